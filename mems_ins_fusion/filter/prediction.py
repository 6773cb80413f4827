"""Prediction of a state and its covariance over one interval (Eq. 4 and 5), for each mechanization, in blocks.

P_nn navigation, P_ns cross, P_ss sensor errors; Phi = [[F, B], [0, A]] with A diagonal for random walk and
Gauss-Markov, and one companion matrix per channel, which steps once per T_s, for AR(p). F and B are not formed:
`error_step` of the mechanization applies [F, B] to a column, or to four columns that stand side by side.

All functions work on the flat memory: passing further arrays would cost as much time as the mathematics. `src`, `dst`
and `sample` are positions in the memory: of the previous state, of the state to write, and of the IMU sample of the
interval.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit
from mems_ins_fusion.compiled_lanes import LANES, four, put

from ..navigation import planar, strapdown
from ..navigation.earth import gravity, radii
from .measurements import acceleration, time_offset
from .memory import (
    HEAD,
    INPUT_SIZE,
    NAV,
    PLANAR,
    WHITE,
    Error,
    Head,
    Nav,
    Sample,
    coefficients_at,
    decay_at,
    driving_at,
    element_at,
    nonnegative,
    restart_at,
    row_of,
    sensor_variance_at,
    variance_at,
    walk_at,
)
from .trust import imu_share
from .trust.drift import Drift, DriftSettings
from .trust.force_noise import force_noise
from .trust.imu_faults import Fault
from .trust.imu_share import ZERO, Difference, Share
from .trust.lag import LagSettings, fall_behind
from .trust.scale import Inputs
from .trust.white_noise import density

#: of the settings: rad^2/s per (rad/s)^2, noise of a gyroscope for its squared rate: of an unknown scale factor error
Turns = HEAD.place('Turns', NOISE=1)

#: s, duration of a turn: a bend of 90 deg at 20 deg/s. White noise whose density squared is this time the variance of
#: the rate error changes the heading in such a turn by as much as the scale factor error does
TURN_TIME = 5.0
#: m/s^2, standard deviation of the vehicle's acceleration during a gap in the IMU samples. Chosen: a car in traffic
GAP_ACCELERATION = 1.5
#: rad/s (17 deg/s), standard deviation of its turn rate during a gap. Chosen; four times as much costs 24 m where an
#: IMU restarts (docs/ablation.md)
GAP_TURN_RATE = 0.3
#: a gap adds this share of the heading's variance to roll and pitch: roads bend more than they tilt. Chosen; a quarter
#: and four times of it move little (docs/ablation.md)
GAP_TILT_SHARE = 0.1
#: rad, largest standard deviation that a gap gives to roll and pitch, however long it lasts: roads are not steeper
GAP_TILT = 0.1
#: s for which the unknown acceleration and turn rate of a gap are taken as constant. After that P goes on growing at
#: the rate it has reached by then. Chosen; a quarter and four times of it move little (docs/ablation.md)
LONGEST_BRIDGE = 2.0
#: rad, standard deviation of a heading that is uniformly distributed over the circle
UNKNOWN_YAW_SIGMA = math.pi / math.sqrt(3.0)
#: rad (3 deg), standard deviation of roll and pitch that are not known: slopes of roads. Chosen; a quarter and four
#: times of it move little (docs/ablation.md)
UNKNOWN_TILT_SIGMA = 0.05
#: dt over the correlation time up to which the series in `_series` equals the exponential to rounding
SERIES = 0.01
#: rad of latitude (13 m): after a move of this size the radii are computed anew, which keeps the scales accurate to
#: 2e-6
RADII_STEP = 2e-6


@njit(_nrt=False, fastmath={'contract'})
def predict(mem, src, dst, sample, dt):
    """Write to dst the state at src, predicted over dt, s, with one IMU sample; the caller sets its TIME."""
    src, dst, sample = nonnegative(src), nonnegative(dst), nonnegative(sample)
    m, p = nonnegative(int(mem[Head.N_AUGMENTED])), nonnegative(int(mem[Head.ORDER]))
    if mem[Head.MECHANIZATION] != PLANAR:
        _step_strapdown(mem, src, dst, sample, dt, m, p)
    elif m == 3 and p == 1:  # the paper's filters: with constant sizes the compiled code is a quarter faster
        _step_planar(mem, src, dst, sample, dt, 3, 1)
    else:
        _step_planar(mem, src, dst, sample, dt, m, p)
    for k in range(Nav.MEMORY, NAV):
        mem[dst + k] = mem[src + k]
    width = nonnegative(int(mem[Head.WIDTH]))
    for k in range(width - INPUT_SIZE * int(mem[Inputs.COUNT]), width):
        mem[dst + k] = mem[src + k]
    if mem[LagSettings.TIME] > 0.0:
        fall_behind(mem, src, dst, dt)
    time_offset.carry_on(mem, src, dst, dt)
    if mem[sample + Sample.INTERVAL] > mem[Head.MAX_GAP] or mem[sample + Sample.FAULT] != 0.0:
        _bridge(mem, dst, dt, mem[sample + Sample.FAULT])
    else:
        mem[dst + Nav.BRIDGED] = 0.0


@njit(_nrt=False)
def set_radii(mem, r):
    """Write to row r how many radians of latitude and of longitude one metre is at its position."""
    north, east = radii(mem[r + Nav.LATITUDE])
    height = mem[r + Nav.HEIGHT]
    mem[r + Nav.RADII_LATITUDE] = mem[r + Nav.LATITUDE]
    mem[r + Nav.NORTH_SCALE] = 1.0 / (north + height)
    mem[r + Nav.EAST_SCALE] = 1.0 / ((east + height) * math.cos(mem[r + Nav.LATITUDE]))


@njit(_nrt=False)
def _move(mem, src, dst, north, east, down):
    """Write to row dst the position of row src, displaced by (north, east, down) m."""
    src, dst = nonnegative(src), nonnegative(dst)
    mem[dst + Nav.LATITUDE] = mem[src + Nav.LATITUDE] + north * mem[src + Nav.NORTH_SCALE]
    mem[dst + Nav.LONGITUDE] = mem[src + Nav.LONGITUDE] + east * mem[src + Nav.EAST_SCALE]
    mem[dst + Nav.HEIGHT] = mem[src + Nav.HEIGHT] - down
    mem[dst + Nav.RADII_LATITUDE] = mem[src + Nav.RADII_LATITUDE]
    mem[dst + Nav.NORTH_SCALE] = mem[src + Nav.NORTH_SCALE]
    mem[dst + Nav.EAST_SCALE] = mem[src + Nav.EAST_SCALE]
    if abs(mem[dst + Nav.LATITUDE] - mem[dst + Nav.RADII_LATITUDE]) > RADII_STEP:
        set_radii(mem, dst)


@njit(_nrt=False, fastmath={'contract'}, forceinline=True)
def _step_planar(mem, src, dst, sample, dt, m, p):
    """Predict one interval of dt, s, with the planar mechanization; m augmented states, p states per channel."""
    src, dst, sample, m, p = nonnegative(src), nonnegative(dst), nonnegative(sample), nonnegative(m), nonnegative(p)
    x, n = NAV + 5, 5 + m
    a = NAV + n  # first position of P
    f_x, f_y, w_z = mem[sample + Sample.F_X], mem[sample + Sample.F_Y], mem[sample + Sample.W_Z]
    closed = mem[Head.OPEN_LOOP] == 0.0
    if closed:
        f_x -= mem[src + x]
        f_y -= mem[src + x + p]
        w_z -= mem[src + x + 2 * p]
    if mem[Share.STATE] > 0.0 and closed:
        f_x -= imu_share.error(mem, src, sample, 0)
        f_y -= imu_share.error(mem, src, sample, 1)
        w_z -= imu_share.error(mem, src, sample, 5)
    yaw = mem[src + Nav.YAW]
    f_n, f_e, c, s = planar.rotate(yaw, dt, f_x, f_y, w_z)
    north, east, v_n, v_e, yaw = planar.mechanize(mem[src + Nav.V_N], mem[src + Nav.V_E], yaw, f_x, f_y, w_z, dt)
    if mem[sample + Sample.FAULT] != 0.0:  # straight motion depends on neither heading nor sensor errors
        f_n = f_e = c = s = 0.0
    _move(mem, src, dst, north, east, 0.0)
    mem[dst + Nav.V_N] = v_n
    mem[dst + Nav.V_E] = v_e
    mem[dst + Nav.YAW] = yaw

    if closed:
        for i in range(5):
            mem[dst + NAV + i] = 0.0
    else:
        (mem[dst + NAV], mem[dst + NAV + 1], mem[dst + NAV + 2], mem[dst + NAV + 3],
         mem[dst + NAV + 4]) = _planar_column(mem, dt, f_n, f_e, c, s, src + NAV, 1, src + x, p)

    if mem[Head.HISTORY_AT] > 0.0:
        _carry_planar(mem, dt, f_n, f_e, c, s, nonnegative(m), nonnegative(p))
    # in the scratch: Phi P, navigation rows, in blocks of four columns (`_block`), and the sensors' rows of P
    g, e = nonnegative(int(mem[Head.SCRATCH_AT])), nonnegative(src + a + 5 * n)
    augmented = g + 5 * LANES * _blocks(5)
    rows = augmented + 5 * LANES * _blocks(m)
    _sensor_rows(mem, src + a, rows, 5, 3, n, p)
    if m < LANES:
        for j in range(m):
            _store(mem, augmented + j, LANES,
                   _planar_column(mem, dt, f_n, f_e, c, s, src + a + 5 + j, n, e + j, m * p))
    for block in range(_blocks(5) + (0 if m < LANES else _blocks(m))):
        j, q, step = _block(block, 5, m, p, rows, e)
        _put(mem, g + 5 * LANES * block, _planar_columns(mem, dt, f_n, f_e, c, s, src + a + j, n, q, step))
    _covariance_planar(mem, g, augmented, nonnegative(dst + a), n, m, p, dt, f_n, f_e, c, s)
    _sensor_states(mem, src, dst, dt, 5, m, p, augmented)
    if mem[Share.STATE] > 0.0:
        d = sample + Difference.VALUE
        imu_share.add_error(mem, dst, sample, planar.error_step(
            dt, f_n, f_e, c, s, 0.0, 0.0, 0.0, 0.0, 0.0, mem[d], mem[d + 1], mem[d + 5]))


@njit(_nrt=False, fastmath={'contract'}, forceinline=True)
def _covariance_planar(mem, g, augmented, to, n, m, p, dt, f_n, f_e, c, s):
    """Write (Phi P) Phi^T of the navigation errors, with white noise, to `to`, rows n apart. Phi P is at g, its columns
    of the augmented states at `augmented` (`_block`)."""
    (g00, g01, g02, g03, g04), (g10, g11, g12, g13, g14) = _five(mem, g), _five(mem, g + LANES)
    (g20, g21, g22, g23, g24), (g30, g31, g32, g33, g34) = _five(mem, g + 2 * LANES), _five(mem, g + 3 * LANES)
    g40, g41, g42, g43, g44 = _five(mem, g + 4 * LANES)

    # row by row; the white noise of a sensor is treated as an error that is constant over the interval
    h = 0.5 * dt
    nx, ny, nw = mem[WHITE], mem[WHITE + 1], mem[WHITE + 5]
    x, y, w = _column_at(augmented, 5, 0, m), _column_at(augmented, 5, p, m), _column_at(augmented, 5, 2 * p, m)
    a00, a01, a02, a03, a04 = planar.error_step(
        dt, f_n, f_e, c, s, g00, g01, g02, g03, g04,
        mem[x] + nx * h * c, mem[y] - ny * h * s, mem[w] - nw * h * h * f_e)
    _, a11, a12, a13, a14 = planar.error_step(
        dt, f_n, f_e, c, s, g10, g11, g12, g13, g14,
        mem[x + LANES] + nx * h * s, mem[y + LANES] + ny * h * c, mem[w + LANES] + nw * h * h * f_n)
    _, _, a22, a23, a24 = planar.error_step(
        dt, f_n, f_e, c, s, g20, g21, g22, g23, g24,
        mem[x + 2 * LANES] + nx * c, mem[y + 2 * LANES] - ny * s, mem[w + 2 * LANES] - nw * h * f_e)
    _, _, _, a33, a34 = planar.error_step(
        dt, f_n, f_e, c, s, g30, g31, g32, g33, g34,
        mem[x + 3 * LANES] + nx * s, mem[y + 3 * LANES] + ny * c, mem[w + 3 * LANES] + nw * h * f_n)
    _, _, _, _, a44 = planar.error_step(dt, f_n, f_e, c, s, g40, g41, g42, g43, g44,
                                        mem[x + 4 * LANES], mem[y + 4 * LANES], mem[w + 4 * LANES] + nw)
    _store(mem, to, 1, (a00, a01, a02, a03, a04))
    _store(mem, to + n + 1, 1, (a11, a12, a13, a14))
    _store(mem, to + 2 * n + 2, 1, (a22, a23, a24))
    _store(mem, to + 3 * n + 3, 1, (a33, a34))
    mem[to + 4 * n + 4] = a44
    _mirror(mem, to, 5, n)


@njit(inline='always')
def _five(mem, at):
    """A row of Phi P, planar: the five columns of the navigation errors, in two blocks; at: of its first element."""
    return mem[at], mem[at + 1], mem[at + 2], mem[at + 3], mem[at + 5 * LANES + 3]


@njit(inline='always')
def _nine(mem, at):
    """`_five` for the strapdown mechanization: nine columns in three blocks, as three errors each of position, velocity
    and attitude."""
    second, third = at + 9 * LANES, at + 18 * LANES
    return ((mem[at], mem[at + 1], mem[at + 2]), (mem[at + 3], mem[second], mem[second + 1]),
            (mem[second + 2], mem[second + 3], mem[third + 3]))


@njit(inline='always')
def _planar_columns(mem, dt, f_n, f_e, c, s, k, step, q, sensor_step):
    """`_planar_column` of four columns that stand side by side."""
    return planar.error_step(
        dt, f_n, f_e, c, s, four(mem, k), four(mem, k + step), four(mem, k + 2 * step), four(mem, k + 3 * step),
        four(mem, k + 4 * step), four(mem, q), four(mem, q + sensor_step), four(mem, q + 2 * sensor_step))


@njit(inline='always')
def _strapdown_columns(mem, transition, k, step, q, sensor_step):
    """`_planar_columns` for the strapdown mechanization."""
    return strapdown.error_step(
        transition, (four(mem, k), four(mem, k + step), four(mem, k + 2 * step)),
        (four(mem, k + 3 * step), four(mem, k + 4 * step), four(mem, k + 5 * step)),
        (four(mem, k + 6 * step), four(mem, k + 7 * step), four(mem, k + 8 * step)),
        (four(mem, q), four(mem, q + sensor_step), four(mem, q + 2 * sensor_step)),
        (four(mem, q + 3 * sensor_step), four(mem, q + 4 * sensor_step), four(mem, q + 5 * sensor_step)))


@njit(inline='always')
def _sensor_rows(mem, p_at, to, size, channels, n, p):
    """Write the rows of P that belong to the sensors' errors, (channels, size), which P has above its diagonal only.

    p_at: position of P. size: number of navigation errors.
    """
    for i in range(size):
        line = nonnegative(p_at + n * i + size)
        for k in range(channels):
            mem[to + size * k + i] = mem[line + k * p]


@njit(inline='always')
def _blocks(count):
    """How many times LANES are enough for `count`."""
    return (count + LANES - 1) // LANES


@njit(inline='always')
def _block(block, size, m, p, rows, e):
    """The first of four columns of P, and where the rows of the sensors' errors have them: position and step.

    First come the `size` navigation errors, whose rows are at `rows`, then the m augmented states, at e. The last four
    of each may overlap with those before them. Of Phi P each block of four columns stands alone, row by row: so the
    steps within it are constants, and do not depend on the number of states.
    """
    first = _blocks(size)
    if block < first:
        j = min(LANES * block, size - LANES)
        return j, rows + j, size
    j = min(LANES * (block - first), m - LANES)
    return size + j, e + j, m * p


@njit(inline='always')
def _column_at(augmented, size, j, m):
    """Position of the first of `size` elements, LANES apart, of column j of the augmented states in Phi P. augmented:
    position of their first block."""
    block = j // LANES
    return augmented + size * LANES * block + j - (min(LANES * block, m - LANES) if m >= LANES else 0)


@njit(inline='always')
def _mirror(mem, at, size, n):
    """Copy what is above the diagonal of the (size, size) block at `at` below it; n elements in a row."""
    for i in range(size):
        for j in range(i + 1, size):
            mem[at + n * j + i] = mem[at + n * i + j]


@njit(inline='always')
def _planar_column(mem, dt, f_n, f_e, c, s, k, step, q, sensor_step):
    """[F, B] times a column: navigation errors at k, k + step, ..., sensor errors at q, q + sensor_step, ..."""
    return planar.error_step(
        dt, f_n, f_e, c, s, mem[k], mem[k + step], mem[k + 2 * step], mem[k + 3 * step], mem[k + 4 * step],
        mem[q], mem[q + sensor_step], mem[q + 2 * sensor_step])


@njit(inline='always')
def _strapdown_column(mem, transition, k, step, q, sensor_step):
    """`_planar_column` for the strapdown mechanization."""
    return strapdown.error_step(
        transition, (mem[k], mem[k + step], mem[k + 2 * step]),
        (mem[k + 3 * step], mem[k + 4 * step], mem[k + 5 * step]),
        (mem[k + 6 * step], mem[k + 7 * step], mem[k + 8 * step]),
        (mem[q], mem[q + sensor_step], mem[q + 2 * sensor_step]),
        (mem[q + 3 * sensor_step], mem[q + 4 * sensor_step], mem[q + 5 * sensor_step]))


@njit(inline='always')
def _strapdown_row(mem, transition, at, sensors):
    """[F, B] times a row of Phi P (`_nine`); sensors: position of the first of its six sensor errors, nine apart."""
    r, v, phi = _nine(mem, at)
    return strapdown.error_step(transition, r, v, phi, (mem[sensors], mem[sensors + 9], mem[sensors + 18]),
                                (mem[sensors + 27], mem[sensors + 36], mem[sensors + 45]))


@njit(_nrt=False)
def _carry_planar(mem, dt, f_n, f_e, c, s, m, p):
    """Multiply the transition matrix T of the smoother's history (history.py) by Phi: its navigation rows."""
    n = 5 + m
    for k in range(int(mem[Head.HISTORY_AT]), int(mem[Head.HISTORY_AT]) + n):
        moved = _planar_column(mem, dt, f_n, f_e, c, s, k, n, k + 5 * n, n * p)
        for i in range(5):
            mem[k + n * i] = moved[i]


