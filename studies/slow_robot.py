"""What a magnetometer is worth to a robot at 0.4 m/s: when it starts, and how well its heading is known then.

    python studies/slow_robot.py [--seeds 12] [--minutes 5]

Simulated robots that drive straight on, turn and turn on the spot, with fixes of 1.5 m each second and without
standstills (vehicle.zero_velocity off, as a robot that is so slow stands by its accelerometers): alone; with a
magnetometer whose hard iron is 15 uT along each axis, which nobody has measured; and with iron beside the way, 5 uT
every 100 m. Heading of the body, from a minute after the start on.
"""
from __future__ import annotations

import argparse

import numpy as np

from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.manoeuvres import SLOW
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

CASES = {'without': ({}, 0.0), 'magnetometer': ({'magnetometer_topic': '/mag'}, 0.0),
         'and iron beside the way': ({'magnetometer_topic': '/mag'}, 5e-6)}
SETTLED = 60 * 10**9  # ns


def driven(seed: int, minutes: float, values: dict, beside: float):
    """Seconds until the start, and error and sigma of the heading from then on, deg; None where there is no start."""
    drive = simulate_drive(60.0 * minutes, seed, 50.0, standstill=10.0, manoeuvres=SLOW, grade=0.03, bank=0.03)
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    recording = simulate_recording(drive, sensors, GnssNoise(1.5, 1.0), seed=seed, aiding=SimulatedAiding(
        magnetometer_rate=20.0, magnetometer_disturbance=beside)).recording
    config = FilterConfig.from_parameters(table.check({'vehicle.zero_velocity': False, **values}))
    samples = Aiding(magnetometer=recording.others['magnetometer']) if values else Aiding()
    result = run(config, recording.imu, recording.gnss, samples)
    if not len(result.stamp):
        return None
    yaw = np.interp(result.stamp, recording.reference.stamp, np.unwrap(recording.reference.yaw))
    late = result.stamp > result.stamp[0] + SETTLED
    error = np.degrees(np.angle(np.exp(1j * (result.yaw - yaw))))
    sigma = np.degrees(result.sigma[:, config.layout.index('phi_d')])
    return (result.stamp[0] - recording.imu.stamp[0]) * 1e-9, error[late], sigma[late]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=12)
    parser.add_argument('--minutes', type=float, default=5.0)
    options = parser.parse_args()
    print('| | started | after, s: median, largest | RMS, deg: median, largest | within two sigma |')
    print('|---|---|---|---|---|')
    for name, (values, beside) in CASES.items():
        all_of = [driven(seed, options.minutes, values, beside) for seed in range(1, options.seeds + 1)]
        found = [one for one in all_of if one is not None and len(one[1])]
        begin, rms = [one[0] for one in found], [float(np.sqrt(np.mean(one[1] ** 2))) for one in found]
        within = np.mean([np.mean(np.abs(error) < 2.0 * sigma) for _, error, sigma in found])
        print(f'| {name} | {len(found)} of {options.seeds} | {np.median(begin):.0f}, {max(begin):.0f} | '
              f'{np.median(rms):.1f}, {max(rms):.1f} | {within:.0%} |', flush=True)


if __name__ == '__main__':
    main()
