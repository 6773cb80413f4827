"""The diagnosis on simulated drives made after the descriptions of cars that nobody of the project has recordings of.

    python studies/diagnosis_of_described_cars.py RESULTS.jsonl [--only NUMBER ..]

Each description (DESCRIPTIONS) with each of three settings (SETTINGS), 15 min: a line in RESULTS.jsonl each; those that
are there are not run again. Then the table of docs/diagnosis_study.md is printed. Judged is a second drive of the same
car, which the diagnosis never sees, against the truth.
"""
from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import diagnosis_on_roads as roads  # noqa: E402

from mems_ins_fusion.diagnosis.diagnose import diagnose  # noqa: E402
from mems_ins_fusion.diagnosis.problem import averaged  # noqa: E402
from mems_ins_fusion.effects.registry import EFFECTS  # noqa: E402
from mems_ins_fusion.parameters import table  # noqa: E402
from mems_ins_fusion.samples import Recording  # noqa: E402
from mems_ins_fusion.simulation.scene import REALISTIC  # noqa: E402
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording  # noqa: E402

DURATION = 900.0  # s
FIRST_SEED, SECOND_DRIVE = 70_000, 500_000
_PLAIN = {'vehicle.zero_velocity': False, 'vehicle.non_holonomic': False, 'gnss.gate_probability': 1.0,
          'gnss.adapt_sigma': False, 'gnss.robust_sigma': 0.0}
SETTINGS = {'default': {}, 'strapdown': _PLAIN,
            'planar': _PLAIN | {'mechanization': 'planar', 'vehicle.tilt_sigma': 0.0}}


@dataclass(frozen=True)
class Description:
    """yaw: deg, by which the mount is off. reference: s by which that of the diagnosis runs late; None: there is none.
    imu_rate: Hz, to which the samples are averaged; 0: as simulated."""

    grade: str
    receiver: GnssNoise
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    yaw: float = 0.0
    slope: float = 0.03
    reference: float | None = None
    imu_rate: float = 0.0


DESCRIPTIONS = {
    'late by 0.67 s, turned by 7 deg': Description(
        'consumer', GnssNoise(1.5, coloured_sigma=1.0), {'gnss_time_offset': {'time_offset': 0.67}}, 7.1),
    'phone: smooths, late': Description(
        'consumer', GnssNoise(2.0, coloured_sigma=2.0, smoothing=1.0, outliers=0.005),
        {'gnss_time_offset': {'time_offset': 0.3}, 'gnss_latency': {'step': 0.15, 'at': 0.5}}),
    '5 Hz, reference of the receiver': Description(
        'automotive', GnssNoise(1.0), {'gnss_time_offset': {'time_offset': 0.15}}, reference=0.15, imu_rate=5.0),
    'turned by 6 deg': Description('consumer', GnssNoise(1.5), yaw=6.0),
    'survey, hills': Description('tactical', GnssNoise(0.02), slope=0.08, reference=0.0),
    'nothing': Description('automotive', GnssNoise(1.5))}
CASES = [(description, settings) for description in DESCRIPTIONS for settings in SETTINGS]


def drive(what: Description, seed: int) -> Recording:
    """One drive of this car, with the truth."""
    scene = replace(REALISTIC, grade=what.slope, mounting_error=0.0)
    path = scene.drive(DURATION, seed)
    sensors = SensorErrors.from_parameters(table.check(roads.GRADES[what.grade]), 'gauss_markov')
    there = [(EFFECTS[name], theta) for name, theta in what.effects.items()]
    there.append((EFFECTS['mounting_rotation'], {'yaw': math.radians(what.yaw), 'pitch': 0.01, 'roll': -0.01}))
    found = simulate_recording(path, sensors, what.receiver, there, seed=seed,
                               vibration=scene.distortions(seed)['vibration']).recording
    return replace(found, imu=averaged(found.imu, what.imu_rate)) if what.imu_rate else found


def judged(number: int) -> dict:
    """The line of one case: what was found and what was told, errors and ellipses before and after."""
    description, settings = CASES[number]
    what = DESCRIPTIONS[description]
    given = table.check({**SETTINGS[settings], **roads.TRUTH})
    first, second = drive(what, FIRST_SEED), drive(what, FIRST_SEED + SECOND_DRIVE)
    reference = None
    if what.reference is not None:
        reference = replace(first.reference, stamp=first.reference.stamp + round(what.reference * 1e9))
    result = diagnose(replace(first, reference=reference), given)
    before, after = roads.errors(given, second), roads.errors(result.corrected, second)
    said = [{'name': f.name, 'added': f.added, **{n: e.text() for n, e in f.parameters.items()}}
            for f in result.findings]
    return {'number': number, 'car': description, 'settings': settings, 'found': said, 'noise': result.noise,
            'before': roads.measured(before), 'after': roads.measured(after),
            'harm': roads.certainly_larger(after, before), **{
                f'within_{name}': [float(w.mean()) for w in e.within]
                for name, e in (('before', before), ('after', after))}}


def line(row: dict) -> str:
    """A row of the table."""
    found = '; '.join(f'`{f["name"]}` ' + ', '.join(f'{n} {t}' for n, t in f.items() if n not in ('name', 'added'))
                      for f in row['found'] if f['added'])
    errors = ', '.join(f'{a:.2g} to {b:.2g}' for a, b in zip(row['before'], row['after']))
    held = ', '.join(f'{100 * a:.0f} to {100 * b:.0f}' for a, b in zip(row['within_before'], row['within_after']))
    noise = ', '.join(f'{n} x {f:.2g}' for n, f in row['noise'].items())
    return (f'| {row["car"]} | {row["settings"]} | {"; ".join(filter(None, (found, noise))) or "nothing"} | {errors}'
            f'{" (harm)" if row["harm"] else ""} | {held} |')


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('results', type=Path, help='a line of JSON for each case')
    parser.add_argument('--only', type=int, nargs='*', help='these cases (default: all)')
    options = parser.parse_args(arguments)
    lines = options.results.read_text().splitlines() if options.results.exists() else []
    rows = {row['number']: row for row in map(json.loads, lines)}
    for number in range(len(CASES)) if options.only is None else options.only:
        if number not in rows:
            rows[number] = judged(number)
            with options.results.open('a') as file:
                file.write(json.dumps(rows[number]) + '\n')
    print('| car | settings | found | errors, m: fixes; 10, 30, 60 s | ellipse holds, %: 10, 30, 60 s |')
    print('|---|---|---|---|---|')
    print('\n'.join(line(row) for _, row in sorted(rows.items())))
    return 0


if __name__ == '__main__':
    sys.exit(main())
