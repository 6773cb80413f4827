"""What a smoother needs of the time between two states that it keeps, gathered while the filter runs.

Whatever happens in between - predictions, corrections, however many - an error e of the estimate at the first state
becomes T e (and noise) at the second, and the innovations in between tell of it g and G:

    prediction      T <- Phi T
    correction      g <- g + T^T H^T z / s,  G <- G + T^T H^T H T / s,  T <- (I - K H) T

z with x already taken out. From the second state back to the first: lambda <- T^T lambda + g and
Lambda <- T^T Lambda T + G (`smoothing.py`). Stands at the end of the filter's memory, where a smoother asked for it:
T (n, n) | G (n, n) | g (n) | room to work (n).
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from .memory import Head


def history_size(n: int) -> int:
    """Floats of the history of n states."""
    return 2 * n * n + 2 * n


@njit(_nrt=False)
def begin(mem, n):
    """A new history: nothing has happened yet."""
    at = int(mem[Head.HISTORY_AT])
    for i in range(at, at + 2 * n * n + 2 * n):
        mem[i] = 0.0
    for i in range(n):
        mem[at + (n + 1) * i] = 1.0


@njit(_nrt=False)
def corrected(mem, n, h, column, residual, s):
    """A scalar correction: row H at `h`, P H^T at `column`, its innovation and the variance of that."""
    t = int(mem[Head.HISTORY_AT])
    told = t + n * n
    g = told + n * n
    u = g + n
    for j in range(n):
        mem[u + j] = 0.0
    for i in range(n):
        if mem[h + i] != 0.0:
            for j in range(n):
                mem[u + j] += mem[h + i] * mem[t + n * i + j]
    for i in range(n):
        share, gain = mem[u + i] / s, mem[column + i] / s
        mem[g + i] += share * residual
        for j in range(n):
            mem[told + n * i + j] += share * mem[u + j]
            mem[t + n * i + j] -= gain * mem[u + j]


@njit(_nrt=False)
def forget(mem, i, n):
    """State i starts anew: what comes tells nothing of its error before."""
    if mem[Head.HISTORY_AT] > 0.0:
        at = int(mem[Head.HISTORY_AT]) + n * i
        for k in range(at, at + n):
            mem[k] = 0.0


@njit(_nrt=False)
def lose(mem, n):
    """All states start anew, and what has been gathered may not be a number."""
    if mem[Head.HISTORY_AT] == 0.0:
        return
    at = int(mem[Head.HISTORY_AT])
    for i in range(at, at + 2 * n * n + n):
        if i < at + n * n or not math.isfinite(mem[i]):
            mem[i] = 0.0


@njit(_nrt=False)
def take(mem, r, n, out):
    """Row r and what has been gathered since the last call into `out`, then a new history."""
    width, at = int(mem[Head.WIDTH]), int(mem[Head.HISTORY_AT])
    for i in range(width):
        out[i] = mem[r + i]
    for i in range(2 * n * n + n):
        out[width + i] = mem[at + i]
    begin(mem, n)
