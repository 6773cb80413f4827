"""What the diagnosis while driving costs the node: latency from a sample to its odometry, and processor time.

    python studies/online_costs.py [--rates 100 400] [--seconds 60] [--output FILE.md]

A simulated drive is published to `fusion_node` in its own time, fixes once a second, after PRELUDE s of it in an eighth
of the time, so that an analysis is running. With `diagnosis.online` off, `report`, and `apply` with a time offset of an
earlier drive applied, so that a filter without it runs beside. Latency: from before an Imu is published to after its
Odometry has come back to this process (median and 99 %, ms), by way of two processes and DDS. CPU: of the node and of
its diagnosis (`diagnosis.share` 0.1), as a part of a core. Load: of the machine before each run, as it was found.
"""
from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu, NavSatFix

from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_drive, simulate_recording

TICK = os.sysconf('SC_CLK_TCK')
#: s of the drive before anything is measured: an analysis begins with its second minute, and takes some
PRELUDE, FASTER = 125.0, 8.0
#: Hz, that is published of the samples in that time
PRELUDE_RATE = 100.0
#: s, by which fixes are late, which an earlier drive has found
OFFSET = 0.05
MODES = ('off', 'report', 'apply')


class Publisher:
    """Publishes a recording, and notes when each sample went out and its odometry came back."""

    def __init__(self, recording):
        self.node = rclpy.create_node('online_costs')
        self.imu = self.node.create_publisher(Imu, '/imu/data', QoSProfile(depth=1000))
        self.fix = self.node.create_publisher(NavSatFix, '/gps/fix', QoSProfile(depth=10))
        self.node.create_subscription(Odometry, '/odometry/fused', self._on_odometry, QoSProfile(depth=1000))
        self.recording, self.sent, self.back = recording, {}, {}
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        threading.Thread(target=self._executor.spin, daemon=True).start()

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()

    def _on_odometry(self, message):
        self.back[message.header.stamp.sec, message.header.stamp.nanosec] = time.perf_counter()

    def publish(self, begin: float, end: float, faster: float, rate: float) -> None:
        """From `begin` to `end`, s after the first sample, so many times as fast as it was, at `rate` Hz."""
        imu, gnss = self.recording.imu, self.recording.gnss
        seconds, fixes = ((s.stamp - imu.stamp[0]) * 1e-9 for s in (imu, gnss))
        step = max(round(1.0 / (rate * (seconds[1] - seconds[0]))), 1)
        began, fix = time.perf_counter(), int(np.searchsorted(fixes, begin))
        for i in range(int(np.searchsorted(seconds, begin)), int(np.searchsorted(seconds, end)), step):
            wait = began + (seconds[i] - begin) / faster - time.perf_counter()
            if wait > 0.0:
                time.sleep(wait)
            while fix < len(fixes) and fixes[fix] < seconds[i]:
                self.fix.publish(_fix(gnss, fix))
                fix += 1
            message = _imu(imu, i)
            self.sent[message.header.stamp.sec, message.header.stamp.nanosec] = time.perf_counter()
            self.imu.publish(message)


def _stamped(message, stamp: int):
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(stamp), 10**9)
    return message


def _imu(imu, i: int) -> Imu:
    message = _stamped(Imu(), imu.stamp[i])
    force, rate = message.linear_acceleration, message.angular_velocity
    force.x, force.y, force.z = imu.specific_force[i].tolist()
    rate.x, rate.y, rate.z = imu.angular_rate[i].tolist()
    message.orientation_covariance[0] = -1.0
    return message


def _fix(gnss, i: int) -> NavSatFix:
    message = _stamped(NavSatFix(), gnss.stamp[i])
    message.latitude, message.longitude = np.degrees([gnss.latitude[i], gnss.longitude[i]]).tolist()
    message.altitude = float(gnss.height[i])
    message.position_covariance = gnss.covariance[i].ravel()
    message.position_covariance_type = int(gnss.covariance_type[i])
    message.status.status = int(gnss.status[i])
    return message


def _cpu(pids: list[int]) -> float:
    """Seconds of processor time that the processes have had."""
    total = 0
    for pid in pids:
        parts = Path(f'/proc/{pid}/stat').read_text().rpartition(') ')[2].split()
        total += int(parts[11]) + int(parts[12])
    return total / TICK


def _descendants(pid: int) -> list[int]:
    found = []
    for path in Path('/proc').glob('[0-9]*/stat'):
        try:
            if int(path.read_text().rpartition(') ')[2].split()[1]) == pid:
                found += [int(path.parent.name), *_descendants(int(path.parent.name))]
        except OSError:
            continue
    return found


def measured(recording, mode: str, seconds: float, rate: float, folder: Path) -> str:
    """A line of the table."""
    state = folder / 'state.json'
    place = {'stamp': 10**9, 'latitude': 0.8, 'longitude': 0.2, 'height': 0.0}
    kept = {'name': 'gnss_time_offset', 'set': {'gnss.time_offset': OFFSET}, 'found': 0,
            'topics': {'imu_topic': '/imu/data', 'gnss_topic': '/gps/fix'},
            'parameters': {'time_offset': [OFFSET, 0.01, 's']}}
    state.write_text(json.dumps({'version': 2, 'filter': place, 'calibration': [kept]}))
    load = os.getloadavg()[0]
    log = (folder / 'log').open('w')
    node = subprocess.Popen([sys.executable, '-m', 'mems_ins_fusion', 'fusion_node', '--ros-args', '-p',
                             f'diagnosis.online:={mode}', '-p', f'state_file:={state}'], stdout=log, stderr=log)
    publisher = Publisher(recording)
    try:
        while 'ready: ' not in (folder / 'log').read_text() and node.poll() is None:
            time.sleep(0.2)
        publisher.publish(0.0, PRELUDE, FASTER, PRELUDE_RATE)
        time.sleep(2.0)
        publisher.sent.clear()
        diagnosis = _descendants(node.pid)
        before = _cpu([node.pid]), _cpu(diagnosis)
        publisher.publish(PRELUDE, PRELUDE + seconds, 1.0, rate)
        time.sleep(1.0)
        cpu = (_cpu([node.pid]) - before[0]) / seconds, (_cpu(diagnosis) - before[1]) / seconds
    finally:
        node.send_signal(signal.SIGINT)
        node.wait(30.0)
        publisher.close()
    late = np.array([publisher.back[key] - sent for key, sent in publisher.sent.items() if key in publisher.back])
    median, most = 1e3 * np.percentile(late, [50, 99])
    return (f'| {rate:g} Hz | {mode} | {len(publisher.sent)} | {len(publisher.sent) - len(late)} | {median:.2f} | '
            f'{most:.1f} | {100 * cpu[0]:.0f} % | {100 * cpu[1]:.0f} % | {load:.1f} |')


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--rates', type=float, nargs='+', default=[100.0, 400.0])
    parser.add_argument('--seconds', type=float, default=60.0)
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init()
    lines = ['| samples | `diagnosis.online` | sent | without odometry | latency 50 %, ms | 99 %, ms | node '
             '| diagnosis | load |', f'|{"---|" * 9}']
    print(*lines, sep='\n', flush=True)
    for rate in options.rates:
        sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
        recording = simulate_recording(simulate_drive(PRELUDE + options.seconds + 2.0, 1, rate=rate, standstill=10.0),
                                       sensors, GnssNoise(0.5), seed=1).recording
        for mode in MODES:
            with tempfile.TemporaryDirectory() as folder:
                lines.append(measured(recording, mode, options.seconds, rate, Path(folder)))
            print(lines[-1], flush=True)
    rclpy.shutdown()
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
