"""Time offsets, antenna, mounting and inputs from the latest minutes without a filter, as findings to be proven.

The estimates are those of `configure`. A look at some minutes takes half a second, an analysis of them by `diagnose`
half a minute. So looks are made each minute or more often, also of the latest minute alone, in which a changed value is
found long before it dominates the kept samples.
"""
from __future__ import annotations

import math

from ..configuration.check import (
    SMALL_ARM,
    SMALL_OFFSET,
    SMALL_TILT,
    SMALL_YAW,
    SURE,
    VAGUE_ARM,
    clocks_left,
    shares_left,
)
from ..configuration.inputs import SHARE_KNOWN
from ..configuration.mounting import Mounting, estimate_mounting
from ..configuration.offset import FLOOR
from ..configuration.remaining import ANGLES, ARM, LOW_PASS, TIME_OFFSET, YAW, Remaining, remaining_of
from ..effects.registry import effect_called
from ..filter.runs.usable import usable_fixes
from ..samples import Recording
from .estimate import Estimate
from .findings import Finding
from .held_out import HeldOut
from .window import last_seconds, seconds

#: s, lengths of the latest samples that are used, the shortest first, in which a change is found first
LOOKED_AT = (60.0, 120.0, 240.0)


def shown_directly(recording: Recording, values: dict) -> list[Finding]:
    """Significant errors of the checked parameters `values` in the latest samples of `recording`."""
    return [finding for finding in direct_findings(recording, values) if finding.added]


def direct_findings(recording: Recording, values: dict) -> list[Finding]:
    """As `shown_directly`, with the parameters that are confirmed by the latest samples: these are not `added`, and
    have their possible remaining errors (`settled`: too small to matter)."""
    found: dict[str, Finding] = {}
    for length in LOOKED_AT:
        for name, finding in _shown(last_seconds(recording, length), values).items():
            before = found.get(name)
            if before is None or (_agree(before, finding) if before.added and finding.added else
                                  finding.added or not before.added and finding.says_more_than(before)):
                found[name] = finding  # of more samples
        if seconds(recording) <= length:
            break
    return list(found.values())


def _shown(part: Recording, values: dict) -> dict[str, Finding]:
    if len(part.imu) < 2 or len(part.gnss) < 2:
        return {}
    mounting = estimate_mounting(part.imu, part.gnss)
    left = {one.name: one for one in remaining_of(mounting, values)}
    arm = {axis: left[name] for axis, name in zip('xyz', ARM)}
    small = dict(zip(ANGLES, (SMALL_TILT, SMALL_TILT, SMALL_YAW)))
    effects = _of_inputs(part, mounting, values)
    effects['gnss_time_offset'] = {'time_offset': left[TIME_OFFSET]}, {'time_offset': SMALL_OFFSET}
    effects['gnss_lever_arm'] = arm, dict.fromkeys('xy', SMALL_ARM)  # heights of fixes are too inaccurate for z
    effects['mounting_rotation'] = {name: left[name] for name in ANGLES}, small
    # the estimate may be the slope of the road until others have been driven
    driven = mounting is not None and mounting.yaw_known
    vague = {'gnss_lever_arm': dict.fromkeys('xyz', VAGUE_ARM), 'mounting_rotation': small}
    since = int(part.imu.stamp[0])
    found = {}
    for name, (sizes, least) in effects.items():
        clear = {n: one for n, one in sizes.items()
                 if one.sigma < vague.get(name, {}).get(n, math.inf) or one.certain(least.get(n, SMALL_ARM), SURE)}
        certain = any(one.certain(least.get(n, SMALL_ARM), SURE) for n, one in clear.items())
        if certain and (driven or name != 'mounting_rotation'):
            found[name] = _finding(name, clear, values, since)
        else:
            found[name] = _as_given(name, sizes, least, since)
    return found


def _as_given(name: str, sizes: dict[str, Remaining], least: dict[str, float], since: int) -> Finding:
    """Possible remaining error of an effect without a significant one. least: size that does not matter."""
    units = {one.name: one.unit for one in effect_called(name).traced}
    left = {n: Estimate(one.value, one.sigma, units[n]) for n, one in sizes.items() if math.isfinite(one.sigma)}
    settled = all(sizes[n].settled(most) for n, most in least.items())
    return Finding(name, [name], left, 0.0, 0.0, False, HeldOut(0.0, 1.0, []), settled=settled, since=since,
                   direct=True)


def _of_inputs(part: Recording, mounting: Mounting | None, values: dict) -> dict[str, tuple[dict, dict]]:
    """By effect: remaining errors of the inputs' clocks, low passes, axes and shares of the dynamic pressure, except
    for those that the filter estimates itself, and the sizes that do not matter."""
    found: dict[str, tuple[dict, dict]] = {}
    for name, clock in clocks_left(part, part.imu, mounting, values).items():
        low_pass = clock.low_pass.left(values[f'{name}.lag']) if clock.low_pass is not None else None
        if low_pass is not None:
            sizes = {'delay': clock, 'tau': Remaining(LOW_PASS, low_pass.tau, low_pass.sigma)}
            found[f'{name}_lag'] = sizes, dict.fromkeys(sizes, 0.0)
        else:
            found[f'{name}_time_offset'] = {'time_offset': clock}, {'time_offset': SMALL_OFFSET}
        if clock.axes:
            axes = Remaining(YAW, clock.axes.yaw, clock.axes.sigma)
            found[f'{name}_yaw'] = {'yaw': axes}, {'yaw': SMALL_YAW}
    for name, share in shares_left(part, usable_fixes(part.gnss), values).items():
        found[f'{name}_dynamic'] = {'share': share}, {'share': SHARE_KNOWN}
    return {name: of for name, of in found.items() if not effect_called(name).hidden(values, part)}


def _finding(name: str, sizes: dict[str, Remaining], values: dict, since: int) -> Finding:
    effect = effect_called(name)
    units = {one.name: one.unit for one in effect.traced}
    adjusted = effect.adjusted(values, {**dict.fromkeys(units, 0.0), **{n: one.value for n, one in sizes.items()}})
    changes = {parameter: value for parameter, value in adjusted.items() if value != values.get(parameter)}
    left = {n: Estimate(one.value, one.sigma, units[n]) for n, one in sizes.items()}
    least = dict.fromkeys(left.keys() & {'time_offset', 'delay'}, FLOOR)
    return Finding(name, [name], left, 0.0, 0.0, True, HeldOut(0.0, 1.0, []), changes=changes, since=since, least=least,
                   direct=True)


def _agree(one: Finding, other: Finding) -> bool:
    a, b = one.parameters, other.parameters
    return not any(a[name].differs(b[name]) for name in a.keys() & b.keys())
