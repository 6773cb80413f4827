"""What the speed by the wheels' vibration is worth: measured drives and simulated ones, with it and without.

    python studies/wheel_vibration_outages.py [--data ../shared/data] [--seeds 4] [--minutes 20] [--rates 100 ...]
                                              [--cars NAME ...] [--only measured|simulated]

Measured drives: fixes are withheld for 30 and 60 s, every 5 s from two minutes on, on stretches without a stop (never
below 4 m/s) and with turns (above 0.1 rad/s) for a fifth of the time at most; the truth is the run with all of the best
fixes. Simulated drives (`simulation/scene.py`, REALISTIC, with what `CARS` adds): fixes with 1.5 m of noise, from five
minutes on withheld for a minute every two minutes, wherever the vehicle is.

The tables: error along the track at the end, m, median / 95 %; mean of the difference of the errors' sizes, on less
off, with its 95 % interval; how often it was within two sigma; the speed told while no fixes came: how often, RMS of
its error, m/s, how often within two sigma. A wrong lock is an error of the speed above three sigma and 0.5 m/s for more
than 10 s.
"""
from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mems_ins_fusion.evaluation.intervals import paired
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.wheel_vibration import Ear, Wheels, summary
from mems_ins_fusion.filter.memory import Event
from mems_ins_fusion.filter.runs.replay import Progress, Replay, Stretch, run, run_with_outages
from mems_ins_fusion.filter.runs.results import Run
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.samples import Aiding, ImuSamples
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
SETTINGS = ('off', 'on')
STEP = 0.5  # s between two looks at what is told


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
        events.record[:, Event.ID] = np.arange(len(events.kind))
        work, found = Progress(samples, events, self.columns, kept, states), []
        for stop in np.searchsorted(samples[:, 0], np.arange(samples[0, 0], samples[-1, 0], STEP)):
            work.advance(memory, int(stop))
            if at and (not found or memory[at + Ear.TOLD] != found[-1][0]) and memory[at + Ear.VARIANCE] > 0.0:
                found.append((memory[at + Ear.TOLD], memory[at + Ear.SPEED], math.sqrt(memory[at + Ear.VARIANCE])))
        work.advance(memory, len(samples))
        work.finish(memory)
        self.stretches.append(Stretch(index[kept], states))
        self.told = Told(*np.array(found).reshape(-1, 3).T, epoch)


def kept(imu: ImuSamples, rate: float = 10.0) -> np.ndarray:
    """Which samples to keep states of, (n,) bool: about `rate` a second."""
    slot = (imu.stamp - imu.stamp[0]) * 1e-9 * rate
    return np.diff(np.floor(slot), prepend=-1.0) > 0


def along(found: Run, truth: Run, stamps: np.ndarray) -> np.ndarray:
    """At each of `stamps` (ns): error along the track, m, its sigma, and error across (k, 3)."""
    i = np.minimum(np.searchsorted(found.stamp, stamps), len(found.stamp) - 1)
    j = np.minimum(np.searchsorted(truth.stamp, found.stamp[i]), len(truth.stamp) - 1)
    errors = np.array([to_local(found.latitude[a], found.longitude[a], found.height[a],
                                (truth.latitude[b], truth.longitude[b], truth.height[b])) for a, b in zip(i, j)])
    ahead = truth.velocity[j, :2] / np.maximum(np.linalg.norm(truth.velocity[j, :2], axis=1), 0.1)[:, None]
    n, e = ahead.T
    variance = (n * found.sigma[i, 0]) ** 2 + (e * found.sigma[i, 1]) ** 2 + 2 * n * e * found.covariance_ne[i]
    return np.column_stack([n * errors[:, 0] + e * errors[:, 1], np.sqrt(variance),
                            n * errors[:, 1] - e * errors[:, 0]])


