"""Trust horizon: for how long, and how far, the position error stays within `horizon.limit` without fixes.

A small copy of the filter's memory (newest state, newest sample, scratch) is predicted without fixes, in steps, for
straight motion at the present speed, or accelerating to `horizon.speed` where that is higher. The non-holonomic
constraint, and the wheel speed where there is one, are applied with zero innovations, so that only the covariance
changes. Standstills are not applied, as it is unknown whether there will be one. The horizon ends where the horizontal
error exceeds `horizon.limit` with a probability above 5 %, by the published covariance, whose part P counts with the
factor that copies of the filter without fixes have shown (withheld.py), and the receiver's slow errors with the
variance that its innovations show. While another filter takes over (blending.py), the difference that is added to the
published position counts as an error.
"""
from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit

from ..advance import coast
from ..config import FilterConfig
from ..constraints import constrain
from ..measurements import speed
from ..measurements.geometry import body_to_level
from ..memory import (
    NAV,
    Event,
    Head,
    Kind,
    Nav,
    Sample,
    element_at,
    has_constraints,
    input_at,
    nonnegative,
    sample_at,
    state_at,
    variance_factor,
    views,
)
from ..prediction import predict
from ..trust.inputs import SPEED_CORRELATION
from ..trust.receiver import Receiver, lasting_factor
from ..trust.scale import Noise, Scale, scale
from ..update import begin_update, end_update, update
from .newest import STEP, NewestState
from .odometry import added_covariance

#: s, longest horizon. A longer one would cost time, and after minutes the error depends on what the vehicle does
LONGEST_HORIZON = 120.0
EXCEEDED = 0.05  # probability of an error above the limit at which the horizon ends
DRIVING_OFF = 2.0  # m/s^2, assumed acceleration of a vehicle that is slower than `horizon.speed`: a car that drives off
#: directions over a quarter turn at which the probability is evaluated: accurate to 1e-3 for a degenerate ellipse
_DIRECTIONS = 16
SPEED_PATIENCE = 1.0  # s since the last wheel speed after which none is expected


class Horizon(NamedTuple):
    """seconds: time for which the horizontal error stays below the limit with a probability of 95 %, at most
    LONGEST_HORIZON. metres: distance driven in that time."""

    seconds: float
    metres: float

    @property
    def in_words(self) -> str:
        """The horizon in words, for a message."""
        more = 'more than ' if self.seconds >= LONGEST_HORIZON else ''
        return f'{more}{self.seconds:.1f} s, {self.metres:.0f} m'


class HorizonPredictor:
    """Horizons of a filter with `config` (parameters `horizon.limit`, m, and `horizon.speed`, m/s)."""

    def __init__(self, config: FilterConfig):
        self._limit, self._speed = config.parameters['horizon.limit'], config.parameters['horizon.speed']
        # three rows: two for the prediction, one that keeps the statistics of the inputs
        self._small = NewestState(config, 3, 1, 1)

    def predict(self, memory: np.ndarray, exceeded: float = EXCEEDED,
                added: tuple[float, float, float] = (0.0, 0.0, 0.0), realised: float = 1.0) -> Horizon:
        """The horizon from the newest state of `memory`, which does not change.

        exceeded: probability of an error above the limit at which the horizon ends. added: difference that is added to
        the published position (`Blending.left`): north and east, m, and the time in which it falls to zero, s.
        realised: realised over expected variance of the errors without fixes (`Withheld.realised`).
        """
        copy, width = self._small.take(memory), int(memory[Head.WIDTH])
        first, state = state_at(copy, 0), state_at(memory, int(memory[Head.SAMPLES]))
        copy[first + Nav.LASTING] *= _shown_over_published(memory, state)
        copy[first + 2 * width:][:width] = copy[first:][:width]
        copy[int(copy[Head.EVENTS_AT]):][:Event.SIZE], interval = _wheel_speed(memory, memory[state + Nav.TIME])
        copy[Head.MAX_GAP] = math.inf
        return Horizon(*_predict(copy, self._limit, self._speed, interval, exceeded, *added, realised))


def _shown_over_published(memory: np.ndarray, state: int) -> float:
    """Variance of the receiver's slow errors by the innovations alone over the one that is published (before its upper
    limit), of the state at `state`. What is published may be too large: it is as claimed, unless the claim is excluded
    for each time constant of these errors. The horizon is to be right in 95 % of the outages, neither less nor more."""
    return math.exp(memory[state + Receiver.LASTING_SCALE + Scale.LOG]) / lasting_factor(memory, state)


def _wheel_speed(memory: np.ndarray, now: float) -> tuple[np.ndarray, float]:
    """Event of the newest wheel speed, and the mean interval between wheel speeds, s; 0: there are none."""
    events = views(memory)[-1][:int(memory[Head.EVENTS])]
    speeds = events[events[:, Event.KIND] == Kind.SPEED]
    time = speeds[:, Event.TIME]
    if len(speeds) < 2 or now - time[-1] > SPEED_PATIENCE:
        return np.zeros(Event.SIZE), 0.0
    return speeds[-1], (time[-1] - time[0]) / (len(time) - 1)


