"""The live node under all of its traffic at once, in real time: is anything lost, do services answer, does memory grow?

    python studies/node_soak.py [--minutes 60] [--imu 100] [--speed 100] [--velocity 0] [--heading 0] [--pressure 0]
                                [--rear 0] [--clock 1000] [--seed 1] [--output FILE.md] [-p NAME:=VALUE ...]

A simulated drive is published with the timing it has: Imu, NavSatFix at 5 Hz, wheel speed, velocity, heading, pressure
and the fixes of a second receiver 1.6 m behind the first at the rates asked for (Hz), and /clock, in whose time the
node lives (0: no /clock, and the node lives in the computer's). Once a second a service of the node is called,
`~/use_fixes` and `get_parameters` in turn. Each minute a line tells, for each input, how many messages the node has
lost, how many the filter did not take, the slowest answer of a service, the node's CPU, the machine's load, and the
node's memory.

Publisher and listener are processes of their own; what the node got is told by its own /diagnostics.
"""
from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

TICK, PAGE = os.sysconf('SC_CLK_TCK'), os.sysconf('SC_PAGE_SIZE')
TOPICS = {'imu': '/imu/data', 'fix': '/gps/fix', 'speed': '/wheel/speed', 'velocity': '/gps/velocity',
          'heading': '/gps/heading', 'pressure': '/pressure', 'rear': '/rear/fix'}
#: parameters of the second receiver
REAR = {'inputs': ['rear'], 'rear.type': 'fix', 'rear.topic': TOPICS['rear'], 'rear.lever_arm': [-1.6, 0.0, 0.0]}
_SECOND = 10**9  # ns
#: until publisher and node have found each other, s
SETTLE = 4.0


def drive(options: argparse.Namespace) -> None:
    """Publish, and print once a second how many of each kind have been sent."""
    import rclpy
    from geometry_msgs.msg import PoseWithCovarianceStamped, TwistWithCovarianceStamped
    from rclpy.qos import QoSProfile
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import FluidPressure, Imu, NavSatFix

    from mems_ins_fusion.filter.measurements.registry import aiding
    from mems_ins_fusion.parameters import table
    from mems_ins_fusion.simulation.simulation import (
        GnssNoise,
        SensorErrors,
        SimulatedAiding,
        simulate_drive,
        simulate_recording,
    )

    seconds = 60.0 * options.minutes
    motion = simulate_drive(seconds, seed=options.seed, rate=options.imu, standstill=10.0)
    recording = simulate_recording(
        motion, SensorErrors.from_parameters(table.defaults(), 'gauss_markov'), GnssNoise(sigma=1.0, rate=5.0),
        seed=options.seed, aiding=SimulatedAiding(speed_rate=options.speed, velocity_rate=options.velocity,
                                                  heading_rate=options.heading, pressure_rate=options.pressure,
                                                  fix_rate=options.rear, fix_sigma=1.0),
        named=[one for one in aiding(table.check(REAR)) if not one.is_plain] if options.rear else []).recording
    streams = recording.streams()
    parts = {'imu': recording.imu, 'fix': recording.gnss,
             **{name: streams[name] for name in TOPICS if streams.get(name) is not None}}
    kinds = {'imu': Imu, 'fix': NavSatFix, 'rear': NavSatFix, 'speed': TwistWithCovarianceStamped,
             'velocity': TwistWithCovarianceStamped, 'heading': PoseWithCovarianceStamped, 'pressure': FluidPressure}
    rclpy.init()
    node = rclpy.create_node('driver')
    qos = QoSProfile(depth=1000)
    publishers = {name: node.create_publisher(kinds[name], TOPICS[name], qos) for name in parts}
    clock = node.create_publisher(Clock, '/clock', 10)
    messages = {name: kinds[name]() for name in parts}
    for name, message in messages.items():
        message.header.frame_id = name
    fillers = {name: _filler(name, parts[name], messages[name]) for name in parts}
    names = list(parts)
    offset = 0 if options.clock else time.time_ns() + round((SETTLE + 1.0) * _SECOND) - int(recording.imu.stamp[0])
    due = np.concatenate([parts[name].received for name in names])
    owner = np.repeat(np.arange(len(names)), [len(parts[name].received) for name in names])
    index = np.concatenate([np.arange(len(parts[name].received)) for name in names])
    order = np.argsort(due, kind='stable')
    due, owner, index = (column[order].tolist() for column in (due, owner, index))
    while not publishers['imu'].get_subscription_count():
        time.sleep(0.05)
    time.sleep(SETTLE)
    sent, told, tick, next_tick = dict.fromkeys([*names, 'clock'], 0), 0.0, round(_SECOND / max(options.clock, 1.0)), 0
    origin, began, ticks = due[0], time.monotonic(), Clock()
    for k in range(len(due)):
        while True:
            ahead = due[k] - origin - round((time.monotonic() - began) * _SECOND)
            now = min(due[k] - max(ahead, 0), due[k])
            if options.clock and now >= next_tick:
                ticks.clock.sec, ticks.clock.nanosec = divmod(now, _SECOND)
                clock.publish(ticks)
                sent['clock'] += 1
                next_tick = now + tick
            if ahead <= 0:
                break
            time.sleep(min(ahead * 1e-9, 1.0 / max(options.clock, 100.0)))
        name = names[owner[k]]
        stamp = messages[name].header.stamp
        stamp.sec, stamp.nanosec = divmod(int(parts[name].stamp[index[k]]) + offset, _SECOND)
        fillers[name](index[k])
        publishers[name].publish(messages[name])
        sent[name] += 1
        if now * 1e-9 - told >= 1.0:
            told = now * 1e-9
            print(json.dumps(sent), flush=True)
    print(json.dumps(sent), flush=True)
    time.sleep(3.0)
    rclpy.shutdown()


