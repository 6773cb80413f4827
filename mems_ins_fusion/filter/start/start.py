"""What a filter starts from: where, how fast, which way, what a standstill showed, and how well all that is known."""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ...navigation.earth import radii
from ..config import FilterConfig
from ..trust.scale import Scale

#: rad, roll and pitch of the IMU where no standstill has shown them
UNKNOWN_TILT_SIGMA = 0.05
#: the local frame begins at the median of this many fixes, the first good ones: of three, one may be wrong
DATUM_FIXES = 3


def first_place(fixes: Sequence[tuple[float, float, float]]) -> np.ndarray:
    """The origin (3,) of the local frame that no parameter gives: latitude, longitude (rad), height (m).

    fixes: the first good ones, the same three numbers each; DATUM_FIXES of them, or as many as there are at the start.
    """
    return np.median(np.array(fixes[:DATUM_FIXES]), axis=0)


@dataclass
class Standstill:
    """What the sensors showed at rest, body axes: means over `duration` seconds that ended at `end`."""

    end: float
    duration: float
    specific_force: np.ndarray
    angular_rate: np.ndarray


@dataclass(frozen=True)
class SensorErrors:
    """What an earlier filter with the same states had learned. estimate (m,), covariance (m, m) of the states behind
    the navigation errors; constant (channels,): the part of each sensor's error that has no state."""

    estimate: np.ndarray
    covariance: np.ndarray
    constant: np.ndarray


class Iron(NamedTuple):
    """What a magnetic heading goes with: states `names` of the magnetometer, their estimate (k,), its change with an
    error of the heading (k,), and what is left of the covariance beside that (k, k)."""

    names: tuple[str, ...]
    estimate: np.ndarray
    by_yaw: np.ndarray
    covariance: np.ndarray


@dataclass
class Start:
    """The first state: where, how fast, which way, and how well that is known."""

    time: float  # s since the epoch
    latitude: float
    longitude: float
    height: float
    velocity: np.ndarray  # (2,) north, east, m/s
    yaw: float  # of the vehicle
    covariance: np.ndarray  # (5, 5) of r_n, r_e, v_n, v_e, yaw
    standstill: Standstill | None
    notes: list[tuple[str, str]] = field(default_factory=list)  # level and text
    errors: SensorErrors | None = None
    gnss_scale: np.ndarray = field(default_factory=lambda: np.zeros(Scale.SIZE))  # of the fixes, see trust/scale.py
    iron: Iron | None = None
    wheels: np.ndarray | None = None  # what an earlier filter had learned of them, see measurements/wheel_vibration.py


def transferred(start: Start, old: FilterConfig, new: FilterConfig) -> Start:
    """The start that `old` found, for a filter with other parameters: so that two runs differ by these alone.

    The time offset moves its time, the lever arm its position; what the standstill shows is `retaken` by the run.
    """
    delay = new.gnss.time_offset - old.gnss.time_offset
    arm = new.gnss.lever_arm - old.gnss.lever_arm
    c, s = math.cos(start.yaw), math.sin(start.yaw)
    meridian, prime_vertical = radii(start.latitude)
    return replace(
        start, time=start.time - delay, latitude=start.latitude - (c * arm[0] - s * arm[1]) / (meridian + start.height),
        longitude=start.longitude - (s * arm[0] + c * arm[1]) / (
            (prime_vertical + start.height) * math.cos(start.latitude)),
        height=start.height + arm[2])


def retaken(start: Start, config: FilterConfig, samples: np.ndarray) -> Start:
    """`start` with what its standstill shows in these samples (n, 7): time as in `start`, f and w in sensor axes."""
    still = start.standstill
    if still is None:
        return start
    inside = slice(*np.searchsorted(samples[:, 0], [still.end - still.duration - 1e-6, still.end + 1e-6]))
    seen = samples[inside, 1:].mean(axis=0)
    seen = config.conditioning @ seen + config.offset
    return replace(start, standstill=replace(still, specific_force=seen[:3], angular_rate=seen[3:]))
