"""Detection of standstills by the accelerometers, and of motion by the state.

This is the only detector of standstills in the running filter, and it learns from the vehicle.

The scatter of the samples does not separate an idling engine from a smooth road. The variation of the specific force
below about 1 Hz does: in motion pitch, grade, bank and speed always change, and an engine shakes faster. Its level
differs between vehicles and mounts, so two levels are learned: that of the quietest motion, while the state shows that
the vehicle certainly moves, and the usual one at rest. studies/standstill.py compares this with fixed thresholds and
counts false and missed seconds.

A robot below MOVING_SPEED may be as quiet in motion as at rest. So a speed of wheels or an odometry overrides the
detector (`wheels_turn`), and fixes contradict a standstill (`creep.py`).
"""
from __future__ import annotations

import math

from mems_ins_fusion.compiled import njit

from ..memory import HEAD, ROW, Event, Kind, Nav, Sample, nonnegative, velocity_variance

#: number of parts of the window STILL_WINDOW, which is moved on by one part at a time
PARTS = 6
#: memory of the detector
Still = HEAD.place(
    'Still',
    FIRST=3,  # m/s^2, specific force after one low pass
    SECOND=3,  # and after two
    MEAN=3,  # its running mean
    TIME=1,  # s, of the latest valid sample
    PART=1,  # number of the part of the window that the latest sample belongs to
    SQUARES=PARTS + 1,  # (m/s^2)^2 s, integral of the squared deviation from the mean over each part,
    DURATIONS=PARTS + 1,  # s, and the duration of each part
    CREPT=1,  # s, for which the vehicle has moved slowly; negative: it has been faster than MOVING_SPEED at some time
    MOTION=1,  # logarithm of the smallest RMS deviation in motion, m/s^2,
    REST=1)  # and of the usual one at rest
#: of a state
WheelMotion = ROW.place('WheelMotion', TIME=1)  # s, time of the latest speed or odometry if it shows motion, else 0
Standing = ROW.place('Standing', TIME=1)  # s, of the latest zero-velocity update

#: number of claimed standard deviations above which a speed shows motion
MOTION_SIGMAS = 3.0
#: m/s, smallest speed that shows motion: some inputs scatter at rest by more than they claim
SLOWEST_SPEED = 0.1
#: rad/s, the same of the turn rate of an odometry
SLOWEST_TURN = 0.02
#: s for which a speed, or a zero-velocity update, counts as the present one. Chosen; a quarter and four times of it
#: move little (docs/ablation.md)
LONGEST_VALID = 1.0
#: standard deviations of the velocity by which the certain speed is below the estimated one: a vehicle is slower than
#: this by chance in one of forty cases
CERTAIN_SIGMAS = 2.0
#: m/s: with a certain speed above this the vehicle moves; a slower one may stand
MOVING_SPEED = 1.0
#: m/s: the level of motion is learned if the speed minus SURE_SIGMAS is above this. Half of MOVING_SPEED, as a creeping
#: car may be as quiet as others at rest; with 1 m/s, a gap in the samples of such a car leads to a false standstill
LEARNING_SPEED = 0.5 * MOVING_SPEED
#: standard deviations for that: with fixes that are late, the estimated speed is two sigma for seconds after a stop.
#: With two, this rest is learned as motion, and stops are missed for ten minutes
SURE_SIGMAS = 4.0
#: s, time constant of each of the two low passes: shorter than the motion of a vehicle, longer than engine vibration
LOW_PASS = 0.15
#: s, time constant of the running mean that is subtracted (tilt and bias); the effect of a braking decays with it
REMOVED_MEAN_TIME = 0.3
#: s, window of the mean square. In an exponential mean, the effect of a braking hides a stop of four seconds. Shorter
#: windows would take a change of gears, which is as quiet for a second, for a standstill
STILL_WINDOW = 1.5
#: s without a valid sample after which low passes, mean and window begin anew: a vehicle may drive off meanwhile.
#: Longer than the interval of slow IMUs. Chosen, not measured
LONGEST_UNSEEN = 0.5
#: s of slow motion after which the level of motion of a vehicle that has never been faster than MOVING_SPEED is learned
CREEPING_TIME = 2.0 * STILL_WINDOW
#: factor by which a standstill is quieter than the quietest motion, and by which it may exceed the usual level at rest
SEPARATION = 2.0
#: s, time constant with which the level of motion rises again: roads and loads change within minutes
MOTION_MEMORY = 600.0
#: s, time constant of the mean of the level at rest. Chosen; a quarter and four times of it move little
#: (docs/ablation.md)
REST_TIME = 5.0
#: how many times a vehicle stands for each time it creeps at a constant speed, as quiet as at rest: 321 to 15 times in
#: 34 simulated drives of 12 min (`vehicle.simulated`), 30 to 2 times in Kingston
STOPS_PER_CREEP = 20.0
#: m/s, mean speed of such a creep: 0.55 to 1.05 in these drives, 0.25 to 0.7 in Kingston
CREEP_SPEED = 0.7
#: m/s, its standard deviation, by the same numbers
CREEP_SCATTER = 0.3
#: the same for each time it is as quiet at a higher speed: in docs/standstill.md never in 13 300 s of motion beside
#: 2700 s at rest; half a second of it is the estimate with the prior of Jeffreys
STOPS_PER_SMOOTH_ROAD = 5000.0
#: s/m, density of these speeds: uniform up to 30 m/s
SPEED_DENSITY = 1.0 / 30.0
#: s for which half of the creeps, at least, stay quiet: 0.3 to 3; half of the stops lasted longer than 4
CREEP_TIME = 1.5
#: a standstill is believed if it is so many times as likely as motion: one that is none leaves an error of the speed
#: with a sigma of some cm/s, one that is missed leaves the sigma as it is. Chosen: wrong in one of ten doubtful cases
SURE_ODDS = 10.0
#: m/s, standard deviation of what the estimated speed at a stop is off beyond its sigma: with fixes that are late it is
#: off by 0.1 to 0.3 m/s for some seconds
STOP_SCATTER = 0.1
#: m/s^2, initial level of motion; that of the vehicle is learned within a minute
EXPECTED_MOTION = 0.05
#: m/s^2, initial level at rest
EXPECTED_REST = 0.01


