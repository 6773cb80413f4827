"""Whether the vehicle certainly moves, as the state says, and whether it stands, as the accelerometers show it.

Of standstills this is the filter's one detector, and it learns from the vehicle.

The scatter of samples does not separate an idling engine from a smooth road. What does is what is left of the specific
force below a hertz or so: no road is so even and no driver so steady that pitch, grade, bank and speed keep still, and
an engine shakes faster. How much there is in motion and at rest is learned, as every vehicle and every mount has its
own: the quietest motion while the filter is certain that the vehicle moves, and the level at rest well below it.
studies/standstill.py compares this with fixed thresholds and counts false and missed seconds.

A robot below MOVING_SPEED may be as quiet in motion as at rest, and turns on the spot. Where a speed of wheels or an
odometry comes, it has the last word; and fixes that go straight on for metres contradict a standstill (`shown_speed`).
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, ROW, Event, Kind, Nav, Sample, nonnegative, velocity_variance
from .hypotheses import SHORTEST_CORRELATION
from .line import FEWEST_ON_LINE, Line, add_to_line, begin_line, fit_line

#: parts of the window below: it moves on by one of these at a time
PARTS = 6
#: what the detector remembers
Still = HEAD.place(
    'Still',
    FIRST=3,  # specific force low-passed once, m/s^2
    SECOND=3,  # and twice
    MEAN=3,  # running mean of that
    PART=1,  # which part of the window the latest sample belongs to
    SQUARES=PARTS + 1,  # (m/s^2)^2 s: integral over each part of the square of what is left,
    DURATIONS=PARTS + 1,  # s: and how long each part is
    CREPT=1,  # s: for how long the vehicle has been slow, but moved; negative: it has been fast, at some time
    MOTION=1,  # logarithm of the least root mean square of it in motion
    REST=1)  # and of what is usual at rest
#: of a state
WheelMotion = ROW.place('WheelMotion', TIME=1)  # s: time of the latest speed if that is significant, else 0
Standing = ROW.place(
    'Standing',
    TIME=1,  # s, of the latest zero velocity,
    LINE=Line.SIZE,  # of the fixes since it began, m from the first of them
    FIRST=2,  # latitude and longitude of that, rad,
    CONTRADICTED=1)  # and time, s, of the latest fix that showed that the vehicle moves; 0: none

#: sigmas that it claims, beyond which a speed is certainly one of motion,
SIGNIFICANT = 3.0
#: m/s, and which it is in any case: some claim less than what they scatter at rest
SLOWEST_SPEED = 0.1
#: rad/s, and the same of the turn rate of an odometry
SLOWEST_TURN = 0.02
#: s after which such a speed says nothing any more
LONGEST_VALID = 1.0
#: sigmas of the velocity by which a certain speed is less than the estimated one: by chance a vehicle is slower than
#: that once in forty times
CERTAIN_SIGMAS = 2.0
#: m/s: a vehicle certainly moves where its certain speed is above this: a slower one may stand
MOVING_SPEED = 1.0
#: m/s: how quiet the vehicle is in motion is learned where its speed, less SURE_SIGMAS, is above this. Half of
#: MOVING_SPEED, as a car that creeps may be as quiet as others that stand: with all of it, a gap in the samples of such
#: a car ended in a standstill
LEARNING_SPEED = 0.5
#: sigmas: fixes that are late leave a speed of two sigmas for seconds after a stop, which then passed for motion as
#: quiet as rest for ten minutes
SURE_SIGMAS = 4.0
#: s: a robot that has never been faster than MOVING_SPEED shows that where it has moved for so long, twice WINDOW
CREEPING_TIME = 3.0
#: m: a vehicle that stands, as its accelerometers show it, moves where fixes go straight on for so far, further than
#: those of a receiver that finds or loses its base change
SHORTEST_DISTANCE = 1.0
#: sigmas of a fix, and for so far: errors by reflections wander by less at a standstill
DISTANCE_SIGMAS = 7.0
#: share of that distance by which they scatter about the line at most: fixes that jump scatter by a sixth of it
STRAIGHT_SHARE = 0.15
#: s for which they are compared with one line: after that the vehicle may have turned
LONGEST_LINE = 60.0
#: s for which a standstill that they contradict is none: time to learn how quiet the vehicle is in motion
MOTION_TIME = 60.0
#: s: time constant of each of the two low passes; an engine shakes faster than what they leave
LOW_PASS = 0.15
#: s: time constant of the running mean that is taken out of it, tilt and bias; after a braking it decays with this
MEAN_TIME = 0.3
#: s: the mean square of the rest is one over a window of this length, without a tail: what a braking has left in an
#: exponential mean hides a stop of four seconds. Between two gears a vehicle is as quiet for a second
WINDOW = 1.5
#: a standstill is quieter than the quietest motion by this factor, and may be louder than other standstills by the same
SEPARATION = 2.0
#: s: time constant with which the quietest motion is forgotten; roads and loads change in minutes
FORGETTING_TIME = 600.0
#: s: the level at rest is a mean over this
REST_TIME = 5.0
#: m/s^2: the quietest motion of a vehicle of which nothing is known yet; it is learned within a minute
EXPECTED_MOTION = 0.05
#: m/s^2: and its level at rest
EXPECTED_REST = 0.01


@njit(_nrt=False)
def velocity_sigma(mem, r):
    """Standard deviation of the horizontal velocity of the state at r, m/s."""
    return math.sqrt(velocity_variance(mem, nonnegative(r)))


@njit(_nrt=False)
def certain_speed(mem, r, sigma):
    """The speed that the vehicle certainly has in the state at r, m/s: less CERTAIN_SIGMAS. sigma: of its velocity."""
    r = nonnegative(r)
    return max(math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E]) - CERTAIN_SIGMAS * sigma, 0.0)


@njit(_nrt=False)
def moves(mem, r):
    """Whether the vehicle certainly moves in the state at r."""
    return certain_speed(mem, r, velocity_sigma(mem, r)) > MOVING_SPEED


@njit(_nrt=False)
def note_speed(mem, r, at):
    """Remember what the speed or odometry at `at`, which is used, says of the motion of the state at r."""
    moves = mem[at + Event.VALUE] ** 2 > max(SIGNIFICANT**2 * mem[at + Event.R_NN], SLOWEST_SPEED**2)
    if mem[at + Event.KIND] == Kind.TWIST:  # false of a turn rate that is not measured, NaN
        moves = moves or mem[at + Event.VALUE + 2] ** 2 > max(SIGNIFICANT**2 * mem[at + Event.R_DD], SLOWEST_TURN**2)
    mem[r + WheelMotion.TIME] = mem[at + Event.TIME] if moves else 0.0


@njit(_nrt=False)
def wheels_turn(mem, r):
    """Whether a speed has said lately that the vehicle moves."""
    return mem[r + WheelMotion.TIME] != 0.0 and mem[r + Nav.TIME] - mem[r + WheelMotion.TIME] < LONGEST_VALID


@njit(_nrt=False)
def fixes_show_motion(mem, r):
    """Whether fixes have shown lately that the vehicle moves, although its accelerometers are as quiet as at rest."""
    latest = mem[r + Standing.CONTRADICTED]
    return latest != 0.0 and mem[r + Nav.TIME] - latest < MOTION_TIME


@njit(_nrt=False)
def stands(mem, r):
    """Whether a standstill has been applied lately to the state at r."""
    return mem[r + Nav.TIME] - mem[r + Standing.TIME] < LONGEST_VALID


@njit(_nrt=False)
def shown_speed(mem, r, at, variance):
    """Speed, m/s, and distance, m, of the fixes since the begin of a standstill, the latest of them at `at`; zeros
    where they do not contradict it.

    variance: of a component of the fix, as fixes scatter, m^2.
    """
    line, time, standing = r + Standing.LINE, mem[at + Event.TIME], stands(mem, r)
    if not standing or time - mem[line + Line.SINCE] > LONGEST_LINE or mem[r + Nav.REFUSED] > 0.0:
        mem[line + Line.COUNT] = 0.0
    if not standing:
        return 0.0, 0.0
    if mem[line + Line.COUNT] == 0.0:
        begin_line(mem, line, time)
        mem[r + Standing.FIRST], mem[r + Standing.FIRST + 1] = mem[at + Event.LATITUDE], mem[at + Event.LONGITUDE]
    weight = min(max(time - mem[r + Nav.FIX_TIME], 0.0) / SHORTEST_CORRELATION, 1.0)
    north = (mem[at + Event.LATITUDE] - mem[r + Standing.FIRST]) / mem[r + Nav.NORTH_SCALE]
    east = (mem[at + Event.LONGITUDE] - mem[r + Standing.FIRST + 1]) / mem[r + Nav.EAST_SCALE]
    add_to_line(mem, line, time, north, east, weight)
    if mem[line + Line.COUNT] < FEWEST_ON_LINE:
        return 0.0, 0.0
    slope_n, slope_e, left, _ = fit_line(mem, line)
    speed = math.hypot(slope_n, slope_e)
    distance = speed * (time - mem[line + Line.SINCE])
    # a vehicle that is faster has not come to such a speed without being seen to accelerate
    if (distance < max(SHORTEST_DISTANCE, DISTANCE_SIGMAS * math.sqrt(variance)) or speed > MOVING_SPEED
            or math.sqrt(left) > STRAIGHT_SHARE * distance):
        return 0.0, 0.0
    mem[line + Line.COUNT], mem[r + Standing.CONTRADICTED] = 0.0, time
    return speed, distance


@njit(_nrt=False)
def is_still(mem, sample, dt, speed, sigma, anew):
    """1 when the sample at `sample`, dt s after the one before, is one of a standstill; its state is in the head.

    speed: that the vehicle certainly has (`certain_speed`), sigma: of the estimated one, m/s. anew: whether nothing is
    known of the time before the sample, so that a change of its specific force since then says nothing.
    """
    low, slow, square = min(1.0, dt / LOW_PASS), min(1.0, dt / MEAN_TIME), 0.0
    first = mem[Still.MOTION] == 0.0
    for i in range(3):
        f = mem[sample + Sample.F_X + i]
        if first or anew:
            mem[Still.FIRST + i] = mem[Still.SECOND + i] = mem[Still.MEAN + i] = f
        mem[Still.FIRST + i] += low * (f - mem[Still.FIRST + i])
        mem[Still.SECOND + i] += low * (mem[Still.FIRST + i] - mem[Still.SECOND + i])
        deviation = mem[Still.SECOND + i] - mem[Still.MEAN + i]
        mem[Still.MEAN + i] += slow * deviation
        square += deviation * deviation
    if first:
        mem[Still.MOTION], mem[Still.REST] = math.log(EXPECTED_MOTION), math.log(EXPECTED_REST)
    mean, seen = _mean_square(mem, square, dt)
    if seen < WINDOW:
        return 0.0
    level, separation = 0.5 * math.log(max(mean, 1e-12)), math.log(SEPARATION)
    motion, rest = mem[Still.MOTION], mem[Still.REST]
    surely = speed - (SURE_SIGMAS - CERTAIN_SIGMAS) * sigma
    if surely > MOVING_SPEED or mem[Still.CREPT] < 0.0:
        mem[Still.CREPT] = -1.0
    else:
        mem[Still.CREPT] = mem[Still.CREPT] + dt if speed > SLOWEST_SPEED else 0.0
    if surely > LEARNING_SPEED or mem[Still.CREPT] > CREEPING_TIME:
        # the least there is: down at once, though not by one sample alone, and up slowly
        motion = min(motion + dt / FORGETTING_TIME, max(level, motion - 2.0 * dt))
    elif level < motion - separation:
        rest += min(1.0, dt / REST_TIME) * (level - rest)
    mem[Still.MOTION], mem[Still.REST] = motion, rest
    threshold = min(max(0.5 * (motion + rest), rest + separation), motion - separation)
    return 1.0 if level < threshold and speed <= MOVING_SPEED else 0.0


@njit(_nrt=False)
def _mean_square(mem, square, dt):
    """Mean of `square`, which belongs to the latest dt s, over the window, and how long that is already, s."""
    part = int(mem[Still.PART])
    if mem[Still.DURATIONS + part] >= WINDOW / PARTS:
        part = (part + 1) % (PARTS + 1)
        mem[Still.PART] = part
        mem[Still.SQUARES + part] = mem[Still.DURATIONS + part] = 0.0
    mem[Still.SQUARES + part] += square * dt
    mem[Still.DURATIONS + part] += dt
    squares = seen = 0.0
    for i in range(PARTS + 1):
        squares += mem[Still.SQUARES + i]
        seen += mem[Still.DURATIONS + i]
    return squares / seen, seen