@njit(_nrt=False)
def _carry_strapdown(mem, transition, m, p):
    """`_carry_planar` for the strapdown mechanization."""
    n = 9 + m
    for k in range(int(mem[Head.HISTORY_AT]), int(mem[Head.HISTORY_AT]) + n):
        moved = _strapdown_column(mem, transition, k, n, k + 9 * n, n * p)
        for i in range(9):
            mem[k + n * i] = moved[i]


@njit(_nrt=False)
def _carry_sensors(mem, dt, size, m):
    """Multiply the rows of the augmented states of T by their decay over dt; size: number of navigation errors."""
    n = size + m
    for j in range(m):
        decay, at = _decay(dt * mem[decay_at(j)]), int(mem[Head.HISTORY_AT]) + n * (size + j)
        for k in range(at, at + n):
            mem[k] *= decay


@njit(_nrt=False)
def _bridge(mem, r, dt, fault):
    """Add to the covariance of row r the motion that the vehicle may have made in dt, s, without a valid sample.

    Acceleration and turn rate are unknown constants, so what they add in dt depends on how long the gap has lasted.
    fault: why the sample is not valid (`Fault`). Where the fixes contradict the IMU (Fault.CONTRADICTED) only the
    acceleration of a land vehicle is added.
    """
    before = mem[r + Nav.BRIDGED]
    after = before + dt
    mem[r + Nav.BRIDGED] = min(after, LONGEST_BRIDGE)
    squares = after**2 - before**2
    velocity, turn = GAP_ACCELERATION**2 * squares, GAP_TURN_RATE**2 * squares
    position = 0.25 * GAP_ACCELERATION**2 * (after**4 - before**4)
    if fault == Fault.CONTRADICTED:
        position, velocity = 0.0, acceleration.DENSITY * dt
    for error in range(Error.SIZE):
        i = row_of(mem, error)
        if i < 0:
            continue
        at = element_at(mem, r, i, i)
        if error <= Error.R_D:
            mem[at] += position
        elif error <= Error.V_D:
            mem[at] += velocity
        elif error <= Error.PHI_E:
            mem[at] += min(GAP_TILT_SHARE * turn, max(GAP_TILT**2 - mem[at], 0.0))
        else:
            mem[at] += turn


