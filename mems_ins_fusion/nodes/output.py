"""From the filter's newest estimate to messages: smooth frame, prediction to the present time, message.

An estimate is an object with the arrays `odometry` (85,), `geodetic` (3,) and `position_covariance_enu` (9,) as
`FusionFilter.update_odometry` fills them. Estimates form a chain, each computed from the one before: the filter; its
smooth frame and its prediction to the present time, if these are configured; the messages.
"""
from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import NavSatFix, NavSatStatus

from ..filter.runs.odometry import (
    ANGULAR,
    LINEAR,
    ORIENTATION,
    POSE_COVARIANCE,
    POSITION,
    SIZE,
    TWIST_COVARIANCE,
)
from ..navigation.frames import rotation_from_rpy, wrap, yaw_of_quaternion
from ..navigation.strapdown import from_rotation_vector, matrix, multiply
from ..parameters.parameter import ParameterError
from ..samples import SECOND

#: s, time constant with which roll and pitch of the smooth frame follow the filter's
LEVEL_TIME = 2.0
#: s, longest step between two estimates that is integrated
LONGEST_STEP = 1.0
#: m^2 and rad^2, published variance of height, roll and pitch of a vehicle in the plane: above zero, so that the
#: covariance can be inverted
FLAT_VARIANCE = 1e-6
_EARTH = 6.37e6  # m, radius of the earth, accurate enough for the displacement in some milliseconds


def tf_message():
    """The class tf2_msgs/TFMessage; ParameterError where tf2_msgs is not installed."""
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        raise ParameterError("parameter 'publish_tf' needs the ROS package tf2_msgs, which is not installed") from None
    return TFMessage


class SmoothFrame:
    """The pose in a frame in which it never jumps (REP-105's odom): velocity and angular rate of `source`, integrated.

    Corrections by fixes change `frame`, the pose (x, y, z, q_x, q_y, q_z, q_w) of this frame in that of `source`. At
    the first estimate both frames are equal. Roll and pitch follow those of `source` slowly, so that the frame stays
    level. The covariance is that of `source` plus the square of the drift of this frame since the last `settle`.
    """

    def __init__(self, source):
        self._source = source
        self.odometry = np.zeros(SIZE)
        self.geodetic, self.position_covariance_enu = source.geodetic, source.position_covariance_enu
        self.frame = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
        self._stamp = None
        self._position, self._q = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
        self._settled = self.frame

    def settle(self) -> None:
        """Take the present difference of the two frames as constant: drift is counted from now on."""
        self._settled = self.frame

    def advance(self, stamp: int) -> None:
        """Update from the newest estimate of `source`, of time `stamp` (ns)."""
        east, north, up, q_x, q_y, q_z, q_w = self._source.odometry[POSITION:POSE_COVARIANCE].tolist()
        position, q = (east, north, up), (q_w, q_x, q_y, q_z)
        if self._stamp is None:
            self._position, self._q = position, q
        else:
            dt = (stamp - self._stamp) * 1e-9
            self._move(q, dt if 0.0 < dt <= LONGEST_STEP else 0.0)
        self._stamp = stamp
        turned = multiply(q, _inverse(self._q))
        moved = _rotate(matrix(turned), self._position)
        self.frame = (*(a - b for a, b in zip(position, moved)), *turned[1:], turned[0])
        out = self.odometry
        out[:] = self._source.odometry
        out[POSITION:ORIENTATION] = self._position
        out[ORIENTATION:POSE_COVARIANCE] = (*self._q[1:], self._q[0])
        self._covariance(position)

    def _move(self, level, dt):
        v, w = self._source.odometry[LINEAR:ANGULAR].tolist(), self._source.odometry[ANGULAR:TWIST_COVARIANCE].tolist()
        half = multiply(self._q, from_rotation_vector(*(0.5 * dt * rate for rate in w)))
        step = _rotate(matrix(half), v)
        self._position = tuple(p + dt * s for p, s in zip(self._position, step))
        q = multiply(self._q, from_rotation_vector(*(dt * rate for rate in w)))
        up, wanted = matrix(q)[6:], matrix(level)[6:]  # what is up, in base_link
        gain = min(1.0, dt / LEVEL_TIME)
        tilt = (gain * (wanted[1] * up[2] - wanted[2] * up[1]), gain * (wanted[2] * up[0] - wanted[0] * up[2]),
                gain * (wanted[0] * up[1] - wanted[1] * up[0]))
        q = multiply(q, from_rotation_vector(*tilt))
        norm = math.sqrt(sum(part * part for part in q))
        self._q = tuple(part / norm for part in q)

    def _covariance(self, position):
        yaw, before = yaw_of_quaternion(*self.frame[3:]), yaw_of_quaternion(*self._settled[3:])
        back = np.kron(np.eye(2), rotation_from_rpy(0.0, 0.0, -yaw))
        expected = rotation_from_rpy(0.0, 0.0, -before) @ np.subtract(position, self._settled[:3])
        drift = np.array([*(self._position - expected), 0.0, 0.0, wrap(yaw - before)])
        p = self._source.odometry[POSE_COVARIANCE:LINEAR].reshape(6, 6)
        self.odometry[POSE_COVARIANCE:LINEAR] = (back @ p @ back.T + np.outer(drift, drift)).ravel()


