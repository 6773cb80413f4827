"""Whether an IMU sits as the parameters say: what a wrong mounting looks like, in plain words."""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.configuration.mounting import Mounting, estimate_mounting
from mems_ins_fusion.navigation.earth import gravity
from mems_ins_fusion.navigation.frames import rotation_from_rpy
from mems_ins_fusion.parameters.params_file import yaml_value
from mems_ins_fusion.recordings.checker import ERROR, WARNING, Finding
from mems_ins_fusion.recordings.motion import valid_fixes
from mems_ins_fusion.samples import Fixes, ImuSamples, Recording

SURE = 4.0  # sigmas
_SMALL_YAW, _SMALL_TILT = math.radians(3.0), math.radians(5.0)  # less is for the filter to find
_LARGE = math.radians(30.0)


def check_mounting(recording: Recording, values: dict) -> list[Finding]:
    """What speaks against `imu.mounting_rpy` in `recording` (SI units): no finding, or one that says what to set.

    values: checked parameters. Where the recording shows too little, nothing is said.
    """
    return mounting_findings(recording.imu, recording.gnss, values['imu.mounting_rpy'])


def mounting_findings(imu: ImuSamples, fixes: Fixes | None, mounting_rpy, lag: float | None = None) -> list[Finding]:
    """The same for the last minutes of a live filter: samples in sensor axes (SI units) and fixes, by arrival.

    mounting_rpy: (3,) rad, as declared. lag: s, `gnss.time_offset`; None searches for it, which is ten times the work.
    With a lag, two minutes at 100 Hz take about 50 ms of CPU: for now and then, not for each fix. Tells an IMU that is
    not upright from gravity alone, a wrong yaw only after some turns or changes of speed, and is silent till then.
    """
    if fixes is not None:
        fixes = fixes.select(valid_fixes(fixes))
    if len(imu) < 2:
        return []
    there = {} if fixes is None or not len(fixes) else {
        'gravity': float(gravity(fixes.latitude[0], fixes.height[0]))}
    found = estimate_mounting(imu, fixes, lag=lag, **there)
    return [] if found is None else _compare(found, rotation_from_rpy(*mounting_rpy))


def _compare(found: Mounting, declared: np.ndarray) -> list[Finding]:
    tilt = math.acos(min(1.0, max(-1.0, float(found.rotation[2] @ declared[2]))))
    tilt_sigma = float(found.sigma[:2].max())
    # the yaw is compared about the up axis found, which a wrong level does not disturb unless it lies on its side
    nose = found.rotation @ declared[0]
    yaw = math.atan2(nose[1], nose[0])
    upright = math.hypot(nose[0], nose[1]) > 0.3
    tilted = tilt > max(_SMALL_TILT, SURE * tilt_sigma)
    turned = found.yaw_known and upright and abs(yaw) > max(_SMALL_YAW, SURE * float(found.sigma[2]))
    if not tilted and not turned:
        return []
    words = ([_tilt_in_words(tilt, tilt_sigma)] if tilted else []) + (
        [_yaw_in_words(yaw, float(found.sigma[2]))] if turned else [])
    known = '' if found.yaw_known else ' (yaw 0: too few turns and changes of speed to see it)'
    advice = f'set imu.mounting_rpy to {yaml_value([round(float(angle), 4) for angle in found.rpy])}{known}'
    severity = ERROR if (tilted and tilt > _LARGE) or (turned and abs(yaw) > _LARGE) else WARNING
    return [Finding(severity, 'imu', f'the IMU seems to be mounted {" and ".join(words)}: {advice}',
                    {'tilt': tilt, 'tilt_sigma': tilt_sigma, 'yaw': yaw if found.yaw_known else None,
                     'yaw_sigma': float(found.sigma[2]), 'mounting_rpy': found.rpy.tolist()})]


def _tilt_in_words(tilt, sigma) -> str:
    degrees = f'{math.degrees(tilt):.0f} +- {math.degrees(sigma):.1f} deg'
    if tilt > math.radians(150.0):
        return 'upside down'
    if tilt > math.radians(60.0):
        return f'on its side ({degrees} off level)'
    return f'tilted by {degrees} against what imu.mounting_rpy says'


def _yaw_in_words(yaw, sigma) -> str:
    if abs(yaw) > math.radians(150.0):
        return 'backwards'
    side = 'left' if yaw > 0 else 'right'
    return (f'turned to the {side} by {abs(math.degrees(yaw)):.0f} +- {math.degrees(sigma):.1f} deg against what '
            'imu.mounting_rpy says')
