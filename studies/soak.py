"""A day of driving with faults drawn at random, through the live filter, event by event: does it last?

    nice -n 15 python studies/soak.py [--hours 24] [--seed 9000] [--output FILE.md]

Realistic simulated drives of half an hour (100 Hz, fixes of 1.5 m each second, parameters at their defaults) are joined
where the vehicle stands: the next one is turned and moved to where the last one ended, and there the ignition is
switched off and on: the filter begins anew with the snapshot that it left, as after a restart of the node. Every 2 to 8
minutes comes a fault of studies/faults.py, or one of those below, for as long as it lasts there. The table says for each
hour what the error was (m) away from faults (from 60 s after the end of each) and at all, how often the 95 % ellipse
held the truth, how often the filter began anew, and the memory of the process.
"""
from __future__ import annotations

import argparse
import itertools
import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from faults import FAULTS, Fault
from vehicle import FIXES, drive_of, simulated

from mems_ins_fusion.evaluation.metrics import NEES_95, rms
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.live import FusionFilter
from mems_ins_fusion.navigation.earth import from_local, to_local
from mems_ins_fusion.navigation.frames import ned_covariance_from_enu, wrap
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording

MINUTES, SECOND = 30.0, 10**9
#: an error is one of a fault until so long after it, s
AFTERMATH = 60.0
#: further away than this, away from faults, the filter is lost, m
LOST = 50.0


def _without(what):
    def alter(recording, inside_imu, inside_fixes, _):
        if what == 'imu':
            return replace(recording, imu=recording.imu.select(~inside_imu))
        return replace(recording, gnss=recording.gnss.select(~inside_fixes))
    return alter


def _not_numbers(recording, inside, *_):
    force = recording.imu.specific_force.copy()
    force[inside] = np.nan
    return replace(recording, imu=replace(recording.imu, specific_force=force))


def _twice(recording, inside, *_):
    stamp = recording.imu.stamp.copy()
    at = np.flatnonzero(inside)
    stamp[at] = stamp[at[0]]
    return replace(recording, imu=replace(recording.imu, stamp=stamp))


MORE = (
    Fault('no IMU samples for 0.3 s', 0.3, _without('imu')), Fault('no IMU samples for 3 s', 3.0, _without('imu')),
    Fault('no IMU samples for 30 s', 30.0, _without('imu')), Fault('no fixes for 20 s', 20.0, _without('gnss')),
    Fault('no fixes for 60 s', 60.0, _without('gnss')),
    Fault('samples that are not numbers for 0.2 s', 0.2, _not_numbers), Fault('the same stamp for 0.1 s', 0.1, _twice),
)
DRAWN = tuple(fault for fault in FAULTS if fault.name != 'nothing') + MORE


@dataclass
class Pose:
    """Where, at which height and which way the vehicle stood when a block ended, and when, ns."""

    stamp: int
    latitude: float
    longitude: float
    height: float
    yaw: float


def block(seed: int, number: int, before: Pose | None) -> tuple[Recording, Pose]:
    """Half an hour that begins where and when the last one ended, and ends at rest.

    The IMU, its mounting and the noise are those of `seed`, the way is another one for each `number`.
    """
    recording = simulated(seed, MINUTES, FIXES['1.5 m'], drive_of(seed + number, MINUTES))
    truth = recording.reference
    at_rest = np.flatnonzero(np.hypot(*truth.velocity[:, :2].T) < 0.01)
    end = truth.stamp[at_rest[-1]]
    recording = replace(recording, **{name: part.select(part.stamp <= end) for name, part in (
        ('imu', recording.imu), ('gnss', recording.gnss), ('reference', truth))})
    if before is not None:
        recording = moved(recording, before)
    last = recording.reference.select(slice(-1, None))
    return recording, Pose(int(recording.imu.stamp[-1]), float(last.latitude[0]), float(last.longitude[0]),
                           float(last.height[0]), float(last.yaw[0]))


def moved(recording: Recording, to: Pose) -> Recording:
    """`recording` turned and moved so that it begins at `to`."""
    truth = recording.reference
    origin = truth.latitude[0], truth.longitude[0], truth.height[0]
    turn, shift = to.yaw - truth.yaw[0], to.stamp + 10_000_000 - int(recording.imu.stamp[0])
    c, s = np.cos(turn), np.sin(turn)

    def placed(samples):
        north, east, down = to_local(samples.latitude, samples.longitude, samples.height, origin)
        latitude, longitude, height = from_local(c * north - s * east, s * north + c * east, down,
                                                 (to.latitude, to.longitude, to.height))
        return {'stamp': samples.stamp + shift, 'latitude': latitude, 'longitude': longitude, 'height': height}
    imu = replace(recording.imu, stamp=recording.imu.stamp + shift, received=recording.imu.received + shift)
    gnss = replace(recording.gnss, received=recording.gnss.received + shift, **placed(recording.gnss))
    return replace(recording, imu=imu, gnss=gnss,
                   reference=replace(truth, yaw=wrap(truth.yaw + turn), velocity=None, **placed(truth)))


