"""What the diagnosis while driving costs the node: latency from a sample to its odometry, and processor time.

    python studies/benchmarks/bench_online.py [--rates 100 400] [--seconds 20] [--repeats 3] [--output FILE.md]

A simulated drive is published to `fusion_node` in its own time, fixes once a second, after PRELUDE s of it in an eighth
of the time, so that an analysis is running. With `diagnosis.online` off, `report`, and `apply` with a time offset of an
earlier drive applied, so that a filter without it runs in parallel. These three run one after the other, repeatedly:
other work on the machine disturbs all three, and the ratios to `off` of the same repeat say what the diagnosis costs.
All numbers are medians of the repeats, but the last three; after a colon the ratio to `off` (smallest to largest).

Latency: from before an Imu is published to after its Odometry has come back to this process (50 and 99 %, ms), by way
of two processes and DDS. On a busy machine most of it is waiting for a core that other processes have. So *work* is
told as well: processor time of a sample's callback, from the message to the published odometry (`time.thread_time_ns`,
in the node), which what else runs does not change but by the caches. It is what the node adds to the latency on a
machine with a free core, without waking up: 0.4 ms where each sample is waited for, and nothing where they queue.

CPU: of the node and of its diagnosis, as a part of a core, while samples come in their own time. Most: the largest part
of a core that the diagnosis had in any WINDOW s, its start included; `diagnosis.share` is 0.1. Load: smallest and
largest of the machine before the runs.
"""
from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
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

from mems_ins_fusion.nodes import fusion_node
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
#: %, of the samples, within the numbers of the table
SHARES = (50, 99)
#: the first argument of a process that is a node
TIMED = '--timed-node'
#: s for which a node may be behind
PATIENCE = 60.0
#: s over which the largest part of a core is taken: many periods of `diagnosis.worker`, few ticks of the CPU time
WINDOW = 5.0


def timed_node(file: str, arguments: list[str]) -> int:
    """The node, which writes the stamp of each sample, ns, and the work of its callback, ns, to `file`."""
    node = fusion_node.FusionNode
    rows, on_imu, serve = [], node._on_imu, node.serve

    def timed(self, message, info):
        stamp, begin = message.header.stamp, time.thread_time_ns()
        on_imu(self, message, info)
        rows.append((stamp.sec * 10**9 + stamp.nanosec, time.thread_time_ns() - begin))

    def served(self, stop):
        try:
            return serve(self, stop)
        finally:  # nothing runs after the node has ended
            np.save(file, np.array(rows, dtype=np.int64))
    node._on_imu, node.serve = timed, served
    return fusion_node.main(arguments)


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

    def wait(self) -> None:
        """Until what was published has come back: on a slow computer the node is behind."""
        came, deadline = -1, time.perf_counter() + PATIENCE
        while came < len(self.back) and time.perf_counter() < deadline:
            came = len(self.back)
            time.sleep(1.0)


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


class Share:
    """CPU time of the processes of a node's diagnosis, looked at twice a second until `stop`."""

    def __init__(self, pid: int):
        self._pid, self._over = pid, threading.Event()
        self._seen: list[tuple[float, float]] = []  # time and CPU time, s
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def _look(self):
        while not self._over.wait(0.5):
            try:
                self._seen.append((time.perf_counter(), _cpu(_descendants(self._pid))))
            except OSError:  # one of them has just ended
                continue

    def stop(self) -> float:
        """The largest part of a core in any WINDOW s."""
        self._over.set()
        self._thread.join()
        clock, cpu = np.array(self._seen or [(0.0, 0.0)]).T
        later = np.searchsorted(clock, clock + WINDOW)
        inside = later < len(clock)
        first, last = np.flatnonzero(inside), later[inside]
        return float(np.max((cpu[last] - cpu[first]) / (clock[last] - clock[first]), initial=0.0))


