"""A state of the filter as odometry: pose, twist and their covariances in the frames of REP 103."""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.compiled import njit

from ...navigation import strapdown
from ...navigation.earth import to_local
from ..memory import (
    NAV,
    Error,
    Head,
    Nav,
    Sample,
    StateLayout,
    channel_of,
    covariance,
    load_covariance,
    nonnegative,
    row_of,
    sample_at,
    state_at,
    variance_factor,
    velocity_state,
)
from ..prediction import UNKNOWN_TILT_SIGMA
from ..trust import imu_share
from ..trust.hypotheses import Hypothesis, spread
from ..trust.white_noise import density

#: first indices in the vector that `odometry` fills, and its size
POSITION, ORIENTATION, POSE_COVARIANCE, LINEAR, ANGULAR, TWIST_COVARIANCE, SIZE = 0, 3, 7, 43, 46, 49, 85
#: m/s, published standard deviation of the vertical velocity with the planar mechanization. Chosen, not measured
PLANAR_VERTICAL_SIGMA = 0.5


@njit
def estimated(row, r, rows, error):
    """Estimate of one of the nine navigation errors; zero where the mechanization does not have it."""
    return row[r + NAV + int(rows[error])] if rows[error] >= 0 else 0.0


@njit
def navigation_solution(row, r, rows, open_loop):
    """Latitude, longitude (rad), height (m), v_n, v_e, v_d (m/s) and the quaternion from b to n of the state at r.

    In open loop the estimated errors x are subtracted. rows (9,): `StateLayout.rows`.
    """
    if rows[Error.PHI_N] < 0:
        q = (math.cos(0.5 * row[r + Nav.YAW]), 0.0, 0.0, math.sin(0.5 * row[r + Nav.YAW]))
    else:
        q = (row[r + Nav.Q_W], row[r + Nav.Q_X], row[r + Nav.Q_Y], row[r + Nav.Q_Z])
    latitude, longitude, height = row[r + Nav.LATITUDE], row[r + Nav.LONGITUDE], row[r + Nav.HEIGHT]
    v_n, v_e, v_d = row[r + Nav.V_N], row[r + Nav.V_E], row[r + Nav.V_D]
    if open_loop:
        latitude -= estimated(row, r, rows, Error.R_N) * row[r + Nav.NORTH_SCALE]
        longitude -= estimated(row, r, rows, Error.R_E) * row[r + Nav.EAST_SCALE]
        height += estimated(row, r, rows, Error.R_D)
        v_n -= estimated(row, r, rows, Error.V_N)
        v_e -= estimated(row, r, rows, Error.V_E)
        v_d -= estimated(row, r, rows, Error.V_D)
        q = strapdown.correct_attitude(q, estimated(row, r, rows, Error.PHI_N), estimated(row, r, rows, Error.PHI_E),
                                       estimated(row, r, rows, Error.PHI_D))
    return latitude, longitude, height, v_n, v_e, v_d, q


@njit(_nrt=False)
def added_covariance(row, r, i, j):
    """Term that is added to P in the published covariance of the state at row[r]: element (i, j) of r_n, r_e, v_n, v_e.

    It contains the slow errors of the receiver (trust/receiver.py), what the lever arm may be off
    (`gnss.lever_arm_sigma`), and the difference to the second filter (trust/hypotheses.py).
    """
    apart = spread(row, r)
    own = 0.0
    if i == j and i < 2:
        own = row[r + Nav.LASTING] + row[r + Nav.ARM_VARIANCE] + row[r + Hypothesis.SPREAD_VARIANCE]
    return own + apart[i] * apart[j]


@njit(_nrt=False)
def add_to_covariance(full, at, n, first, row, r):
    """Add `added_covariance` of the state at row[r] to the covariance (n, n) at full[at]; first: index of v_n."""
    where = (0, 1, first, first + 1)
    for i in range(4):
        for j in range(4):
            full[nonnegative(at + n * where[i] + where[j])] += added_covariance(row, r, i, j)


def published_covariance(row: np.ndarray, layout: StateLayout) -> np.ndarray:
    """The published covariance (n, n) of the state in `row`."""
    full = variance_factor(row, 0) * covariance(row, layout)
    add_to_covariance(full.ravel(), 0, layout.n, layout.index('v_n'), row, 0)  # ravel: a view, it is contiguous
    return full


def widen_without_heading(start, datum, out: np.ndarray, geodetic: np.ndarray, geodetic_covariance: np.ndarray) -> None:
    """Change an `odometry`, in place, to one that may be published while the heading is unknown.

    The filter is linear in the heading error, which may be of any size here. So the position is set to that of `start`
    (a `Start`), and the distance that the filter has moved since is added to its standard deviation in both directions.
    """
    north, east, down = to_local(start.latitude, start.longitude, start.height, datum)
    distance = math.hypot(out[0] - east, out[1] - north)
    out[0], out[1], out[2] = east, north, -down
    geodetic[:] = start.latitude, start.longitude, start.height
    out[[POSE_COVARIANCE, POSE_COVARIANCE + 7]] += distance**2
    geodetic_covariance[[0, 4]] += distance**2