@njit(_nrt=False)
def velocity_sigma(mem, r):
    """Standard deviation of the horizontal velocity of the state at r, m/s."""
    return math.sqrt(velocity_variance(mem, nonnegative(r)))


@njit(_nrt=False)
def certain_speed(mem, r, sigma):
    """Lower limit of the speed in the state at r, m/s: the estimate minus CERTAIN_SIGMAS. sigma: of its velocity."""
    r = nonnegative(r)
    return max(math.hypot(mem[r + Nav.V_N], mem[r + Nav.V_E]) - CERTAIN_SIGMAS * sigma, 0.0)


@njit(_nrt=False)
def moves(mem, r):
    """Whether the vehicle certainly moves in the state at r."""
    return certain_speed(mem, r, velocity_sigma(mem, r)) > MOVING_SPEED


@njit(_nrt=False)
def note_speed(mem, r, at):
    """Note whether the speed or odometry of the event at `at`, which is used, shows motion."""
    moves = mem[at + Event.VALUE] ** 2 > max(MOTION_SIGMAS**2 * mem[at + Event.R_NN], SLOWEST_SPEED**2)
    if mem[at + Event.KIND] == Kind.TWIST:  # false for NaN, a turn rate that is not measured
        moves = moves or mem[at + Event.VALUE + 2] ** 2 > max(MOTION_SIGMAS**2 * mem[at + Event.R_DD], SLOWEST_TURN**2)
    mem[r + WheelMotion.TIME] = mem[at + Event.TIME] if moves else 0.0


@njit(_nrt=False)
def wheels_turn(mem, r):
    """Whether the latest speed or odometry, if there is a recent one, shows motion."""
    return mem[r + WheelMotion.TIME] != 0.0 and mem[r + Nav.TIME] - mem[r + WheelMotion.TIME] < LONGEST_VALID


@njit(_nrt=False)
def stands(mem, r):
    """Whether a zero-velocity update has recently been applied to the state at r."""
    return mem[r + Nav.TIME] - mem[r + Standing.TIME] < LONGEST_VALID


