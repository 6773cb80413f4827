"""What the filter makes of faults: simulated realistic drives with one fault each, parameters at their defaults.

    python studies/faults.py [--seeds 6] [--rate 1] [--set NAME=VALUE ...] [--output FILE.md] [--figure FILE.png]

Each fault begins at 200 s of a drive of 360 s (100 Hz, fixes of 1.5 m at --rate, simulation/scene.py REALISTIC). The
table holds the largest error from its begin to its end, the error 20 s after its end (RMS of 5 s, over all seeds)
beside that of the same filter without the fault and of one that coasts: it has no fixes while a fault of theirs lasts,
is told of each sample of a faulty IMU that it is wrong, or has not the speed or heading that is. Then how often the
95 % ellipse held the truth from the begin to 60 s after the end, and what was said. The figure shows the error of the
first seed over time, for each fault, and how large the 95 % ellipse was in its direction.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import yaml
from scipy.signal import lfilter
from vehicle import simulated

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95, position_errors, rms
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.measurements.registry import aiding as inputs
from mems_ins_fusion.filter.runs.imus import as_one
from mems_ins_fusion.filter.runs.replay import Aiding, run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.simulation import GnssNoise

BEGIN, MINUTES = 200.0, 6.0
METRE = 1.0 / 6.37e6  # rad of latitude


@dataclass(frozen=True)
class Fault:
    """One fault. alter(recording, inside_imu (n,), inside_fixes (m,), rng) gives the recording with it, coast(the same)
    that without what is wrong: fixes by default, or samples that are out of every range. values: parameters that it
    needs. begin(recording): s after the recording's begin."""

    name: str
    duration: float
    alter: Callable
    coast: Callable
    values: dict = field(default_factory=dict)
    begin: Callable = lambda recording: BEGIN


def _coast_without_fixes(recording, _, inside, rng):
    return replace(recording, gnss=recording.gnss.select(~inside))


def of_fixes(name, duration, change):
    """A fault of the receiver: change(fixes, inside, rng) gives the fixes with it."""
    def alter(recording, _, inside, rng):
        return replace(recording, gnss=change(recording.gnss, inside, rng))
    return Fault(name, duration, alter, _coast_without_fixes)


def of_imu(name, duration, change, **more):
    """A fault of the IMU: change(specific force, angular rate, inside, rng) on copies of both."""
    def alter(recording, inside, _, rng, change=change):
        force, rate = recording.imu.specific_force.copy(), recording.imu.angular_rate.copy()
        change(force, rate, inside, rng)
        return replace(recording, imu=replace(recording.imu, specific_force=force, angular_rate=rate))
    return Fault(name, duration, alter, partial(alter, change=_known_as_wrong), **more)


def of_aiding(name, duration, kind, change):
    """A fault of the speed or the heading (kind): change(samples, inside) gives the samples with it."""
    def within(recording, inside):
        imu, samples = recording.imu.stamp, getattr(recording, kind)
        first, last = imu[np.flatnonzero(inside)[[0, -1]]]
        return samples, (samples.stamp >= first) & (samples.stamp <= last)

    def alter(recording, inside, *_):
        return replace(recording, **{kind: change(*within(recording, inside))})

    def coast(recording, inside, *_):
        samples, wrong = within(recording, inside)
        return replace(recording, **{kind: samples.select(~wrong)})
    return Fault(name, duration, alter, coast, {f'{kind}_topic': f'/{kind}'})


def of_stamps(name, duration, change):
    """A fault of the IMU's driver: change(imu, inside, rng) gives the samples with it."""
    def alter(recording, inside, _, rng):
        return replace(recording, imu=change(recording.imu, inside, rng))
    return Fault(name, duration, alter, _coast_without_fixes)


def _known_as_wrong(force, rate, inside, rng):
    force[inside] = 1e6


def _set(array, value, axis=slice(None)):
    def change(force, rate, inside, rng):
        target = force if array == 'force' else rate
        target[np.flatnonzero(inside), axis] = value
    return change


def _zeros(force, rate, inside, rng):
    force[inside] = rate[inside] = 0.0


