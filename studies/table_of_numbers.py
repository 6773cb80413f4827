"""The filter's numbers on short drives, to be held against `test/numbers.csv` whenever the filter is changed.

    python studies/table_of_numbers.py            prints what differs from the table
    python studies/table_of_numbers.py --write    writes the table anew

The drives are plain formulas with noise from numpy's seeded generator, not the simulator's: what moves a number here is
the filter, its alignment or what measures the errors.
"""
from __future__ import annotations

import argparse
import csv
import math
from pathlib import Path

import numpy as np

from mems_ins_fusion.evaluation.metrics import Truth, position_errors, summary
from mems_ins_fusion.evaluation.outages import outage_begins, run_outages
from mems_ins_fusion.evaluation.outages import summary as outage_summary
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs import replay
from mems_ins_fusion.navigation.earth import gravity, radii
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding, Fixes, Headings, ImuSamples, Reference, Speeds, Velocities

TABLE = Path(__file__).resolve().parents[1] / 'test' / 'numbers.csv'
EPOCH = 1_700_000_000 * 10**9
LATITUDE, LONGITUDE, HEIGHT = 0.84, 0.2, 480.0
EARTH_RATE = 7.292115e-5
RELATIVE, ABSOLUTE = 1e-9, 1e-11

#: what the cases begin with: the paper's filter
PAPER = {'mechanization': 'planar', 'vehicle.zero_velocity': False, 'vehicle.non_holonomic': False,
         'vehicle.tilt_sigma': 0.0, 'gnss.gate_probability': 1.0, 'gnss.adapt_sigma': False,
         'gnss.adapt_covariance': False, 'gnss.robust_sigma': 0.0, 'vehicle.learn_drift': False,
         'imu.adapt_noise': False,
         'vehicle.non_holonomic_sigma': 0.2, 'vehicle.non_holonomic_vertical_sigma': 0.2, 'imu.mounting_sigma': 0.0,
         'vehicle.rear_axle_sigma': 0.0}
CONSTRAINTS = {'vehicle.zero_velocity': True, 'vehicle.non_holonomic': True}
#: and the defaults
CAR = {name: table.defaults()[name] for name in PAPER}
AR2 = {'sensor_error_model': 'autoregressive'}
AR3 = {'sensor_error_model': 'autoregressive', 'accelerometer.autoregressive.coefficients': [-1.6, 0.5, 0.101],
       'gyroscope.autoregressive.coefficients': [-1.5, 0.4, 0.101], 'accelerometer.autoregressive.interval': 0.5}
ARM = [1.2, -0.7, 1.5]
#: case: (parameters, what is special about the recording)
CASES = {
    'planar_rw': ({'sensor_error_model': 'random_walk'}, {}),
    'planar_gm': ({}, {}),
    'planar_ar2': (AR2, {}),
    'planar_ar3': (AR3, {}),
    'planar_gm_open': ({'feedback': 'open'}, {}),
    'planar_constraints': (CONSTRAINTS, {}),
    'planar_late': ({}, {'delay': 0.9}),
    'planar_coloured': ({'gnss.coloured_noise.sigma': 1.0, 'gnss.coloured_noise.tau': 20.0}, {'coloured': 1.0}),
    'planar_time_offset': ({'gnss.time_offset': 0.23}, {'time_offset': 0.23}),
    'planar_robust': ({'gnss.robust_sigma': 2.0}, {'outliers': 30.0}),
    'planar_split': ({}, {'phase': 0.0073}),
    'planar_gap': ({}, {'gaps': ((50.0, 50.3), (70.0, 71.2))}),
    'strapdown_rw': ({'mechanization': 'strapdown', 'sensor_error_model': 'random_walk'}, {}),
    'strapdown_gm': ({'mechanization': 'strapdown'}, {}),
    'strapdown_ar2': ({'mechanization': 'strapdown', **AR2}, {}),
    'strapdown_gm_open': ({'mechanization': 'strapdown', 'feedback': 'open'}, {}),
    'strapdown_constraints': ({'mechanization': 'strapdown', **CONSTRAINTS}, {}),
    'strapdown_everything': ({'mechanization': 'strapdown', **AR3, **CONSTRAINTS, 'gnss.lever_arm': ARM,
                              'gnss.coloured_noise.sigma': 0.7, 'gnss.robust_sigma': 3.0},
                             {'delay': 0.9, 'coloured': 0.7, 'lever_arm': ARM, 'phase': 0.0073, 'outliers': 20.0,
                              'gaps': ((50.0, 50.3), (70.0, 71.2))}),
    'car': (CAR, {}),
    'car_outliers': (CAR, {'outliers': 30.0}),
    'car_late_gap': (CAR, {'delay': 0.9, 'gaps': ((50.0, 50.3), (70.0, 71.2))}),
    'strapdown_lever_arm': ({'mechanization': 'strapdown', 'gnss.lever_arm': ARM}, {'lever_arm': ARM}),
    'car_0.2_hz': (CAR, {'interval': 5.0}),
    'car_5_hz': (CAR, {'interval': 0.2}),
    'car_10_hz': (CAR, {'interval': 0.1}),
    'car_10_hz_gap': (CAR, {'interval': 0.1, 'gaps': ((50.0, 50.3), (70.0, 74.0))}),
    'car_speed': ({**CAR, 'speed_topic': '/speed'}, {'aiding': ('speed',)}),
    'car_velocity': ({**CAR, 'velocity_topic': '/velocity'}, {'aiding': ('velocity',)}),
    'car_heading': ({**CAR, 'heading_topic': '/heading'}, {'aiding': ('heading',)}),
    'car_10_hz_all': ({**CAR, 'speed_topic': '/speed', 'velocity_topic': '/velocity', 'heading_topic': '/heading'},
                      {'interval': 0.1, 'aiding': ('speed', 'velocity', 'heading')}),
    'planar_speed': ({**CONSTRAINTS, 'speed_topic': '/speed'}, {'aiding': ('speed',)}),
}
#: rates of the sensors besides, Hz, and their sigmas: m/s, m/s, rad
AIDING = {'speed': (20.0, 0.1), 'velocity': (5.0, 0.1), 'heading': (2.0, 0.02)}


