"""Where everything stands in the filter's memory: named once, used by the kernel and by everybody who reads a state.

One row of floats is one state of the filter: navigation solution, estimated errors x, covariance P.

    nav (NAV) | x (n) | P: navigation block, packed upper triangle | cross block (m, N) | augmented block (m, m)
    | scales of the named inputs

The N navigation error states (5 planar, 9 strapdown) are followed by m augmented states: the sensor error models, one
block of p states for each channel, then the optional states that the configuration asks for. n = N + m.
`StateLayout` knows which index each state has by its name.

Columns are named tuples and not enumerations: compiled code takes their members as constants in every numba.
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
    RADII_LATITUDE: int = column()  # where the two scales were computed
    NORTH_SCALE: int = column()  # rad of latitude per metre
    EAST_SCALE: int = column()  # rad of longitude per metre
    ACCELEROMETER_PHASE: int = column()  # s since the autoregressive model's last step
    GYROSCOPE_PHASE: int = column()
    CONSTRAINT_TIME: int = column()  # s since the last vehicle constraint
    # what the filter has seen of its inputs stands in the row, too, so that going back for a late fix takes it back
    MEMORY: int = column(0)  # the first of these columns, which a prediction only copies
    FIX_TIME: int = column()  # of the last fix, used or refused
    FIX_LATITUDE: int = column()
    FIX_LONGITUDE: int = column()
    RESIDUAL_TIME: int = column()  # of the last fix used, and what it left: updated minus measured position, m
    RESIDUAL_N: int = column()
    RESIDUAL_E: int = column()
    REFUSED: int = column()  # fixes refused in a row, and sums over them for the line their innovations lie on
    REFUSED_SINCE: int = column()
    SUM_T: int = column()
    SUM_TT: int = column()
    SUM_N: int = column()
    SUM_TN: int = column()
    SUM_E: int = column()
    SUM_TE: int = column()
    SUM_SQUARE: int = column()
    LATERAL_NIS: int = column()  # running mean of what the constraints say against the state
    VERTICAL_NIS: int = column()
    BRIDGED: int = column()  # s, within the last minute or so, without a believable IMU sample
    WEIGHTED: int = column()  # fixes that did not fit one after the other, the first of them weighted down
    STRAYED: int = column()  # resets to refused fixes from which the filter had strayed, soon after each other,
    STRAYED_TIME: int = column()  # and when the last one was
    # what the innovations show of the covariance, see trust/receiver.py
    SLOW_N: int = column()  # low-passed whitened innovations of the fixes, and the variance they have when white
    SLOW_E: int = column()
    SLOW_VARIANCE: int = column()
    VARIANCE_FACTOR: int = column()  # realised over expected variance of them; below 1 it counts as 1
    CLAIM_LEVEL: int = column()  # mean logarithm of the claimed variance, m^2
    LASTING: int = column()  # variance of the receiver's errors that last, m^2: the position has them, too
    # whether the fixes or the IMU are right, see trust/contradiction.py
    SLIDING: int = column()  # NIS of the lateral constraint lately, and as is usual for this vehicle
    USUAL_SLIDING: int = column()
    UNSETTLED: int = column()  # s for which the fixes are still to decide
    STOOD: int = column()  # time of the latest standstill, and the velocity that it took away, m/s
    TAKEN_N: int = column()
    TAKEN_E: int = column()
    TURNED: int = column()  # time of the latest standstill at which the gyroscopes showed what is expected of them
    # what has happened to this state, for messages to the user
    SIDEWAYS: int = column()  # s in which the vehicle did not keep to the non-holonomic constraint
    SLID: int = column()  # s in which a slide showed that the IMU misled the filter
    RESTARTS: int = column()  # states that were not finite and were taken back
    RECOVERIES: int = column()  # resets to fixes that had been refused
    MECHANISMS: int = column(241)  # the first of those that the mechanisms ask for (`ROW`), and room for them
    SIZE: int = column(0)


Nav = _Nav()
NAV = Nav.SIZE
#: what mechanisms remember of a state: taken back with it
ROW = Part('a state', Nav.MECHANISMS, Nav.SIZE)
PLANAR, STRAPDOWN = 0, 1
MECHANIZATIONS = {PLANAR: planar, STRAPDOWN: strapdown}


class _Error(NamedTuple):
    """The nine errors of position, velocity and attitude, of which a mechanization has all or some."""

    R_N: int = 0
    R_E: int = 1
    R_D: int = 2
    V_N: int = 3
    V_E: int = 4
    V_D: int = 5
    PHI_N: int = 6
    PHI_E: int = 7
    PHI_D: int = 8  # a planar heading, too
    SIZE: int = 9


Error = _Error()


@dataclass(frozen=True)
class StateLayout:
    """Which state stands where. mechanization: PLANAR or STRAPDOWN. order: states of each sensor channel, p. extras:
    names of the optional states, in order. inputs: how many have a name, with columns of their own at a row's end."""

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
        """Index of each of the nine navigation errors (`Error`) among the states, -1 where it is not there."""
        names = ['phi_d' if name == 'yaw' else name for name in MECHANIZATIONS[self.mechanization].STATES]
        return [names.index(name.lower()) if name.lower() in names else -1 for name in Error._fields[:Error.SIZE]]

    @cached_property
    def axes(self) -> list[int]:
        """Number of the channel of each of f_x, f_y, f_z, w_x, w_y, w_z, -1 where it is not used."""
        return [self.channels.index(name) if name in self.channels else -1 for name in strapdown.CHANNELS]

    @property
    def is_level(self) -> bool:
        """Whether it has neither height nor tilt: the road is taken for level."""
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
        """Number of states behind the navigation errors, m."""
        return self.n_sensor + len(self.extras)

    @property
    def n(self) -> int:
        return self.n_navigation + self.n_augmented

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All states by name, in order: f_x.1, f_x.2 ... where a channel has several."""
        blocks = [channel if self.order == 1 else f'{channel}.{k + 1}' for channel in self.channels
                  for k in range(self.order)]
        return (*MECHANIZATIONS[self.mechanization].STATES, *blocks, *self.extras)

    def index(self, name: str) -> int:
        """Index of the state `name`, -1 where this filter has none of that name."""
        return self.names.index(name) if name in self.names else -1


@njit(_nrt=False)
def nonnegative(position):
    """`position`, of which the compiler then knows that it does not count from the end.

    It else looks at that wherever the position is used, which is a third of the filter's time.
    """
    return position & 0x7FFFFFFFFFFFFFFF


@njit
def packed(i, j, size):
    """Position of element (i, j), i <= j, in the packed upper triangle of a symmetric matrix."""
    return i * size - i * (i - 1) // 2 + j - i


#: floats of a named input at the end of a row: what is seen of it (trust/scale.py)
INPUT_SIZE = 19


def row_width(layout: StateLayout) -> int:
    """Floats in one row."""
    n, m = layout.n_navigation, layout.n_augmented
    return NAV + n + m + n * (n + 1) // 2 + m * (n + m) + INPUT_SIZE * layout.inputs


@njit(_nrt=False)
def load_covariance(row, r, n_navigation, n_augmented, full, at):
    """The covariance of the state at `r` in the array `row`, as a full symmetric matrix (n, n) from full[at] on."""
    n_navigation, n_augmented = nonnegative(n_navigation), nonnegative(n_augmented)
    n = n_navigation + n_augmented
    k = nonnegative(r + NAV + n)
    for i in range(n_navigation):
        for j in range(i, n_navigation):
            full[nonnegative(at + n * i + j)] = full[nonnegative(at + n * j + i)] = row[k]
            k = nonnegative(k + 1)
    for j in range(n_navigation, n):
        line = nonnegative(at + n * j)
        for i in range(n_navigation):
            full[line + i] = full[nonnegative(at + n * i + j)] = row[k + i]
        k = nonnegative(k + n_navigation)
    for i in range(n_navigation, n):
        line = nonnegative(at + n * i + n_navigation)
        for j in range(n_augmented):
            full[line + j] = row[k + j]
        k = nonnegative(k + n_augmented)


@njit(_nrt=False)
def store_covariance(full, at, n_navigation, n_augmented, row, r):
    """Inverse of `load_covariance`."""
    n_navigation, n_augmented = nonnegative(n_navigation), nonnegative(n_augmented)
    n = n_navigation + n_augmented
    k = nonnegative(r + NAV + n)
    for i in range(n_navigation):
        for j in range(i, n_navigation):
            row[k] = full[nonnegative(at + n * i + j)]
            k = nonnegative(k + 1)
    for j in range(n_navigation, n):
        line = nonnegative(at + n * j)
        for i in range(n_navigation):
            row[k + i] = full[line + i]
        k = nonnegative(k + n_navigation)
    for i in range(n_navigation, n):
        line = nonnegative(at + n * i + n_navigation)
        for j in range(n_augmented):
            row[k + j] = full[line + j]
        k = nonnegative(k + n_augmented)


@njit(_nrt=False)
def row_of(mem, error):
    """Index of one of the nine navigation errors (`Error`) among the states; -1: the mechanization has it not."""
    return int(mem[Head.ROWS + error])


@njit(_nrt=False)
def channel_of(mem, axis):
    """Index of the state that is the error of f_x, f_y, f_z, w_x, w_y or w_z (axis 0 to 5); -1: it is not used."""
    channel = int(mem[Head.CHANNEL + axis])
    return int(mem[Head.N_NAVIGATION]) + channel * int(mem[Head.ORDER]) if channel >= 0 else -1


@njit(_nrt=False)
def velocity_state(mem):
    """Index of the north velocity's error among the states; east stands behind it."""
    return row_of(mem, Error.V_N)


