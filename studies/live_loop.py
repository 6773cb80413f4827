"""A recording played to the live node over real ROS 2, what the node says written down, and the figure of it.

    python studies/live_loop.py record FOLDER BAG [--rate 4] [--kill 100 200 ...] [-p NAME:=VALUE ...]
    python studies/live_loop.py replay FOLDER BAG [-p NAME:=VALUE ...]
    python studies/live_loop.py figure PNG FOLDER [FOLDER ...]

record: `fusion_node` and `play` as processes of their own, with a state file in FOLDER; a third process, this one,
listens: odometry with the latency of each (from the Imu message to its Odometry, as they come here), ~/calibration,
~/horizon, /diagnostics, the log, and the state file ten times a second: a file that is not whole, or has anything
beside it at rest, is told. --kill: after so many seconds of the recording the node is killed with SIGKILL and started
again. -p: parameters of the node.

replay: the same recording and parameters without ROS (`diagnosis.applying.driven`), with the same record.

figure: of each FOLDER what was known of each quantity over the drive with its sigma and state, and the error without
fixes with and without it, as the node told it.

Written into FOLDER: record.json, and track.npz with the odometry.
"""
from __future__ import annotations

import argparse
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

SECOND = 10**9  # ns
STATE = 'state.json'
#: doubles at the end of an Odometry: position, quaternion, covariance (36), twist (6), covariance (36)
NUMBERS = 85
#: of the figure, by state
COLOURS = {'INITIALISING': '#bbbbbb', 'COARSE': '#e9a23b', 'FINE': '#2a9d4a', 'SUSPECT': '#c1121f'}
#: messages that the node may have waiting, so that a busy machine changes no number
DEPTH = 4000


def parameters(assignments: list[str]) -> dict:
    """NAME:=VALUE as values."""
    import yaml
    return {name: yaml.safe_load(value) for name, _, value in (text.partition(':=') for text in assignments)}


class Listener:
    """Everything that the node says, with the stamp of the newest sample played (ns) and the time of the computer."""

    def __init__(self, imu_topic: str):
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from nav_msgs.msg import Odometry
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from sensor_msgs.msg import Imu

        rclpy.init()
        self.node = rclpy.create_node('live_loop')
        self.newest, self.sent, self.odometry = 0, {}, []
        self.said: list[dict] = []
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        subscribe, many = self.node.create_subscription, QoSProfile(depth=DEPTH)
        subscribe(Imu, imu_topic, self._on_imu, many, raw=True)
        subscribe(Odometry, '/odometry/fused', self._on_odometry, many, raw=True)
        for topic in ('/fusion_node/calibration', '/fusion_node/horizon'):
            subscribe(DiagnosticArray, topic, lambda message, topic=topic: self._on_statuses(topic, message), latched)
        subscribe(DiagnosticArray, '/diagnostics', lambda message: self._on_statuses('/diagnostics', message), 10)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        threading.Thread(target=self._executor.spin, daemon=True).start()

    def _on_imu(self, raw: bytes):
        stamp = stamp_of(raw)
        self.sent[stamp], self.newest = time.perf_counter(), stamp

    def _on_odometry(self, raw: bytes):
        self.odometry.append((stamp_of(raw), time.perf_counter(), raw[-8 * NUMBERS:]))

    def _on_statuses(self, topic: str, message):
        for status in message.status:
            self.note(topic, stamp=message.header.stamp.sec * SECOND + message.header.stamp.nanosec, name=status.name,
                      level=int.from_bytes(status.level, 'little'), message=status.message,
                      values={pair.key: pair.value for pair in status.values})

    def note(self, topic: str, **what) -> None:
        """Write down what was said on `topic` now."""
        self.said.append({'topic': topic, 'at': self.newest, 'clock': time.perf_counter(), **what})


def stamp_of(raw: bytes) -> int:
    """Header stamp of a serialized message, ns."""
    seconds, nanoseconds = np.frombuffer(raw, dtype='<u4', count=2, offset=4).tolist()
    return seconds * SECOND + nanoseconds


