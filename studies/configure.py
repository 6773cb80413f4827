"""How well `configure` finds mountings: simulated short drives, and measured recordings turned in every way.

    python studies/configure.py simulated [--drives 100]
    python studies/configure.py measured DATA
    python studies/configure.py evidence DATA

simulated: two minutes with a standstill, one right-angled turn and one stop, on hilly roads, in cars with suspension,
IMUs in arbitrary positions, five receivers; the error of the mounting over its sigma. measured: each recording with its
IMU turned by the 24 right-angled rotations and 20 arbitrary ones, in g and deg/s. evidence: whether a
filter without any constraint points where the vehicle goes.
docs/configure.md holds the results.
"""
from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import permutations, product
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mems_ins_fusion.configuration.mounting import deviation, estimate_mounting, rpy
from mems_ins_fusion.configuration.units import find_units
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.navigation.frames import wrap
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.reading import read_recording
from mems_ins_fusion.recordings.units import in_si
from mems_ins_fusion.simulation import drive
from mems_ins_fusion.simulation.drive import MARGIN, _random_hills, _sample, stream
from mems_ins_fusion.simulation.manoeuvres import Segment, _speed_change
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording

#: receivers: sigma of a fix, m, and fixes per second
RECEIVERS = ((0.02, 5.0), (0.3, 5.0), (1.0, 1.0), (1.5, 1.0), (1.5, 5.0))


def short_drive(seed: int, rate=100.0):
    """Two minutes: 15 s at rest, off, straight on, a right-angled turn, straight on, a stop, off again."""
    draw = stream(seed, 'configure')
    cruise, corner, last = draw.uniform(8, 15), draw.uniform(4, 8), draw.uniform(8, 15)
    turn = draw.choice([-1.0, 1.0]) * np.pi / 2
    segments = [Segment(15.0), _speed_change(0.0, cruise, draw.uniform(1.0, 2.0)), Segment(15.0),
                _speed_change(cruise, corner, draw.uniform(1.0, 2.0)), Segment(round(6.0 * 6.0 / corner, 1), 0.0, turn),
                _speed_change(corner, cruise, draw.uniform(1.0, 2.0)), Segment(15.0),
                _speed_change(cruise, 0.0, draw.uniform(1.0, 2.0)), Segment(8.0),
                _speed_change(0.0, last, draw.uniform(1.0, 2.0))]
    segments.append(Segment(120.0 + MARGIN - sum(segment.duration for segment in segments)))
    road = drive.Path(tuple(segments), course=draw.uniform(-np.pi, np.pi), hills=_random_hills(draw),
                pitch_per_acceleration=draw.uniform(0.0, 0.01), roll_per_acceleration=draw.uniform(0.0, 0.01))
    return _sample(road, 120.0, rate)


def short_recording(seed: int):
    """A recording of `short_drive` and the true rotation to base_link."""
    true = Rotation.random(random_state=seed).as_matrix()
    sigma, rate = RECEIVERS[seed % len(RECEIVERS)]
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    simulation = simulate_recording(short_drive(seed), sensors, GnssNoise(sigma, rate), mounting_rpy=rpy(true),
                                    seed=seed)
    return simulation.recording, true


def one_drive(seed: int):
    """Error and sigma of the mounting, rad, about forward, left and up."""
    recording, true = short_recording(seed)
    found = estimate_mounting(recording.imu, recording.gnss)
    return np.concatenate([deviation(found.rotation, true), found.sigma])


def simulated(drives: int):
    with ProcessPoolExecutor(2) as pool:
        rows = np.array(list(pool.map(one_drive, range(drives))))
    error, sigma = rows[:, :3], rows[:, 3:]
    for number, (noise, rate) in enumerate(RECEIVERS):
        show(f'{noise:g} m, {rate:g} Hz', error[number::len(RECEIVERS)], sigma[number::len(RECEIVERS)])
    show('all', error, sigma)


def show(name, error, sigma):
    """A row of the table: RMS errors, and how they compare with the sigmas."""
    known = sigma[:, 2] < np.radians(20.0)
    score = error / sigma
    level, yaw = error[:, :2], error[known, 2]
    print(f'| {name} | {len(error)} | {rms(level):.2f} | {np.degrees(np.abs(level).max()):.2f} | '
          f'{np.sqrt((score[:, :2]**2).mean()):.2f} | {(np.abs(score[:, :2]) < 2).mean():.0%} | {known.sum()} | '
          f'{rms(yaw):.2f} | {np.degrees(np.abs(yaw).max()):.2f} | {np.sqrt((score[known, 2]**2).mean()):.2f} | '
          f'{(np.abs(score[known, 2]) < 2).mean():.0%} |')


def rms(angles) -> float:
    return float(np.degrees(np.sqrt((angles**2).mean())))


#: recording, topic of the fixes, and the axes that its README tells: rotation to forward-left-up, deg
MEASURED = (('longmont_rtk_drive/bag', '/gps/fix', (0, 0, 180)), ('karlsruhe_hills/bag', '/gps/fix', (0, 0, 0)),
            ('karlsruhe_hills/bag', '/reference/fix', (0, 0, 0)), ('incheon_square_ros2/bag', '/fix', (180, 0, 0)),
            ('incheon_park_ros2/bag_0.db3', '/fix', (0, 0, 0)), ('incheon_static_ros2/bag', '/gps/fix', (0, 0, 0)),
            ('kingston_span/bag', '/gps/fix', (0, 0, -90)), ('kingston_span/bag', '/reference/fix', (0, 0, -90)))


