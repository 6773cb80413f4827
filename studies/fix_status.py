"""A receiver whose fixes come in two kinds in turn: with a base, 0.02 m (status 2), and without one, 2 m (status 0).

    python studies/fix_status.py [--seeds 2]

REALISTIC drives of 12 minutes (studies/vehicle.py), a minute of each kind in turn, at 1 and 10 Hz. *White*: errors of
status 0 from fix to fix; *lasting*: first-order Gauss-Markov of 20 s. Claims, m, of status 2 and 0. From 90 s on: RMSE
in the minutes of either status, behind the first 10 s of it, too, and how often the 95 % ellipse held the truth.
"""
from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from vehicle import drive_of, simulated

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95, position_errors, rms
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.parameters import table
from mems_ins_fusion.simulation.simulation import GnssNoise

#: m, by status
TRUE = {2: 0.02, 0: 2.0}
CLAIMS = ({2: 0.02, 0: 2.0}, {2: 0.02, 0: 0.5}, {2: 0.5, 0: 0.5}, {2: 1.0, 0: 1.0})
#: s of each status in turn, time constant of lasting errors, s, and length of a drive, minutes
BLOCK, LASTING, MINUTES = 60.0, 20.0, 12.0


def received(fixes, rate: float, claims: dict, lasting: bool, seed: int):
    """`fixes` without errors at 10 Hz as such a receiver has them, at `rate`."""
    fixes, rng = fixes.select(slice(None, None, round(10 / rate))), np.random.default_rng(seed)
    t = (fixes.stamp - fixes.stamp[0]) * 1e-9
    status = np.where((t // BLOCK) % 2 == 0, 2, 0).astype(np.int8)
    white = rng.standard_normal((2, len(t), 2))
    keep = np.exp(-1.0 / rate / LASTING) if lasting else 0.0
    slow = white[1].copy()
    for i in range(1, len(t)):
        slow[i] = keep * slow[i - 1] + np.sqrt(1.0 - keep**2) * white[1, i]
    error = np.where((status == 2)[:, None], TRUE[2] * white[0], TRUE[0] * slow)
    meridian, normal = radii(fixes.latitude)
    claimed = np.where(status == 2, claims[2], claims[0])
    return replace(fixes, latitude=fixes.latitude + error[:, 0] / meridian,
                   longitude=fixes.longitude + error[:, 1] / (normal * np.cos(fixes.latitude)), status=status,
                   covariance=claimed[:, None, None] ** 2 * np.diag([1.0, 1.0, 2.25]))


def judged(recording, fixes) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Errors, m, and whether they were in the ellipse, by status and by time since it began."""
    config = FilterConfig.from_parameters(table.check({}))
    truth = truth_of(recording, config.parameters)
    errors = position_errors(run(config, recording.imu, fixes), truth, np.zeros(len(truth), dtype=bool))
    t = (errors.stamp - fixes.stamp[0]) * 1e-9
    status = fixes.status[np.clip(np.searchsorted(fixes.stamp, errors.stamp, side='right') - 1, 0, None)]
    inside, settled = errors.nees < NEES_95, t > 90.0
    parts = {'2': settled & (status == 2), '2 later': settled & (status == 2) & (t % BLOCK > 10.0),
             '0': settled & (status == 0)}
    return {name: (errors.horizontal[part], inside[part]) for name, part in parts.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=2)
    options = parser.parse_args()
    drives = {seed: simulated(seed, MINUTES, GnssNoise(1e-3, rate=10.0), drive_of(seed, MINUTES))
              for seed in range(1, options.seeds + 1)}
    print('| errors | Hz | claims | with a base, m | behind 10 s of it | ellipse | without, m | ellipse |')
    print(f'|{"---|" * 8}')
    for lasting in (False, True):
        for rate in (1.0, 10.0):
            for claims in CLAIMS:
                found = [judged(drive, received(drive.gnss, rate, claims, lasting, seed))
                         for seed, drive in drives.items()]
                cell = {name: (rms(np.concatenate([f[name][0] for f in found])),
                               np.mean(np.concatenate([f[name][1] for f in found]))) for name in found[0]}
                print(f"| {'lasting' if lasting else 'white'} | {rate:g} | {claims[2]:g}, {claims[0]:g} | "
                      f"{cell['2'][0]:.3f} | {cell['2 later'][0]:.3f} | {cell['2'][1]:.0%} | {cell['0'][0]:.2f} | "
                      f"{cell['0'][1]:.0%} |", flush=True)


if __name__ == '__main__':
    main()
