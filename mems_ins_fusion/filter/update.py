"""Correction of a state by a measurement (Eq. 6 to 8): one way for fixes, speeds, headings, constraints, standstills.

A measurement fills its record and its rows of H (see `measurements`); `update` forms the innovation, looks at how well
it fits, and corrects. All work on the flat memory of the filter: `r` is the position of a state, `at` of a record.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..navigation import strapdown
from . import history
from .measurements import (
    acceleration,
    heading,
    magnetometer,
    non_holonomic,
    position,
    pressure,
    speed,
    standstill,
    twist,
    velocity,
)
from .measurements.geometry import angular_rate, body_to_level, body_velocity, own_state, vehicle_to_level
from .memory import (
    NAV,
    PLANAR,
    Error,
    Event,
    Head,
    Kind,
    Nav,
    Sample,
    Verdict,
    channel_of,
    load_covariance,
    nonnegative,
    row_of,
    store_covariance,
    velocity_variance,
    yaw_state,
)
from .prediction import set_radii
from .trust import contradiction, hypotheses, receiver, repeats, straight_on, way
from .trust.drift import learn_drift
from .trust.hypotheses import Hypothesis
from .trust.imu_faults import Imu
from .trust.scale import Scale, Seen, learn, scale, seen_of
from .trust.white_noise import hides_turns

#: standstill and non-holonomic constraints are applied this often, s: their errors last about as long
CONSTRAINT_INTERVAL = 0.1
#: where samples are no more often than that, each non-holonomic one has a smaller variance, so that a second tells as
#: much; but none tells more than this many
MOST_TOLD = 2.0
#: m/s: what the accelerometers call a standstill is one only below this speed plus three sigma: smooth roads, a creep
#: in traffic
STILL_SPEED = 0.3
#: rad/s: and below this turn rate plus three sigma: who turns on the spot over the IMU stands still by them. A robot
#: does so within 40 s at the most; a gyroscope that is off by less does not turn a parked car
STILL_RATE = 0.15
#: s that a vehicle may have stood before the accelerometers have called it a standstill: for as long a gyroscope that
#: is off may have turned the heading
STANDS_UNSEEN = 5.0
#: what fits worse than this many sigma is weighted down to it; of fixes it is a parameter
ROBUST = 3.0
#: sigmas beyond which a speed or velocity is refused while fixes speak for the state: wheels that slip, another unit.
#: Weighted down it would still pull, each time. A gyroscope that is further off at a standstill has a new error
FAR = 10.0
#: the same of a magnetic field, which iron beside the way disturbs every day
DISTURBED = 4.0
#: fixes refused in a row that may all be wrong: no way ends there
SINGLE = 2.0
#: m/s, that a speed is believed at most before its way has been compared with that of the fixes, whatever it claims
FIRST_SIGMA = 0.1
#: sigmas beyond which an input is refused of which none is used
NEVER = 1e-9
#: s for which errors of a speed, velocity or odometry last: manoeuvres in which wheels slip and late stamps show, the
#: smoothing of receivers. All of that time tell no more than one (0.3 s late, 60 s without fixes: 7 m, 28 m if white)
SPEED_LASTS = 1.0
#: the same of a magnetic field: what a slow vehicle passes
FIELD_LASTS = 10.0
#: s for which a speed that has fitted and then is far off is one of wheels that slip, without fixes, too; what lasts
#: for longer may be right, and the state wrong
LONGEST_SLIP = 5.0
#: multiple of the claimed variance that counts as noise where FAR is judged, however large it has been seen to be:
#: three times the sigma, as the prior of a scale has it. More is slip or another fault, and makes none fit
LARGEST_CLAIM = 9.0
#: m/s, sigma that counts as noise there in any case: wheels that claim millimetres are not known better
LARGEST_NOISE = 0.2
#: the same of a heading: rad, and s for which one that has fitted and then is far off is wrong: gyroscopes know better
LARGEST_HEADING_NOISE, LONGEST_JUMP = 0.05, 60.0
#: s over which the constraint's NIS is averaged
CONSTRAINT_MEMORY = 10.0
#: mean NIS above which the constraint is not used: it is 1 of a vehicle that keeps to it
CONSTRAINT_OFF = 6.0
#: and below which it is used again: half, so that it does not come and go
CONSTRAINT_ON = 3.0
#: s without a fix after which none speaks for the velocity
NO_FIX = 10.0


@njit(_nrt=False)
def _project(mem, n, h, column):
    """P H^T of the row H at `h` into `column` (n,); P stands at the begin of the scratch. H P H^T."""
    p, h, column = nonnegative(int(mem[Head.SCRATCH_AT])), nonnegative(h), nonnegative(column)
    for i in range(n):
        mem[column + i] = 0.0
    for j in range(n):
        factor, row = mem[h + j], nonnegative(p + n * j)
        if factor != 0.0:
            for i in range(n):
                mem[column + i] += factor * mem[row + i]
    return _product(mem, n, h, column)


@njit(_nrt=False)
def _product(mem, n, h, column):
    """The row H at `h` times a column."""
    h, column, total = nonnegative(h), nonnegative(column), 0.0
    for i in range(n):
        total += mem[h + i] * mem[column + i]
    return total


@njit(_nrt=False)
def _scalar(mem, r, n, h, column, z, s):
    """One scalar measurement z = H x + noise: the row H at `h`, P H^T at `column`, variance of the innovation s.

    P - K H P, of which both halves are the same bits: symmetric by construction.
    """
    p, x, h, column = nonnegative(int(mem[Head.SCRATCH_AT])), nonnegative(r + NAV), nonnegative(h), nonnegative(column)
    residual, inverse = z - _product(mem, n, h, x), 1.0 / s
    for i in range(n):
        element, row = mem[column + i], nonnegative(p + n * i)
        mem[x + i] += element * inverse * residual
        for j in range(n):
            mem[row + j] -= element * mem[column + j] * inverse
    if mem[Head.HISTORY_AT] > 0.0:
        history.corrected(mem, n, h, column, residual, s)


@njit(_nrt=False)
def _normalized(a, b, s_nn, s_ne, s_ee):
    """Normalized square of the innovation (a, b) with the covariance s."""
    return (s_ee * a * a - 2.0 * s_ne * a * b + s_nn * b * b) / (s_nn * s_ee - s_ne * s_ne)


@njit(_nrt=False)
def update(mem, r, at, n, dimensions, factor, robust, gate):
    """Correct the state at r with the record at `at`, whose rows of H stand behind P in the scratch.

    factor: on the covariance R of the record. robust: normalized innovations above it are weighted down to it. gate:
    those above it are refused; 0: none of that. The first two components are judged together, the third alone. The
    verdict.
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
    s_nn, s_ne, s_ee = r_nn + _project(mem, n, h, column), 0.0, 0.0
    if dimensions == 1:
        nis = a * a / s_nn
    else:
        s_ne = r_ne + _product(mem, n, h + n, column)
        s_ee = r_ee + _project(mem, n, h + n, column)
        nis = _normalized(a, b, s_nn, s_ne, s_ee)
    mem[at + Event.S_NN], mem[at + Event.S_NE], mem[at + Event.S_EE] = s_nn, s_ne, s_ee
    mem[at + Event.NIS], mem[at + Event.WEIGHT] = nis, 1.0
    verdict = Verdict.USED
    if gate > 0.0 and nis > gate * gate:
        mem[at + Event.WEIGHT] = 0.0
        return Verdict.REFUSED
    if robust > 0.0 and nis > robust * robust:  # so much noise that the innovation is just `robust`
        inflation = nis / (robust * robust) - 1.0
        r_nn, r_ne, r_ee = r_nn + inflation * s_nn, r_ne + inflation * s_ne, r_ee + inflation * s_ee
        verdict = Verdict.WEIGHTED
        mem[at + Event.WEIGHT] = 1.0 / (1.0 + inflation)

    # the first two made independent by the Cholesky factor of R, then one after the other
    if dimensions > 2:
        s_dd = r_dd + _project(mem, n, h + 2 * n, column)
        mem[at + Event.S_DD] = s_dd
    l_nn = math.sqrt(r_nn)
    for i in range(n):
        mem[h + i] /= l_nn
    z_n /= l_nn
    s = 1.0 + _project(mem, n, h, column)
    _scalar(mem, r, n, h, column, z_n, s)
    if dimensions > 1:
        l_en = r_ne / l_nn
        l_ee = math.sqrt(r_ee - l_en * l_en)
        for i in range(n):
            mem[h + n + i] = (mem[h + n + i] - l_en * mem[h + i]) / l_ee
        z_e = (z_e - l_en * z_n) / l_ee
        s = 1.0 + _project(mem, n, h + n, column)
        _scalar(mem, r, n, h + n, column, z_e, s)
    if dimensions > 2:
        down = mem[at + Event.Z_D] ** 2 / s_dd
        if gate > 0.0 and down > gate * gate:
            return verdict
        if robust > 0.0 and down > robust * robust:
            r_dd += (down / (robust * robust) - 1.0) * s_dd
        s = r_dd + _project(mem, n, h + 2 * n, column)
        _scalar(mem, r, n, h + 2 * n, column, z_d, s)
    return verdict


