"""docs/how_to_add.md names files and what stands in them: all of it is there, and no file is missing in its lists."""
from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'how_to_add.md').read_text(encoding='utf-8')


@pytest.mark.parametrize('name', sorted(set(re.findall(r'`((?:mems_ins_fusion|test|docs|config)/[\w/.]*)`', PAGE))))
def test_the_files_are_there(name):
    assert (ROOT / name).exists()


@pytest.mark.parametrize(('file', 'names'), [
    ('effects/registry.py', ['EFFECTS']), ('effects/base.py', ['Effect', 'applied', 'attitude']),
    ('filter/memory.py', ['BY_NAME', 'Head', 'MECHANIZATIONS', 'Nav']),
    ('filter/measurements/geometry.py', ['body_to_level', 'turn_attitude', 'set_heading']),
    ('filter/measurements/registry.py', ['AIDING', 'by_kind']),
    ('filter/measurements/base.py', ['Measurement', 'events']),
    ('recordings/aiding.py', ['_CHECKS']), ('filter/config.py', ['_write_head']),
    ('sensor_errors/models.py', ['MODELS', 'Model']), ('parameters/table.py', ['_sensor']),
    ('filter/runs/odometry.py', ['navigation_solution']),
    ('navigation/planar.py', ['STATES', 'State', 'CHANNELS', 'mechanize']),
    ('navigation/strapdown.py', ['STATES', 'State', 'CHANNELS', 'mechanize', 'error_step'])])
def test_what_is_named_is_in_them(file, names):
    text = (ROOT / 'mems_ins_fusion' / file).read_text(encoding='utf-8')
    for name in names:
        assert name in PAGE
        assert re.search(rf'\b{name}\b', text), name


@pytest.mark.parametrize('name', ['position', 'speed', 'velocity', 'heading', 'pressure', 'twist', 'magnetometer'])
def test_a_measurement_is_what_the_page_says(name):
    text = (ROOT / 'mems_ins_fusion' / 'filter' / 'measurements' / f'{name}.py').read_text(encoding='utf-8')
    assert 'def observe(' in text and 'def events(' in text


def section(title):
    """The files that a section names, folders with all that is in them."""
    text = PAGE.split(f'## {title}\n')[1].split('\n## ')[0]
    return tuple(re.findall(r'`(mems_ins_fusion/[\w/.]*)`', text))


def naming(*patterns):
    """Files of the package in which each of `patterns` is found."""
    files = sorted((ROOT / 'mems_ins_fusion').rglob('*.py'))
    return [str(file.relative_to(ROOT)) for file in files
            if all(re.search(pattern, file.read_text(encoding='utf-8')) for pattern in patterns)]


def sensor(name, samples):
    return rf'\b({name}_topic|add_{name}|{samples}|Kind\.{name.upper()}|{name}\.(observe|events)|recording\.{name})\b'


@pytest.mark.parametrize(('title', 'patterns'), [
    # what the one that is there touches
    ('An effect', [r'g_sensitivity|GSensitivity']),
    # what all of those that are there touch
    ('A measurement', [sensor('speed', 'Speeds'), sensor('velocity', 'Velocities'), sensor('heading', 'Headings')]),
    ('A sensor error model', ['random_walk|RandomWalk', 'gauss_markov|GaussMarkov', 'autoregressive|Autoregressive']),
    ('A mechanization', ['planar|PLANAR', 'strapdown|STRAPDOWN'])])
def test_the_lists_name_every_file_that_an_example_is_in(title, patterns):
    listed, found = section(title), naming(*patterns)
    assert found
    assert not [file for file in found if not file.startswith(listed)]