@njit(_nrt=False)
def yaw_state(mem):
    """Index of the heading's error among the states."""
    return row_of(mem, Error.PHI_D)


@njit(_nrt=False)
def velocity_variance(mem, r):
    """Of the two horizontal components of the state at r together, m^2/s^2."""
    v, n_navigation = velocity_state(mem), int(mem[Head.N_NAVIGATION])
    k = nonnegative(r + NAV + n_navigation + int(mem[Head.N_AUGMENTED]))
    return mem[k + packed(v, v, n_navigation)] + mem[k + packed(v + 1, v + 1, n_navigation)]


@njit(_nrt=False)
def variance_factor(row, r):
    """By what the covariance of the state at `r` in `row` is to be multiplied before anybody believes it.

    The filter works with the covariance as it is: a common factor changes no gain.
    """
    return max(1.0, row[r + Nav.VARIANCE_FACTOR])


def covariance_index(i: int, j: int, layout: StateLayout) -> int:
    """Column of a row in which element (i, j) of the covariance stands."""
    i, j = min(i, j), max(i, j)
    n, m = layout.n_navigation, layout.n_augmented
    at = NAV + n + m
    triangle = n * (n + 1) // 2
    if j < n:
        return at + packed(i, j, n)
    if i < n:
        return at + triangle + (j - n) * n + i
    return at + triangle + m * n + (i - n) * m + j - n


