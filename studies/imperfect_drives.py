"""Drives with several imperfections at once, as every real one has them, none of which the filter is told.

    python studies/imperfect_drives.py [--first-seed 5001] [--count 20] [--vehicle KIND] [--set NAME=VALUE ...]
                                       [--output FILE.md]

A seed chooses the vehicle (car, motorway, motorcycle, truck, robot of 0.4 m/s; with --vehicle also a tractor or a bus
with the IMU on the roof), its road, body and vibration, the rate and grade of the IMU, its mounting within 4 degrees,
scale factor errors of 1 %, and a receiver: rate, scatter, errors that last, smoothing, outliers, drop-outs, stamps that
are late, a lever arm of up to 1.5 m, a claimed sigma that is right, too small, too large or missing. Parameters are at
their defaults.

With fixes the filter is held against the fixes themselves, without them for 10, 30 and 60 s against going straight on
(never_worse.py). `at rest`: seconds for which the filter stands while the vehicle moves. The last line has geometric
means of errors, and means of seconds and shares.
"""
from __future__ import annotations

import argparse
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from never_worse import _at, _local, _motorway, _rms, without_fixes

from mems_ins_fusion import parameters
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import Aiding, run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.manoeuvres import CITY, MIXED, SLOW, Segment
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording
from mems_ins_fusion.simulation.vibration import Vibration

VEHICLES = {'car': MIXED, 'motorway': (_motorway,), 'motorcycle': MIXED, 'truck': MIXED, 'robot': SLOW, 'city': CITY}


def _rows(speed, rng):
    """Up and down a field at 3 m/s."""
    return [Segment(max(abs(speed - 3.0), 0.5), 3.0 - speed), Segment(60.0), Segment(3.0, -1.5),
            Segment(8.0, 0.0, rng.choice([-1, 1]) * np.pi), Segment(3.0, 1.5)]


#: with --vehicle only: the IMU is on the roof
ON_THE_ROOF = {'tractor': (_rows,), 'bus': CITY}
#: m, from the middle of the rear axle forward to the IMU
AXLE = {'truck': 5.0, 'robot': 0.2, 'tractor': 0.5, 'bus': 7.0}
#: m, height of that roof above the axle
ROOF = 2.5
#: rad, by which a field rolls and pitches a vehicle at 10 m/s, RMS: a third of it at 3 m/s
FIELD = np.radians(6.0)
#: s
DURATION, SETTLED, OUTAGES, SPACING = 420.0, 30.0, (10.0, 30.0, 60.0), 45.0
#: 95 % quantile of chi-square with two degrees of freedom
ELLIPSE = 5.99