@njit(_nrt=False)
def allow_for_restart(mem, r):
    """Add to the covariance of row r by how much a restart of the IMU may change its errors
    (`config.REPEATED_TURN_ON`).
    """
    n_navigation, m, p = int(mem[Head.N_NAVIGATION]), int(mem[Head.N_AUGMENTED]), int(mem[Head.ORDER])
    channels = int(mem[Head.CHANNELS])
    for channel in range(channels):
        mem[sensor_variance_at(mem, r, n_navigation + channel * p)] += mem[restart_at(m, p, channels, channel)]


@njit(inline='always')
def _series(x):
    """exp(-x), exact to rounding for x below SERIES."""
    return 1.0 - x * (1.0 - x * (1 / 2 - x * (1 / 6 - x * (1 / 24 - x * (1 / 120)))))


@njit
def _decay(x):
    """exp(-x), x >= 0. Below SERIES, as always at IMU rate, the series is used: it is exact to rounding."""
    return _series(x) if x < SERIES else math.exp(-x)


@njit(_nrt=False)
def _decays(mem, at, dt, m):
    """Write to `at` the factor by which each of the m augmented states decays in dt, s.

    The series is computed in a loop of its own: the compiler vectorizes it, and in one loop with the choice it would
    compute all exponentials as well.
    """
    at, largest = nonnegative(at), 0.0
    for j in range(m):
        x = dt * mem[decay_at(j)]
        mem[at + j] = _series(x)
        largest = max(largest, x)
    if largest >= SERIES:
        for j in range(m):
            mem[at + j] = _decay(dt * mem[decay_at(j)])