def _ramp(t, begin, end):
    """From 0 to 1 between two times, smoothly."""
    return 0.5 - 0.5 * np.cos(math.pi * np.clip((t - begin) / (end - begin), 0.0, 1.0))


class Drive:
    """A level drive with bends and two standstills: time (k,) s, speed, yaw, velocity (k, 2), north, east (k,)."""

    def __init__(self, duration=150.0, rate=50.0):
        self.time = t = np.arange(round(duration * rate) + 1) / rate
        dt = 1.0 / rate
        self.speed = 12.0 * (_ramp(t, 20, 30) - _ramp(t, 85, 95) + _ramp(t, 103, 112)) * (1 + 0.2 * np.sin(0.3 * t))
        distance = np.concatenate([[0.0], np.cumsum(0.5 * dt * (self.speed[1:] + self.speed[:-1]))])
        self.yaw = 0.6 + 0.9 * np.sin(2 * math.pi * distance / 300.0) + distance / 150.0
        self.velocity = self.speed[:, None] * np.column_stack([np.cos(self.yaw), np.sin(self.yaw)])
        moved = np.concatenate([np.zeros((1, 2)), 0.5 * dt * (self.velocity[1:] + self.velocity[:-1])])
        self.north, self.east = np.cumsum(moved, axis=0).T
        meridian, prime_vertical = radii(LATITUDE)
        self.latitude = LATITUDE + self.north / (meridian + HEIGHT)
        self.longitude = LONGITUDE + self.east / ((prime_vertical + HEIGHT) * np.cos(self.latitude))

    def inertial(self, rotating_earth: bool):
        """Specific force and angular rate (k, 3) in body axes, means over the interval before each sample."""
        dt = np.diff(self.time)
        yaw, velocity = 0.5 * (self.yaw[1:] + self.yaw[:-1]), 0.5 * (self.velocity[1:] + self.velocity[:-1])
        v_n, v_e = velocity.T
        down = np.full(len(dt), -gravity(LATITUDE, HEIGHT))
        force = np.column_stack([np.diff(self.velocity, axis=0) / dt[:, None], down])
        rate = np.column_stack([0 * yaw, 0 * yaw, np.diff(self.yaw) / dt])
        if rotating_earth:
            meridian, prime_vertical = radii(LATITUDE)
            earth = EARTH_RATE * np.array([math.cos(LATITUDE), 0.0, -math.sin(LATITUDE)])
            transport = np.column_stack([v_e / (prime_vertical + HEIGHT), -v_n / (meridian + HEIGHT),
                                         -v_e * math.tan(LATITUDE) / (prime_vertical + HEIGHT)])
            force += np.cross(2 * earth + transport, np.column_stack([velocity, 0 * yaw]))
            rate += _to_body(yaw, earth + transport)
        return tuple(np.vstack([a[:1], a]) for a in (_to_body(yaw, force), rate))


