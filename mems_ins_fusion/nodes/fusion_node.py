"""fusion_node: IMU and GNSS live in, odometry out.

Subscribes sensor_msgs/Imu and sensor_msgs/NavSatFix, publishes nav_msgs/Odometry and the fused position as
sensor_msgs/NavSatFix. All computation is in `filter.fusion`; here messages become numbers and numbers messages.
"""
from __future__ import annotations

import math

from nav_msgs.msg import Odometry
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Imu, NavSatFix, NavSatStatus, Temperature

from ..filter.fusion import FilterConfig, FusionFilter
from ..filter.odometry import LINEAR, POSE_COVARIANCE, POSITION, SIZE, TWIST_COVARIANCE
from ..parameters.parameter import ParameterError
from ..parameters.table import ALL, FILTER, FUSION
from ..recordings.units import ACCELERATION, RATE
from .log import Throttle, Watch
from .ros_parameters import declare, refuse_unused_qos_overrides
from .run import Stop, run, spin

NAME = 'fusion_node'
_SECOND = 10**9  # ns


class FusionNode(Node):
    """The live filter as a node; `argv` names its params files. Raises ParameterError for wrong parameters."""

    def __init__(self, argv: list[str]):
        super().__init__(NAME)
        values = declare(self, argv, (*FILTER, *FUSION), changeable=frozenset({'odometry_rate'}))
        self._filter = FusionFilter(FilterConfig.from_parameters(values))
        self.get_logger().info('loading the filter (the first start on a machine compiles it: up to a minute)')
        self._filter.warm_up()  # before there is a subscription: no message waits for the compiler
        self._force_unit = ACCELERATION[values['imu.acceleration_unit']]
        self._rate_unit = RATE[values['imu.rate_unit']]
        self._use_orientation = values['alignment.heading'] == 'orientation'
        self._set_rate(values['odometry_rate'])
        self._last_slot = None
        self._output = Output(self._filter, values['frame_id'], values['child_frame_id'])
        self._imu_watch = Watch(patience=3.0)
        self._fix_watch = Watch(patience=2 * values['gnss.outage_after'])
        self._throttle = Throttle(5.0)
        self._publish(values)
        self._subscribe(values)
        refuse_unused_qos_overrides(self)
        self.add_on_set_parameters_callback(_check_changes)
        self.add_post_set_parameters_callback(self._apply_changes)
        # timers of the ROS clock stand still while use_sim_time waits for a /clock
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.2, self.report, clock=steady)
        self.create_timer(1.0, self._check_topics, clock=steady)
        self._ready = (f"ready: {self._imu.topic_name} and {self._fix.topic_name} -> "
                       f"{self._odometry_publisher.topic_name} "
                       f"({values['mechanization']}, {values['sensor_error_model']})")

    def serve(self, stop: Stop) -> None:
        """Work until `stop` is requested."""
        self.get_logger().info(self._ready)
        spin(self, stop)

    def _publish(self, values):
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        # events: the executor would ask after each of them at each sample; the other side reports them, too
        options = {'qos_overriding_options': QoSOverridingOptions.with_default_policies(),
                   'event_callbacks': PublisherEventCallbacks(use_default_callbacks=False)}
        self._odometry_publisher = self.create_publisher(Odometry, values['odometry_topic'], qos, **options)
        self._fix_publisher = self.create_publisher(NavSatFix, values['fix_topic'], qos, **options)
        self._send = [(self._odometry_publisher.publish, self._output.odometry),
                      (self._fix_publisher.publish, self._output.fix)]
        if values['publish_tf']:
            transform = self._output.add_transform()
            publisher = self.create_publisher(type(transform), '/tf', QoSProfile(depth=100))
            self._send.append((publisher.publish, transform))

    def _subscribe(self, values):
        def subscribe(kind, topic, callback, depth):
            # best effort also hears reliable drivers; a reliable subscription would not hear best-effort ones.
            # Depth 200 bridges a stall of half a second at 400 Hz
            qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
            return self.create_subscription(
                kind, topic, callback, qos, event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
                qos_overriding_options=QoSOverridingOptions.with_default_policies())

        # where both wait, the executor serves the one created first: a fix before the samples that came after it
        self._fix = subscribe(NavSatFix, values['gnss_topic'], self._on_fix, 10)
        self._imu = subscribe(Imu, values['imu_topic'], self._on_imu, 200)
        if values['temperature_topic']:
            self._temperature = subscribe(Temperature, values['temperature_topic'], self._on_temperature, 10)

    def _on_imu(self, message):
        """The hot path: no formatting, no new message, no look-up of a parameter."""
        self._imu_watch.count += 1
        stamp = message.header.stamp
        force, force_unit = message.linear_acceleration, self._force_unit
        rate, rate_unit = message.angular_velocity, self._rate_unit
        x = y = z = w = 0.0
        if self._use_orientation and message.orientation_covariance[0] != -1.0:  # -1: the driver has none (REP 145)
            orientation = message.orientation
            x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
        now = stamp.sec * _SECOND + stamp.nanosec
        if not self._filter.add_imu(now, force.x * force_unit, force.y * force_unit, force.z * force_unit,
                                    rate.x * rate_unit, rate.y * rate_unit, rate.z * rate_unit, x, y, z, w):
            self.report()  # why there is no estimate
            return
        if self._period:
            # one message in each slot of a period, however the stamps jitter
            slot = now // self._period
            if slot == self._last_slot:
                return
            self._last_slot = slot
        self._output.fill(self._filter.update_odometry())
        for publish, output in self._send:
            publish(output)

    def _on_fix(self, message):
        self._fix_watch.count += 1
        stamp = message.header.stamp
        self._filter.add_fix(stamp.sec * _SECOND + stamp.nanosec, math.radians(message.latitude),
                             math.radians(message.longitude), message.altitude, message.position_covariance,
                             message.status.status, message.position_covariance_type)
        self.report()

    def _on_temperature(self, message):
        stamp = message.header.stamp
        self._filter.add_temperature(stamp.sec * _SECOND + stamp.nanosec, message.temperature)

    def report(self):
        """Log what the filter has to say since the last time; complaints that repeat only for who debugs."""
        for notice in self._filter.notices():
            logger = self.get_logger()
            if notice.level == 'info':
                logger.info(notice.text)
            elif (text := self._throttle.pass_on(notice.text)) is None:
                logger.debug(notice.text)
            elif notice.level == 'error':
                logger.error(text)
            else:
                logger.warning(text)

    def _check_topics(self):
        for watch, subscription, kind in ((self._imu_watch, self._imu, 'sensor_msgs/msg/Imu'),
                                          (self._fix_watch, self._fix, 'sensor_msgs/msg/NavSatFix')):
            found = watch.check()
            if found is None:
                continue
            silent, seconds = found
            if silent:
                self.get_logger().warning(f'no message on {subscription.topic_name} ({kind}) for {seconds:.0f} s: '
                                          f'{self._why_silent(subscription.topic_name, kind)}')
            else:
                self.get_logger().info(f'messages on {subscription.topic_name} again after {seconds:.0f} s')

    def _why_silent(self, topic, kind):
        topics = dict(self.get_topic_names_and_types())
        publishers = {info.topic_type for info in self.get_publishers_info_by_topic(topic)}
        if kind in publishers:
            return 'it has a publisher, but nothing arrives'
        reason = f"it carries {', '.join(sorted(publishers))}" if publishers else 'nobody publishes it'
        same = sorted(name for name, kinds in topics.items()
                      if kind in kinds and self.count_publishers(name) and name not in self._own_topics())
        return f"{reason}; topics of this type: {', '.join(same) or 'none'}"

    def _own_topics(self):
        return self._odometry_publisher.topic_name, self._fix_publisher.topic_name

    def _apply_changes(self, changed):
        for parameter in changed:
            if parameter.name == 'odometry_rate':
                self._set_rate(parameter.value)

    def _set_rate(self, rate):
        self._period = round(_SECOND / rate) if rate else 0