def with_faults(recording: Recording, rng) -> tuple[Recording, list[tuple[float, float, str]]]:
    """Faults drawn at random: the recording with them, and begin, end (ns) and name of each."""
    found, time, end = [], int(recording.imu.stamp[0]) + 60 * SECOND, int(recording.imu.stamp[-1])
    while (time := time + round(rng.uniform(120.0, 480.0) * SECOND)) < end - 120 * SECOND:
        fault = DRAWN[rng.integers(len(DRAWN))]
        until = time + round(max(fault.duration, 0.0099) * SECOND)
        imu, gnss = ((part.stamp >= time) & (part.stamp < until) for part in (recording.imu, recording.gnss))
        if imu.any() and (gnss.any() or fault.duration < 1.0):
            recording = fault.alter(recording, imu, gnss, rng)
            found.append((time, until, fault.name))
        time = until
    return recording, found


@dataclass
class Hour:
    """What was seen in an hour: stamps, errors, whether the ellipse held, and how often the filter began anew."""

    stamp: list[int] = field(default_factory=list)
    error: list[float] = field(default_factory=list)
    inside: list[bool] = field(default_factory=list)
    faults: list[tuple] = field(default_factory=list)
    anew: int = 0
    silent: int = 0  # epochs of the truth without an estimate


def drive(fusion: FusionFilter, recording: Recording, hour: Hour) -> None:
    """Begin anew, feed `recording`, and compare the estimate with the truth where there is an epoch of it."""
    snapshot = fusion.snapshot()
    fusion.reset()
    imu, gnss, truth = recording.imu, recording.gnss, recording.reference
    samples = np.column_stack([imu.specific_force, imu.angular_rate]).tolist()
    arrival = np.searchsorted(imu.received, gnss.received, side='right').tolist()
    fixes = list(zip(gnss.stamp.tolist(), gnss.latitude.tolist(), gnss.longitude.tolist(), gnss.height.tolist(),
                     gnss.covariance.reshape(-1, 9), gnss.status.tolist(), gnss.covariance_type.tolist()))
    at, next_fix = {int(stamp): k for k, stamp in enumerate(truth.stamp)}, 0
    for k, (stamp, values) in enumerate(zip(imu.stamp.tolist(), samples)):
        while next_fix < len(fixes) and arrival[next_fix] <= k:
            fusion.add_fix(*fixes[next_fix])
            next_fix += 1
        fresh = fusion.add_imu(stamp, *values)
        if k == 0 and snapshot is not None:
            fusion.restore(snapshot, 20.0)
        if stamp not in at:
            continue
        if not (fresh and fusion.aligned):
            hour.silent += 1
            continue
        fusion.update_odometry()
        judge(fusion, truth, at[stamp], hour)
        hour.anew += sum('start anew' in n.text or 'aligns anew' in n.text or 'last good one' in n.text
                         for n in fusion.notices())
        fusion.verdicts()


def judge(fusion: FusionFilter, truth, i: int, hour: Hour) -> None:
    place = truth.latitude[i], truth.longitude[i], truth.height[i]
    error = np.array(to_local(*fusion.geodetic, place)[:2])
    p = ned_covariance_from_enu(fusion.position_covariance_enu.reshape(3, 3))[:2, :2]
    hour.stamp.append(int(truth.stamp[i]))
    hour.error.append(float(np.hypot(*error)))
    hour.inside.append(bool(error @ np.linalg.solve(p, error) < NEES_95))


def megabytes() -> float:
    """Resident memory of this process."""
    return int(Path('/proc/self/statm').read_text().split()[1]) * os.sysconf('SC_PAGE_SIZE') / 1e6


def row(number: int, hour: Hour) -> tuple[str, int]:
    """A line of the table, and how many epochs away from faults the filter was lost."""
    stamp, error, inside = np.array(hour.stamp), np.array(hour.error), np.array(hour.inside)
    near = np.zeros(len(stamp), dtype=bool)
    for begin, end, _ in hour.faults:
        near |= (stamp >= begin) & (stamp < end + AFTERMATH * SECOND)
    away = error[~near]
    assert np.isfinite(error).all()
    return (f'| {number} | {len(hour.faults)} | {rms(away):.2f} | {away.max():.1f} | {error.max():.1f} | '
            f'{100 * inside[~near].mean():.1f} % | {100 * inside[near].mean():.1f} % | {hour.silent / 10:.0f} | '
            f'{hour.anew} | {megabytes():.0f} |'), int(np.count_nonzero(away > LOST))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--hours', type=int, default=24)
    parser.add_argument('--seed', type=int, default=9000)
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    fusion = FusionFilter(FilterConfig.from_parameters(table.defaults()))
    lines = ['| hour | faults | RMSE away from faults, m | largest | largest at all, m | in 95 % | during faults and '
             '60 s after | without an estimate, s | began anew | memory, MB |', '|' + '---|' * 10]
    print(*lines, sep='\n', flush=True)
    pose, lost, hour, number, begin = None, 0, Hour(), 1, None
    for blocks in itertools.count():
        recording, pose = block(options.seed, blocks, pose)
        begin = begin or int(recording.imu.stamp[0])
        recording, faults = with_faults(recording, rng)
        hour.faults += faults
        drive(fusion, recording, hour)
        if pose.stamp - begin >= number * 3600 * SECOND:
            line, away = row(number, hour)
            lines.append(line)
            lost += away
            print(line, flush=True)
            hour, number = Hour(), number + 1
            if number > options.hours:
                break
    said = f'Away from faults it was more than {LOST:.0f} m off for {lost / 10:.1f} s.'
    print(said)
    if options.output:
        options.output.write_text('\n'.join([*lines, '', said]) + '\n')


if __name__ == '__main__':
    main()