@njit(_nrt=False)
def _predict(mem, limit, wanted, interval, exceeded, north, east, left, realised):
    """Seconds and metres until the error exceeds `limit`, m, with a probability above `exceeded`.

    mem: as `HorizonPredictor` makes it. wanted: m/s, lowest speed to accelerate to. interval: s between wheel speeds,
    whose event is in the memory; 0: none. north, east: m, added to the estimate; they fall to zero within `left` s.
    realised: factor on the covariance.
    """
    first, width, sample = nonnegative(state_at(mem, 0)), int(mem[Head.WIDTH]), nonnegative(sample_at(mem, 0))
    src, dst, seen = first, nonnegative(first + width), nonnegative(first + 2 * width)
    mem[sample + Sample.INTERVAL], mem[sample + Sample.FAULT], mem[sample + Sample.STILL] = STEP, 0.0, 0.0
    metres = 0.0
    for k in range(round(LONGEST_HORIZON / STEP)):
        part = 1.0 - k * STEP / left if k * STEP < left else 0.0
        if exceedance_probability(mem, src, limit, part * north, part * east, realised) > exceeded:
            return k * STEP, metres
        speed_now = math.hypot(mem[src + Nav.V_N], mem[src + Nav.V_E])
        coast(mem, sample, src)  # not marked as a fault, so that errors of sensors and attitude are propagated
        if speed_now < wanted:
            _accelerate(mem, src, sample)
        predict(mem, src, dst, sample, STEP)
        mem[dst + Nav.TIME], mem[dst + Nav.CONSTRAINT_TIME] = mem[src + Nav.TIME] + STEP, STEP
        if has_constraints(mem):
            constrain(mem, dst, sample)
        if interval > 0.0:
            _take_speed(mem, dst, sample, interval)
        for i in range(Nav.MEMORY, NAV):  # zero innovations must not enter the statistics
            mem[dst + i] = mem[seen + i]
        metres += 0.5 * STEP * (speed_now + math.hypot(mem[dst + Nav.V_N], mem[dst + Nav.V_E]))
        src, dst = dst, src
    return LONGEST_HORIZON, metres


@njit(_nrt=False)
def _accelerate(mem, r, sample):
    """Add an acceleration along the vehicle's forward axis to the sample at `sample`."""
    yaw = int(mem[Head.MOUNTING_YAW])
    turn = mem[r + NAV + yaw] if yaw >= 0 else 0.0
    mem[sample + Sample.F_X] += DRIVING_OFF * math.cos(turn)
    mem[sample + Sample.F_Y] += DRIVING_OFF * math.sin(turn)


@njit(_nrt=False)
def _take_speed(mem, r, sample, interval):
    """Correct the covariance of the state at r with the wheel speeds of a step, innovation zero."""
    (n, h), at = begin_update(mem, r), int(mem[Head.EVENTS_AT])
    dimensions = speed.observe(mem, r, at, h, n, body_to_level(mem, r), sample)
    mem[at + Event.Z_N] = 0.0
    for i in range(n):
        mem[at + Event.Z_N] += mem[h + i] * mem[r + NAV + i]
    factor = max(scale(mem, input_at(mem, r, at) + Noise.SCALE), 1.0)
    update(mem, r, at, n, dimensions, factor, max(interval, SPEED_CORRELATION) / STEP, 0.0, 0.0, 0.0)
    end_update(mem, r)


@njit(_nrt=False)
def exceedance_probability(mem, r, limit, north=0.0, east=0.0, realised=1.0):
    """Probability that the horizontal error of the state at r exceeds `limit`, m. north, east: m, whose squares are
    part of the covariance. realised: factor on it.

    The mean over all directions phi of exp(-limit^2 / (2 (a cos(phi)^2 + b sin(phi)^2))), a and b the variances along
    the axes of the error ellipse.
    """
    factor = realised * variance_factor(mem, r)
    nn = factor * mem[element_at(mem, r, 0, 0)] + added_covariance(mem, r, 0, 0) + north * north
    ne = factor * mem[element_at(mem, r, 0, 1)] + added_covariance(mem, r, 0, 1) + north * east
    ee = factor * mem[element_at(mem, r, 1, 1)] + added_covariance(mem, r, 1, 1) + east * east
    mean, half = 0.5 * (nn + ee), math.hypot(0.5 * (nn - ee), ne)
    total = 0.0
    for k in range(_DIRECTIONS):
        c = math.cos((2 * k + 1) * math.pi / (2 * _DIRECTIONS))  # of 2 phi
        total += math.exp(-0.5 * limit * limit / (mean + half * c))
    return total / _DIRECTIONS