def row(first: list, off: np.ndarray, on: np.ndarray, apart: float = np.inf) -> str:
    """A line of a table: errors (k, 3) as of `along`."""
    a, b = np.abs(off[:, 0]), np.abs(on[:, 0])
    difference = paired(b, a, apart)
    words = '-' if difference is None else f'{difference.mean:+.1f} ({difference.low:+.1f} to {difference.high:+.1f})'
    told = np.any(off != on, axis=1)
    part = (f'{np.median(a[told]):.1f} / {np.percentile(a[told], 95):.1f} | '
            f'{np.median(b[told]):.1f} / {np.percentile(b[told], 95):.1f}' if told.any() else '- | -')
    return (f'| {" | ".join(map(str, first))} | {len(a)} | {np.median(a):.1f} / {np.percentile(a, 95):.1f} | '
            f'{np.median(b):.1f} / {np.percentile(b, 95):.1f} | {words} | {np.mean(a < 2 * off[:, 1]):.0%} | '
            f'{np.mean(b < 2 * on[:, 1]):.0%} | {told.sum()} | {part} |')


HEAD = ('outages | off | on | on less off | off within 2 sigma | on within 2 sigma | told in | of these off | '
        'of these on |')


def straight(truth: Run, duration: float, every: float = 5.0) -> np.ndarray:
    """Begins (o,), ns, of outages without a stop and with few turns."""
    time = (truth.stamp - truth.stamp[0]) * 1e-9
    speed = np.linalg.norm(truth.velocity[:, :2], axis=1)
    turn = np.abs(np.gradient(np.unwrap(truth.yaw), time))
    width = max(round(1.0 / np.median(np.diff(time))), 1)
    turn = np.convolve(turn, np.ones(width) / width, 'same')
    found = []
    for begin in np.arange(120.0, time[-1] - duration, every):
        part = slice(*np.searchsorted(time, [begin, begin + duration]))
        if speed[part].min() > 4.0 and np.mean(turn[part] > 0.1) < 0.2:
            found.append(truth.stamp[0] + round(begin * 1e9))
    return np.array(found, dtype=np.int64)


def apart(begins: np.ndarray, duration: float) -> int:
    """How many of the outages with these begins (ns, ascending) share no time."""
    count, free = 0, -1
    for begin in begins.tolist():
        if begin >= free:
            count, free = count + 1, begin + round(duration * 1e9)
    return count


def of_measured(data: Path):
    """Lines of the table of the measured drives."""
    yield f'| drive | s | {HEAD}\n|{"---|" * 12}'
    for name, (topic, best, values) in DRIVES.items():
        recording = read_recording(data / name, '/imu/data', topic)
        reference = recording if best == topic else read_recording(data / name, '/imu/data', best)
        configs = [FilterConfig.from_parameters(table.check({**values, 'wheel_vibration': s})) for s in SETTINGS]
        truth = run(configs[0], reference.imu, reference.gnss)
        cases = {'': recording} if best == topic else {'': recording, ', best fixes': reference}
        for words, drive in cases.items():
            for duration in (30.0, 60.0):
                begins, errors = straight(truth, duration), []
                for config in configs if len(begins) else ():
                    _, coasting = run_with_outages(config, drive.imu, drive.gnss, begins, duration)
                    errors.append(np.vstack([
                        along(coasting.run.states(slice(*coasting.first[i:i + 2])), truth,
                              np.array([begin + round(duration * 1e9)])) for i, begin in enumerate(coasting.begin)]))
                if errors:
                    yield row([name.split('/')[0] + words, f'{duration:.0f}'], *errors, apart=apart(begins, duration))