@njit(_nrt=False)
def is_of_velocity(kind):
    """Whether a measurement of this kind is of the velocity."""
    return kind == Kind.SPEED or kind == Kind.VELOCITY or kind == Kind.TWIST


@njit(_nrt=False)
def is_of_heading(kind):
    """Whether a measurement of this kind is of the heading."""
    return kind == Kind.HEADING or kind == Kind.MAGNETIC


@njit(_nrt=False)
def makes_way(kind):
    """Whether measurements of this kind make up a way, or its direction."""
    return is_of_velocity(kind) or is_of_heading(kind)


@njit(_nrt=False)
def _judge(mem, r, at, n, dimensions):
    """Factor on the covariance of the speed, velocity or heading at `at`, learned from its innovation, too, and for as
    many as tell no more than one; and the sigmas beyond which it is refused, 0: none. dimensions: of the components
    that are judged together, 1 or 2.

    One that does not fit is wrong, or the state is. What its variance is raised by, that of the state is raised by,
    too, along what is measured, unless fixes speak for the state, as they do for its velocity: so a filter that is sure
    of something wrong comes to where both agree, and the other measurements decide.
    """
    p, kind = int(mem[Head.SCRATCH_AT]), int(mem[at + Event.KIND])
    h, own = p + n * n, seen_of(mem, r, at)
    time = mem[at + Event.TIME]
    of_velocity = is_of_velocity(kind)
    if makes_way(kind) and way.is_contradicted(mem, own):
        return 1.0, NEVER
    # of the start, too, after which the first has still to come
    fix = max(mem[r + Nav.FIX_TIME], mem[r + receiver.Receiver.SCALE + Scale.TIME])
    lasts = SPEED_LASTS if of_velocity else FIELD_LASTS if kind == Kind.MAGNETIC else 0.0
    density = max(1.0, lasts / max(time - mem[own + Scale.TIME], 1e-3))
    if of_velocity and fix != 0.0 and time - fix < NO_FIX and not way.is_compared(mem, own):
        mem[own + Scale.TIME] = time
        # a velocity may fit by its size and point elsewhere
        gate = NEVER if kind == Kind.VELOCITY else ROBUST
        return density * max(1.0, FIRST_SIGMA**2 / mem[at + Event.R_NN]), gate
    column = h + 3 * n
    squared, claimed, variance = 0.0, mem[at + Event.R_NN], 0.0
    for k in range(dimensions):
        squared += (mem[at + Event.Z_N + k] - _product(mem, n, h + n * k, r + NAV)) ** 2 / dimensions
        variance += _project(mem, n, h + n * k, column) / dimensions
    if dimensions > 1:
        claimed = 0.5 * (claimed + mem[at + Event.R_EE])
    before = max(scale(mem, own), 1.0)
    learn(mem, own, time, squared, claimed, variance, dimensions)
    factor = max(scale(mem, own), 1.0)
    if of_velocity and kind != Kind.VELOCITY:
        factor += repeats.unknown(mem, own, time) / claimed
    confirmed = not is_of_heading(kind) and time - mem[r + Nav.FIX_TIME] < NO_FIX
    if makes_way(kind):  # one by one each is judged by what it claims itself
        noise, longest = (LARGEST_NOISE, LONGEST_SLIP) if of_velocity else (LARGEST_HEADING_NOISE, LONGEST_JUMP)
        # iron beside the way lasts, and would pass for noise
        largest, far = (1.0, DISTURBED) if kind == Kind.MAGNETIC else (LARGEST_CLAIM, FAR)
        expected = variance + min(factor * claimed, max(largest * claimed, noise**2))
        # so soon no IMU is wrong by as much
        slips = mem[own + Seen.FITTED] != 0.0 and time - mem[own + Seen.FITTED] < longest
        if squared < ROBUST * ROBUST * expected:
            mem[own + Seen.FITTED] = time
        if confirmed or slips:
            return density * factor, far * math.sqrt(expected / (variance + density * factor * claimed))
    if factor <= before or confirmed or squared < ROBUST * ROBUST * (before * claimed + variance):
        return density * factor, 0.0
    for k in range(dimensions):
        raised = (factor - before) * claimed / _project(mem, n, h + n * k, column) ** 2
        for i in range(n):
            for j in range(n):
                mem[p + n * i + j] += raised * mem[column + i] * mem[column + j]
    return density * factor, 0.0