def _to_body(yaw, vector):
    c, s = np.cos(yaw), np.sin(yaw)
    return np.column_stack([c * vector[:, 0] + s * vector[:, 1], c * vector[:, 1] - s * vector[:, 0], vector[:, 2]])


def _correlated(rng, shape, sigma, tau, dt):
    """First-order Gauss-Markov noise, (k, axes)."""
    decay, driving = math.exp(-dt / tau), rng.standard_normal(shape)
    driving[0] *= sigma
    driving[1:] *= sigma * math.sqrt(1 - decay**2)
    for k in range(1, len(driving)):
        driving[k] += decay * driving[k - 1]
    return driving


def recording(drive: Drive, seed: int, rotating_earth=False, delay=0.0, coloured=0.0, time_offset=0.0, outliers=0.0,
              phase=0.0, gaps=(), lever_arm=(0.0, 0.0, 0.0), sigma=1.5, interval=1.0) -> tuple[ImuSamples, Fixes]:
    """What sensors forward-left-up and a receiver would have delivered.

    delay: s, the latest that a fix arrives after its stamp. coloured: m, of the receiver's slow error. outliers: m,
    added to every ninth fix. phase: s, of the fixes' stamps after the samples'. gaps: s, in the IMU's samples.
    lever_arm: forward-left-up, m. interval: s between fixes.
    """
    rng = np.random.default_rng(seed)
    t, dt = drive.time, drive.time[1] - drive.time[0]
    force, rate = drive.inertial(rotating_earth)
    force = force + _correlated(rng, force.shape, 0.05, 300.0, dt) + 0.01 / math.sqrt(dt) * rng.standard_normal(
        force.shape)
    rate = rate + _correlated(rng, rate.shape, 1e-3, 300.0, dt) + 3e-4 / math.sqrt(dt) * rng.standard_normal(rate.shape)
    stamp = EPOCH + np.round(t * 1e9).astype(np.int64)
    kept = np.ones(len(t), dtype=bool)
    for begin, end in gaps:
        kept &= (t <= begin) | (t >= end)
    flu = np.array([1.0, -1.0, -1.0])
    imu = ImuSamples(stamp[kept], stamp[kept], force[kept] * flu, rate[kept] * flu)

    at = np.arange(0.0, t[-1] - 0.5, interval) + phase
    yaw = np.interp(at, t, drive.yaw)
    arm_x, arm_y, arm_z = np.array(lever_arm) * flu
    noise = sigma * rng.standard_normal((len(at), 3)) + _correlated(rng, (len(at), 3), coloured, 20.0, interval)
    noise[40::9, 0] += outliers
    noise += np.column_stack([np.cos(yaw) * arm_x - np.sin(yaw) * arm_y, np.sin(yaw) * arm_x + np.cos(yaw) * arm_y,
                              np.full(len(at), arm_z)])
    meridian, prime_vertical = radii(LATITUDE)
    latitude, longitude = (np.interp(at, t, values) for values in (drive.latitude, drive.longitude))
    stamped = EPOCH + np.round((at + time_offset) * 1e9).astype(np.int64)
    received = EPOCH + np.round((at + 1e-3 + delay * rng.random(len(at))) * 1e9).astype(np.int64)
    order = np.argsort(received, kind='stable')
    fixes = Fixes(stamped, received, latitude + noise[:, 0] / (meridian + HEIGHT),
                  longitude + noise[:, 1] / ((prime_vertical + HEIGHT) * np.cos(latitude)), HEIGHT - noise[:, 2],
                  np.tile(sigma**2 * np.eye(3), (len(at), 1, 1)), np.zeros(len(at), np.int8),
                  np.full(len(at), 2, np.uint8))
    return imu, fixes.select(order)


def aided(drive: Drive, seed: int, names: tuple[str, ...]) -> Aiding:
    """What the sensors `names` of AIDING would have delivered: wheel speed, velocity (Doppler), heading."""
    rng, made = np.random.default_rng([seed, 1]), {}
    for name in names:
        rate, sigma = AIDING[name]
        at = np.arange(0.0, drive.time[-1] - 0.5, 1.0 / rate) + 0.003
        stamp = EPOCH + np.round(at * 1e9).astype(np.int64)
        noise, variance = sigma * rng.standard_normal((len(at), 3)), np.full(len(at), sigma**2)
        speed, yaw = np.interp(at, drive.time, drive.speed), np.interp(at, drive.time, drive.yaw)
        if name == 'speed':
            made[name] = Speeds(stamp, stamp, speed + noise[:, 0], variance)
        elif name == 'velocity':
            level = np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw), 0 * yaw])
            made[name] = Velocities(stamp, stamp, level + noise, variance[:, None, None] * np.eye(3))
        else:
            made[name] = Headings(stamp, stamp, yaw + noise[:, 0], variance)
    return Aiding(**made)


