"""What each mechanism and each constant of the filter is good for: without it, and with a quarter and four times of it.

    python studies/ablation.py --list
    python studies/ablation.py [--only NAME ...] [--rows faults claims inputs car measured] [--faults TEXT ...]
                               [--rates 0.2 1 10] [--seeds 1] [--first-seed 2000] [--data ../shared/data]
                               [--output FILE.csv]
    python studies/ablation.py --summary FILE.csv [FILE.csv ...]

Mechanisms are switched off by their parameters, or by a constant with which they never act. A constant is changed by
its name, `file.NAME`, or `file.NAME[1]` for one of a tuple: all of `filter/trust`, and what stands
in `filter/` itself of those in FILES. No file is changed, and the filter is compiled once: in this process,
compiled code looks up the value of a constant each time it needs it (`Constant`). A change then costs seconds. What is
written already in FILE.csv is not done again, so the study can be stopped and gone on with.

Each line of the table: the change, the row, the rate of the fixes, the error and how often the 95 % ellipse held the
truth. Rows are the faults of faults.py and of input_faults.py (the largest error from a fault's begin to a minute after
its end), and whole drives, simulated and measured: the RMSE, and the 95th percentile of the largest errors in outages
of 30 and 60 s. *claims* are drives that single mechanisms are for, which the others do not have: an IMU in other units
or axes from some moment on, spikes, a boat, a robot, traffic that creeps. Each begins where the filter as it is has
found its start, which is done once.

The summary: the changes that move no row by more than LEAST_M or LEAST_PERCENT, and for the others, those that move
most first, in how many rows of each rate, where they help and cost most, and how much they change the mean error
(geometric) and how often the ellipse holds the truth, without the CHAOTIC rows. A row that moves by less than
LEAST_PART of its error counts as not moved.
"""
from __future__ import annotations

import argparse
import ast
import csv
import importlib
import math
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.caching import NullCache
from numba.core.imputils import lower_constant

from mems_ins_fusion import compiled

# compiled code with addresses of this process is of no use to another
compiled._Cache = lambda function: NullCache()

import faults  # noqa: E402
import input_faults  # noqa: E402
import vehicle  # noqa: E402

from mems_ins_fusion.evaluation.comparison import samples_to_keep, truth_of  # noqa: E402
from mems_ins_fusion.evaluation.metrics import NEES_95, position_errors, rms  # noqa: E402
from mems_ins_fusion.evaluation.outages import outage_begins, outages_of  # noqa: E402
from mems_ins_fusion.filter.config import FilterConfig  # noqa: E402
from mems_ins_fusion.filter.measurements.registry import aiding as inputs  # noqa: E402
from mems_ins_fusion.filter.memory import Event  # noqa: E402
from mems_ins_fusion.filter.runs.replay import Aiding, Playback, Replay, Stretch, run, run_with_outages  # noqa: E402
from mems_ins_fusion.parameters import table  # noqa: E402
from mems_ins_fusion.recordings.reading import read_recording  # noqa: E402
from mems_ins_fusion.simulation.drive import simulate_drive  # noqa: E402
from mems_ins_fusion.simulation.manoeuvres import SLOW  # noqa: E402
from mems_ins_fusion.simulation.simulation import (  # noqa: E402
    SensorErrors,
    SimulatedAiding,  # noqa: E402
    simulate_recording,
)

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'mems_ins_fusion.filter'
#: files whose constants are tried
FILES = ('trust/*.py', 'update.py', 'apply.py', 'constraints.py', 'advance.py', 'bank.py', 'prediction.py',
         'measurements/base.py', 'measurements/acceleration.py')
