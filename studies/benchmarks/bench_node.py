"""fusion_node beside a bare rclpy node that receives and publishes the same messages: CPU, latency, loss, memory.

    python studies/benchmarks/bench_node.py [--rate 400] [--seconds 20] [--repeats 3] [-p NAME:=VALUE ...]

Three processes: a driver (Imu at `rate`, NavSatFix at 5 Hz, stamped with the time they are sent at), the node, and a
listener. CPU is that of the node's process per IMU message; latency is from the driver's stamp to the listener. Both
nodes run one after the other, repeatedly; what is printed are medians of the repeats. *heard* is what the node itself
has got of the driver's Imu messages, *received* what the listener has got of its odometry.
"""
from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

TICK = os.sysconf('SC_CLK_TCK')
PAGE = os.sysconf('SC_PAGE_SIZE')
#: until all have found each other, s
SETTLE = 3.0
#: of the queue of each subscription, the node's own
DEPTH = 4000
START = '[48.0, 11.0, 500.0, 0.0]'


def drive(rate: float, seconds: float) -> None:
    """Publish, and print how many Imu were sent."""
    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import Imu, NavSatFix

    rclpy.init()
    node = rclpy.create_node('driver')
    qos = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
    imu, fix = node.create_publisher(Imu, '/imu/data', qos), node.create_publisher(NavSatFix, '/gps/fix', qos)
    sample, place = Imu(), NavSatFix(latitude=48.0, longitude=11.0, altitude=500.0, position_covariance_type=2)
    sample.header.frame_id, place.header.frame_id = 'imu', 'gps'
    sample.linear_acceleration.z, sample.orientation_covariance[0] = 9.81, -1.0
    place.position_covariance[[0, 4, 8]] = 1.0
    rng = np.random.default_rng(1)
    while not imu.get_subscription_count():
        time.sleep(0.05)
    time.sleep(SETTLE)
    count, began = round(rate * seconds), time.monotonic()
    for k in range(count):
        time.sleep(max(0.0, began + k / rate - time.monotonic()))
        noise = rng.standard_normal(6).tolist()
        sample.linear_acceleration.x, sample.linear_acceleration.y = 0.05 * noise[0], 0.05 * noise[1]
        sample.angular_velocity.z = 1e-3 * noise[2]
        for message, publisher in ((sample, imu), *(((place, fix),) if k % round(rate / 5) == 0 else ())):
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(time.time_ns(), 10**9)
            publisher.publish(message)
    time.sleep(1.0)
    print(json.dumps({'sent': count}), flush=True)
    rclpy.shutdown()