def covariance(row: np.ndarray, layout: StateLayout) -> np.ndarray:
    """The covariance (n, n) in `row`."""
    full = np.empty(layout.n**2)
    load_covariance(row, 0, layout.n_navigation, layout.n_augmented, full, 0)
    return full.reshape(layout.n, layout.n)


def set_covariance(row: np.ndarray, layout: StateLayout, full: np.ndarray) -> None:
    """Write the covariance (n, n) into `row`."""
    store_covariance(np.ascontiguousarray(full).ravel(), 0, layout.n_navigation, layout.n_augmented, row, 0)


column = numbered()


class _Head(NamedTuple):
    """Sizes, settings and what runs on from sample to sample, at the start of the filter's memory."""

    MECHANIZATION: int = column()
    OPEN_LOOP: int = column()
    N_NAVIGATION: int = column()  # N
    N_AUGMENTED: int = column()  # m
    ORDER: int = column()  # states per sensor channel, p
    CHANNELS: int = column()
    WIDTH: int = column()  # floats in a row
    CAPACITY: int = column()  # rows in the ring
    EVENT_CAPACITY: int = column()
    SAMPLES: int = column()  # IMU samples taken in so far: the newest state is that of row SAMPLES modulo CAPACITY
    EVENTS: int = column()  # measurements remembered
    ROWS_AT: int = column()  # where the parts of the memory begin: states,
    RING_AT: int = column()  # samples,
    EVENTS_AT: int = column()  # measurements,
    SCRATCH_AT: int = column()  # and room to work
    # indices of the optional states among all n; -1: none
    COLOURED: int = column()  # north, and east behind it
    MOUNTING_PITCH: int = column()
    MOUNTING_YAW: int = column()
    AXLE: int = column()
    SPEED_SCALE: int = column()
    TIME_OFFSET: int = column()  # of the receiver's stamps, beyond gnss.time_offset
    ACCELEROMETER_INTERVAL: int = column()  # s, of the autoregressive model; 0: another model
    GYROSCOPE_INTERVAL: int = column()
    MAX_GAP: int = column()
    MAX_DELAY: int = column()
    LEVER_X: int = column()  # of the antenna, body axes forward-right-down, m
    LEVER_Y: int = column()
    LEVER_Z: int = column()
    AXLE_X: int = column()  # from the IMU to the point that does not slip, body axes, m
    AXLE_Y: int = column()
    AXLE_Z: int = column()
    ROBUST_SIGMA: int = column()
    GATE: int = column()  # normalized innovation above which a fix is refused; 0: none
    RECOVERY_TIME: int = column()  # s
    ADAPT: int = column()  # whether the realised sigma of the fixes is used
    CONSTRAINTS: int = column()  # whether there is any vehicle knowledge to apply
    ZERO_VELOCITY_SIGMA: int = column()  # 0: not used
    LATERAL_SIGMA: int = column()  # 0: not used
    VERTICAL_SIGMA: int = column()
    SIDESLIP: int = column()  # rad per m/s^2 of lateral acceleration
    SLIP_SIGMA: int = column()  # sigma of that, rad per m/s^2
    ANGLE_SIGMA: int = column()  # rad: sigma of the direction of motion in the vehicle
    CONDITIONING: int = column(36)  # 6 x 6: body-axis sample = matrix (raw sample) + offset
    OFFSET: int = column(6)  # six
    HISTORY_AT: int = column()  # where a smoother's history begins, see history.py; 0: none
    AXLE_ACROSS: int = column()  # index of the optional state axle_y
    COVARIANCE_FACTOR: int = column()  # whether the covariance is scaled by what the innovations show
    FORGOTTEN: int = column()  # time of the latest measurement that is not kept any more: no state goes back behind it
    ROWS: int = column(9)  # index of each of the nine navigation errors (`Error`) among the states, -1: not there
    CHANNEL: int = column(6)  # number of the channel of each of f_x, f_y, f_z, w_x, w_y, w_z, -1: not used
    AHEAD: int = column()  # s: a measurement that came before an IMU sample may be this much later than it
    MECHANISMS: int = column(75)  # the first of those that the mechanisms ask for (`HEAD`), and room for them
    SIZE: int = column(0)


