"""Lag of the fixes of a receiver that smooths its positions.

The receiver's filter is modelled as a critically damped tracking filter with constant velocity (alpha-beta filter; Y.
Bar-Shalom et al., *Estimation with Applications to Tracking and Navigation*, 2001, 6.5). Its position lags by
tau^2 s^2 / (1 + tau s)^2 times the true one, which is tau times the changes of velocity that it has not followed yet.
tau^2 is the parameter `gnss.lag_per_acceleration`.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, ROW, Nav

#: of the settings
LagSettings = HEAD.place(
    'LagSettings',
    GAIN=1,  # s, lag of a fix, m, for each m/s that the receiver's filter has not followed
    TIME=1)  # s, time constant of the receiver's filter; 0: it has none
#: of a state: changes of velocity that the receiver's filter has not followed yet, m/s
Lag = ROW.place('Lag', FIRST_POLE=3, UNFOLLOWED=3)


@njit(_nrt=False)
def fall_behind(mem, src, dst, dt):
    """Predict the changes of velocity that are not followed yet from the state at src to that at dst, dt s later."""
    keep = math.exp(-dt / mem[LagSettings.TIME])
    for k in range(3):
        first = keep * mem[src + Lag.FIRST_POLE + k] + mem[dst + Nav.V_N + k] - mem[src + Nav.V_N + k]
        mem[dst + Lag.FIRST_POLE + k] = first
        mem[dst + Lag.UNFOLLOWED + k] = first + keep * (mem[src + Lag.UNFOLLOWED + k] - first)


@njit(_nrt=False)
def behind(mem, r, axis):
    """Lag of a fix at the time of the state at r, m north, east or down (axis 0 to 2)."""
    return mem[LagSettings.GAIN] * mem[r + Lag.UNFOLLOWED + axis]