@njit(_nrt=False)
def _travel(mem, r, at, n, c):
    """Add the speed, velocity, twist or heading at `at` to the way of its input; c: rotation from b to n."""
    if mem[at + Event.KIND] == Kind.VELOCITY:  # it has directions of its own
        v_n, v_e, yaw_variance = mem[at + Event.VALUE], mem[at + Event.VALUE + 1], 0.0
    elif is_of_heading(mem[at + Event.KIND]):  # a way that the nose leads along
        forward, yaw_variance = body_velocity(mem, r, vehicle_to_level(mem, r, c), 0), 0.0
        yaw = mem[at + Event.VALUE] if mem[at + Event.KIND] == Kind.HEADING else magnetometer.heading(mem, r, at, c)
        v_n, v_e = math.cos(yaw) * forward, math.sin(yaw) * forward
    else:
        c = vehicle_to_level(mem, r, c)
        v_n, v_e = c[0] * mem[at + Event.VALUE], c[3] * mem[at + Event.VALUE]
        yaw_variance = mem[int(mem[Head.SCRATCH_AT]) + (n + 1) * yaw_state(mem)]
    way.travel(mem, seen_of(mem, r, at), mem[at + Event.TIME], v_n, v_e, yaw_variance)


@njit(_nrt=False)
def _leave_out_turn_rate(mem, r, at, n):
    """Leave out the turn rate of the record at `at`, its third component, where it does not fit: at any instant
    gyroscopes know it better than wheels, of which it may have the wrong sign, track or clock."""
    h = int(mem[Head.SCRATCH_AT]) + n * n + 2 * n
    innovation = mem[at + Event.Z_D] - _product(mem, n, h, r + NAV)
    if innovation**2 > ROBUST**2 * (mem[at + Event.R_DD] + _project(mem, n, h, h + n)):
        mem[at + Event.Z_D] = 0.0
        for i in range(n):
            mem[h + i] = 0.0


