"""Layout of the filter's memory, one flat array of floats: names of all columns and states.

One row of floats is one state of the filter: navigation solution, estimated errors x, covariance P.

    solution and statistics (NAV) | x (n) | P: rows of the navigation errors (N, n) | augmented block (m, m)
    | statistics of each input but the fixes (INPUT_SIZE)

The block of P below the first is not kept: P is symmetric. The N navigation error states (5 planar, 9 strapdown) are
followed by m augmented states: the sensor error models, one block of p states for each channel, then the optional
states of the configuration. n = N + m. `StateLayout` gives the index of each state by its name.

Columns are named tuples, not enumerations: every version of numba compiles their members as constants.
"""
from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit

from ..navigation import planar, strapdown
from .columns import Part, numbered

column = numbered()


class _Nav(NamedTuple):
    """Columns of the navigation solution in a row."""

    TIME: int = column()  # s since the filter's epoch
    LATITUDE: int = column()
    LONGITUDE: int = column()
    HEIGHT: int = column()
    V_N: int = column()
    V_E: int = column()
    V_D: int = column()
    YAW: int = column(0)  # planar
    Q_W: int = column()  # strapdown: quaternion from b to n
    Q_X: int = column()
    Q_Y: int = column()
    Q_Z: int = column()
    RADII_LATITUDE: int = column()  # latitude at which the two scales were computed
    NORTH_SCALE: int = column()  # rad of latitude per metre
    EAST_SCALE: int = column()  # rad of longitude per metre
    PHASE: int = column(2)  # s since the last step of the autoregressive model of accelerometers and gyroscopes
    CONSTRAINT_TIME: int = column()  # s since the last vehicle constraint
    # Statistics of the inputs are part of the state, so that a return to an earlier state for a late fix restores them
    MEMORY: int = column(0)  # the first of these columns, which a prediction only copies
    FIX_TIME: int = column()  # time and position of the last fix, used or refused
    FIX_LATITUDE: int = column()
    FIX_LONGITUDE: int = column()
    RESIDUAL_TIME: int = column()  # time of the last fix used, and its residual: updated minus measured position, m
    RESIDUAL_N: int = column()
    RESIDUAL_E: int = column()
    REFUSED: int = column(9)  # fixes refused in a row: the line through their innovations (`trust.line.Line`)
    LATERAL_NIS: int = column()  # running mean NIS of the non-holonomic constraint, sideways and vertical
    VERTICAL_NIS: int = column()
    BRIDGED: int = column()  # s since the last valid IMU sample, LONGEST_BRIDGE at most (prediction.py)
    WEIGHTED: int = column()  # fixes in a row beyond gnss.robust_sigma, the first of them weighted down
    DIVERGENCE_TIME: int = column()  # s, of the latest new start from right fixes, from which it had diverged; 0: none
    # consistency of the innovations with the covariance, see trust/receiver.py
    LONG_PASSED: int = column(3)  # low-passed whitened innovations of the fixes, and their variance were they white
    VARIANCE_FACTOR: int = column()  # realised over expected variance of these innovations; below 1 it counts as 1
    CLAIM_LEVEL: int = column()  # mean logarithm of the claimed variance, m^2
    LASTING: int = column()  # variance of the receiver's slow errors, m^2, which are part of the position error
    ARM_VARIANCE: int = column()  # variance of the error of the antenna's lever arm, forward and right each, m^2
    # whether the fixes or the IMU are wrong, see trust/contradiction.py
    SLIDING_NIS: int = column()  # NIS of the lateral constraint, mean of the last second
    USUAL_SLIDING_NIS: int = column()  # the same NIS, long-term mean: what is usual for this vehicle
    USE_ALL_FIXES: int = column()  # s for which fixes are still used whatever their innovations
    # counts for messages to the user
    SIDEWAYS: int = column()  # s during which the vehicle violated the non-holonomic constraint
    SLID: int = column()  # s during which a contradiction showed that the IMU was wrong
    RESTARTS: int = column()  # states that were not finite and were replaced by an earlier one
    RECOVERIES: int = column()  # restarts from fixes that had been refused
    MECHANISMS: int = column(213)  # room for the columns that other files declare (`ROW`)
    SIZE: int = column(0)