FACTORS = (0.25, 4.0)
#: parameters that switch a mechanism off
MECHANISMS = {
    'gate': {'gnss.gate_probability': 1.0}, 'weights': {'gnss.robust_sigma': 0.0},
    'adapt_sigma': {'gnss.adapt_sigma': False}, 'adapt_covariance': {'gnss.adapt_covariance': False},
    'adapt_noise': {'imu.adapt_noise': False}, 'learn_drift': {'vehicle.learn_drift': False},
    'standstill': {'vehicle.zero_velocity': False}, 'non_holonomic': {'vehicle.non_holonomic': False},
    'mounting': {'imu.mounting_sigma': 0.0}, 'rear_axle': {'vehicle.rear_axle_sigma': 0.0},
    'scale factors of the gyroscopes': {'gyroscope.scale_sigma': 0.0},
    'scale factor of a speed': {'speed.scale_sigma': 0.0}, 'offset of a heading': {'heading.offset_sigma': 0.0},
    'time offsets of inputs': {f'{name}.time_offset_sigma': 0.0 for name in (
        'speed', 'velocity', 'twist', 'heading', 'magnetometer', 'pressure')}}
#: others have no parameter: a value of a constant with which they never act
NEVER = {
    'end of weighting': {'trust.receiver.LONGEST_WEIGHTED': 1e9},
    'start anew where the filter diverged': {'trust.new_start.DIVERGED_SLOPE': 1e9},
    'growth from fix to fix': {'trust.receiver.LONGEST_GROWTH': 0.0},
    'floor of the gate': {'trust.receiver.GATE_FLOOR': 0.0},
    'speeds that repeat themselves': {'trust.repeats.ROUNDED_SPEED': 1e9, 'trust.repeats.AGEING': 0.0},
    'claims that change': {'trust.receiver.CLAIM_CHANGE': 1e9},
    'three fixes that bound the scatter': {'trust.receiver.LONGEST_OF_THREE': 0.0},
    'noise of the accelerometers that fixes show': {'trust.receiver.LARGEST_SCATTER': 0.0},
    'errors that last, always': {'trust.receiver.LASTING_SHARE': 1e-6},
    'acceleration unseen between fixes': {'trust.receiver.UNSEEN_ACCELERATION': 0.0},
    'slides': {'trust.contradiction.SLIDE_RATIO': 1e9},
    'state loosened after a slide': {'trust.contradiction.INFLATED_NIS': 1e9},
    'a second filter that takes fixes for wrong': {'trust.hypotheses.LOST_NATS': -1e9},
    'receivers that go straight on': {'trust.extrapolation.FEWEST_FIXES': 1e9},
    'IMU doubted after diverging': {'trust.imu_faults.WRONG_TIME': 0.0},
    'spikes': {'trust.imu_faults.LONGEST_SPIKE': 0.0},
    'frozen samples': {'trust.imu_faults.FROZEN_TIME': 1e9},
    'sensors freed after a restart': {'advance.SHORTEST_RESTART': 1e9},
    'constraint left out where it is not kept': {'constraints.CONSTRAINT_OFF': 1e9},
    'standstill denied by speed': {'trust.standstill.STOPS_PER_CREEP': 1e9},
    'standstill denied by turning': {'constraints.STILL_RATE': 1e3},
    'a heading in doubt where a gyroscope is off at a standstill': {'trust.gyroscopes.LONGEST_UNSEEN': 0.0},
    'gyroscopes whose error jumps': {'trust.gyroscopes.JUMP_SIGMAS': 1e9},
    'the end of such an error': {'trust.gyroscopes.SHORTEST_ERROR': 1e9},
    # the second filter
    'earlier begins of wrong fixes': {f'bank.EARLIER[{i}]': 0.0 for i in range(4)},
    'wrong fixes whose offset stays': {'trust.hypotheses.STAYS_WALK': 1e6},
    'the second filter where the first follows fixes that drift away': {'trust.fix_drift.FAR_RATIO': 1e9},
    'a new start that the second filter tries': {'trust.new_start.DIVERGED_AFTER': 1e9},
    'penalty of a new start': {'trust.hypotheses.RESTART_PENALTY': 0.0},
    'an IMU that may be wrong': {'trust.hypotheses.IMU_FAULT_PRIOR': -1e4},
    'the ellipse to the far side of the other filter': {'trust.hypotheses.LEAST_PROBABILITY': 2.0},
    'wrong fixes that jump or become right': {'trust.hypotheses.FAULT_END_RATE': 0.0},
    'an offset in time that is not declared': {'measurements.base.UNDECLARED_OFFSET': 0.0},
    # new starts
    'a new heading from the course': {'trust.new_start.LARGEST_YAW_SIGMA': 1e9},
    'refused fixes that have to agree': {'trust.new_start.AGREEMENT_SIGMAS': 1e9},
    'divergence that is significant': {'trust.new_start.SIGNIFICANCE': 2.0},
    # noise
    'noise of the accelerometers, from fixes or a new start': {'trust.force_noise.ASSUMED_DENSITY': 1e-12},
    'accelerations instead of the constraint where noise hides turns': {'trust.white_noise.COMPARED_OVER': 0.0},
    'fixes that scatter less than they claim': {'trust.scale.SMALLEST_SCALE': 1.0},
    'errors of the receiver that last': {'trust.receiver.LARGEST_LASTING': 0.0},
    'scales that become another one': {'trust.scale.CHANGE_RATE': 0.0},
    'outliers when a scale is learned': {'trust.scale.OUTLIER_DENSITY': 1e-12},
    'the least drift of the accelerometers': {'trust.drift.SMALLEST_DRIFT_RATIO': 0.0},
    'the largest reduction that tells a drift': {'trust.drift.LARGEST_REDUCTION': 1e9},
    # standstills and motion
    'creeps that fixes show': {'trust.creep.LONGEST_CREEP': -1.0},
    'standstill denied by wheels': {'trust.standstill.SLOWEST_SPEED': 1e9, 'trust.standstill.SLOWEST_TURN': 1e9},
    'motion of slow robots that is learned from': {'trust.standstill.CREEPING_TIME': 1e9},
    'usual speed': {'trust.usual_speed.SHORTEST_OUTAGE': 1e9},
    'slides again more easily': {'trust.contradiction.SLIDE_AGAIN_RATIO': 40.0},
    'all fixes used after a slide or a wrong input': {'trust.contradiction.USE_ALL_TIME': 0.0},
    # other inputs
    'slips of inputs': {'trust.inputs.SLIPPED': 1e9},
    'inputs that are far off': {'trust.inputs.GATE': 1e9, 'trust.inputs.NARROW_GATE': 1e9},
    'displacements of inputs': {'trust.displacement.ERROR_SIGMAS': 1e9},
    'inputs that wait for a comparison': {'trust.displacement.COMPARED_SIGMA': 1e9},
    'inputs that have to be right for some time': {'trust.inputs.RIGHT_AGAIN_AFTER': 0.0},
    'clocks that jump': {'trust.clock_jump.OFFSET_SIGMAS': 1e9},
    'lively inputs that stop': {'trust.repeats.LIVELY': 1e9},
    'errors of a speed that last': {'trust.inputs.SPEED_CORRELATION': 0.0},
    'outliers that do not end a displacement': {'apply.MOST_OUTLIERS': 0.0},
    # samples of the IMU
    'saturated samples': {'trust.imu_faults.LARGE_FORCE': 1e9, 'trust.imu_faults.LARGE_RATE': 1e9},
    'single axes that are stuck': {'trust.imu_faults.ALWAYS': 2.0}}