@njit(_nrt=False)
def _take_step(mem, r, at, n):
    """A pressure that is far off at once is another air - a door, a fan, a tunnel - and not another height: its bias
    takes what it is off by."""
    bias, h = own_state(mem, at, pressure.Barometer.BIAS), int(mem[Head.SCRATCH_AT]) + n * n
    innovation = mem[at + Event.Z_N] - _product(mem, n, h, r + NAV)
    if bias >= 0 and innovation**2 > FAR**2 * (mem[at + Event.R_NN] + _project(mem, n, h, h + 3 * n)):
        mem[r + NAV + bias] -= innovation


@njit(_nrt=False)
def _is_believed(mem, r, at, n):
    """Whether the fix at `at` is believed, by what the filter says of the receiver; H stands behind P in the scratch.
    """
    h, factor = int(mem[Head.SCRATCH_AT]) + n * n, receiver.realised_factor(mem, r)
    column = h + 3 * n
    r_nn, r_ne, r_ee = (factor * mem[at + Event.R_NN], factor * mem[at + Event.R_NE], factor * mem[at + Event.R_EE])
    s_nn = r_nn + _project(mem, n, h, column)
    s_ne = r_ne + _product(mem, n, h + n, column)
    s_ee = r_ee + _project(mem, n, h + n, column)
    return hypotheses.judge(mem, r, at, s_nn, s_ne, s_ee, 0.5 * (r_nn + r_ee), receiver.innovation_factor(mem, r))


