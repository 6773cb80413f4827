"""Jumps of the gyroscopes' errors, detected at a standstill, where a vehicle does not turn.

If a gyroscope shows a significant rate at a standstill, its error has changed. The variance of its error is increased
by the square of the change, and that of the heading by the turn that it may have caused since the gyroscopes last
agreed with a standstill. The standstill then determines the new error to a hundredth of a degree per second.

An error that came by a jump may also end by one, which is not observed as well while the vehicle drives. Its remaining
duration is unknown; of a duration whose order of magnitude is unknown, the probability to end within the next second is
about one over the time that it has lasted (J. R. Gott, "Implications of the Copernican principle", Nature 363, 1993).
The variance grows accordingly.
"""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from ..memory import NAV, ROW, Event, Head, Nav, Sample, channel_of, yaw_state
from ..update import product, project
from .imu_share import Share
from .white_noise import density

#: of a state
Gyroscopes = ROW.place(
    'Gyroscopes',
    AGREED=1,  # s, time of the latest standstill at which the rates agreed with their expected errors
    JUMPED=1,  # s, time of the latest standstill at which they did not; 0: none within LONGEST_ERROR
    BEFORE=3)  # rad/s, estimated errors before that, w_x, w_y, w_z

#: standard deviations of a rate at a standstill above which the gyroscope has a new error. Chosen, not measured
JUMP_SIGMAS = 10.0
#: s, longest time between the begin of a standstill and its detection, during which a wrong gyroscope may have turned
#: the heading
LONGEST_UNSEEN = 5.0
#: s, expected duration of a new error: faults of an IMU that are noticed last for this at least. Chosen; a quarter and
#: four times of it move little (docs/ablation.md)
SHORTEST_ERROR = 10.0
#: s after which an error counts as the sensor's own, as after a start with other biases. Chosen; a quarter and four
#: times of it move little (docs/ablation.md)
LONGEST_ERROR = 60.0


@njit(_nrt=False)
def allow_for_jump(mem, r, at, n, dimensions, sample):
    """Increase the variances of gyroscopes with a significant rate at the standstill of the event at `at`, and that of
    the heading. Rows of H follow P in the scratch. sample: position of the IMU sample."""
    h, p, yaw = int(mem[Head.SCRATCH_AT]) + n * n, int(mem[Head.SCRATCH_AT]), yaw_state(mem)
    unseen, white = min(mem[r + Nav.TIME] - mem[r + Gyroscopes.AGREED], LONGEST_UNSEEN), _white(mem, sample)
    fit = agrees = True
    for k in range(dimensions):
        squared = (mem[at + Event.Z_N + k] - product(mem, n, h + n * k, r + NAV)) ** 2
        variance = project(mem, n, h + n * k, h + 3 * n)
        # just after a jump the scatter of the samples, part of R, is large: the white noise alone shows it at once
        agrees = agrees and squared < JUMP_SIGMAS**2 * (variance + white)
        if squared > JUMP_SIGMAS**2 * (variance + mem[at + (Event.R_NN, Event.R_EE, Event.R_DD)[k]]):
            fit = False
            for i in range(n):
                if mem[h + n * k + i] != 0.0 and i != mem[Share.STATE]:
                    mem[p + (n + 1) * i] += squared
            mem[p + (n + 1) * yaw] += squared * unseen * unseen
    if agrees:
        mem[r + Gyroscopes.AGREED] = mem[r + Nav.TIME]
    if fit:
        return
    for i in range(3):
        state = channel_of(mem, 3 + i)
        if state >= 0 and mem[r + Gyroscopes.JUMPED] == 0.0:  # a second jump is probably the end of the first error
            mem[r + Gyroscopes.BEFORE + i] = mem[r + NAV + state]
    mem[r + Gyroscopes.JUMPED] = mem[r + Nav.TIME]


@njit(_nrt=False)
def _white(mem, sample):
    """Variance of the white noise of one sample of the noisiest gyroscope, (rad/s)^2."""
    largest = 0.0
    for axis in range(3, 6):
        largest = max(largest, density(mem, sample, axis))
    return largest / mem[sample + Sample.INTERVAL]


@njit(_nrt=False)
def allow_for_end(mem, r, n, since):
    """Increase the variances in P of the scratch, as errors that came by a jump may have ended in the last `since` s.
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
