"""Poses of a lidar or camera odometry: velocity and turn rate from each pose to the next.

For sources that leave the twist of their odometry empty. A pose drifts, so it is never used as a position; the
displacement between two poses does not drift.
"""
from __future__ import annotations

import numpy as np

from ...navigation.frames import FLU_TO_FRD, ned_from_enu
from ...samples import Displacements
from .base import ODOMETRY, POSE, POSE_STAMPED
from .twist import Twist

#: s: poses further apart in time give no velocity: the mean velocity is not that in the middle any more, and the source
#: may have restarted in between
LONGEST_APART = 1.0


class Pose(Twist):
    """Named inputs only. Its events are those of a named `Twist`, so it has no kind of its own."""

    name, samples, of_two = 'pose', Displacements, True
    topic_text = ('Topic of the poses of a lidar or a camera in a frame of their own, of base_link: nav_msgs/Odometry '
                  'without a twist, geometry_msgs/PoseStamped or PoseWithCovarianceStamped; the source must not use '
                  'the fixes')
    messages = {ODOMETRY: ('pose.pose.position', 'pose.pose.orientation'),
                POSE: ('pose.pose.position', 'pose.pose.orientation'),
                POSE_STAMPED: ('pose.position', 'pose.orientation')}
    written_to = '/lidar/odometry'

    def refusal(self, twist):
        if np.isnan(twist).any():
            return f'a pose that is not finite, or not 0 to {LONGEST_APART:g} s after the one before: dropped'
        return super().refusal(twist)

    def read(self, fields, message):
        """One sample for each pair of successive messages, stamped in the middle between them."""
        prefix = 'pose' if message == POSE_STAMPED else 'pose.pose'
        stamp, position, orientation = fields['stamp'], fields[f'{prefix}.position'], fields[f'{prefix}.orientation']
        steps = np.diff(stamp)
        twist = between(steps * 1e-9, position, orientation)
        return Displacements(stamp[:-1] + steps // 2, fields['received'][1:], twist, np.full(twist.shape, np.nan),
                             position[1:], orientation[1:], stamp[1:])

    def written(self, displacements):
        seconds, nanoseconds = np.divmod(displacements.later, 10**9)
        return {'header.stamp.sec': seconds, 'header.stamp.nanosec': nanoseconds,
                'pose.pose.position': displacements.position, 'pose.pose.orientation': displacements.orientation}

    def simulated(self, drive, errors, effects, rng, instants):
        """Poses that drift, with the errors of an odometry's velocity between them."""
        from scipy.spatial.transform import Rotation

        time, stamp = instants(errors['twist_rate'], 0.0043)
        there, step = drive.at(time), np.diff(time, prepend=time[:1])[:, None]
        moved = np.diff(there.position + there.attitude.apply(self.arm), axis=0, prepend=np.zeros((1, 3)))
        moved *= 1.0 + errors['twist_scale'] * rng.standard_normal()
        position = np.cumsum(moved + errors['twist_sigma'] * step * rng.standard_normal(moved.shape), axis=0)
        turned = Rotation.from_rotvec(errors['twist_turn_sigma'] * step * rng.standard_normal(moved.shape))
        yaw = sum(effect.turned(self.name, values) for effect, values in effects)
        axes = Rotation.from_rotvec([0.0, 0.0, -yaw])  # about the down axis
        to_enu, flu = Rotation.from_matrix(ned_from_enu(np.eye(3))), Rotation.from_matrix(FLU_TO_FRD)
        return self.read({'stamp': stamp, 'received': stamp.copy(), 'pose.pose.position': ned_from_enu(position),
                          'pose.pose.orientation': (to_enu * there.attitude * turned * axes * flu).as_quat()}, ODOMETRY)


def between(step: np.ndarray, position: np.ndarray, orientation: np.ndarray) -> np.ndarray:
    """Mean velocity forward and to the right, m/s, and turn rate clockwise, rad/s, between n poses: (n - 1, 3).

    step (n - 1,): s. position (n, 3): m. orientation (n, 4): quaternions x, y, z, w from forward-left-up axes. The axes
    of the result are those of the mean attitude. NaN where a pose is not finite, and where a step is not above 0 and at
    most LONGEST_APART.
    """
    from scipy.spatial.transform import Rotation  # imported here: it is slow to load, and only poses need it

    if len(position) < 2:
        return np.empty((0, 3))
    with np.errstate(invalid='ignore'):
        length = np.linalg.norm(orientation, axis=1)
        whole = np.isfinite(position).all(axis=1) & np.isfinite(length) & (length > 0.0)
        usable = whole[1:] & whole[:-1] & (step > 0.0) & (step <= LONGEST_APART)
    attitude = Rotation.from_quat(np.where(whole[:, None], orientation, (0.0, 0.0, 0.0, 1.0)))
    turned = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
    half_way = attitude[:-1] * Rotation.from_rotvec(0.5 * turned)
    moved = half_way.inv().apply(np.where(usable[:, None], np.diff(position, axis=0), 0.0))
    step = np.where(usable, step, np.nan)[:, None]
    forward_right, clockwise = (moved / step @ FLU_TO_FRD)[:, :2], (turned / step @ FLU_TO_FRD)[:, 2]
    return np.column_stack([forward_right, clockwise])