@njit(_nrt=False)
def _misfit(mem, r, at, n, factor):
    """Normalized innovation squared of the fix at `at` before its correction, the antenna's arm taken for exact."""
    p = int(mem[Head.SCRATCH_AT])
    a, b = mem[at + Event.Z_N] - mem[r + NAV], mem[at + Event.Z_E] - mem[r + NAV + 1]
    s_nn, s_ne = mem[p] + factor * mem[at + Event.R_NN], mem[p + 1] + factor * mem[at + Event.R_NE]
    s_ee = mem[p + n + 1] + factor * mem[at + Event.R_EE]
    return _normalized(a, b, s_nn, s_ne, s_ee)


@njit(_nrt=False)
def feed_back(mem, r):
    """Closed loop: the estimated navigation errors go into the solution, and x is zero there again."""
    if mem[Head.OPEN_LOOP] != 0.0:
        return
    x, size = r + NAV, int(mem[Head.N_NAVIGATION])
    mem[r + Nav.LATITUDE] -= _error(mem, x, Error.R_N) * mem[r + Nav.NORTH_SCALE]
    mem[r + Nav.LONGITUDE] -= _error(mem, x, Error.R_E) * mem[r + Nav.EAST_SCALE]
    mem[r + Nav.HEIGHT] += _error(mem, x, Error.R_D)
    for k in range(3):
        mem[r + Nav.V_N + k] -= _error(mem, x, Error.V_N + k)
    if mem[Head.MECHANIZATION] == PLANAR:
        mem[r + Nav.YAW] -= _error(mem, x, Error.PHI_D)
    else:
        q = strapdown.correct_attitude((mem[r + Nav.Q_W], mem[r + Nav.Q_X], mem[r + Nav.Q_Y], mem[r + Nav.Q_Z]),
                                       _error(mem, x, Error.PHI_N), _error(mem, x, Error.PHI_E),
                                       _error(mem, x, Error.PHI_D))
        mem[r + Nav.Q_W], mem[r + Nav.Q_X], mem[r + Nav.Q_Y], mem[r + Nav.Q_Z] = q
    for i in range(size):
        mem[x + i] = 0.0


@njit(_nrt=False)
def _error(mem, x, error):
    """The estimate of one of the nine navigation errors, zero where the mechanization has it not; x: of position 0."""
    state = row_of(mem, error)
    return mem[x + state] if state >= 0 else 0.0


@njit(_nrt=False)
def _clear(mem, h, n):
    for i in range(3 * n):
        mem[h + i] = 0.0


@njit(_nrt=False)
def _goes_straight_on(mem, r, at):
    """Whether the fix at `at` is one of a receiver without satellites that goes straight on."""
    north, east, _ = position.difference(mem, r, at, body_to_level(mem, r))
    return straight_on.goes_straight_on(mem, r, at, north - mem[r + NAV], east - mem[r + NAV + 1])


