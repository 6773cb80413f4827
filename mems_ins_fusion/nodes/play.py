"""`play`: the messages of a recording on their topics, with /clock: `ros2 bag play` where there is no `ros2`."""
from __future__ import annotations

import argparse
import time

import numpy as np
import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock

from ..cli.command import Parser
from ..errors import InputError
from ..guard import refuse
from ..hints import did_you_mean
from ..progress import Progress
from ..recordings.bags import Bag
from ..recordings.errors import RecordingError
from ..recordings.reading import READABLE, Memory
from ..samples import SECOND
from .inputs import message_class
from .playback import time_message
from .run import Stop

NAME = 'play'
#: s, largest step of /clock
_TICK = 0.02
#: GB of memory at the start, and bytes beside each message
_MEMORY = 0.2, 150.0
#: s to wait for further subscribers after the first one
_OTHERS = 0.5
#: longest time for the delivery of the last messages to reliable subscribers
_DELIVERY = Duration(seconds=2)
_DEPTH = 1000  # number of messages kept for a slow subscriber

DESCRIPTION = """\
Publish the messages of a recording on their topics, with the timing of the recording, and its time on /clock: what
`ros2 bag play --clock` does, without needing a ros2 command. Nodes that shall live in that time are started with
-p use_sim_time:=true. Topics are played if they carry what the tools here read (Imu, NavSatFix, Temperature, Odometry,
...); --topics names them, and then any type whose Python package is installed. ROS arguments rename topics:
--ros-args -r /imu/data:=/other/imu."""


class Player:
    """Messages in the order of their log times, and their publishers on `node`."""

    def __init__(self, node: Node, bag: Bag, topics: list[str], memory: Memory):
        """Reads all messages of `topics`. Raises RecordingError if a type is not installed or there are no messages."""
        publishers = [_publisher(node, topic, bag.topics[topic]) for topic in topics]
        numbers = {topic: number for number, topic in enumerate(topics)}
        times, owners, messages = [], [], []
        for topic, stamps, raw, part in bag.read(topics):
            times += stamps
            owners += [numbers[topic]] * len(stamps)
            messages += raw
            size = np.mean([len(message) for message in raw]) if raw else 0.0
            Memory(memory.limit, memory.base, memory.each + size).check(f'{bag.path}', len(messages), part)
        if not messages:
            raise RecordingError(f"{bag.path} holds no messages on {', '.join(topics)}")
        order = np.argsort(np.asarray(times), kind='stable')
        self._times, self._owners = np.asarray(times)[order], np.asarray(owners)[order]
        self._messages, self._publishers = [messages[i] for i in order], publishers
        self._clock = node.create_publisher(Clock, '/clock', 10)  # reliable: heard by both kinds
        self.counts = dict(zip(topics, np.bincount(owners, minlength=len(topics)).tolist()))
        self.seconds = (self._times[-1] - self._times[0]) / SECOND

    def heard(self) -> bool:
        """Whether anybody has subscribed to one of the topics."""
        return any(publisher.get_subscription_count() for publisher in self._publishers)

    def play(self, start: float, rate: float, stop: Stop, tell) -> int:
        """Publish from `start` s on, `rate` times as fast as recorded; returns the number of messages. tell: called
        like Progress."""
        first = int(np.searchsorted(self._times, self._times[0] + round(start * SECOND)))
        if first == len(self._times):
            raise InputError(f'--start {start:g} is after the end of the recording, which is {self.seconds:.1f} s long')
        began, origin = time.monotonic(), int(self._times[first])
        for sent, i in enumerate(range(first, len(self._times))):
            stamp = int(self._times[i])
            due = began + (stamp - origin) / (SECOND * rate)
            while (wait := due - time.monotonic()) > 0 and not stop.requested:
                time.sleep(min(wait, _TICK))
                now = origin + round((time.monotonic() - began) * rate * SECOND)
                self._clock.publish(Clock(clock=time_message(min(now, stamp))))
            if stop.requested:
                return sent
            if wait <= 0 and (i == first or stamp > self._times[i - 1]):
                self._clock.publish(Clock(clock=time_message(stamp)))
            self._publishers[self._owners[i]].publish(self._messages[i])
            tell((i - first) / (len(self._times) - first), f'{(stamp - self._times[0]) / SECOND:.0f} s')
        for publisher in self._publishers:  # else what is still on its way is lost with the process
            publisher.wait_for_all_acked(_DELIVERY)
        return len(self._times) - first


