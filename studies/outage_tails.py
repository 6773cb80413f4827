"""What the worst outages have that the others have not: by whether the vehicle turned or stopped meanwhile.

    python studies/outage_tails.py [--seeds 6] [--minutes 20] [--processes 2] [--output FILE.md]

The realistic drives of studies/vehicle.py with fixes of 1.5 m, 30, 60 and 300 s without fixes every 50 s, with the
default noise parameters and with those that the sensors were simulated with: error and the filter's own sigma at the
end, median / 95 %, and the largest error there.
"""
from __future__ import annotations

import numpy as np
import over_drives
from vehicle import FIXES, simulated

from mems_ins_fusion.evaluation.comparison import samples_to_keep, truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95
from mems_ins_fusion.evaluation.outages import outage_begins, run_outages
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.scene import REALISTIC

DURATIONS = (30.0, 60.0, 300.0)
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


def of_drive(seed: int, minutes: float):
    """((duration, noise), rows of `outages_of`) of one drive."""
    recording = simulated(seed, minutes, FIXES['1.5 m'])
    return [((duration, name), rows) for name, values in SETTINGS.items()
            for duration, rows in zip(DURATIONS, outages_of(recording, values))]


def lines(results: dict, drives: int):
    """A line for all outages, those with a turn or a stop, and those without."""
    yield '| without fixes | noise | outages | number | error, m | largest, m | sigma, m | in 95 % |'
    yield f'|{"---|" * 8}'
    for (duration, name), found in sorted(results.items()):
        rows = np.concatenate(found)
        for kind, part in (('all', rows), ('with a turn or a stop', rows[rows[:, 3] == 0]),
                           ('straight on', rows[rows[:, 3] == 1])):
            if not len(part):
                continue
            error, sigma = (np.percentile(part[:, i], [50, 95]) for i in range(2))
            yield (f'| {duration:g} s | {name} | {kind} | {len(part)} | {error[0]:.1f} / {error[1]:.0f} | '
                   f'{part[:, 0].max():.0f} | {sigma[0]:.1f} / {sigma[1]:.0f} | {100 * part[:, 2].mean():.0f} % |')


if __name__ == '__main__':
    over_drives.main(__doc__, of_drive, lines, seeds=6)
