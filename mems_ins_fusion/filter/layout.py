"""Where everything stands in the filter's memory: named once, used by the kernel and by everybody who reads a state.

One row of floats is one state of the filter: navigation solution, estimated errors x, covariance P.

    nav (NAV) | x (n) | P: navigation block, packed upper triangle | cross block (m, N) | sensor block (m, m)

N navigation error states (5 planar, 9 strapdown) are followed by m states: the sensor error models, one block per
channel, then the receiver's coloured noise (north, east) where modelled. n = N + m.
"""
from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit


class _Nav(NamedTuple):
    """Columns of the navigation solution in a row."""

    TIME: int = 0  # s since the filter's epoch
    LATITUDE: int = 1
    LONGITUDE: int = 2
    HEIGHT: int = 3
    V_N: int = 4
    V_E: int = 5
    V_D: int = 6
    YAW: int = 7  # planar
    Q_W: int = 7  # strapdown: quaternion from b to n
    Q_X: int = 8
    Q_Y: int = 9
    Q_Z: int = 10
    RADII_LATITUDE: int = 11  # where the two scales were computed
    NORTH_SCALE: int = 12  # rad of latitude per metre
    EAST_SCALE: int = 13  # rad of longitude per metre
    ACCELEROMETER_PHASE: int = 14  # s since the autoregressive model's last step
    GYROSCOPE_PHASE: int = 15
    CONSTRAINT_TIME: int = 16  # s since the last vehicle constraint
    SIZE: int = 17


Nav = _Nav()


NAV = Nav.SIZE
PLANAR, STRAPDOWN = 0, 1
NAVIGATION_STATES = {PLANAR: 5, STRAPDOWN: 9}
CHANNELS = {PLANAR: ('f_x', 'f_y', 'w_z'), STRAPDOWN: ('f_x', 'f_y', 'f_z', 'w_x', 'w_y', 'w_z')}
STATE_NAMES = {PLANAR: ('r_n', 'r_e', 'v_n', 'v_e', 'yaw'),
               STRAPDOWN: ('r_n', 'r_e', 'r_d', 'v_n', 'v_e', 'v_d', 'phi_n', 'phi_e', 'phi_d')}


@njit
def packed(i, j, size):
    """Position of element (i, j), i <= j, in the packed upper triangle of a symmetric matrix."""
    return i * size - i * (i - 1) // 2 + j - i


