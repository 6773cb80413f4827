"""fusion_node: IMU and GNSS live in, odometry out.

Subscribes sensor_msgs/Imu and sensor_msgs/NavSatFix, publishes nav_msgs/Odometry and the fused position as
sensor_msgs/NavSatFix. All computation is in the filter; here messages become numbers and numbers messages.
"""
from __future__ import annotations

import math
import time
from collections import deque

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseWithCovarianceStamped
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
from ..filter.runs.live import CHANGEABLE, FusionFilter
from ..filter.runs.tally import Tally
from ..parameters.parameter import ParameterError
from ..parameters.table import ALL, FILTER, FUSION
from ..recordings.units import ACCELERATION, RATE
from .aiding_check import AidingCheck
from .checks import check_together
from .inputs import Input, Queue, aiding_inputs, stamp_of
from .loading import load
from .log import StateLog, Throttle
from .mounting import mounting_from_tf
from .mounting_check import MountingCheck
from .output import MapOutput, Output, Prediction, SmoothFrame, VehicleAxes, flatten, tf_message
from .places import geographic_services, start_from_parameters, start_from_pose, to_local_point
from .preflight import Preflight
from .ros_parameters import declare, refuse_unused_qos_overrides
from .run import Stop, run, spin
from .state_file import StateFile
from .status import (
    BEFORE_START,
    ERROR,
    SILENT,
    WARN,
    InputStatus,
    array,
    by_the_clock,
    filter_status,
    level_of,
    verdict,
)

NAME = 'fusion_node'
_SECOND = 10**9  # ns
_TF_QOS = QoSProfile(depth=100)
_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: a state file is written this often, s
_SAVE_PERIOD = 10.0
#: fixes of which /diagnostics gives the mean NIS
_NIS_COUNT = 100
#: of the IMU's queue: a stall of 2.5 s at 400 Hz
_IMU_DEPTH = 1000
#: /diagnostics come so often, s
_PERIOD = 1.0
#: messages that are later than others by more show that the machine is busy, s
_LONG_WAIT = 0.1
#: refused fixes that are shown are looked for among so many
_FIXES_KEPT = 50
#: by the logger's level of a status
_LOG_LEVELS = {b'\x00': 'info', b'\x01': 'warning', b'\x02': 'error'}