def _filler(name, samples, message):
    """A function that writes sample i into `message`, all but its stamp."""
    from mems_ins_fusion.navigation.frames import yaw_from_enu  # its own inverse

    if name == 'imu':
        message.orientation_covariance[0] = -1.0
        force, rate = samples.specific_force.tolist(), samples.angular_rate.tolist()
        f, w = message.linear_acceleration, message.angular_velocity

        def fill(i):
            f.x, f.y, f.z = force[i]
            w.x, w.y, w.z = rate[i]
    elif name in ('fix', 'rear'):
        latitude, longitude = np.degrees(samples.latitude).tolist(), np.degrees(samples.longitude).tolist()
        message.position_covariance_type = 2

        def fill(i):
            message.latitude, message.longitude, message.altitude = latitude[i], longitude[i], float(samples.height[i])
            message.position_covariance[:] = samples.covariance[i].ravel()
            message.status.status = int(samples.status[i])
    elif name == 'speed':
        def fill(i):
            message.twist.twist.linear.x = float(samples.speed[i])
            message.twist.covariance[0] = float(samples.variance[i])
    elif name == 'velocity':
        def fill(i):
            north, east, down = samples.velocity[i].tolist()
            linear, p = message.twist.twist.linear, samples.covariance[i]
            linear.x, linear.y, linear.z = east, north, -down
            message.twist.covariance[[0, 7, 14]] = p[1, 1], p[0, 0], p[2, 2]
    elif name == 'pressure':
        def fill(i):
            message.fluid_pressure, message.variance = float(samples.pressure[i]), float(samples.variance[i])
    else:
        def fill(i):
            yaw = float(yaw_from_enu(samples.yaw[i]))
            q = message.pose.pose.orientation
            q.w, q.z = float(np.cos(yaw / 2)), float(np.sin(yaw / 2))
            message.pose.covariance[35] = float(samples.variance[i])
    return fill


class Listener:
    """Hears /diagnostics and calls services; spins in the time that the caller gives it."""

    def __init__(self):
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from rcl_interfaces.srv import GetParameters
        from rclpy.executors import SingleThreadedExecutor
        from std_srvs.srv import SetBool

        rclpy.init()
        self._node = rclpy.create_node('listener')
        self.statuses: dict[str, dict[str, str]] = {}
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 20)
        self._calls = [
            (self._node.create_client(SetBool, '/fusion_node/use_fixes'), SetBool.Request(data=True)),
            (self._node.create_client(GetParameters, '/fusion_node/get_parameters'),
             GetParameters.Request(names=['imu_topic']))]
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.answers: list[float] = []

    def _on_diagnostics(self, message):
        for status in message.status:
            name = status.name.removeprefix('fusion_node: ')
            self.statuses[name] = {pair.key: pair.value for pair in status.values} | {'message': status.message}

    def call(self, timeout: float = 10.0) -> None:
        """Call the next service, and keep how long it took, s; inf where it did not answer."""
        client, request = self._calls[len(self.answers) % 2]
        began = time.monotonic()
        answer = client.call_async(request)
        while not answer.done() and time.monotonic() - began < timeout:
            self._executor.spin_once(timeout_sec=0.05)
        self.answers.append(time.monotonic() - began if answer.done() else float('inf'))

    def wait(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)


