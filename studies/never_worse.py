"""Whether the filter is ever worse than doing without it: than the fixes themselves, and than going straight on.

    python studies/never_worse.py [--seeds 2] [--minutes 10] [--rate 1] [--only NAME] [--faults] [--data ../shared/data]
                                  [--set NAME=VALUE ...] [--output FILE.md]

With fixes the filter's RMSE is held against that of the fixes themselves, at the fixes' stamps and at the samples
behind them. Without fixes for 10, 30 and 60 s, each 100 s, the largest error (median over the outages) against that of
a point that goes straight on from the last fix, at the velocity between it and the one a second or more before. A
filter is worth its name where the first ratio is at most 1.1 and the second at most 1; what exceeds that is marked.

The drives: REALISTIC ones with the receivers of studies/vehicle.py, a motorway with a phone on the dash (an IMU of
10 Hz without anti-aliasing filter that the vehicle shakes, 36 m/s, fixes of 4 m, smoothed and stamped a second late),
dense traffic, in which the car creeps and stops, accelerometers that are off by much more than configured, for seconds
or a minute,
and the measured drives whose truth is better than 1.5 m, with noise of 1.5 m on their fixes. --faults: each fault of
studies/faults.py on a REALISTIC drive, from its begin to 60 s after its end, with fixes only: an outage within a fault
tells nothing.
"""
from __future__ import annotations

import argparse
import warnings
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np
import yaml
from scipy.signal import lfilter
from vehicle import FIXES, MEASURED, measured, sensors, simulated

from mems_ins_fusion.evaluation.comparison import add_noise
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import Aiding, run, run_with_outages
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.manoeuvres import Segment
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_recording
from mems_ins_fusion.simulation.vibration import Vibration

DURATIONS, SPACING = (10.0, 30.0, 60.0), 100.0
#: the filter has settled so long after its start, s
SETTLED = 60.0
#: what is allowed of the fixes' own error
ALLOWED = 1.1
#: m/s^2 and s: errors of accelerometers on a mount that gives way, beside the ones they are configured with
UNSTEADY = ((0.1, 5.0), (0.3, 5.0), (0.3, 60.0), (1.0, 60.0))
UNSTEADY_RECEIVERS = {'fixes of 1.5 m': GnssNoise(1.5), 'fixes of 0.05 m': GnssNoise(0.05)}


@dataclass(frozen=True)
class Line:
    """A recording, parameters, and from when to when it is judged, s after its begin."""

    name: str
    recording: Recording
    values: dict
    window: tuple[float, float] | None = None


def _motorway(speed, rng):
    """Long bends at 33 to 38 m/s, now and then slower behind others."""
    target = rng.uniform(33.0, 38.0) if rng.uniform() < 0.7 else rng.uniform(22.0, 30.0)
    return [Segment(max(round(abs(target - speed) * 2.0), 4.0), speed_change=target - speed),
            Segment(float(rng.integers(8, 25)), course_change=rng.normal(0.0, 0.15)),
            Segment(float(rng.integers(5, 20)))]


def phone(seed: int, minutes: float) -> Recording:
    """A phone on the dash of a car on a motorway."""
    drive = simulate_drive(60.0 * minutes, seed, manoeuvres=(_motorway,), grade=0.03, bank=0.02, parked_on_slope=True,
                           rotating_earth=True, suspension=1.2, unevenness=np.radians(0.15))
    recording = simulate_recording(drive, sensors(), GnssNoise(4.0, smoothing=0.8, coloured_sigma=2.0), seed=seed,
                                   name='phone', vibration=Vibration(0.4, 0.4)).recording
    late = replace(recording.gnss, stamp=recording.gnss.stamp + 10**9, received=recording.gnss.received + 10**9)
    return replace(recording, imu=recording.imu.select(slice(None, None, 10)), gnss=late,
                   reference=recording.reference.select(slice(None, None, 10)))


