"""Whether the vehicle stands, as the inertial sensors show it: the one detector of the filter."""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from .layout import Head, Sample

#: time constant of the running means that tell a standstill, s
STILL_TIME = 0.5
#: how long, s, these means must have stayed within so much of the specific force, m/s^2
STEADY_TIME, STEADY_ACCELERATION = 1.0, 0.05


@njit(_nrt=False)
def is_still(memory, sample, dt):
    """1 when specific force and angular rate scatter little, nothing turns, and their means have been steady for a
    while: who starts or stops gently is quiet, but not that."""
    weight = min(1.0, dt / STILL_TIME)
    turn = 0.0
    for half in range(2):
        variance = 0.0
        for i in range(3 * half, 3 * half + 3):
            deviation = memory[sample + Sample.F_X + i] - memory[Head.STILL_MEAN + i]
            memory[Head.STILL_MEAN + i] += weight * deviation
            variance += deviation * deviation
            if half == 1:
                turn = max(turn, abs(memory[Head.STILL_MEAN + i]))
        memory[Head.STILL_VARIANCE_F + half] += weight * (variance - memory[Head.STILL_VARIANCE_F + half])
    steady = (memory[Head.STILL_VARIANCE_F] < 3.0 * memory[Head.STILL_ACCELERATION] ** 2
              and memory[Head.STILL_VARIANCE_W] < 3.0 * memory[Head.STILL_RATE] ** 2
              and turn < memory[Head.STILL_RATE])
    for i in range(3):
        if abs(memory[Head.STILL_MEAN + i] - memory[Head.STILL_REFERENCE + i]) > STEADY_ACCELERATION:
            steady = False
    time = memory[sample + Sample.TIME]
    if not steady:
        memory[Head.STILL_SINCE] = time
        for i in range(3):
            memory[Head.STILL_REFERENCE + i] = memory[Head.STILL_MEAN + i]
    return 1.0 if time - memory[Head.STILL_SINCE] >= STEADY_TIME else 0.0