def turns() -> list[np.ndarray]:
    """The 24 right-angled rotations and 20 arbitrary ones."""
    right = [np.array([[sign[i] * (j == order[i]) for j in range(3)] for i in range(3)], float)
             for order in permutations(range(3)) for sign in product((1, -1), repeat=3)]
    return [matrix for matrix in right if np.linalg.det(matrix) > 0] + list(
        Rotation.random(20, random_state=15).as_matrix())


def turned(imu, rotation, acceleration=1.0, rate=1.0):
    """What the same IMU records when it is mounted otherwise, in other units."""
    return replace(imu, specific_force=imu.specific_force @ rotation.T * acceleration,
                   angular_rate=imu.angular_rate @ rotation.T * rate)


def one_turn(task):
    """Error of the mounting of a turned IMU in g and deg/s against what `straight` makes of it; whether units fit.

    The time offset is that of the recording as it is, which a rotation does not change: the search takes longest.
    """
    imu, fixes, straight, rotation = task
    imu = turned(imu, rotation, 1 / STANDARD_GRAVITY, 180 / np.pi)
    units = find_units(imu, fixes, STANDARD_GRAVITY)
    found = estimate_mounting(in_si(imu, units.acceleration, units.rate), fixes, lag=straight.lag)
    return deviation(found.rotation, straight.rotation @ rotation.T), (units.acceleration, units.rate) == ('g', 'deg/s')


def measured(data: Path):
    for name, topic, axes in MEASURED:
        recording = read_recording(data / name, '/imu/data', topic)
        imu, fixes = recording.imu, recording.gnss
        found = estimate_mounting(imu, fixes)
        angles, sigma = np.degrees(found.rpy), np.degrees(found.sigma)
        nominal = Rotation.from_euler('xyz', axes, degrees=True).as_matrix()
        away = np.degrees(deviation(found.rotation, nominal))
        errors, right = zip(*(one_turn((imu, fixes, found, rotation)) for rotation in turns()))
        errors = np.degrees(np.abs(errors))
        yaw = f'{angles[2]:.1f} ± {sigma[2]:.1f}' if found.yaw_known else 'not shown'
        lag = f'{found.lag:.3f} ± {found.lag_sigma:.3f}' if found.lag_sigma < 0.3 else 'not shown'
        worst_yaw = f'{errors[:, 2].max():.2f}' if found.yaw_known else '–'
        print(f'| {name.split("/")[0]}, {topic} | {angles[0]:.1f} ± {sigma[0]:.1f} | '
              f'{angles[1]:.1f} ± {sigma[1]:.1f} | {yaw} | {away[0]:.1f}, {away[1]:.1f}, {away[2]:.1f} | {lag} | '
              f'{errors[:, :2].max():.2f} | {worst_yaw} | {sum(right)} of {len(right)} |', flush=True)


def evidence(data: Path):
    """Attitude of a strapdown filter that is told the mounting but no constraint, against course and grade."""
    from mems_ins_fusion.filter.config import FilterConfig
    from mems_ins_fusion.filter.replay import run

    for name, topic, _ in MEASURED:
        recording = read_recording(data / name, '/imu/data', topic)
        found = estimate_mounting(recording.imu, recording.gnss)
        if not found.yaw_known:
            continue
        values = table.check({'mechanization': 'strapdown', 'imu.mounting_rpy': found.rpy.tolist(),
                              'gnss.time_offset': found.lag, 'gnss.robust_sigma': 3.0})
        result = run(FilterConfig.from_parameters(values), recording.imu, recording.gnss)
        time = (result.stamp - result.stamp[0]) * 1e-9
        steady = np.abs(np.gradient(np.unwrap(result.yaw), time)) < 0.03
        speed = np.hypot(result.velocity[:, 0], result.velocity[:, 1])
        used = steady & (speed > max(1.0, 0.5 * np.percentile(speed, 90))) & (time > 60.0)
        slip = wrap(np.arctan2(result.velocity[:, 1], result.velocity[:, 0]) - result.yaw)[used]
        stretches = [part.mean() for part in np.array_split(slip, max(len(slip) // 1000, 2))]
        print(f'{name}, {topic}: course minus heading of the filter {np.degrees(np.mean(stretches)):+.2f} +- '
              f'{np.degrees(np.std(stretches) / np.sqrt(len(stretches))):.2f} deg in {used.sum()} samples straight on')


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('what', choices=('simulated', 'measured', 'evidence'))
    parser.add_argument('data', nargs='?', type=Path, help='folder of the measured recordings')
    parser.add_argument('--drives', type=int, default=100)
    options = parser.parse_args()
    if options.what == 'simulated':
        simulated(options.drives)
    else:
        {'measured': measured, 'evidence': evidence}[options.what](options.data)


if __name__ == '__main__':
    main()
