"""A day of driving with faults drawn at random, through the live filter, event by event: does it last?

    nice -n 12 python studies/soak.py [--hours 24] [--seed 9000] [--output FILE.md]

One realistic simulated drive of that many hours (100 Hz, fixes of 1.5 m each second, parameters at their defaults), one
filter from its begin to its end. Every 2 to 8 minutes comes a fault of studies/faults.py, or one of those below, for as
long as it lasts there; one of them is a restart of the node while it drives, with the snapshot that the filter left.
The table says for each hour what the error was (m) away from faults (from 60 s after the end of each) and at all,
how often the 95 % ellipse held the truth, how often the filter began anew, and how much the memory of the process has
grown since the first hour began.
"""
from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from faults import FAULTS, Fault, of_fixes, of_imu, of_stamps
from vehicle import FIXES, simulated

from mems_ins_fusion.evaluation.metrics import NEES_95, rms
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.navigation.frames import ned_covariance_from_enu
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording

SECOND = 10**9  # ns
#: an error is one of a fault until so long after it, s
AFTERMATH = 60.0
#: further away than this, away from faults, the filter is lost, m
LOST = 50.0


def _not_numbers(force, rate, inside, rng):
    force[inside] = np.nan


def _gone(samples, inside, rng):
    return samples.select(~inside)


RESTART = of_fixes('the node restarts', 1.0, lambda fixes, *_: fixes)
MORE = (
    of_stamps('no IMU samples for 0.3 s', 0.3, _gone), of_stamps('no IMU samples for 3 s', 3.0, _gone),
    of_stamps('no IMU samples for 30 s', 30.0, _gone), of_fixes('no fixes for 20 s', 20.0, _gone),
    of_fixes('no fixes for 60 s', 60.0, _gone), of_imu('samples that are not numbers for 0.2 s', 0.2, _not_numbers),
    RESTART,
)
DRAWN = tuple(fault for fault in FAULTS if fault.name != 'nothing') + MORE


def stretches(recording: Recording, rng) -> Iterator[tuple[Recording, int, int, Fault]]:
    """The recording in parts with one fault each, drawn at random: the part, the fault's begin and end (ns), and it."""
    imu, gnss, truth = recording.imu, recording.gnss, recording.reference
    begin, time = int(imu.stamp[0]), int(imu.stamp[0]) + 60 * SECOND
    while True:
        time += round(rng.uniform(120.0, 480.0) * SECOND)
        fault = DRAWN[rng.integers(len(DRAWN))]
        until = time + round(max(fault.duration, 0.0099) * SECOND)
        end = until + round(AFTERMATH * SECOND)
        part = replace(recording, **{name: samples.select((samples.stamp >= begin) & (samples.stamp < end)) for
                                     name, samples in (('imu', imu), ('gnss', gnss), ('reference', truth))})
        if imu.stamp[-1] < end:
            return
        inside = [(samples.stamp >= time) & (samples.stamp < until) for samples in (part.imu, part.gnss)]
        yield fault.alter(part, *inside, rng), time, until, fault
        begin, time = end, until


@dataclass
class Hour:
    """What was seen in an hour: stamps, errors, whether the ellipse held, which were near a fault, and how often the
    filter began anew."""

    error: list[float] = field(default_factory=list)
    inside: list[bool] = field(default_factory=list)
    near: list[bool] = field(default_factory=list)
    faults: int = 0
    anew: int = 0
    silent: int = 0  # epochs of the truth without an estimate