def _freeze(force, rate, inside, rng):
    first = np.flatnonzero(inside)[0]
    force[inside], rate[inside] = force[first], rate[first]


def _stuck(array, axis):
    def change(force, rate, inside, rng):
        target = force if array == 'force' else rate
        target[inside, axis] = target[np.flatnonzero(inside)[0], axis]
    return change


def _swapped(force, rate, inside, rng):
    for values in (force, rate):
        values[inside] = values[inside][:, [1, 0, 2]]


def _noisy(force, rate, inside, rng):
    force[inside] += rng.normal(0.0, 3.0, (inside.sum(), 3))
    rate[inside] += rng.normal(0.0, 0.2, (inside.sum(), 3))


def _biased(force, rate, inside, rng):
    rate[inside, 2] += np.radians(5.0)


def _parked(recording):
    """Begin of the longest standstill from 100 s on that leaves 90 s to the end, s after the recording's begin."""
    reference = recording.reference
    time = (reference.stamp - recording.imu.stamp[0]) * 1e-9
    usable = (time > 100.0) & (time < 60.0 * MINUTES - 90.0)
    still = np.concatenate([[0], (np.linalg.norm(reference.velocity, axis=1) < 0.02) & usable, [0]])
    first, last = np.flatnonzero(np.diff(still) == 1), np.flatnonzero(np.diff(still) == -1)
    return float(time[first[np.argmax(last - first)]]) if len(first) else BEGIN


def _restarted(force, rate, inside, rng):
    """An IMU that says nothing useful for as long, and comes back with other biases."""
    last = np.flatnonzero(inside)[-1]
    force[inside] = rate[inside] = 0.0
    force[last:] += rng.normal(0.0, 0.1, 3)
    rate[last:] += np.radians(rng.normal(0.0, 0.3, 3))


def _force_off(force, rate, inside, rng):
    force[inside, 0] += 1.0


def _force_off_for_ever(force, rate, inside, rng):
    """Known as wrong for the fault's duration only: after that the filter has to have found it."""
    force[np.flatnonzero(inside)[0]:] += rng.normal(0.0, 0.5, 3)


def _pitched(force, rate, inside, rng):
    c, s = np.cos(np.radians(10.0)), np.sin(np.radians(10.0))
    for values in (force, rate):
        values[inside] = values[inside] @ np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _creeping(force, rate, inside, rng):
    rate[inside, 2] += np.radians(np.linspace(0.0, 1.5, np.count_nonzero(inside)))


def _half_rate(imu, inside, rng):
    return imu.select(~inside | (np.arange(len(imu)) % 2 == 0))


def _half_lost(imu, inside, rng):
    return imu.select(~inside | (rng.random(len(imu)) < 0.5))


def _stamps_twice(imu, inside, rng):
    stamp = imu.stamp.copy()
    second = np.flatnonzero(inside)[1::2]
    stamp[second] = stamp[second - 1]
    return replace(imu, stamp=stamp)


def _clock(seconds):
    def change(imu, inside, rng):
        return replace(imu, stamp=imu.stamp + np.where(inside, round(seconds * 1e9), 0))
    return change


def _moved(metres):
    def change(fixes, inside, rng):
        return replace(fixes, latitude=fixes.latitude + np.where(inside, metres * METRE, 0.0))
    return change


def _drifting(rate):
    def change(fixes, inside, rng):
        since = (fixes.stamp - fixes.stamp[np.flatnonzero(inside)[0]]) * 1e-9
        return replace(fixes, latitude=fixes.latitude + np.where(inside, rate * since * METRE, 0.0))
    return change


def _shifted(fixes, north, east):
    """north, east: m, one each fix."""
    return replace(fixes, latitude=fixes.latitude + north * METRE,
                   longitude=fixes.longitude + east * METRE / np.cos(fixes.latitude))


def _led_away(fixes, inside, rng):
    """Away from the truth by 4 m/s to 40 m, in any direction, and on with that offset."""
    since = (fixes.stamp - fixes.stamp[np.flatnonzero(inside)[0]]) * 1e-9
    off, angle = inside * np.clip(4.0 * since, 0.0, 40.0), rng.uniform(0.0, 2.0 * np.pi)
    return _shifted(fixes, off * np.cos(angle), off * np.sin(angle))


