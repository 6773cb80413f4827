"""The diagnosis on simulated drives made after the descriptions of cars that nobody of the project has recordings of.

    python studies/diagnosis_of_described_cars.py RESULTS.csv [--drives N] [--first I] [--minutes M]

Each description (DESCRIPTIONS) with each of three settings, 15 min: a line in RESULTS.csv each, as of
`diagnosis_on_roads`. Judged is a second drive of the same car against the truth.
"""
from __future__ import annotations

import argparse
import math
import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import diagnosis_on_roads as roads  # noqa: E402

from mems_ins_fusion.diagnosis.diagnose import diagnose  # noqa: E402
from mems_ins_fusion.diagnosis.residuals import averaged  # noqa: E402
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
    """The line of one case."""
    names = [(d, s) for d in DESCRIPTIONS for s in SETTINGS]
    description, settings = names[number % len(names)]
    what, seed = DESCRIPTIONS[description], FIRST_SEED + number // len(names)
    given = table.check({**SETTINGS[settings], **roads.TRUTH})
    true = {**what.effects, **({'mounting_rotation': {'yaw': math.radians(what.yaw)}} if what.yaw else {})}
    row = dict.fromkeys(roads.COLUMNS, '') | {'number': number, 'kind': f'{description}, {settings}', 'true': true}
    first, second = drive(what, seed), drive(what, seed + SECOND_DRIVE)
    reference = None
    if what.reference is not None:
        reference = replace(first.reference, stamp=first.reference.stamp + round(what.reference * 1e9))
    began = time.perf_counter()
    result = diagnose(replace(first, reference=reference), given)
    row['seconds'] = time.perf_counter() - began
    before, after = roads.errors(given, second), roads.errors(result.corrected, second)
    said = [{'name': f.name, 'group': f.group, 'added': f.added, 'why': f.reason,
             **{n: e.text() for n, e in f.parameters.items()}} for f in result.findings]
    return row | {'found': said, 'deviations': result.noise, 'unexplained': result.unexplained,
                  'before': roads.measured(before), 'after': roads.measured(after),
                  'harm': roads.certainly_larger(after, before),
                  'within_before': [float(w.mean()) for w in before.within],
                  'within_after': [float(w.mean()) for w in after.within]}


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('results', type=Path)
    parser.add_argument('--drives', type=int, default=len(DESCRIPTIONS) * len(SETTINGS))
    parser.add_argument('--first', type=int, default=0)
    parser.add_argument('--only', type=int, nargs='*')
    options = parser.parse_args(arguments)
    there = {row['number'] for row in roads.read(options.results)}
    for number in options.only or range(options.first, options.first + options.drives):
        if number not in there:
            row = judged(number)
            roads.append(options.results, row)
            print(row['number'], row['kind'], 'HARM' if row['harm'] else '', f"{row['seconds']:.0f} s")
            for f in row['found']:
                print('   ', {k: v for k, v in f.items() if v})
            print('    noise', roads._rounded(row['deviations']), 'unexplained', row['unexplained'])
            for what in ('before', 'after', 'within_before', 'within_after'):
                print('   ', what, roads._rounded(row[what]), flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
