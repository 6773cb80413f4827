"""Accelerometer lever arm: the accelerometers are not at the point whose track is estimated."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.compiled import njit
from mems_ins_fusion.effects.base import Effect, EffectParameter
from mems_ins_fusion.navigation.frames import FLU_TO_FRD
from mems_ins_fusion.parameters.parameter import Parameter

#: s, longest step between two samples over which an angular acceleration is computed
LONGEST_STEP = 0.5
#: s, time constant of the average of the angular acceleration. Without it the noise of the gyroscopes would be
#: amplified and hide standstills
SMOOTH = 0.1


class AccelerometerLeverArm(Effect):
    """The accelerometers stand at (x, y, z) from the IMU's reference point, base_link (forward-left-up)."""

    name = 'accelerometer_lever_arm'
    signature = 'the same as a lever arm of the antenna, with the opposite sign'
    in_words = 'the IMU is far from the axle about which the vehicle turns'
    to_check = 'the place of the IMU seen from the middle of the rear axle'
    looks_the_same = 'tyres that slip in bends look nearly the same'
    sizes = {'x': ('the IMU is {} further forward', 'the IMU is {} further back'),
             'y': ('{} further left', '{} further right'),
             'z': ('{} higher', '{} lower')}
    largest = {'x': 3.0, 'y': 2.0, 'z': 2.0}
    larger_is = ('an error that turns with the vehicle: a time offset, an IMU that is turned or tilted, positions '
                 'that the receiver smooths')
    parameters = tuple(EffectParameter(axis, 'm', 0.5, adds_to=('imu.lever_arm', i)) for i, axis in enumerate('xyz'))
    settings = (Parameter('imu.lever_arm', [0.0, 0.0, 0.0], 'm', 'From the point that the track describes to the '
                          'accelerometers, base_link (forward-left-up).', lengths=(3,), minimum=-20.0, maximum=20.0),)

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        arm = np.array([values['x'], -values['y'], -values['z']])  # body, forward-right-down
        rate = drive.angular_rate
        centripetal = np.cross(rate, np.cross(rate, arm))
        tangential = np.cross(np.gradient(rate, 1 / drive.rate, axis=0), arm)
        return specific_force + centripetal + tangential, angular_rate

    def corrector(self, values, rotation):
        if not any(values['imu.lever_arm']):
            return None
        arm = rotation.T @ (FLU_TO_FRD @ np.array(values['imu.lever_arm']))
        last_stamp, last_rate, acceleration = np.zeros(1, dtype=np.int64), np.zeros(3), np.zeros(3)

        def correct(stamp, f, w, celsius):
            rising = _angular_acceleration(stamp, w, last_stamp, last_rate, acceleration)
            return f - _cross(w, _cross(w, arm)) - _cross(rising, arm), w

        return correct


@njit
def _angular_acceleration(stamp, w, last_stamp, last_rate, acceleration):
    """Angular acceleration (n, 3), rad/s^2: differences of `w` (n, 3), rad/s, averaged over SMOOTH. last_stamp,
    last_rate, acceleration: state after the previous sample, updated in place."""
    found = np.zeros_like(w)
    for k in range(len(w)):
        dt = (stamp[k] - last_stamp[0]) * 1e-9
        usable = 0.0 < dt < LONGEST_STEP
        weight = min(1.0, dt / SMOOTH)
        for i in range(3):
            change = (w[k, i] - last_rate[i]) / dt if usable else 0.0
            acceleration[i] = acceleration[i] + weight * (change - acceleration[i]) if usable else 0.0
            found[k, i] = acceleration[i]
            last_rate[i] = w[k, i]
        last_stamp[0] = stamp[k]
    return found


def _cross(a, b):
    """Cross product, written out so that one sample gives the same bits as many."""
    b = np.broadcast_to(b, a.shape)
    return np.stack([a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1], a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
                     a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]], axis=1)
