"""How fast the vehicle usually is bounds its velocity where no fix does."""
from __future__ import annotations

import math

import numpy as np
import pytest
from filter_support import LATITUDE, LONGITUDE, configure, fix_event, started, take_all

from mems_ins_fusion.filter.memory import Nav, covariance_index, views
from mems_ins_fusion.filter.trust.scale import PRIOR, Scale
from mems_ins_fusion.filter.trust.usual_speed import ASSUMED_VARIANCE, CORRELATION, SHORTEST_OUTAGE, UsualSpeed
from mems_ins_fusion.navigation.earth import gravity, radii

RATE = 20.0  # Hz
METRES = radii(LATITUDE)[0]  # per radian of latitude, at height 0
#: sensors without errors, a constraint that says nothing of the velocity
EXACT = {'mechanization': 'planar', 'vehicle.non_holonomic': True, 'vehicle.non_holonomic_sigma': 100.0,
         'vehicle.zero_velocity': False, 'accelerometer.noise_density': [1e-6], 'gyroscope.noise_density': [1e-6],
         'accelerometer.random_walk.q': [1e-12], 'gyroscope.random_walk.q': [1e-12]}


def coasting(seconds):
    """Samples (k, 7) of an IMU that neither accelerates nor turns."""
    samples = np.zeros((round(RATE * seconds), 7))
    samples[:, 0], samples[:, 3] = np.arange(1, len(samples) + 1) / RATE, gravity(LATITUDE, 0.0)
    return samples


def without_fixes(sigma, velocity=6.0, seconds=60.0, learned=True):
    """Each second: time, s, velocity north, m/s, its variance and that of the velocity east, of a filter that begins
    with this sigma, m/s, and has no fix; learned: whether it knows that ASSUMED_VARIANCE is usual."""
    config = configure(EXACT)
    i = config.layout.index('v_n')
    p = 1e-12 * np.eye(config.layout.n)
    p[i, i] = p[i + 1, i + 1] = sigma**2
    memory = started(config, velocity=(velocity, 0.0, 0.0), attitude=(0.0, 0.0, 0.0), p=p)
    if learned:
        views(memory)[2][0][[UsualSpeed.SCALE + Scale.TIME, UsualSpeed.SCALE + Scale.REDUCED]] = -1.0, PRIOR
    rows, _ = take_all(memory, coasting(seconds), np.zeros((0, len(fix_event(0.0)))),
                       [Nav.TIME, Nav.V_N, *(covariance_index(k, k, config.layout) for k in (i, i + 1))])
    return rows[round(RATE) - 1::round(RATE)].T


def test_without_fixes_the_usual_speed_is_one_measurement_in_each_correlation_time():
    # given a velocity with a sigma of 30 m/s, of a vehicle that has usually ASSUMED_VARIANCE
    time, velocity, north, east = without_fixes(30.0)
    # then its information grows by that of the usual speed, until it is known as well as that alone,
    applied = (time[:-1] > SHORTEST_OUTAGE) & (0.5 * (north + east)[1:] > ASSUMED_VARIANCE)
    grown = np.diff(1.0 / north)
    assert grown[applied] == pytest.approx(1.0 / (CORRELATION * ASSUMED_VARIANCE), rel=3e-3) and applied.sum() > 10
    assert grown[(time[1:] < SHORTEST_OUTAGE) | (0.5 * (north + east)[:-1] < ASSUMED_VARIANCE)] == pytest.approx(
        0.0, abs=2e-4)
    # and zero is that much nearer
    until = np.append(True, applied | (time[:-1] < SHORTEST_OUTAGE))
    assert velocity[until] == pytest.approx(6.0 * north[until] / 30.0**2, rel=3e-3)


def test_a_velocity_that_is_known_better_stays_as_it_is():
    _, velocity, *_ = without_fixes(0.8 * math.sqrt(ASSUMED_VARIANCE))
    assert velocity == pytest.approx(6.0, abs=1e-6)


def test_a_vehicle_that_is_certainly_faster_than_usual_goes_on():
    # given 40 +- 6 m/s, where 5 m/s is usual: less certain than the usual speed, but certainly faster
    _, velocity, *_ = without_fixes(1.2 * math.sqrt(ASSUMED_VARIANCE), velocity=40.0)
    assert velocity == pytest.approx(40.0, abs=1e-6)


def test_a_velocity_stays_as_it_is_where_fixes_have_shown_none():
    _, velocity, *_ = without_fixes(30.0, learned=False)
    assert velocity == pytest.approx(6.0, abs=1e-6)


@pytest.mark.parametrize('speed', [0.8, 3.0, 40.0])
def test_the_usual_speed_is_learned_from_fixes(speed):
    # given five minutes of fixes at a constant speed
    config = configure(EXACT)
    memory = started(config, velocity=(speed, 0.0, 0.0), attitude=(0.0, 0.0, 0.0))
    fixes = np.array([fix_event(k - 0.001, LATITUDE + speed * k / METRES, LONGITUDE, 0.0, 0.01 * np.eye(2))
                      for k in range(1, 300)])
    rows, _ = take_all(memory, coasting(300.0), fixes, [UsualSpeed.SCALE + Scale.LOG])
    # then the variance of a component is half its square, or somewhat more: that a vehicle was never faster than its
    # mean in fifteen times CORRELATION is more likely chance than a rule
    learned = ASSUMED_VARIANCE * math.exp(rows[-1, 0])
    assert 0.5 * speed**2 < learned < 1.2 * speed**2
