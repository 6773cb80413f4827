"""The route of a simulated land vehicle: manoeuvres within what a driver does and a car bears.

Each segment changes speed and course by the quintic step 10 u^3 - 15 u^4 + 6 u^5, whose first derivative peaks at
15/8 and whose second at 10/sqrt(3), per unit of change and duration.
"""
from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

#: m/s, of a car in town
MAX_SPEED = 20.0
#: m/s, of a slow robot
ROBOT_SPEED = 0.4
#: m/s^3, forwards or sideways
MAX_JERK = 2.5
#: m, smallest radius of a turn, at its tightest point
MIN_RADIUS = 9.0
#: largest first derivative of the quintic step
_PEAK_RATE = 15 / 8
#: largest second derivative of the quintic step
_PEAK_CURVATURE = 10 / math.sqrt(3)
#: s, segments end on multiples of this, where the quadrature has an edge
_TIME_GRID = 0.1


@dataclass(frozen=True)
class Segment:
    """A stretch of `duration` s in which the speed changes by `speed_change` m/s, the course by `course_change` rad."""

    duration: float
    speed_change: float = 0.0
    course_change: float = 0.0


def plan(duration: float, standstill: float, rng: np.random.Generator, deck) -> Iterator[Segment]:
    """Segments that fill at least `duration` s, the first `standstill` s at rest.

    The opening after the standstill is straight, so that a filter can align; then manoeuvres, each of which starts and
    ends in motion, come from shuffled decks: a drive of a few minutes holds all kinds. deck: CITY, MIXED, TRAFFIC or
    SLOW.
    """
    speed = elapsed = 0.0
    kinds = _shuffled(deck, rng)
    cruise, acceleration = (ROBOT_SPEED, 0.3) if deck is SLOW else (rng.uniform(8, 12), 1.5)
    first = [Segment(_on_grid(standstill)), _speed_change(0.0, cruise, acceleration), Segment(5.0)]
    while elapsed < duration:
        for segment in first or next(kinds)(speed, rng):
            yield segment
            elapsed += segment.duration
            speed += segment.speed_change
        first = None


def _shuffled(deck, rng):
    while True:
        for i in rng.permutation(len(deck)):
            yield deck[i]


def _straight(speed, rng):
    target = rng.uniform(6.0, MAX_SPEED)
    return [_speed_change(speed, target, rng.uniform(0.8, 2.3)), _hold(rng.uniform(3, 15))]


def _bend(speed, rng):
    """A bend of 10 to 70 degrees, in which the driver may also change speed."""
    target = speed if rng.uniform() < 0.5 else float(np.clip(speed + rng.uniform(-5, 5), 4.0, MAX_SPEED))
    angle = rng.choice([-1, 1]) * np.radians(rng.uniform(10, 70))
    return [_curve(speed, target, angle, rng.uniform(0.8, 2.0)), _hold(rng.uniform(1, 6))]


def _double_bend(speed, rng):
    angle = rng.choice([-1, 1]) * np.radians(rng.uniform(15, 40))
    return [_curve(speed, speed, angle, 1.8), _curve(speed, speed, -angle, 1.8), _hold(2.0)]


def _turn(speed, rng):
    """Slow down, turn a right angle, speed up again."""
    corner = rng.uniform(3.5, 7.0)
    angle = rng.choice([-1, 1]) * np.pi / 2
    acceleration = rng.uniform(1.2, 2.3)
    return [_speed_change(speed, corner, acceleration), _curve(corner, corner, angle, 2.4), _hold(rng.uniform(0.5, 2)),
            _speed_change(corner, rng.uniform(7, 15), acceleration), _hold(rng.uniform(2, 8))]


def _stop(speed, rng):
    """Stop, stand for a while, drive on."""
    return [_speed_change(speed, 0.0, rng.uniform(1.0, 2.3)), _hold(rng.uniform(4, 20)),
            _speed_change(0.0, rng.uniform(6, 14), rng.uniform(1.0, 2.3)), _hold(rng.uniform(1, 5))]


def _cruise(speed, rng):
    """A long straight at constant speed, which a standstill detector may take for a standstill."""
    return [_speed_change(speed, rng.uniform(10.0, 28.0), rng.uniform(0.8, 1.5)), _hold(rng.uniform(20, 60))]


def _red_light(speed, rng):
    """Stop for longer, creep forward in between, drive on."""
    creep = rng.uniform(0.5, 1.5)
    return [_speed_change(speed, 0.0, rng.uniform(1.0, 2.3)), _hold(rng.uniform(5, 30)), _speed_change(0.0, creep, 0.6),
            _hold(rng.uniform(2, 6)), _speed_change(creep, 0.0, 0.6), _hold(rng.uniform(3, 30)),
            _speed_change(0.0, rng.uniform(6, 14), rng.uniform(1.0, 2.3)), _hold(rng.uniform(1, 5))]


def _stop_and_go(speed, rng):
    """Drive slowly and steadily, stop, stand, move up at half the speed."""
    slow = rng.uniform(0.8, 4.0)
    return [_speed_change(speed, slow, 0.8), _hold(rng.uniform(3, 15)), _speed_change(slow, 0.0, 0.8),
            _hold(rng.uniform(2, 25)), _speed_change(0.0, slow / 2, 0.6), _hold(rng.uniform(2, 8))]


