"""Apply a measurement to the state at its time: the order of the checks, for fixes and for all other inputs."""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from .measurements import position, registry, twist
from .measurements.geometry import body_to_level, yaw_of
from .memory import NAV, Error, Event, Head, Kind, Nav, Verdict, input_at, row_of
from .prediction import set_radii
from .trust import (
    contradiction,
    creep,
    displacement,
    extrapolation,
    fix_drift,
    hypotheses,
    inputs,
    new_start,
    receiver,
    repeats,
)
from .trust.drift import learn_drift
from .trust.fix_drift import FixDrift
from .trust.hypotheses import Hypothesis
from .trust.receiver import Receiver
from .trust.standstill import note_speed, stands
from .trust.usual_speed import learn_speed
from .update import ROBUST, begin_update, end_update, normalized_square, product, project, update

#: largest number of fixes refused in a row that count as outliers: other inputs are not compared with them
#: (`trust/displacement.py`). After more of them the filter may be wrong. Chosen; a quarter and four times of it move
#: little (docs/ablation.md)
MOST_OUTLIERS = 3.0


@njit(_nrt=False)
def apply_event(mem, r, at, sample):
    """Correct the state at r with the measurement at `at`; sample: position of the IMU sample of that time."""
    if mem[at + Event.VERDICT] == Verdict.AHEAD:
        return
    if repeats.is_stuck(mem, r, at):
        mem[at + Event.VERDICT], mem[at + Event.WEIGHT] = Verdict.FROZEN, 0.0
        repeats.note(mem, r, at)
    elif mem[at + Event.KIND] == Kind.POSITION:
        _apply_fix(mem, r, at)
    else:
        _apply_input(mem, r, at, sample)


@njit(_nrt=False)
def _apply_fix(mem, r, at):
    """Check the fix at `at`, correct the state at r with it, and learn from it.

    Checks: extrapolated straight line, new start or heading from the course, the receiver's realised scatter, whether
    this filter assumes that the fixes are wrong, whether a standstill was a creep, innovation gate. Learned: scatter of
    the receiver, displacement of the other inputs, drift of the fixes, drift of the sensors.
    """
    receiver.take_status(mem, r, at)
    if _is_extrapolated(mem, r, at):
        extrapolation.refuse_fix(mem, r, at)
        return
    n, h = begin_update(mem, r)
    recovered, before = False, hypotheses.position_and_velocity(mem, r)
    fixes_wrong = mem[r + Hypothesis.FIXES_WRONG] != 0.0
    if not fixes_wrong:
        recovered = mem[Head.GATE] > 0.0 and new_start.is_due(mem, r, at)
        if recovered:
            new_start.start_anew(mem, r, at)
        else:
            v_n, v_e = new_start.course_velocity(mem, r, at)
            if v_n != 0.0 or v_e != 0.0:
                new_start.take_course(mem, r, v_n, v_e, 0.0)
    c = _note_state(mem, r, at)
    dimensions = position.observe(mem, r, at, h, n, c)
    height = mem[at + Event.Z_D] + mem[r + Nav.HEIGHT]  # used by the planar filter, which has no state for the height
    receiver.learn_scatter(mem, r, at)
    factor, robust, gate = receiver.factor_and_limits(mem, r, at)
    if fixes_wrong:
        robust = gate = 0.0
    if not _uses_fix(mem, r, at, n, factor):
        hypotheses.refuse_fix(mem, r, at)
        return
    p = int(mem[Head.SCRATCH_AT])
    known, variance = 0.5 * (mem[p] + mem[p + n + 1]), receiver.realised_variance(mem, r, at)
    white, slow = receiver.white_and_slow(mem, r, at)
    crept = not fixes_wrong and creep.crept(mem, r, at, known + white, slow)
    if crept:
        creep.correct(mem, r, p, n)
    if mem[r + Nav.USE_ALL_FIXES] > 0.0:
        if contradiction.inflate_to_fit(mem, r, n, _misfit(mem, r, at, n, factor)):
            robust = gate = 0.0
    # a height that is far off is no sign that the filter is wrong: in a car it changes slowly
    verdict = update(mem, r, at, n, dimensions, factor, 1.0, robust, gate, mem[Head.ROBUST_SIGMA])
    mem[at + Event.VERDICT] = Verdict.RECOVERED if recovered else verdict
    if verdict != Verdict.REFUSED or crept:
        end_update(mem, r)
        without_altitude = position.is_without_altitude(mem[at + Event.R_DD])
        if row_of(mem, Error.R_D) < 0 and verdict != Verdict.REFUSED and not without_altitude:
            mem[r + Nav.HEIGHT] = height
        set_radii(mem, r)
    creep.note_correction(mem, r, mem[at + Event.WEIGHT] * known / (known + variance))
    new_start.note(mem, r, at)
    repeats.note(mem, r, at)
    left_n, left_e, _ = position.difference(mem, r, at, body_to_level(mem, r))
    if verdict != Verdict.REFUSED or mem[r + Nav.REFUSED] > MOST_OUTLIERS:
        displacement.compare(mem, r, at, variance)
    after = hypotheses.position_and_velocity(mem, r)
    extrapolation.note_move(mem, r, before, after)
    if recovered:  # it has moved by more than a correction
        fix_drift.reset(mem, r)
        mem[r + Receiver.FIRST] = 0.0
    else:
        hypotheses.add_move(mem, r, r + FixDrift.MOVED, before, after)
        hypotheses.add_move(mem, r, r + Receiver.MOVED, before, after)
    receiver.learn(mem, r, at, left_n, left_e)
    learn_drift(mem, r)
    if verdict == Verdict.USED and not stands(mem, r):
        learn_speed(mem, r, mem[at + Event.TIME])


