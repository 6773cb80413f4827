"""Tilt in motion: on hills, and on its suspension, the body pitches and rolls, and gravity leaks into f_x and f_y.

Simulated as suspension (hills are the drive's own); diagnosed by the attitude that the other sensors of the same IMU
show; corrected by the strapdown mechanization, which needs no parameter.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter
from mems_ins_fusion.navigation.frames import mounting


class Tilt(Effect):
    """Nose up by pitch_per_acceleration when speeding up, leaning outwards by roll_per_acceleration in a bend.

    In the diagnosis its one parameter is `compensation`: the part of gravity's leakage, computed from the attitude of a
    strapdown run, that the planar filter's specific force contains. 1 says that the attitude explains it.
    """

    name = 'tilt'
    signature = ('along-track innovations on slopes, across-track ones on banked roads, up to g times the angle; where '
                 'only the suspension tilts, scale factors of the accelerometers look the same')
    traced = (EffectParameter('compensation', '-', 0.3),)
    parameters = (EffectParameter('pitch_per_acceleration', 'rad/(m/s^2)', 0.01),
                  EffectParameter('roll_per_acceleration', 'rad/(m/s^2)', 0.01))

    def alter_drive(self, drive, values):
        return drive.altered(
            pitch_per_acceleration=drive.path.pitch_per_acceleration + values['pitch_per_acceleration'],
            roll_per_acceleration=drive.path.roll_per_acceleration + values['roll_per_acceleration'])

    def hidden(self, values, recording):
        if values['mechanization'] == 'strapdown':
            return 'the strapdown mechanization has no such error'
        return ''

    def adjusted(self, values, theta):
        return {**values, 'mechanization': 'strapdown'} if theta['compensation'] else values

    def applied(self, values, recording, theta):
        """The recording with this part of the leakage taken out, seen by the mechanization as it is."""
        force = recording.imu.specific_force - theta['compensation'] * self.leakage(values, recording)
        return values, replace(recording, imu=replace(recording.imu, specific_force=force))

    def leakage(self, values, recording) -> np.ndarray:
        """Gravity in f_x and f_y by the attitude of a strapdown run, (n, 3) m/s^2 in sensor axes."""
        from mems_ins_fusion.filter.fusion import FilterConfig, run
        from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY

        result = run(FilterConfig.from_parameters({**values, 'mechanization': 'strapdown'}), recording.imu,
                     recording.gnss)
        body = np.zeros((len(recording.imu), 3))
        body[result.index, 0] = STANDARD_GRAVITY * np.sin(result.pitch)
        body[result.index, 1] = -STANDARD_GRAVITY * np.sin(result.roll) * np.cos(result.pitch)
        return body @ mounting(values['imu.mounting_rpy'])