def _wandering(fixes, inside, rng):
    """A first-order Gauss-Markov process of 20 s, 0 at its begin: multipath between houses."""
    at = np.flatnonzero(inside)
    keep = np.exp(-np.median(np.diff(fixes.stamp)) * 1e-9 / 20.0)
    steps = 8.0 * np.sqrt(1.0 - keep * keep) * rng.standard_normal((2, len(at)))
    off = np.zeros((2, len(fixes)))
    off[:, at] = lfilter([1.0], [1.0, -keep], steps)
    return _shifted(fixes, *off)


def _tunnel_then_moved(tunnel, metres):
    def change(fixes, inside, rng):
        since = (fixes.stamp - fixes.stamp[np.flatnonzero(inside)[0]]) * 1e-9
        moved = replace(fixes, latitude=fixes.latitude + np.where(inside, metres * METRE, 0.0))
        return moved.select(~(inside & (since < tunnel)))
    return change


def _null(fixes, inside, rng):
    return replace(fixes, **{name: np.where(inside, 0.0, getattr(fixes, name))
                             for name in ('latitude', 'longitude', 'height')})


def _frozen(fixes, inside, rng):
    first = np.flatnonzero(inside)[0]
    return replace(fixes, **{name: np.where(inside, getattr(fixes, name)[first], getattr(fixes, name))
                             for name in ('latitude', 'longitude', 'height')})


def _straight_on(fixes, inside, rng):
    """As a receiver without satellites that goes on at the speed it had over the last five seconds."""
    last = np.flatnonzero(inside)[0] - 1
    since = (fixes.stamp - fixes.stamp[last]) * 1e-9
    before = int(np.searchsorted(since, -5.0 - 0.1))
    gone = {}
    for name in ('latitude', 'longitude'):
        values = getattr(fixes, name)
        speed = (values[last] - values[before]) / (since[last] - since[before])
        gone[name] = np.where(inside, values[last] + speed * since, values)
    return replace(fixes, **gone)


def _outliers(fixes, inside, rng):
    hit = inside & (rng.random(len(fixes)) < 0.15)
    size, angle = rng.uniform(10.0, 60.0, len(fixes)), rng.uniform(0, 2 * np.pi, len(fixes))
    return _shifted(fixes, hit * size * np.cos(angle), hit * size * np.sin(angle))


def _scattered(sigma):
    def change(fixes, inside, rng):
        return _shifted(fixes, *(sigma * inside * rng.standard_normal((2, len(fixes)))))
    return change


def _claims(factor):
    def change(fixes, inside, rng):
        return replace(fixes, covariance=np.where(inside[:, None, None], factor, 1.0) * fixes.covariance)
    return change


def _height(value, more=0.0):
    def change(fixes, inside, rng):
        return replace(fixes, height=np.where(inside, more * fixes.height + value, fixes.height))
    return change


def _ahead(fixes, inside, rng):
    return replace(fixes, stamp=fixes.stamp + np.where(inside, 3 * 10**9, 0))


def _behind(fixes, inside, rng):
    return replace(fixes, stamp=fixes.stamp - np.where(inside, 2 * 10**9, 0))


def _speed_times(factor):
    return lambda speeds, inside: replace(speeds, speed=speeds.speed * np.where(inside, factor, 1.0))


def _slipping(speeds, inside):
    """Wheels that spin: 3 m/s faster than the road."""
    return replace(speeds, speed=speeds.speed + np.where(inside, 3.0, 0.0))


def _heading_off(degrees):
    return lambda headings, inside: replace(headings, yaw=headings.yaw + np.where(inside, np.radians(degrees), 0.0))


def _late(seconds):
    def change(fixes, inside, rng):
        return replace(fixes, received=fixes.received + np.where(inside, round(seconds * 1e9), 0))
    return change


