"""Whether the speed told by the wheels' vibration is right, without fixes: measured drives and simulated ones.

    python studies/wheel_vibration_outages.py [--data ../shared/data] [--seeds 4] [--minutes 20] [--rates 100 ...]
                                              [--cars NAME ...] [--only measured|simulated]

Fixes are withheld for a minute every two minutes, wherever the vehicle is, in two runs that withhold the one and the
other minute: of measured drives from two minutes on, of simulated ones (`simulation/scene.py`, REALISTIC, with what
`CARS` adds; fixes with 1.5 m of noise) from five minutes on. The truth of a measured drive is the run with all of the
best fixes.

The tables: circumference found; time without fixes in which the vehicle drives faster than 4 m/s; in which share of it
a speed is told; RMS of its error and, at the same instants, of the filter's own speed; how often it was within two
sigma; how long wrong locks lasted: errors above three sigma and 0.5 m/s for more than 10 s.
"""
from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.wheel_vibration import HOP, SLOWEST, WITHOUT_FIX, Lines, Wheels, summary
from mems_ins_fusion.filter.memory import Event
from mems_ins_fusion.filter.runs.replay import Playback, Replay, Stretch, run
from mems_ins_fusion.filter.runs.results import Run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.samples import Aiding, Recording, Reference
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, Vibration, simulate_recording

#: drive: topic of its fixes, of the best ones, and what is known of it (docs/vehicle.md)
DRIVES = {
    'longmont_rtk_drive/bag': ('/gps/fix', '/gps/fix', {'imu.mounting_rpy': [0.0, 0.0, math.pi],
                                                        'gnss.time_offset': -0.26}),
    'karlsruhe_hills/bag': ('/gps/fix', '/reference/fix', {}),
    'kingston_span/bag': ('/gps/fix', '/reference/fix', {'imu.mounting_rpy': [0.0, 0.0, -math.pi / 2]}),
    'dresden_hobby_imu': ('/gps/fix', '/gps/fix', {}),
}
_ROAD = Vibration(0.05, 0.1)
#: second order of an engine to the wheels, gear by gear
_GEARS = (14.0, 8.0, 5.5, 4.1)
#: what a simulated car adds to the scene
CARS = {
    'wheels': replace(_ROAD, wheels=0.02, lines=0.05, gears=_GEARS),
    'soft mount': replace(_ROAD, wheels=0.005, lines=0.05, gears=_GEARS),
    'tyre change': replace(_ROAD, wheels=0.02, lines=0.05, gears=_GEARS, changed=600.0),
    'no wheels': replace(_ROAD, lines=0.1, gears=_GEARS),
    'engine only': replace(_ROAD, idle=0.2, gears=_GEARS),
}
STEP = 0.5  # s between two looks at what is told
PHASES = (0.0, 60.0)  # s by which the minutes without fixes are later: in two runs each minute is one of them once


@dataclass(frozen=True)
class Told:
    """Speeds told: time since the filter's epoch, speed and sigma (k,)."""

    time: np.ndarray
    speed: np.ndarray
    sigma: np.ndarray
    epoch: int


class _Listening(Replay):
    """A replay that notes what is told."""

    def _filter(self, memory, samples, index, events, epoch):
        kept, at = np.flatnonzero(self.keep[index]), int(memory[Wheels.AT])
        states = np.empty((len(kept), len(self.columns)))
        events.event[:, Event.ID] = np.arange(len(events.kind))
        work, found = Playback(samples, events, self.columns, kept, states), []
        for stop in np.searchsorted(samples[:, 0], np.arange(samples[0, 0], samples[-1, 0], STEP)):
            work.advance(memory, int(stop))
            if at and (not found or memory[at + Lines.REPORTED] != found[-1][0]) and memory[at + Lines.VARIANCE] > 0.0:
                found.append((memory[at + Lines.REPORTED], memory[at + Lines.SPEED],
                              math.sqrt(memory[at + Lines.VARIANCE])))
        work.advance(memory, len(samples))
        work.finish(memory)
        self.stretches.append(Stretch(index[kept], states))
        self.told = Told(*np.array(found).reshape(-1, 3).T, epoch)