def truth_of(drive: Drive) -> Truth:
    """Where the IMU was, ten times a second."""
    step = slice(0, None, max(1, round(0.1 / (drive.time[1] - drive.time[0]))))
    stamp = EPOCH + np.round(drive.time[step] * 1e9).astype(np.int64)
    velocity = np.column_stack([drive.velocity[step], 0 * drive.speed[step]])
    reference = Reference(stamp, drive.latitude[step], drive.longitude[step], np.full(len(stamp), HEIGHT), velocity,
                          drive.yaw[step])
    return Truth(reference, np.zeros(3), np.zeros(len(stamp)), 'the formula')


def numbers_of(name: str) -> dict[str, float]:
    """The numbers of one case."""
    (values, special), seed = CASES[name], list(CASES).index(name)
    special = dict(special)
    drive = Drive()
    config = FilterConfig.from_parameters(table.check({**PAPER, **values}))
    aiding = aided(drive, seed, special.pop('aiding', ()))
    imu, fixes = recording(drive, seed, values.get('mechanization') == 'strapdown', **special)
    truth = truth_of(drive)
    run = replay.run(config, imu, fixes, aiding)
    errors = summary(position_errors(run, truth, np.zeros(len(truth), dtype=bool)))
    numbers = {key: errors[key] for key in ('horizontal_rmse_m', 'horizontal_p95_m', 'heading_rmse_deg',
                                            'speed_rmse_mps', 'within_95_percent')}
    numbers['fixes_used'] = len(run.innovations.nis)
    numbers['nis_mean'] = run.innovations.nis.mean()
    numbers['yaw_end'] = run.yaw[-1]
    layout = config.layout
    for i, state in enumerate(layout.names[:layout.n_navigation]):
        numbers[f'sigma_{state}_end'] = run.sigma[-1, i]
    for i, channel in enumerate(layout.channels):
        numbers[f'error_{channel}_end'] = run.sensor_errors[-1, i]
        numbers[f'sigma_{channel}_end'] = run.sigma[-1, layout.n_navigation + i * layout.order]
    begin = outage_begins(int(run.stamp[0]), fixes.select(np.argsort(fixes.stamp)), config.gnss.time_offset,
                          15.0, 10.0)
    for outages in run_outages(config, imu, fixes, truth, [10.0, 30.0], begin, aiding):
        row = outage_summary(outages)
        for key in ('count', 'max_error_rms_m', 'max_error_p95_m', 'within_95_percent'):
            numbers[f'outage_{outages.duration:.0f}_s_{key}'] = row[key]
    return {key: float(value) for key, value in numbers.items()}


def computed() -> list[tuple[str, str, float]]:
    """Case, quantity and value of all cases."""
    return [(name, quantity, value) for name in CASES for quantity, value in numbers_of(name).items()]


def written() -> dict[tuple[str, str], float]:
    """The table in the repository."""
    with open(TABLE, newline='') as file:
        return {(row['case'], row['quantity']): float(row['value']) for row in csv.DictReader(file)}


def differences(old: dict[tuple[str, str], float], new: list[tuple[str, str, float]]) -> list[str]:
    """One line for each number that is not the table's: case, quantity, old, new."""
    lines = []
    for case, quantity, value in new:
        before = old.get((case, quantity), math.nan)
        if not math.isclose(before, value, rel_tol=RELATIVE, abs_tol=ABSOLUTE):
            lines.append(f'{case:24s} {quantity:32s} {before:.12g} -> {value:.12g}')
    missing = old.keys() - {(case, quantity) for case, quantity, _ in new}
    return lines + [f'{case:24s} {quantity:32s} {old[case, quantity]:.12g} -> none' for case, quantity in
                    sorted(missing)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--write', action='store_true', help='write the table anew')
    arguments = parser.parse_args()
    new = computed()
    print('\n'.join(differences(written() if TABLE.exists() else {}, new)) or 'no difference')
    if arguments.write:
        with open(TABLE, 'w', newline='') as file:
            writer = csv.writer(file, lineterminator='\n')
            writer.writerow(('case', 'quantity', 'value'))
            writer.writerows((case, quantity, f'{value:.12g}') for case, quantity, value in new)


if __name__ == '__main__':
    main()
