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
from typing import NamedTuple

import numpy as np

from mems_ins_fusion.compiled import njit

from ..navigation import planar, strapdown
from .columns import Part


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
    # what the filter has seen of its inputs stands in the row, too: who goes back for a late fix takes it back
    MEMORY: int = 17  # the first of these columns, which a prediction only copies
    FIX_TIME: int = 17  # of the last fix, used or refused
    FIX_LATITUDE: int = 18
    FIX_LONGITUDE: int = 19
    RESIDUAL_TIME: int = 20  # of the last fix used, and what it left: updated minus measured position, m
    RESIDUAL_N: int = 21
    RESIDUAL_E: int = 22
    REFUSED: int = 23  # fixes refused one after the other, and sums over them for the line their innovations lie on
    REFUSED_SINCE: int = 24
    SUM_T: int = 25
    SUM_TT: int = 26
    SUM_N: int = 27
    SUM_TN: int = 28
    SUM_E: int = 29
    SUM_TE: int = 30
    SUM_SQUARE: int = 31
    FROZEN: int = 32  # fixes at the very same place one after the other
    LATERAL_NIS: int = 33  # running mean of what the constraints say against the state
    VERTICAL_NIS: int = 34
    BRIDGED: int = 35  # s, within the last minute or so, without a believable IMU sample
    WEIGHTED: int = 36  # fixes that did not fit one after the other, the first of them weighted down
    STRAYED: int = 37  # resets to refused fixes from which the filter had strayed, soon after each other,
    STRAYED_TIME: int = 38  # and when the last one was
    # what the innovations show of the covariance, see trust/receiver.py
    SLOW_N: int = 39  # low-passed whitened innovations of the fixes, and the variance they have when white
    SLOW_E: int = 40
    SLOW_VARIANCE: int = 41
    VARIANCE_FACTOR: int = 42  # realised over expected variance of them; below 1 it counts as 1
    CLAIM_LEVEL: int = 43  # mean logarithm of the claimed variance, m^2
    LASTING: int = 44  # variance of the receiver's errors that last, m^2: the position has them, too
    # who is right, fixes or IMU, see trust/contradiction.py
    SLIDING: int = 45  # NIS of the lateral constraint lately, and as is usual for this vehicle
    USUAL_SLIDING: int = 46
    UNSETTLED: int = 47  # s for which the fixes are still to decide
    MOVED_N: int = 48  # by what fixes that do not fit have moved position, m, and velocity, m/s, until the last fix
    MOVED_E: int = 49
    MOVED_V_N: int = 50
    MOVED_V_E: int = 51
    LEFT_N: int = 52  # m: and how far they still are from it
    LEFT_E: int = 53
    MISFIT_FOR: int = 54  # s for which whatever fixes change still counts
    MISFITS: int = 55  # how many of the latest fixes did not fit
    UNDECIDED: int = 56  # above 0: too many fixes did not fit for chance; fades with how far they have moved the state
    STOOD: int = 57  # time of the latest standstill, and the velocity that it took away, m/s
    TAKEN_N: int = 58
    TAKEN_E: int = 59
    # what has happened to this state, for who wants to say it
    SIDEWAYS: int = 60  # s in which the vehicle did not keep to the non-holonomic constraint
    SLID: int = 61  # s in which a slide showed that the IMU misled the filter
    RESTARTS: int = 62  # states that were not finite and were taken back
    RECOVERIES: int = 63  # resets to fixes that had been refused
    MECHANISMS: int = 64  # the first of those that the mechanisms ask for (`ROW`), and room for them
    SIZE: int = 148


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
    names of the optional states, in order. inputs: how many have a name, each with a scale at the end of a row."""

    mechanization: int
    order: int
    extras: tuple[str, ...] = ()
    inputs: int = 0

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the sensor channels the mechanization uses."""
        return MECHANIZATIONS[self.mechanization].CHANNELS

    @property
    def rows(self) -> list[int]:
        """Index of each of the nine navigation errors (`Error`) among the states, -1 where it is not there."""
        names = ['phi_d' if name == 'yaw' else name for name in MECHANIZATIONS[self.mechanization].STATES]
        return [names.index(name.lower()) if name.lower() in names else -1 for name in Error._fields[:Error.SIZE]]

    @property
    def axes(self) -> list[int]:
        """Number of the channel of each of f_x, f_y, f_z, w_x, w_y, w_z, -1 where it is not used."""
        return [self.channels.index(name) if name in self.channels else -1 for name in strapdown.CHANNELS]

    @property
    def is_level(self) -> bool:
        """Whether it has neither height nor tilt: the road is taken for level."""
        return self.rows[Error.PHI_N] < 0

    @property
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

    @property
    def names(self) -> tuple[str, ...]:
        """All states by name, in order: f_x.1, f_x.2 ... where a channel has several."""
        blocks = [channel if self.order == 1 else f'{channel}.{k + 1}' for channel in self.channels
                  for k in range(self.order)]
        return (*MECHANIZATIONS[self.mechanization].STATES, *blocks, *self.extras)

    def index(self, name: str) -> int:
        """Index of the state `name`, -1 where this filter has none of that name."""
        return self.names.index(name) if name in self.names else -1