def unsteady(seed: int, recording: Recording, size: float, tau: float) -> Recording:
    """With errors of the accelerometers of `size`, m/s^2, and a correlation time of `tau`, s."""
    interval = np.median(np.diff(recording.imu.stamp)) * 1e-9
    keep = np.exp(-interval / tau)
    white = np.random.default_rng(seed).standard_normal(recording.imu.specific_force.shape)
    error = size * lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white, axis=0)
    return replace(recording, imu=replace(recording.imu, specific_force=recording.imu.specific_force + error))


def _local(latitude, longitude, origin):
    north, east = radii(origin[0])
    return np.column_stack([(latitude - origin[0]) * north, (longitude - origin[1]) * east * np.cos(origin[0])])


def _at(stamp, samples, origin):
    """Positions (m, 2) of what has stamp, latitude and longitude, at the stamps (m,)."""
    base = samples.stamp[0]
    where = _local(samples.latitude, samples.longitude, origin)
    return np.column_stack([np.interp((stamp - base) * 1e-9, (samples.stamp - base) * 1e-9, where[:, k])
                            for k in range(2)])


def _straight_on(fixes, begin, stamp, origin):
    """Positions at the stamps (m,) of what goes straight on from the fixes till `begin`, ns."""
    known = fixes.select(fixes.stamp <= begin)
    last = len(known) - 1
    before = int(np.searchsorted(known.stamp, known.stamp[last] - 10**9 + 10**7, side='right')) - 1
    where = _local(known.latitude, known.longitude, origin)
    velocity = (where[last] - where[before]) / ((known.stamp[last] - known.stamp[before]) * 1e-9)
    return where[last] + (stamp[:, None] - known.stamp[last]) * 1e-9 * velocity


def without_fixes(config: FilterConfig, recording: Recording, begins: np.ndarray, duration: float, aiding: Aiding):
    """Of each outage of `duration` s that begins at `begins`, ns: the filter's states, the stamps of the truth (m,) in
    it, and the errors there of the filter and of going straight on (m, 2), m."""
    truth, fixes = recording.reference, recording.gnss
    origin = truth.latitude[0], truth.longitude[0]
    coasting = run_with_outages(config, recording.imu, fixes, begins, duration, aiding)[1]
    for k, begin in enumerate(coasting.begin):
        rows = coasting.run.states(slice(coasting.first[k], coasting.first[k + 1]))
        stamp = truth.stamp[(truth.stamp > begin) & (truth.stamp <= min(begin + duration * 1e9, rows.stamp[-1]))]
        if len(stamp):
            there = _at(stamp, truth, origin)
            yield rows, stamp, _at(stamp, rows, origin) - there, _straight_on(fixes, begin, stamp, origin) - there


def judge(line: Line) -> str:
    """A line of the table."""
    recording, config = line.recording, FilterConfig.from_parameters(table.check(line.values))
    truth = recording.reference
    origin = truth.latitude[0], truth.longitude[0]
    aiding = Aiding(**{kind: getattr(recording, kind) for kind in ('speed', 'velocity', 'heading')
                       if config.parameters[f'{kind}_topic']})
    whole = run(config, recording.imu, recording.gnss, aiding)
    if not len(whole.stamp):
        return f'| {line.name} | {whole.notices[-1].text} |'
    first = whole.stamp[0] + round(SETTLED * 1e9)
    stop = truth.stamp[-1]
    if line.window:
        first, stop = (recording.imu.stamp[0] + round(t * 1e9) for t in line.window)
    fixes = recording.gnss
    judged = fixes.select((fixes.stamp > max(first, truth.stamp[0])) & (fixes.stamp < min(stop, whole.stamp[-1])))
    alone = _rms(_local(judged.latitude, judged.longitude, origin) - _at(judged.stamp, truth, origin))
    # the first sample behind a fix is the first whose state knows of it; between two of them half of it does not
    after = whole.stamp[np.searchsorted(whole.stamp, judged.stamp)]
    fused = _rms(_at(after, whole, origin) - _at(after, truth, origin))
    cells = [f'{alone:.2f}', f'{fused:.2f}', _ratio(fused / alone, ALLOWED)]
    for duration in DURATIONS if not line.window else ():
        begins = np.arange(first, stop - round((duration + 1.0) * 1e9), round(SPACING * 1e9))
        found = [(np.linalg.norm(mine, axis=1).max(), np.linalg.norm(straight, axis=1).max())
                 for _, _, mine, straight in without_fixes(config, recording, begins, duration, aiding)]
        a, b = np.median(found, axis=0)
        cells += [f'{a:.1f}', f'{b:.1f}', _ratio(a / b, 1.0)]
    return f'| {line.name} | {" | ".join(cells)} |'


