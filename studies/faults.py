"""What the filter makes of faults: simulated realistic drives with one fault each, parameters at their defaults.

    python studies/faults.py [--seeds 6] [--output FILE.md] [--figure FILE.png]

Each fault begins at 200 s of a drive of 360 s (100 Hz, fixes of 1.5 m each second, simulation/scene.py REALISTIC). The
table holds the largest error from its begin to its end, the error 20 s after its end (RMS of 5 s, over all seeds)
beside that of the same filter without the fault and of one that had no fixes while the fault lasted, how often the 95 %
ellipse held the truth from the begin to 60 s after the end, and what was said. The figure shows the error of the first
seed over time, for each fault, and how large the 95 % ellipse was in its direction.
"""
from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from vehicle import FIXES, simulated

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95, position_errors, rms
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording

BEGIN, MINUTES = 200.0, 6.0
METRE = 1.0 / 6.37e6  # rad of latitude


@dataclass(frozen=True)
class Fault:
    """One fault. alter(recording, inside_imu (n,), inside_fixes (m,), rng) gives the recording with it."""

    name: str
    duration: float
    alter: Callable
    values: dict | None = None


def _imu(change):
    """A fault of the IMU: change(specific force, angular rate, inside, rng) on copies of both."""
    def alter(recording, inside, _, rng):
        force, rate = recording.imu.specific_force.copy(), recording.imu.angular_rate.copy()
        change(force, rate, inside, rng)
        return replace(recording, imu=replace(recording.imu, specific_force=force, angular_rate=rate))
    return alter


def _set(array, value, axis=slice(None)):
    def change(force, rate, inside, rng):
        target = force if array == 'force' else rate
        target[np.flatnonzero(inside), axis] = value
    return _imu(change)


def _zeros(force, rate, inside, rng):
    force[inside] = rate[inside] = 0.0


def _freeze(force, rate, inside, rng):
    first = np.flatnonzero(inside)[0]
    force[inside], rate[inside] = force[first], rate[first]


def _fixes(change):
    """A fault of the receiver: change(fixes, inside, rng) gives the fixes with it."""
    def alter(recording, _, inside, rng):
        return replace(recording, gnss=change(recording.gnss, inside, rng))
    return alter


def _moved(metres):
    def change(fixes, inside, rng):
        return replace(fixes, latitude=fixes.latitude + np.where(inside, metres * METRE, 0.0))
    return change


def _null(fixes, inside, rng):
    return replace(fixes, **{name: np.where(inside, 0.0, getattr(fixes, name))
                             for name in ('latitude', 'longitude', 'height')})


def _frozen(fixes, inside, rng):
    first = np.flatnonzero(inside)[0]
    return replace(fixes, **{name: np.where(inside, getattr(fixes, name)[first], getattr(fixes, name))
                             for name in ('latitude', 'longitude', 'height')})


def _outliers(fixes, inside, rng):
    hit = inside & (rng.random(len(fixes)) < 0.15)
    size, angle = rng.uniform(10.0, 60.0, len(fixes)), rng.uniform(0, 2 * np.pi, len(fixes))
    return replace(fixes, latitude=fixes.latitude + hit * size * np.cos(angle) * METRE,
                   longitude=fixes.longitude + hit * size * np.sin(angle) * METRE / np.cos(fixes.latitude))


def _claims(factor):
    def change(fixes, inside, rng):
        return replace(fixes, covariance=np.where(inside[:, None, None], factor, 1.0) * fixes.covariance)
    return change


def _height(value):
    def change(fixes, inside, rng):
        return replace(fixes, height=np.where(inside, value, fixes.height))
    return change


def _ahead(fixes, inside, rng):
    return replace(fixes, stamp=fixes.stamp + np.where(inside, 3 * 10**9, 0))


