"""Outages in which findings on trial are compared with the parameters that drive."""
from __future__ import annotations

import numpy as np

from ..evaluation.comparison import aiding_of, samples_to_keep, truth_of
from ..evaluation.metrics import Errors
from ..evaluation.outages import run_outages
from ..filter.config import FilterConfig
from ..samples import Recording

#: north and east, m
Place = tuple[float, float]
#: s before a chunk, for two filters to find their state in
SETTLING = 180.0
#: s without fixes: short ones are many, and show soon what moves the next fix; long ones what grows, and whether what
#: fits the next fix is true
OUTAGES = (1.0, 5.0, 10.0, 30.0)
#: part of an outage at whose end the fixes are compared with the prediction: their mean
JUDGED = 0.3
#: s before the end of a chunk at which its last outages end: fixes may be stamped that much before their time, which is
#: gnss.time_offset, and the filter has no samples beyond the chunk
EARLY = 1.0
#: m that have to be driven in an outage that says something
DRIVEN = 20.0
#: m/s, the same of a short one
SLOWEST = 4.0


def predicted(part: Recording, values: dict, chunk: Recording) -> dict[float, dict[int, tuple[Place, float]]]:
    """By duration and begin (ns, as fixes are stamped): how far the filter with `values` is from the fixes at the end
    of an outage, m, and the distance driven. What is judged is in `chunk`, at the end of `part`. Outages do not
    overlap."""
    delay = round(values['gnss.time_offset'] * 1e9)
    config, truth = FilterConfig.from_parameters(values), truth_of(part, values)
    keep = samples_to_keep(part.imu, truth.reference.stamp)
    longest: dict[int, float] = {}
    for duration in OUTAGES:  # ascending; a longer one begins where shorter ones begin, so that one run has them all
        longest |= dict.fromkeys(_begins(part, chunk, duration), duration)
    begin = np.array(sorted(longest), dtype=np.int64)
    outages = run_outages(config, part.imu, part.gnss, truth, OUTAGES, begin - delay, aiding_of(part), keep,
                          np.array([longest[b] for b in begin.tolist()]), announces=False)
    return {one.duration: {b + delay: (_misfit(errors, b + round((1.0 - JUDGED) * one.duration * 1e9)), distance) for
                           b, errors, distance in zip(one.begin.tolist(), one.errors, one.distance)}
            for one in outages}


def _begins(part: Recording, chunk: Recording, duration: float) -> list[int]:
    """Stamps of the fixes, ns, at which outages of `duration` s begin. They follow each other from EARLY before the
    begin of `chunk` to EARLY before its end. Fixes from before `chunk` are not judged."""
    stamp, length = np.unique(part.gnss.stamp), round(duration * 1e9)
    begin, end = (int(chunk.imu.stamp[i]) - round(EARLY * 1e9) for i in (0, -1))
    last, old = (stamp[np.maximum(np.searchsorted(stamp, time, side='right') - [1, 2], 0)] for time in (end, begin))
    # the interval from one fix to the next varies: an outage as long as a chunk begins one fix earlier if necessary
    wanted = np.arange(last[0] - length, old[1] - 1, -length)
    begins = stamp[np.maximum(np.searchsorted(stamp, wanted, side='right') - 1, 0)]
    return [b for b in begins.tolist() if b + (1.0 - JUDGED) * length >= chunk.gnss.stamp[0]]


class Predictions:
    """What filters with several parameters predict in the outages of `chunk`, at the end of `part`: of the same ones it
    is computed once."""

    def __init__(self, part: Recording, chunk: Recording):
        self._part, self._chunk = part, chunk
        self._known: list[tuple[dict, dict]] = []

    def of(self, values: dict) -> dict[float, dict[int, tuple[Place, float]]]:
        """As of `predicted`."""
        known = next((found for others, found in self._known if others == values), None)
        if known is None:
            known = predicted(self._part, values, self._chunk)
            self._known.append((values, known))
        return known


def _misfit(errors: Errors, begin: int) -> Place:
    """The mean error from `begin` on, ns; NaN where there is none."""
    late = errors.stamp >= begin
    return (float(errors.north[late].mean()), float(errors.east[late].mean())) if late.any() else (np.nan, np.nan)


def paired_errors(present: dict, other: dict) -> dict[float, list[tuple[Place, Place]]]:
    """By duration, the errors of the same outages of two filters in which the vehicle was driven."""
    found = {}
    for duration in OUTAGES:
        a, b, least = present[duration], other[duration], min(DRIVEN, SLOWEST * duration)
        both = [(a[begin][0], b[begin][0]) for begin in sorted(a.keys() & b.keys()) if a[begin][1] > least]
        found[duration] = [pair for pair in both if np.isfinite(sum(pair[0]) + sum(pair[1]))]
    return found


def has_estimate_alone(other: dict, present: dict) -> bool:
    """Whether only the first of two filters, as of `predicted`, has estimates: the other one has not started."""
    return any(other.values()) and not any(present.values())
