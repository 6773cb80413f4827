"""Noise levels for the user's filter, chosen by its predictions over one second to a minute.

The likelihood of the innovations alone may be highest with a noise level of the sensors that is too high and one of the
receiver that is too low. The filter then follows each fix, and its predictions are useless after a minute. So levels
are chosen by predictions over all horizons, all with the same weight, and each part of the drive is judged with the
levels that the other parts have chosen.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .measured import MeasuredErrors
from .noise import LARGEST_FACTOR, MODEL_NOISE, ONLY_LARGER, scaled

STEP = float(np.sqrt(10.0))  # ratio of successive factors that are tried
#: smallest gain in log likelihood of one horizon for each step of a level: a smaller one is not worth a change
WORTH = 3.0
SWEEPS = 2  # number of passes over all levels
MOST_STEPS = round(np.log(LARGEST_FACTOR) / np.log(STEP))  # largest number of steps, to LARGEST_FACTOR
STEPS = dict.fromkeys(ONLY_LARGER, (0, 1))  # smallest and largest number, where that is another one


@dataclass(frozen=True)
class NoiseLevels:
    """Factors on noise levels, by name. by_part: for each part, the factors that the other parts choose."""

    factors: dict[str, float]
    by_part: list[dict[str, float]]


def multiplied(values: dict, factors: dict[str, float], claimed: float) -> dict:
    """`values` multiplied by `factors` (by name). claimed: m, sigma of a fix if gnss.sigma is 0 (from the messages)."""
    for name, factor in factors.items():
        if factor != 1.0:
            if name == 'gnss.sigma' and not values[name]:
                values = {**values, name: claimed}
            values = scaled(values, name, factor)
    return values


def adjustable(values: dict) -> list[str]:
    """Names of the noise levels of a filter with `values` that may be changed."""
    model = MODEL_NOISE[values['sensor_error_model']]
    names = [f'{sensor}.{part}' for sensor in ('gyroscope', 'accelerometer') for part in ('noise_density', model)]
    if values['vehicle.non_holonomic']:
        names.append('vehicle.non_holonomic_sigma')
    return names if learns_scatter(values) else ['gnss.sigma', *names]


def learns_scatter(values: dict) -> bool:
    """Whether a filter with `values` learns from the fixes how they scatter."""
    return values['gnss.adapt_sigma'] and values['mechanization'] == 'strapdown'


def choose(values: dict, errors: Callable[[Sequence[dict]], list[MeasuredErrors]], part_of: Callable, count: int,
           claimed: float, start: dict[str, float] | None = None) -> NoiseLevels:
    """The levels that predict best. The search begins at the configured levels, or at `start` if these are better, and
    moves one level after the other up or down as long as predictions become better.

    errors: measures the filters of several parameter sets. part_of: the part, 0 to count - 1, of stamps (k,) ns.
    claimed: as for `multiplied`.
    """
    names = adjustable(values)
    tried: dict[tuple[int, ...], np.ndarray] = {}

    def merits(points):
        new = [p for p in dict.fromkeys(points) if p not in tried]
        found = errors([multiplied(values, _factors(names, p), claimed) for p in new])
        for point, measured in zip(new, found):
            tried[point] = _merit(measured, part_of, count) - WORTH * np.abs(point).sum() / predictions(measured)
        return [tried[p][-1] for p in points]

    begins = [tuple(0 for _ in names)]
    if start:
        begins.append(tuple(round(np.log(start.get(name, 1.0)) / np.log(STEP)) for name in names))
    merits(begins)
    best = max(begins, key=lambda point: tried[point][-1])
    for _ in range(SWEEPS):
        before = best
        for i in range(len(names)):
            best = _along(best, i, STEPS.get(names[i], (-MOST_STEPS, MOST_STEPS)), merits, tried)
        if best == before:
            break
    points = list(tried)
    table = np.array([tried[p] for p in points])
    chosen = [points[k] for k in np.argmax(table, axis=0)]
    return NoiseLevels(_factors(names, chosen[-1]), [_factors(names, p) for p in chosen[:-1]])


def _along(best, i, limits: tuple[int, int], merits, tried):
    """The best point on the line through `best` along axis i: steps as long as they help, up or down, to `limits`."""

    def moved(by):
        return (*best[:i], best[i] + by, *best[i + 1:])

    def allowed(by):
        return limits[0] <= best[i] + by <= limits[1]

    steps = [by for by in (1, -1) if allowed(by)]
    found = merits([moved(by) for by in steps])
    here = tried[best][-1]
    if max(found) <= here:
        return best
    by = steps[int(np.argmax(found))]
    best = moved(by)
    while allowed(by) and merits([moved(by)])[0] > tried[best][-1]:
        best = moved(by)
    return best


def predictions(measured: MeasuredErrors) -> int:
    """Number of independent predictions: outages that begin at the same fix count once, whatever their durations."""
    return max([1, *(o.apart for o in measured.outages)])


def _factors(names, point) -> dict[str, float]:
    return {name: round(STEP**k, 2) if k >= 0 else round(STEP**k, 3) for name, k in zip(names, point)}


def _merit(measured: MeasuredErrors, part_of, count: int) -> np.ndarray:
    """Mean over the horizons of the mean log likelihood, (count + 1,): without each of the parts, and of all data."""
    total = np.zeros(count + 1)
    for stamp, score in measured.scores():
        part = part_of(stamp)
        for k in range(count + 1):
            mine = score[part != k]
            total[k] += mine.mean() if len(mine) else score.mean()
    return total / max(len(measured.scores()), 1)