#: settings of vehicle.py, and of measured drives: path within the folder, s between outages, parameters
SETTINGS = ('car', 'car + speed')
MEASURED = {'longmont_rtk_drive': ('bag', 60.0, {'imu.mounting_rpy': [0.0, 0.0, np.pi]}),
            'karlsruhe_hills': ('bag', 60.0, {'reference_topic': '/reference/fix'}),
            'kingston_span': ('bag', 300.0, {'imu.mounting_rpy': [0.0, 0.0, -np.pi / 2],
                                             'reference_topic': '/reference/fix'}),
            'dresden_hobby_imu': ('', 30.0, {'imu.mounting_rpy': [0.0, 0.1, 0.0]}),
            'husky_wheel_speed': ('', 60.0, {'speed_topic': '/wheel/speed'})}
ROWS = ('faults', 'claims', 'inputs', 'car', 'measured')
OUTAGES = (30.0, 60.0)  # s
#: ns: the filter runs for so long before the first outage; and so long before a fault the drives are the same
SETTLING, COMMON = 60 * 10**9, 10 * 10**9
#: minutes of each simulated drive, and s between outages there
MINUTES, SPACING = 10.0, 100.0
#: what moves no row by more than this, m and percent, moves nothing; nor what moves it by this part of its
#: error
LEAST_M, LEAST_PERCENT, LEAST_PART = 0.05, 0.5, 0.02
#: rows, by a part of their name, whose errors nearly any change turns into others (docs/ablation.md)
CHAOTIC = ('angular rates in deg/s', 'IMU turned by 90 deg', 'boat')
COLUMNS = ('change', 'row', 'rate_hz', 'error_m', 'within_95_percent')


