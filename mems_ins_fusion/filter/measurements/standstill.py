"""Pseudo-measurements at standstill: velocity zero, and angular rate zero, so that the gyroscopes show their errors."""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ..memory import WHITE, Error, Event, Nav, Sample, channel_of
from .geometry import add, add_sensor_error

#: rad/s (0.2 deg/h), smallest standard deviation of an angular rate at a standstill: less than any gyroscope resolves.
#: One that shows zeros only, and is configured without noise, would have none
SMALLEST_RATE_SIGMA = 1e-6


@njit(_nrt=False)
def observe_velocity(mem, r, at, h, n, dimensions, variance):
    """Zero velocity to north and east and, of three `dimensions`, down, each with `variance`, m^2/s^2."""
    for k in range(dimensions):
        mem[at + Event.Z_N + k] = mem[r + Nav.V_N + k]
        add(mem, h + n * k, Error.V_N + k, 1.0)
    mem[at + Event.R_NN] = mem[at + Event.R_EE] = mem[at + Event.R_DD] = variance
    mem[at + Event.R_NE] = 0.0


@njit(_nrt=False)
def observe_rate(mem, at, h, n, sample):
    """Zero angular rate, about the axes that are used: the IMU sample at `sample` is error and white noise. Returns the
    number of components."""
    count = 0
    for axis in range(3):
        if channel_of(mem, 3 + axis) >= 0:
            mem[at + Event.Z_N + count] = mem[sample + Sample.W_X + axis]
            mem[at + Event.Z_N + count] += add_sensor_error(mem, h + n * count, sample, 3 + axis, 1.0)
            mem[at + (Event.R_NN, Event.R_EE, Event.R_DD)[count]] = _variance(mem, axis, sample)
            count += 1
    mem[at + Event.R_NE] = 0.0
    return count


@njit(_nrt=False)
def _variance(mem, axis, sample):
    """Variance of one gyroscope sample: white noise, or the scatter of the samples where the engine's vibration makes
    it larger."""
    return max(mem[WHITE + 3 + axis] / mem[sample + Sample.INTERVAL], mem[sample + Sample.RATE_SCATTER],
               SMALLEST_RATE_SIGMA**2)
