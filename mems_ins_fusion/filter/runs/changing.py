"""A live filter whose parameters change while it drives: one with the new ones runs beside it until it takes its place.

The new filter begins with nothing, aligns by itself and has the same messages. It takes over once it is as sure as the
present one, and where that does not show: the estimates differ by less than both publish as their sigmas, or the
vehicle stands. Both filters and the comparison depend on nothing but stamps and numbers of what comes in: live and in a
replay it is the same sample.
"""
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...navigation.frames import wrap, yaw_of_quaternion
from ..config import FilterConfig
from .live import FusionFilter
from .odometry import LINEAR, ORIENTATION, POSE_COVARIANCE, POSITION, TWIST_COVARIANCE

#: s for which the new filter runs beside the present one before they are compared: its sensor errors settle in that
SETTLING = 60.0
#: s after which it takes over wherever it is: its parameters have been proven to be better
LONGEST = 180.0
#: sigmas of position and heading, as parts of those of the present filter, with which the new one is as sure: a filter
#: that has just begun is less sure for a minute or two, and rightly so
AS_SURE = 1.25
#: ns from one comparison to the next
PERIOD = 10**9
#: m/s: a vehicle that is slower stands, and nobody steers by its pose
STANDING = 0.05
#: of the filter that drives, not of its parameters: what others look at or have heard, and counts since the start
_STAYS = frozenset({'odometry', 'geodetic', 'position_covariance_enu', 'datum', 'tallies', 'gaps', 'waited', '_notices',
                    '_judged', '_said', '_said_mounting', '_looked', '_recent', '_last_recovery', '_using_fixes'})


@dataclass(frozen=True)
class Handover:
    """A filter has taken the place of another. stamp: ns. By how much the estimate has changed: m, rad."""

    stamp: int
    position: float
    yaw: float

    @property
    def text(self) -> str:
        """In words."""
        return (f'the filter goes on with other parameters: position {self.position:.2f} m, heading '
                f'{math.degrees(self.yaw):+.2f} deg from where it was')


class ChangingFilter(FusionFilter):
    """`FusionFilter` with `change`."""

    def __init__(self, config: FilterConfig):
        self._next: FusionFilter | None = None
        self._begun, self._slot = 0, 0  # ns, of the newest change; number of the newest comparison
        self.handovers: list[Handover] = []
        super().__init__(config)

    @property
    def changing(self) -> bool:
        """Whether a filter with other parameters runs beside this one."""
        return self._next is not None

    def change(self, values: dict) -> None:
        """Go on with the checked parameters `values`, as soon as a filter that has them is where this one is."""
        self._next = FusionFilter(FilterConfig.from_parameters(values))
        self._next.use_fixes(self._using_fixes)
        self._begun = self._now

    def add_imu(self, stamp: int, *numbers) -> bool:
        new = super().add_imu(stamp, *numbers)
        if self._next is not None:
            self._next.add_imu(stamp, *numbers)
            if stamp // PERIOD != self._slot:
                self._slot = stamp // PERIOD
                self._compare(stamp)
        return new

    def add_fix(self, *fix) -> None:
        super().add_fix(*fix)
        if self._next is not None:
            self._next.add_fix(*fix)

    def add(self, name: str, stamp: int, *numbers) -> None:
        super().add(name, stamp, *numbers)
        if self._next is not None:
            self._next.add(name, stamp, *numbers)

    def add_temperature(self, stamp: int, celsius: float) -> None:
        super().add_temperature(stamp, celsius)
        if self._next is not None:
            self._next.add_temperature(stamp, celsius)

    def adopt(self, config: FilterConfig) -> None:
        super().adopt(config)
        if self._next is not None:
            self._next.adopt(self._next.changed(config.parameters))

    def use_fixes(self, use: bool) -> None:
        super().use_fixes(use)
        if self._next is not None:
            self._next.use_fixes(use)

    def set_start(self, *start) -> None:
        super().set_start(*start)
        if self._next is not None:
            self._next.set_start(*start)

    def reset(self) -> None:
        super().reset()
        if self._next is not None:
            self._next.reset()

    def _compare(self, now: int) -> None:
        """Take over where it is time."""
        other = self._next
        other.notices(), other.verdicts()  # said by the filter that drives
        if not self.has_estimate:
            self._take_over(now, 0.0, 0.0)
        elif other.aligned and now - self._begun >= SETTLING * 1e9:
            other.datum = self.datum
            self.update_odometry()
            other.update_odometry()
            position, velocity, yaw = _differences(self.odometry, other.odometry)
            stands = max(abs(self.odometry[LINEAR]), abs(other.odometry[LINEAR])) < STANDING
            smooth = stands or _covered(position, velocity, yaw, self.odometry, other.odometry)
            if (smooth and _as_sure(self.odometry, other.odometry)) or now - self._begun >= LONGEST * 1e9:
                self._take_over(now, position, yaw)

    def _take_over(self, now: int, position: float, yaw: float) -> None:
        other, self._next = self._next, None
        self.__dict__.update({name: value for name, value in vars(other).items() if name not in _STAYS})
        self.handovers.append(Handover(now, position, yaw))
        self.say('info', self.handovers[-1].text)


def _differences(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """Of two odometries (85,): horizontal distance m, of the velocities m/s, and of the yaw from the first, rad."""
    position = math.hypot(*(b - a)[POSITION:POSITION + 2])
    velocity = math.hypot(*(b - a)[LINEAR:LINEAR + 2])
    yaw = wrap(yaw_of_quaternion(*b[ORIENTATION:POSE_COVARIANCE]) - yaw_of_quaternion(*a[ORIENTATION:POSE_COVARIANCE]))
    return position, velocity, float(yaw)


def _as_sure(present: np.ndarray, other: np.ndarray) -> bool:
    """Whether the odometry `other` (85,) claims position and heading about as well as `present`."""
    a, b = (odometry[POSE_COVARIANCE:LINEAR].reshape(6, 6) for odometry in (present, other))
    return bool(b[0, 0] + b[1, 1] <= AS_SURE**2 * (a[0, 0] + a[1, 1]) and b[5, 5] <= AS_SURE**2 * a[5, 5])


def _covered(position: float, velocity: float, yaw: float, a: np.ndarray, b: np.ndarray) -> bool:
    """Whether differences are within one sigma of what the odometries `a` and `b` (85,) claim together."""
    pose = (a + b)[POSE_COVARIANCE:LINEAR].reshape(6, 6)
    twist = (a + b)[TWIST_COVARIANCE:].reshape(6, 6)
    return (position**2 <= pose[0, 0] + pose[1, 1] and velocity**2 <= twist[0, 0] + twist[1, 1]
            and yaw**2 <= pose[5, 5])