# -- drives that single mechanisms are for -----------------------------------------------------------------------------


def _degrees(force, rate, inside, rng):
    rate[inside] *= math.degrees(1.0)


def _turned(force, rate, inside, rng):
    """The IMU turned by 90 deg to the left, or a vehicle that goes sideways."""
    for values in (force, rate):
        values[inside] = values[inside][:, [1, 0, 2]] * [1.0, -1.0, 1.0]


def _spikes(force, rate, inside, rng):
    hit = np.flatnonzero(inside & (rng.random(len(inside)) < 0.05))
    force[hit] += rng.normal(0.0, 60.0, (len(hit), 3))
    rate[hit] += rng.normal(0.0, 5.0, (len(hit), 3))


FAULTS = (faults.of_imu('angular rates in deg/s for 60 s', 60.0, _degrees),
          faults.of_imu('IMU turned by 90 deg for 60 s', 60.0, _turned),
          faults.of_imu('5 % spikes for 60 s', 60.0, _spikes))


def _dies_in_a_tunnel(recording, *_):
    """A speed in whole km/h of which only the last value comes from 20 s on in a tunnel of a minute."""
    time, fixes = ((samples.stamp - recording.imu.stamp[0]) * 1e-9 - faults.BEGIN
                   for samples in (recording.speed, recording.gnss))
    speed, dead = np.round(3.6 * recording.speed.speed) / 3.6, (time > 20.0) & (time < 60.0)
    speed[dead] = speed[np.flatnonzero(dead)[0]]
    return replace(recording, gnss=recording.gnss.select((fixes < 0.0) | (fixes > 60.0)),
                   speed=replace(recording.speed, speed=speed))


INPUT_FAULTS = (*input_faults.FAULTS, faults.Fault(
    'speed in whole km/h dies in a tunnel of 60 s', 60.0, _dies_in_a_tunnel, _dies_in_a_tunnel,
    input_faults.INPUTS['speed']))


def boat(seed: int, rate: float, speed: float = 2.0):
    """A vehicle whose ground, water, moves by `speed`, m/s, from when it drives off; fixes of 5 cm."""
    drive = vehicle.simulated(seed, MINUTES, vehicle.GnssNoise(0.05, rate=rate))
    angle = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi)
    north, east = speed * np.cos(angle), speed * np.sin(angle)

    def moved(samples):
        seconds = np.maximum((samples.stamp - drive.imu.stamp[0]) * 1e-9 - 25.0, 0.0)
        return {'latitude': samples.latitude + north * seconds * faults.METRE,
                'longitude': samples.longitude + east * seconds * faults.METRE / np.cos(samples.latitude)}
    return replace(drive, gnss=replace(drive.gnss, **moved(drive.gnss)),
                   reference=replace(drive.reference, **moved(drive.reference)))