@njit(_nrt=False)
def apply_event(mem, r, at, sample):
    """Correct the state at r with the measurement at `at`; sample: position of the IMU sample of that time."""
    n_navigation, m = int(mem[Head.N_NAVIGATION]), int(mem[Head.N_AUGMENTED])
    n, p, kind = n_navigation + m, int(mem[Head.SCRATCH_AT]), mem[at + Event.KIND]
    h = p + n * n
    if mem[at + Event.VERDICT] == Verdict.AHEAD:
        return
    if repeats.is_stuck(mem, r, at):
        mem[at + Event.VERDICT], mem[at + Event.WEIGHT] = Verdict.FROZEN, 0.0
        repeats.note(mem, r, at)
        return
    if kind == Kind.POSITION:
        receiver.take_status(mem, r, at)
        if _goes_straight_on(mem, r, at):
            straight_on.refuse(mem, r, at)
            return
    load_covariance(mem, r, n_navigation, m, mem, p)
    recovered, before = False, hypotheses.position_and_velocity(mem, r)
    doubts = kind == Kind.POSITION and mem[r + Hypothesis.DOUBTS] != 0.0
    if kind == Kind.POSITION and not doubts:
        recovered = mem[Head.GATE] > 0.0 and receiver.agreed(mem, r, at)
        if recovered:
            receiver.start_anew(mem, r, at)
        else:
            v_n, v_e = receiver.finds_course(mem, r, at)
            if v_n != 0.0 or v_e != 0.0:
                receiver.take_course(mem, r, v_n, v_e, 0.0)
    _clear(mem, h, n)
    c = body_to_level(mem, r)
    mem[at + Event.YAW] = math.atan2(c[3], c[0])
    mem[at + Event.V_N], mem[at + Event.V_E] = mem[r + Nav.V_N], mem[r + Nav.V_E]
    factor, robust, gate, height = 1.0, 0.0, 0.0, 0.0
    if kind == Kind.POSITION:
        dimensions = position.observe(mem, r, at, h, n, c)
        height = mem[at + Event.Z_D] + mem[r + Nav.HEIGHT]  # of the planar filter, which has no state for it
        if not doubts:
            factor, robust, gate = receiver.trust(mem, r, at)
        if not _is_believed(mem, r, at, n):
            hypotheses.refuse(mem, r, at)
            return
        if mem[r + Nav.UNSETTLED] > 0.0:
            robust = gate = 0.0
            contradiction.loosen(mem, r, n, _misfit(mem, r, at, n, factor))
    elif kind == Kind.VELOCITY:
        dimensions = velocity.observe(mem, r, at, h, n, c, sample)
    elif kind == Kind.SPEED:
        dimensions = speed.observe(mem, r, at, h, n, c, sample)
    elif kind == Kind.TWIST:
        dimensions = twist.observe(mem, r, at, h, n, c, sample)
    elif kind == Kind.PRESSURE:
        dimensions = pressure.observe(mem, r, at, h)
        _take_step(mem, r, at, n)
    elif kind == Kind.MAGNETIC:
        dimensions = magnetometer.observe(mem, r, at, h, n, c)
    elif kind == Kind.PLACE:
        dimensions = position.observe_place(mem, r, at, h, n, c)
    else:
        dimensions = heading.observe(mem, r, at, h, n, c)
    if kind != Kind.POSITION:
        if makes_way(kind):
            _travel(mem, r, at, n, c)
        judged = min(dimensions, 2)
        if kind == Kind.TWIST:
            judged = 2 if twist.measures_sideways(mem, at) else 1
            _leave_out_turn_rate(mem, r, at, n)
        factor, gate = _judge(mem, r, at, n, judged)
        robust = ROBUST
    verdict = update(mem, r, at, n, dimensions, factor, robust, gate)
    mem[at + Event.VERDICT] = Verdict.RECOVERED if recovered else verdict
    if makes_way(kind) and verdict == Verdict.REFUSED:
        own = seen_of(mem, r, at)
        if way.is_contradicted(mem, own):
            mem[at + Event.VERDICT] = Verdict.CONTRADICTED
        elif not way.is_compared(mem, own):
            mem[at + Event.VERDICT] = Verdict.AWAITED
    if verdict != Verdict.REFUSED:
        store_covariance(mem, p, n_navigation, m, mem, r)
        feed_back(mem, r)
        if kind == Kind.POSITION and row_of(mem, Error.R_D) < 0:
            mem[r + Nav.HEIGHT] = height
        set_radii(mem, r)
    repeats.note(mem, r, at)
    if kind == Kind.POSITION:
        left_n, left_e, _ = position.difference(mem, r, at, body_to_level(mem, r))
        if verdict != Verdict.REFUSED or mem[r + Nav.REFUSED] > SINGLE:
            way.compare(mem, r, at, receiver.realised_variance(mem, r, at))
        straight_on.pull(mem, r, before, hypotheses.position_and_velocity(mem, r))
        receiver.learn(mem, r, at, left_n, left_e)
        learn_drift(mem, r)


