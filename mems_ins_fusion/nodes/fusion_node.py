"""fusion_node: IMU and GNSS live in, odometry out.

Subscribes sensor_msgs/Imu and sensor_msgs/NavSatFix, publishes nav_msgs/Odometry and the fused position as
sensor_msgs/NavSatFix. All computation is in the filter; this file converts messages to numbers, and services and
parameters to calls of the filter. Outputs: `estimates.py`, `verdicts.py`; diagnostics and log: `monitor.py`.
"""
from __future__ import annotations

import math

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import NavSatFix
from std_srvs.srv import SetBool, Trigger

from ..compiled import tell
from ..diagnosis.applying import apply_findings, with_applied
from ..diagnosis.quantity import FilterFindings
from ..filter.config import FilterConfig
from ..filter.measurements.registry import imus
from ..filter.runs.changing import ChangingFilter
from ..filter.runs.imus import Imus
from ..filter.runs.live import CHANGEABLE, FusionFilter
from ..parameters.parameter import ParameterError
from ..parameters.table import ALL, FILTER, FUSION
from ..recordings.messages import IMU, TEMPERATURE
from ..recordings.reading import FIX_TYPES
from ..recordings.units import ACCELERATION, RATE
from . import identity
from .checks import check_together
from .estimates import LATCHED, NO_EVENTS, Estimates
from .geographic import geographic_services, start_from_parameters, start_from_pose, world_frame
from .geometry import geometry_from_tf
from .horizon import HorizonOutput
from .inputs import Input, Queue, aiding_inputs, nav_sat_fix
from .loading import load
from .log import Log
from .monitor import PERIOD, Monitor
from .online import OnlineDiagnosis
from .output import tf_message
from .ros_parameters import declare, refuse_unused_qos_overrides
from .run import Stop, serve, spin
from .state_file import StateFile
from .status import BEFORE_START
from .verdicts import Verdicts

NAME = 'fusion_node'
#: s between two writes of the state file, 10 ms of work each: a loss of power loses no more than this
_SAVE_PERIOD = 10.0
#: s between two looks for messages of the filter to the user, in addition to those at each message of an input
_REPORT_PERIOD = 0.2
#: s without a temperature after which its topic is silent: temperatures come once a second or less often
_TEMPERATURE_PATIENCE = 30.0