def of_simulated(car: str, rate: float, seed: int, minutes: float):
    """One simulated drive: errors (k, 3) at the ends of the outages without and with it, speeds told without fixes
    (error, sigma), wrong locks without and with it, and hours."""
    scene = REALISTIC
    drive = scene.drive(minutes * 60.0, seed, rate, standstill=20.0)
    sensors = table.check(scene.imu)
    simulated = simulate_recording(
        drive, SensorErrors.from_parameters(sensors, 'gauss_markov'), GnssNoise(1.5), seed=seed,
        **{**scene.distortions(seed), 'vibration': CARS[car], 'aiding': None})
    recording, keep = simulated.recording, kept(simulated.recording.imu)
    since = (recording.gnss.stamp - recording.imu.stamp[0]) * 1e-9
    fixes = recording.gnss.select(~((since > 300.0) & (since % 120.0 < 60.0)))
    reference = recording.reference
    errors, wrong, told = [], [], None
    for setting in SETTINGS:
        work = _Listening(FilterConfig.from_parameters(table.check({'wheel_vibration': setting})), recording.imu,
                          fixes, Aiding(), None, keep)
        found = work.run()
        truth = _as_run(reference, found)
        ends = np.arange(360.0 + 59.5, minutes * 60.0, 120.0)
        errors.append(along(found, truth, recording.imu.stamp[0] + np.round(ends * 1e9).astype(np.int64)))
        wrong.append(_wrong(found, truth))
        if setting == 'on':
            time = work.told.time + (work.told.epoch - recording.imu.stamp[0]) * 1e-9
            alone = (time > 303.0) & (time % 120.0 > 3.0) & (time % 120.0 < 60.0)
            speed = np.interp(time, (reference.stamp - recording.imu.stamp[0]) * 1e-9,
                              np.linalg.norm(reference.velocity, axis=1))
            told = np.column_stack([work.told.speed - speed, work.told.sigma])[alone]
            print(f'{car}, {rate:g} Hz, seed {seed}: {summary(found.memory)}', file=sys.stderr)
    return errors, told, wrong, minutes / 60.0


def _as_run(reference, found: Run) -> Run:
    """The reference at the states of `found`."""
    j = np.minimum(np.searchsorted(reference.stamp, found.stamp), len(reference) - 1)
    return replace(found, latitude=reference.latitude[j], longitude=reference.longitude[j], height=reference.height[j],
                   velocity=reference.velocity[j])


def _wrong(found: Run, truth: Run) -> int:
    """Wrong locks: the speed off by more than three sigma and 0.5 m/s for more than 10 s."""
    ahead = truth.velocity[:, :2] / np.maximum(np.linalg.norm(truth.velocity[:, :2], axis=1), 0.1)[:, None]
    error = np.einsum('ki,ki->k', found.velocity[:, :2] - truth.velocity[:, :2], ahead)
    v = found.config.layout.index('v_n')
    off = np.abs(error) > np.maximum(3.0 * np.sqrt(np.einsum('ki,ki->k', ahead**2, found.sigma[:, v:v + 2] ** 2)), 0.5)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], off, [False]])))
    lasted = (found.stamp[np.minimum(edges[1::2], len(off) - 1)] - found.stamp[edges[::2]]) * 1e-9
    return int(np.sum(lasted > 10.0))


def of_cars(cars, rates, seeds: int, minutes: float):
    """Lines of the table of the simulated drives."""
    yield (f'| car | Hz | hours | {HEAD} told, share of the windows | RMS, m/s | within 2 sigma | wrong locks off | on '
           f'|\n|{"---|" * 18}')
    for car in cars:
        for rate in rates:
            drives = [of_simulated(car, rate, 2000 + seed, minutes) for seed in range(seeds)]
            off, on = (np.vstack([d[0][i] for d in drives]) for i in range(2))
            told, wrong = np.vstack([d[1] for d in drives]), np.sum([d[2] for d in drives], axis=0)
            windows = sum(len(d[0][0]) for d in drives) * 28.0
            numbers = (f'{len(told) / windows:.0%} | {math.sqrt(np.mean(told[:, 0] ** 2)):.2f} | '
                       f'{np.mean(np.abs(told[:, 0]) < 2 * told[:, 1]):.0%}' if len(told) else '0 % | - | -')
            yield (f'{row([car, f"{rate:g}", f"{sum(d[3] for d in drives):.1f}"], off, on)} {numbers} | {wrong[0]} | '
                   f'{wrong[1]} |')


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
