"""A running filter in the axes of another mounting: what it knows of the vehicle is the same, only the axes differ."""
from __future__ import annotations

import math

import numpy as np
import pytest
from test_applying import APPLY, SECOND, drive, fed

from mems_ins_fusion.filter.config import MOUNTING_STATES, FilterConfig
from mems_ins_fusion.filter.memory import NAV, Head, Nav, covariance, newest_row, set_covariance, views
from mems_ins_fusion.filter.runs import changing, snapshot, turning
from mems_ins_fusion.filter.runs.turning import turns_into
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.navigation.strapdown import matrix

ARM = [0.8, 0.3, 1.0]
GIVEN = {**APPLY, 'gnss.lever_arm': ARM}
TURNED = {**GIVEN, 'imu.mounting_rpy': [0.02, 0.1, -0.09]}
#: index of the sample at which the filter is turned, at 20 Hz: the vehicle drives
AT = 200 * 20


@pytest.fixture(scope='module')
def right():
    return drive(minutes=6.0, offset=0.0)


def filtered(recording, last, at=None, values=GIVEN):
    fusion = changing.ChangingFilter(FilterConfig.from_parameters(values))
    fed(fusion, recording, 0, last, {index: lambda what=what: what(fusion) for index, what in (at or {}).items()})
    return fusion


def attitude(fusion):
    """From the sensor's axes, and from those of the body, to north-east-down."""
    body = np.array(matrix(tuple(newest_row(fusion._memory)[Nav.Q_W:Nav.Q_Z + 1]))).reshape(3, 3)
    return body @ fusion.config.imu.mounting, body


def antenna(fusion):
    """North, east, down, m, from the datum."""
    row = newest_row(fusion._memory)
    north, east, _ = to_local(row[Nav.LATITUDE], row[Nav.LONGITUDE], row[Nav.HEIGHT], fusion.datum)
    return [float(north), float(east), -row[Nav.HEIGHT]] + attitude(fusion)[1] @ fusion._memory[
        Head.LEVER_X:Head.LEVER_X + 3]


def forward(fusion):
    """The forward axis of the vehicle, in north-east-down."""
    layout, row = fusion.config.layout, newest_row(fusion._memory)
    yaw, pitch = (row[NAV + layout.index(name)] for name in ('mounting_yaw', 'mounting_pitch'))
    axis = [math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), -math.sin(pitch)]
    return attitude(fusion)[1] @ axis


def angle(a, b):
    """rad, of the rotation from a to b (3, 3)."""
    return math.acos(min(max(0.5 * (np.trace(a.T @ b) - 1.0), -1.0), 1.0))


def test_a_turned_filter_knows_the_same_of_sensor_antenna_and_vehicle(right):
    # given a filter under way
    fusion = filtered(right, AT)
    config, row = fusion.config, newest_row(fusion._memory).copy()
    before = attitude(fusion)[0], antenna(fusion), forward(fusion), snapshot.vehicle_heading(config, fusion._memory)
    p = covariance(row, config.layout)
    # when it goes on with a mounting that turns all three axes
    fusion.change(TURNED)
    # then it does so at once, and attitude of the sensor, place of the antenna and direction of the vehicle stay
    assert fusion.config.parameters == TURNED and not fusion.changing and len(fusion.handovers) == 1
    assert angle(before[0], attitude(fusion)[0]) < 1e-7
    assert np.abs(before[1] - antenna(fusion)).max() < 1e-4  # scales of radians to metres are of a latitude nearby
    assert np.abs(before[2] - forward(fusion)).max() < 1e-12
    # with their covariances: those of the heading contain the correlations with the mounting
    layout, after = fusion.config.layout, covariance(newest_row(fusion._memory), fusion.config.layout)
    n = layout.n_navigation
    assert after[:n, :n] == pytest.approx(p[:n, :n])
    assert snapshot.vehicle_heading(fusion.config, fusion._memory)[1] == pytest.approx(before[3][1], rel=1e-3)
    # and errors and their variances along any direction of the sensor are the same
    turn, row_after = fusion.config.imu.mounting @ config.imu.mounting.T, newest_row(fusion._memory)
    for first in (n, n + 3):
        part = slice(first, first + 3)
        assert turn.T @ row_after[NAV:][part] == pytest.approx(row[NAV:][part], abs=1e-12)
        assert turn.T @ after[part, part] @ turn == pytest.approx(p[part, part], abs=1e-15)


