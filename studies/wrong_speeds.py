"""What a speed, velocity, odometry or heading costs that is wrong for a whole drive, or from 200 s on: the filter is to
be as good as without it.

    python studies/wrong_speeds.py [--seeds 4] [--minutes 10] [--output FILE.md]

REALISTIC drives, fixes of 1.5 m each second, one further input that is right, or wrong from the begin to the end: wheel
speed and odometry at 20 Hz, those of the last rows at 100 Hz, GNSS velocity and heading at 5 Hz. With
fixes the RMSE of the position, without them the largest error within 30 and 60 s, begun each 100 s: means over all
drives. Share: of its messages that were used.
"""
from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import over_drives
from vehicle import FIXES, drive_of, sensors

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import Event, Kind, Verdict
from mems_ins_fusion.filter.runs.replay import run_with_outages
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import SimulatedAiding, simulate_recording

DURATIONS, SPACING, SETTLED = (30.0, 60.0), 100.0, 60.0
USED = Verdict.USED, Verdict.WEIGHTED
_SWAPPED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def _times(name, matrix):
    """What makes `name` of a recording a wrong one: its values times a number or a matrix."""
    return name, lambda samples: replace(samples, **{name: getattr(samples, name) @ matrix if np.ndim(matrix) else
                                                     getattr(samples, name) * matrix})


def _late(name, seconds):
    return name, lambda samples: replace(samples, stamp=samples.stamp + round(seconds * 1e9))


def _turned(degrees):
    return 'heading', lambda samples: replace(samples, yaw=samples.yaw + np.radians(degrees))


def _later(name, change):
    """Wrong from 200 s on."""
    def changed(samples):
        late = samples.stamp - samples.stamp[0] > 200 * 10**9
        part = 'yaw' if name == 'heading' else name
        return replace(samples, **{part: np.where(late, getattr(change(samples), part), getattr(samples, part))})
    return name, changed


INPUTS = {
    'none': ('', None),
    'wheel speed': _times('speed', 1.0), 'wheel speed in km/h': _times('speed', 3.6),
    'wheel speed in mph': _times('speed', 2.23694), 'in mph, taken for km/h': _times('speed', 1.0 / 1.609),
    'wheel speed, negative': _times('speed', -1.0), 'wheel speed, always zero': _times('speed', 0.0),
    'wheel speed 0.1 s late': _late('speed', 0.1), 'wheel speed 0.3 s late': _late('speed', 0.3),
    'GNSS velocity': _times('velocity', 1.0), 'GNSS velocity, north and east exchanged': _times('velocity', _SWAPPED),
    'odometry': _times('twist', 1.0), 'odometry in km/h': _times('twist', np.diag([3.6, 3.6, 1.0])),
    'odometry, turns to the right positive': _times('twist', np.diag([1.0, 1.0, -1.0])),
    'odometry, turn rate half as much again': _times('twist', np.diag([1.0, 1.0, 1.5])),
    'odometry 0.3 s late': _late('twist', 0.3),
    'wheel speed, 10 % more from 200 s on': _later(*_times('speed', 1.1)),
    'in mph, taken for km/h, from 200 s on': _later(*_times('speed', 1.0 / 1.609)),
    'GNSS velocity, always zero': _times('velocity', 0.0),
    'heading': _turned(0.0), 'heading 5 deg off': _turned(5.0), 'heading 15 deg off': _turned(15.0),
    'heading half a turn off': _turned(180.0), 'heading to the left positive': (
        'heading', lambda samples: replace(samples, yaw=-samples.yaw)),
    'heading 5 deg off from 200 s on': _later(*_turned(5.0)),
    'GNSS velocity 0.3 s late': _late('velocity', 0.3), 'heading 0.3 s late': _late('heading', 0.3),
}
#: the same at the rate of a bus
FAST = ('wheel speed', 'wheel speed in km/h', 'wheel speed in mph', 'in mph, taken for km/h', 'wheel speed, negative',
        'wheel speed, always zero', 'wheel speed 0.3 s late', 'wheel speed, 10 % more from 200 s on', 'odometry',
        'odometry in km/h', 'odometry 0.3 s late')


def of_drive(seed: int, minutes: float) -> list:
    made = simulate_recording(drive_of(seed, minutes), sensors(), FIXES['1.5 m'], seed=seed, aiding=SimulatedAiding(
        speed_rate=100.0, velocity_rate=5.0, twist_rate=100.0, heading_rate=5.0), **{
            key: value for key, value in REALISTIC.distortions(seed).items() if key != 'aiding'})
    recording = made.recording
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        return [(name, _judge(recording, *of, 5)) for name, of in INPUTS.items()] + [
            (f'{name}, 100 Hz', _judge(recording, *INPUTS[name], 1)) for name in FAST]


def _judge(recording, name, change, step) -> list[float]:
    """step: of the samples of wheels one in so many is used."""
    samples = {}
    if name:
        chosen = slice(None, None, step if name in ('speed', 'twist') else 1)
        samples = {name: change(recording.streams()[name].select(chosen))}
    config = FilterConfig.from_parameters(table.check({'reference_lever_arm': [0.0] * 3, **({
        f'{name}_topic': f'/{name}'} if name else {})}))
    start, end = recording.imu.stamp[0], recording.imu.stamp[-1]
    row = []
    for duration in DURATIONS:
        begin = np.arange(start + SETTLED * 1e9, end - (duration + 1.0) * 1e9, SPACING * 1e9).astype(np.int64)
        whole, outages = run_with_outages(config, recording.imu, recording.gnss, begin, duration, Aiding(samples))
        off = _errors(recording.reference, outages.run)
        stamp = outages.run.stamp
        row.append(np.mean([off[(stamp >= b) & (stamp <= b + duration * 1e9)].max() for b in begin]))
    settled = whole.stamp > start + SETTLED * 1e9
    row.insert(0, float(np.sqrt((_errors(recording.reference, whole)[settled] ** 2).mean())))
    of_input = whole.measured.event[whole.measured.kind != Kind.POSITION]
    used = np.isin(of_input[:, Event.VERDICT], USED)
    return [*row, float(used.mean()) if len(used) else np.nan]


def _errors(true, result):
    north, east = radii(result.latitude)
    since = (result.stamp - true.stamp[0]) * 1e-9
    known = (true.stamp - true.stamp[0]) * 1e-9
    return np.hypot((result.latitude - np.interp(since, known, true.latitude)) * north,
                    (result.longitude - np.interp(since, known, true.longitude)) * east * np.cos(result.latitude))


def lines(results: dict, seeds: int):
    yield f'| input, {seeds} drives | RMSE with fixes, m | 30 s without, m | 60 s without, m | used |'
    yield '|---|---|---|---|---|'
    for name, rows in results.items():
        rmse, short, long, used = np.array(rows).mean(axis=0)
        yield f'| {name} | {rmse:.2f} | {short:.1f} | {long:.1f} | {"" if np.isnan(used) else f"{used:.0%}"} |'


if __name__ == '__main__':
    over_drives.main(__doc__, of_drive, lines, 4)
