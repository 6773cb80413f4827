"""One parameter of the file that `configure` writes, and when a value is sure enough for it."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.recordings.findings import SURE

SIGNIFICANT = 2.0  # sigmas: a smaller value is not set
#: sigmas, the same of the clocks of inputs, of which a file has several: at two, one file in five would have a false
#: one
OF_SEVERAL = 3.0
#: m, standard deviation of the place of an antenna forward and left of the IMU, of which nothing is known; chosen
ARM_UNKNOWN = 0.5
ARM_SHOWN = 0.3  # m: a part of an arm with a larger sigma is not shown; a tape is better
TF_ARM = 0.05  # m: what the transforms may be off by themselves, standard deviation


@dataclass(frozen=True)
class Setting:
    """One parameter of the file. why: lines of evidence, with sigma."""

    name: str
    value: object
    why: tuple[str, ...]


def is_sure(value: float, sigma: float, sigmas: float = SIGNIFICANT) -> bool:
    """Whether a value is better than zero for certain."""
    return bool(abs(value) > sigmas * sigma)


def at_zero(sigmas: float = SIGNIFICANT) -> str:
    """What the evidence of a smaller value ends with."""
    return f': less than {sigmas:g} sigma, left at zero'


def arm_apart(arm, sigma, told: np.ndarray) -> np.ndarray:
    """(3,) whether the arm that the transforms say is another than `arm` with `sigma`, as the drive shows it."""
    known = np.asarray(sigma) < ARM_SHOWN
    return known & (np.abs(np.where(known, arm, told) - told) > SURE * np.hypot(np.where(known, sigma, 0.0), TF_ARM))


def rounded(values, digits) -> list:
    return [round(float(value), digits) + 0.0 for value in values]