def _ratio(value, allowed):
    return f'{value:.2f}' if value <= allowed else f'**{value:.2f}**'


def _rms(distance):
    return float(np.sqrt((distance**2).sum(axis=1).mean()))


def lines(options, given: dict):
    """What is judged, made one by one."""
    exact = {'reference_lever_arm': [0.0, 0.0, 0.0], **given}
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        if options.faults:
            import faults

            for fault in faults.FAULTS:
                if options.only in fault.name:
                    clean = faults.clean_drive(seed, options.rate)
                    begin = fault.begin(clean)
                    yield Line(f'{fault.name}, seed {seed}', faults.altered(fault, clean, seed),
                               {**exact, **fault.values}, (begin, begin + fault.duration + 60.0))
            continue
        for name, receiver in FIXES.items():
            if options.only in name:
                yield Line(f'simulated, {name}, seed {seed}',
                           simulated(seed, options.minutes, replace(receiver, rate=options.rate)), exact)
        if options.only in 'dense traffic':
            drive = replace(REALISTIC, manoeuvres='traffic').drive(60.0 * options.minutes, seed)
            yield Line(f'simulated, dense traffic, seed {seed}', simulated(
                seed, options.minutes, GnssNoise(1.5, options.rate), drive), exact)
        if options.only in 'phone':
            yield Line(f'simulated, phone on a motorway, seed {seed}', phone(seed, options.minutes), exact)
        for (receiver, noise), (size, tau) in product(UNSTEADY_RECEIVERS.items(), UNSTEADY):
            name = f'accelerometers off by {size:g} m/s^2 for {tau:g} s, {receiver}'
            if options.only in name:
                recording = simulated(seed, options.minutes, replace(noise, rate=options.rate))
                yield Line(f'simulated, {name}, seed {seed}', unsteady(seed, recording, size, tau), exact)
    if options.faults:
        return
    for name, of in MEASURED.items():
        if options.only in name and (options.data / name).exists():
            recording = measured(name, options.data)
            if recording.reference is None:
                continue
            noisy = add_noise(recording.gnss, 1.5 if np.median(recording.gnss.covariance[:, 0, 0]) < 0.1 else 0.0, 0)
            yield Line(name, replace(recording, gnss=noisy), {**of.values, **given})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = parser.add_argument
    add('--seeds', type=int, default=2)
    add('--first-seed', type=int, default=2001)
    add('--minutes', type=float, default=10.0)
    add('--rate', type=float, default=1.0, help='of the simulated fixes, Hz')
    add('--only', default='', help='drives, or faults, with this in their name')
    add('--faults', action='store_true', help='faults in place of drives')
    add('--data', type=Path, default=Path('../shared/data'))
    add('--set', nargs='+', default=[], metavar='NAME=VALUE', help='parameters')
    add('--output', type=Path)
    options = parser.parse_args()
    given = {name: yaml.safe_load(value) for name, _, value in (text.partition('=') for text in options.set)}
    head = ['drive', 'fixes alone, m', 'filter, m', 'ratio']
    for duration in DURATIONS if not options.faults else ():
        head += [f'{duration:g} s without: filter, m', 'straight on, m', 'ratio']
    table_lines = [f'| {" | ".join(head)} |', f'|{"---|" * len(head)}']
    print(*table_lines, sep='\n', flush=True)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        for line in lines(options, given):
            table_lines.append(judge(line))
            print(table_lines[-1], flush=True)
    if options.output:
        options.output.write_text('\n'.join(table_lines) + '\n')


if __name__ == '__main__':
    main()