@njit(inline='always')
def _sensor_states(mem, src, dst, dt, size, m, p, augmented):
    """Predict x and P of the m augmented states, which follow `size` navigation errors, with the steps of AR(p).

    augmented: position of their columns of Phi P, navigation rows of Phi (`_block`).
    """
    x, n = NAV + size, size + m
    a = NAV + n
    e = a + size * n
    decays = augmented + size * LANES * _blocks(m)
    scaled = 0 if mem[DriftSettings.LEARNED] == 0.0 else 6  # number of states whose process noise trust/drift.py scales
    _decays(mem, decays, dt, m)
    _decay_augmented(mem, augmented, dst + a + size, size, n, src + e, dst + e, decays, m)
    for j in range(m):
        decay, row = mem[decays + j], nonnegative(dst + e + m * j)
        mem[dst + x + j] = decay * mem[src + x + j]
        drift = mem[src + Drift.RATIO + (j > 2)] if j < scaled else 1.0
        mem[row + j] += drift * (mem[walk_at(m, j)] * dt
                                 + mem[variance_at(m, j)] * (1.0 - decay * decay))
    if mem[Head.HISTORY_AT] > 0.0:
        _carry_sensors(mem, dt, nonnegative(size), nonnegative(m))
    if mem[Head.INTERVAL] > 0.0:
        _autoregressive(mem, src, dst, dt, size, m, p)
    mem[dst + Nav.CONSTRAINT_TIME] = mem[src + Nav.CONSTRAINT_TIME] + dt


