"""Quality of a receiver's fixes: their actual standard deviation beside the stated one, and their delay."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.configuration.mounting import Mounting
from mems_ins_fusion.filter.runs.usable import usable_fixes
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.recordings.motion import robust_sigma, scatter_at_rest, sigmas
from mems_ins_fusion.samples import Fixes, ImuSamples

#: m/s^2 over the square root of six: residual of specific force and motion by the roughness of ordinary roads
_ROUGHNESS = 0.06
#: ratio of actual to stated standard deviation above which the stated one is not used
TOO_SURE = 2.0
#: s: a larger difference between stamp and arrival is one of clocks, not a delay
_CLOCKS = 2.0


@dataclass(frozen=True)
class Receiver:
    """stated: m, median of the stated sigmas, or None. at_rest: m, scatter in standstills, or None. in_motion: m, white
    noise about, from changes of speed against the accelerometers, or None. delay: s, from stamp to arrival beyond the
    IMU's, 99 %, None where the log does not show it.
    """

    stated: float | None
    at_rest: float | None
    in_motion: float | None
    delay: float | None

    @property
    def realised(self) -> float | None:
        """The larger of the scatters at rest and in motion; None where both are unknown."""
        seen = [sigma for sigma in (self.at_rest, self.in_motion) if sigma is not None]
        return max(seen) if seen else None


def assess_receiver(fixes: Fixes, imu: ImuSamples, still: np.ndarray, found: Mounting | None) -> Receiver:
    """The receiver of `fixes`. imu: in SI units. still: (n,) its samples at rest. found: the mounting."""
    good = usable_fixes(fixes)
    stated = sigmas(good)
    stated = float(np.nanmedian(stated)) if np.isfinite(stated).any() else None
    at_rest = scatter_at_rest(good, imu, still) if len(good) > 1 else None
    at_rest = None if at_rest is None else float(at_rest)
    in_motion = None
    if found is not None and found.spans is not None and found.yaw_known:
        drive = found.spans
        along = drive.force @ found.rotation[0] - found.bias @ found.rotation[0]
        along -= STANDARD_GRAVITY * np.sin(np.nan_to_num(drive.grade))
        misfit = (drive.acceleration - along) * drive.length**2 / np.sqrt(6.0)
        sensors = _ROUGHNESS * drive.length**2  # what the accelerometers and the road add
        in_motion = float(np.sqrt(max(robust_sigma(misfit)**2 - sensors**2, 0.0))) or None
    return Receiver(stated, at_rest, in_motion, _delay(fixes, imu))


def _delay(fixes, imu) -> float | None:
    late = (fixes.received - fixes.stamp) * 1e-9
    if not late.any():
        return None
    late = late - np.median((imu.received - imu.stamp) * 1e-9)
    return float(np.percentile(late, 99)) if abs(np.median(late)) < _CLOCKS else None

