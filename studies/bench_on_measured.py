"""Filters on simulated sensors over a measured trajectory: the recording for `bench`, with the truth that a measured
drive has not.

    python studies/bench_on_measured.py ../shared/data/karlsruhe_hills/bag drive --reference-topic /reference/fix
    python -m mems_ins_fusion bench prepare --bag drive --reference-topic /reference/fix --output drive_bench --kf-gins

Speed and course are those of the measured trajectory, after 30 s at rest; road, body, mounting, vibration and IMU are
those of `simulate --drive realistic`, which knows more than any filter. Fixes of 1.5 m each second.
"""
from __future__ import annotations

import argparse
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import savgol_filter

from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.simulation.drive import MARGIN, Drive, Path
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording

REST = 30.0  # s at rest, before and after the drive
KNOTS = 0.5  # s between the knots of speed and course: a vehicle steers no faster
WINDOW = 1.5  # s, over which positions are smoothed by a parabola
SLOW = 1.0  # m/s: below this the course is not seen from positions


@dataclass(frozen=True)
class Measured(Path):
    """A path with speed and course as functions of time from elsewhere: (n,) s, m/s and rad."""

    time: np.ndarray | None = None
    speed: np.ndarray | None = None
    heading: np.ndarray | None = None

    @cached_property
    def _speed(self) -> CubicSpline:
        return CubicSpline(self.time, self.speed, bc_type='clamped')

    @cached_property
    def _course(self) -> CubicSpline:
        return CubicSpline(self.time, self.heading, bc_type='clamped')


def profile(reference) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, speed and course at knots, from rest to rest."""
    datum = reference.latitude[0], reference.longitude[0], reference.height[0]
    seconds = (reference.stamp - reference.stamp[0]) * 1e-9
    step = float(np.median(np.diff(seconds)))
    at = np.arange(0.0, seconds[-1], step)
    north, east = (np.interp(at, seconds, v) for v in to_local(
        reference.latitude, reference.longitude, reference.height, datum)[:2])
    length = max(2 * round(WINDOW / step / 2) + 1, 5)
    v = [savgol_filter(axis, length, 2, deriv=1, delta=step) for axis in (north, east)]
    speed, course = np.hypot(*v), np.arctan2(v[1], v[0])
    moving = speed > SLOW
    course = np.interp(at, at[moving], np.unwrap(course[moving]))
    knots = np.arange(0.0, at[-1], KNOTS)
    still = np.arange(REST / KNOTS)
    time = np.arange(len(knots) + 2 * len(still) + round(MARGIN / KNOTS)) * KNOTS
    after = len(time) - len(knots) - len(still)
    speed, course = np.interp(knots, at, speed * moving), np.interp(knots, at, course)
    return time, np.pad(speed, (len(still), after)), np.pad(course, (len(still), after), mode='edge')


def driven(reference, seed: int, rate: float) -> Drive:
    """The drive over the trajectory `reference` in the realistic scene."""
    time, speed, heading = profile(reference)
    some = REALISTIC.drive(1.0, seed, rate, origin=(
        float(reference.latitude[0]), float(reference.longitude[0]), float(reference.height[0])))
    scene = {f.name: getattr(some.path, f.name) for f in fields(Path)}
    path = Measured(**scene, time=time, speed=speed, heading=heading)
    return replace(some, path=path, time=np.array([time[-1] - MARGIN])).altered()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('bag')
    parser.add_argument('output')
    parser.add_argument('--reference-topic', required=True)
    parser.add_argument('--imu-topic', default='/imu/data')
    parser.add_argument('--rate', type=float, default=100.0)
    parser.add_argument('--seed', type=int, default=1)
    options = parser.parse_args()
    measured = read_recording(options.bag, options.imu_topic, None, options.reference_topic).reference
    drive = driven(measured, options.seed, options.rate)
    distortions = REALISTIC.distortions(options.seed) | {'aiding': None}
    made = simulate_recording(drive, SensorErrors.from_parameters(table.check(REALISTIC.imu), 'gauss_markov'),
                              GnssNoise(), seed=options.seed, **distortions).recording
    thinned = slice(None, None, round(options.rate / 10.0))
    write_recording(replace(made, reference=made.reference.select(thinned)), options.output)
    distance = np.linalg.norm(np.diff(drive.position, axis=0), axis=1).sum()
    print(f'{options.output}: {drive.time[-1]:.0f} s, {distance:.0f} m, up to '
          f'{np.linalg.norm(drive.velocity, axis=1).max():.1f} m/s')


if __name__ == '__main__':
    main()