@njit(inline='always')
def _decay_augmented(mem, cross, cross_to, size, n, own, own_to, decays, m):
    """P Phi^T of the m augmented states' columns, which decay by what is at `decays`.

    cross: position of their columns of Phi P (`_block`), `size` rows. own: of the block (m, m), whose rows decay as
    well. The results go to cross_to, with rows n apart, and own_to, symmetric to the last bit.
    """
    if m < LANES:
        for j in range(m):
            for i in range(size):
                mem[cross_to + n * i + j] = mem[decays + j] * mem[cross + LANES * i + j]
            for i in range(m):
                mem[own_to + m * i + j] = mem[decays + i] * mem[decays + j] * mem[own + m * i + j]
        return
    for block in range(_blocks(m)):
        j = min(LANES * block, m - LANES)
        decay, at = four(mem, decays + j), cross + size * LANES * block
        for i in range(size):
            put(mem, cross_to + n * i + j, decay * four(mem, at + LANES * i))
        for i in range(m):
            put(mem, own_to + m * i + j, mem[decays + i] * decay * four(mem, own + m * i + j))


@njit(_nrt=False, fastmath={'contract'})
def _autoregressive(mem, src, dst, dt, size, m, p):
    """Step the companion blocks of accelerometers and gyroscopes, each once for every T_s that has passed (Eq. 22)."""
    src, dst, size, m, p = nonnegative(src), nonnegative(dst), nonnegative(size), nonnegative(m), nonnegative(p)
    accelerometers, channels = (2, 3) if size == 5 else (3, 6)
    for sensor in range(2):
        phase, interval = Nav.PHASE + sensor, mem[Head.INTERVAL + sensor]
        first, last = (0, accelerometers) if sensor == 0 else (accelerometers, channels)
        mem[dst + phase] = mem[src + phase] + dt
        while mem[dst + phase] > interval * (1.0 - 1e-6):
            mem[dst + phase] -= interval
            for channel in range(first, last):
                _step_channel(mem, dst, size, m, p, channel, channels)


