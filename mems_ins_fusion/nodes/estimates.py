"""Publishes the filter's newest estimate, in the frames, axes and dimensions and at the rate of the parameters."""
from __future__ import annotations

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import NavSatFix

from ..filter.runs.live import FusionFilter
from ..samples import SECOND
from .log import Log
from .output import MapOutput, Output, Prediction, SmoothFrame, VehicleAxes, flatten

#: ten messages are kept for a slow subscriber: an odometry that is older than ten samples is of no use
_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
#: quality of service of /tf, as in tf2's broadcasters
_TF_QOS = QoSProfile(depth=100)
#: quality of service of topics with few messages: a later subscriber gets the newest one
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: no callbacks for events: the executor would check each of them at each sample; the subscriber reports them as well
NO_EVENTS = {'event_callbacks': PublisherEventCallbacks(use_default_callbacks=False)}


class Estimates:
    """Publishes the estimates of `fusion`, as specified by `values` (checked parameters of the node)."""

    def __init__(self, node: Node, fusion: FusionFilter, values: dict, log: Log):
        self._node, self._fusion, self._values, self._log = node, fusion, values, log
        self._newest: int | None = None  # stamp of the newest estimate, ns
        self._last_slot, self._timer = None, None
        self._vehicle = VehicleAxes(fusion) if values['vehicle_axes'] else None
        self._flat = values['two_d']
        self._smooth = SmoothFrame(fusion) if values['frames'] == 'map_odom' else None
        estimate = self._smooth or fusion
        self._prediction = Prediction(estimate) if values['predict_to_now'] else None
        self._publish(Output(self._prediction or estimate, values['frame_id'], values['child_frame_id']))
        self.set_rate(values['odometry_rate'])

    def _publish(self, output: Output) -> None:
        node, values = self._node, self._values
        options = {'qos_overriding_options': QoSOverridingOptions.with_default_policies(), **NO_EVENTS}
        odometry = node.create_publisher(Odometry, values['odometry_topic'], _QOS, **options)
        fix = node.create_publisher(NavSatFix, values['fix_topic'], _QOS, **options)
        self.topic_name = odometry.topic_name
        self._fill = [output.fill]
        self._send = [(odometry.publish, output.odometry), (fix.publish, output.fix)]
        transforms = [output.add_transform()] if values['publish_tf'] else []
        if self._smooth:
            in_map = MapOutput(self._fusion, self._smooth, values['map_frame_id'], values['frame_id'])
            publisher = node.create_publisher(PoseWithCovarianceStamped, values['pose_topic'], _QOS, **options)
            self._fill.append(in_map.fill)
            self._send.append((publisher.publish, in_map.pose))
            transforms += [in_map.transform()] if values['publish_tf'] else []
        if transforms:
            publisher = node.create_publisher(type(transforms[0]), '/tf', _TF_QOS)
            self._send += [(publisher.publish, transform) for transform in transforms]

    def set_rate(self, rate: float) -> None:
        """Publish at `rate`, Hz, from now on; 0: a message for each sample."""
        self._period = round(SECOND / rate) if rate else 0
        if self._prediction:
            if self._timer is not None:
                self._node.destroy_timer(self._timer)
            self._timer = self._node.create_timer(1.0 / rate, self._send_prediction)

    def on_sample(self, now: int) -> None:
        """The filter has an estimate from a sample with the stamp `now`, ns."""
        if self._smooth or self._prediction:
            self._newest = self._update()
            if self._smooth:
                self._smooth.advance(self._newest)
                if not self._fusion.aligned:  # while the heading is unknown, its error is not a drift of the frame
                    self._smooth.settle()
            if self._prediction:  # published by the clock
                return
        if self._period:
            # one message in each slot of a period, however the stamps jitter
            slot = now // self._period
            if slot == self._last_slot:
                return
            self._last_slot = slot
        self._send_all(self._newest or self._update())

    def stop(self) -> None:
        """The filter has no estimate any more."""
        self._newest = None

    def _update(self) -> int:
        """Write the newest estimate to the filter's arrays, in the axes and dimensions of the parameters; returns its
        stamp, ns."""
        stamp = self._fusion.update_odometry()
        if self._vehicle:
            self._vehicle.turn()
        if self._flat:
            flatten(self._fusion.odometry)
        return stamp

    def _send_all(self, stamp: int) -> None:
        for fill in self._fill:
            fill(stamp)
        for publish, output in self._send:
            publish(output)

    def _send_prediction(self) -> None:
        """Publish the newest estimate, predicted to the present time; called by a timer."""
        if self._newest is None:
            return
        now = self._node.get_clock().now().nanoseconds
        ahead = (now - self._newest) * 1e-9
        if not 0.0 <= ahead <= self._values['imu.max_gap']:
            topic = self._node.resolve_topic_name(self._values['imu_topic'])
            self._log.say('warning', f'{topic}: the newest sample is stamped {ahead:.3f} s before now, not 0 to '
                                     f"{self._values['imu.max_gap']:g} s (imu.max_gap): nothing is published")
            return
        self._prediction.advance(ahead)
        self._send_all(now)
