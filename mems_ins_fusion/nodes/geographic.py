"""Start pose and datum, and the services that turn latitude and longitude into points of the local frame, and back."""
from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import Point
from rclpy.node import Node

from ..errors import InputError
from ..navigation.earth import from_local, to_local
from ..navigation.frames import yaw_from_enu, yaw_of_quaternion
from ..parameters.parameter import ParameterError
from ..parameters.table import ALL

#: m^2, variance of the height of a start pose that has none: the first fix gives a better height
_HEIGHT_VARIANCE = 100.0


def world_frame(values: dict) -> str:
    """Name of the frame that is east-north-up at the datum, from the node's parameters `values`."""
    return values['map_frame_id' if values['frames'] == 'map_odom' else 'frame_id']


def start_from_parameters(values: dict) -> tuple:
    """Arguments of the filter's `set_start` from the parameters start_pose and start_pose_sigma."""
    latitude, longitude, height, yaw = values['start_pose']
    position, heading = values['start_pose_sigma']
    return (math.radians(latitude), math.radians(longitude), height, yaw,
            np.diag([position**2, position**2, position**2, heading**2]))


def start_from_pose(message, datum, frame_id: str) -> tuple:
    """Arguments of `set_start` from a PoseWithCovarianceStamped in the frame east-north-up at `datum` (rad, rad, m).

    Raises InputError if the message is not usable.
    """
    frame = message.header.frame_id
    if frame != frame_id:
        raise InputError(f"header.frame_id '{frame}' is not '{frame_id}'")
    if datum is None:
        raise InputError("there is no datum yet: set the parameter 'datum', or wait for the first fix")
    position, q = message.pose.pose.position, message.pose.pose.orientation
    covariance = np.reshape(message.pose.covariance, (6, 6))[np.ix_([1, 0, 2, 5], [1, 0, 2, 5])]
    sign = np.diag([1.0, 1.0, -1.0, -1.0])
    numbers = np.array([position.x, position.y, position.z, q.x, q.y, q.z, q.w, *covariance.ravel()])
    if not np.isfinite(numbers).all() or not any((q.x, q.y, q.z, q.w)):
        raise InputError('pose or covariance is not finite, or its orientation is all zeros')
    if min(covariance[0, 0], covariance[1, 1], covariance[3, 3]) <= 0.0:
        raise InputError(f'covariance of x, y, yaw must be above 0, got {covariance[1, 1]:g}, {covariance[0, 0]:g}, '
                         f'{covariance[3, 3]:g}')
    if np.linalg.eigvalsh(covariance[np.ix_([0, 1, 3], [0, 1, 3])]).min() <= 0.0:
        raise InputError('covariance of x, y, yaw is not positive definite')
    # a two-dimensional tool gives no height
    covariance[2, 2] = covariance[2, 2] if covariance[2, 2] > 0.0 else _HEIGHT_VARIANCE
    place = from_local(position.y, position.x, -position.z, datum)
    yaw = float(yaw_from_enu(yaw_of_quaternion(q.x, q.y, q.z, q.w)))
    return (*place, yaw, sign @ covariance @ sign)


def to_local_point(message, datum) -> Point:
    """The position of a NavSatFix or GeoPoint in the frame east-north-up at `datum` (rad, rad, m)."""
    north, east, down = to_local(math.radians(message.latitude), math.radians(message.longitude), message.altitude,
                                 datum)
    return Point(x=float(east), y=float(north), z=float(-down))


class GeographicServices:
    """fromLL, toLL and datum as robot_localization's navsat_transform_node has them, for Nav2 and mapviz."""

    def __init__(self, node: Node, fusion, set_datum):
        from robot_localization.srv import FromLL, SetDatum, ToLL

        self._node, self._fusion, self._set_datum = node, fusion, set_datum
        node.create_service(FromLL, 'fromLL', self.from_ll)
        node.create_service(ToLL, 'toLL', self.to_ll)
        node.create_service(SetDatum, 'datum', self.datum)

    def from_ll(self, request, response):
        """Latitude, longitude (deg) and altitude to a point in the local frame; NaN while there is no datum."""
        datum = self._fusion.datum
        response.map_point = Point(x=math.nan, y=math.nan, z=math.nan) if datum is None else \
            to_local_point(request.ll_point, datum)
        return response

    def to_ll(self, request, response):
        """A point in the local frame to latitude, longitude (deg) and altitude; NaN while there is no datum."""
        point, place = request.map_point, response.ll_point
        place.latitude = place.longitude = place.altitude = math.nan
        if self._fusion.datum is not None:
            latitude, longitude, height = from_local(point.y, point.x, -point.z, self._fusion.datum)
            place.latitude, place.longitude = math.degrees(latitude), math.degrees(longitude)
            place.altitude = float(height)
        return response

    def datum(self, request, response):
        """The local frame's origin from now on, within the limits of the parameter; one beyond them is logged."""
        place = request.geo_pose.position
        try:
            latitude, longitude, height = ALL['datum'].check([place.latitude, place.longitude, place.altitude])
        except ParameterError as error:  # the service has no field for it
            self._node.get_logger().error(f'service datum: the origin stays where it is: {error}')
            return response
        self._set_datum(math.radians(latitude), math.radians(longitude), height)
        return response


def geographic_services(node: Node, fusion, set_datum) -> GeographicServices | None:
    """The services where robot_localization and geographic_msgs are installed; None elsewhere."""
    try:
        return GeographicServices(node, fusion, set_datum)
    except ImportError:
        return None