@njit(_nrt=False)
def odds_of_standing(speed, variance, quiet):
    """How many times as likely it is that a vehicle which has been as quiet as at rest for `quiet` s stands as that it
    moves.

    speed: estimated one, m/s. variance: of it, (m/s)^2. Three statements are compared by how often each is true and by
    its density of the estimated speed: the vehicle stands, creeps at a constant speed, or moves faster on a road that
    is even. Of the latter two, the share 1 / (1 + t / CREEP_TIME) is quiet for longer than t.
    """
    standing, creeping = variance + STOP_SCATTER**2, variance + CREEP_SCATTER**2
    in_motion = _density(speed - CREEP_SPEED, creeping) / STOPS_PER_CREEP + SPEED_DENSITY / STOPS_PER_SMOOTH_ROAD
    return _density(speed, standing) * (1.0 + quiet / CREEP_TIME) / in_motion


@njit(_nrt=False)
def _density(deviation, variance):
    """Density of a normal distribution."""
    return math.exp(-0.5 * deviation * deviation / variance) / math.sqrt(2.0 * math.pi * variance)


@njit(_nrt=False, forceinline=True)
def is_still(mem, sample, dt, speed, sigma, without_fixes):
    """1 if the vehicle is as quiet as at rest at the sample at `sample`, dt s after the previous one, else 0. Updates
    `Still`.

    speed: certain speed (`certain_speed`), m/s. sigma: of the velocity, m/s. without_fixes: whether there have been no
    fixes for some seconds.
    """
    low, slow, square = min(1.0, dt / LOW_PASS), min(1.0, dt / REMOVED_MEAN_TIME), 0.0
    first, time = mem[Still.MOTION] == 0.0, mem[sample + Sample.TIME]
    anew = first or time - mem[Still.TIME] > LONGEST_UNSEEN
    mem[Still.TIME] = time
    for i in range(3):
        f = mem[sample + Sample.F_X + i]
        if anew:
            mem[Still.FIRST + i] = mem[Still.SECOND + i] = mem[Still.MEAN + i] = f
        mem[Still.FIRST + i] += low * (f - mem[Still.FIRST + i])
        mem[Still.SECOND + i] += low * (mem[Still.FIRST + i] - mem[Still.SECOND + i])
        deviation = mem[Still.SECOND + i] - mem[Still.MEAN + i]
        mem[Still.MEAN + i] += slow * deviation
        square += deviation * deviation
    if first:
        mem[Still.MOTION], mem[Still.REST] = math.log(EXPECTED_MOTION), math.log(EXPECTED_REST)
    if anew:
        for i in range(PARTS + 1):
            mem[Still.SQUARES + i] = mem[Still.DURATIONS + i] = 0.0
        if not first:  # its interval, the gap, would fill the window with this one sample
            return 0.0
    mean, seen = _mean_square(mem, square, dt)
    if seen < STILL_WINDOW:
        return 0.0
    level, separation = 0.5 * math.log(max(mean, 1e-12)), math.log(SEPARATION)
    motion, rest = mem[Still.MOTION], mem[Still.REST]
    surely = speed - (SURE_SIGMAS - CERTAIN_SIGMAS) * sigma
    if surely > MOVING_SPEED or mem[Still.CREPT] < 0.0:
        mem[Still.CREPT] = -1.0
    else:
        mem[Still.CREPT] = mem[Still.CREPT] + dt if speed > SLOWEST_SPEED else 0.0
    if surely > LEARNING_SPEED or mem[Still.CREPT] > CREEPING_TIME:
        # minimum: falls quickly, but not by a single sample, and rises slowly
        motion = min(motion + dt / MOTION_MEMORY, max(level, motion - 2.0 * dt))
    elif level < motion - separation:
        rest += min(1.0, dt / REST_TIME) * (level - rest)
    mem[Still.MOTION], mem[Still.REST] = motion, rest
    threshold = min(max(0.5 * (motion + rest), rest + separation), motion - separation)
    # with fixes the estimated speed is right, and so high a speed is that of a smooth road
    return 1.0 if level < threshold and (speed <= MOVING_SPEED or without_fixes) else 0.0


@njit(_nrt=False)
def _mean_square(mem, square, dt):
    """Mean of `square` over the window, of which this value covers the last dt s, and the time covered so far, s."""
    part = int(mem[Still.PART])
    if mem[Still.DURATIONS + part] >= STILL_WINDOW / PARTS:
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
