"""Gyroscopes whose error has jumped: found at a standstill, where a vehicle does not turn.

A gyroscope that certainly turns at a standstill has another error than before. It is less certain by as much, and so is
the heading, by what the error may have turned it since the gyroscopes last showed what is expected of them. The
standstill then tells the new error to a hundredth of a degree per second. What has come by a jump may go by one,
though, and while the vehicle drives nothing tells that as well: how long an error lasts is known only by how long it
has lasted, so that it goes within a second with a probability of about one over that time (a duration of which the
order of magnitude is not known; J. R. Gott, "Implications of the Copernican principle", Nature 363, 1993).
"""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ..memory import NAV, ROW, Event, Head, Nav, Sample, channel_of, yaw_state
from ..update import product, project
from .white_noise import density

#: of a state
Gyroscopes = ROW.place(
    'Gyroscopes',
    AGREED=1,  # s: time of the latest standstill at which they showed what is expected of them
    JUMPED=1,  # s: time of the latest one at which they did not; 0: none within LONGEST_ERROR
    BEFORE=3)  # rad/s: estimated errors before that, w_x, w_y, w_z

#: sigmas: a gyroscope that is further off at a standstill has a new error
JUMP_SIGMAS = 10.0
#: s that a vehicle may have stood before the accelerometers have called it a standstill: for as long a gyroscope that
#: is off may have turned the heading
LONGEST_UNSEEN = 5.0
#: s: an error that has just come is expected to last for this at least, as a fault of an IMU does that is noticed
SHORTEST_ERROR = 10.0
#: s: an error that has lasted for this is the sensor's own from now on, as after a start with other biases
LONGEST_ERROR = 60.0


@njit(_nrt=False)
def allow_for_jump(mem, r, at, n, dimensions, sample):
    """Gyroscopes that certainly turn at the standstill of the event at `at` less certain by as much, and the heading
    with them; rows of H stand behind P in the scratch. sample: position of the IMU sample."""
    h, p, yaw = int(mem[Head.SCRATCH_AT]) + n * n, int(mem[Head.SCRATCH_AT]), yaw_state(mem)
    unseen, white = min(mem[r + Nav.TIME] - mem[r + Gyroscopes.AGREED], LONGEST_UNSEEN), _white(mem, sample)
    fit = agrees = True
    for k in range(dimensions):
        squared = (mem[at + Event.Z_N + k] - product(mem, n, h + n * k, r + NAV)) ** 2
        variance = project(mem, n, h + n * k, h + 3 * n)
        # a jump counts for a moment as scatter, too: by the noise between samples it does not agree from the first on
        agrees = agrees and squared < JUMP_SIGMAS**2 * (variance + white)
        if squared > JUMP_SIGMAS**2 * (variance + mem[at + (Event.R_NN, Event.R_EE, Event.R_DD)[k]]):
            fit = False
            for i in range(n):
                if mem[h + n * k + i] != 0.0:
                    mem[p + (n + 1) * i] += squared
            mem[p + (n + 1) * yaw] += squared * unseen * unseen
    if agrees:
        mem[r + Gyroscopes.AGREED] = mem[r + Nav.TIME]
    if fit:
        return
    for i in range(3):
        state = channel_of(mem, 3 + i)
        if state >= 0 and mem[r + Gyroscopes.JUMPED] == 0.0:  # a second jump is likely the first one's end
            mem[r + Gyroscopes.BEFORE + i] = mem[r + NAV + state]
    mem[r + Gyroscopes.JUMPED] = mem[r + Nav.TIME]


@njit(_nrt=False)
def _white(mem, sample):
    """Variance of one sample's white noise, (rad/s)^2, of the noisiest gyroscope."""
    largest = 0.0
    for axis in range(3, 6):
        largest = max(largest, density(mem, sample, axis))
    return largest / mem[sample + Sample.INTERVAL]


@njit(_nrt=False)
def allow_for_end(mem, r, n, since):
    """P in the scratch less certain by what errors that have come by a jump may have gone back in the last `since` s.
    """
    if mem[r + Gyroscopes.JUMPED] == 0.0:
        return
    p, lasted = int(mem[Head.SCRATCH_AT]), mem[r + Nav.TIME] - mem[r + Gyroscopes.JUMPED]
    if lasted > LONGEST_ERROR:
        mem[r + Gyroscopes.JUMPED] = 0.0
        return
    for i in range(3):
        state = channel_of(mem, 3 + i)
        if state >= 0:
            jump = mem[r + NAV + state] - mem[r + Gyroscopes.BEFORE + i]
            mem[p + (n + 1) * state] += jump * jump * since / (SHORTEST_ERROR + lasted)
