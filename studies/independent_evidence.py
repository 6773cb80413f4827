"""Evidence for the effects of docs/closing_the_loop.md that does not come from the filter's innovations.

    python studies/independent_evidence.py DATA

DATA: folder of the recordings. Prints the time offset and the antenna's arm that the track between fixes shows, the
offset at which the turns of the fixes' course go best with those of the gyroscopes, and how the pitch of a strapdown
run that is given no heights goes with the grade that the heights of the truth show.
"""
from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from mems_ins_fusion.configuration.mounting import estimate_mounting
from mems_ins_fusion.configuration.turn_offset import estimate_turn_offset, turning_of
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.motion import positions
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.samples import Fixes, Headings

RECORDINGS = (('longmont_rtk_drive', '/gps/fix', None, [0.0, 0.0, np.pi], -0.265),
              ('karlsruhe_hills', '/gps/fix', '/reference/fix', [0.0, 0.0, 0.0], 0.0),
              ('incheon_square_ros2', '/fix', None, [np.pi, 0.0, 0.0], 0.0),
              ('dresden_hobby_imu', '/gps/fix', None, [0.0, 0.1, 0.0], 0.55))
#: the grade is that over this time, at 2 m/s or faster, s
SPAN = 4.0
#: s, length of the chords between fixes whose direction is taken as the course
CHORD = 0.6
#: m/s, lowest mean speed on such a chord: the course of slower ones is dominated by the errors of the fixes
FASTER = 4.0


def course_of(fixes: Fixes) -> Headings:
    """The course of the fixes, between two of them each; NaN where the vehicle is slow."""
    step = max(round(CHORD / float(np.median(np.diff(fixes.stamp)) * 1e-9)), 1)
    way, time = (x[step:] - x[:-step] for x in (positions(fixes)[:, :2], fixes.stamp * 1e-9))
    course = np.where(np.hypot(*way.T) > FASTER * time, np.arctan2(way[:, 1], way[:, 0]), np.nan)
    middle = (fixes.stamp[step:] + fixes.stamp[:-step]) // 2
    return Headings(middle, middle, course, np.full(len(middle), np.nan))


def pitch_run(recording, mounting_rpy, offset):
    """A strapdown run whose fixes have no heights: stamps and pitch."""
    covariance = recording.gnss.covariance.copy()
    covariance[:, 2, 2], covariance[:, 2, :2], covariance[:, :2, 2] = 1e8, 0.0, 0.0
    flat = replace(recording.gnss, covariance=covariance, height=np.full(len(recording.gnss), 100.0))
    values = table.check({'mechanization': 'strapdown', 'imu.mounting_rpy': mounting_rpy,
                               'gnss.time_offset': offset})
    result = run(FilterConfig.from_parameters(values), recording.imu, flat)
    return result.stamp, result.pitch


def grade_and_pitch(truth, stamp, pitch):
    """Grade and mean pitch, rad, each second where the vehicle moves."""
    origin = truth.stamp[0]
    seconds, time = (truth.stamp - origin) * 1e-9, (stamp - origin) * 1e-9
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(positions(truth)[:, :2], axis=0).T))])
    turned = np.concatenate([[0.0], np.cumsum(pitch[1:] * np.diff(time))])
    begin = np.arange(max(seconds[0], time[0]) + 30.0, seconds[-1] - SPAN, 1.0)
    rise, distance = (np.interp(begin + SPAN, seconds, x) - np.interp(begin, seconds, x)
                      for x in (truth.height, driven))
    mean = (np.interp(begin + SPAN, time, turned) - np.interp(begin, time, turned)) / SPAN
    moving = distance > 2.0 * SPAN
    return np.arctan2(rise, distance)[moving], mean[moving]


def main():
    for name, topic, reference, mounting_rpy, offset in RECORDINGS:
        folder = Path(sys.argv[1]) / name
        recording = read_recording(folder / 'bag' if (folder / 'bag').exists() else folder, '/imu/data', topic,
                                   reference)
        found = estimate_mounting(recording.imu, recording.gnss)
        print(name, found.offset if found is not None else None)
        if found is not None:
            print(' ', estimate_turn_offset(recording.imu, turning_of(course_of(recording.gnss)), found.rotation[2]))
        truth = recording.reference if reference else recording.gnss
        grade, pitch = grade_and_pitch(truth, *pitch_run(recording, mounting_rpy, offset))
        if len(grade) < 20:
            print('  too slow for a grade')
            continue
        slope, constant = np.polyfit(grade, pitch, 1)
        print(f'  {len(grade)} grades: correlation {np.corrcoef(grade, pitch)[0, 1]:.3f}, pitch = {slope:.2f} grade '
              f'{np.degrees(constant):+.2f} deg, rest {np.degrees((pitch - slope * grade - constant).std()):.2f} deg')


if __name__ == '__main__':
    main()