def robot(seed: int, rate: float):
    """0.4 m/s, with turns on the spot, on a floor that does not shake it, with wheel speed."""
    drive = simulate_drive(60.0 * MINUTES, seed, 50.0, standstill=10.0, manoeuvres=SLOW, grade=0.03, bank=0.03)
    recording = simulate_recording(drive, SensorErrors.from_parameters(table.defaults(), 'gauss_markov'),
                                   vehicle.GnssNoise(1.5, rate), seed=seed,
                                   aiding=SimulatedAiding(speed_rate=20.0)).recording
    return replace(recording, reference=recording.reference.select(slice(None, None, 5)))


def city(seed: int, rate: float):
    """Traffic that creeps, with a receiver that loses its satellites."""
    return vehicle.simulated(seed, MINUTES, replace(vehicle.FIXES['city'], rate=rate))


DRIVES = {'boat in a current of 2 m/s': (boat, {}), 'robot that turns on the spot': (robot, {'speed_topic': '/speed'}),
          'city': (city, {})}


# -- constants that can be changed after the filter has been compiled --------------------------------------------------

#: the values that compiled code looks up
VALUES = np.zeros(1000)


class Constant(float):
    """A number of the filter that compiled code finds at its place in VALUES, each time that it needs it."""

    def __new__(cls, value: float, place: int):
        made = super().__new__(cls, value)
        made.place, VALUES[place] = place, value
        return made


@lower_constant(types.float64)
def _look_up(context, builder, kind, value):
    """A constant in compiled code: as numba has it, or the value that stands in VALUES."""
    llvm = context.get_value_type(kind)
    if not isinstance(value, Constant):
        return llvm(value)
    address = ir.IntType(64)(VALUES.ctypes.data + VALUES.itemsize * value.place)
    return builder.load(builder.inttoptr(address, llvm.as_pointer()))


@cache
def constants() -> dict[str, float]:
    """All numbers that stand at the top of the files in capitals, by `file.NAME` or `file.NAME[i]`."""
    found = {}
    folder = ROOT / 'mems_ins_fusion' / 'filter'
    for path in sorted(path for pattern in FILES for path in folder.glob(pattern)):
        module = '.'.join(path.relative_to(folder).with_suffix('').parts)
        for node in ast.parse(path.read_text(encoding='utf-8')).body:
            if isinstance(node, ast.Assign):
                for target in node.targets:
                    for name in (target.elts if isinstance(target, ast.Tuple) else [target]):
                        if isinstance(name, ast.Name) and name.id.isupper() and not name.id.startswith('_'):
                            found |= _numbers(f'{module}.{name.id}')
    return found


def _numbers(name: str) -> dict[str, float]:
    module, attribute = name.rsplit('.', 1)
    value = getattr(importlib.import_module(f'{PACKAGE}.{module}'), attribute)
    if isinstance(value, float):
        return {name: value}
    if isinstance(value, tuple) and all(isinstance(v, float) for v in value) and not hasattr(value, '_fields'):
        return {f'{name}[{i}]': v for i, v in enumerate(value)}
    return {}


def lay_over(changes: dict[str, float]) -> None:
    """Give constants other values, in each module that has them, and in compiled code."""
    places = {name: i for i, name in enumerate(constants())}
    for name, value in changes.items():
        module, attribute = name.split('[')[0].rsplit('.', 1)
        old = getattr(importlib.import_module(f'{PACKAGE}.{module}'), attribute)
        new = Constant(value, places[name])
        if '[' in name:
            i = int(name[name.index('[') + 1:-1])
            new = (*old[:i], new, *old[i + 1:])
        for known in [m for n, m in list(sys.modules.items()) if n.startswith(PACKAGE) and m is not None]:
            if known.__dict__.get(attribute) is old:
                setattr(known, attribute, new)


# -- rows --------------------------------------------------------------------------------------------------------------