Head = _Head()
#: settings of mechanisms, and what they remember of the samples, which are not gone back to
HEAD = Part('the head', Head.MECHANISMS, Head.SIZE)


column = numbered()


class _Sample(NamedTuple):
    """One IMU sample as the kernel takes it, body axes forward-right-down, and what the constraints said at it."""

    TIME: int = column()
    F_X: int = column()
    F_Y: int = column()
    F_Z: int = column()
    W_X: int = column()
    W_Y: int = column()
    W_Z: int = column()
    STILL: int = column()  # 1 at rest
    FAULT: int = column()  # why it was not believed (see trust/imu_faults.py); 0: it was
    CONSTRAINT: int = column()  # kind of the constraint that was applied; 0: none
    Z: int = column(3)  # its innovation, three
    S: int = column(3)  # and the variances of that, three
    COASTED: int = column()  # 1: not measured, but made so that the vehicle goes straight on
    INTERVAL: int = column()  # s since the sample before it
    MECHANISMS: int = column(10)  # the first of those that the mechanisms ask for (`SAMPLE`), and room for them
    SIZE: int = column(0)


Sample = _Sample()
#: what mechanisms remember beside a sample
SAMPLE = Part('a sample', Sample.MECHANISMS, Sample.SIZE)


class _Kind(NamedTuple):
    """What a measurement is of: a file of `measurements` each."""

    POSITION: int = 1
    SPEED: int = 2
    VELOCITY: int = 3
    HEADING: int = 4
    PRESSURE: int = 5
    TWIST: int = 6
    PLACE: int = 7  # a fix of a further receiver
    MAGNETIC: int = 8
    ZERO_VELOCITY: int = 9
    ZERO_RATE: int = 10
    NON_HOLONOMIC: int = 11
    WHEEL_VIBRATION: int = 12


Kind = _Kind()


column = numbered()


