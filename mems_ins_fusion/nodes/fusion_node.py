"""fusion_node: IMU and GNSS live in, odometry out.

Subscribes sensor_msgs/Imu and sensor_msgs/NavSatFix, publishes nav_msgs/Odometry and the fused position as
sensor_msgs/NavSatFix. All computation is in the filter; here messages become numbers and numbers messages.
"""
from __future__ import annotations

import math
from collections import deque

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Imu, NavSatFix, Temperature
from std_srvs.srv import SetBool, Trigger

from ..compiled import tell
from ..filter.config import FilterConfig
from ..filter.live import CHANGEABLE, FusionFilter
from ..parameters.parameter import ParameterError
from ..parameters.table import ALL, FILTER, FUSION
from ..recordings.units import ACCELERATION, RATE
from .checks import check_together
from .inputs import aiding_inputs, subscribe
from .loading import load
from .log import StateLog, Throttle, Watch
from .mounting import mounting_from_tf
from .mounting_check import MountingCheck
from .output import MapOutput, Output, Prediction, SmoothFrame, tf_message
from .places import geographic_services, start_from_parameters, start_from_pose
from .ros_parameters import declare, refuse_unused_qos_overrides
from .run import Stop, run, spin
from .state_file import StateFile
from .status import BEFORE_START, GOOD_STATES, diagnostics, verdict

NAME = 'fusion_node'
_SECOND = 10**9  # ns
_TF_QOS = QoSProfile(depth=100)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: a state file is written this often, s
_SAVE_PERIOD = 10.0
#: fixes of which /diagnostics gives the mean NIS
_NIS_COUNT = 100