class FusionNode(Node):
    """The live filter as a node; `argv` names its params files. Raises ParameterError for wrong parameters."""

    def __init__(self, argv: list[str], stop: Stop):
        super().__init__(NAME)
        changeable = frozenset({*CHANGEABLE, 'odometry_rate', 'datum'})
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
        self._mounting = MountingCheck(values)
        self._use_orientation = values['alignment.heading'] == 'orientation'
        self._start = start_from_parameters(values) if values['start_pose'] else None
        self._datum = None
        self._set_rate(values['odometry_rate'])
        self._last_slot = None
        self._throttle = Throttle(5.0)
        self._state_log = StateLog()
        self._cannot_start: float | None = None  # since when, steady clock
        self._nis: deque[float] = deque(maxlen=_NIS_COUNT)
        self._publish(values)
        self._subscribe(values)
        self._serve()
        refuse_unused_qos_overrides(self, [told.topic_name for told in self._aiding])
        self.add_on_set_parameters_callback(self._check_changes)
        self.add_post_set_parameters_callback(self._apply_changes)
        # timers of the ROS clock stand still while use_sim_time waits for a /clock
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.2, self.report, clock=steady)
        self._looked, self._stalled = time.monotonic(), 0.0
        self.create_timer(_PERIOD, self._each_second, clock=steady)
        if self._state_file:
            self.create_timer(_SAVE_PERIOD, self._save, clock=steady)
        self._ready = (f"ready: {self._imu.topic_name} and {self._fix.topic_name} -> "
                       f"{self._odometry_publisher.topic_name} "
                       f"({values['mechanization']}, {values['sensor_error_model']})")

    def serve(self, stop: Stop) -> None:
        """Work until `stop` is requested."""
        self.get_logger().info(self._ready)
        spin(self, stop)
        if self._state_file:
            self._save()

    # --- what goes out ---

    def _publish(self, values):
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
        # events: the executor would ask after each of them at each sample; the other side reports them, too
        events = {'event_callbacks': PublisherEventCallbacks(use_default_callbacks=False)}
        options = {'qos_overriding_options': QoSOverridingOptions.with_default_policies(), **events}
        estimate = self._filter
        self._vehicle = VehicleAxes(estimate) if values['vehicle_axes'] else None
        self._flat = values['two_d']
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
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10, **events)
        self._verdicts = self.create_publisher(DiagnosticArray, '~/verdicts', 1000, **events)
        self._refused_fixes = self.create_publisher(NavSatFix, '~/refused_fixes', 50, **events)
        self._refused_points = self.create_publisher(PointStamped, '~/refused_points', 50, **events)
        self._datum_publisher = self.create_publisher(NavSatFix, '~/datum', _LATCHED, **events)

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
        self._fixes_kept: deque[NavSatFix] = deque(maxlen=_FIXES_KEPT)
        self._queue = queue = Queue(self)
        self._imu = Input(self, queue, 'imu', values['imu_topic'], (Imu,), self._on_imu, _IMU_DEPTH)
        self._fix = Input(self, queue, 'fix', values['gnss_topic'], (NavSatFix,), self._on_fix, 100,
                          patience=2 * values['gnss.outage_after'])
        asked_for = [name for name in ('speed', 'velocity', 'heading') if values[f'{name}_topic']]
        self._aiding_check = AidingCheck(asked_for, values)
        self._aiding = aiding_inputs(self, queue, values, self._filter, self._aiding_check.add)
        self._inputs = [self._imu, self._fix, *self._aiding]
        if values['temperature_topic']:
            self._inputs.append(Input(self, queue, 'temperature', values['temperature_topic'], (Temperature,),
                                      self._on_temperature, 50, patience=30.0))
        self._statuses = [InputStatus(told) for told in self._inputs]
        self._preflight = Preflight(self._inputs, values)
        if values['initial_pose_topic']:
            self.create_subscription(PoseWithCovarianceStamped, values['initial_pose_topic'], self._on_start_pose, 10)

    def _on_imu(self, message, info):
        """The hot path: no formatting, no new message, no look-up of a parameter."""
        self._imu.traffic.take(message.header, info)
        force, force_unit = message.linear_acceleration, self._force_unit
        rate, rate_unit = message.angular_velocity, self._rate_unit
        x = y = z = w = 0.0
        if self._use_orientation and message.orientation_covariance[0] != -1.0:  # -1: the driver has none (REP 145)
            orientation = message.orientation
            x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
        now = self._imu.traffic.stamp
        sample = (now, force.x * force_unit, force.y * force_unit, force.z * force_unit,
                  rate.x * rate_unit, rate.y * rate_unit, rate.z * rate_unit)
        self._mounting.add_sample(sample)
        if not self._filter.add_imu(*sample, x, y, z, w):
            if self._filter.state in BEFORE_START:
                self._newest = None
                if not self._mounting.is_certainly_wrong:
                    self._begin()
            self.report()  # why there is no estimate
            return
        if self._smooth or self._prediction:
            self._newest = self._update()
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
        self._send_estimate(self._newest or self._update())

    def _update(self) -> int:
        """The newest estimate in the filter's arrays, in the axes and with the dimensions asked for; its stamp, ns."""
        stamp = self._filter.update_odometry()
        if self._vehicle:
            self._vehicle.turn()
        if self._flat:
            flatten(self._filter.odometry)
        return stamp

    def _on_fix(self, message, info):
        waited = self._fix.traffic.take(message.header, info)
        stamp = self._fix.traffic.stamp
        self._filter.waited = waited
        self._fixes_kept.append(message)
        latitude, longitude = math.radians(message.latitude), math.radians(message.longitude)
        if self._state_file and message.status.status >= 0 and math.isfinite(latitude + longitude + message.altitude):
            self._resume(stamp, latitude, longitude, message.altitude)
        fix = (stamp, latitude, longitude, message.altitude, message.position_covariance, message.status.status,
               message.position_covariance_type)
        self._mounting.add_fix((*fix[:4], fix[4].copy(), *fix[5:]))
        self._aiding_check.add_fix((*fix[:4], fix[4].copy(), *fix[5:]))
        if not self._mounting.is_certainly_wrong:  # without a fix the filter does not start again
            self._filter.add_fix(*fix)
        self.report()

    def _on_temperature(self, message, info):
        temperature = self._inputs[-1].traffic
        temperature.take(message.header, info)
        self._filter.add_temperature(temperature.stamp, message.temperature)

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
        self.create_service(Trigger, '~/set_datum', self._on_set_datum)
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

    def _on_set_datum(self, request, response):
        if not self._filter.has_estimate:
            response.success, response.message = False, 'there is no estimate yet to put the datum at'
            return response
        self._filter.update_odometry()
        self._set_datum(*self._filter.geodetic.tolist())
        response.success, response.message = True, 'the local frame begins here from now on'
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
        """Log what the filter has to say since the last time; what repeats only for who debugs."""
        for notice in self._filter.notices():
            self._say(notice.level, notice.text)
        for judged in self._filter.verdicts():
            self._verdicts.publish(verdict(self.get_name(), judged))
            if judged.kind == 'fix':
                self._nis.extend([judged.nis] if judged.used else [])
                if not judged.used:
                    self._show_refused(judged.stamp)

    def _show_refused(self, stamp: int) -> None:
        """Publish a fix that was refused, for maps and views. stamp: ns, in the clock of the IMU."""
        stamp += round(self._values['gnss.time_offset'] * _SECOND)
        for message in self._fixes_kept:
            if abs(stamp_of(message) - stamp) < 1000:  # through the filter's seconds
                self._refused_fixes.publish(message)
                if self._filter.datum is not None and math.isfinite(message.latitude + message.longitude
                                                                    + message.altitude):
                    point = PointStamped(header=message.header, point=to_local_point(message, self._filter.datum))
                    point.header.frame_id = self._values['map_frame_id' if self._smooth else 'frame_id']
                    self._refused_points.publish(point)
                return

    def _say(self, level, line):
        text = self._throttle.pass_on(line)
        self._log('debug' if text is None else level, text or line)

    def _warn(self, line):
        self._say('warning', line)

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
        now = time.monotonic()
        self._stalled, self._looked = now - self._looked - _PERIOD, now
        self._queue.release()
        for told in self._inputs:
            told.look()
        for status in self._statuses:
            status.look(self._tally(status.input))
            self._say_lost(status)
        self._look_at_mounting()
        for name, level, text in self._aiding_check.look():
            topic = next(told.topic_name for told in self._aiding if told.name == name)
            self._log(level, f'{topic}: {text}')
        self._check_topics()
        self._tell_datum()
        self._diagnose()
        found = self._preflight.look(self._mounting.force())
        if found:
            self._log(*found)

    def _tally(self, told):
        return self._filter.tallies.get(told.name) or Tally()

    def _say_lost(self, status):
        if status.lost:
            waited = max(status.waited, self._stalled)
            why = (f'others came up to {waited:.1f} s late: the machine is busy' if waited > _LONG_WAIT
                   else 'on their way: the network or the publisher is busy')
            self._warn(f'{status.input.topic_name}: {status.lost} messages lost in the last second, {why}')

    def _diagnose(self):
        """State, reasons and numbers by the clock, for the log and /diagnostics."""
        state, health, reasons = self._filter.state, self._filter.health(), self._filter.reasons
        imu = self._imu.traffic
        if imu.is_stale and imu.count:
            state = SILENT
            reasons = [f'no sample on {self._imu.topic_name} for {imu.silence:.0f} s, nothing is published']
            health = by_the_clock(health, imu.silence)
        elif state in BEFORE_START:
            reasons = [health['status']]
        elif state == 'coasting':
            reasons = [f"no fix used for {health['age of the last fix used, s']:.0f} s", *reasons]
        level = level_of(state, self._cannot_start_for())
        since, said = self._state_log.look(state, '; '.join(reasons) or health['status'], level)
        if said:
            self._log(_LOG_LEVELS[level], said)
        if self._mounting.is_wrong:
            certain = self._mounting.is_certainly_wrong
            reasons, level = [*reasons, self._mounting.found], max(level, ERROR if certain else WARN)
        if self._nis:
            health['mean NIS'] = sum(self._nis) / len(self._nis)
        health['mounting'] = self._mounting.found
        for told in self._inputs:
            health[f'messages on {told.topic_name}, Hz'] = told.traffic.hertz
        name = self.get_name()
        statuses = [filter_status(name, state, level, since, reasons, health)]
        for status in self._statuses:
            more = {'gaps': self._filter.gaps} if status.input is self._imu else {}
            if status.input is self._fix:
                more = {key: health[key] for key in ('age of the last fix used, s',) if key in health}
            problem = self._aiding_check.found.get(status.input.name)
            statuses.append(status.status(name, self._tally(status.input), problem, more))
        self._diagnostics.publish(array(self.get_clock().now().nanoseconds, statuses))

    def _cannot_start_for(self) -> float:
        """For how long the filter has waited for what will not come by itself, s."""
        now = time.monotonic()
        if not self._filter.contradicted:
            self._cannot_start = None
        elif self._cannot_start is None:
            self._cannot_start = now
        return 0.0 if self._cannot_start is None else now - self._cannot_start

    def _look_at_mounting(self):
        found = self._mounting.look()
        if found:
            level, text = found
            self._log(level, f'{self._imu.topic_name}: {text}')
            if self._mounting.is_certainly_wrong:
                self._filter.reset()
                self._log(level, f'{self._imu.topic_name}: nothing is published with a mounting that is certainly '
                                 'wrong')

    def _check_topics(self):
        for told in self._inputs:
            found = told.traffic.check()
            if found is None:
                continue
            silent, seconds = found
            if silent:
                self.get_logger().warning(f'no message on {told.topic_name} ({told.kind}) for {seconds:.0f} s: '
                                          f'{told.why_silent()}')
            else:
                self.get_logger().info(f'messages on {told.topic_name} again after {seconds:.0f} s')

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
        if values.get('datum'):
            latitude, longitude, height = values['datum']
            self._set_datum(math.radians(latitude), math.radians(longitude), height)
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
            self.destroy_timer(old)
        return self.create_timer(period, self._send_prediction)


def main(argv: list[str]) -> int:
    """Run the node until SIGINT or SIGTERM; the exit status."""
    return run(NAME, FusionNode, argv, FusionNode.serve, (FILTER, FUSION))
