"""The inputs of the node: their messages, of any accepted type, as numbers for the filter."""
from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Callable, Sequence
from dataclasses import fields as dataclass_fields
from importlib import import_module
from operator import attrgetter

import numpy as np
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, ReliabilityPolicy, qos_check_compatible
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import NavSatFix

from ..filter.measurements.base import Measurement
from ..filter.measurements.registry import MEASUREMENTS, aiding
from ..filter.memory import Kind
from ..recordings.reading import thinned
from ..samples import SECOND
from .traffic import Traffic

#: ns: a measurement whose stamp is later than the newest sample's by more may have overtaken samples. The filter
#: refuses a measurement that is a second ahead
OVERTAKEN = 500_000_000
#: s: a message that is delayed by more than the fastest of its topic shows that the machine has stalled
STALLED = 0.3
#: s for which messages are processed before timers and services are
AT_ONCE = 0.05
#: s without a sample after which the samples before a held measurement are not expected any more
HOLD = 2.0
#: number of messages in a queue while the machine is busy: 10 s of an IMU of 400 Hz. With 1000, a node that got a
#: twentieth of a machine with a load of 18 lost 2.6 % of such samples (studies/node_soak.py)
_DEPTH = 4000


def stamp_of(message) -> int:
    """ns."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def sample_of(measurement: Measurement, messages: Sequence, received: int | None = None) -> tuple[int, tuple]:
    """Stamp, ns, and numbers of the sample in `messages`, as `measurement.read` gives them for a recording.

    messages: one, or two of a measurement that needs two (`of_two`). received: ns, of a message without a header.
    """
    kind = _name(type(messages[0]))
    fields = {path: thinned(path, np.concatenate([_row(attrgetter(path)(message)) for message in messages]))
              for path in measurement.messages[kind]}
    stamps = [stamp_of(message) if received is None else received for message in messages]
    fields['stamp'] = fields['received'] = np.array(stamps, dtype=np.int64)
    samples = measurement.read(fields, kind)
    return int(samples.stamp[0]), tuple(getattr(samples, field.name)[0] for field in dataclass_fields(samples)[2:])


def nav_sat_fix(message, received: int | None = None) -> NavSatFix:
    """A fix in a message of another type, or one without altitude, converted by `measurements.position`.

    received: ns, of a message without a header; the time of the fix is in the message itself.
    """
    fix = MEASUREMENTS[Kind.POSITION]
    stamp, (latitude, longitude, height, covariance, status, kind) = sample_of(fix, [message], received)
    made = NavSatFix(latitude=float(np.degrees(latitude)), longitude=float(np.degrees(longitude)),
                     altitude=float(height), position_covariance=np.ascontiguousarray(covariance).reshape(9),
                     position_covariance_type=int(kind))
    if received is None:
        made.header = message.header
    else:
        made.header.stamp.sec, made.header.stamp.nanosec = divmod(stamp, SECOND)
    made.status.status = int(status)
    return made


def _row(value) -> np.ndarray:
    """A field of a message as an array over messages: (1, k), or (1,) for a single number."""
    if hasattr(value, 'x'):
        value = [getattr(value, name) for name in 'xyzw' if hasattr(value, name)]
    return np.asarray(value, dtype=float)[None]


class Queue:
    """The messages that wait on all inputs, as one queue in the order in which they were sent.

    DDS has a queue for each topic, and rclpy's executor builds a new wait set for each round and takes one message of
    each topic. On a busy machine, fixes would then be processed before samples that were sent earlier, and the wait set
    would take more time than the work.
    """

    def __init__(self, node: Node):
        self.inputs: list[Input] = []
        self._waiting: list[tuple] = []  # when sent, input, message, rclpy's information on it
        self._held: dict[Input, deque] = defaultdict(deque)  # messages that have overtaken samples
        self._deadline: float | None = None  # time until which they are held, steady clock
        self._again = node.create_guard_condition(self._serve)

    def serve(self, first: Input, message, info: dict) -> None:
        """Process a message and those that wait by now; after AT_ONCE, timers and services are processed."""
        self._waiting.append((info['source_timestamp'], first, message, info))
        self._serve()

    def release(self) -> None:
        """Process held messages whose time is over; called once a second, as there may be no message."""
        if self._held:
            self._serve()

    def _serve(self) -> None:
        waiting = self._waiting
        for source in self.inputs:  # a node that cannot keep up leaves the rest in the queues of the topics
            while len(waiting) < _DEPTH and (taken := source.take()) is not None:
                waiting.append((taken[1]['source_timestamp'], source, *taken))
        if len(waiting) > 1:
            waiting.sort(key=lambda one: one[0])
        begun, done = time.monotonic(), 0
        self._pass_on_held()
        for one in waiting:
            _, source, message, info = one
            if source.is_imu:
                source.on_message(message, info)
                self._deadline = None  # they still come
                self._pass_on_held()
            elif source in self._held or self._overtook(source, message, info):  # later ones stay behind it
                self._held[source].append(one)
            else:
                source.on_message(message, info)
            done += 1
            if time.monotonic() - begun > AT_ONCE:
                break
        del waiting[:done]
        if waiting:
            self._again.trigger()

    def _pass_on_held(self) -> None:
        """The held messages for which all earlier samples have come, or whose time is over."""
        for source, held in list(self._held.items()):
            while held and not self._overtook(source, *held[0][2:]):
                source.on_message(*held.popleft()[2:])
            if not held:
                del self._held[source]

    def _overtook(self, source: Input, message, info: dict) -> bool:
        """Whether samples from before a message are still to come: the message is late, and its stamp is far ahead of
        the newest sample's. After a stall, messages come topic by topic. A message that is ahead but not late has a
        stamp of another clock."""
        newest = max((other.traffic.stamp for other in self.inputs if other.is_imu), default=0)
        if not newest or stamp_of(message) - newest <= OVERTAKEN or source.traffic.waited(info) <= STALLED:
            return False
        if self._deadline is None:
            self._deadline = time.monotonic() + HOLD
        return time.monotonic() < self._deadline


class Input:
    """A topic that the node subscribes to. name: as in the filter (imu, fix, speed, ...).

    kinds: possible message types, package/msg/Name, of which only those that are installed are used. If there are
    several, the subscription is made when a publisher shows its type. queue: of the node. on_message: called with a
    message and rclpy's information on it. patience: s without a message after which the topic is silent. is_imu:
    whether the filter takes its time from this topic.
    """

    def __init__(self, node: Node, queue: Queue, name: str, topic: str, kinds: tuple, on_message: Callable,
                 patience: float = 3.0, is_imu: bool = False):
        self.is_imu = is_imu
        self.name, self.topic_name = name, node.resolve_topic_name(topic)
        self.traffic = Traffic(patience, lambda: node.get_clock().now().nanoseconds)
        self._node, self._queue, self._topic, self.on_message = node, queue, topic, on_message
        installed = {kind: message_class(kind) for kind in kinds}
        self._missing = {kind for kind, found in installed.items() if found is None}
        self._kinds = {kind: found for kind, found in installed.items() if found is not None}
        self._subscription = None
        queue.inputs.append(self)
        if len(self._kinds) == 1:
            self._subscribe(*self._kinds.values())
        self.look()

    @property
    def kind(self) -> str:
        """The message type that it carries; until that is known, those that it may carry, in words."""
        return ' or '.join(self._kinds) if self._subscription is None else _name(self._subscription.msg_type)

    @property
    def is_subscribed(self) -> bool:
        """Whether its type is known."""
        return self._subscription is not None

    def look(self) -> None:
        """Subscribe if there is a publisher."""
        if self._subscription is None:
            for info in self._node.get_publishers_info_by_topic(self.topic_name):
                if info.topic_type in self._kinds:
                    self._subscribe(self._kinds[info.topic_type])
                    return

    def _subscribe(self, kind):
        # best effort also receives from reliable drivers; a reliable subscription receives nothing from best-effort
        # ones
        self._subscription = self._node.create_subscription(
            kind, self._topic, self._on_first,
            QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
            qos_overriding_options=QoSOverridingOptions.with_default_policies())

    def take(self):
        """The next waiting message, with rclpy's information on it; None if there is none."""
        if self._subscription is None:
            return None
        taken = self._subscription.handle.take_message(self._subscription.msg_type, False)
        return taken and (self._with_header(taken[0]), taken[1])

    def _on_first(self, message, info):
        self._queue.serve(self, self._with_header(message), info)

    def _with_header(self, message):
        """`message`; a fix whose type has no header as NavSatFix."""
        if hasattr(message, 'header'):
            return message
        return nav_sat_fix(message, self._node.get_clock().now().nanoseconds)

    def publishers(self) -> int:
        return self._node.count_publishers(self.topic_name)

    def why_silent(self) -> str:
        """Why no messages come, as far as ROS knows."""
        infos = self._node.get_publishers_info_by_topic(self.topic_name)
        own = {publisher.topic_name for publisher in self._node.publishers}
        if any(info.topic_type in self._kinds for info in infos):
            return self.qos_problem() or 'it has a publisher, but nothing arrives'
        kinds = sorted({info.topic_type for info in infos})
        for kind in self._missing.intersection(kinds):
            return f"it carries {kind}, and the package '{kind.split('/')[0]}' is not installed"
        reason = f"it carries {', '.join(kinds)}" if kinds else 'nobody publishes it'
        same = sorted(name for name, carried in self._node.get_topic_names_and_types()
                      if set(self._kinds) & set(carried) and self._node.count_publishers(name) and name not in own)
        return f"{reason}; topics of this type: {', '.join(same) or 'none'}"

    def qos_problem(self) -> str:
        """Publisher whose quality of service does not fit this subscription, and what to set; '' if all fit."""
        if self._subscription is None:
            return ''
        for info in self._node.get_publishers_info_by_topic(self.topic_name):
            compatible, reason = qos_check_compatible(info.qos_profile, self._subscription.qos_profile)
            if compatible == QoSCompatibility.ERROR:
                return (f'the quality of service of its publisher {info.node_name} does not fit: '
                        f'{" ".join(reason.split())} (qos_overrides.{self.topic_name}.subscription.*)')
        return ''