@njit(_nrt=False)
def constrain(mem, r, sample):
    """What is known of a land vehicle: at standstill no velocity and no rotation, else no sideways velocity.

    r: position of the state, sample: of the sample that led to it.
    """
    still = mem[sample + Sample.STILL] != 0.0 and mem[Head.ZERO_VELOCITY_SIGMA] > 0.0
    if not still and mem[Head.LATERAL_SIGMA] == 0.0:
        return
    n_navigation, m = int(mem[Head.N_NAVIGATION]), int(mem[Head.N_AUGMENTED])
    n, p = n_navigation + m, int(mem[Head.SCRATCH_AT])
    h = p + n * n
    at = h + 6 * n  # a record for the time being
    since, mem[r + Nav.CONSTRAINT_TIME] = mem[r + Nav.CONSTRAINT_TIME], 0.0
    load_covariance(mem, r, n_navigation, m, mem, p)
    yaw = yaw_state(mem)
    if still:
        variance = velocity_variance(mem, r)
        squared = mem[r + Nav.V_N] ** 2 + mem[r + Nav.V_E] ** 2
        agrees = squared < STILL_SPEED**2 + 9.0 * variance
        # who creeps smoothly and straight on has turned nowhere; a gyroscope that turns has misled the velocity, too
        still = ((agrees or contradiction.goes_back(mem, r) or _turns(mem, r, sample, n, 0.0, FAR))
                 and not _turns(mem, r, sample, n, STILL_RATE, ROBUST))
        if still and not agrees:
            contradiction.admit(mem, r, n)
    if still:
        v_n, v_e = mem[r + Nav.V_N], mem[r + Nav.V_E]
        _clear(mem, h, n)
        dimensions = standstill.observe_velocity(mem, r, at, h, n)
        update(mem, r, at, n, dimensions, 1.0, 0.0, 0.0)
        _note(mem, sample, at, Kind.ZERO_VELOCITY, dimensions)
        _clear(mem, h, n)
        dimensions = standstill.observe_rate(mem, r, at, h, n, sample)
        _free_gyroscopes(mem, r, at, n, dimensions)
        update(mem, r, at, n, dimensions, 1.0, 0.0, 0.0)
    elif mem[Head.LATERAL_SIGMA] > 0.0 and not _fixes_tell_the_heading(mem, r, mem[p + (n + 1) * yaw]):
        _clear(mem, h, n)
        c = body_to_level(mem, r)
        if hides_turns(mem, sample):
            dimensions = acceleration.observe(mem, at, h, n, c, sample, since)
            update(mem, r, at, n, dimensions, 1.0, ROBUST, 0.0)
        else:
            dimensions = non_holonomic.observe(mem, r, at, h, n, c, sample)
            _constrain_motion(mem, r, at, n, h, vehicle_to_level(mem, r, c), dimensions, since)
            _note(mem, sample, at, Kind.NON_HOLONOMIC, dimensions)
    else:
        return
    store_covariance(mem, p, n_navigation, m, mem, r)
    feed_back(mem, r)
    if still:
        contradiction.stood(mem, r, v_n, v_e)
    set_radii(mem, r)


@njit(_nrt=False)
def _share(since):
    """Factor on the variance of the non-holonomic constraint `since` s after the last: its errors are a density."""
    return max(CONSTRAINT_INTERVAL / since, 1.0 / MOST_TOLD)


@njit(_nrt=False)
def _fixes_tell_the_heading(mem, r, variance):
    """Whether the heading is too uncertain for the constraint, which is linear in its error, and fixes will find it.

    Without them the constraint is all there is against drifting away.
    """
    since = mem[r + Nav.TIME] - mem[r + Nav.FIX_TIME]
    return variance > receiver.LARGEST_YAW_SIGMA**2 and since < receiver.LONGEST_PAIR