def imperfect(seed: int, vehicle: str | None = None) -> tuple[Recording, str]:
    """The recording of a seed, and what was chosen."""
    rng = np.random.default_rng(seed)
    kind = vehicle or str(rng.choice(list(VEHICLES)))
    rate = float(rng.choice([50.0, 100.0, 200.0]))
    # a motorcycle leans into the bend as far as it takes to stay upright, the others roll outwards
    lean = -0.1 if kind == 'motorcycle' else np.radians(rng.uniform(0.1, 0.8))
    drive = simulate_drive(
        DURATION, seed, rate, standstill=rng.uniform(10.0, 60.0), grade=rng.uniform(0.0, 0.06), bank=0.02,
        parked_on_slope=True, manoeuvres={**VEHICLES, **ON_THE_ROOF}[kind], rotating_earth=True, suspension=1.2,
        pitch_per_acceleration=np.radians(rng.uniform(0.1, 0.6)), roll_per_acceleration=lean,
        sideslip_per_acceleration=rng.uniform(0.0, 0.006), unevenness=np.radians(rng.uniform(0.0, 0.4)),
        axle_to_imu=(AXLE.get(kind, rng.uniform(-0.5, 2.0)), rng.uniform(-0.4, 0.4), -rng.uniform(0.0, 1.0)))
    if kind in ON_THE_ROOF:
        uneven = FIELD if kind == 'tractor' else drive.path.unevenness
        drive = drive.altered(unevenness=uneven, axle_to_imu=(*drive.path.axle_to_imu[:2], -ROOF))
    grade = 10.0 ** rng.uniform(-0.5, 0.8)
    imu = {name: [grade * value for value in values] if not name.endswith('tau') else values
           for name, values in REALISTIC.imu.items()}
    sensors = replace(SensorErrors.from_parameters(parameters.table.check(imu), 'gauss_markov'),
                      accelerometer_scale=rng.normal(0.0, 0.01, 3), gyroscope_scale=rng.normal(0.0, 0.01, 3))
    sigma = float(rng.choice([0.02, 0.1, 0.5, 1.5, 1.5, 2.5, 4.0]))
    receiver = GnssNoise(sigma, rate=float(rng.choice([0.5, 1.0, 1.0, 2.0, 5.0, 10.0])),
                         coloured_sigma=sigma * rng.choice([0.0, 0.0, 0.5, 1.5]),
                         coloured_tau=rng.choice([20.0, 60.0, 200.0]), outliers=rng.choice([0.0, 0.0, 0.02]),
                         smoothing=rng.choice([0.0, 0.0, 0.5, 1.0]) if sigma > 0.3 else 0.0,
                         dropouts=rng.choice([0.0, 0.0, 20.0]))
    off, arm = np.radians(rng.uniform(-4.0, 4.0, 3)), rng.choice([0.0, 1.0]) * rng.uniform(-1.5, 1.5, 3)
    effects = [(EFFECTS[name], dict(zip([one.name for one in EFFECTS[name].parameters], values.tolist())))
               for name, values in (('mounting_rotation', off), ('gnss_lever_arm', arm)) if values.any()]
    vibration = Vibration(rng.uniform(0.0, 0.5), rng.uniform(0.0, 0.6)) if rng.random() < 0.7 else None
    recording = simulate_recording(drive, sensors, receiver, effects, seed=seed, name=f'{kind} {seed}',
                                   vibration=vibration).recording
    late, jitter = float(rng.choice([0.0, 0.0, 0.1, 0.3, 0.6])), float(rng.choice([0.0, 0.0, 0.05]))
    claim, fixes = float(rng.choice([1.0, 1.0, 0.3, 0.1, 3.0, 0.0])), recording.gnss
    shift = np.round((late + jitter * np.abs(rng.standard_normal(len(fixes)))) * 1e9).astype(np.int64)
    known = fixes.covariance_type if claim else np.zeros_like(fixes.covariance_type)
    fixes = replace(fixes, stamp=fixes.stamp + shift, received=fixes.received + shift,
                    covariance=claim**2 * fixes.covariance, covariance_type=known)
    if rng.random() < 0.3:  # recorded from somewhere in the drive on
        begin = recording.imu.stamp[0] + round(rng.uniform(60.0, 100.0) * 1e9)
        recording = replace(recording, imu=recording.imu.select(recording.imu.stamp > begin))
        fixes = fixes.select(fixes.stamp > begin)
    said = (f'{kind} {seed}, IMU {rate:g} Hz x{grade:.1f}, fixes {receiver.rate:g} Hz {sigma:g} m, claimed x{claim:g}, '
            f'{late:g} s late, arm {np.abs(arm).max():.1f} m')
    truth = recording.reference.select(slice(None, None, round(rate / 10.0)))
    return replace(recording, gnss=fixes, reference=truth), said


def _within(rows, k, off):
    """Whether the 95 % ellipse of the states k of `rows` holds errors of `off`, m (k, 2)."""
    n, e, ne = rows.sigma[k, 0], rows.sigma[k, 1], rows.covariance_ne[k]
    square = e**2 * off[:, 0] ** 2 - 2.0 * ne * off[:, 0] * off[:, 1] + n**2 * off[:, 1] ** 2
    return square < ELLIPSE * (n**2 * e**2 - ne**2)