@njit(_nrt=False)
def place(position):
    """`position`, of which the compiler then knows that it does not count from the end.

    It else looks at that wherever the position is used, which is a third of the filter's time.
    """
    return position & 0x7FFFFFFFFFFFFFFF


@njit
def packed(i, j, size):
    """Position of element (i, j), i <= j, in the packed upper triangle of a symmetric matrix."""
    return i * size - i * (i - 1) // 2 + j - i


#: floats of a named input at the end of a row: its `Scale`
INPUT_SIZE = 3


def row_width(layout: StateLayout) -> int:
    """Floats in one row."""
    n, m = layout.n_navigation, layout.n_augmented
    return NAV + n + m + n * (n + 1) // 2 + m * (n + m) + INPUT_SIZE * layout.inputs


@njit(_nrt=False)
def load_covariance(row, r, n_navigation, n_augmented, full, at):
    """The covariance of the state at `r` in the array `row`, as a full symmetric matrix (n, n) from full[at] on."""
    n_navigation, n_augmented = place(n_navigation), place(n_augmented)
    n = n_navigation + n_augmented
    k = place(r + NAV + n)
    for i in range(n_navigation):
        for j in range(i, n_navigation):
            full[place(at + n * i + j)] = full[place(at + n * j + i)] = row[k]
            k = place(k + 1)
    for j in range(n_navigation, n):
        line = place(at + n * j)
        for i in range(n_navigation):
            full[line + i] = full[place(at + n * i + j)] = row[k + i]
        k = place(k + n_navigation)
    for i in range(n_navigation, n):
        line = place(at + n * i + n_navigation)
        for j in range(n_augmented):
            full[line + j] = row[k + j]
        k = place(k + n_augmented)


@njit(_nrt=False)
def store_covariance(full, at, n_navigation, n_augmented, row, r):
    """Inverse of `load_covariance`."""
    n_navigation, n_augmented = place(n_navigation), place(n_augmented)
    n = n_navigation + n_augmented
    k = place(r + NAV + n)
    for i in range(n_navigation):
        for j in range(i, n_navigation):
            row[k] = full[place(at + n * i + j)]
            k = place(k + 1)
    for j in range(n_navigation, n):
        line = place(at + n * j)
        for i in range(n_navigation):
            row[k + i] = full[line + i]
        k = place(k + n_navigation)
    for i in range(n_navigation, n):
        line = place(at + n * i + n_navigation)
        for j in range(n_augmented):
            row[k + j] = full[line + j]
        k = place(k + n_augmented)


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
    k = place(r + NAV + n_navigation + int(mem[Head.N_AUGMENTED]))
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


class _Head(NamedTuple):
    """Sizes, settings and what runs on from sample to sample, at the start of the filter's memory."""

    MECHANIZATION: int = 0
    OPEN_LOOP: int = 1
    N_NAVIGATION: int = 2  # N
    N_AUGMENTED: int = 3  # m
    ORDER: int = 4  # states per sensor channel, p
    CHANNELS: int = 5
    WIDTH: int = 6  # floats in a row
    CAPACITY: int = 7  # rows in the ring
    EVENT_CAPACITY: int = 8
    SAMPLES: int = 9  # IMU samples taken in so far: the newest state is that of row SAMPLES modulo CAPACITY
    EVENTS: int = 10  # measurements remembered
    ROWS_AT: int = 11  # where the parts of the memory begin: states,
    RING_AT: int = 12  # samples,
    EVENTS_AT: int = 13  # measurements,
    SCRATCH_AT: int = 14  # and room to work
    # indices of the optional states among all n; -1: none
    COLOURED: int = 15  # north, and east behind it
    MOUNTING_PITCH: int = 16
    MOUNTING_YAW: int = 17
    AXLE: int = 18
    SPEED_SCALE: int = 19
    TIME_OFFSET: int = 20  # of the receiver's stamps, beyond gnss.time_offset
    ACCELEROMETER_INTERVAL: int = 21  # s, of the autoregressive model; 0: another model
    GYROSCOPE_INTERVAL: int = 22
    MAX_GAP: int = 23
    MAX_DELAY: int = 24
    LEVER_X: int = 25  # of the antenna, body axes forward-right-down, m
    LEVER_Y: int = 26
    LEVER_Z: int = 27
    AXLE_X: int = 28  # from the IMU to the point that does not slip, body axes, m
    AXLE_Y: int = 29
    AXLE_Z: int = 30
    ROBUST_SIGMA: int = 31
    GATE: int = 32  # normalized innovation above which a fix is refused; 0: none
    RECOVERY_TIME: int = 33  # s
    ADAPT: int = 34  # whether the realised sigma of the fixes is used
    CONSTRAINTS: int = 35  # whether there is any vehicle knowledge to apply
    ZERO_VELOCITY_SIGMA: int = 36  # 0: not used
    LATERAL_SIGMA: int = 37  # 0: not used
    VERTICAL_SIGMA: int = 38
    SIDESLIP: int = 39  # rad per m/s^2 of lateral acceleration
    SLIP_SIGMA: int = 40  # sigma of that, rad per m/s^2
    ANGLE_SIGMA: int = 41  # rad: sigma of the direction of motion in the vehicle
    CONDITIONING: int = 42  # 6 x 6: body-axis sample = matrix (raw sample) + offset
    OFFSET: int = 78  # six
    HISTORY_AT: int = 84  # where a smoother's history begins, see history.py; 0: none
    AXLE_ACROSS: int = 85  # index of the optional state axle_y
    COVARIANCE_FACTOR: int = 86  # whether the covariance is scaled by what the innovations show
    FORGOTTEN: int = 87  # time of the latest measurement that is not remembered any more: no state goes back behind it
    ROWS: int = 88  # index of each of the nine navigation errors (`Error`) among the states, -1: not there
    CHANNEL: int = 97  # number of the channel of each of f_x, f_y, f_z, w_x, w_y, w_z, -1: not used
    AHEAD: int = 103  # s: a measurement that came before an IMU sample may be this much later than it
    MECHANISMS: int = 104  # the first of those that the mechanisms ask for (`HEAD`), and room for them
    SIZE: int = 174


