"""docs/how_to_add.md names files and what stands in them: all of it is there."""
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
    ('filter/layout.py', ['Kind', 'Head', 'MECHANIZATIONS', 'Nav']),
    ('filter/correction.py', ['apply_event', 'feed_back']),
    ('filter/intake.py', ['SOURCES', 'NAMES']), ('filter/config.py', ['_extras', '_write_head', '_set_noise']),
    ('filter/replay.py', ['Aiding', 'WITHHELD']), ('parameters/table.py', ['MODELS', '_sensor']),
    ('filter/odometry.py', ['corrected']), ('navigation/planar.py', ['STATES', 'State', 'CHANNELS', 'mechanize']),
    ('navigation/strapdown.py', ['STATES', 'State', 'CHANNELS', 'mechanize', 'error_step'])])
def test_what_is_named_is_in_them(file, names):
    text = (ROOT / 'mems_ins_fusion' / file).read_text(encoding='utf-8')
    for name in names:
        assert name in PAGE
        assert re.search(rf'\b{name}\b', text), name


@pytest.mark.parametrize('name', ['position', 'speed', 'velocity', 'heading'])
def test_a_measurement_is_what_the_page_says(name):
    text = (ROOT / 'mems_ins_fusion' / 'filter' / 'measurements' / f'{name}.py').read_text(encoding='utf-8')
    assert 'def observe(' in text and 'def records(' in text