FAULTS = (
    Fault('nothing', 1.0, lambda recording, *_: recording),
    Fault('one accelerometer sample of 1e5 m/s^2', 0.01, _set('force', 1e5, 0)),
    Fault('one accelerometer sample of 1e300 m/s^2', 0.01, _set('force', 1e300, 0)),
    Fault('one gyroscope sample of 35 rad/s', 0.01, _set('rate', 35.0, 2)),
    Fault('one gyroscope sample of 300 rad/s', 0.01, _set('rate', 300.0, 2)),
    Fault('accelerometer at 39.2 m/s^2 for 1 s', 1.0, _set('force', 39.2266, 0)),
    Fault('accelerometer at 157 m/s^2 for 1 s', 1.0, _set('force', 156.9, 0)),
    Fault('IMU all zeros for 15 s', 15.0, _imu(_zeros)),
    Fault('IMU frozen for 5 s', 5.0, _imu(_freeze)),
    Fault('three fixes at 0, 0, 0', 3.0, _fixes(_null)),
    Fault('fixes 300 m off for 10 s', 10.0, _fixes(_moved(300.0))),
    Fault('fixes 30 m off for 20 s', 20.0, _fixes(_moved(30.0))),
    Fault('fixes frozen for 20 s', 20.0, _fixes(_frozen)),
    Fault('15 % of the fixes 10 to 60 m off', 90.0, _fixes(_outliers)),
    Fault('claimed sigma a tenth of the true one', 90.0, _fixes(_claims(0.01))),
    Fault('an altitude of 1e300', 1.0, _fixes(_height(1e300))),
    Fault('altitude 1000 m off for 10 s', 10.0, _fixes(_height(1500.0))),
    Fault('fixes stamped 3 s ahead for 20 s', 20.0, _fixes(_ahead)),
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


def outcome(recording: Recording, truth, values: dict) -> Outcome:
    result = run(FilterConfig.from_parameters(values), recording.imu, recording.gnss)
    errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
    time = (errors.stamp - recording.imu.stamp[0]) * 1e-9 - BEGIN
    said = [n.text for n in result.notices if n.level != 'info']
    reach = errors.horizontal * np.sqrt(NEES_95 / np.maximum(errors.nees, 1e-12))
    return Outcome(time, errors.horizontal, errors.nees < NEES_95, reach, said)


@cache
def clean_drive(seed: int) -> Recording:
    return simulated(seed, MINUTES, FIXES['1.5 m'])


def judged(fault: Fault, seed: int) -> tuple[Outcome, Outcome, Outcome]:
    """With the fault, without it, and without fixes while it lasts."""
    clean = clean_drive(seed)
    values = table.check({**(fault.values or {}), 'reference_lever_arm': [0.0, 0.0, 0.0]})
    truth = truth_of(clean, values)
    origin = clean.imu.stamp[0]

    def inside(samples):
        time = (samples.stamp - origin) * 1e-9
        return (time >= BEGIN) & (time < BEGIN + max(fault.duration, 0.0099))

    faulty = fault.alter(clean, inside(clean.imu), inside(clean.gnss), np.random.default_rng(seed))
    dark = replace(clean, gnss=clean.gnss.select(~inside(clean.gnss)))
    return tuple(outcome(r, truth, values) for r in (faulty, clean, dark))


def row(fault: Fault, found: list[tuple[Outcome, Outcome, Outcome]]) -> str:
    """A line of the table from what was `judged` for each seed."""
    during = [o.error[(o.time >= 0) & (o.time <= fault.duration + 1.0)] for o, *_ in found]
    dark = [o.error[(o.time >= 0) & (o.time <= fault.duration + 1.0)] for *_, o in found]
    later = [rms(np.concatenate([o.error[np.abs(o.time - fault.duration - 20.0) < 2.5] for o in outcomes]))
             for outcomes in zip(*found)]
    held = np.concatenate([o.inside[(o.time >= 0) & (o.time <= fault.duration + 60.0)] for o, *_ in found])
    finite = all(np.isfinite(o.error).all() for o, *_ in found)
    said = found[0][0].said
    text = said[0].split(': ', 1)[-1] if said else ''
    cells = [max(d.max() for d in during), max(d.max() for d in dark), *later]
    numbers = ' | '.join(f'{c:.2f}' if c < 100 else f'{c:.0f}' for c in cells)
    return (f'| {fault.name} | {numbers} | {100 * held.mean():.0f} %{"" if finite else " NOT FINITE"} | '
            f'{text[:90]} |')


def draw(figure: Path, drawn: list[tuple[Fault, tuple[Outcome, Outcome, Outcome]]]) -> None:
    """The error over time with each fault, without fixes meanwhile, and how far the 95 % ellipse reached."""
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
    parser.add_argument('--output', type=Path)
    parser.add_argument('--figure', type=Path)
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    lines = ['| fault | largest, m | coasting, m | 20 s after, m | without fault | after coasting | in 95 % | said |',
             '|---|---|---|---|---|---|---|---|']
    print(*lines, sep='\n')
    drawn = []
    for fault in FAULTS:
        found = [judged(fault, seed) for seed in seeds]
        lines.append(row(fault, found))
        drawn.append((fault, found[0]))
        print(lines[-1], flush=True)
    if options.figure:
        draw(options.figure, drawn)
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
