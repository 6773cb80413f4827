"""Effects put into a measured recording by changing what it holds: what a wrong declaration would have done to it.

A measured drive has effects of its own, of unknown size; what is put in comes on top, and its size is known.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from mems_ins_fusion.navigation.frames import FLU_TO_FRD, mounting, rotation_from_rpy
from mems_ins_fusion.samples import Recording


def with_undeclared(recording: Recording, mounting_rpy=(0.0, 0.0, 0.0), *, time_offset: float = 0.0,
                    accelerometer_scale=(0.0, 0.0, 0.0), gyroscope_scale=(0.0, 0.0, 0.0),
                    mounting_rotation=(0.0, 0.0, 0.0)) -> Recording:
    """`recording` as it would be with effects that it does not have: those of the same names in `effects`.

    mounting_rpy: rad, imu.mounting_rpy of the recording. time_offset: s, by which what comes from the receiver is
    stamped later. accelerometer_scale, gyroscope_scale: scale factor errors along the body's x, y and z.
    mounting_rotation: roll, pitch and yaw, rad, by which the IMU is turned beyond `mounting_rpy`. Rotation acts first.
    The reference is kept.
    """
    declared = mounting(mounting_rpy)  # from sensor to body axes
    extra = FLU_TO_FRD @ rotation_from_rpy(*mounting_rotation) @ FLU_TO_FRD
    imu = recording.imu

    def measured(vectors, scale):
        """Sensor axes of then, from sensor axes: to the body, into the turned IMU, times its scale factors."""
        body = vectors @ declared.T @ extra
        return body * (1.0 + np.asarray(scale)) @ declared

    imu = replace(imu, specific_force=measured(imu.specific_force, accelerometer_scale),
                  angular_rate=measured(imu.angular_rate, gyroscope_scale))
    late = round(time_offset * 1e9)

    def stamped(samples):
        if samples is None or not late:
            return samples
        stamp = samples.stamp + late
        return replace(samples, stamp=stamp, received=np.maximum(samples.received, stamp))

    return replace(recording, imu=imu, gnss=stamped(recording.gnss), velocity=stamped(recording.velocity))