def _name(kind) -> str:
    return f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"


def aiding_inputs(node: Node, queue: Queue, values: dict, fusion, before: Callable[[str, int, tuple], None]
                  ) -> list[Input]:
    """The inputs besides the fixes in `values` (checked parameters), for the filter `fusion`.

    before: called with name, stamp (ns) and numbers of each measurement before the filter gets it.
    """
    return [_aiding(node, queue, one, values[one.topic], fusion, before) for one in aiding(values)
            if values.get(one.topic)]


def _aiding(node, queue, measurement, topic, fusion, before) -> Input:
    newest = deque(maxlen=2 if measurement.of_two else 1)

    def on_message(message, info):
        fusion.waited = source.traffic.take(message.header, info)
        newest.append(message)
        if len(newest) < newest.maxlen:
            return
        stamp, numbers = sample_of(measurement, newest)
        before(measurement.name, stamp, numbers)
        fusion.add(measurement.name, stamp, *numbers)

    source = Input(node, queue, measurement.name, topic, tuple(measurement.messages), on_message)
    return source


def message_class(kind: str):
    """The class of a message type, package/msg/Name; None where it is not installed."""
    package, _, name = kind.split('/')
    try:
        return getattr(import_module(f'{package}.msg'), name)
    except (ImportError, AttributeError):
        return None
