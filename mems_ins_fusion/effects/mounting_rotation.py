"""Mounting rotation: the IMU is rotated in the vehicle beyond its declared mounting (misalignment)."""
from __future__ import annotations

from mems_ins_fusion.effects.base import Effect, EffectParameter


class MountingRotation(Effect):
    """With R the rotation of (roll, pitch, yaw), base_link (forward-left-up): true mounting = R declared mounting."""

    name = 'mounting_rotation'
    signature = ('across-track innovations after each change of speed, along-track ones in bends: f_x and f_y '
                 'are mixed')
    in_words = 'the IMU is turned against the vehicle'
    to_check = 'how the IMU is mounted: imu.mounting_rpy, and whether its bracket is loose'
    sizes = {'roll': ('it is tilted {} more to the right', 'it is tilted {} more to the left'),
             'pitch': ('it is tilted {} more forward', 'it is tilted {} more backward'),
             'yaw': ('it is turned {} more to the left', 'it is turned {} more to the right')}
    largest = {'roll': 0.5, 'pitch': 0.5, 'yaw': 0.8}
    larger_is = 'sensor axes that are not those of imu.mounting_rpy: `configure` finds them'
    parameters = tuple(EffectParameter(angle, 'rad', 0.05) for angle in ('roll', 'pitch', 'yaw'))
    principal = 'yaw'

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        from scipy.spatial.transform import Rotation

        seen = Rotation.from_euler('ZYX', [-values['yaw'], -values['pitch'], values['roll']]).inv()
        return seen.apply(specific_force), seen.apply(angular_rate)

    def hidden(self, values, recording):
        if values['vehicle.non_holonomic']:
            return ''
        return 'only vehicle.non_holonomic defines the forward axis: without it the heading contains the rotation'

    def held(self, values):
        estimated = values['vehicle.non_holonomic'] and values['imu.mounting_sigma'] > 0.0
        return {**values, 'imu.mounting_sigma': 0.0} if estimated else values

    def adjusted(self, values, theta):
        from scipy.spatial.transform import Rotation

        extra = Rotation.from_euler('xyz', [theta['roll'], theta['pitch'], theta['yaw']])
        declared = Rotation.from_euler('xyz', values['imu.mounting_rpy'])
        return {**values, 'imu.mounting_rpy': [float(a) for a in (extra * declared).as_euler('xyz')]}
