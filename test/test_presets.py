"""The presets of config/sensors: they load, say where their numbers come from, and go together with one's own file."""
from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
import ros_support
from scipy.spatial.transform import Rotation

from mems_ins_fusion.parameters import params_file, table

FOLDER = Path(__file__).resolve().parents[1] / 'config' / 'sensors'
PRESETS = sorted(FOLDER.glob('*.yaml'))
#: of data sheets in SI units
UNITS = {'ug/sqrt(Hz)': 9.80665e-6, 'mg/sqrt(Hz)': 9.80665e-3, 'deg/s/sqrt(Hz)': math.pi / 180}


@pytest.mark.parametrize('preset', PRESETS, ids=lambda path: path.stem)
def test_a_preset_loads_and_says_what_it_stands_on(preset):
    text = preset.read_text(encoding='utf-8')
    given = params_file.load_yaml(preset)
    table.check(given)
    assert given.get('imu_topic') or given.get('gnss_topic')
    # each number from a data sheet with the unit it has there, beside its SI value
    for name, [value] in ((n, v) for n, v in given.items() if n.endswith('noise_density')):
        number, unit = re.search(rf'([\d.]+) (\S+)\n    {name}:', text).groups()
        assert value == pytest.approx(float(number) * UNITS[unit], rel=5e-4)
        assert f'{number} {unit}' in re.sub(r'\n#\s+', ' ', text.split('/**:')[0])
    assert re.search(r'source|README|data sheet|specification', text)


def test_there_is_one_for_each_sensor_promised():
    names = ' '.join(preset.stem for preset in PRESETS)
    for sensor in ('f9p', 'm8', 'xsens_mti', 'vn100', 'vn200', 'bno055', 'bmi088', 'adis16470'):
        assert sensor in names


@pytest.mark.parametrize('name', ['vectornav_vn100', 'vectornav_vn200'])
def test_right_forward_up_becomes_forward_left_up(name):
    rpy = params_file.load_yaml(FOLDER / f'{name}.yaml')['imu.mounting_rpy']
    turned = Rotation.from_euler('xyz', rpy).apply(np.eye(3))  # of the sensor's axes right, forward, up
    assert turned == pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), abs=1e-6)


def test_an_imu_a_receiver_and_a_vehicle_go_together_in_the_node(tmp_path):
    own = tmp_path / 'my_car.yaml'
    own.write_text('/**:\n  ros__parameters:\n    imu_topic: /front/imu\n    gnss.lever_arm: [0.5, 0.0, 1.2]\n')
    files = [FOLDER / 'vectornav_vn100.yaml', FOLDER / 'ublox_f9p.yaml', own]
    together = table.check(params_file.load_files(files))
    assert together['gyroscope.noise_density'] == [6.109e-5] and together['imu_topic'] == '/front/imu'
    arguments = [word for path in files for word in ('--params-file', str(path))]
    with ros_support.NodeProcess('fusion_node', *arguments) as node:
        ready = node.wait_for('ready: ', timeout=600.0)
    assert '/front/imu and /ublox_gps_node/fix ->' in ready