def listen(seconds: float) -> None:
    """Count and time the odometry; print it."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from nav_msgs.msg import Odometry

    rclpy.init()
    node = rclpy.create_node('listener')
    latency, heard = [], [0]

    def on_diagnostics(message):
        for status in message.status:
            if status.name.endswith(': imu'):
                heard[0] = next(int(pair.value) for pair in status.values if pair.key == 'messages')

    def on_odometry(message):
        stamp = message.header.stamp
        latency.append(time.time_ns() - stamp.sec * 10**9 - stamp.nanosec)

    node.create_subscription(Odometry, '/odometry/fused', on_odometry, DEPTH)
    node.create_subscription(DiagnosticArray, '/diagnostics', on_diagnostics, 10)
    last, seen = time.monotonic(), 0
    while time.monotonic() - last < 4.0 + SETTLE:  # until it has been silent for a while
        rclpy.spin_once(node, timeout_sec=0.1)
        if len(latency) != seen:
            last, seen = time.monotonic(), len(latency)
        elif not seen:
            last = time.monotonic()
    print(json.dumps({'received': len(latency), 'heard': heard[0], 'p50_us': float(np.percentile(latency, 50) / 1e3),
                      'p99_us': float(np.percentile(latency, 99) / 1e3)}), flush=True)
    rclpy.shutdown()


def bare() -> None:
    """Receive Imu and NavSatFix and publish Odometry and NavSatFix, as fusion_node does, computing nothing but how many
    Imu it has heard, on /diagnostics."""
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
    from nav_msgs.msg import Odometry
    from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import Imu, NavSatFix

    rclpy.init()
    node = rclpy.create_node('fusion_node')
    quiet = {'event_callbacks': PublisherEventCallbacks(use_default_callbacks=False)}
    odometry = node.create_publisher(Odometry, '/odometry/fused', 10, **quiet)
    fix = node.create_publisher(NavSatFix, '/fix/fused', 10, **quiet)
    diagnostics, heard = node.create_publisher(DiagnosticArray, '/diagnostics', 10, **quiet), [0]
    out, place = Odometry(child_frame_id='base_link'), NavSatFix()
    out.header.frame_id = 'odom'

    def on_imu(message):
        stamp = message.header.stamp
        out.header.stamp.sec, out.header.stamp.nanosec = stamp.sec, stamp.nanosec
        place.header.stamp.sec, place.header.stamp.nanosec = stamp.sec, stamp.nanosec
        odometry.publish(out)
        fix.publish(place)
        heard[0] += 1

    def tell():
        status = DiagnosticStatus(name='bare: imu', values=[KeyValue(key='messages', value=str(heard[0]))])
        diagnostics.publish(DiagnosticArray(status=[status]))

    node.create_timer(1.0, tell)

    for kind, topic, callback in ((NavSatFix, '/gps/fix', lambda message: None), (Imu, '/imu/data', on_imu)):
        node.create_subscription(kind, topic, callback, QoSProfile(depth=DEPTH,
                                                                   reliability=ReliabilityPolicy.BEST_EFFORT),
                                 event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False))
    print('ready', flush=True)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while True:
        executor.spin_once()


def cpu_and_memory(pid: int) -> tuple[float, float]:
    """CPU seconds used so far, and resident megabytes."""
    fields = Path(f'/proc/{pid}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICK, int(fields[21]) * PAGE / 1e6


def measure(kind: str, rate: float, seconds: float, more: list[str]) -> dict:
    """One run of the node `kind`."""
    me = [sys.executable, __file__]
    command = [*me, '--role', 'bare'] if kind == 'bare' else [
        sys.executable, '-m', 'mems_ins_fusion', 'fusion_node', '--ros-args', '-p', f'start_pose:={START}',
        *(part for value in more for part in ('-p', value))]
    node = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        for line in node.stdout:
            if 'ready' in line:
                break
        os.set_blocking(node.stdout.fileno(), False)
        listener = subprocess.Popen([*me, '--role', 'listen'], stdout=subprocess.PIPE, text=True)
        driver = subprocess.Popen([*me, '--role', 'drive', '--rate', str(rate), '--seconds', str(seconds)],
                                  stdout=subprocess.PIPE, text=True)
        time.sleep(1.0 + SETTLE + 0.25 * seconds)
        before = time.monotonic(), *cpu_and_memory(node.pid)
        time.sleep(0.5 * seconds)
        after = time.monotonic(), *cpu_and_memory(node.pid)
        result = {**json.loads(driver.communicate()[0]), **json.loads(listener.communicate()[0])}
    finally:
        node.terminate()
        node.wait(10)
    wall, cpu = after[0] - before[0], after[1] - before[1]
    return {**result, 'cpu_us': 1e6 * cpu / (rate * wall), 'memory_mb': after[2], 'grown_mb': after[2] - before[2]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--rate', type=float, default=400.0)
    parser.add_argument('--seconds', type=float, default=20.0)
    parser.add_argument('--repeats', type=int, default=3)
    parser.add_argument('-p', action='append', default=[], metavar='NAME:=VALUE', help='parameters of fusion_node')
    parser.add_argument('--role', choices=('drive', 'listen', 'bare'), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.role:
        {'drive': lambda: drive(arguments.rate, arguments.seconds), 'listen': lambda: listen(arguments.seconds),
         'bare': bare}[arguments.role]()
        return
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', '101')
    runs = {kind: [] for kind in ('bare', 'fusion_node')}
    for _ in range(arguments.repeats):
        for kind, results in runs.items():
            results.append(measure(kind, arguments.rate, arguments.seconds, arguments.p))
    medians = {kind: {name: statistics.median(r[name] for r in results) for name in results[0]}
               for kind, results in runs.items()}
    print(f'{"":12s} {"sent":>6s} {"heard":>6s} {"received":>9s} {"CPU us/sample":>14s} {"p50 us":>7s} '
          f'{"p99 us":>7s} {"MB":>6s} {"grown MB":>9s}')
    for kind, m in medians.items():
        print(f'{kind:12s} {m["sent"]:6.0f} {m["heard"]:6.0f} {m["received"]:9.0f} {m["cpu_us"]:14.0f} '
              f'{m["p50_us"]:7.0f} {m["p99_us"]:7.0f} {m["memory_mb"]:6.0f} {m["grown_mb"]:9.2f}')
    bare_, fusion = medians.values()
    print(f'CPU ratio {fusion["cpu_us"] / bare_["cpu_us"]:.2f}; latency added: '
          f'{fusion["p50_us"] - bare_["p50_us"]:.0f} us at 50 %, '
          f'{fusion["p99_us"] - bare_["p99_us"]:.0f} us at 99 %')


if __name__ == '__main__':
    main()