def drive(fusion: FusionFilter, recording: Recording, restart: int | None, begin: int, hour: Hour) -> None:
    """Feed `recording`, and compare the estimate with the truth where there is an epoch of it.

    restart: ns, at which the filter begins anew with the snapshot it left. begin: ns, of the fault.
    """
    imu, gnss, truth = recording.imu, recording.gnss, recording.reference
    samples = np.column_stack([imu.specific_force, imu.angular_rate]).tolist()
    order = np.argsort(gnss.received, kind='stable')
    arrival = np.searchsorted(imu.received, gnss.received[order], side='right').tolist()
    gnss = gnss.select(order)
    fixes = list(zip(gnss.stamp.tolist(), gnss.latitude.tolist(), gnss.longitude.tolist(), gnss.height.tolist(),
                     gnss.covariance.reshape(-1, 9), gnss.status.tolist(), gnss.covariance_type.tolist()))
    at, next_fix = {int(stamp): k for k, stamp in enumerate(truth.stamp)}, 0
    for k, (stamp, values) in enumerate(zip(imu.stamp.tolist(), samples)):
        while next_fix < len(fixes) and arrival[next_fix] <= k:
            fusion.add_fix(*fixes[next_fix])
            next_fix += 1
        if restart is not None and stamp >= restart:
            snapshot, restart = fusion.snapshot(), None
            fusion.reset()
            fresh = fusion.add_imu(stamp, *values)
            if snapshot is not None:
                fusion.restore(snapshot, 20.0)
        else:
            fresh = fusion.add_imu(stamp, *values)
        if stamp not in at:
            continue
        if not (fresh and fusion.aligned):
            hour.silent += 1
            continue
        fusion.update_odometry()
        judge(fusion, truth, at[stamp], hour)
        hour.near.append(stamp >= begin)
        hour.anew += sum('start anew' in n.text or 'aligns anew' in n.text or 'last good one' in n.text
                         for n in fusion.notices())
        fusion.verdicts()


def judge(fusion: FusionFilter, truth, i: int, hour: Hour) -> None:
    place = truth.latitude[i], truth.longitude[i], truth.height[i]
    error = np.array(to_local(*fusion.geodetic, place)[:2])
    p = ned_covariance_from_enu(fusion.position_covariance_enu.reshape(3, 3))[:2, :2]
    hour.error.append(float(np.hypot(*error)))
    hour.inside.append(bool(error @ np.linalg.solve(p, error) < NEES_95))


def megabytes() -> float:
    """Resident memory of this process."""
    return int(Path('/proc/self/statm').read_text().split()[1]) * os.sysconf('SC_PAGE_SIZE') / 1e6


def row(number: int, hour: Hour, memory: float) -> tuple[str, int]:
    """A line of the table, and how many epochs away from faults the filter was lost."""
    error, inside, near = np.array(hour.error), np.array(hour.inside), np.array(hour.near)
    away = error[~near]
    assert np.isfinite(error).all()
    return (f'| {number} | {hour.faults} | {rms(away):.2f} | {away.max():.1f} | {error.max():.1f} | '
            f'{100 * inside[~near].mean():.1f} % | {100 * inside[near].mean():.1f} % | {hour.silent / 10:.0f} | '
            f'{hour.anew} | {megabytes() - memory:+.0f} |'), int(np.count_nonzero(away > LOST))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--hours', type=float, default=24.0)
    parser.add_argument('--seed', type=int, default=9000)
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    fusion = FusionFilter(FilterConfig.from_parameters(table.defaults()))
    lines = ['| hour | faults | RMSE away from faults, m | largest | largest at all, m | in 95 % | during faults and '
             '60 s after | without an estimate, s | began anew | memory grown, MB |', '|' + '---|' * 10]
    print(*lines, sep='\n', flush=True)
    recording = simulated(options.seed, 60.0 * options.hours, FIXES['1.5 m'])
    first, lost, hour, number, memory = int(recording.imu.stamp[0]), 0, Hour(), 1, 0.0
    for part, begin, until, fault in stretches(recording, rng):
        drive(fusion, part, begin if fault is RESTART else None, begin, hour)
        hour.faults += 1
        memory = memory or megabytes()
        if part.imu.stamp[-1] - first < min(number, options.hours - 0.2) * 3600 * SECOND:  # no fault at the end
            continue
        line, away = row(number, hour, memory)
        lines.append(line)
        lost += away
        print(line, flush=True)
        hour, number = Hour(), number + 1
    said = f'Away from faults it was more than {LOST:.0f} m off for {lost / 10:.1f} s.'
    print(said)
    if options.output:
        options.output.write_text('\n'.join([*lines, '', said]) + '\n')


if __name__ == '__main__':
    main()