def row_width(navigation: int, others: int) -> int:
    """Floats in one row with `navigation` (N) and `others` (m) states."""
    return (NAV + navigation + others + navigation * (navigation + 1) // 2 + others * (navigation + others))


@njit
def load_covariance(row, navigation, others, full):
    """The covariance in `row` (width,) as a full symmetric matrix, written into `full` (n, n)."""
    at = NAV + navigation + others
    for i in range(navigation):
        for j in range(i, navigation):
            full[i, j] = full[j, i] = row[at]
            at += 1
    for j in range(navigation, navigation + others):
        for i in range(navigation):
            full[i, j] = full[j, i] = row[at]
            at += 1
    for i in range(navigation, navigation + others):
        for j in range(navigation, navigation + others):
            full[i, j] = row[at]
            at += 1


@njit
def store_covariance(full, navigation, others, row):
    """Inverse of `load_covariance`."""
    at = NAV + navigation + others
    for i in range(navigation):
        for j in range(i, navigation):
            row[at] = full[i, j]
            at += 1
    for j in range(navigation, navigation + others):
        for i in range(navigation):
            row[at] = full[i, j]
            at += 1
    for i in range(navigation, navigation + others):
        for j in range(navigation, navigation + others):
            row[at] = full[i, j]
            at += 1


def covariance_index(i: int, j: int, navigation: int, others: int) -> int:
    """Column of a row in which element (i, j) of the covariance stands."""
    i, j = min(i, j), max(i, j)
    at = NAV + navigation + others
    triangle = navigation * (navigation + 1) // 2
    if j < navigation:
        return at + packed(i, j, navigation)
    if i < navigation:
        return at + triangle + (j - navigation) * navigation + i
    return at + triangle + others * navigation + (i - navigation) * others + j - navigation


def covariance(row: np.ndarray, navigation: int, others: int) -> np.ndarray:
    """The covariance (n, n) in `row`."""
    full = np.empty((navigation + others, navigation + others))
    load_covariance(row, navigation, others, full)
    return full


class _Head(NamedTuple):
    """Sizes and settings at the start of the filter's memory."""

    MECHANIZATION: int = 0
    OPEN_LOOP: int = 1
    NAVIGATION: int = 2  # N
    OTHERS: int = 3  # m
    ORDER: int = 4  # states per sensor channel, p
    CHANNELS: int = 5
    WIDTH: int = 6  # floats in a row
    CAPACITY: int = 7  # rows in the ring
    FIX_CAPACITY: int = 8
    SAMPLES: int = 9  # IMU samples taken in so far: the newest state is that of row SAMPLES modulo CAPACITY
    FIXES: int = 10  # fixes remembered
    COLOURED: int = 11  # first of the two states of coloured GNSS noise; -1: none
    ACCELEROMETER_INTERVAL: int = 12  # s, of the autoregressive model; 0: another model
    GYROSCOPE_INTERVAL: int = 13
    MAX_GAP: int = 14
    MAX_DELAY: int = 15
    ROBUST_SIGMA: int = 16
    LEVER_X: int = 17  # lever arm, body axes forward-right-down, m
    LEVER_Y: int = 18
    LEVER_Z: int = 19
    ZERO_VELOCITY_SIGMA: int = 20  # 0: not used
    NON_HOLONOMIC_SIGMA: int = 21
    STILL_ACCELERATION: int = 22  # scatter below which the sensors are at rest, m/s^2
    STILL_RATE: int = 23  # rad/s
    STILL_VARIANCE_F: int = 24  # running variance of specific force and angular rate, sum over the axes
    STILL_VARIANCE_W: int = 25
    STILL_MEAN: int = 26  # their running means, six
    ROWS_AT: int = 32  # where the parts of the memory begin: states,
    RING_AT: int = 33  # samples,
    FIXES_AT: int = 34  # fixes,
    SCRATCH_AT: int = 35  # and room to work
    CONDITIONING: int = 36  # 6 x 6: body-axis sample = matrix (raw sample) + offset
    OFFSET: int = 72  # six
    SIDESLIP: int = 78  # rad per m/s^2 of lateral acceleration
    STILL_REFERENCE: int = 79  # the running means of specific force when they became steady, three
    STILL_SINCE: int = 82  # and when that was
    SIZE: int = 83


Head = _Head()


class _Sample(NamedTuple):
    """One IMU sample as the kernel takes it: body axes forward-right-down, at rest or not."""

    TIME: int = 0
    F_X: int = 1
    F_Y: int = 2
    F_Z: int = 3
    W_X: int = 4
    W_Y: int = 5
    W_Z: int = 6
    STILL: int = 7  # 1 at rest
    SIZE: int = 8


Sample = _Sample()


class _Fix(NamedTuple):
    """One fix as the kernel takes it, and what came of it."""

    TIME: int = 0  # at which it describes the vehicle
    LATITUDE: int = 1
    LONGITUDE: int = 2
    HEIGHT: int = 3
    R_NN: int = 4
    R_NE: int = 5
    R_EE: int = 6
    R_DD: int = 7
    ID: int = 8  # counts the fixes given to the kernel
    Z_N: int = 9  # innovation, predicted minus measured antenna position, m
    Z_E: int = 10
    Z_D: int = 11
    S_NN: int = 12  # its covariance
    S_NE: int = 13
    S_EE: int = 14
    S_DD: int = 15
    NIS: int = 16
    APPLIED: int = 17  # 1 when the filter has used it
    YAW: int = 18  # of the prediction, to see innovations along and across track
    V_N: int = 19
    V_E: int = 20
    SIZE: int = 21


Fix = _Fix()


FIX_SIZE, SAMPLE_SIZE, HEAD_SIZE = Fix.SIZE, Sample.SIZE, Head.SIZE


def noise_size(m: int, p: int, channels: int) -> int:
    """Floats of the noise section: white (6) | 1/tau, walk, variance (m each) | AR coefficients | b0 squared."""
    return 6 + 3 * m + channels * (p + 1)


def views(memory: np.ndarray):
    """The parts of the memory as arrays: head, noise, states (capacity + 2, width), samples, fixes."""
    head = memory[:HEAD_SIZE]
    rows, ring, fixes, scratch = (int(head[i]) for i in (Head.ROWS_AT, Head.RING_AT, Head.FIXES_AT, Head.SCRATCH_AT))
    return (head, memory[HEAD_SIZE:rows], memory[rows:ring].reshape(-1, int(head[Head.WIDTH])),
            memory[ring:fixes].reshape(-1, SAMPLE_SIZE), memory[fixes:scratch].reshape(-1, FIX_SIZE))


@njit
def state_at(memory, k):
    """Position of the state after sample k."""
    return int(memory[Head.ROWS_AT]) + (k & (int(memory[Head.CAPACITY]) - 1)) * int(memory[Head.WIDTH])


@njit
def sample_at(memory, k):
    """Position of sample k."""
    return int(memory[Head.RING_AT]) + (k & (int(memory[Head.CAPACITY]) - 1)) * SAMPLE_SIZE


@njit
def fix_at(memory, i):
    """Position of fix i of those remembered, by time."""
    return int(memory[Head.FIXES_AT]) + i * FIX_SIZE