class Prediction:
    """The estimate `source` predicted with constant velocity and angular rate, with the covariance that this adds."""

    def __init__(self, source):
        self._source = source
        self.odometry, self.geodetic, self.position_covariance_enu = np.zeros(SIZE), np.zeros(3), np.zeros(9)

    def advance(self, dt: float) -> None:
        """Predict the newest estimate of `source` by `dt` s."""
        out, source = self.odometry, self._source
        out[:] = source.odometry
        x, y, z, w = out[ORIENTATION:POSE_COVARIANCE].tolist()
        rate = out[ANGULAR:TWIST_COVARIANCE].tolist()
        c = np.array(matrix((w, x, y, z))).reshape(3, 3)
        step = dt * c @ out[LINEAR:ANGULAR]
        out[POSITION:ORIENTATION] += step
        q = multiply((w, x, y, z), from_rotation_vector(*(dt * r for r in rate)))
        out[ORIENTATION:POSE_COVARIANCE] = (*q[1:], q[0])
        jacobian = dt * np.kron(np.eye(2), c)
        added = jacobian @ out[TWIST_COVARIANCE:SIZE].reshape(6, 6) @ jacobian.T
        out[POSE_COVARIANCE:LINEAR] += added.ravel()
        self.position_covariance_enu[:] = source.position_covariance_enu + added[:3, :3].ravel()
        latitude, longitude, height = source.geodetic.tolist()
        self.geodetic[:] = (latitude + step[1] / _EARTH, longitude + step[0] / (_EARTH * math.cos(latitude)),
                            height + step[2])


class VehicleAxes:
    """The odometry of `fusion`, a FusionFilter, in the axes of the vehicle, by the estimated mounting.

    The filter's odometry is in the axes that imu.mounting_rpy gives, to which the transforms of all other sensors lead.
    """

    def __init__(self, fusion):
        self._fusion = fusion

    def turn(self) -> None:
        """Rotate the newest odometry, in place."""
        yaw, pitch, sigma = self._fusion.vehicle_axes()
        out = self._fusion.odometry
        # forward-left-up axes: both angles change sign
        mounting = rotation_from_rpy(0.0, -pitch, -yaw)
        half_yaw, half_pitch = -0.5 * yaw, -0.5 * pitch
        q_m = multiply((math.cos(half_yaw), 0.0, 0.0, math.sin(half_yaw)),
                       (math.cos(half_pitch), 0.0, math.sin(half_pitch), 0.0))
        x, y, z, w = out[ORIENTATION:POSE_COVARIANCE].tolist()
        q = multiply((w, x, y, z), q_m)
        out[ORIENTATION:POSE_COVARIANCE] = (*q[1:], q[0])
        _turn_twist(out, mounting.T)
        p = out[POSE_COVARIANCE:LINEAR].reshape(6, 6)
        if sigma is not None and p[5, 5] > 0.0:  # the correlations are kept, so that it stays a covariance
            ratio = sigma / math.sqrt(p[5, 5])
            p[5] *= ratio
            p[:, 5] *= ratio


