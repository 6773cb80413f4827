"""Correction of a state by a measurement (Eq. 6 to 8), the same for fixes, speeds, headings, constraints, standstills.

A measurement fills its event and its rows of H (see `measurements`); `update` forms the innovation, applies the
innovation gate and the robust weight, and corrects. All functions work on the flat memory of the filter: `r` is the
position of a state, `at` that of an event (`Event`). Called by `apply.py` (measurements) and `constraints.py` (vehicle
constraints).
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit
from mems_ins_fusion.compiled_lanes import LANES, four, put

from . import history
from .measurements.geometry import turn_attitude
from .memory import (
    NAV,
    Error,
    Event,
    Head,
    Nav,
    Verdict,
    load_covariance,
    nonnegative,
    row_of,
    store_covariance,
)

#: sigmas: for a larger normalized innovation R is raised until it has this value (Huber). For fixes, the parameter
#: gnss.robust_sigma takes its place and has the same default. A quarter of it makes the mean error larger by 10 %
#: (docs/ablation.md)
ROBUST = 3.0


@njit(_nrt=False)
def project(mem, n, h, column):
    """Write P H^T to `column` (n,) and return H P H^T. h: position of the row H; P is at the begin of the scratch."""
    p, h, column = nonnegative(int(mem[Head.SCRATCH_AT])), nonnegative(h), nonnegative(column)
    before, last = _last_blocks(n)
    for i in range(n):
        mem[column + i] = 0.0
    for j in range(n):
        factor, row = mem[h + j], nonnegative(p + n * j)
        if factor != 0.0:
            for block in range(before):
                i = LANES * block
                put(mem, column + i, four(mem, column + i) + factor * four(mem, row + i))
            i, end = LANES * before, four(mem, column + last) + factor * four(mem, row + last)
            put(mem, column + i, four(mem, column + i) + factor * four(mem, row + i))
            put(mem, column + last, end)
    return product(mem, n, h, column)


@njit(inline='always')
def _last_blocks(n):
    """Of n columns: how many blocks of four come before the last two, and the first column of the last block, which may
    overlap with the one before it: both are read before one of them is written."""
    return max(n // LANES - 1, 0), nonnegative(n - LANES)


@njit(_nrt=False)
def product(mem, n, h, column):
    """Product of the row H at `h` and the vector at `column`."""
    h, column, total = nonnegative(h), nonnegative(column), 0.0
    for i in range(n):
        total += mem[h + i] * mem[column + i]
    return total


@njit(_nrt=False)
def correct_by_scalar(mem, r, n, h, column, z, s):
    """Correct x and P with one scalar measurement z = H x + noise.

    h, column: positions of the row H and of P H^T. s: variance of the innovation. P - K H P is computed such that P
    stays symmetric to the last bit.
    """
    p, x, h, column = nonnegative(int(mem[Head.SCRATCH_AT])), nonnegative(r + NAV), nonnegative(h), nonnegative(column)
    residual, inverse = z - product(mem, n, h, x), 1.0 / s
    for i in range(n):
        mem[x + i] += mem[column + i] * inverse * residual
    before, last = _last_blocks(n)
    for block in range(before):  # four columns of P at once
        others, at = four(mem, column + LANES * block), p + LANES * block
        for i in range(n):
            put(mem, at + n * i, four(mem, at + n * i) - mem[column + i] * others * inverse)
    others, at = four(mem, column + LANES * before), p + LANES * before
    others_last, at_last = four(mem, column + last), p + last
    for i in range(n):
        end = four(mem, at_last + n * i) - mem[column + i] * others_last * inverse
        put(mem, at + n * i, four(mem, at + n * i) - mem[column + i] * others * inverse)
        put(mem, at_last + n * i, end)
    if mem[Head.HISTORY_AT] > 0.0:
        history.note_correction(mem, n, h, column, residual, s)


@njit(_nrt=False)
def normalized_square(a, b, s_nn, s_ne, s_ee):
    """Normalized innovation squared (NIS) of the innovation (a, b) with the covariance [[s_nn, s_ne], [s_ne, s_ee]]."""
    return (s_ee * a * a - 2.0 * s_ne * a * b + s_nn * b * b) / (s_nn * s_ee - s_ne * s_ne)


@njit(_nrt=False)
def update(mem, r, at, n, dimensions, factor, repeated, robust, gate, robust_alone):
    """Correct the state at r with the event at `at`, whose rows of H follow P in the scratch. Returns the `Verdict`.

    dimensions: number of components, 1 to 3. factor: multiplies the covariance R of the event. repeated: number of
    successive measurements with the same error, which together count as one. The tests are applied to the measurement
    alone; then R is multiplied by this number. robust: if the normalized innovation is larger, R is raised until it has
    this value. gate: a larger normalized innovation is refused. robust or gate 0: not applied. The first two components
    have a common normalized innovation. The third has its own, with robust_alone instead of robust, and beyond the gate
    only the third is left out.
    """
    p = int(mem[Head.SCRATCH_AT])
    h = p + n * n
    column = h + 3 * n
    r_nn, r_ne = factor * mem[at + Event.R_NN], factor * mem[at + Event.R_NE]
    r_ee, r_dd = factor * mem[at + Event.R_EE], factor * mem[at + Event.R_DD]
    z_n, z_e, z_d = mem[at + Event.Z_N], mem[at + Event.Z_E], mem[at + Event.Z_D]
    for k in range(dimensions):
        for i in range(n):
            mem[at + Event.Z_N + k] -= mem[h + n * k + i] * mem[r + NAV + i]
    a, b = mem[at + Event.Z_N], mem[at + Event.Z_E]
    s_nn, s_ne, s_ee = r_nn + project(mem, n, h, column), 0.0, 0.0
    if dimensions == 1:
        nis = a * a / s_nn
    else:
        s_ne = r_ne + product(mem, n, h + n, column)
        s_ee = r_ee + project(mem, n, h + n, column)
        nis = normalized_square(a, b, s_nn, s_ne, s_ee)
    mem[at + Event.S_NN], mem[at + Event.S_NE], mem[at + Event.S_EE] = s_nn, s_ne, s_ee
    mem[at + Event.NIS], mem[at + Event.WEIGHT] = nis, 1.0
    verdict = Verdict.USED
    if gate > 0.0 and nis > gate * gate:
        mem[at + Event.WEIGHT] = 0.0
        return Verdict.REFUSED
    if robust > 0.0 and nis > robust * robust:  # R is raised until the normalized innovation is `robust`
        inflation = nis / (robust * robust) - 1.0
        r_nn, r_ne, r_ee = r_nn + inflation * s_nn, r_ne + inflation * s_ne, r_ee + inflation * s_ee
        verdict = Verdict.WEIGHTED
        mem[at + Event.WEIGHT] = 1.0 / (1.0 + inflation)
    r_nn, r_ne, r_ee = repeated * r_nn, repeated * r_ne, repeated * r_ee

    if dimensions > 2:
        s_dd = r_dd + project(mem, n, h + 2 * n, column)
        mem[at + Event.S_DD] = s_dd
    _correct_first_two(mem, r, n, dimensions, z_n, z_e, r_nn, r_ne, r_ee)
    if dimensions > 2:
        down = mem[at + Event.Z_D] ** 2 / s_dd
        if gate > 0.0 and down > gate * gate:
            return verdict
        if robust_alone > 0.0 and down > robust_alone * robust_alone:
            r_dd += (down / (robust_alone * robust_alone) - 1.0) * s_dd
        s = repeated * r_dd + project(mem, n, h + 2 * n, column)
        correct_by_scalar(mem, r, n, h + 2 * n, column, z_d, s)
    return verdict


@njit(_nrt=False)
def _correct_first_two(mem, r, n, dimensions, z_n, z_e, r_nn, r_ne, r_ee):
    """Correct the state at r with the first one or two components of a measurement, decorrelated with the Cholesky
    factor of R, one after the other. Their rows of H follow P in the scratch, and are divided by that factor."""
    h = int(mem[Head.SCRATCH_AT]) + n * n
    column = h + 3 * n
    l_nn = math.sqrt(r_nn)
    for i in range(n):
        mem[h + i] /= l_nn
    z_n /= l_nn
    s = 1.0 + project(mem, n, h, column)
    correct_by_scalar(mem, r, n, h, column, z_n, s)
    if dimensions > 1:
        l_en = r_ne / l_nn
        l_ee = math.sqrt(r_ee - l_en * l_en)
        for i in range(n):
            mem[h + n + i] = (mem[h + n + i] - l_en * mem[h + i]) / l_ee
        z_e = (z_e - l_en * z_n) / l_ee
        s = 1.0 + project(mem, n, h + n, column)
        correct_by_scalar(mem, r, n, h + n, column, z_e, s)


@njit(_nrt=False)
def feed_back(mem, r):
    """Closed loop: correct the navigation solution by the estimated errors and set these to zero. Open loop: nothing.
    """
    if mem[Head.OPEN_LOOP] != 0.0:
        return
    x, size = r + NAV, int(mem[Head.N_NAVIGATION])
    mem[r + Nav.LATITUDE] -= _error(mem, x, Error.R_N) * mem[r + Nav.NORTH_SCALE]
    mem[r + Nav.LONGITUDE] -= _error(mem, x, Error.R_E) * mem[r + Nav.EAST_SCALE]
    mem[r + Nav.HEIGHT] += _error(mem, x, Error.R_D)
    for k in range(3):
        mem[r + Nav.V_N + k] -= _error(mem, x, Error.V_N + k)
    turn_attitude(mem, r, _error(mem, x, Error.PHI_N), _error(mem, x, Error.PHI_E), _error(mem, x, Error.PHI_D))
    for i in range(size):
        mem[x + i] = 0.0


@njit(_nrt=False)
def _error(mem, x, error):
    """Estimate of one of the nine navigation errors (`Error`), zero where it is not a state; x: position of state 0."""
    state = row_of(mem, error)
    return mem[x + state] if state >= 0 else 0.0


@njit(_nrt=False)
def scratch_of(mem):
    """Number of states n, and the position in the scratch of P (n, n) of the state that is being corrected."""
    return int(mem[Head.N_NAVIGATION]) + int(mem[Head.N_AUGMENTED]), int(mem[Head.SCRATCH_AT])


@njit(_nrt=False)
def begin_update(mem, r):
    """Write P of the state at r to the scratch and set the rows of H behind it to zero.

    Returns the number of states n and the position of the first row of H.
    """
    n, p = scratch_of(mem)
    load_covariance(mem, r, int(mem[Head.N_NAVIGATION]), int(mem[Head.N_AUGMENTED]), mem, p)
    clear_rows(mem, p + n * n, n)
    return n, p + n * n


@njit(_nrt=False)
def end_update(mem, r):
    """Write the corrected P from the scratch to the state at r, and feed the estimated errors back (`feed_back`)."""
    store_covariance(mem, int(mem[Head.SCRATCH_AT]), int(mem[Head.N_NAVIGATION]), int(mem[Head.N_AUGMENTED]), mem, r)
    feed_back(mem, r)


@njit(_nrt=False)
def clear_rows(mem, h, n):
    """Set the three rows of H at `h` to zero."""
    for i in range(3 * n):
        mem[h + i] = 0.0
