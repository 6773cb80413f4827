"""The mission in one test: effects that nobody declares, put into a measured drive, are found beside what it has."""
from __future__ import annotations

import pytest
from conftest import shared_data
from undeclared import with_undeclared

from mems_ins_fusion.diagnosis.diagnose import diagnose
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.evaluation.comparison import time_span
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording

#: the IMU looks backwards
MOUNTING = [0.0, 0.0, 3.141593]
#: candidates: what is put in, and what looks alike
EFFECTS_TRIED = [EFFECTS[name] for name in ('gnss_time_offset', 'gnss_lever_arm', 'gyroscope_scale',
                                            'mounting_rotation')]


@pytest.fixture(scope='module')
def drive():
    """City streets, then tight turns, of which nobody said that fixes are stamped a quarter of a second early."""
    return time_span(read_recording(shared_data('longmont_rtk_drive') / 'bag', '/imu/data', '/gps/fix'), 0.0, 300.0)


def found(recording):
    """Values and sigmas by effect and parameter, of what was added; and the diagnosis."""
    result = diagnose(recording, table.check({'imu.mounting_rpy': MOUNTING, 'gnss.max_delay': 2.0}),
                      effects=EFFECTS_TRIED, durations=(10.0, 30.0))
    return {(f.name, name): e for f in result.findings if f.added for name, e in f.parameters.items()}, result


@pytest.fixture(scope='module')
def own(drive):
    return found(drive)


def test_what_the_drive_has_of_its_own_is_found(own):
    values, result = own
    # the course of the fixes, which knows no filter, says -0.28 s (sigma 0.03), and a yaw of -5.8 deg (sigma 0.4)
    assert values['gnss_time_offset', 'time_offset'].value == pytest.approx(-0.28, abs=0.09)
    assert values['mounting_rotation', 'yaw'].value == pytest.approx(-0.101, abs=0.03)
    # and it helps where it was not fitted
    assert result.changed
    for before, after in zip(result.before.outages, result.after.outages):
        assert after.max_error.mean() < 0.7 * before.max_error.mean()
        assert after.within.mean() >= 0.9


def test_effects_that_are_put_in_are_found_beside_it(drive, own):
    # given three effects at once, each of another kind, on top of what the drive has of its own
    own, _ = own
    values, result = found(with_undeclared(drive, MOUNTING, time_offset=0.5, gyroscope_scale=(0.0, 0.0, 0.05),
                                           mounting_rotation=(0.0, 0.0, -0.1)))
    assert result.changed
    for effect, parameter, size, resolution in (('gnss_time_offset', 'time_offset', 0.5, 0.03),
                                                ('gyroscope_scale', 'z', 0.05, 0.01),
                                                ('mounting_rotation', 'yaw', -0.1, 0.02)):
        before = own.get((effect, parameter))
        expected = size + (before.value if before else 0.0)
        assert values[effect, parameter].value == pytest.approx(expected, abs=resolution), effect
