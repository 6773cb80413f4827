"""The diagnosis while driving on the measured drives: is any of them worse with `apply` than with `off`?

    python studies/online_measured.py ../shared/data [--drives longmont_rtk_drive dresden_hobby_imu ...] [--output FILE]

Each drive as a live node would have driven it (`diagnosis.applying.live_output`), with `off` and `apply`, the topics
and the mounting to the nearest right angle alone given. Printed: what came to which state when, where another filter
took over, and a row of the table:

RMSE: horizontal, against the reference, over the whole drive, m; where there is none, `-`, as the filter is given the
fixes. Outages of 10 and 30 s: the largest errors (mean, m) behind the middle of the drive, fixes withheld each 10 s on,
with the parameters as given and with those that are applied at the end. Where nothing is applied, all numbers have to
be the same, to the last bit.
"""
from __future__ import annotations

import argparse
from math import pi
from pathlib import Path

import numpy as np

from mems_ins_fusion.diagnosis.applying import live_output
from mems_ins_fusion.diagnosis.watch import RecordingWatch
from mems_ins_fusion.evaluation.comparison import aiding_of, samples_to_keep, truth_of
from mems_ins_fusion.evaluation.outages import outage_begins, run_outages
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.samples import Recording

#: mounting to the nearest right angle, other parameters, and the topic of a reference, of each drive
DRIVES = {'longmont_rtk_drive': ([0.0, 0.0, pi], {}, ''),
          'karlsruhe_hills': ([0.0, 0.0, 0.0], {}, '/reference/fix'),
          'kingston_span': ([0.0, 0.0, -pi / 2.0], {}, '/reference/fix'),
          'dresden_hobby_imu': ([0.0, 0.0, 0.0], {}, ''),
          'incheon_square_ros2': ([pi, 0.0, 0.0], {'gnss_topic': '/fix'}, ''),
          'husky_wheel_speed': ([0.0, 0.0, 0.0], {'speed_topic': '/wheel/speed'}, '')}
DURATIONS, SPACING = (10.0, 30.0), 10.0  # s
SECOND = 10**9


def rmse(run, recording: Recording, datum) -> float | None:
    """Horizontal, m."""
    if recording.reference is None:
        return None
    reference = recording.reference
    inside = (reference.stamp > run.stamp[0]) & (reference.stamp < run.stamp[-1])
    north, east, _ = to_local(reference.latitude[inside], reference.longitude[inside], reference.height[inside], datum)
    found = [np.interp(reference.stamp[inside] - run.stamp[0], run.stamp - run.stamp[0], run.odometry[:, i])
             for i in (1, 0)]  # odometry is east and north
    return float(np.sqrt(np.mean((found[0] - north)**2 + (found[1] - east)**2)))


def outages(recording: Recording, values: dict) -> list[str]:
    """Mean of the largest errors of each duration, and of how many outages."""
    truth, imu = truth_of(recording, values), recording.imu
    middle = int(imu.stamp[[0, -1]].mean())
    begin = outage_begins(middle, recording.gnss, values['gnss.time_offset'], SPACING, DURATIONS[0])
    found = run_outages(FilterConfig.from_parameters(values), imu, recording.gnss, truth, DURATIONS, begin,
                        aiding_of(recording), samples_to_keep(imu, truth.reference.stamp))
    return [f'{one.max_error.mean():.2f} ({len(one.max_error)})' for one in found]


def row(name: str, data: Path) -> str:
    """Drive twice; a line of the table."""
    mounting, more, reference = DRIVES[name]
    values = table.check({'imu_topic': '/imu/data', 'gnss_topic': '/gps/fix', 'imu.mounting_rpy': mounting, **more})
    bag = data / name / 'bag' if (data / name / 'bag').exists() else data / name
    speed = {'speed_topic': values['speed_topic']} if values['speed_topic'] else {}
    recording = read_recording(bag, values['imu_topic'], values['gnss_topic'], reference or None, **speed)
    fix = recording.gnss
    datum = (float(fix.latitude[0]), float(fix.longitude[0]), float(fix.height[0]))
    watch = RecordingWatch(recording, {**values, 'diagnosis.online': 'apply'})
    off = live_output(recording, values, None, datum)
    run = live_output(recording, {**values, 'diagnosis.online': 'apply'}, watch, datum)
    begin, told = int(recording.imu.stamp[0]), {}
    for q in watch.said:
        if told.get(q.name) != (q.state, q.applied):
            print(f'{name}: {(q.time - begin) / SECOND:.0f} s {q.name} {q.state}, applied {q.applied}: {q.text}')
        told[q.name] = q.state, q.applied
    for one in run.handovers:
        print(f'{name}: {(one.stamp - begin) / SECOND:.0f} s {one.text}')
    for one in run.dropped:
        print(f'{name}: {(one.stamp - begin) / SECOND:.0f} s {one.name} dropped')
    learned = {key: value for sets in watch.wanted.applied.values() for key, value in sets.items()}
    same = np.array_equal(off.odometry, run.odometry)
    errors = ['-' if error is None else f'{error:.2f}' for error in (rmse(off, recording, datum),
                                                                     rmse(run, recording, datum))]
    given, after = outages(recording, values), outages(recording, {**values, **learned}) if learned else ['', '']
    cells = [name, ', '.join(watch.wanted.applied) or 'nothing', 'yes' if same else 'no', *errors, *given, *after]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('data', type=Path)
    parser.add_argument('--drives', nargs='+', default=list(DRIVES), choices=list(DRIVES))
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    lines = ['| drive | applied | the same bits | RMSE, off | apply | 10 s, as given | 30 s | 10 s, applied | 30 s |',
             f'|{"---|" * 9}']
    for name in options.drives:
        lines.append(row(name, options.data))
        print(lines[-1], flush=True)
        if options.output:
            options.output.write_text('\n'.join(lines) + '\n')
    print(*lines, sep='\n')


if __name__ == '__main__':
    main()
