"""What is put into a measured recording: the declaration of it takes it out again."""
from __future__ import annotations

import numpy as np
import pytest
from conftest import shared_data
from filter_support import configure
from undeclared import with_undeclared

from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.evaluation.comparison import time_span
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_drive, simulate_recording

#: the IMU looks backwards
MOUNTING = [0.0, 0.0, np.pi]
#: what is put in, and the effect and its parameters that it is
PUT = {'an offset': ({'time_offset': 0.4}, 'gnss_time_offset', {'time_offset': 0.4}),
       'a negative offset': ({'time_offset': -0.3}, 'gnss_time_offset', {'time_offset': -0.3}),
       'scales of the accelerometers': ({'accelerometer_scale': (0.05, -0.04, 0.0)}, 'accelerometer_scale',
                                        {'x': 0.05, 'y': -0.04}),
       'a scale of the gyroscope': ({'gyroscope_scale': (0.0, 0.0, 0.03)}, 'gyroscope_scale', {'z': 0.03}),
       'a rotation': ({'mounting_rotation': (0.03, -0.02, 0.1)}, 'mounting_rotation',
                      {'roll': 0.03, 'pitch': -0.02, 'yaw': 0.1})}


@pytest.fixture(scope='module')
def measured():
    return time_span(read_recording(shared_data('longmont_rtk_drive') / 'bag', '/imu/data', '/gps/fix'), 0.0, 200.0)


@pytest.mark.parametrize('what', PUT)
def test_its_declaration_takes_it_out_of_a_measured_drive(measured, what):
    # given a measured drive, and the same with an effect
    put, name, theta = PUT[what]
    values = table.check({'imu.mounting_rpy': MOUNTING, 'gnss.max_delay': 2.0})
    changed = with_undeclared(measured, MOUNTING, **put)
    declared = EFFECTS[name].adjusted(values, theta)
    # when the filter runs as before, without knowing, and knowing
    was, ignorant, knowing = (run(configure(v), r.imu, r.gnss) for v, r in (
        (values, measured), (values, changed), (declared, changed)))
    # then the innovations are those of before, to the rounding of rotations and stamps
    assert len(was.innovations.z) > 600 and np.array_equal(knowing.innovations.index, was.innovations.index)
    assert np.abs(knowing.innovations.z - was.innovations.z).max() < 1e-5
    common = np.intersect1d(ignorant.innovations.index, was.innovations.index, return_indices=True)[1:]
    assert np.abs(ignorant.innovations.z[common[0]] - was.innovations.z[common[1]]).max() > 0.05


@pytest.mark.parametrize('what', PUT)
def test_it_is_the_effect_of_that_name(what):
    # given a simulated drive with an effect, and the drive without it into which it is put
    put, name, theta = PUT[what]
    drive, mounting_rpy = simulate_drive(60.0, 3), (0.1, -0.2, 1.2)
    with_it, without = (simulate_recording(drive, None, GnssNoise(sigma=0.0), effects, mounting_rpy).recording
                        for effects in ([(EFFECTS[name], theta)], []))
    changed = with_undeclared(without, mounting_rpy, **put)
    # then sensors without errors measure the same
    assert np.abs(changed.imu.specific_force - with_it.imu.specific_force).max() < 1e-12
    assert np.abs(changed.imu.angular_rate - with_it.imu.angular_rate).max() < 1e-12
    if name == 'gnss_time_offset':
        at = np.interp(with_it.gnss.stamp - without.gnss.stamp[0], changed.gnss.stamp - without.gnss.stamp[0],
                       changed.gnss.latitude)
        moving = slice(30, -2)
        assert np.abs(at - with_it.gnss.latitude)[moving].max() * 6.37e6 < 0.4  # m: chords of a second
        assert (changed.gnss.received >= changed.gnss.stamp).all()


def test_nothing_put_in_is_nothing(measured):
    same = with_undeclared(measured, MOUNTING)
    assert np.abs(same.imu.specific_force - measured.imu.specific_force).max() < 1e-12
    assert same.gnss is measured.gnss and same.velocity is measured.velocity