def _bursts(fixes, inside, rng):
    received = fixes.received.copy()
    at = np.flatnonzero(inside)
    received[at] = fixes.received[np.minimum(at[0] + (at - at[0]) // 5 * 5 + 4, at[-1])]
    return replace(fixes, received=received)


FAULTS = (
    of_fixes('nothing', 1.0, lambda fixes, *_: fixes),
    of_imu('one accelerometer sample of 1e5 m/s^2', 0.01, _set('force', 1e5, 0)),
    of_imu('one accelerometer sample of 1e300 m/s^2', 0.01, _set('force', 1e300, 0)),
    of_imu('one gyroscope sample of 35 rad/s', 0.01, _set('rate', 35.0, 2)),
    of_imu('one gyroscope sample of 300 rad/s', 0.01, _set('rate', 300.0, 2)),
    of_imu('accelerometer at 39.2 m/s^2 for 1 s', 1.0, _set('force', 39.2266, 0)),
    of_imu('accelerometer at 157 m/s^2 for 1 s', 1.0, _set('force', 156.9, 0)),
    of_imu('IMU all zeros for 15 s', 15.0, _zeros),
    of_imu('IMU frozen for 5 s', 5.0, _freeze),
    of_imu('gyroscope z stuck for 10 s', 10.0, _stuck('rate', 2)),
    of_imu('accelerometer x stuck for 10 s', 10.0, _stuck('force', 0)),
    of_imu('IMU axes x and y swapped for 2 s', 2.0, _swapped),
    of_imu('IMU noise of 3 m/s^2 and 0.2 rad/s for 10 s', 10.0, _noisy),
    of_imu('gyroscope z 5 deg/s off for 10 s', 10.0, _biased),
    of_stamps('IMU at half its rate for 20 s', 20.0, _half_rate),
    of_stamps('half of the IMU samples lost for 20 s', 20.0, _half_lost),
    of_stamps('each IMU stamp twice for 5 s', 5.0, _stamps_twice),
    of_stamps('clock of the IMU 1 s ahead for 10 s', 10.0, _clock(1.0)),
    of_stamps('clock of the IMU 1 s behind for 10 s', 10.0, _clock(-1.0)),
    of_fixes('three fixes at 0, 0, 0', 3.0, _null),
    of_fixes('fixes 300 m off for 10 s', 10.0, _moved(300.0)),
    of_fixes('fixes 30 m off for 20 s', 20.0, _moved(30.0)),
    of_fixes('fixes drift away by 3 m/s for 20 s', 20.0, _drifting(3.0)),
    of_fixes('fixes go straight on for 15 s', 15.0, _straight_on),
    of_fixes('fixes frozen for 20 s', 20.0, _frozen),
    of_fixes('15 % of the fixes 10 to 60 m off', 90.0, _outliers),
    of_fixes('fixes scatter by 15 m for 60 s', 60.0, _scattered(15.0)),
    of_fixes('claimed sigma a tenth of the true one', 90.0, _claims(0.01)),
    of_fixes('claimed covariance a millionth for 20 s', 20.0, _claims(1e-6)),
    of_fixes('claimed covariance a million times for 20 s', 20.0, _claims(1e6)),
    of_fixes('an altitude of 1e300', 1.0, _height(1e300)),
    of_fixes('altitude 1000 m off for 10 s', 10.0, _height(1500.0)),
    of_fixes('altitude 300 m more for 20 s', 20.0, _height(300.0, 1.0)),
    of_fixes('fixes stamped 3 s ahead for 20 s', 20.0, _ahead),
    of_fixes('fixes stamped 2 s behind for 20 s', 20.0, _behind),
    of_fixes('fixes come 2 s late for 20 s', 20.0, _late(2.0)),
    of_fixes('fixes come in bursts of 5 for 20 s', 20.0, _bursts),
    of_fixes('fixes 6 m off for 20 s', 20.0, _moved(6.0)),
    of_fixes('fixes go straight on through a tunnel of 30 s', 30.0, _straight_on),
    of_fixes('tunnel of 30 s, then fixes 80 m off for 8 s', 38.0, _tunnel_then_moved(30.0, 80.0)),
    of_aiding('heading 90 deg wrong for 20 s', 20.0, 'heading', _heading_off(90.0)),
    of_aiding('wheel speed in km/h for 20 s', 20.0, 'speed', _speed_times(3.6)),
    of_aiding('wheels that slip by 3 m/s for 5 s', 5.0, 'speed', _slipping),
    of_imu('gyroscope z 5 deg/s off for 10 s while parked', 10.0, _biased, begin=_parked),
    of_imu('IMU that restarts with other biases', 3.0, _restarted),
    of_imu('accelerometer x 1 m/s^2 off for 20 s', 20.0, _force_off),
    of_imu('accelerometers off by 0.5 m/s^2 from now on', 30.0, _force_off_for_ever),
    of_imu('mount pitched by 10 deg for 20 s', 20.0, _pitched),
    of_imu('gyroscope z creeps to 1.5 deg/s in 20 s', 20.0, _creeping),
    of_fixes('fixes 40 m off, reached in 10 s, for 40 s', 40.0, _led_away),
    of_fixes('fixes wander by 8 m for 60 s', 60.0, _wandering),
)


@dataclass(frozen=True)
class Outcome:
    """Errors of one drive: time (m,) s after the fault's begin, error (m,) m, inside (m,) the 95 % ellipse, which
    reaches that far in the direction of the error: reach (m,) m."""

    time: np.ndarray
    error: np.ndarray
    inside: np.ndarray
    reach: np.ndarray
    said: list[str]


def outcome(recording: Recording, truth, values: dict, begin: float, filtered: Callable = run) -> Outcome:
    """What `filtered`, called as `replay.run`, makes of the recording, in which a fault begins at `begin` s."""
    recording, _ = as_one(recording, values)
    there = recording.streams()
    aiding = Aiding({one.name: there[one.name] for one in inputs(values) if values[one.topic]})
    result = filtered(FilterConfig.from_parameters(values), recording.imu, recording.gnss, aiding)
    errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
    time = (errors.stamp - recording.imu.stamp[0]) * 1e-9 - begin
    said = [n.text for n in result.notices if n.level != 'info']
    reach = errors.horizontal * np.sqrt(NEES_95 / np.maximum(errors.nees, 1e-12))
    return Outcome(time, errors.horizontal, errors.nees < NEES_95, reach, said)


@cache
def clean_drive(seed: int, rate: float = 1.0) -> Recording:
    return simulated(seed, MINUTES, GnssNoise(1.5, rate=rate))


def _where(fault: Fault, clean: Recording, seed: int) -> tuple:
    """Which samples and fixes are within the fault, and random numbers for it."""
    origin, begin = clean.imu.stamp[0], fault.begin(clean)

    def inside(samples):
        time = (samples.stamp - origin) * 1e-9
        return (time >= begin) & (time < begin + max(fault.duration, 0.0099))

    return inside(clean.imu), inside(clean.gnss), np.random.default_rng(seed)


def altered(fault: Fault, clean: Recording, seed: int) -> Recording:
    """The recording with the fault."""
    return fault.alter(clean, *_where(fault, clean, seed))


def judged(fault: Fault, seed: int, rate: float = 1.0, given: dict | None = None,
           drive: Callable = clean_drive) -> tuple[Outcome, Outcome, Outcome]:
    """With the fault, without it, and coasting through it. rate: of the fixes, Hz. given: parameters. drive: the
    recording without the fault, called with seed and rate."""
    clean = drive(seed, rate)
    values = table.check({'reference_lever_arm': [0.0, 0.0, 0.0], **fault.values, **(given or {})})
    truth, where, begin = truth_of(clean, values), _where(fault, clean, seed), fault.begin(clean)
    recordings = fault.alter(clean, *where), clean, fault.coast(clean, *where)
    return tuple(outcome(r, truth, values, begin) for r in recordings)


def row(fault: Fault, found: list[tuple[Outcome, Outcome, Outcome]]) -> str:
    """A line of the table from what was `judged` for each seed."""
    def largest(outcomes):
        return max(o.error[(o.time >= 0) & (o.time <= fault.duration + 1.0)].max(initial=0.0) for o in outcomes)

    faulty, _, dark = zip(*found)
    later = [rms(np.concatenate([o.error[np.abs(o.time - fault.duration - 20.0) < 2.5] for o in outcomes]))
             for outcomes in zip(*found)]
    held = np.concatenate([o.inside[(o.time >= 0) & (o.time <= fault.duration + 60.0)] for o in faulty])
    finite = all(np.isfinite(o.error).all() for o in faulty)
    silent = 1.0 - len(held) / sum(np.count_nonzero((o.time >= 0) & (o.time <= fault.duration + 60.0))
                                   for _, o, _ in found)
    said = found[0][0].said
    text = said[0].split(': ', 1)[-1] if said else ''
    if silent > 0.0:
        text = f'(nothing published for {silent * (fault.duration + 60.0):.0f} s) {text}'
    cells = [largest(faulty), largest(dark), *later]
    numbers = ' | '.join(f'{c:.2f}' if c < 100 else f'{c:.0f}' for c in cells)
    return (f'| {fault.name} | {numbers} | {100 * held.mean():.0f} %{"" if finite else " NOT FINITE"} | '
            f'{text[:90]} |')


def draw(figure: Path, drawn: list[tuple[Fault, tuple[Outcome, Outcome, Outcome]]]) -> None:
    """The error over time with each fault, coasting through it, and how far the 95 % ellipse reached."""
    from matplotlib import pyplot as plt

    columns = 4
    rows = -(-len(drawn) // columns)
    picture, axes = plt.subplots(rows, columns, figsize=(13, 1.9 * rows), layout='constrained', squeeze=False)
    for ax in axes.ravel()[len(drawn):]:
        ax.remove()
    for ax, (fault, (faulty, _, dark)) in zip(axes.ravel(), drawn):
        shown, while_dark = ((o.time > -10.0) & (o.time < fault.duration + 40.0) for o in (faulty, dark))
        ax.axvspan(0.0, max(fault.duration, 0.3), color='0.88', lw=0)
        if fault.duration <= 20.0:
            ax.plot(dark.time[while_dark], dark.error[while_dark], color='0.55', lw=0.9, label='coasting through it')
        ax.plot(faulty.time[shown], faulty.reach[shown], color='tab:orange', lw=0.9, label='95 % ellipse')
        ax.plot(faulty.time[shown], faulty.error[shown], color='tab:blue', lw=1.1, label='error')
        ax.set_title(fault.name, fontsize=8)
        ax.set_ylim(0.0, max(6.0, 1.1 * faulty.error[shown].max()))
        ax.tick_params(labelsize=7)
    for ax in axes[:, 0]:
        ax.set_ylabel('m', fontsize=8)
    axes[0, -1].legend(fontsize=7, frameon=False)
    picture.supxlabel('seconds after the begin of the fault (grey)', fontsize=8)
    plt.rcParams['svg.hashsalt'] = 'faults'
    picture.savefig(figure, metadata={'Date': None} if figure.suffix == '.svg' else None, dpi=80)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=6)
    parser.add_argument('--first-seed', type=int, default=2000)
    parser.add_argument('--rate', type=float, default=1.0, help='of the fixes, Hz')
    parser.add_argument('--only', default='', help='faults with one of these in their name, separated by commas')
    parser.add_argument('--set', nargs='+', default=[], metavar='NAME=VALUE', help='parameters')
    parser.add_argument('--output', type=Path)
    parser.add_argument('--figure', type=Path)
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    given = {name: yaml.safe_load(value) for name, _, value in (text.partition('=') for text in options.set)}
    lines = ['| fault | largest, m | coasting, m | 20 s after, m | without fault | after coasting | in 95 % | said |',
             '|---|---|---|---|---|---|---|---|']
    print(*lines, sep='\n')
    drawn = []
    for fault in FAULTS:
        if not any(part in fault.name for part in options.only.split(',')):
            continue
        found = [judged(fault, seed, options.rate, given) for seed in seeds]
        lines.append(row(fault, found))
        drawn.append((fault, found[0]))
        print(lines[-1], flush=True)
    if options.figure:
        draw(options.figure, drawn)
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
