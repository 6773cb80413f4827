"""Whether the vehicle stands, as the accelerometers show it: the filter's one detector, which learns from the vehicle.

The scatter of samples does not separate an idling engine from a smooth road. What does is what is left of the specific
force below a hertz or so: no road is so even and no driver so steady that pitch, grade, bank and speed keep still, and
an engine shakes faster. How much there is in motion and at rest is learned, as every vehicle and every mount has its
own: the quietest motion while the filter is certain that the vehicle moves, and the level at rest well below it.
studies/standstill.py compares this with fixed thresholds and counts false and missed seconds.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from .layout import Head, Sample

#: low pass, running mean, running energy, and how long it must have been quiet, s
LOW_PASS, MEAN_TIME, ENERGY_TIME, DURATION = 0.2, 0.5, 0.7, 1.0
#: a standstill is quieter than the quietest motion by this factor, and may be louder than other standstills by the same
SEPARATION = 2.0
#: the quietest motion is forgotten with this time constant, the level at rest is a mean over that, s
FORGET, REST = 600.0, 5.0
#: what is expected of a vehicle of which nothing is known yet, m/s^2: it is learned within a minute
EXPECTED_MOTION, EXPECTED_REST = 0.05, 0.01
#: so far above the threshold a single sample ends a standstill
JUMP = 4.0


@njit(_nrt=False)
def is_still(mem, sample, dt, moving, anew):
    """1 when the sample at `sample`, dt s after the one before, is one of a standstill; its state is in the head.

    moving: whether the filter is certain that the vehicle moves. anew: whether nothing is known of the time before the
    sample, so that a change of its specific force since then says nothing.
    """
    low, slow, energy = min(1.0, dt / LOW_PASS), min(1.0, dt / MEAN_TIME), 0.0
    first = mem[Head.STILL_ENERGY] == 0.0
    for i in range(3):
        f = mem[sample + Sample.F_X + i]
        if first or anew:
            mem[Head.STILL_FIRST + i] = mem[Head.STILL_SECOND + i] = mem[Head.STILL_MEAN + i] = f
        mem[Head.STILL_FIRST + i] += low * (f - mem[Head.STILL_FIRST + i])
        mem[Head.STILL_SECOND + i] += low * (mem[Head.STILL_FIRST + i] - mem[Head.STILL_SECOND + i])
        deviation = mem[Head.STILL_SECOND + i] - mem[Head.STILL_MEAN + i]
        mem[Head.STILL_MEAN + i] += slow * deviation
        energy += deviation * deviation
    if first:
        mem[Head.STILL_ENERGY] = EXPECTED_MOTION**2
        mem[Head.STILL_MOTION], mem[Head.STILL_REST] = math.log(EXPECTED_MOTION), math.log(EXPECTED_REST)
    elif anew:  # it may stand by now: as loud as the quietest motion, till it shows more
        mem[Head.STILL_ENERGY] = min(mem[Head.STILL_ENERGY], math.exp(2.0 * mem[Head.STILL_MOTION]))
    mem[Head.STILL_ENERGY] += min(1.0, dt / ENERGY_TIME) * (energy - mem[Head.STILL_ENERGY])
    level, separation = 0.5 * math.log(max(mem[Head.STILL_ENERGY], 1e-12)), math.log(SEPARATION)
    motion, rest = mem[Head.STILL_MOTION], mem[Head.STILL_REST]
    if moving:  # the least there is: down at once, though not by one sample alone, and up slowly
        motion = min(motion + dt / FORGET, max(level, motion - 2.0 * dt))
    elif level < motion - separation:
        rest += min(1.0, dt / REST) * (level - rest)
    mem[Head.STILL_MOTION], mem[Head.STILL_REST] = motion, rest
    threshold = min(max(0.5 * (motion + rest), rest + separation), motion - separation)
    quiet = level < threshold and energy < JUMP**2 * math.exp(2.0 * threshold) and not moving
    mem[Head.STILL_SINCE] = mem[Head.STILL_SINCE] + dt if quiet else 0.0
    return 1.0 if mem[Head.STILL_SINCE] >= DURATION else 0.0
