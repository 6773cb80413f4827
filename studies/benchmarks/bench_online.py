"""What the diagnosis while driving costs the node: latency from a sample to its odometry, and processor time.

    python studies/benchmarks/bench_online.py [--rates 100 400] [--seconds 20] [--repeats 3] [--output FILE.md]

A simulated drive is published to `fusion_node` in its own time, fixes once a second, after PRELUDE s of it in an eighth
of the time, so that an analysis is running. With `diagnosis.online` off, `report`, and `apply` with a time offset of an
earlier drive applied, so that a filter without it runs in parallel. These three run one after the other, repeatedly:
other work on the machine disturbs all three, and the ratios to `off` of the same repeat say what the diagnosis costs.
All numbers are medians of the repeats, but the last three.

Latency: from before an Imu is published to after its Odometry has come back to this process (50 and 99 %, ms), by way
of two processes and DDS. On a busy machine most of it is waiting for a core that other processes have, so there are two
more, which other work does not change but by the caches: *on a free core* is the latency less the time for which the
threads that a sample goes by were ready to run and had no core (the second number of /proc/PID/task/TID/schedstat), and
*work* the processor time (the first number) of those of the node from one sample to the next.

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
from dataclasses import dataclass
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
#: %, of the samples, within the numbers of the table
SHARES = (50, 99)
#: s for which a node may be behind
PATIENCE = 60.0
#: names of the threads of DDS that messages from other processes go by
RECEIVING = ('dds.shm.7', 'dds.udp.7')
#: s over which the largest part of a core is taken: many periods of `diagnosis.worker`, few ticks of the CPU time
WINDOW = 5.0


class Threads:
    """Processor time of some threads, and the time for which they were ready to run and had no core."""

    def __init__(self, pid: int, *others: int):
        """The first thread of a process, those that receive messages, and others by their number."""
        own = [path for path in Path(f'/proc/{pid}/task').iterdir() if int(path.name) in (pid, *others)
               or (path / 'comm').read_text().startswith(RECEIVING)]
        self._files = [os.open(path / 'schedstat', os.O_RDONLY) for path in own]

    def times(self) -> tuple[int, int]:
        """On a core and waiting for one, ns, since they began."""
        rows = [os.pread(file, 100, 0).split() for file in self._files]
        return sum(int(row[0]) for row in rows), sum(int(row[1]) for row in rows)

    def close(self) -> None:
        for file in self._files:
            os.close(file)


@dataclass(frozen=True)
class Moment:
    """A sample going out, or its odometry coming back. clock: s. work: processor time of the node's threads, ns.
    waited: for a core, of the node's threads and of those that receive here, ns."""

    clock: float
    work: int
    waited: int


class Publisher:
    """Publishes a recording, and notes when each sample went out and its odometry came back."""

    def __init__(self, recording):
        self.node = rclpy.create_node('online_costs')
        self.imu = self.node.create_publisher(Imu, '/imu/data', QoSProfile(depth=1000))
        self.fix = self.node.create_publisher(NavSatFix, '/gps/fix', QoSProfile(depth=10))
        self.node.create_subscription(Odometry, '/odometry/fused', self._on_odometry, QoSProfile(depth=1000))
        self.recording, self.sent, self.back = recording, {}, {}
        self._threads: list[Threads] = []
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._spinning = threading.Thread(target=self._executor.spin, daemon=True)
        self._spinning.start()

    def look_at(self, pid: int) -> None:
        """Note the times of the threads of the node, a process, and of those that receive here."""
        self._threads = [Threads(pid), Threads(os.getpid(), self._spinning.native_id)]

    def _now(self) -> Moment:
        times = [threads.times() for threads in self._threads] or [(0, 0)]
        return Moment(time.perf_counter(), times[0][0], sum(waited for _, waited in times))

    def close(self) -> None:
        for threads in self._threads:
            threads.close()
        self._executor.shutdown()
        self.node.destroy_node()

    def _on_odometry(self, message):
        self.back[message.header.stamp.sec, message.header.stamp.nanosec] = self._now()

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
            self.sent[message.header.stamp.sec, message.header.stamp.nanosec] = self._now()
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
    node = subprocess.Popen([sys.executable, '-m', 'mems_ins_fusion', 'fusion_node', '--ros-args', '-p',
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
        publisher.look_at(node.pid)
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
    pairs = [(sent, publisher.back[key]) for key, sent in publisher.sent.items() if key in publisher.back]
    if not pairs:
        raise SystemExit('no odometry has come back: ' + (folder / 'log').read_text())
    late = np.array([back.clock - sent.clock for sent, back in pairs])
    waited = 1e-9 * np.array([back.waited - sent.waited for sent, back in pairs])
    work = 1e-9 * np.diff([sent.work for sent in publisher.sent.values()])
    shares = {name: 1e3 * np.percentile(values, SHARES)
              for name, values in (('latency', late), ('free', late - waited), ('work', work))}
    return {**{f'{name} {share}': value for name, values in shares.items() for share, value in zip(SHARES, values)},
            'node': node_cpu / seconds, 'diagnosis': diagnosis_cpu / seconds,
            'most': most, 'lost': len(publisher.sent) - len(late), 'load': load}


def row(rate: float, mode: str, runs: list[dict[str, float]], off: list[dict[str, float]]) -> str:
    """A line of the table: `runs` of a mode; times in ms, with the ratios to those with `off` of the same repeats."""
    def middle(name: str) -> float:
        return statistics.median(run[name] for run in runs)

    def compared(name: str) -> str:
        if runs is off:
            return f'{middle(name):.2f}'
        ratios = [run[name] / other[name] for run, other in zip(runs, off)]
        return f'{middle(name):.2f}: {statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})'

    loads = [run['load'] for run in runs]
    cells = (f'{rate:g} Hz', mode, *(f"{middle(f'latency {share}'):.1f}" for share in SHARES),
             *(compared(f'{name} {share}') for name in ('free', 'work') for share in SHARES),
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
    lines = ['| samples | `diagnosis.online` | latency, 50 % | 99 % | on a free core, 50 % | 99 % | work, 50 % | 99 % '
             '| node | diagnosis | most | lost | load |', f'|{"---|" * 13}']
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
    main()