class Node:
    """`fusion_node` as a process, its log noted by `listener`."""

    def __init__(self, listener: Listener, arguments: list[str]):
        self._listener, self.is_ready = listener, threading.Event()
        self.process = subprocess.Popen([sys.executable, '-m', 'mems_ins_fusion', 'fusion_node', '--ros-args',
                                         *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        threading.Thread(target=self._read, daemon=True).start()
        if not self.is_ready.wait(600.0):
            raise SystemExit('the node does not start')

    def _read(self):
        for line in self.process.stdout:
            self._listener.note('log', message=line.rstrip())
            if 'ready: ' in line:
                self.is_ready.set()
        self.is_ready.set()


def watch_file(path: Path, listener: Listener, over: threading.Event) -> None:
    """Note each change of what the state file keeps, and where it is not whole."""
    before = None
    while not over.wait(0.1):
        try:
            text = path.read_text()
        except FileNotFoundError:
            continue
        try:
            kept = {one['name']: one['set'] for one in json.loads(text)['calibration']}
        except (ValueError, KeyError) as error:
            listener.note('state file', message=f'not whole: {error}')
            continue
        if kept != before:
            listener.note('state file', message=json.dumps(kept))
        before = kept


def record(folder: Path, bag: str, rate: float, kills: list[float], assignments: list[str]) -> None:
    """Play `bag` to a node and write down what it says."""
    values = {'imu_topic': '/imu/data', 'gnss_topic': '/gps/fix', **parameters(assignments)}
    folder.mkdir(parents=True, exist_ok=True)
    state = folder / STATE
    listener, over = Listener(values['imu_topic']), threading.Event()
    arguments = [part for text in (
        f'state_file:={state}', *(f'qos_overrides.{topic}.subscription.reliability:=reliable'
                                  for topic in (values['imu_topic'], values['gnss_topic'])),
        f"qos_overrides.{values['imu_topic']}.subscription.depth:={DEPTH}", *assignments) for part in ('-p', text)]
    threading.Thread(target=watch_file, args=(state, listener, over), daemon=True).start()
    node = Node(listener, arguments)
    loads = [os.getloadavg()[0]]
    cpu = os.times()
    player = subprocess.Popen([sys.executable, '-m', 'mems_ins_fusion', 'play', bag, '--rate', f'{rate:g}'],
                              stdout=subprocess.DEVNULL)
    begin, left = 0, sorted(kills)
    while player.poll() is None:
        time.sleep(0.05)
        begin = begin or listener.newest
        if left and begin and listener.newest - begin > left[0] * SECOND:
            left.pop(0)
            node.process.send_signal(signal.SIGKILL)
            node.process.wait()
            beside = [one.name for one in folder.iterdir() if one.name.startswith(f'.{STATE}')]
            listener.note('killed', message=f"{state.read_text() if state.exists() else 'no file'}", beside=beside)
            node = Node(listener, arguments)
    time.sleep(2.0)
    loads.append(os.getloadavg()[0])
    node.process.send_signal(signal.SIGINT)
    node.process.wait(60.0)
    time.sleep(0.5)
    over.set()
    own = os.times()
    rows = listener.odometry
    stamp = np.array([row[0] for row in rows], dtype=np.int64)
    late = np.array([arrived - listener.sent.get(stamp, math.nan) for stamp, arrived, _ in rows])
    numbers = np.array([np.frombuffer(row[2]) for row in rows]).reshape(-1, NUMBERS)
    np.savez_compressed(folder / 'track.npz', stamp=stamp, odometry=numbers, latency=late)
    write(folder, {'bag': bag, 'rate': rate, 'parameters': values, 'begin': begin, 'samples': len(listener.sent),
                   'odometries': len(rows), 'latency, ms': (1e3 * np.nanpercentile(late, [50, 99])).round(2).tolist(),
                   'load': loads, 'CPU of node and play, s': own.children_user + own.children_system
                   - cpu.children_user - cpu.children_system, 'said': listener.said})


def replay(folder: Path, bag: str, assignments: list[str]) -> None:
    """The same without ROS."""
    from mems_ins_fusion.diagnosis.applying import driven
    from mems_ins_fusion.diagnosis.watch import Watch
    from mems_ins_fusion.parameters import table
    from mems_ins_fusion.recordings.reading import read_recording

    own = {parameter.name for parameter in table.FILTER}
    given = {name: value for name, value in parameters(assignments).items() if name in own}
    values = table.check({'imu_topic': '/imu/data', 'gnss_topic': '/gps/fix', **given})
    recording = read_recording(bag, values['imu_topic'], values['gnss_topic'])
    watch = Watch(recording, values) if values['diagnosis.online'] != 'off' else None
    began = time.perf_counter()
    run = driven(recording, values, watch)
    folder.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(folder / 'track.npz', stamp=run.stamp, odometry=run.odometry)
    told = [{'topic': '/fusion_node/calibration', 'at': q.time, 'stamp': q.time, 'name': q.name, 'message':
             f'{q.state}: {q.text}', 'values': {'state': q.state, 'applied': str(q.applied)}} for q in
            (watch.said if watch else ())]
    told += [{'topic': 'log', 'at': one.stamp, 'message': one.text} for one in run.handovers]
    told += [{'topic': 'log', 'at': one.stamp, 'message': f'{one.name} dropped'} for one in run.dropped]
    write(folder, {'bag': bag, 'parameters': values, 'begin': int(recording.imu.stamp[0]),
                   'seconds': time.perf_counter() - began, 'said': sorted(told, key=lambda one: one['at'])})


def write(folder: Path, content: dict) -> None:
    """record.json, and in words what changed when."""
    (folder / 'record.json').write_text(json.dumps(content, default=str))
    print(*(f'{name}: {value}' for name, value in content.items() if name not in ('said', 'parameters')), sep='\n')
    before = {}
    for one in content['said']:
        after = (one['at'] - content['begin']) / SECOND
        if one['topic'] == '/fusion_node/calibration':
            key = one['name'], one['values']['state'], one['values']['applied']
            if before.get(one['name']) != key:
                print(f"{after:7.1f} s (stamp {(one['stamp'] - content['begin']) / SECOND:.0f} s)  {one['name']}: "
                      f"applied {one['values']['applied']}, {one['message']}")
            before[one['name']] = key
        elif one['topic'] in ('log', 'state file', 'killed'):
            print(f"{after:7.1f} s  {one['topic']}: {one['message'][:300]}")
    sys.stdout.flush()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('what', choices=('record', 'replay', 'figure'))
    parser.add_argument('output', type=Path)
    parser.add_argument('input', nargs='+')
    parser.add_argument('--rate', type=float, default=4.0)
    parser.add_argument('--kill', type=float, nargs='+', default=[])
    parser.add_argument('-p', action='append', default=[], dest='assignments')
    options = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_LOG_DIR', tempfile.mkdtemp())
    if options.what == 'record':
        record(options.output, options.input[0], options.rate, options.kill, options.assignments)
    elif options.what == 'replay':
        replay(options.output, options.input[0], options.assignments)


if __name__ == '__main__':
    main()