def measured(recording, mode: str, seconds: float, rate: float, folder: Path) -> dict[str, float]:
    """One run of the node."""
    state = folder / 'state.json'
    place = {'stamp': 10**9, 'latitude': 0.8, 'longitude': 0.2, 'height': 0.0}
    kept = {'name': 'gnss_time_offset', 'set': {'gnss.time_offset': OFFSET}, 'found': 0,
            'topics': {'imu_topic': '/imu/data', 'gnss_topic': '/gps/fix'},
            'parameters': {'time_offset': [OFFSET, 0.01, 's']}}
    state.write_text(json.dumps({'version': 2, 'filter': place, 'calibration': [kept]}))
    load = os.getloadavg()[0]
    log = (folder / 'log').open('w')
    times = folder / 'times.npy'
    node = subprocess.Popen([sys.executable, __file__, TIMED, str(times), '--ros-args', '-p',
                             f'diagnosis.online:={mode}', '-p', f'state_file:={state}'], stdout=log, stderr=log)
    publisher, share = Publisher(recording), Share(node.pid)
    try:
        while 'ready: ' not in (folder / 'log').read_text():
            if node.poll() is not None:
                raise SystemExit((folder / 'log').read_text())
            time.sleep(0.2)
        publisher.publish(0.0, PRELUDE, FASTER, PRELUDE_RATE)
        publisher.wait()
        publisher.sent.clear()
        diagnosis = _descendants(node.pid)
        before = _cpu([node.pid]), _cpu(diagnosis)
        publisher.publish(PRELUDE, PRELUDE + seconds, 1.0, rate)
        node_cpu, diagnosis_cpu = _cpu([node.pid]) - before[0], _cpu(diagnosis) - before[1]
        publisher.wait()
        most = share.stop()
    finally:
        node.send_signal(signal.SIGINT)
        node.wait(30.0)
        publisher.close()
    late = np.array([publisher.back[key] - sent for key, sent in publisher.sent.items() if key in publisher.back])
    if not len(late):
        raise SystemExit('no odometry has come back: ' + (folder / 'log').read_text())
    stamps, work = np.load(times).T
    work = work[stamps >= recording.imu.stamp[0] + round(PRELUDE * 1e9)]
    return {**{f'latency {share}': 1e3 * np.percentile(late, share) for share in SHARES},
            **{f'work {share}': 1e-3 * np.percentile(work, share) for share in SHARES},
            'node': node_cpu / seconds, 'diagnosis': diagnosis_cpu / seconds, 'most': most,
            'lost': len(publisher.sent) - len(late), 'load': load}


def row(rate: float, mode: str, runs: list[dict[str, float]], off: list[dict[str, float]]) -> str:
    """A line of the table: `runs` of a mode beside those with `off` of the same repeats."""
    def middle(name: str) -> float:
        return statistics.median(run[name] for run in runs)

    def compared(name: str, digits: int) -> str:
        if runs is off:
            return f'{middle(name):.{digits}f}'
        ratios = [run[name] / other[name] for run, other in zip(runs, off)]
        return f'{middle(name):.{digits}f}: {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})'

    loads = [run['load'] for run in runs]
    cells = (f'{rate:g} Hz', mode, *(compared(f'work {share}', 0) for share in SHARES),
             *(compared(f'latency {share}', 1) for share in SHARES),
             f"{100 * middle('node'):.1f} %", f"{100 * middle('diagnosis'):.1f} %",
             f"{100 * max(run['most'] for run in runs):.1f} %", f"{sum(run['lost'] for run in runs):.0f}",
             f'{min(loads):.1f} to {max(loads):.1f}')
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--rates', type=float, nargs='+', default=[100.0, 400.0])
    parser.add_argument('--seconds', type=float, default=20.0)
    parser.add_argument('--repeats', type=int, default=3)
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_DOMAIN_ID', '101')
    rclpy.init()
    lines = ['| samples | `diagnosis.online` | work 50 %, us | 99 % | latency 50 %, ms | 99 % | node | diagnosis '
             '| most | lost | load |', f'|{"---|" * 11}']
    for rate in options.rates:
        sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
        recording = simulate_recording(simulate_drive(PRELUDE + options.seconds + 2.0, 1, rate=rate, standstill=10.0),
                                       sensors, GnssNoise(0.5), seed=1).recording
        runs: dict[str, list[dict[str, float]]] = {mode: [] for mode in MODES}
        for mode in MODES * options.repeats:
            with tempfile.TemporaryDirectory() as folder:
                runs[mode].append(measured(recording, mode, options.seconds, rate, Path(folder)))
            print(f'{rate:g} Hz', mode, *(f'{name} {value:.4g}' for name, value in runs[mode][-1].items()), flush=True)
        lines += [row(rate, mode, runs[mode], runs['off']) for mode in MODES]
    rclpy.shutdown()
    print(*lines, sep='\n')
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    if sys.argv[1:2] == [TIMED]:
        sys.exit(timed_node(sys.argv[2], sys.argv[3:]))
    main()