def _publisher(node: Node, topic: str, kind: str):
    message = message_class(kind)
    if message is None:
        raise RecordingError(f"topic '{topic}' carries {kind}, and the Python package '{kind.split('/')[0]}' with that "
                             'type is not installed')
    kept = DurabilityPolicy.TRANSIENT_LOCAL if topic == '/tf_static' else DurabilityPolicy.VOLATILE
    return node.create_publisher(message, topic, QoSProfile(depth=_DEPTH, durability=kept))


def _topics(bag: Bag, asked: list[str] | None) -> list[str]:
    for topic in asked or ():
        if topic not in bag.topics:
            hint = did_you_mean(topic, bag.topics) or f"; there are {', '.join(sorted(bag.topics))}"
            raise RecordingError(f"no topic '{topic}' in {bag.path}{hint}")
    topics = asked or sorted(topic for topic, kind in bag.topics.items() if kind in READABLE and message_class(kind))
    if not topics:
        raise RecordingError(f'{bag.path} holds no topic that the tools here read; name others with --topics: '
                             f"{', '.join(sorted(bag.topics)) or 'it has none'}")
    return topics


def _wait_for_listeners(player: Player, seconds: float, stop: Stop) -> None:
    deadline = time.monotonic() + seconds
    if seconds > 0 and not player.heard():
        print(f'waiting for a subscriber, at most {seconds:g} s (--wait)', flush=True)
    while not (player.heard() or stop.requested or time.monotonic() > deadline):
        time.sleep(_TICK)
    if player.heard():
        time.sleep(_OTHERS)


def play(node: Node, options: argparse.Namespace, stop: Stop) -> None:
    """Play the recording as specified by `options`, until its end or a signal. Raises RecordingError and InputError."""
    if not 1e-3 <= options.rate <= 1e3:
        raise InputError(f'--rate must be from 0.001 to 1000, got {options.rate:g}')
    if not 0 <= options.start < 1e9:
        raise InputError(f'--start must be at least 0 s, got {options.start:g}')
    with Bag(options.bag) as bag:
        player = Player(node, bag, _topics(bag, options.topics), Memory(options.memory_limit, *_MEMORY))
        for line in bag.damage():
            print(line)
    counts = ', '.join(f'{count} on {topic}' for topic, count in player.counts.items())
    print(f'{options.bag}: {player.seconds:.1f} s, {counts}', flush=True)
    _wait_for_listeners(player, options.wait, stop)
    while not stop.requested:
        began = time.monotonic()
        with Progress(NAME) as tell:
            sent = player.play(options.start, options.rate, stop, tell)
        print(f'played {sent} messages in {time.monotonic() - began:.1f} s', flush=True)
        if not options.loop:
            return


def main(argv: list[str]) -> int:
    """Run the tool with `argv`, which may also hold ROS arguments; its exit status, 0 after a signal."""
    options = _parser().parse_args(remove_ros_args(argv))
    stop = Stop()
    rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
    node = Node(NAME)
    try:
        play(node, options, stop)
    except InputError as error:
        return refuse(NAME, error)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _parser() -> Parser:
    parser = Parser(NAME, DESCRIPTION)
    add = parser.add_argument
    add('bag', metavar='BAG', help='rosbag2 folder, .mcap, .db3 or ROS 1 .bag')
    add('--rate', type=float, default=1.0, metavar='R', help='times as fast as recorded (default %(default)g)')
    add('--topics', nargs='+', metavar='TOPIC', help='only these (default: all that the tools here read)')
    add('--start', type=float, default=0.0, metavar='S', help='skip this much of the recording')
    add('--loop', action='store_true', help='begin again at the end')
    add('--wait', type=float, default=10.0, metavar='S',
        help='for a subscriber before it begins, at most (default %(default)g)')
    add('--memory-limit', type=float, default=2.0, metavar='GB', help='a recording that takes more is refused '
        '(default %(default)g)')
    return parser
