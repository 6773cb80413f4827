"""Estimates that are impossible for a vehicle: they are reported with their usual cause, and never added."""
from __future__ import annotations

from collections.abc import Mapping

from ..effects.registry import effect_called
from .estimate import Estimate

#: parameters that recordings show without a filter, too: how, in words, and the smallest difference that counts. The
#: lag of receivers that smooth over a second appears too small in the track, by up to 0.8 s^2 beyond its sigma
_SHOWN = {'gyroscope_scale.z': ('the angle of the course shows a scale', 0.05),
          'gnss_lag.lag': ('the track between fixes shows a lag', 2.0)}
#: the same for the time offset of an input. A vague value does not contradict an estimate
_CLOCK_SHOWN = 'its stamps beside the IMU or the fixes show an offset', 0.05
_CONTRADICTED = 4.0  # number of sigmas by which two values of one quantity contradict each other


def implausible(effect: str, parameters: Mapping[str, Estimate], shown: Mapping[str, Estimate] | None = None) -> str:
    """In words, why these sizes of an effect are impossible, and their usual cause; empty if they are possible.

    shown: values that the recordings show without a filter (`TrialRuns.shown`). A size that is far from these, or large
    while these are zero within their sigma, is impossible.
    """
    clocks = {name: _CLOCK_SHOWN for name in shown or ()
              if name.endswith(('_time_offset.time_offset', '_lag.delay')) and not name.startswith('gnss_time_offset')}
    for name, (words, alike) in (_SHOWN | clocks).items():
        own, seen = parameters.get(name.removeprefix(f'{effect}.')), (shown or {}).get(name)
        if seen is None or own is None or own.value is None:
            continue
        contradicted = abs(own.value - seen.value) > max(_CONTRADICTED * seen.sigma, alike)
        if contradicted or name not in clocks and abs(own.value) > alike and abs(seen.value) <= seen.sigma:
            return f'{words} of {seen.text()}, which {"contradicts it" if contradicted else "is none"}'
    known = effect_called(effect)
    beyond = [f'{name} of {estimate.text()}' for name, estimate in parameters.items()
              if estimate.value is not None and _within(estimate)[0] > known.largest.get(name, float('inf'))]
    if beyond:
        return f'{" and ".join(beyond)} is more than any vehicle has; it usually stands for {known.larger_is}'
    below = [f'{name} of {estimate.text()}' for name, estimate in parameters.items()
             if estimate.value is not None and _within(estimate)[1] < known.smallest.get(name, 0.0)]
    return f'{" and ".join(below)} is {known.smaller_is}' if below else ''


def _within(estimate: Estimate) -> tuple[float, float]:
    """Smallest and largest size within one sigma: an estimate is impossible only if all of this range is."""
    sigma = estimate.sigma if estimate.known else 0.0
    return abs(estimate.value) - sigma, abs(estimate.value) + sigma