class Output:
    """The messages a node publishes, each made once and refilled: a fresh one costs ten times as much."""

    def __init__(self, fusion: FusionFilter, frame_id: str, child_frame_id: str):
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
        # views: the filter's arrays on the one side, the messages' on the other
        state = fusion.odometry
        self._pose, self._twist = state[POSITION:POSE_COVARIANCE], state[LINEAR:TWIST_COVARIANCE]
        self._geodetic = fusion.geodetic
        self._covariances = [(self.odometry.pose.covariance, state[POSE_COVARIANCE:LINEAR]),
                             (self.odometry.twist.covariance, state[TWIST_COVARIANCE:SIZE]),
                             (self.fix.position_covariance, fusion.position_covariance_enu)]

    def add_transform(self):
        """A tf2_msgs/TFMessage that is filled from now on, too; ParameterError where tf2_msgs is not installed."""
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            raise ParameterError("parameter 'publish_tf' needs the ROS package tf2_msgs, which is not installed") \
                from None
        from geometry_msgs.msg import TransformStamped

        transform = TransformStamped(child_frame_id=self.odometry.child_frame_id)
        transform.header.frame_id = self.odometry.header.frame_id
        self._stamps.append(transform.header.stamp)
        self._positions.append(transform.transform.translation)
        self._orientations.append(transform.transform.rotation)
        return TFMessage(transforms=[transform])

    def fill(self, stamp: int) -> None:
        """Take over the filter's newest estimate, of time `stamp` (ns), as `update_odometry` left it."""
        seconds, nanoseconds = divmod(stamp, _SECOND)
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
        self.fix.latitude, self.fix.longitude = math.degrees(latitude), math.degrees(longitude)
        for target, source in self._covariances:
            target[:] = source


def _check_changes(changed):
    try:
        for parameter in changed:
            if parameter.name in ALL:
                ALL[parameter.name].check(parameter.value)
    except ParameterError as error:
        return SetParametersResult(successful=False, reason=str(error))
    return SetParametersResult(successful=True)


def main(argv: list[str]) -> int:
    """Run the node until SIGINT or SIGTERM; the exit status."""
    return run(NAME, FusionNode, argv, FusionNode.serve)