class Shared(Replay):
    """A replay whose begin, till `common` ns, is that of others: the first of them leaves the filter's memory in `left`
    under `key`, from which the others go on."""

    def share(self, common: int, left: dict, key) -> Shared:
        self.common, self.left, self.key = common, left, key
        return self

    def _filter(self, memory, samples, index, events, epoch):
        kept = np.flatnonzero(self.keep[index])
        states = np.empty((len(kept), len(self.columns)))
        events.event[:, Event.ID] = np.arange(len(events.kind))
        work = Playback(samples, events, self.columns, kept, states)
        stop = int(np.searchsorted(samples[:, 0], (self.common - epoch) * 1e-9))
        if self.stretches:  # after a restart, which the others have not
            pass
        elif self.key in self.left:
            memory[:] = self.left[self.key]
            work.sample, work.next_event = stop, int(np.searchsorted(events.arrival, stop))
        else:
            work.advance(memory, stop)
            self.left[self.key] = memory.copy()
        work.advance(memory, len(samples))
        work.finish(memory)
        self.stretches.append(Stretch(index[kept], states))


def given(recording, values: dict, changed: dict) -> tuple:
    """What a replay of the recording is given, with these parameters changed."""
    values, there = table.check({**values, **changed}), recording.streams()
    aiding = Aiding({one.name: there[one.name] for one in inputs(values) if values[one.topic]})
    return FilterConfig.from_parameters(values), recording.imu, recording.gnss, aiding


def until(recording, last: int):
    """What of a recording has been received till `last`, ns."""
    return recording.having({name: samples.select(getattr(samples, 'received', samples.stamp) <= last)
                             for name, samples in recording.streams().items()})


def of_fault(fault, seeds, rate: float, drive: Callable, left: dict) -> Callable:
    """A row of faults.py or input_faults.py: called with changed parameters it gives the lines of the table. left: see
    `Shared`; emptied before each change."""
    prepared = []
    for seed in seeds:
        clean = drive(seed, rate)
        values = {'reference_lever_arm': [0.0, 0.0, 0.0], **fault.values}
        first = clean.imu.stamp[0] + round(fault.begin(clean) * 1e9)
        last = first + round((fault.duration + 60.0) * 1e9)
        recording = until(faults.altered(fault, clean, seed), last + 10**9)
        truth = truth_of(clean, table.check(values))
        truth = truth.select((truth.reference.stamp >= first) & (truth.reference.stamp <= last))
        key = (drive.__module__, *fault.values, seed, first, rate)
        prepared.append((recording, first, key, run(*given(recording, values, {})).start, truth))

    def judge(changed: dict) -> list[tuple[str, float, float]]:
        found = []
        for recording, first, key, start, truth in prepared:
            config, imu, fixes, aiding = given(recording, values, changed)
            keep = imu.stamp > first - 10**9
            replay = Shared(config, imu, fixes, aiding, start, keep).share(first - COMMON, left, key)
            found.append(errors_of(replay.run(), truth))
        return [(fault.name, max(e.horizontal.max(initial=0.0) for e in found), share(found))]
    return judge


def of_drives(name: str, recordings, values: dict, spacing: float) -> Callable:
    """The rows of whole drives, as one."""
    prepared = []
    for recording in recordings:
        truth = truth_of(recording, table.check(values))
        begins = outage_begins(int(recording.imu.stamp[0]) + SETTLING, recording.gnss, 0.0, spacing, max(OUTAGES))
        keep = samples_to_keep(recording.imu, truth.reference.stamp)
        prepared.append((recording, begins, keep, run(*given(recording, values, {})).start, truth))

    def judge(changed: dict) -> list[tuple[str, float, float]]:
        runs, outages = [], defaultdict(list)
        for recording, begins, keep, start, truth in prepared:
            config, imu, fixes, aiding = given(recording, values, changed)
            whole, coasting = run_with_outages(config, imu, fixes, begins, max(OUTAGES), aiding, keep, start)
            runs.append(errors_of(whole, truth))
            for found in outages_of(whole, coasting, truth, OUTAGES, config.imu.restart_gap):
                outages[found.duration].append(found)
        error = np.concatenate([e.horizontal for e in runs])
        lines = [(name, rms(error), share(runs))]
        for duration, found in outages.items():
            largest, within = (np.concatenate([getattr(o, part) for o in found]) for part in ('max_error', 'within'))
            lines.append((f'{name}, {duration:g} s without fixes', np.percentile(largest, 95), 100.0 * within.mean()))
        return lines
    return judge


