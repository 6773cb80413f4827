"""With which weight a speed, velocity, odometry, heading, magnetic field and pressure are used: by their innovations
(`scale.py`), and by the displacement that they integrate to, beside that between fixes (`displacement.py`).

Fixes are judged in `receiver.py`.
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..measurements import magnetometer
from ..measurements.geometry import angular_rate, arm_of, axle_of, body_velocity, rotate, vehicle_to_level
from ..measurements.low_pass import LowPass
from ..memory import INPUT, NAV, Event, Head, Kind, Nav, input_at, is_of_heading, is_of_velocity, yaw_state
from ..update import ROBUST, product, project
from . import clock_jump, contradiction, displacement, hypotheses, receiver, repeats
from .clock_jump import LARGEST_ERROR, LARGEST_OFFSET
from .displacement import Integral
from .scale import PRIOR, Noise, Scale, learn_changes, reopen, scale
from .standstill import SLOWEST_SPEED

#: of an input
Fit = INPUT.place(
    'Fit',
    TIME=1,  # s, of its latest value that fitted; negative: it is wrong, and when that was seen
    ABOVE=1,  # s, time of its latest value far above the expected one,
    BELOW=1,  # s, and of the latest one far below it
    LEVEL=1,  # m/s or rad, low-passed innovation of the values that fitted,
    LEVEL_VARIANCE=1,  # and the low-passed part of their variance that is the state's
    STEP=1)  # rad, sum of the changes of a heading's innovation since it fitted
#: sigmas beyond which a speed or velocity is refused while fixes speak for the state: wheels that slip, another unit.
#: Weighted down it would still pull, each time.
GATE = 10.0
#: the same of one that has fitted a moment ago, as wheels that begin to slip. By chance it happens less than once in an
#: hour with a hundred speeds in a second
SLIPPED = 5.0
#: the same of a magnetic field, which iron beside the road disturbs every day, and of a further receiver, which
#: reflections take away
NARROW_GATE = 4.0
#: m/s: least sigma of a speed before its displacement has been compared with that of the fixes, whatever it claims
UNCOMPARED_SIGMA = 0.1
#: rad, the same of a heading: antennas that are exchanged, a compass beside iron
UNCOMPARED_HEADING_SIGMA = 0.3
#: sigmas: a limit that refuses every measurement of an input
REFUSE_ALL = 1e-9
#: s for which errors of a speed, velocity or odometry last: manoeuvres in which wheels slip and late stamps show, the
#: smoothing of receivers. All of that time tell no more than one (0.3 s late, 60 s without fixes: 7 m, 28 m if white)
SPEED_CORRELATION = 1.0
#: the same of a magnetic field: what a slow vehicle passes
FIELD_CORRELATION = 10.0
#: s for which an input that was wrong has to fit the state, where an error of LARGEST_ERROR would not have fitted,
#: until it is used again: as long as its errors last
RIGHT_AGAIN_AFTER = SPEED_CORRELATION
#: s for which a speed that has fitted and then is far off is one of wheels that slip, without fixes, too; what lasts
#: for longer may be right, and the state wrong
LONGEST_SLIP = 5.0
#: s for which a speed has not to fit until it is no part of the displacement between fixes, and has to fit before it
#: is used: a single one is no displacement, and displacements that begin anew all the time show no factor. Also the
#: time constant of the innovations that its change is compared with
SHORTEST_SLIP = 0.25
#: multiple of the interval between two messages within which one follows another: none is missing between them
FOLLOWS = 1.5
#: multiple of the claimed variance that counts as noise where GATE is judged, however large it has been seen to be:
#: three times the sigma, as the prior of a scale has it. More is slip or another fault, and makes none fit
LARGEST_NOISE_FACTOR = 9.0
#: m/s, sigma that counts as noise there in any case: wheels that claim millimetres are not known better
LEAST_NOISE = 0.2
#: rad, the same of a heading
LEAST_HEADING_NOISE = 0.05
#: largest variance of the logarithm of an input's scale with which a change is judged by its noise: a factor of 1.3 in
#: sigma at one standard deviation. Wheels that claim millimetres are not slipping, but not known yet. Chosen
LARGEST_LOG_VARIANCE = 0.25
#: sigmas of the change of a speed that fits again after a slip, above which its constant error may be another one: of a
#: slip that is over it is less (95 %); one that does not end fits as the state becomes uncertain, just below ROBUST
OTHER_SIGMAS = 2.0
#: largest number of messages of a heading after a step by which it is found, and time constant, in messages, of the
#: mean before it. With more, the drift of the gyroscopes counts. A step of 5 deg at a noise of 0.02 rad has 5 sigma
#: with two messages, 7 with four
LONGEST_STEP = 4
#: s for which a heading that has fitted and then is far off is wrong, as gyroscopes know better; and a further receiver
#: that was far off the fixes when they ended
LONGEST_JUMP = 60.0
#: s without a fix after which the fixes no longer confirm the velocity
LONGEST_WITHOUT_FIX = 10.0


@njit(_nrt=False)
def has_displacement(kind):
    """Whether measurements of this kind integrate to a displacement, or to its direction."""
    return is_of_velocity(kind) or is_of_heading(kind)


@njit(_nrt=False)
def is_forward_speed(kind):
    """Whether measurements of this kind begin with a forward speed, as that of wheels: a speed or an odometry."""
    return kind == Kind.SPEED or kind == Kind.TWIST


@njit(_nrt=False)
def factor_and_limits(mem, r, at, n, dimensions):
    """Factor on the covariance of the input at `at`, learned from its innovation, too; how many of it tell no more than
    one; and the sigmas beyond which it is refused, 0: none. dimensions: of the components that are judged together, 1
    or 2.
    """
    own, kind, time = input_at(mem, r, at), int(mem[at + Event.KIND]), mem[at + Event.TIME]
    _note_wrong_displacement(mem, r, at, n)
    since = time - mem[own + Noise.SCALE + Scale.TIME]
    if not is_contradicted(mem, r, at) and _is_uncompared(mem, r, at):
        return _before_comparison(mem, at, own, since)
    correlation = SPEED_CORRELATION if is_of_velocity(kind) else FIELD_CORRELATION if kind == Kind.MAGNETIC else 0.0
    density = _repeated(correlation, since)
    claimed = mem[at + Event.R_NN] if dimensions == 1 else 0.5 * (mem[at + Event.R_NN] + mem[at + Event.R_EE])
    before = max(scale(mem, own + Noise.SCALE), 1.0)
    unknown = repeats.unknown(mem, own, time) if is_forward_speed(kind) else 0.0
    noise = _noise(kind, claimed, before * claimed + unknown)
    squared, variance = _innovation(mem, r, at, n, dimensions)
    if is_contradicted(mem, r, at):
        if not _is_right_again(mem, r, at, n, own, squared, variance + noise):
            return 1.0, 1.0, REFUSE_ALL
        mem[own + Fit.TIME] = 0.0
        _forget_error(mem, at, n, own, squared - variance - noise)  # maybe not as the one it was
        squared, variance = _innovation(mem, r, at, n, dimensions)
    change, expected = _change(mem, r, at, n, own, noise, variance, since)
    nis, change_nis = squared / (variance + noise), change / expected
    if kind == Kind.HEADING:
        step = _step(mem, r, at, n, own, noise, variance, since)
        if step != 0.0:
            _raise_error(mem, at, n, step**2)
            squared, variance = _innovation(mem, r, at, n, dimensions)
            nis = squared / (variance + noise)
    if is_of_velocity(kind) and _is_far_off(kind, max(nis, change_nis)) and _alternates(mem, r, at, n, own, squared):
        noise = max(noise, squared - variance, change)
        nis, change_nis = squared / (variance + noise), change / max(expected, noise)
    slips = has_displacement(kind) and _slips(mem, own, kind, time, since, max(nis, change_nis))
    if not slips and clock_jump.has_jumped(mem, r, at, n, own, dimensions, density * noise, variance,
                                           _constant_error(mem, at)):
        squared, variance = _innovation(mem, r, at, n, dimensions)
        change, expected = _change(mem, r, at, n, own, noise, variance, since)
        nis, change_nis = squared / (variance + noise), change / expected
    confirmed = not is_of_heading(kind) and time - mem[r + Nav.FIX_TIME] < LONGEST_WITHOUT_FIX
    if kind == Kind.PLACE:
        expected = variance + min(before, LARGEST_NOISE_FACTOR) * claimed
        hypotheses.score_further_fix(mem, r, squared, expected, since)
        if _is_elsewhere(mem, own, time, squared, expected, confirmed):
            mem[own + Noise.SCALE + Scale.TIME] = time
            return 1.0, 1.0, REFUSE_ALL
    if slips:  # which is no noise
        mem[own + Noise.SCALE + Scale.TIME] = time
    else:
        learn_changes(mem, own + Noise.SCALE, time, squared, claimed, variance, dimensions, 1.0 / density)
    factor = max(scale(mem, own + Noise.SCALE), 1.0) + unknown / claimed
    if has_displacement(kind):
        fitted = _has_fitted(mem, own, kind, time)
        if _fits(mem, own, kind, time, since, nis, change_nis, slips):
            refused = False
            if confirmed and change_nis > OTHER_SIGMAS**2 and _comes_back(mem, own, kind, time, since):
                _raise_error(mem, at, n, change)
            _note_fitted(mem, r, at, n, own, variance, since)
        else:
            refused = _refuses(mem, at, n, own, since, squared, _is_far_off(kind, max(nis, change_nis)), slips,
                               confirmed)
        if refused or confirmed or fitted:  # one by one each is judged by what it claims itself
            gate = GATE * math.sqrt((variance + noise) / (variance + factor * claimed))
            return factor, density, REFUSE_ALL if refused else gate
    if factor > before and not confirmed and squared >= ROBUST * ROBUST * (before * claimed + variance):
        _make_state_uncertain(mem, n, dimensions, (factor - before) * claimed)
    return factor, density, 0.0


@njit(_nrt=False)
def _is_uncompared(mem, r, at):
    """Whether the input at `at` has to wait for a comparison with displacements between fixes, which come."""
    kind, time = int(mem[at + Event.KIND]), mem[at + Event.TIME]
    # of the start, too, after which the first has still to come
    fix = max(mem[r + Nav.FIX_TIME], mem[r + receiver.Receiver.SCALE + Scale.TIME])
    return ((is_of_velocity(kind) or kind == Kind.HEADING) and fix != 0.0 and time - fix < LONGEST_WITHOUT_FIX
            and not displacement.is_compared(mem, input_at(mem, r, at)))


@njit(_nrt=False)
def _before_comparison(mem, at, own, since):
    """Factor, how many tell no more than one, and gate of an input that has not been compared with fixes yet."""
    kind, first, correlation = int(mem[at + Event.KIND]), UNCOMPARED_SIGMA, SPEED_CORRELATION
    if kind == Kind.HEADING:  # what is wrong with it does not change from one to the next
        first, correlation = UNCOMPARED_HEADING_SIGMA, FIELD_CORRELATION
    mem[own + Noise.SCALE + Scale.TIME] = mem[at + Event.TIME]
    # a velocity may fit by its size and point elsewhere
    gate = REFUSE_ALL if kind == Kind.VELOCITY else ROBUST
    return max(1.0, first**2 / mem[at + Event.R_NN]), _repeated(correlation, since), gate


@njit(_nrt=False)
def _noise(kind, claimed, seen):
    """Variance that counts as noise of an input where GATE and a slip are judged. claimed: its own; seen: realised."""
    if kind == Kind.MAGNETIC:  # iron beside the way lasts, and would pass for noise
        return min(seen, claimed)
    least = LEAST_NOISE if is_of_velocity(kind) else LEAST_HEADING_NOISE
    return min(seen, max(LARGEST_NOISE_FACTOR * claimed, least**2))


@njit(_nrt=False)
def _change(mem, r, at, n, own, noise, variance, since):
    """Square of the change of the innovation since the input fitted, and its variance; of a speed or the forward
    velocity of an odometry.

    The error of the state was in the innovations before, too, so only what its variance has changed by is expected: a
    wheel that begins to slip is found though the state is less certain than the wheel. noise: variance of the input.
    """
    kind = mem[at + Event.KIND]
    gain = _gain(kind, since)
    is_judged = is_forward_speed(kind) and PRIOR - mem[own + Noise.SCALE + Scale.REDUCED] < LARGEST_LOG_VARIANCE
    change = _first(mem, r, at, n) - mem[own + Fit.LEVEL] if is_judged else 0.0
    return change**2, noise * 2.0 / (2.0 - gain) + abs(variance - mem[own + Fit.LEVEL_VARIANCE])


@njit(_nrt=False)
def _step(mem, r, at, n, own, noise, variance, since):
    """Mean step of a heading, rad, in the last two to four messages, none of which has fitted; 0: not significant.

    The yaw of the vehicle makes no step, so that of a heading is another offset: antennas that have turned, a receiver
    that has resolved its phases anew, a compass that was calibrated. noise: variance of the input.
    """
    fitted, time = mem[own + Fit.TIME], mem[at + Event.TIME]
    if fitted <= 0.0 or since <= 0.0 or PRIOR - mem[own + Noise.SCALE + Scale.REDUCED] > LARGEST_LOG_VARIANCE:
        return 0.0
    count = int((time - fitted) / since + 0.5)  # at equal intervals; after a missing message the sum begins anew
    if count <= 1:
        mem[own + Fit.STEP] = 0.0
    change, before = _first(mem, r, at, n) - mem[own + Fit.LEVEL], mem[own + Fit.STEP]
    mem[own + Fit.STEP] += change
    if not 2 <= count <= LONGEST_STEP:
        return 0.0
    step, gain = mem[own + Fit.STEP] / count, _gain(Kind.HEADING, since)
    if (change - before / (count - 1)) ** 2 > (count - 1) * count * noise:
        return 0.0  # it scatters: not within count - 1 sigma; the fewer they are, the more they must agree
    expected = noise / count + noise * gain / (2.0 - gain) + abs(variance - mem[own + Fit.LEVEL_VARIANCE])
    return step if step**2 > NARROW_GATE**2 * expected else 0.0


@njit(_nrt=False)
def _gain(kind, since):
    """Gain of the low pass of the innovations that fitted. since: s since the message before."""
    return 1.0 / LONGEST_STEP if kind == Kind.HEADING else max(0.0, min(since / SHORTEST_SLIP, 1.0))


@njit(_nrt=False)
def _first(mem, r, at, n):
    """First component of the innovation of the event at `at`."""
    return mem[at + Event.Z_N] - product(mem, n, int(mem[Head.SCRATCH_AT]) + n * n, r + NAV)


@njit(_nrt=False)
def _note_fitted(mem, r, at, n, own, variance, since):
    """Note that the input fits: time, level of its innovation and variance of the state."""
    kind, time = int(mem[at + Event.KIND]), mem[at + Event.TIME]
    gain = _gain(kind, since) if _has_fitted(mem, own, kind, time) else 1.0
    mem[own + Fit.TIME] = time
    mem[own + Fit.LEVEL] += gain * (_first(mem, r, at, n) - mem[own + Fit.LEVEL])
    mem[own + Fit.LEVEL_VARIANCE] += gain * (variance - mem[own + Fit.LEVEL_VARIANCE])


@njit(_nrt=False)
def _alternates(mem, r, at, n, own, squared):
    """Whether a speed, velocity or odometry that is far off was so on the other side within LONGEST_SLIP: wheels that
    slip are too fast or too slow for a while, so this is noise, however large, from which its scale is learned.

    squared: of the innovation, mean of the components.
    """
    first = _first(mem, r, at, n)
    if mem[at + Event.KIND] == Kind.VELOCITY and first * first < squared:
        return False  # it is off mainly to the east, and the sign of the northern component is chance
    side, other = (Fit.ABOVE, Fit.BELOW) if first > 0.0 else (Fit.BELOW, Fit.ABOVE)
    time = mem[at + Event.TIME]
    mem[own + side] = time
    return mem[own + other] > 0.0 and time - mem[own + other] < LONGEST_SLIP


@njit(_nrt=False)
def _is_far_off(kind, nis):
    """Whether an innovation, or its change, is more than noise. nis: its square over its variance."""
    far = NARROW_GATE if kind == Kind.MAGNETIC else SLIPPED
    return nis > far**2


@njit(_nrt=False)
def _has_fitted(mem, own, kind, time):
    """Whether a speed, velocity, odometry or heading has fitted so lately that what is far off now is wrong: so soon no
    IMU is wrong by as much."""
    longest = LONGEST_SLIP if is_of_velocity(kind) else LONGEST_JUMP
    return mem[own + Fit.TIME] != 0.0 and time - mem[own + Fit.TIME] < longest


@njit(_nrt=False)
def _goes_on_slipping(mem, own, kind, time, since):
    """Whether a speed, velocity or odometry that has fitted lately has not done so for SHORTEST_SLIP."""
    return (is_of_velocity(kind) and _has_fitted(mem, own, kind, time)
            and time - mem[own + Fit.TIME] > max(SHORTEST_SLIP, FOLLOWS * since))


@njit(_nrt=False)
def _slips(mem, own, kind, time, since, nis):
    """Whether wheels slip, or the same of a velocity or a heading: it has fitted a moment ago, and is far off.

    One that goes on slipping has to fit before it is used: the state without it becomes less certain. nis: the larger
    one of the innovation's square over its variance, and that of its change. since: s since the message before.
    """
    return _has_fitted(mem, own, kind, time) and (
        _is_far_off(kind, nis) or _goes_on_slipping(mem, own, kind, time, since) and nis > ROBUST**2)


@njit(_nrt=False)
def _fits(mem, own, kind, time, since, nis, change_nis, slips):
    """Whether a speed, velocity, odometry or heading fits the state; of one that has not fitted for SHORTEST_SLIP, the
    change of the innovation has to fit, too. nis, change_nis: squares of both over their variances."""
    if not _has_fitted(mem, own, kind, time):
        return nis < ROBUST**2
    follows = time - mem[own + Fit.TIME] < FOLLOWS * since  # the message before this one has fitted
    return nis < ROBUST**2 and not slips and (follows or change_nis < ROBUST**2)


@njit(_nrt=False)
def _comes_back(mem, own, kind, time, since):
    """Whether a speed, velocity, odometry or heading that fits has not done so in messages before this one."""
    if _has_fitted(mem, own, kind, time):
        return _goes_on_slipping(mem, own, kind, time, since)
    return mem[own + Fit.TIME] > 0.0 and since < displacement.LONGEST_PAUSE


@njit(_nrt=False)
def _refuses(mem, at, n, own, since, squared, far_off, slips, confirmed):
    """Whether a speed, velocity, odometry or heading that does not fit is refused: it slips, or is far off for longer
    than a slip lasts while fixes confirm the state, by more than its constant error, or its time offset, can be. The
    latter makes it wrong until it `_is_right_again`. squared: of the innovation."""
    kind, time = int(mem[at + Event.KIND]), mem[at + Event.TIME]
    if confirmed and far_off and not slips and mem[own + Fit.TIME] > 0.0:  # no slip lasts for so long
        if _may_be_another_constant(mem, at, n, squared):
            _forget_error(mem, at, n, own, squared)
            return False
        mem[own + Fit.TIME] = -time
        displacement.forget(mem, own)
        return True
    if far_off and kind != Kind.VELOCITY and _goes_on_slipping(mem, own, kind, time, since):
        displacement.interrupt(mem, own)
    return slips


@njit(_nrt=False)
def _may_be_another_constant(mem, at, n, squared):
    """Whether another constant error of the input at `at`, or another time offset, may explain its innovation,
    squared."""
    return _explains(mem, n, _constant_error(mem, at), squared, LARGEST_ERROR) or _explains(
        mem, n, _time_offset(mem, at), squared, LARGEST_OFFSET)


@njit(_nrt=False)
def _explains(mem, n, state, squared, largest):
    """Whether an error of `state` (-1: none) of less than `largest` explains an innovation, squared."""
    return state >= 0 and squared < (largest * mem[int(mem[Head.SCRATCH_AT]) + n * n + state]) ** 2


@njit(_nrt=False)
def _is_right_again(mem, r, at, n, own, squared, expected):
    """Whether an input that was wrong is right again: its displacements are, or it has fitted the state, which it has
    not misled since then, for RIGHT_AGAIN_AFTER where an error of LARGEST_ERROR would not have fitted. Notes since when
    it fits; one that does not has no displacement.

    squared, expected: of the innovation, and its variance.
    """
    kind, time = int(mem[at + Event.KIND]), mem[at + Event.TIME]
    if mem[own + Fit.TIME] == -time:  # its displacements are wrong
        return False
    if is_of_heading(kind):  # the state's heading may be what it has made of it
        return displacement.is_compared(mem, own)
    if squared > ROBUST**2 * expected and not _may_be_another_constant(mem, at, n, squared):
        mem[own + Fit.TIME] = -time
        displacement.interrupt(mem, own)
        return False
    if displacement.is_compared(mem, own):
        return True
    speed = math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E])
    if ROBUST**2 * expected > (LARGEST_ERROR * speed) ** 2:
        mem[own + Fit.TIME] = -time
    if time + mem[own + Fit.TIME] < RIGHT_AGAIN_AFTER:
        return False
    displacement.accept(mem, own)
    return True


@njit(_nrt=False)
def _raise_error(mem, at, n, squared):
    """The constant error of the input at `at`, or its time offset, may have become another one: the variance of each is
    raised by what would explain that the innovation, squared, has changed by so much. Later ones tell them apart."""
    p = int(mem[Head.SCRATCH_AT])
    for state, largest in ((_constant_error(mem, at), LARGEST_ERROR), (_time_offset(mem, at), LARGEST_OFFSET)):
        if squared > 0.0 and _explains(mem, n, state, squared, largest):
            mem[p + (n + 1) * state] += squared / mem[p + n * n + state] ** 2


@njit(_nrt=False)
def _forget_error(mem, at, n, own, squared):
    """The same by what would explain the innovation, squared, and the displacements, beyond what is expected; these are
    of the error before, and so may be what seemed to be noise."""
    error = _constant_error(mem, at)
    if error >= 0:
        mem[int(mem[Head.SCRATCH_AT]) + (n + 1) * error] += min(displacement.squared_error(mem, own), LARGEST_ERROR**2)
    if error >= 0 or _time_offset(mem, at) >= 0:
        _raise_error(mem, at, n, squared)
        mem[own + Fit.ABOVE] = mem[own + Fit.BELOW] = 0.0
        displacement.forget_error(mem, own)
        reopen(mem, own + Noise.SCALE, 1.0)


@njit(_nrt=False)
def _make_state_uncertain(mem, n, dimensions, variance):
    """What does not fit is wrong, or the state is. What the variance of a measurement is raised by, that of the state
    is raised by, too, along what is measured, unless fixes speak for the state, as they do for its velocity: so a
    filter that is sure of something wrong comes to where both agree, and the other measurements decide."""
    p, n_navigation = int(mem[Head.SCRATCH_AT]), int(mem[Head.N_NAVIGATION])
    h = p + n * n
    column = h + 3 * n
    for k in range(dimensions):
        raised = variance / project(mem, n, h + n * k, column) ** 2
        for i in range(n_navigation):  # sensor errors do not make it wrong by as much at once
            for j in range(n_navigation):
                mem[p + n * i + j] += raised * mem[column + i] * mem[column + j]


@njit(_nrt=False)
def _innovation(mem, r, at, n, dimensions):
    """Mean square of the innovation of the event at `at`, and what of that is expected of the state."""
    h, squared, variance = int(mem[Head.SCRATCH_AT]) + n * n, 0.0, 0.0
    for k in range(dimensions):
        squared += (mem[at + Event.Z_N + k] - product(mem, n, h + n * k, r + NAV)) ** 2 / dimensions
        variance += project(mem, n, h + n * k, h + 3 * n) / dimensions
    return squared, variance


@njit(_nrt=False)
def _is_elsewhere(mem, own, time, squared, expected, confirmed):
    """Whether a further receiver has been far from the fixes, and not near them since then.

    squared, expected: mean square of its innovation, m^2. confirmed: whether fixes come.
    """
    if confirmed and squared > max(NARROW_GATE**2 * expected, 0.5 * receiver.GATE_FLOOR**2):
        mem[own + Fit.TIME] = -time
    elif confirmed and squared < ROBUST**2 * expected:
        mem[own + Fit.TIME] = time
    return mem[own + Fit.TIME] < 0.0 and time + mem[own + Fit.TIME] < LONGEST_JUMP


@njit(_nrt=False)
def _repeated(lasts, since):
    """Of how many measurements, `since` s apart, the errors are the same where they last for `lasts` s."""
    return max(1.0, lasts / max(since, 1e-3))


@njit(_nrt=False)
def _constant_error(mem, at):
    """Index of the state that is the constant error of the input at `at`, -1: none: scale factor error of a speed or an
    odometry, offset of a heading."""
    return int(mem[at + Event.STATE]) if _has_constants(mem[at + Event.KIND]) else -1


@njit(_nrt=False)
def _time_offset(mem, at):
    """Index of the state that is the time offset of the same inputs, -1: none."""
    state = int(mem[at + Event.TIME_OFFSET])
    return state if state > 0 and _has_constants(mem[at + Event.KIND]) else -1


@njit(_nrt=False)
def _has_constants(kind):
    """Whether what is constant of an input of this kind is told by one component of its innovation."""
    return is_forward_speed(kind) or kind == Kind.HEADING


@njit(_nrt=False)
def is_contradicted(mem, r, at):
    """Whether the input of the event at `at` has contradicted the fixes, and has not been right again since then."""
    return has_displacement(int(mem[at + Event.KIND])) and mem[input_at(mem, r, at) + Fit.TIME] < 0.0


@njit(_nrt=False)
def _note_wrong_displacement(mem, r, at, n):
    """Note whether the displacements of the input of the event at `at` contradict those of the fixes, by more than its
    constant error, as estimated, may still be off; P is in the scratch."""
    kind, own = int(mem[at + Event.KIND]), input_at(mem, r, at)
    if not has_displacement(kind):
        return
    error, tolerated = _constant_error(mem, at), displacement.TOLERATED_ERROR
    if error >= 0:
        tolerated = displacement.ERROR_SIGMAS * math.sqrt(mem[int(mem[Head.SCRATCH_AT]) + (n + 1) * error])
        if mem[own + Fit.TIME] < 0.0:  # refused already: it may be one with another constant error
            tolerated = max(tolerated, LARGEST_ERROR)
    begun_anew = mem[own + Fit.TIME] >= 0.0 and mem[own + Integral.COMPARED] < 0.0
    if begun_anew or displacement.differs(mem, own, kind, tolerated):
        # it has misled the state where it was used since the fix before: one that was refused has not
        fitted = mem[own + Fit.TIME]
        if fitted > max(mem[own + Integral.START] - displacement.LONGEST_PAUSE, 0.0):
            contradiction.use_all_fixes(mem, r, fitted - mem[own + Integral.COMPARED])
        mem[own + Fit.TIME] = -mem[at + Event.TIME]


@njit(_nrt=False)
def integrate_displacement(mem, r, at, n, c, sample):
    """Integrate the speed, velocity, twist or heading at `at` to a displacement; c: rotation from b to n, sample:
    position of the IMU sample of that time.

    Wheels tell the velocity of the axle, which does not go sideways. That of the antenna differs by the turn rate.
    """
    x, y, z = arm_of(mem, at)
    yaw_variance, density = 0.0, SPEED_CORRELATION * mem[at + Event.R_NN]
    kind, error = mem[at + Event.KIND], _constant_error(mem, at)
    known = mem[r + NAV + error] if error >= 0 else 0.0
    unfollowed = mem[input_at(mem, r, at) + LowPass.UNFOLLOWED]
    if kind == Kind.VELOCITY:  # it has directions of its own
        v_n, v_e = mem[at + Event.VALUE], mem[at + Event.VALUE + 1]
    elif is_of_heading(kind):  # a displacement along the heading
        forward = body_velocity(mem, r, vehicle_to_level(mem, r, c), 0)
        yaw = (magnetometer.heading(mem, r, at, c) if kind == Kind.MAGNETIC else
               mem[at + Event.VALUE] - known + unfollowed)
        v_n, v_e = math.cos(yaw) * forward, math.sin(yaw) * forward
        x, y, z = axle_of(mem, r)[0], 0.0, 0.0
        density *= forward * forward
    else:
        vehicle = vehicle_to_level(mem, r, c)
        forward = mem[at + Event.VALUE] / (1.0 + known) + unfollowed
        v_n, v_e = vehicle[0] * forward, vehicle[3] * forward
        x = axle_of(mem, r)[0]
        yaw_variance = mem[int(mem[Head.SCRATCH_AT]) + (n + 1) * yaw_state(mem)]
    w_x, w_y, w_z = angular_rate(mem, r, sample)
    x, y, z = mem[Head.LEVER_X] - x, mem[Head.LEVER_Y] - y, mem[Head.LEVER_Z] - z
    north, east, _ = rotate(c, w_y * z - w_z * y, w_z * x - w_x * z, w_x * y - w_y * x)  # w x arm
    late, late_variance, offset = 0.0, 0.0, int(mem[at + Event.TIME_OFFSET])
    if offset > 0 and not is_of_heading(kind):
        late = mem[r + NAV + offset]
        late_variance = mem[int(mem[Head.SCRATCH_AT]) + (n + 1) * offset]
    displacement.integrate(mem, r, input_at(mem, r, at), mem[at + Event.TIME], v_n + north, v_e + east, density,
                           yaw_variance, late, late_variance)
    goes = abs(body_velocity(mem, r, vehicle_to_level(mem, r, c), 0))
    if kind != Kind.VELOCITY and math.hypot(north, east) > max(goes, SLOWEST_SPEED):
        displacement.interrupt(mem, input_at(mem, r, at))  # a turn on the spot moves the antenna, and fits any speed


@njit(_nrt=False)
def leave_out_turn_rate(mem, r, at, n):
    """Leave out the turn rate of the event at `at`, its third component, where it does not fit: at any instant
    gyroscopes know it better than wheels, of which it may have the wrong sign, track or clock."""
    h = int(mem[Head.SCRATCH_AT]) + n * n + 2 * n
    innovation = mem[at + Event.Z_D] - product(mem, n, h, r + NAV)
    if innovation**2 > ROBUST**2 * (mem[at + Event.R_DD] + project(mem, n, h, h + n)):
        mem[at + Event.Z_D] = 0.0
        for i in range(n):
            mem[h + i] = 0.0


@njit(_nrt=False)
def absorb_step(mem, r, at, n):
    """A pressure that is far off at once is another air - a door, a fan, a tunnel - and not another height: its bias
    takes what it is off by."""
    bias, h = int(mem[at + Event.STATE]), int(mem[Head.SCRATCH_AT]) + n * n
    innovation = mem[at + Event.Z_N] - product(mem, n, h, r + NAV)
    if bias >= 0 and innovation**2 > GATE**2 * (mem[at + Event.R_NN] + project(mem, n, h, h + 3 * n)):
        mem[r + NAV + bias] -= innovation
