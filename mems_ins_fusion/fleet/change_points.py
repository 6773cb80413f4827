"""Changes of a vehicle between drives: change points in the estimates from single drives.

A series of estimates x_i with standard deviations s_i, in the order of time, is modelled as constant except for steps.
The s_i may be too small. So they are multiplied by a scale: the ratio of the differences between successive drives of
all vehicles to their expectation. It is computed as a median, on which the few differences with a step have little
effect. Each step is tested with Student's t, with the degrees of freedom of the scale, at a level divided by the number
of all places in all series (Bonferroni).

Source: binary segmentation, A. J. Scott, M. Knott, "A cluster analysis method for grouping means in the analysis of
variance", Biometrics 30, 1974.
"""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..navigation.frames import wrap

#: probability of any false change in a fleet without changes
LEVEL = 0.01
#: median of a chi-square variable with one degree of freedom
_MEDIAN = 0.4549364231195724
#: smallest number of differences between successive drives of all vehicles; with fewer no change is reported
FEWEST = 4
#: the same for a separate scale of one vehicle
FEWEST_OWN = 3
#: degrees of freedom of a scale by the median, for each difference: the median of squares is worth 37 % of their mean
#: (P. J. Huber, "Robust Statistics", 1981), and neighbouring differences share a drive
EFFICIENCY = 0.3


@dataclass(frozen=True)
class TrackedQuantity:
    """A quantity whose changes are looked for. unit: as shown to people; values in it are `scale` times those in SI.
    ratio: whether changes are factors. angle: whether it is periodic with 2 pi."""

    effect: str
    parameter: str
    words: str
    unit: str
    scale: float = 1.0
    ratio: bool = False
    angle: bool = False


#: the quantities whose changes are looked for, by effect and parameter as in the rows of `effects`
QUANTITIES = {(q.effect, q.parameter): q for q in (
    TrackedQuantity('gnss_time_offset', 'time_offset', 'time offset of the receiver', 's'),
    *(TrackedQuantity('mounting_rotation', name, f'{name} of the IMU\'s mounting', 'deg', 180 / math.pi, angle=True)
      for name in ('roll', 'pitch', 'yaw')),
    *(TrackedQuantity('gnss_lever_arm', axis, f'antenna ({way})', 'm')
      for axis, way in (('x', 'forward'), ('y', 'left'), ('z', 'up'))),
    *(TrackedQuantity(f'{sensor}_noise', 'density', f'noise of the {sensor}s', '%', ratio=True)
      for sensor in ('accelerometer', 'gyroscope')),
    TrackedQuantity('receiver', 'scatter', 'scatter of the receiver', '%', ratio=True))}


@dataclass(frozen=True)
class QuantityHistory:
    """Estimates of one quantity from the drives of one vehicle in the order of time: stamp (n,) ns, value and sigma
    (n,).

    Of a ratio value and sigma are those of the logarithm. source: the estimator; different ones are not mixed.
    """

    vehicle: str
    quantity: TrackedQuantity
    source: str
    stamp: np.ndarray
    value: np.ndarray
    sigma: np.ndarray

    def __len__(self) -> int:
        return len(self.stamp)


@dataclass(frozen=True)
class ChangePoint:
    """One step. last, first: ns, of the last drive before and the first drive after it. before, after: number of
    drives. step, sigma: in the unit of the quantity. p: probability of a step this large without a change, corrected
    for all places."""

    vehicle: str
    quantity: TrackedQuantity
    source: str
    last: int
    first: int
    drives: tuple[int, int]
    step: float
    sigma: float
    p: float

    def words(self) -> str:
        """The change in words."""
        q = self.quantity
        size = f'{abs(self.step):.2g} +- {self.sigma:.1g} {q.unit}'
        how = (f'{"up" if self.step > 0 else "down"} by {size}' if q.ratio else f'changed by {self.step:+.2g} +- '
               f'{self.sigma:.1g} {q.unit}')
        sure = '' if min(self.drives) > 1 else '; seen in one drive only'
        return f'{q.words}: {how} between {day(self.last)} and {day(self.first)}{sure}'


def day(stamp: int) -> str:
    """A time, ns, as a date."""
    return str(np.datetime64(int(stamp), 'ns').astype('datetime64[m]')).replace('T', ' ')


def series_of(rows: Sequence[dict]) -> list[QuantityHistory]:
    """The series in `rows` of estimates: vehicle, source, effect, parameter, value, sigma and stamp_ns."""
    found: dict[tuple, list] = {}
    for row in rows:
        quantity = QUANTITIES.get((row['effect'], row['parameter']))
        if quantity is not None and row['value'] is not None and row['stamp_ns'] is not None:
            found.setdefault((row['vehicle'], row['source'], quantity.effect, quantity.parameter), []).append(row)
    return [_one_series(QUANTITIES[key[2:]], rows) for key, rows in sorted(found.items())]


