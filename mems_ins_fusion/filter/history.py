"""Smoother data accumulated by the forward filter between two stored states.

Over all predictions and corrections in between, an error e of the estimate at the first state becomes T e (plus noise)
at the second, and the innovations in between carry the information vector g and matrix G about e:

    prediction      T <- Phi T
    correction      g <- g + T^T H^T z / s,  G <- G + T^T H^T H T / s,  T <- (I - K H) T

z is the innovation minus H x. From the second state back to the first: lambda <- T^T lambda + g and
Lambda <- T^T Lambda T + G (`runs/smoothing.py`). Layout, at the end of the memory of a filter that is to be smoothed:
T (n, n) | G (n, n) | g (n) | scratch (n).
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from .memory import Head, copy


def history_size(n: int) -> int:
    """Number of floats of the history of n states."""
    return 2 * n * n + 2 * n


@njit(_nrt=False)
def begin(mem, n):
    """Empty history: T is the identity, g and G are zero."""
    at = int(mem[Head.HISTORY_AT])
    for i in range(at, at + 2 * n * n + 2 * n):
        mem[i] = 0.0
    for i in range(n):
        mem[at + (n + 1) * i] = 1.0


@njit(_nrt=False)
def note_correction(mem, n, h, column, residual, s):
    """Add a scalar correction. h, column: positions of the row H and of P H^T. residual: innovation minus H x. s: its
    variance."""
    t = int(mem[Head.HISTORY_AT])
    information = t + n * n
    g = information + n * n
    u = g + n  # H T
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
            mem[information + n * i + j] += share * mem[u + j]
            mem[t + n * i + j] -= gain * mem[u + j]


@njit(_nrt=False)
def forget(mem, i, n):
    """State i was reset: later innovations carry no information about its earlier error."""
    if mem[Head.HISTORY_AT] > 0.0:
        at = int(mem[Head.HISTORY_AT]) + n * i
        for k in range(at, at + n):
            mem[k] = 0.0


@njit(_nrt=False)
def lose(mem, n):
    """All states were reset because they were not finite; g and G may not be finite either."""
    if mem[Head.HISTORY_AT] == 0.0:
        return
    at = int(mem[Head.HISTORY_AT])
    for i in range(at, at + 2 * n * n + n):
        if i < at + n * n or not math.isfinite(mem[i]):
            mem[i] = 0.0


@njit(_nrt=False)
def take(mem, r, n, out):
    """Copy row r and the history since the previous call into `out`, and begin an empty history."""
    width, at = int(mem[Head.WIDTH]), int(mem[Head.HISTORY_AT])
    copy(out, 0, mem, r, width)
    copy(out, width, mem, at, 2 * n * n + n)
    begin(mem, n)