def usage(pid: int) -> tuple[float, float]:
    """CPU seconds used so far, and resident megabytes."""
    fields = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICK, int(fields[21]) * PAGE / 1e6


def not_taken(status: dict[str, str]) -> int:
    """Measurements of an input that the filter had and did not take, whatever the reason."""
    return sum(int(value) for key, value in status.items() if key.startswith('refused'))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--minutes', type=float, default=60.0)
    for option, rate in (('--imu', 100.0), ('--speed', 100.0), ('--velocity', 0.0), ('--heading', 0.0),
                         ('--pressure', 0.0), ('--rear', 0.0), ('--clock', 1000.0)):
        parser.add_argument(option, type=float, default=rate, metavar='HZ')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--output', type=Path)
    parser.add_argument('-p', action='append', default=[], metavar='NAME:=VALUE', help='parameters of fusion_node')
    parser.add_argument('--drive', action='store_true', help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.drive:
        drive(options)
        return
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', '101')
    rates = {name: getattr(options, name) for name in ('speed', 'velocity', 'heading', 'pressure')}
    second = [f'{name}:={json.dumps(value)}' for name, value in REAR.items()] if options.rear else []
    parameters = [f'use_sim_time:={"true" if options.clock else "false"}',
                  *(f'{name}_topic:={TOPICS[name]}' for name, rate in rates.items() if rate), *second, *options.p]
    node = subprocess.Popen([sys.executable, '-m', 'mems_ins_fusion', 'fusion_node', '--ros-args',
                             *(part for value in parameters for part in ('-p', value))],
                            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    driver = subprocess.Popen([sys.executable, *sys.argv, '--drive'], stdout=subprocess.PIPE)
    lines = ['| minute | sent | lost | not taken | slowest answer, s | CPU, % | load | MB |', '|' + '---|' * 8]
    print(*lines, sep='\n', flush=True)
    try:
        soak(options, node, driver, lines)
    finally:
        for process in (driver, node):
            process.terminate()
            process.wait(20)
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


def newest(driver: subprocess.Popen) -> dict[str, int] | None:
    """What the driver said last of how much it has sent; None where it has said nothing since."""
    found = re.findall(rb'\{[^}]*\}', driver.stdout.read() or b'')
    return json.loads(found[-1]) if found else None


def soak(options, node, driver, lines: list[str]) -> None:
    """Listen until the driver has ended; a line each minute into `lines`."""
    listener, sent, minute, called = Listener(), {}, 0, 0
    os.set_blocking(driver.stdout.fileno(), False)
    before, then = usage(node.pid)[0], time.monotonic()
    while driver.poll() is None:
        listener.wait(1.0)
        sent = newest(driver) or sent
        if not sent:
            before, then = usage(node.pid)[0], time.monotonic()
            continue
        listener.call()
        if driver.poll() is None and time.monotonic() - then < 60.0:
            continue
        listener.wait(1.2)  # the last second's messages are on the next /diagnostics
        sent = newest(driver) or sent
        cpu, memory = usage(node.pid)
        minute, share = minute + 1, 100 * (cpu - before) / (time.monotonic() - then)
        before, then = cpu, time.monotonic()
        heard = {name: listener.statuses.get(name, {}) for name in sent if name != 'clock'}
        lost = ', '.join(f"{name} {values.get('lost', '?')}" for name, values in heard.items())
        refused = ', '.join(f'{name} {not_taken(values)}' for name, values in heard.items())
        answers, called = listener.answers[called:], len(listener.answers)
        line = (f"| {minute} | {', '.join(f'{name} {n}' for name, n in sent.items())} | {lost} | {refused} | "
                f'{max(answers, default=0.0):.3f} | {share:.0f} | {os.getloadavg()[0]:.1f} | {memory:.1f} |')
        lines.append(line)
        print(line, flush=True)
    got = {name: int(values.get('messages', 0)) for name, values in heard.items()}
    half, most, longest = np.quantile(listener.answers, (0.5, 0.99, 1.0))
    said = (f'Sent {sum(sent[name] for name in got)}, heard {sum(got.values())}: '
            + ', '.join(f'{name} {sent[name] - n} of {sent[name]} not heard' for name, n in got.items())
            + f". {sent['clock']} messages on /clock. {len(listener.answers)} calls of services: half were answered "
            f'within {half:.3f} s, 99 % within {most:.3f}, the slowest after {longest:.3f} s.')
    lines += ['', said]
    print(said)


if __name__ == '__main__':
    main()
