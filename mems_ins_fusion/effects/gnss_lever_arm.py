"""GNSS lever arm: the antenna is not where the IMU is."""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter


class GnssLeverArm(Effect):
    """The antenna stands at (x, y, z) from the IMU, base_link (forward-left-up)."""

    name = 'gnss_lever_arm'
    signature = ('innovations that are constant in the axes of the vehicle: seen in bends and at changes of heading; '
                 'the same as an accelerometer lever arm')
    in_words = 'the antenna is not where the parameters say'
    to_check = 'the place of the antenna seen from the IMU, with a tape measure: forward, left, up'
    sizes = {'x': ('the antenna is {} further forward', 'the antenna is {} further back'),
             'y': ('{} further left', '{} further right'),
             'z': ('{} higher', '{} lower')}
    largest = {'x': 5.0, 'y': 3.0, 'z': 3.5}
    larger_is = ('an error that turns with the vehicle: a time offset, an IMU that is turned or tilted, positions '
                 'that the receiver smooths')
    parameters = tuple(EffectParameter(axis, 'm', 1.0, adds_to=('gnss.lever_arm', i),
                                       sigma_in='gnss.lever_arm_sigma' if axis in 'xy' else '')
                       for i, axis in enumerate('xyz'))

    def distort_fixes(self, drive, time, position, values, rng):
        arm = np.array([values['x'], -values['y'], -values['z']])  # body, forward-right-down
        return position + drive.at(time).attitude.apply(arm)