@njit(_nrt=False)
def _turns(mem, r, sample, n, rate, sigmas):
    """Whether the gyroscopes turn by more than `rate`, rad/s, and so many sigmas at the sample; P is in the scratch."""
    w_x, w_y, w_z = angular_rate(mem, r, sample)
    p, variance = int(mem[Head.SCRATCH_AT]), mem[Imu.SPREAD + 1]
    for axis in range(3, 6):
        state = channel_of(mem, axis)
        if state >= 0:
            variance += mem[p + (n + 1) * state]
    return w_x * w_x + w_y * w_y + w_z * w_z > rate * rate + sigmas * sigmas * variance


@njit(_nrt=False)
def _free_gyroscopes(mem, r, at, n, dimensions):
    """Gyroscopes that certainly turn at a standstill have other errors than before: these are less certain by as much,
    and the heading by what they may have turned it since they last showed what is expected of them."""
    h, p, yaw = int(mem[Head.SCRATCH_AT]) + n * n, int(mem[Head.SCRATCH_AT]), yaw_state(mem)
    unseen, fit = min(mem[r + Nav.TIME] - mem[r + Nav.TURNED], STANDS_UNSEEN), True
    for k in range(dimensions):
        squared = (mem[at + Event.Z_N + k] - _product(mem, n, h + n * k, r + NAV)) ** 2
        variance = _project(mem, n, h + n * k, h + 3 * n)
        if squared > FAR**2 * (variance + mem[at + (Event.R_NN, Event.R_EE, Event.R_DD)[k]]):
            fit = False
            for i in range(n):
                if mem[h + n * k + i] != 0.0:
                    mem[p + (n + 1) * i] += squared
            mem[p + (n + 1) * yaw] += squared * unseen * unseen
    if fit:
        mem[r + Nav.TURNED] = mem[r + Nav.TIME]


@njit(_nrt=False)
def _constrain_motion(mem, r, at, n, h, c, dimensions, since):
    """The components of the non-holonomic constraint one by one, each unless the vehicle does not keep to it.

    c: rotation from the vehicle's axes to n. since: s from the one before. Each is judged by the variance as it is, so
    that a slow IMU's is judged as a fast one's, and used with that for its interval.
    """
    for k in range(dimensions):
        z, variance = mem[at + Event.Z_N + k], mem[at + (Event.R_NN if k == 0 else Event.R_EE)]
        column = h + (3 + k) * n
        innovation = z - _product(mem, n, h + n * k, r + NAV)
        s = variance + _project(mem, n, h + n * k, column)
        nis = innovation * innovation / s
        # where each fix is believed in any case there is nothing to decide
        if k == 0 and mem[Head.GATE] > 0.0 and contradiction.slides(mem, r, innovation, s, since):
            contradiction.unsettle(mem, r, n, innovation, since)
            s = variance + _project(mem, n, h + n * k, column)
            nis = innovation * innovation / s
        mem[at + Event.Z_N + k] = innovation
        mem[at + (Event.S_NN if k == 0 else Event.S_EE)] = s
        running = Nav.LATERAL_NIS if k == 0 else Nav.VERTICAL_NIS
        before = mem[r + running]
        off = before < 0.0  # the sign tells that it is off
        mean = abs(before) + (min(nis, 25.0) - abs(before)) * min(since / CONSTRAINT_MEMORY, 1.0)
        off = mean > (CONSTRAINT_ON if off else CONSTRAINT_OFF)
        mem[r + running] = -mean if off else mean
        if off:
            mem[r + Nav.SIDEWAYS] += since if k == 0 else 0.0
            continue
        if nis > ROBUST**2:
            s *= nis / ROBUST**2  # so much more noise
        _scalar(mem, r, n, h + n * k, column, z, s - (1.0 - _share(since)) * variance)


@njit(_nrt=False)
def _note(mem, sample, at, kind, dimensions):
    """What a constraint said, beside the sample it was applied at."""
    mem[sample + Sample.CONSTRAINT] = kind
    for k in range(dimensions):
        mem[sample + Sample.Z + k] = mem[at + Event.Z_N + k]
    mem[sample + Sample.S] = mem[at + Event.S_NN]
    mem[sample + Sample.S + 1] = mem[at + Event.S_EE]
    mem[sample + Sample.S + 2] = mem[at + Event.S_DD]
