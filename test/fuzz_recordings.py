"""Whole recordings of absurd but well-formed content, and the tools that are to make something of them.

A drive is simulated once; a case changes it by one to three of `ABSURDITIES`, writes it as a bag and lets a tool read
that: `configure`, `diagnose` (with topics only, or with the file of `configure`), `replay_node` or `characterize`.
"""
from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import numpy as np

from mems_ins_fusion.samples import Recording

SECOND = 10**9
DAY = 86400 * SECOND
#: values that no sensor delivers, and some that one may
EXTREME = (1e300, -1e300, 1e30, 1e18, 1e6, 1e-300, np.nan, np.inf, -np.inf, 0.0, 300.0)
#: what a clock that is not set, or is another one, is off by, ns
SHIFTS = (-DAY, DAY, -3600 * SECOND, 3600 * SECOND, -5 * SECOND, 5 * SECOND, -SECOND // 20, 20 * SECOND)
TOOLS = ('configure', 'diagnose', 'configure diagnose', 'replay', 'characterize')
#: s of processor time that a tool may take for such a recording
LONGEST = {'diagnose': 300, 'configure diagnose': 300, 'replay': 60, 'configure': 60, 'characterize': 120}


@cache
def drive(kind: str) -> Recording:
    """The recordings that are spoiled: two minutes, but for one at rest, with a standstill in the beginning."""
    from mems_ins_fusion.parameters import table
    from mems_ins_fusion.simulation.scene import SCENES
    from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

    scene, rate = SCENES['flat' if kind == 'rest' else 'realistic'], {'phone': 10.0}.get(kind, 50.0)
    seconds = 60.0 if kind == 'rest' else 130.0
    values = table.check(scene.imu)
    moved = scene.drive(seconds, 3, rate, standstill=seconds if kind == 'rest' else 12.0)
    distortions = {**scene.distortions(3),
                   'aiding': SimulatedAiding(speed_rate=5.0, velocity_rate=1.0, heading_rate=1.0)}
    found = simulate_recording(moved, SensorErrors.from_parameters(values, 'gauss_markov'), GnssNoise(1.5), seed=3,
                               **distortions).recording
    return replace(found, reference=found.reference.select(slice(None, None, 10)))


# -- what is changed ---------------------------------------------------------------------------------------------------

def _array(rng, samples, *names):
    """One of the arrays of `samples` called `names`, as a copy that may be written to, and its name."""
    name = rng.choice(names)
    return name, np.array(getattr(samples, name), dtype=float)


def _some(rng, count: int):
    """Where something is changed: at one, at some, in a stretch, or everywhere."""
    begin = rng.randrange(count)
    return rng.choice([begin, 0, count - 1, rng.sample(range(count), max(count // 20, 1)),
                       slice(begin, begin + count // 5 + 1), slice(None)])


def imu_extreme(recording, rng):
    name, values = _array(rng, recording.imu, 'specific_force', 'angular_rate')
    axes = rng.choice([0, 2, slice(None)])
    values[_some(rng, len(values)), axes] = rng.choice(EXTREME)
    return replace(recording, imu=replace(recording.imu, **{name: values}))


def imu_constant(recording, rng):
    """An axis, a sensor or all of it without any change, for ever or from some time on."""
    imu = recording.imu
    chosen = rng.choice([('specific_force',), ('angular_rate',), ('specific_force', 'angular_rate')])
    axes, begin = rng.choice([0, 2, slice(None)]), rng.choice([0, rng.randrange(len(imu))])
    changed = {}
    for name in chosen:
        values = np.array(getattr(imu, name))
        values[begin:, axes] = rng.choice([0.0, values[begin, axes]])
        changed[name] = values
    return replace(recording, imu=replace(imu, **changed))


def imu_scaled(recording, rng):
    """Other units, other axes, mirrored or swapped ones."""
    imu, matrix = recording.imu, np.eye(3)[rng.sample(range(3), 3)] * [rng.choice([-1, 1]) for _ in range(3)]
    force, rate = rng.choice([1.0, 1 / 9.80665, 1000 / 9.80665, 1e-6, 1e-200]), rng.choice([1.0, 57.3, 1e3, 1e-200])
    return replace(recording, imu=replace(imu, specific_force=force * imu.specific_force @ matrix.T,
                                          angular_rate=rate * imu.angular_rate @ matrix.T))


def _twice(samples, rng):
    """Each message, or some, twice: at once, or with the receipt of the first."""
    count = len(samples)
    again = rng.choice([np.arange(count), np.array(rng.sample(range(count), max(count // 10, 1)))])
    return samples.select(np.sort(np.concatenate([np.arange(count), again])))


def imu_twice(recording, rng):
    return replace(recording, imu=_twice(recording.imu, rng))


def fixes_twice(recording, rng):
    return replace(recording, gnss=_twice(recording.gnss, rng))


def _dated(samples, rng):
    """Stamps, and with them perhaps the log times, of another clock."""
    stamp, received = samples.stamp.copy(), samples.received.copy()
    where = _some(rng, len(stamp))
    if rng.random() < 0.3:
        stamp[where] = rng.choice([0, 1, 2**31 * SECOND - 1, int(stamp[0])])
    else:
        stamp[where] += rng.choice(SHIFTS)
    stamp = np.clip(stamp, 0, 2**31 * SECOND - 1)
    if rng.random() < 0.3:
        received = stamp.copy()
    return replace(samples, stamp=stamp, received=received)


def imu_dated(recording, rng):
    return replace(recording, imu=_dated(recording.imu, rng))


def fixes_dated(recording, rng):
    return replace(recording, gnss=_dated(recording.gnss, rng))


def stamps_coarse(recording, rng):
    """Stamps of whole seconds or tenths, or time that runs thousand times too fast or too slow."""
    def change(samples):
        first = int(samples.stamp[0])
        past = samples.stamp - first
        stamp = first + {'s': past // SECOND * SECOND, 'ds': past // (SECOND // 10) * (SECOND // 10), 'fast':
                         past // 1000, 'slow': past * 1000, 'none': 0 * past}[how]
        return replace(samples, stamp=stamp, received=stamp)

    how = rng.choice(['s', 'ds', 'fast', 'slow', 'none'])
    which = rng.choice([('imu',), ('gnss',), ('imu', 'gnss')])
    return replace(recording, **{name: change(getattr(recording, name)) for name in which})


def fixes_far(recording, rng):
    """Fixes that teleport, stand still, or are nowhere."""
    name, values = _array(rng, recording.gnss, 'latitude', 'longitude', 'height')
    where = _some(rng, len(values))
    if name == 'height':
        values[where] = rng.choice([*EXTREME, 9e4, -9e4, 9999.0])
    else:
        values[where] += rng.choice([1e-5, 1e-4, 1e-2, 1.0, np.pi, *EXTREME])
    return replace(recording, gnss=replace(recording.gnss, **{name: values}))


def fixes_frozen(recording, rng):
    gnss, where = recording.gnss, _some(rng, len(recording.gnss))
    changed = {}
    for name in ('latitude', 'longitude', 'height')[:rng.choice([2, 3])]:
        values = getattr(gnss, name).copy()
        values[where] = values[len(values) // 2]
        changed[name] = values
    return replace(recording, gnss=replace(gnss, **changed))


def elsewhere(recording, rng):
    """The same drive at a pole, at the date line, at the equator, or far too high."""
    moves = {'pole': (np.pi / 2 - recording.gnss.latitude.max() - rng.choice([0.0, 1e-12, 1e-6, 1e-3]), 0.0),
             'date line': (0.0, np.pi - recording.gnss.longitude.mean()),
             'null': (-recording.gnss.latitude[0], -recording.gnss.longitude[0])}
    north, east = moves[rng.choice(list(moves))]
    changed = {}
    for name in ('gnss', 'reference'):
        samples = getattr(recording, name)
        longitude = samples.longitude + east
        changed[name] = replace(samples, latitude=samples.latitude + north,
                                longitude=np.where(longitude > np.pi, longitude - 2 * np.pi, longitude))
    return replace(recording, **changed)


def fixes_sigma(recording, rng):
    covariance = np.array(recording.gnss.covariance)
    where = _some(rng, len(covariance))
    covariance[where] = rng.choice([1e-300, 1e-12, 1e-6, 1e12, 1e300, np.nan, 0.0, -1.0]) * rng.choice(
        [np.eye(3), np.ones((3, 3)), np.diag([1.0, 1e-9, 1.0])])
    kind = np.full(len(covariance), rng.choice([0, 1, 2, 3]), np.uint8)
    return replace(recording, gnss=replace(recording.gnss, covariance=covariance, covariance_type=kind))


def fixes_status(recording, rng):
    status = recording.gnss.status.copy()
    status[_some(rng, len(status))] = rng.choice([-1, 2, 100])
    return replace(recording, gnss=replace(recording.gnss, status=status))


def gaps(recording, rng):
    """Pieces of IMU and of fixes missing in turn, or all but some seconds."""
    imu, gnss = recording.imu, recording.gnss
    first, last = int(imu.stamp[0]), int(imu.stamp[-1])
    period = rng.choice([4, 12, 40]) * SECOND
    if rng.random() < 0.3:
        last = first + rng.choice([1, 5, 30, 70]) * SECOND
        imu, gnss = (s.select(s.stamp <= max(last, int(s.stamp[0]))) for s in (imu, gnss))
    phase = rng.choice([0.2, 0.5, 0.8])
    keep = ((imu.stamp - first) % period) / period < phase
    keep_fix = ((gnss.stamp - first) % period) / period > rng.choice([phase, phase / 2])
    imu, gnss = (s.select(k) if k.any() else s for s, k in ((imu, keep), (gnss, keep_fix)))
    return replace(recording, imu=imu, gnss=gnss)


def few(recording, rng):
    """Only some samples, or some fixes."""
    name = rng.choice(['imu', 'gnss'])
    samples = getattr(recording, name)
    count = rng.choice([1, 2, 3, 10, 70])
    kept = rng.choice([slice(0, count), slice(-count, None), slice(None, None, max(len(samples) // count, 1))])
    return replace(recording, **{name: samples.select(kept)})


def slow_imu(recording, rng):
    return replace(recording, imu=recording.imu.select(slice(None, None, rng.choice([5, 10, 50]))))


def aiding_absurd(recording, rng):
    name, value = rng.choice([('speed', 'speed'), ('speed', 'variance'), ('velocity', 'velocity'),
                              ('velocity', 'covariance'), ('heading', 'yaw'), ('heading', 'variance')])
    samples = getattr(recording, name)
    values = np.array(getattr(samples, value))
    values[_some(rng, len(values))] = rng.choice(EXTREME)
    samples = replace(samples, **{value: values})
    if rng.random() < 0.4:
        samples = _dated(samples, rng)
    return replace(recording, **{name: samples})


def reference_absurd(recording, rng):
    name, values = _array(rng, recording.reference, 'latitude', 'longitude', 'height')
    values[_some(rng, len(values))] += rng.choice([1e-3, 1.0, *EXTREME])
    reference = replace(recording.reference, **{name: values})
    if rng.random() < 0.3:
        reference = replace(reference, stamp=np.clip(reference.stamp + rng.choice(SHIFTS), 0, None))
    return replace(recording, reference=reference)


def arrival(recording, rng):
    """Log times that tell another story than the stamps."""
    def change(samples):
        received = {'late': samples.received + 30 * SECOND, 'same': np.full_like(samples.received, samples.received[0]),
                    'years': samples.received - 365 * DAY}[how]
        return replace(samples, received=np.clip(received, 0, None))

    how, which = rng.choice(['late', 'same', 'years']), rng.choice([('imu',), ('gnss',), ('imu', 'gnss')])
    return replace(recording, **{name: change(getattr(recording, name)) for name in which})


ABSURDITIES = (imu_extreme, imu_extreme, imu_constant, imu_scaled, imu_twice, fixes_twice, imu_dated, imu_dated,
               fixes_dated, stamps_coarse, fixes_far, fixes_far, fixes_frozen, elsewhere, fixes_sigma, fixes_status,
               gaps, gaps, few, slow_imu, aiding_absurd, reference_absurd, arrival)


def _set(recording, stream, name, where, value, add=False):
    samples = getattr(recording, stream)
    values = np.array(getattr(samples, name))
    values[where] = values[where] + value if add else value
    return replace(recording, **{stream: replace(samples, **{name: values})})


def _at_pole(recording, apart):
    north = np.pi / 2 - apart - recording.gnss.latitude.max()
    for stream in ('gnss', 'reference'):
        recording = _set(recording, stream, 'latitude', slice(None), north, True)
    return recording


def _in_turn(recording):
    """Eight seconds of IMU, then eight of fixes."""
    imu, gnss = recording.imu, recording.gnss
    odd, odd_fix = ((samples.stamp - imu.stamp[0]) // (8 * SECOND) % 2 == 1 for samples in (imu, gnss))
    return replace(recording, imu=imu.select(~odd), gnss=gnss.select(odd_fix))


def _repeated(recording, stream):
    samples = getattr(recording, stream)
    return replace(recording, **{stream: samples.select(np.repeat(np.arange(len(samples)), 2))})


_ALL = slice(None)
#: what once ended a tool, each by itself
KNOWN = {
    'one sample of 1e300': lambda r: _set(r, 'imu', 'specific_force', (1000, 0), 1e300),
    'one sample of 1e30': lambda r: _set(r, 'imu', 'specific_force', (1000, 0), 1e30),
    'one turn rate of 1e300': lambda r: _set(r, 'imu', 'angular_rate', (1000, 2), 1e300),
    'a constant IMU': lambda r: _set(_set(r, 'imu', 'specific_force', _ALL, [0.1, 0.2, 9.8]), 'imu', 'angular_rate',
                                     _ALL, [0.01, 0.0, 0.0]),
    'constant accelerometers': lambda r: _set(r, 'imu', 'specific_force', _ALL, [0.1, 0.2, 9.8]),
    'a dead IMU': lambda r: _set(_set(r, 'imu', 'specific_force', _ALL, 0.0), 'imu', 'angular_rate', _ALL, 0.0),
    'dead accelerometers': lambda r: _set(r, 'imu', 'specific_force', _ALL, 0.0),
    'an IMU whose values have squares of zero': lambda r: replace(r, imu=replace(
        r.imu, specific_force=1e-200 * r.imu.specific_force, angular_rate=1e-200 * r.imu.angular_rate)),
    'dead gyroscopes': lambda r: _set(r, 'imu', 'angular_rate', _ALL, 0.0),
    'each sample twice': lambda r: _repeated(r, 'imu'), 'each fix twice': lambda r: _repeated(r, 'gnss'),
    'one stamp of 1970': lambda r: _set(r, 'imu', 'stamp', 1000, 0),
    'the first stamp a day early': lambda r: _set(r, 'imu', 'stamp', 0, -DAY, True),
    'the first stamp a day late': lambda r: _set(r, 'imu', 'stamp', 0, DAY, True),
    'a clock set back by 5 s': lambda r: _set(r, 'imu', 'stamp', slice(3000, None), -5 * SECOND, True),
    'a fix that teleports': lambda r: _set(r, 'gnss', 'latitude', 60, 0.5, True),
    'fixes that have teleported': lambda r: _set(r, 'gnss', 'latitude', slice(60, None), 0.5, True),
    'a sigma of nothing': lambda r: _set(r, 'gnss', 'covariance', _ALL, 1e-300 * np.eye(3)),
    'at the pole': lambda r: _at_pole(r, 0.0), 'a metre from the pole': lambda r: _at_pole(r, 2e-7),
    'IMU and fixes in turn': _in_turn,
    'fixes in one place': lambda r: _set(_set(r, 'gnss', 'latitude', _ALL, 0.8), 'gnss', 'longitude', _ALL, 0.2),
    'one fix': lambda r: replace(r, gnss=r.gnss.select(slice(60, 61))),
    'two samples': lambda r: replace(r, imu=r.imu.select(slice(0, 2))),
    'an IMU of 1 Hz': lambda r: replace(r, imu=r.imu.select(slice(None, None, 50)))}


def in_order(recording: Recording) -> Recording:
    """As a bag holds it: each stream in the order of its arrival."""
    changed = {}
    for field in fields(recording):
        samples = getattr(recording, field.name)
        if samples is not None and hasattr(samples, 'received'):
            changed[field.name] = samples.select(np.argsort(samples.received, kind='stable'))
    return replace(recording, **changed)


# -- what is done with it ----------------------------------------------------------------------------------------------

def recording_case(folder: Path, rng: random.Random, tool: str) -> tuple[str, Callable[[], object]]:
    """(what is changed, the tool's work) of one recording, which is written to `folder`."""
    kind = 'rest' if tool == 'characterize' else rng.choice(['car', 'car', 'phone'])
    recording, done = drive(kind), []
    for absurd in rng.sample(ABSURDITIES, rng.choice([1, 1, 2, 3])):
        with np.errstate(all='ignore'):
            recording = absurd(recording, rng)
        done.append(absurd.__name__)
    bag = folder / 'absurd'
    written(recording, bag)
    return f'{kind}: {", ".join(done)}', lambda: use(tool, bag, folder, rng.random() < 0.3)


def written(recording: Recording, bag: Path) -> Path:
    """`recording` as the bag `bag`."""
    from mems_ins_fusion.recordings.writing import write_recording

    write_recording(in_order(recording), bag, overwrite=True)
    return bag


def use(tool: str, bag: Path, folder: Path, with_reference: bool) -> object:
    """`tool` on `bag`; its exit status."""
    from mems_ins_fusion.cli import characterize, configure, diagnose

    out, file = folder / f'out_{tool.replace(" ", "_")}', folder / 'found.yaml'
    shutil.rmtree(out, ignore_errors=True)
    topics = [line for line, wanted in (('reference_topic: /reference/fix', with_reference),
                                        ('speed_topic: /wheel/speed', True), ('velocity_topic: /gps/velocity', True),
                                        ('heading_topic: /gps/heading', True)) if wanted]
    given = folder / 'topics.yaml'
    given.write_text('/**:\n  ros__parameters:\n    imu_topic: /imu/data\n' + ''.join(f'    {t}\n' for t in topics))
    if tool == 'replay':
        return _replay(bag, out, given)
    if tool == 'characterize':
        return characterize.main(['--bag', str(bag), '--output', str(out)])
    status, files = 0, ['--params-file', str(given)]
    if 'configure' in tool:
        status = configure.main(['--bag', str(bag), '--output', str(file), '--overwrite'])
        files = ['--params-file', str(file)]
    if 'diagnose' in tool and status == 0:
        status = diagnose.main(['--bag', str(bag), '--output', str(out), *files])
    return status


def _replay(bag, out, given) -> object:
    from mems_ins_fusion.parameters import params_file, table
    from mems_ins_fusion.reports.replay import replay_recordings

    values = table.check({**params_file.load_yaml(given), 'bag': [str(bag)], 'output_dir': str(out)})
    values.update(models=['gauss_markov'], update_intervals=[1.0], outage_durations=[10.0], smoothing=True)
    replay_recordings(values)
