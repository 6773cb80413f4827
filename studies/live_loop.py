"""A recording played to the live node over real ROS 2, what the node says written down, and the figure of it.

    python studies/live_loop.py record FOLDER BAG [--rate 4] [--kill 100 200 ...] [-p NAME:=VALUE ...]
                                                  [--kills 5 --kept 1 --life 120 --seed 0]
    python studies/live_loop.py replay FOLDER BAG [-p NAME:=VALUE ...]
    python studies/live_loop.py figure PNG FOLDER [FOLDER ...]

record: `fusion_node` and `play` as processes of their own, with a state file in FOLDER; a third process, this one,
listens: odometry with the latency of each (from the Imu message to its Odometry, as they come here), ~/calibration,
~/horizon, /diagnostics, the log, and the state file ten times a second: a file that is not whole, or has anything
beside it at rest, is told. --kill: after so many seconds of the recording the node is killed with SIGKILL and started
again. --kills: so often at random moments while the file keeps --kept values or more, each up to --life s of the
recording after the node was ready and they were there. -p: parameters of the node.

Of each kill: what the file kept at that moment, whether it was whole with nothing beside it, and what the next node
first said of each of these values in ~/calibration (`SUSPECT, applied` where it begins with it).

replay: the same recording and parameters without ROS (`diagnosis.applying.live_output`), with the same record.

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
        if not is_whole(text):
            listener.note('state file', message=f'not whole: {text[:100]}')
            continue
        kept = kept_in(path)
        if kept != before:
            listener.note('state file', message=json.dumps(kept))
        before = kept


class RandomKills:
    """So many moments at which to kill a node whose state file has kept `kept` values or more, for up to `life` s."""

    def __init__(self, count: int, kept: int, life: float, seed: int):
        self._left, self._kept, self._life = count, kept, life
        self._random, self._at = np.random.default_rng(seed), None

    def is_now(self, newest: int, state: Path) -> bool:
        """Whether to kill as the sample of stamp `newest` (ns) is played."""
        if not self._left:
            return False
        if self._at is None and len(kept_in(state)) >= self._kept:
            self._at = newest + self._random.uniform(0.0, self._life) * SECOND
        if self._at is None or newest < self._at:
            return False
        self._left, self._at = self._left - 1, None
        return True


def is_whole(text: str) -> bool:
    """Whether a state file has all that one has."""
    try:
        return 'calibration' in json.loads(text)
    except ValueError:
        return False


def kept_in(state: Path) -> dict[str, dict]:
    """What the state file keeps: parameters by finding; nothing where there is none, or it is not whole."""
    try:
        return {one['name']: one['set'] for one in json.loads(state.read_text())['calibration']}
    except (OSError, ValueError, KeyError):
        return {}


def after_kills(said: list[dict]) -> list[str]:
    """In words, of each kill: what the file kept, and what the next node first said of it."""
    kills = [i for i, one in enumerate(said) if one['topic'] == 'killed']
    lines = []
    for first, last in zip(kills, [*kills[1:], len(said)]):
        whole, beside, kept = (said[first][key] for key in ('whole', 'beside', 'kept'))
        first_words = {}
        for one in said[first:last]:
            if one['topic'] == '/fusion_node/calibration' and one['values']['applied'] == 'True':
                first_words.setdefault(one['name'].rpartition(': ')[2], f"{one['values']['state']}, applied")
        lines.append(f"kill {len(lines) + 1}: the file {'is whole' if whole else 'IS NOT WHOLE'}, beside it {beside}, "
                     f'keeps {json.dumps(kept)}; then: {first_words}')
    return lines


def record(folder: Path, bag: str, rate: float, kills: list[float], random: RandomKills,
           assignments: list[str]) -> None:
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
        planned = left and begin and listener.newest - begin > left[0] * SECOND
        if planned or random.is_now(listener.newest, state):
            left = left[1:] if planned else left
            node.process.send_signal(signal.SIGKILL)
            node.process.wait()
            text = state.read_text() if state.exists() else 'no file'
            beside = [one.name for one in folder.iterdir() if one.name.startswith(f'.{STATE}')]
            listener.note('killed', message=text, whole=is_whole(text), beside=beside, kept=kept_in(state))
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
    from mems_ins_fusion.diagnosis.applying import live_output
    from mems_ins_fusion.diagnosis.watch import RecordingWatch
    from mems_ins_fusion.parameters import table
    from mems_ins_fusion.recordings.reading import read_recording

    own = {parameter.name for parameter in table.FILTER}
    given = {name: value for name, value in parameters(assignments).items() if name in own}
    values = table.check({'imu_topic': '/imu/data', 'gnss_topic': '/gps/fix', **given})
    recording = read_recording(bag, values['imu_topic'], values['gnss_topic'])
    watch = RecordingWatch(recording, values) if values['diagnosis.online'] != 'off' else None
    began = time.perf_counter()
    run = live_output(recording, values, watch)
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
    print(*after_kills(content['said']), sep='\n')
    sys.stdout.flush()


def figure(path: Path, folders: list[Path]) -> None:
    """A column for each folder: a row for each of its quantities, the errors without fixes, and the trust horizon."""
    from matplotlib.figure import Figure

    columns = [shown(json.loads((folder / 'record.json').read_text())) for folder in folders]
    rows = max(len(quantities) for _, quantities, _ in columns) + 2
    whole = Figure(figsize=(6.5 * len(columns), 2.0 * rows), layout='constrained')
    grid = whole.subplots(rows, len(columns), squeeze=False)
    for axes, folder, (record, quantities, horizon) in zip(grid.T, folders, columns):
        axes[0].set_title(f"{folder.name}: {record['bag'].rstrip('/').removesuffix('/bag').split('/')[-1]}, "
                          f"{record['rate']:g}x, diagnosis.share {record['parameters'].get('diagnosis.share', 0.1):g}")
        for ax, (name, told) in zip(axes, sorted(quantities.items())):
            of_quantity(ax, name, told)
        of_errors(axes[-2], quantities)
        axes[-1].plot(*np.array(horizon).T, linewidth=0.7, color='0.3')
        axes[-1].set_ylabel('trust horizon, s')
        axes[-1].set_xlabel('time, s')
        for ax in axes[len(quantities):-2]:
            ax.set_axis_off()
        for ax in axes:
            ax.set_xlim(0.0, horizon[-1][0])
            for one in record['said']:
                if one['topic'] == 'log' and ('goes on with other' in one['message'] or ': dropped' in one['message']):
                    ax.axvline((one['at'] - record['begin']) / SECOND, color='k', linewidth=0.8, linestyle=':')
    whole.savefig(path, dpi=70, metadata={'Software': None})


def shown(record: dict) -> tuple[dict, dict[str, list], list]:
    """The record, what it has of each quantity, in order, with `after` (s), and the horizon (s, s)."""
    quantities: dict[str, list] = {}
    horizon = [(0.0, 0.0)]
    for one in record['said']:
        one['after'] = (one['at'] - record['begin']) / SECOND
        if one['topic'] == '/fusion_node/calibration' and one['after'] >= 0.0:
            quantities.setdefault(one['name'].rpartition(': ')[2].partition(',')[0], []).append(one)
        elif one['topic'] == '/fusion_node/horizon' and one['after'] >= 0.0:
            horizon.append((one['after'], float(one['values']['seconds'])))
    quantities.pop('all', None)
    return record, quantities, horizon


def of_quantity(ax, name: str, told: list) -> None:
    """Values with their sigmas, and the state as the colour behind them, filled where applied."""
    from matplotlib.patches import Patch

    ends = [one['after'] for one in told[1:]] + [1e9]
    for one, end in zip(told, ends):
        values = one['values']
        ax.axvspan(one['after'], end, color=COLOURS[values['state']],
                   alpha=0.45 if values['applied'] == 'True' else 0.2, linewidth=0.0)
    keys = [key for key in told[-1]['values'] if f"{key.partition(',')[0]} sigma{key.partition(',')[1]}" in
            ''.join(told[-1]['values']) and ' sigma' not in key and not key.startswith('set ')]
    for marker, key in zip('osv^', keys):
        parameter, _, unit = key.partition(',')
        pairs = [(one['after'], float(one['values'][key]),
                  float(one['values'][f"{parameter} sigma{',' if unit else ''}{unit}"]))
                 for one in told if one['values'].get(key, 'None') != 'None'
                 and one['values'].get(f"{parameter} sigma{',' if unit else ''}{unit}", 'None') != 'None']
        if pairs:
            at, value, sigma = np.array(pairs).T
            ax.errorbar(at, value, sigma, fmt=marker, markersize=4, linewidth=1.0, capsize=2, label=key)
    ax.set_ylabel(name, fontsize=8)
    states = [Patch(color=colour, alpha=0.3, label=state) for state, colour in COLOURS.items()
              if state in {one['values']['state'] for one in told}]
    ax.legend(handles=[*ax.get_legend_handles_labels()[0], *states], fontsize=6, loc='lower right')


def of_errors(ax, quantities: dict[str, list]) -> None:
    """Mean error after 5 s without fixes, without each finding and with it, as it was told on the way."""
    key = 'error after 5 s without fixes, m, '
    for (name, told), colour in zip(sorted(quantities.items()), ('C0', 'C1', 'C2', 'C3', 'C4')):
        for which, style in (('without it', 'x-'), ('with it', 'o-')):
            pairs = [(one['after'], float(one['values'][key + which])) for one in told if key + which in one['values']]
            if pairs:
                ax.plot(*np.array(pairs).T, style, color=colour, markersize=4, linewidth=0.8,
                        alpha=0.5 if which == 'without it' else 1.0, label=f'{name}, {which}')
    ax.set_ylabel('error after 5 s, m', fontsize=8)
    ax.set_ylim(bottom=0.0)
    if ax.get_legend_handles_labels()[0]:
        ax.legend(fontsize=6)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('what', choices=('record', 'replay', 'figure'))
    parser.add_argument('output', type=Path)
    parser.add_argument('input', nargs='+')
    parser.add_argument('--rate', type=float, default=4.0)
    parser.add_argument('--kill', type=float, nargs='+', default=[])
    parser.add_argument('--kills', type=int, default=0)
    parser.add_argument('--kept', type=int, default=1)
    parser.add_argument('--life', type=float, default=120.0)
    parser.add_argument('--seed', type=int, default=0)
    parser.add_argument('-p', action='append', default=[], dest='assignments')
    options = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_LOG_DIR', tempfile.mkdtemp())
    if options.what == 'record':
        record(options.output, options.input[0], options.rate, options.kill,
               RandomKills(options.kills, options.kept, options.life, options.seed), options.assignments)
    elif options.what == 'replay':
        replay(options.output, options.input[0], options.assignments)
    else:
        figure(options.output, [Path(folder) for folder in options.input])


if __name__ == '__main__':
    main()