@njit(inline='always')
def _step_channel(mem, dst, size, m, p, channel, channels):
    """One step of one channel's AR(p): apply the companion matrix to x and to both sides of P, and add b0^2."""
    x, n = NAV + size, size + m
    b = NAV + n + size
    e = NAV + n + size * n
    start, a = channel * p, coefficients_at(m, p, channel)
    _companion(mem, dst + x + start, 1, p, a)
    for i in range(size):
        _companion(mem, nonnegative(dst + b + n * i + start), 1, p, a)
    for j in range(m):
        _companion(mem, nonnegative(dst + e + m * start + j), m, p, a)
    for i in range(m):
        row = nonnegative(dst + e + m * i + start)
        if start <= i < start + p:
            _companion(mem, row, 1, p, a)
        else:  # copied from the rows, so that P stays symmetric
            for k in range(p):
                mem[row + k] = mem[nonnegative(dst + e + m * (start + k) + i)]
    if mem[Head.HISTORY_AT] > 0.0:
        for k in range(n):
            _companion(mem, int(mem[Head.HISTORY_AT]) + n * (size + start) + k, n, p, a)
    mem[dst + e + (m + 1) * start] += mem[driving_at(m, p, channels, channel)]


@njit(inline='always')
def _companion(mem, at, stride, p, a):
    """Multiply p elements v, `stride` apart, by the companion matrix: the first becomes -a_1 v_1 - ... - a_p v_p, the
    others move on by one. a: position of the coefficients."""
    if p == 2:  # the usual order, without a loop
        first = mem[at]
        mem[at] = -mem[a + 1] * mem[at + stride] - mem[a] * first
        mem[at + stride] = first
        return
    y = 0.0
    for k in range(p - 1, -1, -1):
        y -= mem[a + k] * mem[at + k * stride]
        if k > 0:
            mem[at + k * stride] = mem[at + (k - 1) * stride]
    mem[at] = y