def test_a_turned_filter_goes_on_like_one_that_is_not(right):
    # given a drive of which a filter is turned in the middle, and a fix that comes late, of before the turn
    late = right.gnss.received.copy()
    k = np.flatnonzero(late < right.imu.received[AT - 1])[-1]
    late[k] += round(0.3 * SECOND)
    recording = right.having({**right.streams(), 'gnss': right.gnss.select(slice(None))})
    object.__setattr__(recording.gnss, 'received', late)
    last = AT + 60 * 20
    turned, other = filtered(recording, last, {AT: lambda fusion: fusion.change(TURNED)}), filtered(recording, last)
    # then a minute later both have the same sensor at the same place: the accelerations of a drive do not change by it
    assert turned.config.parameters == TURNED
    assert angle(attitude(turned)[0], attitude(other)[0]) < math.radians(0.1)
    assert np.abs(antenna(turned) - antenna(other)).max() < 0.03
    assert turned.tallies['fix'].refused == other.tallies['fix'].refused == {}


def test_what_is_published_goes_over_to_the_new_axes_within_seconds(right):
    turn = math.radians(5.0)
    yaws = []
    fusion = filtered(right, AT + 15 * 20, {
        AT: lambda fusion: (note(fusion, yaws), fusion.change({**GIVEN, 'imu.mounting_rpy': [0.0, 0.0, turn]}),
                            note(fusion, yaws))})
    assert yaws[1] == pytest.approx(yaws[0], abs=1e-9)
    assert fusion.handovers[0].yaw == pytest.approx(-turn, abs=1e-6)
    fusion.update_odometry()
    assert fusion._blending is None  # after BLENDING


def note(fusion, yaws):
    fusion.update_odometry()
    yaws.append(float(changing.yaw_of_quaternion(*fusion.odometry[changing.ORIENTATION:changing.POSE_COVARIANCE])))


def test_only_a_mounting_that_the_filter_estimates_is_turned(right):
    config = FilterConfig.from_parameters(GIVEN)
    assert turns_into(config, TURNED)
    assert not turns_into(config, GIVEN) and not turns_into(config, {**TURNED, 'gnss.time_offset': 0.1})
    exact = {'imu.mounting_sigma': 0.0}
    assert not turns_into(FilterConfig.from_parameters({**GIVEN, **exact}), {**TURNED, **exact})
    # and it needs no filter that runs beside until then; one that is not aligned yet gets one
    fusion = filtered(right, AT, {AT - 1: lambda fusion: fusion.prepare([TURNED])})
    assert fusion._others == []
    fusion = filtered(right, 20)
    fusion.change(TURNED)
    assert fusion.changing


def test_a_filter_without_a_finding_is_turned_as_well(right):
    # given a filter with a finding, one without it beside, and the bets on both
    offset = {'gnss.time_offset': 0.1}
    fusion = filtered(right, AT, values={**GIVEN, **offset}, at={1: lambda one: one.watch({'offset': GIVEN})})
    beside = fusion._beside['offset']
    # when a mounting is applied
    fusion.change({**TURNED, **offset}, {'offset': TURNED})
    # then it goes on, in the new axes
    assert fusion._beside['offset'] is beside and beside.fusion.config.parameters == TURNED


def test_the_covariance_of_the_mounting_follows_its_angles():
    # given a mounting that is far from the old one
    rotation, angles, step = FilterConfig.from_parameters({**GIVEN, 'imu.mounting_rpy': [0.4, -0.3, 0.5]}
                                                          ).imu.mounting @ np.diag([1.0, -1.0, -1.0]), [0.2, -0.1], 1e-6
    # then the derivatives that its covariance is multiplied by are those of its angles
    slope = np.column_stack([(turning._turned(np.add(angles, change), rotation)
                              - turning._turned(np.subtract(angles, change), rotation)) / (2.0 * step)
                             for change in step * np.eye(2)])
    assert turning._slope(np.array(angles), rotation) == pytest.approx(slope, abs=1e-8)
    assert np.abs(slope - np.eye(2)).max() > 0.1
    # and they are used
    config = FilterConfig.from_parameters(GIVEN)
    other = FilterConfig.from_parameters({**GIVEN, 'imu.mounting_rpy': [0.4, -0.3, 0.5]})
    memory, layout = config.memory(), config.layout
    row = views(memory)[2][0]
    row[Nav.Q_W], states = 1.0, [layout.index(name) for name in MOUNTING_STATES]
    full = np.zeros((layout.n, layout.n))
    full[states, states] = 1.0, 4.0
    set_covariance(row, layout, full)
    turning.turn(memory, config, other)
    rotation = other.imu.mounting @ config.imu.mounting.T
    slope = turning._slope(np.zeros(2), rotation)
    assert covariance(row, layout)[np.ix_(states, states)] == pytest.approx(slope @ np.diag([1.0, 4.0]) @ slope.T)