def flatten(out: np.ndarray) -> None:
    """Set height, roll, pitch and their rates in an odometry (85,) to zero, their variances to FLAT_VARIANCE, in place.
    """
    x, y, z, w = out[ORIENTATION:POSE_COVARIANCE].tolist()
    yaw = yaw_of_quaternion(x, y, z, w)
    level = rotation_from_rpy(0.0, 0.0, -yaw) @ np.array(matrix((w, x, y, z))).reshape(3, 3)
    _turn_twist(out, level)
    out[POSITION + 2] = out[LINEAR + 2] = out[ANGULAR] = out[ANGULAR + 1] = 0.0
    out[ORIENTATION:POSE_COVARIANCE] = (0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
    for first, last in ((POSE_COVARIANCE, LINEAR), (TWIST_COVARIANCE, SIZE)):
        p = out[first:last].reshape(6, 6)
        p[2:5] = p[:, 2:5] = 0.0
        p[[2, 3, 4], [2, 3, 4]] = FLAT_VARIANCE


def _turn_twist(out: np.ndarray, turn: np.ndarray) -> None:
    """Rotate the twist of an odometry (85,) and its covariance by `turn` (3, 3), in place."""
    out[LINEAR:ANGULAR] = turn @ out[LINEAR:ANGULAR]
    out[ANGULAR:TWIST_COVARIANCE] = turn @ out[ANGULAR:TWIST_COVARIANCE]
    both, p = np.kron(np.eye(2), turn), out[TWIST_COVARIANCE:SIZE].reshape(6, 6)
    p[:] = both @ p @ both.T


def _inverse(q):
    return q[0], -q[1], -q[2], -q[3]


def _rotate(c, v):
    return (c[0] * v[0] + c[1] * v[1] + c[2] * v[2], c[3] * v[0] + c[4] * v[1] + c[5] * v[2],
            c[6] * v[0] + c[7] * v[1] + c[8] * v[2])


class Output:
    """The messages of a node, created once and refilled: creating a new one takes ten times as long."""

    def __init__(self, estimate, frame_id: str, child_frame_id: str):
        self.odometry = Odometry(child_frame_id=child_frame_id)
        self.odometry.header.frame_id = frame_id
        self.fix = NavSatFix(position_covariance_type=NavSatFix.COVARIANCE_TYPE_KNOWN)
        self.fix.header.frame_id = child_frame_id
        self.fix.status.status = NavSatStatus.STATUS_FIX
        self.fix.status.service = NavSatStatus.SERVICE_GPS
        self._stamps = [self.odometry.header.stamp, self.fix.header.stamp]
        self._positions = [self.odometry.pose.pose.position]
        self._orientations = [self.odometry.pose.pose.orientation]
        self._linear = self.odometry.twist.twist.linear
        self._angular = self.odometry.twist.twist.angular
        # views: the estimate's arrays on the one side, the messages' on the other
        state = estimate.odometry
        self._pose, self._twist = state[POSITION:POSE_COVARIANCE], state[LINEAR:TWIST_COVARIANCE]
        self._geodetic = estimate.geodetic
        self._covariances = [(self.odometry.pose.covariance, state[POSE_COVARIANCE:LINEAR]),
                             (self.odometry.twist.covariance, state[TWIST_COVARIANCE:SIZE]),
                             (self.fix.position_covariance, estimate.position_covariance_enu)]

    def add_transform(self):
        """Returns a tf2_msgs/TFMessage that is filled from now on as well. Raises ParameterError where tf2_msgs is not
        installed."""
        transform = TransformStamped(child_frame_id=self.odometry.child_frame_id)
        transform.header.frame_id = self.odometry.header.frame_id
        self._stamps.append(transform.header.stamp)
        self._positions.append(transform.transform.translation)
        self._orientations.append(transform.transform.rotation)
        return tf_message()(transforms=[transform])

    def fill(self, stamp: int) -> None:
        """Take over the newest estimate, of time `stamp` (ns)."""
        seconds, nanoseconds = divmod(stamp, SECOND)
        for target in self._stamps:
            target.sec, target.nanosec = seconds, nanoseconds
        east, north, up, x, y, z, w = self._pose.tolist()
        for target in self._positions:
            target.x, target.y, target.z = east, north, up
        for target in self._orientations:
            target.x, target.y, target.z, target.w = x, y, z, w
        linear, angular = self._linear, self._angular
        linear.x, linear.y, linear.z, angular.x, angular.y, angular.z = self._twist.tolist()
        latitude, longitude, self.fix.altitude = self._geodetic.tolist()
        self.fix.latitude = math.degrees(latitude)
        self.fix.longitude = math.degrees(math.remainder(longitude, 2 * math.pi))  # the filter's is not wrapped
        for target, source in self._covariances:
            target[:] = source


class MapOutput:
    """The messages of the map frame: pose of the smooth frame in the map, and pose of the vehicle, created once."""

    def __init__(self, estimate, smooth: SmoothFrame, map_frame_id: str, frame_id: str):
        self._smooth = smooth
        self.pose = PoseWithCovarianceStamped()
        self.pose.header.frame_id = map_frame_id
        self._state = estimate.odometry
        self._transform = TransformStamped(child_frame_id=frame_id)
        self._transform.header.frame_id = map_frame_id
        self._stamps = [self.pose.header.stamp, self._transform.header.stamp]

    def transform(self):
        """The tf2_msgs/TFMessage that is filled from now on."""
        return tf_message()(transforms=[self._transform])

    def fill(self, stamp: int) -> None:
        """Take over the newest estimate, of time `stamp` (ns)."""
        seconds, nanoseconds = divmod(stamp, SECOND)
        for target in self._stamps:
            target.sec, target.nanosec = seconds, nanoseconds
        pose, transform = self.pose.pose.pose, self._transform.transform
        for (x, y, z, *q), position, orientation in (
                (self._state[POSITION:POSE_COVARIANCE].tolist(), pose.position, pose.orientation),
                (self._smooth.frame, transform.translation, transform.rotation)):
            position.x, position.y, position.z = x, y, z
            orientation.x, orientation.y, orientation.z, orientation.w = q
        self.pose.pose.covariance[:] = self._state[POSE_COVARIANCE:LINEAR]