class FusionNode(Node):
    """The live filter as a node; `argv` names its params files. Raises ParameterError for wrong parameters."""

    def __init__(self, argv: list[str], stop: Stop):
        super().__init__(NAME)
        changeable = frozenset({*CHANGEABLE, 'odometry_rate', 'datum'})
        self._values = values = declare(self, argv, (*FILTER, *FUSION), changeable=changeable)
        check_together(values, self.resolve_topic_name)
        if values['publish_tf']:
            tf_message()  # report a missing package before anything takes time
        self._log = Log(self.get_logger())
        self._state_file = self._open_state_file(values)
        values |= geometry_from_tf(self, values, stop)
        self._identity = identity.Identity((identity.IMU, identity.GNSS))
        self._given, kept = {**values}, self._findings_of_earlier_drives(values)
        self._applied = {one.name: one.sets for one in kept}  # findings of the diagnosis while driving
        began, without = with_applied(values, self._applied)
        values.update(began)
        make = FusionFilter if values['diagnosis.online'] == 'off' else ChangingFilter
        self._filter = make(FilterConfig.from_parameters(values))
        if without:
            self._filter.watch(without)
        tell(self.get_logger().info)
        self._imus = Imus(values) if imus(values) else None
        load(self._filter, stop, self._imus)  # before there is a subscription: no message waits for the compiler
        self._force_unit = ACCELERATION[values['imu.acceleration_unit']]
        self._rate_unit = RATE[values['imu.rate_unit']]
        self._use_orientation = values['alignment.heading'] == 'orientation'
        self._start = start_from_parameters(values) if values['start_pose'] else None
        self._datum = None
        self._estimates = Estimates(self, self._filter, values, self._log)
        self._horizon = HorizonOutput(self, self._filter, values)
        self._verdicts = Verdicts(self, self._filter, values)
        self._datum_publisher = self.create_publisher(NavSatFix, '~/datum', LATCHED, **NO_EVENTS)
        inputs = self._subscribe(values)
        self._online = None
        if values['diagnosis.online'] != 'off':
            self._online = OnlineDiagnosis(self, self._given, self._log, kept)
        self._monitor = Monitor(self, self._filter, inputs, self._verdicts, values, self._log, self._online, self._imus)
        self._serve()
        refuse_unused_qos_overrides(self, [one.topic_name for one in inputs if not one.is_subscribed])
        self.add_on_set_parameters_callback(self._check_changes)
        self.add_post_set_parameters_callback(self._apply_changes)
        # timers of the ROS clock stand still while use_sim_time waits for a /clock
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(_REPORT_PERIOD, self.report, clock=steady)
        self.create_timer(PERIOD, self._each_second, clock=steady)
        if self._state_file:
            self.create_timer(_SAVE_PERIOD, self._save, clock=steady)
        self._ready = (f'ready: {self._imu.topic_name} and {self._fix.topic_name} -> {self._estimates.topic_name} '
                       f"({values['mechanization']}, {values['sensor_error_model']})")

    def serve(self, stop: Stop) -> None:
        """Work until `stop` is requested."""
        self.get_logger().info(self._ready)
        try:
            spin(self, stop)
            self._save_if_asked()
        finally:
            if self._online:
                self._online.close()

    def report(self) -> None:
        """Log and publish what the filter has to say since the last time."""
        for notice in (*self._filter.notices(), *(self._imus.notices() if self._imus else ())):
            # while the mounting is certainly wrong, messages on what the filter waits for would mislead
            if notice.level != 'info' or not self._monitor.mounting.is_certainly_wrong:
                self._log.say(notice.level, notice.text)
        self._verdicts.publish()

    def _each_second(self):
        self._queue.release()
        self._monitor.look()
        self._publish_datum()

    # --- inputs ---

    def _subscribe(self, values) -> list[Input]:
        """All inputs, the IMU and the fixes first."""
        self._queue = queue = Queue(self)
        self._imu = Input(self, queue, 'imu', values['imu_topic'], (IMU,), self._on_imu, is_imu=True)
        self._fix = Input(self, queue, 'fix', values['gnss_topic'], FIX_TYPES, self._on_fix,
                          patience=2 * values['gnss.outage_after'])
        further = [self._further_imu(queue, i) for i in range(1, len(self._imus.names))] if self._imus else []
        inputs = [self._imu, self._fix, *further,
                  *aiding_inputs(self, queue, values, self._filter, self._before_aiding)]
        if values['temperature_topic']:
            self._temperature = Input(self, queue, 'temperature', values['temperature_topic'], (TEMPERATURE,),
                                      self._on_temperature, patience=_TEMPERATURE_PATIENCE)
            inputs.append(self._temperature)
        if values['initial_pose_topic']:
            self.create_subscription(PoseWithCovarianceStamped, values['initial_pose_topic'], self._on_start_pose, 10)
        return inputs

    def _further_imu(self, queue, i) -> Input:
        """The input of the further IMU number i."""
        def on_message(message, info):
            traffic = imu.traffic
            traffic.take(message.header, info)
            force, rate = message.linear_acceleration, message.angular_velocity
            self._take_all(self._imus.add(i, traffic.stamp, (force.x, force.y, force.z), (rate.x, rate.y, rate.z)))

        imu = Input(self, queue, self._imus.names[i], self._imus.topics[i], (IMU,), on_message, is_imu=True)
        return imu

    def _on_imu(self, message, info):
        """Called for each sample, so it is kept fast: no formatting, no new message, no look-up of a parameter."""
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
        if self._identity.is_unknown(identity.IMU):
            self._identify(identity.IMU, now, {'frame_id': message.header.frame_id,
                                               'orientation': bool(message.orientation_covariance[0] != -1.0)})
        if self._imus is None:
            self._take(sample, x, y, z, w)
        else:
            self._take_all(self._imus.add(0, now, sample[1:4], sample[4:]), now, (x, y, z, w))

    def _take_all(self, samples, stamp=None, orientation=(0.0,) * 4):
        """Combine the samples of several IMUs; orientation: of the sample with this stamp."""
        for now, numbers in samples:
            self._take((now, *numbers[:6]), *(orientation if now == stamp else (0.0,) * 4), numbers[6:])

    def _take(self, sample, x, y, z, w, difference=()):
        """A sample for the filter. difference: of several IMUs, as in `ImuSamples`."""
        now = sample[0]
        self._monitor.mounting.add_sample(sample)
        if self._online and (findings := self._online.add_sample(sample)) is not None:
            self._apply_findings(findings)
        is_new = self._filter.add_imu(*sample, x, y, z, w, difference)
        if self._applied:
            self._remove_dropped()
        if is_new:
            self._estimates.on_sample(now)
            self._horizon.on_sample(now)
            return
        if self._filter.state in BEFORE_START:
            self._estimates.stop()
            self._horizon.stop(now)
            if not self._monitor.mounting.is_certainly_wrong:
                self._begin()
        self.report()  # why there is no estimate

    def _on_fix(self, message, info):
        self._filter.waited = self._fix.traffic.take(message.header, info)
        stamp = self._fix.traffic.stamp
        if not isinstance(message, NavSatFix) or math.isnan(message.altitude):
            message = nav_sat_fix(message)
        self._verdicts.keep(message)
        latitude, longitude = math.radians(message.latitude), math.radians(message.longitude)
        has_position = message.status.status >= 0 and math.isfinite(latitude + longitude + message.altitude)
        self._monitor.preflight.add_fix(stamp, has_position)
        if self._state_file and has_position:
            self._resume(stamp, latitude, longitude, message.altitude)
        fix = (stamp, latitude, longitude, message.altitude, message.position_covariance.copy(), message.status.status,
               message.position_covariance_type)
        # without a fix, drivers do not fill status.service
        if self._identity.is_unknown(identity.GNSS) and message.status.status >= 0:
            self._identify(identity.GNSS, stamp, {'frame_id': message.header.frame_id,
                                                  'service': message.status.service})
        self._monitor.mounting.add_fix(fix)
        self._monitor.aiding.add_fix(fix)
        if self._online:
            self._online.add_fix(fix)
        if not self._monitor.mounting.is_certainly_wrong:  # without a fix the filter does not start again
            self._filter.add_fix(*fix)
        self.report()

    def _before_aiding(self, name, stamp, numbers):
        self._monitor.aiding.add(name, stamp, numbers)
        if self._online:
            self._online.add(name, stamp, numbers)

    def _on_temperature(self, message, info):
        self._temperature.traffic.take(message.header, info)
        self._filter.add_temperature(self._temperature.traffic.stamp, message.temperature)

    # --- starts, stops and datum ---

    def _begin(self):
        """Start at the start pose of the parameters, at the first sample."""
        if self._start is not None:
            start, self._start = self._start, None
            self.get_logger().info(f"starting from the parameter 'start_pose': {self._values['start_pose']}")
            self._filter.set_start(*start)

    def _on_start_pose(self, message):
        topic = self.resolve_topic_name(self._values['initial_pose_topic'])
        try:
            start = start_from_pose(message, self._filter.datum, world_frame(self._values))
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

    def _sensor_topics(self):
        """The topics of the sensors to which a calibration belongs."""
        return {name: self._values[name] for name in ('imu_topic', 'gnss_topic')}

    def _findings_of_earlier_drives(self, values):
        """The findings in the state file, if findings are to be applied."""
        if self._state_file is None or values['diagnosis.online'] != 'apply':
            return []
        kept, said = self._state_file.calibration(self._sensor_topics())
        for text in said:
            self.get_logger().info(text)
        return kept

    def _identify(self, sensor, stamp, properties):
        """Note the properties of the device that sends; findings from another device are not used."""
        self._identity.add(sensor, stamp, properties)
        known = self._identity.known
        if known is None or self._state_file is None or not self._applied:
            return
        others = identity.differences(self._state_file.devices(self._sensor_topics()), known)
        if others:
            self.get_logger().warning(f"state file: another device than before ({', '.join(others)}): findings from "
                                      f"the earlier one are not used: {', '.join(self._applied)}")
            self._apply_findings(FilterFindings({}, {}))
            self._online.ask('reject')

    def _apply_findings(self, findings):
        """Set `findings` in the filter, in addition to the parameters that the node was given."""
        changes = self._set_applied(findings.applied)
        apply_findings(self._filter, self._values_without_findings(), findings, changes)
        if changes:
            self._save_if_asked()

    def _remove_dropped(self):
        """Remove the findings that the filter has dropped."""
        for one in self._filter.dropped():
            self._log.tell('warning', f'diagnosis.online: {one.name} is no longer valid: dropped')
            self._set_applied({name: sets for name, sets in self._applied.items() if name != one.name})
            self._online.dropped(one)
            self._save_if_asked()

    def _values_without_findings(self):
        """The present parameters; those changed by findings with the values that the node was given."""
        found = {name for sets in self._applied.values() for name in sets}
        return {**self._values, **{name: self._given[name] for name in found}}

    def _set_applied(self, applied):
        """Use the parameters with the findings `applied`; whether any value changes."""
        before, (values, _) = dict(self._values), with_applied(self._values_without_findings(), applied)
        self._values.update(values)
        self._applied = applied
        said = ', '.join(f'{name}: {value} (before: {before[name]})' for name, value in values.items()
                         if value != before[name])
        if said:
            self._log.tell('warning', f'diagnosis.online: the filter will use {said}')
        return bool(said)

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

    def _save_if_asked(self):
        if self._state_file:
            self._save()

    def _save(self):
        snapshot = self._filter.snapshot()
        if snapshot is not None:
            devices = self._identity.known  # without them, a calibration could not be assigned to its device
            said = self._state_file.write(snapshot, self._online.kept if self._online and devices else None,
                                          self._sensor_topics(), devices)
            if said:
                self._log.say('warning', said)

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
        self._publish_datum()

    def _publish_datum(self):
        """Publish and log the datum if it is new."""
        datum = self._filter.datum
        if datum is None or self._datum == tuple(datum):
            return
        self._datum = tuple(datum)
        latitude, longitude, height = math.degrees(datum[0]), math.degrees(datum[1]), float(datum[2])
        message = NavSatFix(latitude=latitude, longitude=longitude, altitude=height)
        message.header.frame_id = world_frame(self._values)
        message.header.stamp = self.get_clock().now().to_msg()
        self._datum_publisher.publish(message)
        self.get_logger().info(f'datum: latitude {latitude:.8f} deg, longitude {longitude:.8f} deg, height '
                               f'{height:.3f} m')

    # --- parameters while running ---

    def _check_changes(self, changed):
        try:
            values = {p.name: ALL[p.name].check(p.value) for p in changed if p.name in ALL}
            if self._values['predict_to_now'] and not values.get('odometry_rate', 1.0):
                raise ParameterError("parameter 'odometry_rate' must be above 0 with predict_to_now")
            self._filter.changed(values)
        except ParameterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_changes(self, changed):
        values = {p.name: ALL[p.name].check(p.value) for p in changed if p.name in ALL}
        self._values.update(values)
        if 'odometry_rate' in values:
            self._estimates.set_rate(values['odometry_rate'])
        if values.get('datum'):
            latitude, longitude, height = values['datum']
            self._set_datum(math.radians(latitude), math.radians(longitude), height)
        self._filter.adopt(self._filter.changed(values))
        if values:
            self.get_logger().info(', '.join(f'{name}: {value}' for name, value in values.items()) + ' from now on')


def main(argv: list[str]) -> int:
    """Run the node until SIGINT or SIGTERM; the exit status."""
    return serve(NAME, FusionNode, argv, FusionNode.serve, (FILTER, FUSION))