@njit(_nrt=False, fastmath={'contract'}, forceinline=True)
def _step_strapdown(mem, src, dst, sample, dt, m, p):
    """Predict one interval of dt, s, with the strapdown mechanization; m augmented states, p states per channel."""
    src, dst, sample, m, p = nonnegative(src), nonnegative(dst), nonnegative(sample), nonnegative(m), nonnegative(p)
    x = NAV + 9
    closed = mem[Head.OPEN_LOOP] == 0.0
    f = (mem[sample + Sample.F_X], mem[sample + Sample.F_Y], mem[sample + Sample.F_Z])
    w = (mem[sample + Sample.W_X], mem[sample + Sample.W_Y], mem[sample + Sample.W_Z])
    if closed:
        f = (f[0] - mem[src + x], f[1] - mem[src + x + p], f[2] - mem[src + x + 2 * p])
        w = (w[0] - mem[src + x + 3 * p], w[1] - mem[src + x + 4 * p], w[2] - mem[src + x + 5 * p])
    if mem[Share.STATE] > 0.0 and closed:
        f = (f[0] - imu_share.error(mem, src, sample, 0), f[1] - imu_share.error(mem, src, sample, 1),
             f[2] - imu_share.error(mem, src, sample, 2))
        w = (w[0] - imu_share.error(mem, src, sample, 3), w[1] - imu_share.error(mem, src, sample, 4),
             w[2] - imu_share.error(mem, src, sample, 5))
    latitude, height = mem[src + Nav.LATITUDE], mem[src + Nav.HEIGHT]
    rates = strapdown.frame_rates(latitude, mem[src + Nav.V_N], mem[src + Nav.V_E], 1.0 / mem[src + Nav.NORTH_SCALE],
                                  1.0 / (mem[src + Nav.EAST_SCALE] * math.cos(latitude)))
    attitude, c, f_level, moved, velocity = strapdown.mechanize(
        (mem[src + Nav.Q_W], mem[src + Nav.Q_X], mem[src + Nav.Q_Y], mem[src + Nav.Q_Z]), mem[src + Nav.V_N],
        mem[src + Nav.V_E], mem[src + Nav.V_D], f, w, dt, gravity(latitude, height), rates)
    if mem[sample + Sample.FAULT] != 0.0:  # straight motion depends on neither attitude nor sensor errors
        c, f_level = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    transition = strapdown.transition(dt, c, f_level)
    if mem[Head.HISTORY_AT] > 0.0:
        _carry_strapdown(mem, transition, m, p)
    _move(mem, src, dst, moved[0], moved[1], moved[2])
    mem[dst + Nav.V_N], mem[dst + Nav.V_E], mem[dst + Nav.V_D] = velocity
    mem[dst + Nav.Q_W], mem[dst + Nav.Q_X], mem[dst + Nav.Q_Y], mem[dst + Nav.Q_Z] = attitude

    if closed:
        for i in range(9):
            mem[dst + NAV + i] = 0.0
    else:
        _store(mem, dst + NAV, 1, _strapdown_column(mem, transition, src + NAV, 1, src + x, p))

    augmented = _covariance_strapdown(mem, src, dst, sample, dt, m, p, transition, c, f_level)
    _sensor_states(mem, src, dst, dt, 9, m, p, augmented)
    if mem[Share.STATE] > 0.0:
        d = sample + Difference.VALUE
        imu_share.add_error(mem, dst, sample, strapdown.error_step(
            transition, ZERO, ZERO, ZERO, (mem[d], mem[d + 1], mem[d + 2]), (mem[d + 3], mem[d + 4], mem[d + 5])))


