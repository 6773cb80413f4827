"""Start pose and geographic services: east-north-up at the datum to latitude and longitude and back."""
from __future__ import annotations

import math
import sys
import types
from types import SimpleNamespace

import numpy as np
import pytest
import ros_support  # noqa: F401  a ROS domain for the tests
from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
from sensor_msgs.msg import Imu

from mems_ins_fusion.filter.measurements.registry import AIDING
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.nodes.geographic import geographic_services, start_from_parameters, start_from_pose
from mems_ins_fusion.nodes.inputs import sample_of

DATUM = np.array([0.84, 0.2, 480.0])


def pose(x=30.0, y=40.0, yaw=0.5, frame='map', variances=(1.0, 4.0, 0.0, 0.0, 0.0, 0.09)):
    message = PoseWithCovarianceStamped()
    message.header.frame_id = frame
    message.pose.pose.position.x, message.pose.pose.position.y = x, y
    message.pose.pose.orientation.z, message.pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    message.pose.covariance = np.diag(variances).ravel()
    return message


def test_a_start_pose_is_a_place_on_earth_with_a_heading_from_north():
    message = pose()
    message.pose.covariance[1] = message.pose.covariance[6] = 0.5
    latitude, longitude, height, yaw, covariance = start_from_pose(message, DATUM, 'map')
    assert to_local(latitude, longitude, height, DATUM) == pytest.approx((40.0, 30.0, 0.0), abs=1e-6)
    assert yaw == pytest.approx(math.pi / 2 - 0.5)
    # north is y, a yaw from north turns the other way, and RViz's zero for the height is no knowledge
    assert np.diag(covariance) == pytest.approx([4.0, 1.0, 100.0, 0.09])
    assert covariance[0, 1] == covariance[1, 0] == 0.5


@pytest.mark.parametrize('message, datum, said', [
    (pose(frame='base_link'), DATUM, "header.frame_id 'base_link' is not 'map'"),
    (pose(), None, 'there is no datum yet'),
    (pose(x=math.nan), DATUM, 'not finite'),
    (pose(variances=[0.0] * 6), DATUM, 'covariance of x, y, yaw must be above 0'),
])
def test_a_start_pose_that_cannot_be_used_says_why(message, datum, said):
    with pytest.raises(ValueError, match=said):
        start_from_pose(message, datum, 'map')


def test_a_start_pose_of_the_parameters_is_in_degrees():
    latitude, longitude, height, yaw, covariance = start_from_parameters(
        {'start_pose': [48.0, 11.0, 500.0, 1.5], 'start_pose_sigma': [3.0, 0.1]})
    assert (math.degrees(latitude), math.degrees(longitude), height, yaw) == pytest.approx((48.0, 11.0, 500.0, 1.5))
    assert np.diag(covariance) == pytest.approx([9.0, 9.0, 9.0, 0.01])


class Services:
    """A node that remembers its services, and what it has logged as an error."""

    def __init__(self):
        self.callbacks, self.errors = {}, []

    def get_logger(self):
        return SimpleNamespace(error=self.errors.append)

    def create_service(self, kind, name, callback):
        self.callbacks[name] = callback


def empty():
    return SimpleNamespace(map_point=SimpleNamespace(), ll_point=SimpleNamespace())


def test_latitude_and_longitude_to_the_local_frame_and_back_where_the_interfaces_are_installed(monkeypatch):
    node, fusion = Services(), SimpleNamespace(datum=None)
    monkeypatch.setitem(sys.modules, 'robot_localization', None)
    assert geographic_services(node, fusion, None) is None and not node.callbacks
    interfaces = types.ModuleType('robot_localization.srv')
    interfaces.FromLL = interfaces.ToLL = interfaces.SetDatum = object
    monkeypatch.setitem(sys.modules, 'robot_localization', types.ModuleType('robot_localization'))
    monkeypatch.setitem(sys.modules, 'robot_localization.srv', interfaces)
    geographic_services(node, fusion, lambda *place: setattr(fusion, 'datum', np.array(place)))
    there = SimpleNamespace(ll_point=SimpleNamespace(latitude=48.001, longitude=11.002, altitude=510.0))
    assert math.isnan(node.callbacks['fromLL'](there, empty()).map_point.x)
    # when the datum is set
    place = SimpleNamespace(position=SimpleNamespace(latitude=48.0, longitude=11.0, altitude=500.0))
    node.callbacks['datum'](SimpleNamespace(geo_pose=place), None)
    point = node.callbacks['fromLL'](there, empty()).map_point
    north, east, down = to_local(math.radians(48.001), math.radians(11.002), 510.0, fusion.datum)
    assert (point.x, point.y, point.z) == (east, north, -down)
    back = node.callbacks['toLL'](SimpleNamespace(map_point=point), empty()).ll_point
    assert (back.latitude, back.longitude, back.altitude) == pytest.approx((48.001, 11.002, 510.0), abs=1e-9)
    # and one that is no place, by the limits of the parameter, changes nothing and is told
    before = fusion.datum
    for field, value in (('latitude', 95.0), ('longitude', math.nan), ('altitude', 1e6)):
        wrong = SimpleNamespace(position=SimpleNamespace(**{**vars(place.position), field: value}))
        node.callbacks['datum'](SimpleNamespace(geo_pose=wrong), None)
        assert fusion.datum is before and "parameter 'datum' must" in node.errors.pop() and not node.errors


def test_speed_velocity_and_heading_become_the_filters():
    twist = TwistWithCovarianceStamped()
    twist.twist.twist.linear.x, twist.twist.twist.linear.y, twist.twist.twist.linear.z = 3.0, 4.0, 0.5
    p = np.arange(36.0).reshape(6, 6)
    twist.twist.covariance = (p + p.T).ravel()
    named = {measurement.name: measurement for measurement in AIDING}
    speed, velocity, heading = (named[name] for name in ('speed', 'velocity', 'heading'))
    assert sample_of(speed, [twist])[1] == (3.0, 0.0)
    twist.twist.twist.angular.z = 0.2
    forward_right_clockwise, variance = sample_of(named['twist'], [twist])[1]
    assert forward_right_clockwise.tolist() == [3.0, -4.0, -0.2]
    assert variance.tolist() == [(p + p.T)[i, i] for i in (0, 1, 5)]
    velocity, covariance = sample_of(velocity, [twist])[1]
    assert velocity.tolist() == [4.0, 3.0, -0.5]
    signed = np.diag([1.0, 1.0, -1.0]) @ (p + p.T)[np.ix_([1, 0, 2], [1, 0, 2])] @ np.diag([1.0, 1.0, -1.0])
    assert covariance == pytest.approx(signed)
    assert sample_of(heading, [pose(yaw=0.5)])[1] == pytest.approx((math.pi / 2 - 0.5, 0.09))
    imu = Imu()
    imu.orientation.z, imu.orientation.w = math.sin(-0.6), math.cos(-0.6)
    imu.orientation_covariance[8] = 0.02
    assert sample_of(heading, [imu])[1] == pytest.approx((math.pi / 2 + 1.2, 0.02))
    imu.orientation_covariance[0] = -1.0  # the driver has none
    assert math.isnan(sample_of(heading, [imu])[1][0])
