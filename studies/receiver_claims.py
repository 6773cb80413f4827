"""What the filter makes of receivers that claim another sigma than their own: realistic drives, parameters at defaults.

    python studies/receiver_claims.py [--seeds 3] [--first-seed 1000] [--minutes 20] [--processes 2] [--output FILE.md]

The drives of studies/vehicle.py, fixes that scatter by 1.5 m. Each row is a rate and by how much the claim is larger
than the scatter: RMSE and largest error from the first estimate on, both also as a multiple of those with the right
claim at that rate, and how often the 95 % ellipse held the truth. In the rows *wanders* an error of 2 m with a
correlation time of 60 s, of which the receiver says nothing, comes on top; *early* are fixes stamped 0.8 s before
their time. *Slow*: 2 m with that correlation time and 0.3 m of white noise, both claimed; *scatter k times*: for two
minutes in the middle, as among houses, with the claim as before; errors of that time only. Of both, in place of
`x right` are multiples of the errors of the fixes.
"""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import over_drives
from vehicle import drive_of, simulated

from mems_ins_fusion.evaluation.comparison import truth_of
from mems_ins_fusion.evaluation.metrics import NEES_95, position_errors, rms
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.navigation.earth import radii
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.simulation import GnssNoise

RATES = (0.2, 1.0, 5.0, 10.0)
CLAIMS = (1.0, 1 / 3, 1 / 10, 1 / 75, 3.0, 10.0)
SCATTER = 1.5  # m
FASTEST = 10.0  # Hz: the others are every so many fixes of that
EARLY = 0.8  # s
TIMES, HOUSES = (3.0, 6.0, 20.0), 120.0  # times SCATTER, for so long, s
SLOW = {f'slow, {tau:g} s': tau for tau in (60.0, 300.0, 1000.0)}  # s, correlation times
SLOW_SIGMA, SLOW_WHITE = 2.0, 0.3  # m, of these errors and of the noise beside them
RECEIVERS = {'white': GnssNoise(SCATTER, rate=FASTEST),
             'wanders': GnssNoise(SCATTER, rate=FASTEST, coloured_sigma=2.0, coloured_tau=60.0),
             **{name: GnssNoise(SLOW_WHITE, rate=FASTEST, coloured_sigma=SLOW_SIGMA, coloured_tau=tau)
                for name, tau in SLOW.items()}}


@dataclass(frozen=True)
class Outcome:
    """Errors of one drive: error (m,) m, inside (m,) the 95 % ellipse; both empty where the filter did not start."""

    error: np.ndarray
    inside: np.ndarray
    fixes: tuple[float, float] = (np.nan, np.nan)  # RMSE and largest error of the fixes, m, where they are the measure


def recordings(seed: int, minutes: float) -> dict[str, Recording]:
    """One drive as each of RECEIVERS records it at FASTEST."""
    drive = drive_of(seed, minutes)
    return {name: simulated(seed, minutes, noise, drive) for name, noise in RECEIVERS.items()}


def with_claim(recording: Recording, rate: float, claim: float) -> Recording:
    """Its fixes at `rate`, Hz, claiming `claim` times SCATTER."""
    gnss = recording.gnss.select(slice(None, None, round(FASTEST / rate)))
    factor = (claim * SCATTER) ** 2 / gnss.covariance[0, 0, 0]
    return replace(recording, gnss=replace(gnss, covariance=factor * gnss.covariance))


def early(recording: Recording) -> Recording:
    """Its fixes stamped EARLY."""
    return replace(recording, gnss=replace(recording.gnss, stamp=recording.gnss.stamp - round(EARLY * 1e9)))