def judge(recording: Recording, values: dict) -> list[float] | str:
    """RMSE of the fixes, RMSE and largest error of the filter, m, share in the ellipse, s falsely at rest; for each
    duration without fixes the median of the largest errors of the filter and of going straight on, m, and the share in
    the ellipse at the end. A text where the filter did not start."""
    config = FilterConfig.from_parameters(table.check({'reference_lever_arm': [0.0, 0.0, 0.0], **values}))
    truth, fixes = recording.reference, recording.gnss
    origin = truth.latitude[0], truth.longitude[0]
    whole = run(config, recording.imu, fixes, Aiding())
    if not len(whole.stamp):
        return whole.notices[-1].text
    first, last = whole.stamp[0] + round(SETTLED * 1e9), min(truth.stamp[-1], whole.stamp[-1])
    judged = fixes.select((fixes.stamp > first) & (fixes.stamp < last))
    alone = _rms(_local(judged.latitude, judged.longitude, origin) - _at(judged.stamp, truth, origin))
    behind = whole.stamp[np.searchsorted(whole.stamp, judged.stamp)]
    fused = _rms(_at(behind, whole, origin) - _at(behind, truth, origin))
    true = (truth.stamp > first) & (truth.stamp < last)
    k = np.searchsorted(whole.stamp, truth.stamp[true])
    off = _at(whole.stamp[k], whole, origin) - _at(whole.stamp[k], truth, origin)
    speeds = [np.hypot(velocity[:, 0], velocity[:, 1]) for velocity in (whole.velocity[k], truth.velocity[true])]
    held = 0.1 * np.sum((speeds[0] < 0.03) & (speeds[1] > 0.15))
    found = [alone, fused, np.linalg.norm(off, axis=1).max(), _within(whole, k, off).mean(), held]
    for duration in OUTAGES:
        begins = np.arange(first + round(20e9), last - round((duration + 1.0) * 1e9), round(SPACING * 1e9))
        outages = []
        for rows, stamp, off, straight in without_fixes(config, recording, begins, duration, Aiding()):
            end = np.clip(np.searchsorted(rows.stamp, stamp[-1:]), 0, len(rows.stamp) - 1)
            outages.append((np.linalg.norm(off, axis=1).max(), np.linalg.norm(straight, axis=1).max(),
                            _within(rows, end, off[-1:])[0]))
        mine, straight, held = np.array(outages).T if outages else np.full((3, 1), np.nan)
        found += [np.median(mine), np.median(straight), np.mean(held)]
    return found


def _line(name, found):
    alone, fused, largest, within, held, *outages = found
    cells = [f'{alone:.2f}', f'{fused:.2f}', f'{largest:.1f}', f'{100 * within:.0f} %', f'{held:.0f}']
    cells += [f'{a:.1f} / {b:.1f}, {100 * c:.0f} %' for a, b, c in zip(*[iter(outages)] * 3)]
    return f'| {name} | {" | ".join(cells)} |'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add('--first-seed', type=int, default=5001)
    add('--count', type=int, default=20)
    add('--vehicle', choices=[*VEHICLES, *ON_THE_ROOF])
    add('--set', nargs='+', default=[], metavar='NAME=VALUE', help='parameters')
    add('--output', type=Path)
    options = parser.parse_args()
    given = {name: yaml.safe_load(value) for name, _, value in (text.partition('=') for text in options.set)}
    head = ['drive', 'fixes, m', 'filter, m', 'largest, m', 'in 95 %', 'at rest, s']
    head += [f'{duration:g} s without: filter / straight on, m, in 95 %' for duration in OUTAGES]
    lines, all_found = [f'| {" | ".join(head)} |', f'|{"---|" * len(head)}'], []
    print(*lines, sep='\n', flush=True)
    for seed in range(options.first_seed, options.first_seed + options.count):
        recording, said = imperfect(seed, options.vehicle)
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')
            found = judge(recording, given)
        if isinstance(found, str):
            lines.append(f'| {said} | {found} |')
        else:
            all_found.append(found)
            lines.append(_line(said, found))
        print(lines[-1], flush=True)
    every = np.array(all_found)
    if len(every):
        mean = np.exp(np.nanmean(np.log(np.maximum(every, 1e-9)), axis=0))
        mean[[3, 4, 7, 10, 13]] = np.nanmean(every[:, [3, 4, 7, 10, 13]], axis=0)
        lines.append(_line(f'mean of {len(every)}', mean))
        print(lines[-1])
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
