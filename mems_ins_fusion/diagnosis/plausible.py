"""Sizes that no vehicle has: such an estimate is told, with what it usually stands for, and never added."""
from __future__ import annotations

from collections.abc import Mapping

from ..effects.registry import effect_called
from .estimate import Estimate

#: what recordings show without a filter, too: in words, and how large a difference is one. Of receivers that smooth
#: over a second the track shows a lag that is too small by up to 0.8 s^2, beyond its sigma
_SHOWN = {'gyroscope_scale.z': ('the angle of the course shows a scale', 0.05),
          'gnss_lag.lag': ('the track between fixes shows a lag', 2.0)}
#: the same of the clock of an input: where it is shown only vaguely, an offset is not denied by that
_CLOCK_SHOWN = 'its stamps beside the IMU or the fixes show an offset', 0.05
#: sigmas that two values of one quantity are apart which contradict each other
_CONTRADICTED = 4.0


def implausible(effect: str, parameters: Mapping[str, Estimate], shown: Mapping[str, Estimate] | None = None) -> str:
    """Why these sizes cannot be, and what they usually stand for; empty where they can.

    shown: what the recordings show of them without a filter (`TrialRuns.shown`). What is far from that, or is large
    where nothing of it is shown, is none.
    """
    clocks = {name: _CLOCK_SHOWN for name in shown or ()
              if name.endswith('_time_offset.time_offset') and not name.startswith('gnss_time_offset')}
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
    """Between which sizes it is, by a sigma: what may be possible is not impossible."""
    sigma = estimate.sigma if estimate.known else 0.0
    return abs(estimate.value) - sigma, abs(estimate.value) + sigma
