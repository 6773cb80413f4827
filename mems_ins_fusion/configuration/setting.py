"""One parameter of the file that `configure` writes, and when a value is sure enough for it."""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.recordings.remarks import SURE

#: sigmas: a value that differs from zero by less is not set
SET_SIGMAS = 2.0
#: sigmas, the same for time offsets of inputs, of which a file has several: with two sigmas, one file in five would
#: have a false one
OF_SEVERAL = 3.0
#: m, standard deviation of the lever arm of an antenna forward and left if nothing is known. Chosen, not measured
ARM_UNKNOWN = 0.5
#: m: a component of a lever arm with a larger standard deviation is not set: a tape measure is better
ARM_SHOWN = 0.3
#: m, standard deviation of a lever arm that the transforms (tf) state
TF_ARM = 0.05


@dataclass(frozen=True)
class Setting:
    """One parameter of the file. why: lines of evidence, with sigma."""

    name: str
    value: object
    why: tuple[str, ...]


def is_sure(value: float, sigma: float, sigmas: float = SET_SIGMAS) -> bool:
    """Whether a value differs from zero by at least that many sigmas."""
    return bool(abs(value) > sigmas * sigma)


def left_at_zero_text(sigmas: float = SET_SIGMAS) -> str:
    """Last line of the evidence for a value that is not set, as it is smaller."""
    return f': less than {sigmas:g} sigma, left at zero'


def arm_apart(arm, sigma, told: np.ndarray) -> np.ndarray:
    """(3,) whether the lever arm `told` by the transforms contradicts `arm` with `sigma`, estimated from the drive."""
    known = np.asarray(sigma) < ARM_SHOWN
    return known & (np.abs(np.where(known, arm, told) - told) > SURE * np.hypot(np.where(known, sigma, 0.0), TF_ARM))


def rounded(values, digits) -> list:
    return [round(float(value), digits) + 0.0 for value in values]