def of_drive(recording: Recording, truth: Run | Reference, values: dict, phase: float, first: float):
    """One drive: speeds told without fixes (k, 3): error, sigma, error of the filter's speed; how long they were wrong,
    s; s without fixes in which the vehicle goes faster than SLOWEST; circumference, m, or None.

    Fixes are withheld for a minute every two minutes from `first` on, `phase` s later or earlier.
    """
    begin = recording.imu.stamp[0]
    fixes = recording.gnss.select(~_alone((recording.gnss.stamp - begin) * 1e-9, phase, first))
    work = _Listening(FilterConfig.from_parameters(table.check({**values, 'wheel_vibration': 'report'})), recording.imu,
                      fixes, Aiding(), None, None)
    found = work.run()
    of_truth = (truth.stamp - begin) * 1e-9
    speed = np.linalg.norm(truth.velocity, axis=1)
    time = work.told.time + (work.told.epoch - begin) * 1e-9
    use = _alone(time - WITHOUT_FIX, phase, first) & _alone(time, phase, first)
    true = np.interp(time, of_truth, speed)
    own = np.interp(time, (found.stamp - begin) * 1e-9, np.linalg.norm(found.velocity, axis=1))
    told = np.column_stack([work.told.speed - true, work.told.sigma, own - true])[use]
    step = np.diff(of_truth, append=of_truth[-1])
    driving = step[_alone(of_truth, phase, first) & (speed > SLOWEST)].sum()
    heard = summary(found.memory)
    return told, _wrong(time[use], told), driving, heard and heard['circumference_m']


def _alone(time: np.ndarray, phase: float, first: float) -> np.ndarray:
    """Whether fixes are withheld at `time`, s since the first sample."""
    return (time > first) & ((time - first - phase) % 120.0 < 60.0)


def _wrong(time: np.ndarray, told: np.ndarray) -> float:
    """Wrong locks: s in which the speeds told were off by more than three sigma and 0.5 m/s, for more than 10 s."""
    off = np.abs(told[:, 0]) > np.maximum(3.0 * told[:, 1], 0.5)
    total, since = 0.0, np.nan
    for i in range(len(time)):
        if not off[i] or i + 1 == len(time) or time[i + 1] - time[i] > 10.0:
            last = time[i] if off[i] else time[i - 1]
            total += last - since if last - since > 10.0 else 0.0
            since = np.nan
        elif math.isnan(since):
            since = time[i]
    return total


HEAD = ('circumference, m | s without fixes | told, share of it | RMS, m/s | the filter\'s | within 2 sigma | '
        'wrong locks, s |')


def row(first: list, drives: list) -> str:
    """A line of the table from what `of_drive` gave."""
    told = np.vstack([drive[0] for drive in drives])
    seconds = sum(drive[2] for drive in drives)
    known = [drive[3] for drive in drives if drive[3]]
    numbers = '- | - | -'
    if len(told):
        numbers = (f'{_rms(told[:, 0]):.2f} | {_rms(told[:, 2]):.2f} | '
                   f'{np.mean(np.abs(told[:, 0]) < 2 * told[:, 1]):.0%}')
    return (f'| {" | ".join(first)} | {f"{min(known):.3f} to {max(known):.3f}" if known else "-"} | {seconds:.0f} | '
            f'{len(told) * HOP / seconds:.0%} | {numbers} | {sum(drive[1] for drive in drives):.0f} |')


def _rms(values: np.ndarray) -> float:
    return math.sqrt(np.mean(values**2))


def of_measured(data: Path):
    """Lines of the table of the measured drives."""
    yield f'| drive | {HEAD}\n|{"---|" * 8}'
    for name, (topic, best, values) in DRIVES.items():
        reference = read_recording(data / name, '/imu/data', best)
        truth = run(FilterConfig.from_parameters(table.check(values)), reference.imu, reference.gnss)
        cases = {'': read_recording(data / name, '/imu/data', topic)}
        if best != topic:
            cases[', best fixes'] = reference
        for words, recording in cases.items():
            drives = [of_drive(recording, truth, values, phase, 120.0) for phase in PHASES]
            yield row([name.split('/')[0] + words], drives)


def of_cars(cars, rates, seeds: int, minutes: float):
    """Lines of the table of the simulated drives."""
    yield f'| car | Hz | {HEAD}\n|{"---|" * 9}'
    scene = REALISTIC
    for car in cars:
        for rate in rates:
            drives = []
            for seed in range(2000, 2000 + seeds):
                drive = scene.drive(minutes * 60.0, seed, rate, standstill=20.0)
                simulated = simulate_recording(
                    drive, SensorErrors.from_parameters(table.check(scene.imu), 'gauss_markov'), GnssNoise(1.5),
                    seed=seed, **{**scene.distortions(seed), 'vibration': CARS[car], 'aiding': None})
                drives += [of_drive(simulated.recording, simulated.recording.reference, {}, phase, 300.0)
                           for phase in PHASES]
            yield row([car, f'{rate:g}'], drives)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    parser.add_argument('--only', choices=('measured', 'simulated'))
    parser.add_argument('--cars', nargs='+', default=list(CARS), choices=CARS)
    parser.add_argument('--rates', nargs='+', type=float, default=[100.0])
    parser.add_argument('--seeds', type=int, default=4)
    parser.add_argument('--minutes', type=float, default=20.0)
    options = parser.parse_args()
    if options.only != 'simulated':
        for line in of_measured(options.data):
            print(line, flush=True)
    if options.only != 'measured':
        for line in of_cars(options.cars, options.rates, options.seeds, options.minutes):
            print(line, flush=True)


if __name__ == '__main__':
    main()