@njit
def odometry(memory, datum, height_sigma, out, geodetic, geodetic_covariance):
    """The newest state as odometry.

    datum: (3,) latitude, longitude (rad), height. height_sigma: m, used with the planar mechanization, which does not
    estimate the height.
    Outputs: out (SIZE,): position ENU; orientation x, y, z, w of base_link (FLU) in ENU; pose covariance 6 x 6; linear
    and angular velocity in base_link; twist covariance 6 x 6. geodetic (3,), geodetic_covariance (9,) ENU. Returns the
    time of the state, s.
    """
    n_navigation, m = int(memory[Head.N_NAVIGATION]), int(memory[Head.N_AUGMENTED])
    newest = int(memory[Head.SAMPLES])
    r, sample, n = state_at(memory, newest), sample_at(memory, newest), n_navigation + m
    full = int(memory[Head.SCRATCH_AT])  # n x n
    load_covariance(memory, r, n_navigation, m, memory, full)
    factor = variance_factor(memory, r)
    for k in range(full, full + n * n):
        memory[k] *= factor
    add_to_covariance(memory, full, n, velocity_state(memory), memory, r)
    latitude, longitude, height, v_n, v_e, v_d, q = navigation_solution(
        memory, r, memory[Head.ROWS:Head.ROWS + Error.SIZE], memory[Head.OPEN_LOOP] != 0.0)
    geodetic[0], geodetic[1], geodetic[2] = latitude, longitude, height
    north, east, down = to_local(latitude, longitude, height, datum)
    out[0], out[1], out[2] = east, north, -down
    _orientation(q, out)
    c = strapdown.matrix(q)

    # errors of position (n, e, d), velocity (n, e, d) and attitude (n, e, d) as one 9 x 9 covariance
    nine = np.zeros(81)
    for i in range(9):
        row = row_of(memory, i)
        if row < 0:
            sigma = height_sigma if i == Error.R_D else PLANAR_VERTICAL_SIGMA if i == Error.V_D else UNKNOWN_TILT_SIGMA
            nine[10 * i] = sigma**2
            continue
        for j in range(9):
            column = row_of(memory, j)
            if column >= 0:
                nine[9 * i + j] = memory[full + n * row + column]
    for i in range(6):
        for j in range(6):
            a, sign_a = _enu(i)
            b, sign_b = _enu(j)
            out[POSE_COVARIANCE + 6 * i + j] = sign_a * sign_b * nine[9 * a + b]
            if i < 3 and j < 3:
                geodetic_covariance[3 * i + j] = sign_a * sign_b * nine[9 * a + b]

    _linear(c, v_n, v_e, v_d, nine, out)
    _angular(memory, newest, r, sample, full, out)
    return memory[r + Nav.TIME]


@njit
def _enu(i):
    """Index of component i of an ENU pose among the errors of position and attitude in NED (`Error`), and its sign."""
    component = i % 3
    sign = -1.0 if component == 2 else 1.0
    swapped = 1 - component if component < 2 else 2
    return (swapped if i < 3 else 6 + swapped), sign


@njit
def _orientation(q, out):
    """Write the quaternion q from b (FRD) to n (NED) to `out` as that from base_link (FLU) to ENU."""
    half = math.sqrt(0.5)
    r = strapdown.multiply((0.0, half, half, 0.0), strapdown.multiply(q, (0.0, 1.0, 0.0, 0.0)))
    sign = 1.0 if r[0] >= 0.0 else -1.0
    out[ORIENTATION], out[ORIENTATION + 1] = sign * r[1], sign * r[2]
    out[ORIENTATION + 2], out[ORIENTATION + 3] = sign * r[3], sign * r[0]


@njit
def _linear(c, v_n, v_e, v_d, nine, out):
    """Write velocity in base_link and its covariance. c: rotation from b to n. nine: covariance 9 x 9 of position,
    velocity and attitude."""
    # velocity in b: C^T v, its error C^T (dv + [v x] phi)
    jacobian = np.zeros(27)
    for k in range(3):
        x, y, z = strapdown.column(c, k)
        row = 9 * k
        sign = 1.0 if k == 0 else -1.0  # forward-right-down to forward-left-up
        out[LINEAR + k] = sign * (x * v_n + y * v_e + z * v_d)
        jacobian[row + 3], jacobian[row + 4], jacobian[row + 5] = sign * x, sign * y, sign * z
        jacobian[row + 6] = sign * (y * v_d - z * v_e)
        jacobian[row + 7] = sign * (z * v_n - x * v_d)
        jacobian[row + 8] = sign * (x * v_e - y * v_n)
    for i in range(3):
        for j in range(3):
            total = 0.0
            for k in range(3, 9):
                for other in range(3, 9):
                    total += jacobian[9 * i + k] * nine[9 * k + other] * jacobian[9 * j + other]
            out[TWIST_COVARIANCE + 6 * i + j] = total


@njit
def _angular(memory, newest, r, sample, full, out):
    """Angular velocity of the sample minus the estimated errors, and its variance including the white noise; zero
    before the first sample. full: position of the covariance (n, n) in the memory."""
    n = int(memory[Head.N_NAVIGATION]) + int(memory[Head.N_AUGMENTED])
    for k in range(3):
        sign = 1.0 if k == 0 else -1.0
        at = TWIST_COVARIANCE + 6 * (3 + k) + 3 + k
        state = channel_of(memory, 3 + k)
        if state < 0 or newest == 0:  # planar: roll and pitch rate are zero
            out[ANGULAR + k] = 0.0
            out[at] = UNKNOWN_TILT_SIGMA**2
            continue
        error = memory[r + NAV + state] + imu_share.error(memory, r, sample, 3 + k)
        out[ANGULAR + k] = sign * (memory[sample + Sample.W_X + k] - error)
        out[at] = density(memory, sample, 3 + k) / memory[sample + Sample.INTERVAL] + memory[full + (n + 1) * state]