Nav = _Nav()
NAV = Nav.SIZE  # columns before the estimated errors in a row
#: columns of a state that other files declare; a return to an earlier state restores them with the state
ROW = Part('a state', Nav.MECHANISMS, Nav.SIZE)
#: numbers of the mechanizations: planar (north, east, heading), and in three dimensions
PLANAR, STRAPDOWN = 0, 1
MECHANIZATIONS = {PLANAR: planar, STRAPDOWN: strapdown}  # and their modules
BY_NAME = {'planar': PLANAR, 'strapdown': STRAPDOWN}  # as the parameter `mechanization` has it


#: the nine errors of position, velocity and attitude; PHI_D is also the planar yaw. Planar has only some as states
Error = strapdown.State


@dataclass(frozen=True)
class StateLayout:
    """Index of each state. mechanization: PLANAR or STRAPDOWN. order: states of each sensor channel, p. extras: names
    of the optional states, in order. inputs: number of inputs but the fixes, each with columns at the end of a row."""

    mechanization: int
    order: int
    extras: tuple[str, ...] = ()
    inputs: int = 0

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Names of the sensor channels the mechanization uses."""
        return MECHANIZATIONS[self.mechanization].CHANNELS

    @cached_property
    def rows(self) -> list[int]:
        """Index of each of the nine navigation errors (`Error`) among the states, -1: not a state."""
        names = ['phi_d' if name == 'yaw' else name for name in MECHANIZATIONS[self.mechanization].STATES]
        return [names.index(name.lower()) if name.lower() in names else -1 for name in Error._fields[:Error.SIZE]]

    @cached_property
    def axes(self) -> list[int]:
        """Channel of each of f_x, f_y, f_z, w_x, w_y, w_z, -1: not used."""
        return [self.channels.index(name) if name in self.channels else -1 for name in strapdown.CHANNELS]

    @property
    def is_level(self) -> bool:
        """Whether there are no states for height and tilt: roads are assumed to be level."""
        return self.rows[Error.PHI_N] < 0

    @cached_property
    def n_navigation(self) -> int:
        """Number of navigation error states, N."""
        return len(MECHANIZATIONS[self.mechanization].STATES)

    @property
    def n_sensor(self) -> int:
        """Number of states of the sensor error models."""
        return len(self.channels) * self.order

    @property
    def n_augmented(self) -> int:
        """Number of states after the navigation errors, m."""
        return self.n_sensor + len(self.extras)

    @property
    def n(self) -> int:
        return self.n_navigation + self.n_augmented

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all states, in order; f_x.1, f_x.2 ... where a channel has several."""
        blocks = [channel if self.order == 1 else f'{channel}.{k + 1}' for channel in self.channels
                  for k in range(self.order)]
        return (*MECHANIZATIONS[self.mechanization].STATES, *blocks, *self.extras)

    @cached_property
    def _indices(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    def index(self, name: str) -> int:
        """Index of the state `name`, -1 where there is none."""
        return self._indices.get(name, -1)


@njit(_nrt=False)
def nonnegative(position):
    """Return `position`, which is not negative, in a form in which the compiler knows that it is not negative.

    Otherwise a numba that `compiled_parts` has not been tried with would test at each use for a negative index (one
    from the end), which takes a third of the filter's time.
    """
    return position & 0x7FFFFFFFFFFFFFFF


INPUT_SIZE = 56  # floats of each input but the fixes at the end of a row
#: columns of one of these inputs, from `input_at` on, which other files declare: its statistics
INPUT = Part('an input', 0, INPUT_SIZE)


def row_width(layout: StateLayout) -> int:
    """Floats in one row."""
    n, m = layout.n_navigation, layout.n_augmented
    return NAV + n + m + n * (n + m) + m * m + INPUT_SIZE * layout.inputs


@njit(_nrt=False)
def load_covariance(row, r, n_navigation, n_augmented, full, at):
    """Write the covariance of the state at row[r] as a full symmetric matrix (n, n) to full[at] on."""
    n_navigation, n_augmented, at = nonnegative(n_navigation), nonnegative(n_augmented), nonnegative(at)
    n = n_navigation + n_augmented
    k, above = nonnegative(r + NAV + n), n * n_navigation
    for i in range(above):
        full[at + i] = row[k + i]
    k += above
    for i in range(n_augmented):
        line = at + above + n * i
        for j in range(n_navigation):
            full[line + j] = full[at + n * j + n_navigation + i]
        for j in range(n_augmented):
            full[line + n_navigation + j] = row[k + n_augmented * i + j]


@njit(_nrt=False)
def store_covariance(full, at, n_navigation, n_augmented, row, r):
    """Inverse of `load_covariance`."""
    n_navigation, n_augmented, at = nonnegative(n_navigation), nonnegative(n_augmented), nonnegative(at)
    n = n_navigation + n_augmented
    k, above = nonnegative(r + NAV + n), n * n_navigation
    for i in range(above):
        row[k + i] = full[at + i]
    k += above
    for i in range(n_augmented):
        line = at + above + n * i + n_navigation
        for j in range(n_augmented):
            row[k + n_augmented * i + j] = full[line + j]


@njit(_nrt=False)
def element_at(mem, r, i, j):
    """Position of element (i, j) of the covariance of the state at r. i: index of a navigation error."""
    n = int(mem[Head.N_NAVIGATION]) + int(mem[Head.N_AUGMENTED])
    return nonnegative(r + NAV + n + n * i + j)


@njit(_nrt=False)
def sensor_variance_at(mem, r, state):
    """Position of the variance of an augmented state in the covariance of the state at r. state: its index among all.
    """
    first, m = int(mem[Head.N_NAVIGATION]), int(mem[Head.N_AUGMENTED])
    return nonnegative(r + NAV + (first + 1) * (first + m) + (m + 1) * (state - first))


@njit(inline='always')
def copy(target, to, source, at, count):
    """Copy `count` elements of the array `source` from position `at` on to `target` from position `to` on, in ascending
    order; both may be the same array."""
    for i in range(count):
        target[to + i] = source[at + i]


@njit(_nrt=False)
def has_constraints(mem):
    """Whether the standstill or the non-holonomic constraint is used."""
    return mem[Head.ZERO_VELOCITY_SIGMA] > 0.0 or mem[Head.LATERAL_SIGMA] > 0.0


@njit(_nrt=False)
def row_of(mem, error):
    """Index of one of the nine navigation errors (`Error`) among the states; -1: not a state of this mechanization."""
    return int(mem[Head.ROWS + error])


@njit(_nrt=False)
def channel_of(mem, axis):
    """Index of the first state of the error of f_x, f_y, f_z, w_x, w_y or w_z (axis 0 to 5); -1: not used."""
    channel = int(mem[Head.CHANNEL + axis])
    return int(mem[Head.N_NAVIGATION]) + channel * int(mem[Head.ORDER]) if channel >= 0 else -1


@njit(_nrt=False)
def velocity_state(mem):
    """Index of the error of the north velocity among the states; that of the east velocity follows it."""
    return row_of(mem, Error.V_N)


@njit(_nrt=False)
def yaw_state(mem):
    """Index of the error of the heading among the states."""
    return row_of(mem, Error.PHI_D)


@njit(_nrt=False)
def velocity_variance(mem, r):
    """Sum of the variances of the two horizontal velocity components of the state at r, m^2/s^2."""
    v = velocity_state(mem)
    return mem[element_at(mem, r, v, v)] + mem[element_at(mem, r, v + 1, v + 1)]


@njit(_nrt=False)
def variance_factor(row, r):
    """Factor from the covariance P of the state at row[r] to the published covariance.

    The filter itself works with P: a common factor changes no gain.
    """
    return max(1.0, row[r + Nav.VARIANCE_FACTOR])


def covariance_index(i: int, j: int, layout: StateLayout) -> int:
    """Column of element (i, j) of the covariance in a row."""
    i, j = min(i, j), max(i, j)
    n, m = layout.n_navigation, layout.n_augmented
    at = NAV + n + m
    return at + (n + m) * i + j if i < n else at + (n + m) * n + m * (i - n) + j - n


def covariance(row: np.ndarray, layout: StateLayout) -> np.ndarray:
    """The covariance (n, n) in `row`."""
    full = np.empty(layout.n**2)
    load_covariance(row, 0, layout.n_navigation, layout.n_augmented, full, 0)
    return full.reshape(layout.n, layout.n)


def set_covariance(row: np.ndarray, layout: StateLayout, full: np.ndarray) -> None:
    """Write the covariance (n, n) into `row`, symmetric to the last bit: as above the diagonal."""
    symmetric = np.triu(full) + np.triu(full, 1).T
    store_covariance(symmetric.ravel(), 0, layout.n_navigation, layout.n_augmented, row, 0)


def newest_row(memory: np.ndarray) -> np.ndarray:
    """The newest state in the filter's memory, (width,): a view."""
    at = state_at(memory, int(memory[Head.SAMPLES]))
    return memory[at:at + int(memory[Head.WIDTH])]


column = numbered()


class _Head(NamedTuple):
    """Sizes, settings and counters, at the start of the filter's memory. A late measurement does not restore them."""

    MECHANIZATION: int = column()
    OPEN_LOOP: int = column()
    N_NAVIGATION: int = column()  # N
    N_AUGMENTED: int = column()  # m
    ORDER: int = column()  # states per sensor channel, p
    CHANNELS: int = column()
    WIDTH: int = column()  # floats in a row
    CAPACITY: int = column()  # IMU samples in their ring, a power of two
    EVENT_CAPACITY: int = column()
    SAMPLES: int = column()  # IMU samples so far, which is the number of the newest state
    EVENTS: int = column()  # number of measurements in the memory
    ROWS_AT: int = column()  # first position of the states,
    RING_AT: int = column()  # first position of the IMU samples,
    EVENTS_AT: int = column()  # first position of the measurements,
    SCRATCH_AT: int = column()  # and first position of the scratch
    # indices of the optional states among all n; -1: none
    COLOURED: int = column()  # coloured_n, followed by coloured_e
    MOUNTING_PITCH: int = column()
    MOUNTING_YAW: int = column()
    AXLE: int = column()
    INTERVAL: int = column(2)  # s, T_s of the autoregressive models of accelerometers and gyroscopes; 0: other models
    MAX_GAP: int = column()  # s
    MAX_DELAY: int = column()  # s
    LEVER_X: int = column()  # lever arm of the antenna, body axes forward-right-down, m
    LEVER_Y: int = column()
    LEVER_Z: int = column()
    AXLE_X: int = column()  # from the IMU to the point that does not slip, body axes, m
    AXLE_Y: int = column()
    AXLE_Z: int = column()
    ROBUST_SIGMA: int = column()
    GATE: int = column()  # normalized innovation above which a fix is refused; 0: none
    RECOVERY_TIME: int = column()  # s
    ADAPT: int = column()  # whether the realised sigma of the fixes is used
    ZERO_VELOCITY_SIGMA: int = column()  # 0: not used
    LATERAL_SIGMA: int = column()  # 0: not used
    VERTICAL_SIGMA: int = column()
    SIDESLIP: int = column()  # sideslip angle, rad per m/s^2 of lateral acceleration,
    SLIP_SIGMA: int = column()  # and its standard deviation, rad per m/s^2
    ANGLE_SIGMA: int = column()  # standard deviation of the direction of motion in the vehicle's axes, rad
    CONDITIONING: int = column(36)  # 6 x 6, by columns: body-axis sample = matrix (raw sample) + offset
    OFFSET: int = column(6)
    HISTORY_AT: int = column()  # first position of the smoother's history, see history.py; 0: none
    AXLE_ACROSS: int = column()  # indices of the optional states axle_y
    AXLE_BELOW: int = column()  # and axle_z
    COVARIANCE_FACTOR: int = column()  # whether the published covariance has the factor Nav.VARIANCE_FACTOR
    FORGOTTEN: int = column()  # time of the newest measurement that was dropped: the filter cannot return before it
    ROWS: int = column(9)  # `StateLayout.rows`
    CHANNEL: int = column(6)  # `StateLayout.axes`
    AHEAD: int = column()  # s: a measurement may be this much later than the newest IMU sample
    MECHANISMS: int = column(81)  # room for the columns that other files declare (`HEAD`)
    SIZE: int = column(0)


Head = _Head()
#: columns of the head that other files declare: settings, and statistics of IMU samples
HEAD = Part('the head', Head.MECHANISMS, Head.SIZE)


column = numbered()


class _Sample(NamedTuple):
    """One IMU sample, body axes forward-right-down, and the constraint applied at it."""

    TIME: int = column()
    F_X: int = column()
    F_Y: int = column()
    F_Z: int = column()
    W_X: int = column()
    W_Y: int = column()
    W_Z: int = column()
    STILL: int = column()  # s for which the samples have been as quiet as at rest; 0: this one is not
    FAULT: int = column()  # why it is replaced by straight motion, `trust.imu_faults.Fault`; 0: it is used
    CONSTRAINT: int = column()  # kind of the constraint applied; 0: none
    Z: int = column(3)  # innovation of the constraint
    S: int = column(3)  # and its variances
    INTERVAL: int = column()  # s since the previous sample
    RATE_SCATTER: int = column()  # (rad/s)^2, running variance of the angular rates up to it
    MECHANISMS: int = column(15)  # room for the columns that other files declare (`SAMPLE`)
    SIZE: int = column(0)


Sample = _Sample()
SAMPLE = Part('a sample', Sample.MECHANISMS, Sample.SIZE)  # columns of a sample that other files declare


class _Kind(NamedTuple):
    """What is measured; each has a file in `measurements`, but PLACE, which is in position.py."""

    POSITION: int = 1
    SPEED: int = 2
    VELOCITY: int = 3
    HEADING: int = 4
    PRESSURE: int = 5
    TWIST: int = 6
    PLACE: int = 7  # a fix of a further receiver
    MAGNETIC: int = 8
    ZERO_VELOCITY: int = 9
    NON_HOLONOMIC: int = 11


Kind = _Kind()


@njit(_nrt=False)
def is_of_velocity(kind):
    """Whether a measurement of this kind is of the velocity."""
    return kind == Kind.SPEED or kind == Kind.VELOCITY or kind == Kind.TWIST


@njit(_nrt=False)
def is_of_heading(kind):
    """Whether a measurement of this kind is of the heading."""
    return kind == Kind.HEADING or kind == Kind.MAGNETIC


column = numbered()


class _Event(NamedTuple):
    """Columns of one measurement: what was measured, and what the filter did with it.

    It has up to three components, which are called N, E, D whatever they are; the first two may be correlated.
    """

    TIME: int = column()  # s since the epoch, at which it describes the vehicle
    KIND: int = column()
    VALUE: int = column(0)  # up to three measured values,
    LATITUDE: int = column()  # or a position
    LONGITUDE: int = column()
    HEIGHT: int = column()
    R_NN: int = column()  # variances of the components, and the covariance of the first two
    R_NE: int = column()
    R_EE: int = column()
    R_DD: int = column()
    ID: int = column()  # serial number of the measurements given to the kernel
    Z_N: int = column()  # innovation, predicted minus measured
    Z_E: int = column()
    Z_D: int = column()
    S_NN: int = column()  # covariance of the innovation
    S_NE: int = column()
    S_EE: int = column()
    S_DD: int = column()
    NIS: int = column()  # normalized innovation squared of the first two components
    VERDICT: int = column()  # what the filter did with it, one of `Verdict`
    WEIGHT: int = column()  # factor by which the robust weight multiplied the inverse of S, 0 to 1
    YAW: int = column()  # predicted yaw and velocity, for innovations along and across track
    V_N: int = column()
    V_E: int = column()
    WITHDRAWN: int = column()  # 1: a later measurement has shown that it is wrong
    # what belongs to its input, as `FilterConfig.of_input` has it
    INPUT: int = column()  # number of its input from 1 on, in the order of the statistics at the end of a row; 0: fix
    STATE: int = column()  # index of its first optional state among all n; -1: none
    TIME_OFFSET: int = column()  # index of the state of its time offset among all n; 0 (a position state): none
    AT_AXLE: int = column()  # 1: of the axle that does not steer, whose place is estimated
    ARM: int = column(3)  # lever arm from the IMU to where it is measured, body axes, m
    LAG: int = column()  # time constant of the low pass that it comes through, s; 0: none
    INPUT_END: int = column(0)
    STATUS: int = column()  # if a fix: `NavSatStatus.status`, 0 plain, 1 with satellite corrections, 2 with a base
    DECLINATION: int = column()  # if a magnetic field: declination as configured, rad
    SIZE: int = column(0)


Event = _Event()


class _Verdict(NamedTuple):
    """What the filter did with a measurement."""

    PENDING: int = 0  # not applied yet
    USED: int = 1
    WEIGHTED: int = 2  # used with a larger covariance, as its innovation is large
    REFUSED: int = 3  # refused: its innovation is beyond the gate
    FROZEN: int = 4  # refused: its value does not change although the state does
    RECOVERED: int = 5  # the filter restarted from it, as it agrees with fixes refused before
    AHEAD: int = 6  # refused: its stamp is later than that of the next IMU sample
    EXTRAPOLATED: int = 7  # refused: the receiver extrapolates a straight line without satellites
    CONTRADICTED: int = 8  # refused: its integral differs from the displacement between fixes
    AWAITED: int = 9  # not used: its integral has not been compared with the fixes yet, and its innovation is large


Verdict = _Verdict()


#: number of newest states that are kept, a power of two: those of the default of gnss.max_delay at 100 Hz, and more. Of
#: earlier states each NEWEST-th is kept; others are computed from it by repeating the samples in between. This number
#: of states (0.5 MB) fits into the processor's second-level cache. With all states kept, a sample takes 1.3 times as
#: long on a busy machine
NEWEST = 128
#: first position of the noise parameters, which follow the head: white noise densities squared of the six axes
WHITE = Head.SIZE
_STATES = WHITE + 6  # then the noise parameters of the augmented states, at the positions that the functions below give


@njit(inline='always')
def decay_at(state):
    """Position of 1/tau of an augmented state."""
    return _STATES + state


@njit(inline='always')
def walk_at(m, state):
    """Position of the variance that a state gains in a second (random walk); m: number of augmented states."""
    return _STATES + m + state


@njit(inline='always')
def variance_at(m, state):
    """Position of the stationary variance of a state (Gauss-Markov)."""
    return _STATES + 2 * m + state


@njit(inline='always')
def coefficients_at(m, order, channel):
    """Position of the coefficients of a channel's autoregressive model."""
    return _STATES + 3 * m + order * channel


@njit(inline='always')
def driving_at(m, order, channels, channel):
    """Position of b0 squared of a channel's autoregressive model."""
    return _STATES + 3 * m + order * channels + channel


@njit(inline='always')
def restart_at(m, order, channels, channel):
    """Position of the variance that a restart of the IMU adds to a channel's error."""
    return _STATES + 3 * m + (order + 1) * channels + channel


def noise_size(layout: StateLayout) -> int:
    """Number of floats of the noise parameters."""
    return 6 + 3 * layout.n_augmented + len(layout.channels) * (layout.order + 2)


def scratch_size(n: int) -> int:
    """Number of floats of the scratch: P (n, n), six vectors (n,), and one event."""
    return n * n + 6 * n + Event.SIZE


def views(memory: np.ndarray):
    """Views of the memory: head, noise, states (capacity + 2, width), IMU samples, measurements."""
    head = memory[:Head.SIZE]
    rows, ring, events, scratch = (int(head[i]) for i in (Head.ROWS_AT, Head.RING_AT, Head.EVENTS_AT, Head.SCRATCH_AT))
    return (head, memory[Head.SIZE:rows], memory[rows:ring].reshape(-1, int(head[Head.WIDTH])),
            memory[ring:events].reshape(-1, Sample.SIZE), memory[events:scratch].reshape(-1, Event.SIZE))


def count_states(capacity: int) -> int:
    """Rows for states where the memory has `capacity` IMU samples: those of `state_at`, and two more for states between
    samples."""
    return capacity // NEWEST + NEWEST - 1 + 2


@njit(_nrt=False)
def state_at(memory, k):
    """Position of the state after sample k: of one of the NEWEST last ones, or of one of the earlier ones whose number
    is a multiple of NEWEST."""
    number, earlier = k & (NEWEST - 1), int(memory[Head.CAPACITY]) // NEWEST
    row = earlier - 1 + number if number else (k // NEWEST) & (earlier - 1)
    return int(memory[Head.ROWS_AT]) + row * int(memory[Head.WIDTH])


@njit(_nrt=False)
def sample_at(memory, k):
    """Position of sample k."""
    return int(memory[Head.RING_AT]) + (k & (int(memory[Head.CAPACITY]) - 1)) * Sample.SIZE


@njit(_nrt=False)
def event_at(memory, i):
    """Position of measurement i of those in the memory, in the order of time."""
    return int(memory[Head.EVENTS_AT]) + i * Event.SIZE


@njit(_nrt=False)
def input_at(memory, r, at):
    """Position of the statistics (`INPUT`) of the input of the event at `at`, in the state at r."""
    return r + int(memory[Head.WIDTH]) - INPUT_SIZE * int(memory[at + Event.INPUT])


@njit(_nrt=False)
def time_of(memory, k):
    """Time of state k, s since the filter's epoch: that of its sample."""
    return memory[sample_at(memory, k) + Sample.TIME]


@njit(_nrt=False)
def oldest_state(memory):
    """Number of the oldest state that the filter can return to: it repeats no more than half of the samples."""
    return max(0, int(memory[Head.SAMPLES]) - int(memory[Head.CAPACITY]) // 2 + 1)


@njit(_nrt=False)
def state_before(memory, time):
    """Number of the last state before `time`, s, or of the oldest that the filter can return to."""
    k, oldest = int(memory[Head.SAMPLES]), oldest_state(memory)
    while k > oldest and time_of(memory, k) >= time:
        k -= 1
    return k


@njit(_nrt=False)
def kept_state(memory, k):
    """Number of the last state in the memory that is not later than state k: to return to k, the filter repeats the
    samples between them."""
    return k if int(memory[Head.SAMPLES]) - k < NEWEST else k - k % NEWEST