Head = _Head()
#: settings of mechanisms, and what they remember of the samples, which are not gone back to
HEAD = Part('the head', Head.MECHANISMS, Head.SIZE)


class _Sample(NamedTuple):
    """One IMU sample as the kernel takes it, body axes forward-right-down, and what the constraints said at it."""

    TIME: int = 0
    F_X: int = 1
    F_Y: int = 2
    F_Z: int = 3
    W_X: int = 4
    W_Y: int = 5
    W_Z: int = 6
    STILL: int = 7  # 1 at rest
    FAULT: int = 8  # why it was not believed (see trust/imu_faults.py); 0: it was
    CONSTRAINT: int = 9  # kind of the constraint that was applied; 0: none
    Z: int = 10  # its innovation, three
    S: int = 13  # and the variances of that, three
    COASTED: int = 16  # 1: not measured, but made so that the vehicle goes straight on
    INTERVAL: int = 17  # s since the sample before it
    MECHANISMS: int = 18  # the first of those that the mechanisms ask for (`SAMPLE`), and room for them
    SIZE: int = 28


Sample = _Sample()
#: what mechanisms remember beside a sample
SAMPLE = Part('a sample', Sample.MECHANISMS, Sample.SIZE)


class _Kind(NamedTuple):
    """What a measurement is of: a file of `measurements` each."""

    POSITION: int = 1
    SPEED: int = 2
    VELOCITY: int = 3
    HEADING: int = 4
    ZERO_VELOCITY: int = 5
    ZERO_RATE: int = 6
    NON_HOLONOMIC: int = 7
    WHEEL_VIBRATION: int = 8
    PRESSURE: int = 9
    PLACE: int = 10  # a fix of a further receiver


Kind = _Kind()


class _Event(NamedTuple):
    """One measurement as the kernel takes it, and what came of it.

    Up to three components: the first two may be correlated, the third stands alone.
    """

    TIME: int = 0  # at which it describes the vehicle
    KIND: int = 1
    VALUE: int = 2  # three
    LATITUDE: int = 2  # of a position
    LONGITUDE: int = 3
    HEIGHT: int = 4
    R_NN: int = 5  # variances of the components, the covariance of the first two in between
    R_NE: int = 6
    R_EE: int = 7
    R_DD: int = 8
    ID: int = 9  # counts the measurements given to the kernel
    Z_N: int = 10  # innovation, predicted minus measured
    Z_E: int = 11
    Z_D: int = 12
    S_NN: int = 13  # its covariance
    S_NE: int = 14
    S_EE: int = 15
    S_DD: int = 16
    NIS: int = 17  # of the first two components
    VERDICT: int = 18  # what the filter did with it, one of `Verdict`
    WEIGHT: int = 19  # 1: as it claims; less: its covariance was raised
    YAW: int = 20  # of the prediction, to see innovations along and across track
    V_N: int = 21
    V_E: int = 22
    WITHDRAWN: int = 23  # 1: it has turned out to be wrong by what came after it
    INPUT: int = 24  # number of the named input that it is from, from 1 on; 0: the plain one, of which the head knows
    STATE: int = 25  # of a named input: index of its own optional state among all n; -1: none
    ARM: int = 26  # and three, from the IMU to where it is measured, body axes, m
    SIZE: int = 29


Event = _Event()


class _Verdict(NamedTuple):
    """What became of a measurement."""

    PENDING: int = 0
    USED: int = 1
    WEIGHTED: int = 2  # used with a larger covariance: it does not fit well
    REFUSED: int = 3  # its innovation is beyond the gate
    FROZEN: int = 4  # the receiver repeats a position while the vehicle moves
    RECOVERED: int = 5  # used for a new start: it agrees with those refused before it
    AHEAD: int = 6  # of a time that the IMU's clock has not come to: the clocks differ
    STRAIGHT_ON: int = 7  # the receiver goes straight on without satellites


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