class FusionNode(Node):
    """The live filter as a node; `argv` names its params files. Raises ParameterError for wrong parameters."""

    def __init__(self, argv: list[str], stop: Stop):
        super().__init__(NAME)
        changeable = frozenset({*CHANGEABLE, 'odometry_rate'})
        self._values = values = declare(self, argv, (*FILTER, *FUSION), changeable=changeable)
        check_together(values, self.resolve_topic_name)
        if values['publish_tf']:
            tf_message()  # what is missing is said before anything takes time
        self._state_file = self._open_state_file(values)
        if values['mounting_from_tf']:
            values['imu.mounting_rpy'] = mounting_from_tf(self, values['imu_topic'], values['child_frame_id'],
                                                            stop)
        self._filter = FusionFilter(FilterConfig.from_parameters(values))
        tell(self.get_logger().info)
        load(self._filter, stop)  # before there is a subscription: no message waits for the compiler
        self._force_unit = ACCELERATION[values['imu.acceleration_unit']]
        self._rate_unit = RATE[values['imu.rate_unit']]
        self._mounting = MountingCheck(values['imu.mounting_rpy'], values['gnss.time_offset'],
                                       values['imu.max_specific_force'], values['imu.max_angular_rate'])
        self._use_orientation = values['alignment.heading'] == 'orientation'
        self._start = start_from_parameters(values) if values['start_pose'] else None
        self._datum = None
        self._urgent: set = set()
        self._set_rate(values['odometry_rate'])
        self._last_slot = None
        self._throttle = Throttle(5.0)
        self._state_log = StateLog()
        self._nis: deque[float] = deque(maxlen=_NIS_COUNT)
        self._publish(values)
        self._subscribe(values)
        self._serve()
        refuse_unused_qos_overrides(self)
        self.add_on_set_parameters_callback(self._check_changes)
        self.add_post_set_parameters_callback(self._apply_changes)
        # timers of the ROS clock stand still while use_sim_time waits for a /clock
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._urgent |= {self._imu, self._fix, self.create_timer(0.2, self.report, clock=steady)}
        self.create_timer(1.0, self._each_second, clock=steady)
        if self._state_file:
            self.create_timer(_SAVE_PERIOD, self._save, clock=steady)
        self._ready = (f"ready: {self._imu.topic_name} and {self._fix.topic_name} -> "
                       f"{self._odometry_publisher.topic_name} "
                       f"({values['mechanization']}, {values['sensor_error_model']})")

    def serve(self, stop: Stop) -> None:
        """Work until `stop` is requested."""
        self.get_logger().info(self._ready)
        spin(self, stop, urgent=self._urgent)
        if self._state_file:
            self._save()

    # --- what goes out ---

    def _publish(self, values):
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        # events: the executor would ask after each of them at each sample; the other side reports them, too
        options = {'qos_overriding_options': QoSOverridingOptions.with_default_policies(),
                   'event_callbacks': PublisherEventCallbacks(use_default_callbacks=False)}
        estimate = self._filter
        self._smooth = SmoothFrame(estimate) if values['frames'] == 'map_odom' else None
        estimate = self._smooth or estimate
        self._prediction = Prediction(estimate) if values['predict_to_now'] else None
        output = Output(self._prediction or estimate, values['frame_id'], values['child_frame_id'])
        self._odometry_publisher = self.create_publisher(Odometry, values['odometry_topic'], qos, **options)
        self._fix_publisher = self.create_publisher(NavSatFix, values['fix_topic'], qos, **options)
        self._fill = [output.fill]
        self._send = [(self._odometry_publisher.publish, output.odometry), (self._fix_publisher.publish, output.fix)]
        transforms = [output.add_transform()] if values['publish_tf'] else []
        if self._smooth:
            in_map = MapOutput(self._filter, self._smooth, values['map_frame_id'], values['frame_id'])
            publisher = self.create_publisher(PoseWithCovarianceStamped, values['pose_topic'], qos, **options)
            self._fill.append(in_map.fill)
            self._send.append((publisher.publish, in_map.pose))
            transforms += [in_map.transform()] if values['publish_tf'] else []
        if transforms:
            publisher = self.create_publisher(type(transforms[0]), '/tf', _TF_QOS)
            self._send += [(publisher.publish, transform) for transform in transforms]
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._verdicts = self.create_publisher(DiagnosticArray, '~/verdicts', 50)
        self._datum_publisher = self.create_publisher(NavSatFix, '~/datum', _LATCHED)

    def _send_estimate(self, stamp):
        for fill in self._fill:
            fill(stamp)
        for publish, output in self._send:
            publish(output)

    def _send_prediction(self):
        """The newest estimate, predicted to now: by the clock, whenever samples come."""
        if self._newest is None:
            return
        now = self.get_clock().now().nanoseconds
        ahead = (now - self._newest) * 1e-9
        if not 0.0 <= ahead <= self._values['imu.max_gap']:
            self._warn(f'{self._imu.topic_name}: the newest sample is stamped {ahead:.3f} s before now, not 0 to '
                       f"{self._values['imu.max_gap']:g} s (imu.max_gap): nothing is published")
            return
        self._prediction.advance(ahead)
        self._send_estimate(now)

    # --- what comes in ---

    def _subscribe(self, values):
        self._newest = None
        self._imu_watch = Watch(patience=3.0)
        self._fix_watch = Watch(patience=2 * values['gnss.outage_after'])
        # where both wait, the executor serves the one created first: a fix before the samples that came after it.
        # Depth 200 bridges a stall of half a second at 400 Hz
        self._fix = subscribe(self, NavSatFix, values['gnss_topic'], self._on_fix, 10)
        self._imu = subscribe(self, Imu, values['imu_topic'], self._on_imu, 200)
        if values['temperature_topic']:
            subscribe(self, Temperature, values['temperature_topic'], self._on_temperature, 10)
        if values['initial_pose_topic']:
            self.create_subscription(PoseWithCovarianceStamped, values['initial_pose_topic'], self._on_start_pose, 10)
        self._aiding = aiding_inputs(self, values, self._filter)
        self._watched = [(self._imu_watch, self._imu.topic_name, 'sensor_msgs/msg/Imu'),
                         (self._fix_watch, self._fix.topic_name, 'sensor_msgs/msg/NavSatFix'),
                         *((i.watch, i.topic_name, i.kind) for i in self._aiding)]

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
        sample = (now, force.x * force_unit, force.y * force_unit, force.z * force_unit,
                  rate.x * rate_unit, rate.y * rate_unit, rate.z * rate_unit)
        self._mounting.add_sample(sample)
        if not self._filter.add_imu(*sample, x, y, z, w):
            if self._filter.state in BEFORE_START:
                self._newest = None
                self._begin()
            self.report()  # why there is no estimate
            return
        if self._smooth or self._prediction:
            self._newest = self._filter.update_odometry()
            if self._smooth:
                self._smooth.advance(self._newest)
                if not self._filter.aligned:  # by as much as a heading that nobody knows is wrong nothing has drifted
                    self._smooth.settle()
            if self._prediction:  # published by the clock
                return
        if self._period:
            # one message in each slot of a period, however the stamps jitter
            slot = now // self._period
            if slot == self._last_slot:
                return
            self._last_slot = slot
        self._send_estimate(self._newest or self._filter.update_odometry())

    def _on_fix(self, message):
        self._fix_watch.count += 1
        stamp = message.header.stamp.sec * _SECOND + message.header.stamp.nanosec
        latitude, longitude = math.radians(message.latitude), math.radians(message.longitude)
        if self._state_file and message.status.status >= 0 and math.isfinite(latitude + longitude + message.altitude):
            self._resume(stamp, latitude, longitude, message.altitude)
        fix = (stamp, latitude, longitude, message.altitude, message.position_covariance, message.status.status,
               message.position_covariance_type)
        self._mounting.add_fix((*fix[:4], fix[4].copy(), *fix[5:]))
        self._filter.add_fix(*fix)
        self.report()

    def _on_temperature(self, message):
        stamp = message.header.stamp
        self._filter.add_temperature(stamp.sec * _SECOND + stamp.nanosec, message.temperature)

    # --- starts, stops and datum ---

    def _begin(self):
        """The start pose of the parameters, at the first sample."""
        if self._start is not None:
            start, self._start = self._start, None
            self.get_logger().info(f"starting from the parameter 'start_pose': {self._values['start_pose']}")
            self._filter.set_start(*start)

    def _on_start_pose(self, message):
        frame = self._values['map_frame_id' if self._smooth else 'frame_id']
        topic = self.resolve_topic_name(self._values['initial_pose_topic'])
        try:
            start = start_from_pose(message, self._filter.datum, frame)
        except ValueError as error:
            self.get_logger().warning(f'{topic}: {error}: start pose not used')
            return
        latitude, longitude, _, yaw, _ = start
        self.get_logger().info(f'{topic}: starting from latitude {math.degrees(latitude):.7f} deg, longitude '
                               f'{math.degrees(longitude):.7f} deg, heading {math.degrees(yaw) % 360:.1f} deg')
        self._filter.set_start(*start)

    def _open_state_file(self, values):
        if not values['state_file']:
            return None
        state_file = StateFile(values['state_file'], values['state_file_max_age'], values['state_file_max_distance'])
        said = state_file.read()
        if said:
            self.get_logger().warning(said)
        return state_file

    def _resume(self, stamp, latitude, longitude, height):
        found = self._state_file.fitting(stamp, latitude, longitude, height)
        if found is None:
            return
        snapshot, said = found
        if snapshot is None:
            self.get_logger().warning(said)
            return
        try:
            used = self._filter.restore(snapshot, self._values['state_file_max_distance'])
            self.get_logger().info(f'{said}: {used}')
        except ValueError as error:
            self.get_logger().warning(f'{error}: starting without')

    def _save(self):
        snapshot = self._filter.snapshot()
        if snapshot is not None:
            said = self._state_file.write(snapshot)
            if said:
                self._warn(said)

    def _serve(self):
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(SetBool, '~/use_fixes', self._on_use_fixes)
        geographic_services(self, self._filter, self._set_datum)

    def _on_reset(self, request, response):
        self._filter.reset()
        self.report()
        response.success, response.message = True, 'the filter aligns anew'
        return response

    def _on_use_fixes(self, request, response):
        self._filter.use_fixes(request.data)
        response.success = True
        response.message = f"fixes on {self._fix.topic_name} are {'used' if request.data else 'ignored'} from now on"
        self.get_logger().info(response.message)
        return response

    def _set_datum(self, latitude, longitude, height):
        self._filter.datum = np.array([latitude, longitude, height])
        self._tell_datum()

    def _tell_datum(self):
        """Publish and log the datum where it is new."""
        datum = self._filter.datum
        if datum is None or self._datum == tuple(datum):
            return
        self._datum = tuple(datum)
        latitude, longitude, height = math.degrees(datum[0]), math.degrees(datum[1]), float(datum[2])
        message = NavSatFix(latitude=latitude, longitude=longitude, altitude=height)
        message.header.frame_id = self._values['map_frame_id' if self._smooth else 'frame_id']
        message.header.stamp = self.get_clock().now().to_msg()
        self._datum_publisher.publish(message)
        self.get_logger().info(f'datum: latitude {latitude:.8f} deg, longitude {longitude:.8f} deg, height '
                               f'{height:.3f} m')

    # --- what is said ---

    def report(self):
        """Log what the filter has to say since the last time; complaints that repeat only for who debugs."""
        for notice in self._filter.notices():
            if notice.level == 'info':
                self._log('info', notice.text)
            else:
                self._warn(notice.text, notice.level)
        for judged in self._filter.verdicts():
            self._verdicts.publish(verdict(self.get_name(), judged))
            if judged.used and judged.kind == 'fix':
                self._nis.append(judged.nis)

    def _warn(self, line, level='warning'):
        text = self._throttle.pass_on(line)
        self._log('debug' if text is None else level, text or line)

    def _log(self, level, text):
        """rclpy wants a line of source of its own for each severity."""
        logger = self.get_logger()
        if level == 'debug':
            logger.debug(text)
        elif level == 'info':
            logger.info(text)
        elif level == 'warning':
            logger.warning(text)
        else:
            logger.error(text)

    def _each_second(self):
        for aiding in self._aiding:
            aiding.look()
        self._look_at_mounting()
        self._check_topics()
        self._tell_datum()
        state, health = self._filter.state, self._filter.health()
        since, said = self._state_log.look(state, self._filter.status)
        if said:
            self._log('info' if state in GOOD_STATES else 'warning', said)
        for watch, topic, _ in self._watched:
            health[f'messages on {topic}, Hz'] = watch.rate()
        if self._nis:
            health['mean NIS'] = sum(self._nis) / len(self._nis)
        now = self.get_clock().now().nanoseconds
        health['mounting'] = self._mounting.found
        wrong = self._mounting.found if self._mounting.is_wrong else ''
        self._diagnostics.publish(diagnostics(now, self.get_name(), state, since, health, wrong))

    def _look_at_mounting(self):
        found = self._mounting.look()
        if found:
            level, text = found
            self._log(level, f'{self._imu.topic_name}: {text}')

    def _check_topics(self):
        for watch, topic, kind in self._watched:
            found = watch.check()
            if found is None:
                continue
            silent, seconds = found
            if silent:
                self.get_logger().warning(f'no message on {topic} ({kind}) for {seconds:.0f} s: '
                                          f'{self._why_silent(topic, kind)}')
            else:
                self.get_logger().info(f'messages on {topic} again after {seconds:.0f} s')

    def _why_silent(self, topic, kind):
        wanted = set(kind.split(' or '))
        topics = dict(self.get_topic_names_and_types())
        publishers = {info.topic_type for info in self.get_publishers_info_by_topic(topic)}
        if wanted & publishers:
            return 'it has a publisher, but nothing arrives'
        reason = f"it carries {', '.join(sorted(publishers))}" if publishers else 'nobody publishes it'
        same = sorted(name for name, kinds in topics.items()
                      if wanted & set(kinds) and self.count_publishers(name) and name not in self._own_topics())
        return f"{reason}; topics of this type: {', '.join(same) or 'none'}"

    def _own_topics(self):
        return {publisher.topic_name for publisher in self.publishers}

    # --- parameters while running ---

    def _check_changes(self, changed):
        try:
            values = {p.name: ALL[p.name].check(p.value) for p in changed if p.name in ALL}
            if self._prediction and not values.get('odometry_rate', 1.0):
                raise ParameterError("parameter 'odometry_rate' must be above 0 with predict_to_now")
            self._filter.changed(values)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_changes(self, changed):
        values = {p.name: ALL[p.name].check(p.value) for p in changed if p.name in ALL}
        self._values.update(values)
        if 'odometry_rate' in values:
            self._set_rate(values['odometry_rate'])
        self._filter.adopt(self._filter.changed(values))
        if values:
            self.get_logger().info(', '.join(f'{name}: {value}' for name, value in values.items()) + ' from now on')

    def _set_rate(self, rate):
        self._period = round(_SECOND / rate) if rate else 0
        if self._values['predict_to_now']:
            self._clock_timer = self._replaced_timer(1.0 / rate)

    def _replaced_timer(self, period):
        old = getattr(self, '_clock_timer', None)
        if old is not None:
            self._urgent.discard(old)
            self.destroy_timer(old)
        timer = self.create_timer(period, self._send_prediction)
        self._urgent.add(timer)
        return timer


def main(argv: list[str]) -> int:
    """Run the node until SIGINT or SIGTERM; the exit status."""
    return run(NAME, FusionNode, argv, FusionNode.serve, (FILTER, FUSION))