def among_houses(recording: Recording, times: float) -> Outcome:
    """With fixes that scatter `times` as much as they claim for HOUSES in the middle."""
    gnss = recording.gnss
    middle = (recording.imu.stamp[0] + recording.imu.stamp[-1]) // 2
    inside = np.abs(gnss.stamp - middle) < round(0.5e9 * HOUSES)
    north, east = (np.random.default_rng(0).standard_normal((2, len(gnss.stamp)))
                   * SCATTER * np.sqrt(times**2 - 1.0) * inside)
    meridian, prime_vertical = radii(gnss.latitude)
    moved = replace(gnss, latitude=gnss.latitude + north / meridian,
                    longitude=gnss.longitude + east / (prime_vertical * np.cos(gnss.latitude)))
    off = times / np.sqrt(times**2 - 1.0) * np.hypot(north, east)[inside]
    return replace(outcome(replace(recording, gnss=moved), middle), fixes=(rms(off), off.max()))


def slow(recording: Recording, rate: float) -> Outcome:
    """Of a receiver of SLOW, which claims what it has."""
    claiming = with_claim(recording, rate, np.hypot(SLOW_SIGMA, SLOW_WHITE) / SCATTER)
    gnss, truth = claiming.gnss, claiming.reference
    meridian, prime_vertical = radii(gnss.latitude)
    off = np.hypot(meridian * (gnss.latitude - np.interp(gnss.stamp, truth.stamp, truth.latitude)),
                   prime_vertical * np.cos(gnss.latitude)
                   * (gnss.longitude - np.interp(gnss.stamp, truth.stamp, truth.longitude)))
    return replace(outcome(claiming), fixes=(rms(off), off.max()))


def outcome(recording: Recording, middle: int | None = None) -> Outcome:
    """Of the whole drive, or within HOUSES about `middle`, ns."""
    values = table.check({'reference_lever_arm': [0.0, 0.0, 0.0]})
    truth = truth_of(recording, values)
    result = run(FilterConfig.from_parameters(values), recording.imu, recording.gnss)
    if not len(result.stamp):
        return Outcome(np.empty(0), np.empty(0))
    errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
    judged = slice(None) if middle is None else np.abs(errors.stamp - middle) < round(0.5e9 * HOUSES)
    return Outcome(errors.horizontal[judged], (errors.nees < NEES_95)[judged])


def of_recordings(found: dict[str, Recording], rates=RATES, claims=CLAIMS):
    """((rate, what is special), outcome) of one drive."""
    results = []
    for rate in rates:
        results += [((rate, f'claims {claim:.3g} of it'), outcome(with_claim(found['white'], rate, claim)))
                    for claim in claims]
        results += [((rate, 'wanders'), outcome(with_claim(found['wanders'], rate, 1.0))),
                    ((rate, 'early'), outcome(early(with_claim(found['white'], rate, 1.0))))]
        results += [((rate, name), slow(found[name], rate)) for name in SLOW]
        results += [((rate, f'scatter {times:g} times'), among_houses(with_claim(found['white'], rate, 1.0), times))
                    for times in TIMES]
    return results


def of_drive(seed: int, minutes: float):
    return of_recordings(recordings(seed, minutes))


def lines(results: dict, drives: int):
    """The table. results: by (rate, what is special) the outcomes of each drive."""
    yield f'| {drives} drives | fixes | RMSE, m | x right | largest, m | x right | in 95 % | of the worst drive |'
    yield '|---|---|---|---|---|---|---|---|'
    for (rate, special), found in results.items():
        rmse, largest = _size(found)
        right = _size(results[(rate, 'claims 1 of it')])
        if special.startswith(('scatter', 'slow')):
            right = rms(np.array([o.fixes[0] for o in found])), max(o.fixes[1] for o in found)
        held = [100 * o.inside.mean() if len(o.inside) else 0.0 for o in found]
        yield (f'| {rate:g} Hz | {special} | {rmse:.2f} | {rmse / right[0]:.2f} | {largest:.1f} | '
               f'{largest / right[1]:.1f} | {np.mean(held):.0f} % | {min(held):.0f} % |')


def _size(found) -> tuple[float, float]:
    """RMSE and largest error of all drives, m; infinite where the filter did not start in one."""
    if not all(len(o.error) for o in found):
        return np.inf, np.inf
    return rms(np.concatenate([o.error for o in found])), max(o.error.max() for o in found)


if __name__ == '__main__':
    over_drives.main(__doc__, of_drive, lines, seeds=3)