class _Event(NamedTuple):
    """One measurement as the kernel takes it, and what came of it.

    Up to three components: the first two may be correlated, the third stands alone.
    """

    TIME: int = column()  # at which it describes the vehicle
    KIND: int = column()
    VALUE: int = column(0)  # three
    LATITUDE: int = column()  # of a position
    LONGITUDE: int = column()
    HEIGHT: int = column()
    R_NN: int = column()  # variances of the components, the covariance of the first two in between
    R_NE: int = column()
    R_EE: int = column()
    R_DD: int = column()
    ID: int = column()  # counts the measurements given to the kernel
    Z_N: int = column()  # innovation, predicted minus measured
    Z_E: int = column()
    Z_D: int = column()
    S_NN: int = column()  # its covariance
    S_NE: int = column()
    S_EE: int = column()
    S_DD: int = column()
    NIS: int = column()  # of the first two components
    VERDICT: int = column()  # what the filter did with it, one of `Verdict`
    WEIGHT: int = column()  # 1: as it claims; less: its covariance was raised
    YAW: int = column()  # of the prediction, to see innovations along and across track
    V_N: int = column()
    V_E: int = column()
    WITHDRAWN: int = column()  # 1: it has turned out to be wrong by what came after it
    INPUT: int = column()  # number of the named input that it is from, from 1 on; 0: that of the settings in the head
    STATE: int = column()  # of a named input: index of its own optional state among all n; -1: none
    ARM: int = column(3)  # and three, from the IMU to where it is measured, body axes, m
    STATUS: int = column()  # of a fix, `NavSatStatus.status`: 0, 1 with corrections of satellites, 2 of a base
    DECLINATION: int = column()  # of a magnetic field, as declared, rad
    SIZE: int = column(0)


Event = _Event()


class _Verdict(NamedTuple):
    """What became of a measurement."""

    PENDING: int = 0
    USED: int = 1
    WEIGHTED: int = 2  # used with a larger covariance: it does not fit well
    REFUSED: int = 3  # its innovation is beyond the gate
    FROZEN: int = 4  # it repeats itself although what it measures changes
    RECOVERED: int = 5  # used for a new start: it agrees with those refused before it
    AHEAD: int = 6  # of a time that the IMU's clock has not come to: the clocks differ
    STRAIGHT_ON: int = 7  # the receiver goes straight on without satellites
    CONTRADICTED: int = 8  # a speed that makes up another way than the one between the fixes
    AWAITED: int = 9  # one that does not fit before its way has been compared with that of the fixes


Verdict = _Verdict()


#: the noise stands behind the head: the density squared of the six axes as assumed,
WHITE = Head.SIZE
#: and what drives the states behind the navigation errors, the parts of it one behind the other
_STATES = WHITE + 6


@njit(inline='always')
def decay_at(m, state):
    """Where 1/tau of an augmented state stands; m: how many there are."""
    return _STATES + state


@njit(inline='always')
def walk_at(m, state):
    """Variance that a state gains in a second."""
    return _STATES + m + state


@njit(inline='always')
def variance_at(m, state):
    """Variance that a state which decays keeps."""
    return _STATES + 2 * m + state


@njit(inline='always')
def coefficients_at(m, order, channel):
    """The coefficients of a channel's autoregressive model."""
    return _STATES + 3 * m + order * channel


@njit(inline='always')
def driving_at(m, order, channels, channel):
    """And b0 squared."""
    return _STATES + 3 * m + order * channels + channel


@njit(inline='always')
def restart_at(m, order, channels, channel):
    """Variance that a restart of the sensor adds to a channel."""
    return _STATES + 3 * m + (order + 1) * channels + channel


def noise_size(layout: StateLayout) -> int:
    """Floats of all of that."""
    return 6 + 3 * layout.n_augmented + len(layout.channels) * (layout.order + 2)


def scratch_size(n: int) -> int:
    """Floats the kernel needs to work: P (n, n), six vectors, and one record."""
    return n * n + 6 * n + Event.SIZE


def views(memory: np.ndarray):
    """The parts of the memory as arrays: head, noise, states (capacity + 2, width), samples, events."""
    head = memory[:Head.SIZE]
    rows, ring, events, scratch = (int(head[i]) for i in (Head.ROWS_AT, Head.RING_AT, Head.EVENTS_AT, Head.SCRATCH_AT))
    return (head, memory[Head.SIZE:rows], memory[rows:ring].reshape(-1, int(head[Head.WIDTH])),
            memory[ring:events].reshape(-1, Sample.SIZE), memory[events:scratch].reshape(-1, Event.SIZE))


@njit(_nrt=False)
def state_at(memory, k):
    """Position of the state after sample k."""
    return int(memory[Head.ROWS_AT]) + (k & (int(memory[Head.CAPACITY]) - 1)) * int(memory[Head.WIDTH])


@njit(_nrt=False)
def sample_at(memory, k):
    """Position of sample k."""
    return int(memory[Head.RING_AT]) + (k & (int(memory[Head.CAPACITY]) - 1)) * Sample.SIZE


@njit(_nrt=False)
def event_at(memory, i):
    """Position of measurement i of those remembered, by time."""
    return int(memory[Head.EVENTS_AT]) + i * Event.SIZE