@njit(_nrt=False, fastmath={'contract'}, forceinline=True)
def _covariance_strapdown(mem, src, dst, sample, dt, m, p, transition, c, f_level):
    """Write (Phi P) Phi^T of the navigation errors, with white noise, to dst. Returns the position of the columns of
    Phi P of the augmented states (`_block`). c, f_level: of `strapdown.mechanize`."""
    n = 9 + m
    a = NAV + n
    # Phi P, four columns at once (`_block`), then (Phi P) Phi^T, row by row. In the scratch: Phi P, at u the sensors'
    # columns of it with their white noise, which is treated as an error that is constant over dt, and their rows of P
    g, e = nonnegative(int(mem[Head.SCRATCH_AT])), nonnegative(src + a + 9 * n)
    augmented, u = g + 9 * LANES * _blocks(9), g + 9 * LANES * (_blocks(9) + _blocks(m))
    rows = u + 54
    _sensor_rows(mem, src + a, rows, 9, 6, n, p)
    for block in range(_blocks(9) + _blocks(m)):
        j, q, step = _block(block, 9, m, p, rows, e)
        _put(mem, g + 9 * LANES * block, _strapdown_columns(mem, transition, src + a + j, n, q, step))
    h = 0.5 * dt
    more = force_noise(mem, src)
    gyroscopes = nonnegative(src + NAV + 9 + 3 * p)  # their estimated errors, which w contains in open loop
    for axis in range(3):
        force, turn = _column_at(augmented, 9, p * axis, m), _column_at(augmented, 9, p * (3 + axis), m)
        q = nonnegative(u + 9 * axis)
        white_f = density(mem, sample, axis) + more
        rate = mem[sample + Sample.W_X + axis] - mem[gyroscopes + p * axis]
        white_w = density(mem, sample, 3 + axis) + mem[Turns.NOISE] * rate * rate
        x, y, z = strapdown.column(c, axis)
        turned = h * (y * f_level[2] - z * f_level[1]), h * (z * f_level[0] - x * f_level[2]), h * (
            x * f_level[1] - y * f_level[0])
        _add(mem, q, force, white_f, (h * x, h * y, h * z, x, y, z, 0.0, 0.0, 0.0))
        _add(mem, q + 27, turn, white_w, (
            h * turned[0], h * turned[1], h * turned[2], turned[0], turned[1], turned[2], x, y, z))
    to = nonnegative(dst + a)  # of the rows of velocity and attitude only what is not below the diagonal is needed
    for i in range(3):
        _store(mem, to + n * i, 1, _strapdown_row(mem, transition, g + LANES * i, u + i))
    for i in range(3, 6):
        _store(mem, to + n * i + 3, 1, _strapdown_row(mem, transition, g + LANES * i, u + i)[3:])
    for i in range(6, 9):
        _store(mem, to + n * i + 6, 1, _strapdown_row(mem, transition, g + LANES * i, u + i)[6:])
    _mirror(mem, to, 9, n)
    return augmented


@njit(inline='always')
def _add(mem, to, source, factor, values):
    """Write to `to` the nine elements at source, source + LANES, ... plus `factor` times the nine values."""
    for i in range(9):
        mem[to + i] = mem[source + LANES * i] + factor * values[i]


@njit(inline='always')
def _put(mem, at, values):
    """Write fours, one after the other, to `at` on."""
    for i in range(len(values)):
        put(mem, at + LANES * i, values[i])


@njit(inline='always')
def _store(mem, at, step, values):
    """Write the values to at, at + step, ..."""
    for i in range(len(values)):
        mem[at + step * i] = values[i]
