"""The start of a filter: the first state with its covariance, and the sensor errors known at that time."""
from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from ...navigation.earth import radii
from ...navigation.frames import near
from ..config import FilterConfig
from ..prediction import UNKNOWN_TILT_SIGMA
from ..trust.scale import Scale

#: m/s^2, standard deviation of the horizontal specific force due to the tilt of the IMU, where no standstill shows it
UNKNOWN_TILT_FORCE = UNKNOWN_TILT_SIGMA * 9.8
#: m/s^2, standard deviation of the horizontal specific force relative to that at standstill, on another slope
KNOWN_FORCE_SIGMA = 0.1
KNOWN_RATE_SIGMA = 1e-3  # rad/s, standard deviation of a gyroscope bias that was found at a standstill
DATUM_FIXES = 3  # the origin of the local frame is the median of this many fixes: of three, one may be an outlier


def first_place(fixes: Sequence[tuple[float, float, float]]) -> np.ndarray:
    """Origin (3,) of the local frame where no parameter gives it: latitude, longitude (rad), height (m).

    fixes: latitude, longitude, height of the first valid fixes; DATUM_FIXES of them, or as many as there are.
    """
    places = np.array(fixes[:DATUM_FIXES])
    places[:, 1] = near(places[:, 1], places[0, 1])
    place = np.median(places, axis=0)
    place[1] = near(place[1], 0.0)
    return place


@dataclass
class Standstill:
    """Mean samples at rest, body axes, over `duration` s until `end`."""

    end: float
    duration: float
    specific_force: np.ndarray
    angular_rate: np.ndarray


@dataclass(frozen=True)
class SensorErrors:
    """Estimated by an earlier filter with the same states: estimate (m,) and covariance (m, m) of the augmented states;
    constant (channels,): part of each sensor's error that is not a state."""

    estimate: np.ndarray
    covariance: np.ndarray
    constant: np.ndarray


@dataclass(frozen=True)
class SavedState:
    """State of an earlier run that ended at rest.

    position: rad, rad, m. yaw, yaw_sigma: of the vehicle, rad. max_distance: m, from the position, within which it is
    used. errors: None where they are of another configuration. wheels: `wheel_vibration.calibration`, or None.
    """

    position: tuple[float, float, float]
    yaw: float
    yaw_sigma: float
    max_distance: float
    errors: SensorErrors | None
    wheels: np.ndarray | None = None


class Iron(NamedTuple):
    """Iron estimated together with a magnetic heading: names of the magnetometer's states (k), their estimate (k,), its
    derivative by the error of the heading (k,), and the covariance without the part due to the heading (k, k)."""

    names: tuple[str, ...]
    estimate: np.ndarray
    by_yaw: np.ndarray
    covariance: np.ndarray


@dataclass
class Start:
    """The first state."""

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
    #: of the fixes, see trust/scale.py
    gnss_scale: np.ndarray = field(default_factory=lambda: np.zeros(Scale.CHANGING_SIZE))
    iron: Iron | None = None
    wheels: np.ndarray | None = None  # `wheel_vibration.calibration` of an earlier run
    has_height: bool = True  # whether its fix has an altitude


def transferred(start: Start, old: FilterConfig, new: FilterConfig) -> Start:
    """A start found with the configuration `old`, converted to `new`, so that two runs differ only by their parameters.

    The time offset changes the time of the start, the lever arm its position. The run recomputes the standstill
    (`remeasured`).
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


def remeasured(start: Start, config: FilterConfig, samples: np.ndarray) -> Start:
    """`start` with the means of its standstill over these samples (n, 7): time as in `start`, f, w in sensor axes."""
    still = start.standstill
    if still is None:
        return start
    inside = slice(*np.searchsorted(samples[:, 0], [still.end - still.duration - 1e-6, still.end + 1e-6]))
    mean = config.conditioning @ samples[inside, 1:].mean(axis=0) + config.offset
    return replace(start, standstill=replace(still, specific_force=mean[:3], angular_rate=mean[3:]))
