"""What the latest minutes show without a filter of time offsets, antenna, mounting and inputs, as findings to be
proven.

The estimates are those of `configure`; a look at some minutes takes half a second of work, where an analysis of them by
`diagnose` takes half a minute. So it can be had each minute or sooner, of the latest one alone too: a value that has
changed shows before it is most of what is kept.
"""
from __future__ import annotations

from ..configuration.check import (
    SMALL_ARM,
    SMALL_OFFSET,
    SMALL_SHARE,
    SMALL_TILT,
    SMALL_YAW,
    SURE,
    VAGUE_ARM,
    clocks_left,
    shares_left,
)
from ..configuration.mounting import Mounting, estimate_mounting
from ..configuration.offset import FLOOR
from ..configuration.remaining import ANGLES, ARM, LOW_PASS, TIME_OFFSET, YAW, Remaining, remaining_of
from ..effects.registry import effect_called
from ..filter.runs.usable import usable_fixes
from ..samples import Recording
from .estimate import Estimate
from .findings import Finding
from .held_out import HeldOut
from .window import cut, seconds

#: s before now, of the samples that are looked at: the shortest first, in which a change shows
LOOKED_AT = (60.0, 120.0, 240.0)


def shown_directly(recording: Recording, values: dict) -> list[Finding]:
    """What is left for certain of the checked parameters `values` in the latest samples of `recording`."""
    found: dict[str, Finding] = {}
    for length in LOOKED_AT:
        for name, finding in _shown(cut(recording, length), values).items():
            if name not in found or _agree(found[name], finding):
                found[name] = finding  # of more samples
        if seconds(recording) <= length:
            break
    return list(found.values())


def _shown(part: Recording, values: dict) -> dict[str, Finding]:
    if len(part.imu) < 2 or len(part.gnss) < 2:
        return {}
    mounting = estimate_mounting(part.imu, part.gnss)
    left = {one.name: one for one in remaining_of(mounting, values)}
    arm = {axis: left[name] for axis, name in zip('xyz', ARM) if left[name].sigma < VAGUE_ARM}
    small = dict(zip(ANGLES, (SMALL_TILT, SMALL_TILT, SMALL_YAW)))
    angles = {name: left[name] for name in ANGLES if left[name].sigma < small[name]}
    effects = _of_inputs(part, mounting, values)
    if left[TIME_OFFSET].certain(SMALL_OFFSET, SURE):
        effects['gnss_time_offset'] = {'time_offset': left[TIME_OFFSET]}
    if any(one.certain(SMALL_ARM, SURE) for one in arm.values()):
        effects['gnss_lever_arm'] = arm
    # what was not driven yet may be the slope of the road
    driven = mounting is not None and mounting.yaw_known
    if driven and any(one.certain(small[name], SURE) for name, one in angles.items()):
        effects['mounting_rotation'] = angles
    since = int(part.imu.stamp[0])
    return {name: _finding(name, sizes, values, since) for name, sizes in effects.items()}


def _of_inputs(part: Recording, mounting: Mounting | None, values: dict) -> dict[str, dict[str, Remaining]]:
    """By effect: what is left for certain of the inputs' clocks, low passes, axes and shares of the dynamic pressure,
    but for what the filter estimates itself."""
    found: dict[str, dict[str, Remaining]] = {}
    for name, clock in clocks_left(part, part.imu, mounting, values).items():
        low_pass = clock.low_pass.left(values[f'{name}.lag']) if clock.low_pass is not None else None
        if low_pass is not None:
            found[f'{name}_lag'] = {'delay': clock, 'tau': Remaining(LOW_PASS, low_pass.tau, low_pass.sigma)}
        elif clock.certain(SMALL_OFFSET, SURE):
            found[f'{name}_time_offset'] = {'time_offset': clock}
        axes = clock.axes and Remaining(YAW, clock.axes.yaw, clock.axes.sigma)
        if axes is not None and axes.certain(SMALL_YAW, SURE):
            found[f'{name}_yaw'] = {'yaw': axes}
    for name, share in shares_left(part, usable_fixes(part.gnss), values).items():
        if share.certain(SMALL_SHARE, SURE):
            found[f'{name}_dynamic'] = {'share': share}
    return {name: sizes for name, sizes in found.items() if not effect_called(name).hidden(values, part)}


def _finding(name: str, sizes: dict[str, Remaining], values: dict, since: int) -> Finding:
    effect = effect_called(name)
    units = {one.name: one.unit for one in effect.traced}
    adjusted = effect.adjusted(values, {**dict.fromkeys(units, 0.0), **{n: one.value for n, one in sizes.items()}})
    changes = {parameter: value for parameter, value in adjusted.items() if value != values.get(parameter)}
    left = {n: Estimate(one.value, one.sigma, units[n]) for n, one in sizes.items()}
    least = dict.fromkeys(left.keys() & {'time_offset', 'delay'}, FLOOR)
    return Finding(name, [name], left, 0.0, 0.0, True, HeldOut(0.0, 1.0, []), changes=changes, since=since, least=least)


def _agree(one: Finding, other: Finding) -> bool:
    a, b = one.parameters, other.parameters
    return not any(a[name].differs(b[name]) for name in a.keys() & b.keys())
