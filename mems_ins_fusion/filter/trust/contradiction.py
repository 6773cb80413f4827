"""An IMU that is wrong although its samples are finite and in range.

Its axes are swapped, a gyroscope is off by degrees per second, a loose mount makes noise. The fixes then do not fit,
which looks as if they were wrong. The non-holonomic constraint tells the two apart: with such an IMU the vehicle seems
to slide sideways, more than is usual for this vehicle (the constraint's sigma is a bound for every car and road).
Velocity and heading are then made as uncertain as the slide is large, and for EXCLUDED_TIME the filter does without
the IMU: it goes straight on between fixes, with a covariance that knows how land vehicles accelerate.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import Head, Nav, velocity_state, yaw_state
from . import hypotheses
from .force_noise import ForceNoise
from .scale import Inputs, reset_scale

#: s over which the normalized innovation squared (NIS) of the lateral constraint is averaged: its errors last about as
#: long
SLIDING_TIME = 1.0
#: s over which the usual NIS of a vehicle is averaged: some bends and some straights
USUAL_TIME = 30.0
#: usual NIS before any has been seen: half a sigma, as the constraint's sigma is a bound for all vehicles
FIRST_USUAL = 0.25
#: a NIS of more than this many times the usual counts as that: one slide must not become the usual
LARGEST_RATIO = 10.0
#: a slide is a mean NIS of this many times the usual: measured drives stay below 29
SLIDE_RATIO = 40.0
#: and this mean NIS at least: below half a sigma there is nothing to explain, however quiet the vehicle usually is
SMALLEST_SLIDE_NIS = 0.2
#: s for which the IMU is not used after a slide. Faults of an IMU that are no defect last for seconds; a slide that
#: goes on begins it again. Chosen: 5 s let a car with much sideslip go 100 m off, 20 s cost more with rare fixes
EXCLUDED_TIME = 10.0
#: s since the last fix above which the IMU is used all the same: a fix each ten seconds still counts
LONGEST_WITHOUT_FIX = 10.0
#: m/s, speed below which a slide tells no more of the heading than at it: the ratio of the two would be without bound
SLOWEST_SPEED = 1.0


@njit(_nrt=False)
def slides(mem, r, innovation, s, since):
    """Whether the IMU has the vehicle slide as it does not usually.

    innovation, s: of the lateral constraint, m/s, and its variance. since: s from the one before.
    """
    nis = innovation * innovation / s
    usual = mem[r + Nav.USUAL_SLIDING_NIS]
    mem[r + Nav.SLIDING_NIS] += (nis - mem[r + Nav.SLIDING_NIS]) * min(since / SLIDING_TIME, 1.0)
    mem[r + Nav.USUAL_SLIDING_NIS] += (min(nis, LARGEST_RATIO * usual) - usual) * min(since / USUAL_TIME, 1.0)
    return mem[r + Nav.SLIDING_NIS] > max(SLIDE_RATIO * usual, SMALLEST_SLIDE_NIS)


@njit(_nrt=False)
def exclude_imu(mem, r, n, innovation):
    """The IMU is not used for EXCLUDED_TIME after a slide of `innovation`, m/s."""
    raise_uncertainty(mem, r, n, innovation)
    time, until = mem[r + Nav.TIME], mem[r + Nav.EXCLUDED_UNTIL]
    if mem[Inputs.COUNT] > 0.0 or time - mem[r + Nav.FIX_TIME] > LONGEST_WITHOUT_FIX:
        return  # it may be another input that is wrong, and without fixes nothing but the IMU tells of turns
    if time >= until:
        hypotheses.add_prior(mem, r, hypotheses.IMU_FAULT_PRIOR)
    mem[r + Nav.EXCLUDED_UNTIL] = time + EXCLUDED_TIME
    mem[r + Nav.EXCLUDED] += time + EXCLUDED_TIME - max(until, time)


@njit(_nrt=False)
def raise_uncertainty(mem, r, n, error):
    """Velocity and heading of P in the scratch less certain by an error of the velocity, m/s, of that size."""
    p, squared = int(mem[Head.SCRATCH_AT]), error * error
    speed = max(math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E]), SLOWEST_SPEED)
    first, yaw = velocity_state(mem), yaw_state(mem)
    for i in range(first, first + 2):
        mem[p + (n + 1) * i] += squared
    mem[p + (n + 1) * yaw] += squared / (speed * speed)


@njit(_nrt=False)
def recover_from_wrong_input(mem, r, n, of_heading):
    """The state at r has been misled by an input that is wrong for certain: its velocity is unknown, and its heading
    where the input is one. The innovations have been that input's, not the accelerometers'. P is in the scratch."""
    reset_scale(mem, r + ForceNoise.SCALE)
    speed = math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E])
    if of_heading:
        raise_uncertainty(mem, r, n, speed)
        return
    first = int(mem[Head.SCRATCH_AT]) + (n + 1) * velocity_state(mem)
    for i in range(2):
        mem[first + (n + 1) * i] += speed * speed
