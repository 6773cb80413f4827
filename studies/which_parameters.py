"""Which parameters matter: each one of a params file wrong, on measured drives.

    python studies/which_parameters.py [DATA]

DATA: the folder of the recordings (../shared/data). Defaults, the mounting to the nearest right angle (Longmont with
what `configure` finds). Each parameter is changed alone; the mean of the largest errors in 30 s without fixes, every
30 s, and the share of them that ended in the 95 % ellipse.
"""
from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np

from mems_ins_fusion.evaluation.comparison import samples_to_keep, truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95
from mems_ins_fusion.evaluation.outages import outage_begins, run_outages
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording

DURATION = SPACING = 30.0  # s
DRIVES = {
    'Karlsruhe': ('karlsruhe_hills/bag', '/reference/fix', {}),
    'Kingston': ('kingston_span/bag', '/reference/fix', {'imu.mounting_rpy': [0.0, 0.0, -math.pi / 2]}),
    'Longmont': ('longmont_rtk_drive/bag', None, {'imu.mounting_rpy': [0.0153, -0.1152, 3.0399],
                                                  'imu.mounting_sigma': 0.01, 'gnss.time_offset': -0.266,
                                                  'gnss.time_offset_sigma': 0.011})}
#: name: change of the values of a drive
CHANGES = {
    'as it is': lambda v: {},
    '`imu.mounting_rpy`: yaw 30 deg off': lambda v: {'imu.mounting_rpy': _turned(v, 2, 30.0)},
    '`imu.mounting_rpy`: yaw 5 deg off': lambda v: {'imu.mounting_rpy': _turned(v, 2, 5.0)},
    '`gnss.time_offset` 0.5 s off': lambda v: {'gnss.time_offset': v['gnss.time_offset'] + 0.5},
    '`gnss.lever_arm` 1 m off to the left': lambda v: {'gnss.lever_arm': [0.0, 1.0, 0.0]},
    '`vehicle.non_holonomic: false`': lambda v: {'vehicle.non_holonomic': False},
    '`vehicle.zero_velocity: false`': lambda v: {'vehicle.zero_velocity': False},
    '`gnss.sigma` a fifth': lambda v: {'gnss.sigma': 0.2 * v['fix_sigma']},
    '`gnss.sigma` five times': lambda v: {'gnss.sigma': 5.0 * v['fix_sigma']},
    '`accelerometer.noise_density` x 4': lambda v: _times(v, 4.0, 'accelerometer.noise_density'),
    '`accelerometer.noise_density` x 1/4': lambda v: _times(v, 0.25, 'accelerometer.noise_density'),
    '`gyroscope.noise_density` x 4': lambda v: _times(v, 4.0, 'gyroscope.noise_density'),
    '`gyroscope.noise_density` x 1/4': lambda v: _times(v, 0.25, 'gyroscope.noise_density'),
    'both `gauss_markov.sigma` x 4': lambda v: _times(v, 4.0, *SLOW),
    'both `gauss_markov.sigma` x 1/4': lambda v: _times(v, 0.25, *SLOW),
    '`vehicle.non_holonomic_sigma` x 4': lambda v: _times(v, 4.0, 'vehicle.non_holonomic_sigma'),
    '`vehicle.non_holonomic_sigma` x 1/4': lambda v: _times(v, 0.25, 'vehicle.non_holonomic_sigma'),
    '`sensor_error_model: random_walk`': lambda v: {'sensor_error_model': 'random_walk'},
    '`sensor_error_model: autoregressive`': lambda v: {'sensor_error_model': 'autoregressive'}}
SLOW = ('accelerometer.gauss_markov.sigma', 'gyroscope.gauss_markov.sigma')


def _times(values, factor, *names):
    return {name: [factor * x for x in values[name]] if isinstance(values[name], list) else factor * values[name]
            for name in names}


def _turned(values, axis, degrees):
    rpy = list(values['imu.mounting_rpy'])
    rpy[axis] += math.radians(degrees)
    return rpy


def errors(recording, values) -> tuple[float, float] | None:
    """Mean of the largest errors, m, and the share in the ellipse; None without an outage."""
    config, truth = FilterConfig.from_parameters(values), truth_of(recording, values)
    keep = samples_to_keep(recording.imu, truth.reference.stamp)
    stamps = run(config, recording.imu, recording.gnss, keep=keep).stamp
    if not len(stamps):
        return None
    begin = outage_begins(int(stamps[0]), recording.gnss, values['gnss.time_offset'], SPACING, DURATION)
    found = run_outages(config, recording.imu, recording.gnss, truth, (DURATION,), begin, keep=keep)[0].errors
    return (float(np.mean([e.horizontal.max() for e in found])),
            float(np.mean([e.nees[-1] < NEES_95 for e in found])))


def main(data: str = '../shared/data') -> None:
    """Print the table."""
    columns = []
    for path, reference, given in DRIVES.values():
        recording = read_recording(Path(data) / path, '/imu/data', '/gps/fix', reference)
        default = {**table.defaults(), **given}
        sigma = float(np.sqrt(np.median(recording.gnss.covariance[:, 0, 0])))
        columns.append([errors(recording, table.check({**given, **change({**default, 'fix_sigma': sigma})}))
                        for change in CHANGES.values()])
    print(f'| {DURATION:g} s without fixes, m (in the ellipse, %) | {" | ".join(DRIVES)} |')
    print(f'|{"---|" * (len(DRIVES) + 1)}')
    for name, *cells in zip(CHANGES, *columns):
        print(f'| {name} | ' + ' | '.join(
            'does not start' if cell is None else f'{cell[0]:.2g} ({100 * cell[1]:.0f})' for cell in cells) + ' |')


if __name__ == '__main__':
    main(*sys.argv[1:])