def errors_of(run, truth):
    return position_errors(run, truth, np.zeros(len(truth), dtype=bool))


def share(found) -> float:
    """How often the 95 % ellipse held the truth, %."""
    return 100.0 * float(np.concatenate([e.nees < NEES_95 for e in found]).mean())


def rows(arguments, left: dict) -> Iterator[tuple[float, Callable]]:
    """The rows asked for: rate of the fixes, Hz (0: as recorded), and what judges."""
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    for rate in arguments.rates:
        for kind, drive, known in (('faults', faults.clean_drive, faults.FAULTS),
                                   ('claims', faults.clean_drive, FAULTS),
                                   ('inputs', input_faults.clean, INPUT_FAULTS)):
            if kind in arguments.rows:
                for fault in [f for f in known if any(part in f.name for part in arguments.faults)]:
                    yield rate, of_fault(fault, seeds, rate, drive, left)
        if 'claims' in arguments.rows:
            for name, (drive, values) in DRIVES.items():
                yield rate, of_drives(name, [drive(seed, rate) for seed in seeds], {
                    **values, 'reference_lever_arm': [0.0, 0.0, 0.0]}, SPACING)
        if 'car' in arguments.rows:
            drives = [vehicle.simulated(seed, MINUTES, vehicle.GnssNoise(1.5, rate=rate)) for seed in seeds]
            for setting in SETTINGS:
                values = {**vehicle.SETTINGS[setting], 'reference_lever_arm': [0.0, 0.0, 0.0]}
                yield rate, of_drives(setting, drives, values, SPACING)
    if 'measured' in arguments.rows:
        for name, (path, spacing, values) in MEASURED.items():
            if (arguments.data / name).exists():
                values = table.check(values)
                topics = {one.topic: values[one.topic] for one in inputs(values) if values[one.topic]}
                recording = read_recording(arguments.data / name / path, '/imu/data', '/gps/fix',
                                           values['reference_topic'] or None, **topics)
                yield 0.0, of_drives(name, [recording], values, spacing)


# -- the study ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Change:
    """What is done to the filter: parameters and constants with other values."""

    name: str
    values: dict
    constants: dict


def changes(only: list[str]) -> list[Change]:
    """The filter as it is, then each mechanism off, then each constant with each factor; `only`: with that in the
    name."""
    made = [Change(f'without {name}', values, {}) for name, values in MECHANISMS.items()]
    made += [Change(f'without {name}', {}, values) for name, values in NEVER.items()]
    made += [Change(f'{name} x {factor:g}', {}, {name: factor * value})
             for name, value in constants().items() for factor in FACTORS]
    return [Change('as it is', {}, {}), *(c for c in made if not only or any(part in c.name for part in only))]


