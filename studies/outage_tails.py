"""What the worst outages have that the others have not: by whether the vehicle turned or stopped meanwhile.

    python studies/outage_tails.py [--seeds 6] [--minutes 20] [--output FILE.md]

The realistic drives of studies/vehicle.py with fixes of 1.5 m, 60 s without fixes every 50 s, with the default noise
parameters and with those that the sensors were simulated with: error and the filter's own sigma at the end,
median / 95 %.
"""
from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from vehicle import FIXES, simulated

from mems_ins_fusion.evaluation.comparison import samples_to_keep, truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95
from mems_ins_fusion.evaluation.outages import outage_begins, run_outages
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.scene import REALISTIC

DURATIONS = (30.0, 60.0)
SPACING = 50.0
#: an outage in which the vehicle turns by this much, rad, or is as slow as that, m/s, shows the filter its speed
TURN, SLOW = np.radians(20.0), 0.3
SETTINGS = {'defaults': {}, 'noise known': REALISTIC.imu}


def outages_of(recording, values: dict):
    """For each duration (o, 4): error and sigma at the end, m, whether the ellipse held it, whether straight on."""
    values = table.check(values)
    config, truth = FilterConfig.from_parameters(values), truth_of(recording, values)
    keep = samples_to_keep(recording.imu, truth.reference.stamp)
    started = int(run(config, recording.imu, recording.gnss, keep=keep).stamp[0])
    begin = outage_begins(started, recording.gnss, 0.0, SPACING, min(DURATIONS))
    return [np.array([(e.horizontal[-1], e.sigma[-1], e.nees[-1] < NEES_95, is_straight(truth.reference, e.stamp))
                      for e in outages.errors])
            for outages in run_outages(config, recording.imu, recording.gnss, truth, DURATIONS, begin, keep=keep)]


def is_straight(reference, stamp) -> bool:
    """Whether the vehicle neither turned nor stopped from the first to the last `stamp`, ns."""
    during = reference.select((reference.stamp >= stamp[0]) & (reference.stamp <= stamp[-1]))
    yaw = np.unwrap(during.yaw)
    return bool(np.ptp(yaw) < TURN and np.hypot(*during.velocity[:, :2].T).min() > SLOW)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=6)
    parser.add_argument('--first-seed', type=int, default=1000)
    parser.add_argument('--minutes', type=float, default=20.0)
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    found: dict = {}
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        recording = simulated(seed, options.minutes, FIXES['1.5 m'])
        for name, values in SETTINGS.items():
            for duration, rows in zip(DURATIONS, outages_of(recording, values)):
                found.setdefault((duration, name), []).append(rows)
    lines = ['| without fixes | noise | outages | number | error, m | sigma, m | in 95 % |', f'|{"---|" * 7}']
    for (duration, name), rows in sorted(found.items()):
        rows = np.concatenate(rows)
        for kind, part in (('all', rows), ('with a turn or a stop', rows[rows[:, 3] == 0]),
                           ('straight on', rows[rows[:, 3] == 1])):
            error, sigma = (np.percentile(part[:, i], [50, 95]) for i in range(2))
            lines.append(f'| {duration:g} s | {name} | {kind} | {len(part)} | {error[0]:.1f} / {error[1]:.0f} | '
                         f'{sigma[0]:.1f} / {sigma[1]:.0f} | {100 * part[:, 2].mean():.0f} % |')
    print('\n'.join(lines))
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