@njit(_nrt=False)
def _apply_input(mem, r, at, sample):
    """Check a measurement that is not a fix of the main receiver, and correct the state at r with it."""
    n, h = begin_update(mem, r)
    before = hypotheses.position_and_velocity(mem, r)
    kind, c = mem[at + Event.KIND], _note_state(mem, r, at)
    dimensions = registry.observe(mem, r, at, h, n, c, sample)
    if kind == Kind.PRESSURE:
        inputs.absorb_step(mem, r, at, n)
    if inputs.has_displacement(kind):
        inputs.integrate_displacement(mem, r, at, n, c, sample)
    judged = min(dimensions, 2)
    if kind == Kind.TWIST:
        judged = 2 if twist.measures_sideways(mem, at) else 1
        inputs.leave_out_turn_rate(mem, r, at, n)
    factor, repeated, gate = inputs.factor_and_limits(mem, r, at, n, judged)
    verdict = update(mem, r, at, n, dimensions, factor, repeated, ROBUST, gate, ROBUST)
    mem[at + Event.VERDICT] = verdict
    if inputs.has_displacement(kind) and verdict == Verdict.REFUSED:
        if inputs.is_contradicted(mem, r, at):
            mem[at + Event.VERDICT] = Verdict.CONTRADICTED
        elif kind != Kind.MAGNETIC and not displacement.is_compared(mem, input_at(mem, r, at)):
            mem[at + Event.VERDICT] = Verdict.AWAITED
    if verdict != Verdict.REFUSED:
        end_update(mem, r)
        set_radii(mem, r)
        hypotheses.move_offset(mem, r, before)
        if inputs.is_forward_speed(kind):
            note_speed(mem, r, at)
    repeats.note(mem, r, at)


@njit(_nrt=False)
def _note_state(mem, r, at):
    """Write the predicted yaw and velocity to the measurement at `at`; returns the rotation from b to n (9 elements).
    """
    c = body_to_level(mem, r)
    mem[at + Event.YAW] = yaw_of(c)
    mem[at + Event.V_N], mem[at + Event.V_E] = mem[r + Nav.V_N], mem[r + Nav.V_E]
    return c


@njit(_nrt=False)
def _uses_fix(mem, r, at, n, factor):
    """Whether this filter uses the fix at `at` (`hypotheses.score_fix`). The rows of H follow P in the scratch. factor:
    on its covariance R."""
    h = int(mem[Head.SCRATCH_AT]) + n * n
    column = h + 3 * n
    r_nn, r_ne, r_ee = (factor * mem[at + Event.R_NN], factor * mem[at + Event.R_NE], factor * mem[at + Event.R_EE])
    s_nn = r_nn + project(mem, n, h, column)
    s_ne = r_ne + product(mem, n, h + n, column)
    s_ee = r_ee + project(mem, n, h + n, column)
    return hypotheses.score_fix(mem, r, at, s_nn, s_ne, s_ee, 0.5 * (r_nn + r_ee), receiver.innovation_factor(mem, r))


@njit(_nrt=False)
def _misfit(mem, r, at, n, factor):
    """Normalized innovation squared of the fix at `at` before its correction, as if the lever arm had no effect on S.
    """
    p = int(mem[Head.SCRATCH_AT])
    a, b = mem[at + Event.Z_N] - mem[r + NAV], mem[at + Event.Z_E] - mem[r + NAV + 1]
    s_nn, s_ne = mem[p] + factor * mem[at + Event.R_NN], mem[p + 1] + factor * mem[at + Event.R_NE]
    s_ee = mem[p + n + 1] + factor * mem[at + Event.R_EE]
    return normalized_square(a, b, s_nn, s_ne, s_ee)


@njit(_nrt=False)
def _is_extrapolated(mem, r, at):
    """Whether the fix at `at` comes from a receiver that extrapolates a straight line without satellites."""
    north, east, _ = position.difference(mem, r, at, body_to_level(mem, r))
    fix_drift.note(mem, r, at, north - mem[r + NAV], east - mem[r + NAV + 1])
    return extrapolation.is_extrapolated(mem, r, at, north - mem[r + NAV], east - mem[r + NAV + 1])