def summary(rows: list[dict]) -> list[str]:
    """What moves nothing, and where the others help and cost most, against the filter as it is."""
    by_change = defaultdict(dict)
    for row in rows:
        by_change[row['change']][row['row'], row['rate_hz']] = (float(row['error_m']),
                                                                float(row['within_95_percent']))
    plain, moving, idle, impossible = by_change.pop('as it is'), {}, [], []
    for change, found in by_change.items():
        if not found.keys() <= plain.keys():  # a division by zero
            impossible.append(change)
            continue
        moved = {key: (value[0] - plain[key][0], value[1] - plain[key][1]) for key, value in found.items()}
        rates = [key[1] for key, (m, p) in moved.items()
                 if abs(m) >= max(LEAST_M, LEAST_PART * plain[key][0]) or abs(p) >= LEAST_PERCENT]
        if not rates:
            idle.append(change)
            continue
        best, worst = min(moved, key=lambda key: moved[key][0]), max(moved, key=lambda key: moved[key][0])
        counts = ', '.join(f'{rates.count(rate)} at {rate} Hz' for rate in dict.fromkeys(rate for _, rate in plain))
        calm = [key for key in moved if not any(part in key[0] for part in CHAOTIC)]
        mean = 100.0 * math.expm1(np.mean([math.log(max(found[key][0], LEAST_M) / max(plain[key][0], LEAST_M))
                                           for key in calm]))
        within = np.mean([moved[key][1] for key in calm])
        moving[change] = (moved[worst][0] - moved[best][0], (
            f'{change:45s} {moved[best][0]:+8.2f} m {best[0]} ({best[1]} Hz)   {moved[worst][0]:+8.2f} m '
            f'{worst[0]} ({worst[1]} Hz); {counts}; mean {mean:+.1f} %, in the ellipse {within:+.2f} %'))
    lines = [line for _, line in sorted(moving.values(), reverse=True)]
    return [*lines, f'move nothing: {", ".join(idle) or "none"}',
            f'impossible (division by zero): {", ".join(impossible) or "none"}']


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--list', action='store_true', help='the constants and their values')
    parser.add_argument('--summary', nargs='+', type=Path, metavar='FILE.csv', help='of what has been written')
    parser.add_argument('--only', nargs='+', default=[], help='changes with one of these in their name')
    parser.add_argument('--rows', nargs='+', choices=ROWS, default=ROWS)
    parser.add_argument('--faults', nargs='+', default=[''], metavar='TEXT',
                        help='those with one of these in their name')
    parser.add_argument('--rates', nargs='+', type=float, default=[0.2, 1.0, 10.0], help='of the fixes, Hz')
    parser.add_argument('--seeds', type=int, default=1)
    parser.add_argument('--first-seed', type=int, default=2000)
    parser.add_argument('--data', type=Path, default=ROOT.parent / 'shared' / 'data', help='folder of measured drives')
    parser.add_argument('--output', type=Path, default=Path('ablation.csv'))
    arguments = parser.parse_args()
    if arguments.list:
        print('\n'.join(f'{name:45s} {value:g}' for name, value in constants().items()))
    elif arguments.summary:
        print('\n'.join(summary([row for path in arguments.summary for row in _read(path)])))
    else:
        study(arguments)
        print('\n'.join(summary(_read(arguments.output))))


def study(arguments) -> None:
    """Add to the file what it has not yet."""
    lay_over(constants())
    left: dict = {}
    judges = list(rows(arguments, left))
    done = _read(arguments.output) if arguments.output.exists() else []
    finished = {row['change'] for row in done}
    with open(arguments.output, 'a', newline='') as file:
        writer = csv.writer(file, lineterminator='\n')
        if not done:
            writer.writerow(COLUMNS)
        for change in changes(arguments.only):
            if change.name not in finished:
                lay_over(change.constants)
                left.clear()
                try:
                    lines = [(change.name, name, f'{rate:g}', f'{error:.4f}', f'{within:.2f}')
                             for rate, judge in judges for name, error, within in judge(change.values)]
                except ZeroDivisionError:  # the constant is a bound that keeps numbers finite
                    lines = [(change.name, 'as it is', '0', 'inf', '0')]
                writer.writerows(lines)
                lay_over({name: constants()[name] for name in change.constants})
                file.flush()
                print(change.name, flush=True)


def _read(path: Path) -> list[dict]:
    with open(path, newline='') as file:
        return list(csv.DictReader(file))


if __name__ == '__main__':
    main()