def _one_series(quantity: TrackedQuantity, rows: list[dict]) -> QuantityHistory:
    rows = sorted(rows, key=lambda row: (row['stamp_ns'], row['value']))
    value = np.array([row['value'] for row in rows], dtype=float)
    # without stated sigmas all drives have the same weight, and the scale gives their scatter
    sigma = np.array([row['sigma'] if row['sigma'] else math.nan for row in rows], dtype=float)
    if quantity.ratio:
        with np.errstate(divide='ignore', invalid='ignore'):
            sigma, value = sigma / value, np.log(value)
    if quantity.angle:
        value = value[0] + wrap(value - value[0])
    sigma = np.where(np.isfinite(sigma), sigma, 0.1)
    good = np.isfinite(value)
    return QuantityHistory(rows[0]['vehicle'], quantity, rows[0]['source'],
                           np.array([r['stamp_ns'] for r in rows])[good],
                           value[good], sigma[good])


def find_changes(series: Sequence[QuantityHistory]) -> list[ChangePoint]:
    """The changes in all series of a fleet."""
    places = sum(max(len(s) - 1, 0) for s in series)
    found = []
    for kind in dict.fromkeys((s.quantity, s.source) for s in series):
        same = [s for s in series if (s.quantity, s.source) == kind]
        scale, count = _scale(same)
        if count < FEWEST:
            continue
        for s in same:
            # a vehicle may scatter more than others: what its own drives say counts as soon as they are enough, without
            # the largest difference, which may be the step
            own, own_count = _scale([s], without=1)
            scaled = replace(s, sigma=(max(scale, own) if own_count >= FEWEST_OWN else scale) * s.sigma)
            found += [_change(scaled, *place) for place in _steps(scaled, 0, len(s), EFFICIENCY * count, places)]
    return sorted(found, key=lambda c: (c.vehicle, c.last, c.quantity.words))


def _scale(series: Sequence[QuantityHistory], without: int = 0) -> tuple[float, int]:
    """Ratio of the differences between successive drives to their expectation, at least 1, and the number of
    differences, `without` the largest ones.

    It is a median of squares, on which the few steps have little effect.
    """
    squares = np.concatenate([np.diff(s.value)**2 / (s.sigma[1:]**2 + s.sigma[:-1]**2) for s in series])
    squares = np.sort(squares)[:max(len(squares) - without, 0)]
    if not len(squares):
        return 1.0, 0
    return max(1.0, math.sqrt(float(np.median(squares)) / _MEDIAN)), len(squares)


def _steps(s: QuantityHistory, begin: int, end: int, freedom: float, places: int) -> list[tuple]:
    """(first, place, end, p) of the steps among the drives from `begin` to `end`, each with the constant parts around
    it."""
    if end - begin < 2:
        return []
    weight = 1.0 / s.sigma[begin:end]**2
    total, sums = np.cumsum(weight), np.cumsum(weight * s.value[begin:end])
    left, right = total[:-1], total[-1] - total[:-1]
    step = (sums[-1] - sums[:-1]) / right - sums[:-1] / left
    score = np.abs(step) / np.sqrt(1.0 / left + 1.0 / right)
    best = int(np.argmax(score))
    p = min(places * _two_sided(float(score[best]), freedom), 1.0)
    if p >= LEVEL:
        return []
    at = begin + best + 1
    before, after = _steps(s, begin, at, freedom, places), _steps(s, at, end, freedom, places)
    first = max((place for _, place, _, _ in before), default=begin)
    last = min((place for _, place, _, _ in after), default=end)
    return [*before, (first, at, last, p), *after]


def _two_sided(score: float, freedom: float) -> float:
    from scipy.stats import t

    return float(2.0 * t.sf(score, freedom))


def _change(s: QuantityHistory, first: int, at: int, last: int, p: float) -> ChangePoint:
    means, variances = zip(*(_mean(s, part) for part in (slice(first, at), slice(at, last))))
    step, sigma, q = means[1] - means[0], math.sqrt(sum(variances)), s.quantity
    if q.ratio:
        step, sigma = 100.0 * math.expm1(step), 100.0 * math.exp(step) * sigma
    return ChangePoint(s.vehicle, q, s.source, int(s.stamp[at - 1]), int(s.stamp[at]), (at - first, last - at),
                       q.scale * step, q.scale * sigma, p)


def _mean(s: QuantityHistory, part: slice) -> tuple[float, float]:
    weight = 1.0 / s.sigma[part]**2
    return float(weight @ s.value[part] / weight.sum()), float(1.0 / weight.sum())
