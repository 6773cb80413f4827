"""Errors while fixes are withheld: the protocol of docs/metrics.md."""
from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..filter.config import FilterConfig
from ..filter.measurements.position import is_fix
from ..filter.runs.replay import Coasting, run_with_outages
from ..filter.runs.results import Run
from ..filter.runs.smoothing import smoothed_outages
from ..navigation.earth import radii
from ..samples import Aiding, Fixes, ImuSamples
from .metrics import NEES_95, Errors, Truth, position_errors, rms
from .verdict import Consistency

#: s for which the filter has run before the first outage
SETTLING = 30.0
#: largest number of outages; in longer recordings they begin further apart
MOST_OUTAGES = 500


@dataclass(frozen=True)
class Outages:
    """The outages of one filter and one duration, (o,) each.

    begin: ns, of the last fix used. max_error: m, the largest horizontal error. distance: m, driven in the outage.
    within: whether the error at the end (smoothed: in the middle) is inside the filter's own 95 % ellipse. time (g,): s
    after the begin; growth (o, g): horizontal error at these times, m; sigma (o, g): the filter's horizontal standard
    deviation, m. errors: of each outage. kept: m, the largest error of a prediction with the velocity at the begin,
    which needs no IMU. announced: s for which, by the trust horizon at the begin, the error stays below `horizon.limit`
    (NaN for smoothed outages, and where it was not asked for); crossed: s after which the error exceeded it, inf where
    it did not.
    """

    duration: float
    begin: np.ndarray
    max_error: np.ndarray
    distance: np.ndarray
    within: np.ndarray
    time: np.ndarray
    growth: np.ndarray
    sigma: np.ndarray
    errors: list[Errors]
    kept: np.ndarray
    announced: np.ndarray
    crossed: np.ndarray

    @property
    def apart(self) -> int:
        """Approximate number of outages that do not overlap: overlapping outages have common errors."""
        return len(np.unique((self.begin - self.begin[0]) // round(self.duration * 1e9))) if len(self.begin) else 0

    def select(self, index: np.ndarray) -> Outages:
        """Some of the outages; index: (o,) bool."""
        return Outages(self.duration, self.begin[index], self.max_error[index], self.distance[index],
                       self.within[index], self.time, self.growth[index], self.sigma[index],
                       [errors for errors, wanted in zip(self.errors, index) if wanted], self.kept[index],
                       self.announced[index], self.crossed[index])

    @property
    def consistency(self) -> Consistency:
        """The errors against the filter's own sigmas."""
        return Consistency(self.duration, np.array([e.nees.mean() for e in self.errors]), self.within, self.apart)


def outage_begins(first: int, fixes: Fixes, time_offset: float, spacing: float, shortest: float,
                  longest: float = 0.0) -> np.ndarray:
    """Begins of outages, (o,) ns of the IMU's clock: fixes about `spacing` s apart.

    They are counted from the first fix, so that they are the same for every filter, whenever it starts. If no outage of
    `longest` s would then end within the recording, they are counted from the first possible begin. first: ns, of the
    first estimate; the first outage begins SETTLING later at the earliest. shortest: s, the shortest duration; there
    must be fixes for this long after the last begin.
    """
    stamp = np.unique(fixes.stamp[is_fix(fixes)]) - round(time_offset * 1e9)
    possible = stamp[stamp >= first + round(SETTLING * 1e9)]
    if not len(possible):
        return possible
    begin = _spaced(stamp, spacing)
    begin = begin[begin >= possible[0]]
    if not len(begin) or begin[0] + round(longest * 1e9) > stamp[-1]:
        begin = _spaced(possible, spacing)
    return begin[begin <= stamp[-1] - round(shortest * 1e9)]


def _spaced(stamp: np.ndarray, spacing: float) -> np.ndarray:
    """The first one of `stamp` in each interval of `spacing` s that has any. If they are more than MOST_OUTAGES, every
    second, third ... of them."""
    _, index = np.unique(np.floor((stamp - stamp[0]) / (spacing * 1e9)), return_index=True)
    return stamp[index[::-(-len(index) // MOST_OUTAGES)]]


def run_outages(config: FilterConfig, imu: ImuSamples, fixes: Fixes, truth: Truth, durations, begin: np.ndarray,
                aiding: Aiding = Aiding(), keep: np.ndarray | None = None, longest: np.ndarray | None = None,
                announces: bool = True) -> list[Outages]:
    """The outages of each duration (s) that begin at `begin`, each the only one in its run.

    aiding: inputs besides the fixes. keep: IMU samples whose states are used, (n,) bool; they must surround the epochs
    of the truth. longest: s, of each begin (o,) the longest duration that is wanted; None: all. announces: as for
    `run_with_outages`.
    """
    run, coasting = run_with_outages(config, imu, fixes, begin, max(durations) if longest is None else longest, aiding,
                                     keep, announces=announces)
    return outages_of(run, coasting, truth, durations, config.imu.restart_gap)


def outages_of(run: Run, coasting: Coasting, truth: Truth, durations, longest_gap: float,
               judged: float = 1.0) -> list[Outages]:
    """The outages of each duration (s) in `coasting`, of those that are as long there; run: the ordinary run. judged:
    part of the duration at which `within` is evaluated (1: at the end)."""
    durations = sorted(durations)
    driven = Distance(run)
    rows = [slice(first, last) for first, last in zip(coasting.first[:-1], coasting.first[1:])]
    limit = coasting.run.config.parameters['horizon.limit']
    errors = [tuple(_errors(states, begin, truth, durations[-1], longest_gap)
                    for states in (coasting.run.states(mine), _kept(coasting.run.states(mine))))
              for mine, begin in zip(rows, coasting.begin)]
    return [_measure(duration, _fitting(duration, coasting, errors, truth, run), driven, judged, limit)
            for duration in durations]


def smooth_outages(config: FilterConfig, imu: ImuSamples, fixes: Fixes, truth: Truth, durations, begin: np.ndarray,
                   aiding: Aiding, keep: np.ndarray, run: Run) -> list[Outages]:
    """The same outages, smoothed with the fixes that come after them. run: the smoothed run with all fixes."""
    results = []
    for duration in sorted(durations):
        coasting = smoothed_outages(config, imu, fixes, begin, duration, aiding, keep)
        results += outages_of(run, coasting, truth, [duration], config.imu.restart_gap, 0.5)
    return results


def _fitting(duration: float, coasting: Coasting, errors: list[Errors], truth: Truth, run: Run):
    """Begin, announced time and errors of those outages that end before the recording does."""
    if not len(run.stamp):  # a filter that never starts
        return []
    length, last = round(duration * 1e9), min(truth.reference.stamp[-1] if len(truth) else 0, run.stamp[-1])
    return [(b, a, e) for b, d, a, e in zip(coasting.begin.tolist(), coasting.duration.tolist(),
                                            coasting.announced.tolist(), errors)
            if d >= duration and b + length <= last and (e[0].stamp <= b + length).any()]


def _kept(states: Run) -> Run:
    """`states` as if the vehicle had kept velocity and attitude of the first one."""
    if not len(states.stamp):
        return states
    seconds, (north, east) = (states.stamp - states.stamp[0]) * 1e-9, states.velocity[0, :2]
    meridian, prime_vertical = radii(states.latitude[0])
    cos = np.cos(states.latitude[0])
    attitude = {name: np.full_like(angle, angle[0]) for name in ('roll', 'pitch', 'yaw')
                for angle in (getattr(states, name),)}
    return replace(states, latitude=states.latitude[0] + north * seconds / (meridian + states.height[0]),
                   longitude=states.longitude[0] + east * seconds / ((prime_vertical + states.height[0]) * cos),
                   **attitude)


def _errors(run: Run, begin: int, truth: Truth, duration: float, longest_gap: float) -> Errors:
    stamp = truth.reference.stamp
    within = slice(np.searchsorted(stamp, begin, side='right'),
                   np.searchsorted(stamp, begin + round(duration * 1e9), side='right'))
    truth = truth.select(within)
    return position_errors(run, truth, np.zeros(len(truth), dtype=bool), longest_gap)


class Distance:
    """Distance driven by the speed of a run with fixes, m: positions with noise move at standstill, too."""

    def __init__(self, run: Run):
        self.stamp = run.stamp
        speed = np.hypot(*run.velocity[:, :2].T)
        step = np.minimum(np.diff(run.stamp) * 1e-9, 1.0)
        self.driven = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * step)])

    def at(self, stamp):
        """From the first estimate to `stamp`, ns."""
        return np.interp(stamp - self.stamp[0], self.stamp - self.stamp[0], self.driven)


def _measure(duration, fits, driven, judged: float, limit: float) -> Outages:
    length = round(duration * 1e9)
    time = np.linspace(0.0, duration, max(int(np.ceil(duration)), 2) + 1)[1:]
    maxima, distance, within, growth, sigma, kept, crossed = [], [], [], [], [], [], []
    fits = [(begin, announced, *(errors.select(errors.stamp <= begin + length) for errors in both))
            for begin, announced, both in fits]
    for begin, _, errors, without_imu in fits:
        kept.append(without_imu.horizontal.max())
        horizontal, after = errors.horizontal, (errors.stamp - begin) * 1e-9
        maxima.append(horizontal.max())
        crossed.append(np.min(after[horizontal > limit], initial=np.inf))
        distance.append(float(driven.at(begin + length) - driven.at(begin)))
        within.append(errors.nees[min(int(judged * len(errors)), len(errors) - 1)] < NEES_95)
        growth.append(np.interp(time, after, horizontal))
        sigma.append(np.interp(time, after, errors.sigma))
    shape = (len(fits), len(time))
    return Outages(duration, np.array([b for b, *_ in fits], dtype=np.int64), np.array(maxima), np.array(distance),
                   np.array(within, dtype=bool), time, np.reshape(growth, shape), np.reshape(sigma, shape),
                   [errors for _, _, errors, _ in fits], np.array(kept), np.array([a for _, a, *_ in fits]),
                   np.array(crossed))


def summary(outages: Outages) -> dict:
    """The numbers of the outages of one duration for `report.json`."""
    error = outages.max_error
    numbers = {'duration_s': outages.duration, 'count': len(error)}
    if not len(error):
        return {**numbers, **dict.fromkeys(('max_error_rms_m', 'max_error_mean_m', 'max_error_median_m',
                                            'max_error_p95_m', 'percent_of_distance', 'within_95_percent',
                                            'velocity_kept_mean_m', 'announced_s', 'crossed_s',
                                            'crossed_early_percent'))}
    distance = outages.distance.sum()
    return {**numbers, 'max_error_rms_m': rms(error), 'max_error_mean_m': float(error.mean()),
            'max_error_median_m': float(np.median(error)),
            'max_error_p95_m': float(np.percentile(error, 95)),
            'percent_of_distance': float(100 * error.sum() / distance) if distance > 1.0 else None,
            'within_95_percent': float(100 * outages.within.mean()),
            'velocity_kept_mean_m': float(outages.kept.mean()), **_horizon(outages)}


def _horizon(outages: Outages) -> dict:
    """Medians of the announced times and of the times at which the limit was exceeded; None where they are unknown, or
    most outages did not exceed it."""
    announced, crossed = float(np.median(outages.announced)), float(np.median(outages.crossed))
    known = not np.isnan(announced)
    return {'announced_s': announced if known else None, 'crossed_s': crossed if np.isfinite(crossed) else None,
            'crossed_early_percent': float(100 * np.mean(outages.crossed < outages.announced)) if known else None}