def _reverse(speed, rng):
    """Stop, reverse round a corner, drive on."""
    back, angle = rng.uniform(-2.5, -1.2), rng.choice([-1, 1]) * rng.uniform(0.2, 0.5)
    return [_speed_change(speed, 0.0, rng.uniform(1.0, 2.0)), _hold(rng.uniform(2, 6)), _speed_change(0.0, back, 0.8),
            Segment(4.0, 0.0, angle), _speed_change(back, 0.0, 0.8), _hold(rng.uniform(1, 5)),
            _speed_change(0.0, rng.uniform(6, 12), 1.5), _hold(rng.uniform(2, 5))]


def _robot_straight(speed, rng):
    return [_hold(rng.uniform(10, 40))]


def _robot_turn(speed, rng):
    """A turn on a circle of a metre or two."""
    return [Segment(_on_grid(rng.uniform(6, 12)), 0.0, rng.choice([-1, 1]) * rng.uniform(0.5, 1.8)),
            _hold(rng.uniform(2, 10))]


def _robot_on_the_spot(speed, rng):
    """Stop, turn on the spot, go on."""
    return [_speed_change(speed, 0.0, 0.3), _hold(rng.uniform(2, 6)),
            Segment(_on_grid(rng.uniform(5, 10)), 0.0, rng.choice([-1, 1]) * rng.uniform(0.8, 3.0)),
            _hold(rng.uniform(1, 4)), _speed_change(0.0, speed, 0.3)]


def _hold(duration):
    return Segment(_on_grid(duration))


def _speed_change(speed, target, acceleration):
    """From `speed` to `target` with a peak of `acceleration`, or less where the jerk would be too large."""
    change = target - speed
    duration = max(_PEAK_RATE * abs(change) / acceleration, math.sqrt(_PEAK_CURVATURE * abs(change) / MAX_JERK))
    return Segment(_on_grid(duration), speed_change=change)


def _curve(speed, target, angle, lateral_acceleration):
    """A curve of `angle` whose lateral acceleration and radius stay within bounds at the faster of both speeds."""
    fastest, change = max(speed, target), abs(target - speed)
    lateral = min(lateral_acceleration, fastest**2 / MIN_RADIUS)
    duration = max(_PEAK_RATE * abs(angle) * fastest / lateral,
                   math.sqrt(_PEAK_CURVATURE * abs(angle) * fastest / MAX_JERK),
                   _speed_change(speed, target, 1.0).duration if change else 0.0)
    return Segment(_on_grid(duration), target - speed, angle)


def _on_grid(duration):
    """`duration` rounded up to the time grid, one step at least."""
    return max(math.ceil(duration / _TIME_GRID - 1e-9), 1) * _TIME_GRID


#: the kinds of manoeuvres of a drive, to be shuffled: a city with short stops, one with everything, dense traffic, a
#: slow robot
CITY = (_turn, _bend, _straight, _turn, _bend, _stop, _turn, _straight, _double_bend, _bend)
MIXED = (_turn, _bend, _straight, _stop, _turn, _cruise, _bend, _red_light, _turn, _straight, _double_bend, _cruise,
         _bend, _stop, _reverse)
TRAFFIC = (_stop_and_go, _stop_and_go, _stop_and_go, _turn)
SLOW = (_robot_straight, _robot_turn, _robot_on_the_spot, _robot_straight, _robot_turn)


def _turns(angle, speed):
    corner = min(speed, 6.0)
    return [_speed_change(speed, corner, 2.0), _curve(corner, corner, angle, 2.4), _speed_change(corner, speed, 2.0)]


#: manoeuvres that a driver can be asked for, in words, as segments for a given speed that begin and end at that speed
ASKED = {
    'driving straight on': lambda speed: [],
    'a left turn at a crossing': lambda speed: _turns(-np.pi / 2, speed),
    'a right turn at a crossing': lambda speed: _turns(np.pi / 2, speed),
    'a left and a right turn': lambda speed: _turns(-np.pi / 2, speed) + _turns(np.pi / 2, speed),
    'braking to a stop and driving off': lambda speed: [
        _speed_change(speed, 0.0, 2.0), _hold(3.0), _speed_change(0.0, speed, 2.0)],
    'braking and speeding up again': lambda speed: [
        _speed_change(speed, 0.4 * speed, 2.3), _speed_change(0.4 * speed, speed, 2.3)] * 2,
    'a slalom of bends': lambda speed: [_curve(speed, speed, sign * 0.6, 2.2) for sign in (-0.5, 1, -1, 1, -0.5)],
    'a full circle': lambda speed: [_speed_change(speed, 4.0, 2.0), _curve(4.0, 4.0, 2 * np.pi, 1.5),
                                    _speed_change(4.0, speed, 2.0)],
}


def asked(name: str, speed: float, before: float, duration: float) -> tuple[tuple[Segment, ...], float]:
    """A standstill and a drive of `before` s or more that lets a filter start, one of ASKED, and straight on until
    `duration` s have gone since. speed: m/s. Returns the time, s, at which that one begins, too."""
    opening = [Segment(25.0), _speed_change(0.0, speed, 1.5), Segment(10.0), *_turns(np.pi / 2, speed)]
    opening.append(_hold(max(before - sum(s.duration for s in opening), 1.0)))
    course = ASKED[name](speed)
    rest = _hold(max(duration - sum(s.duration for s in course), 0.0) + 10.0)
    return (*opening, *course, rest), sum(s.duration for s in opening)
