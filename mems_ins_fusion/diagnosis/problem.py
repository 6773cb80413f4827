"""A recording and its parameters as an estimation problem: unknowns (noise levels, effects) and the innovations of the
filter as residuals.

For each value of the unknowns the filter runs again. It is not quite the user's filter: one that weights down or
refuses fixes that do not fit, or raises their variance, hides what is to be found (`without_adaptation`).
"""
from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ..configuration.vehicle import standstills_show
from ..errors import InputError
from ..evaluation.comparison import aiding_of, fixes_apart, samples_to_keep
from ..filter.config import FilterConfig
from ..filter.measurements.position import is_without_altitude
from ..filter.measurements.registry import aiding
from ..filter.memory import PLANAR, Event, Kind, Verdict
from ..filter.runs.replay import Constrained, run, run_with_constraints
from ..filter.runs.results import Run
from ..filter.start.start import Start, transferred
from ..samples import Fixes, ImuSamples, Recording
from ..threads import threads
from .clock import FIX_BLOCK, GNSS, IMU
from .residuals import Residual, lasting

SETTLING = 20.0  # s after the start without residuals: these innovations show the alignment
UPDATE_INTERVAL = 1.0  # s between the fixes used; those in between are withheld and serve as the truth
#: Hz, highest rate of the averaged IMU samples in the many runs of a diagnosis; errors are measured at the full rate
FASTEST_RATE = 12.5
SLOWEST_RATE = 5.0  # Hz, lowest rate of the averaged samples, in a long recording
MANY_SAMPLES = 20_000  # number of averaged samples of a recording, within these rates: with more a run is too slow
#: number of samples in which the time of the start is found to the sample; later it is found to a tenth of a second
_ALIGNING = 100_000
#: m, standard deviation that is added to each fix: a diagnosis looks for errors of metres, and no model of a car is
#: exact to a centimetre
FLOOR = 0.1
#: largest share of the fixes that can be outliers: if the filter refuses more, the filter is wrong
MOST_OUTLIERS = 0.2
#: smallest share of the fixes that the filter uses after its own start, which it has to use after another one, too
SEEN_TOO = 0.9
#: names of the residuals besides the horizontal position of a fix: its height, and those of the constraints
BESIDE = ('height', 'sideways', 'upwards', 'north at rest', 'east at rest', 'down at rest')
FEWEST_SAID = 3  # smallest number of constraints since the last fix of which a mean is taken
LONG_BLOCK = 60.0  # s, length of the longer blocks that are also used: errors of a receiver can last for minutes
FEWEST_BLOCKS = 10  # smallest number of long blocks in a recording: fewer do not show their scatter


class DiagnosisError(InputError):
    """A recording cannot be diagnosed. The text is one line: why, and what recording is needed."""


@dataclass(frozen=True)
class Unknown:
    """A scalar that can be estimated: a noise level, or a parameter of an effect.

    apply(values, recording, x) returns the parameters and the recording with the unknown at x. base: its configured
    value. step: a difference over which the innovations change linearly. prior: standard deviation of plausible values;
    usual: a common size. one_sided: derivatives by forward differences only, at a bound or where they are accurate
    enough. variance: x is the square of the parameter that the name says. factor_on: x is the logarithm of a factor on
    this number; None otherwise.
    """

    name: str
    apply: Callable
    base: float
    step: float
    prior: float
    usual: float = 1.0
    one_sided: bool = False
    variance: bool = False
    factor_on: float | None = None
    bounds: tuple[float, float] = (-np.inf, np.inf)
    noise: bool = False

    @property
    def effect(self) -> str:
        """Name of the effect that it is a parameter of: the first part of its name."""
        return self.name.split('.')[0]

    @property
    def parameter(self) -> str:
        """Name of that parameter: the second part of its name."""
        return self.name.split('.')[1]

    def near(self, x: float) -> tuple[float, float]:
        """Limits of an unknown that is about `x`: half and twice the size that it stands for; none if it has a sign."""
        if self.factor_on is not None:
            return x - np.log(2.0), x + np.log(2.0)
        return (0.25 * x, 4.0 * x) if self.variance and x > 0 else (-np.inf, np.inf)

    def meant(self, x: float, sigma: float) -> tuple[float, float]:
        """Value and sigma of the parameter that the name says, from those of x."""
        if self.factor_on is not None:
            value = self.factor_on * float(np.exp(x))
            return value, value * float(sigma)
        if not self.variance:
            return float(x), float(sigma)
        root = float(np.sqrt(max(x, 0.0)))
        return root, float(sigma / (2 * root)) if root > 0 else float(np.sqrt(sigma))


class Problem:
    """A recording and its parameters; all runs of the filter begin with the same start and differ by the unknowns only.

    given: the parameters as given; values: those of the filter without adaptation (`without_adaptation`). full: the
    recording with the fixes used; drive: the same with averaged samples; recording: as `drive`, with the covariances
    that the filter uses written into the fixes, and without those that the filter with the given parameters refuses.
    stamp (f,): ns, of the fixes; mask (f,): the fixes with a residual. began: ns, time of the first estimate with the
    given parameters, by the clock of the fixes. counted (f, b): the residuals besides the fixes that count, those of
    the filter as given. reference_clock: clock of the truth (`clock.reference_clock_of`). others: further
    parameters from which a search may start (`starts.other_starts`).
    """

    def __init__(self, recording: Recording, values: dict, interval: float = UPDATE_INTERVAL,
                 others: Sequence[dict] = ()):
        self.reference_clock, self.others = GNSS if recording.reference is None else IMU, tuple(others)
        self.given = values
        self.values = without_adaptation(values, recording)
        given = FilterConfig.from_parameters({**values, **exact_offsets(values)})
        keep = samples_to_keep(recording.imu, recording.imu.stamp[:_ALIGNING])
        first = run(given, recording.imu, recording.gnss, aiding_of(recording), keep=keep)
        if not len(first.stamp):
            reason = first.notices[-1].text if first.notices else 'no fixes'
            raise DiagnosisError(f'{recording.name}: {reason}')
        # in the clock of the fixes, as in a replay, so that both thin out the same ones and have the same outages
        self.began = int(first.stamp[0]) + round(values['gnss.time_offset'] * 1e9)
        self.used = fixes_apart(recording.gnss, interval, self.began)
        self.full = replace(recording, gnss=recording.gnss.select(self.used))
        seconds = max((recording.imu.stamp[-1] - recording.imu.stamp[0]) * 1e-9, 1.0)
        rate = float(np.clip(MANY_SAMPLES / seconds, SLOWEST_RATE, FASTEST_RATE))
        self.drive = replace(self.full, imu=averaged(recording.imu, rate))
        self.stamp = self.drive.gnss.stamp
        watched = run(given, self.drive.imu, self.drive.gnss, aiding_of(recording),
                      keep=np.zeros(len(self.drive.imu), dtype=bool))
        self.before = self.innovations(watched)
        self.claimed = stated_covariances(self.drive.gnss, self.given)
        self.outlying = _refused(watched, len(self.stamp))
        for other in others:  # a fix that one start explains is no outlier
            self.outlying &= _refused(run(
                FilterConfig.from_parameters({**other, **exact_offsets(other)}), self.drive.imu, self.drive.gnss,
                aiding_of(recording), keep=np.zeros(len(self.drive.imu), dtype=bool)), len(self.stamp))
        self.recording = replace(self.drive, gnss=with_covariances(self.drive.gnss, self.claimed, 0.0, self.outlying))
        self.config = FilterConfig.from_parameters(self.values)
        self.start = self._start([self.values, *(without_adaptation(other, recording) for other in others)])
        if self.start is None:
            raise DiagnosisError(f'{recording.name}: the filter starts only with fixes that it does not believe later')
        self._attitude = cache(self._strapdown_attitude)
        self.runs: list[int] = []  # IMU samples of each run, of this problem and those made from it
        self.lasting, self.counted = np.ones(len(BESIDE)), np.ones((len(self.stamp), len(BESIDE)), dtype=bool)
        self.base = self.residual(self.values, self.recording)
        settled = self.stamp > self.began + round(SETTLING * 1e9)
        self.mask = settled & np.isfinite(self.base.z[:, 0])
        self.lasting = lasting(self.base.beside, self.mask)
        self.base.beside[:, 1] *= self.lasting
        self.counted = np.isfinite(self.base.beside[:, 1])
        self.base = self.base.counting(self.counted)

    def _start(self, tried: Sequence[dict]) -> Start | None:
        """The start of all runs: the one whose filter, of those with the parameters `tried`, explains the fixes best.

        A start found with a wrong time offset can have a wrong heading (a vehicle at walking speed 30 deg), and with it
        no time offset explains the fixes. None if the first filter does not start.
        """
        found = [run(FilterConfig.from_parameters(values), self.recording.imu, self.recording.gnss,
                     aiding_of(self.recording), keep=np.zeros(len(self.recording.imu), dtype=bool)) for values in tried]
        likelihoods = [self.innovations(one).log_likelihood() for one in found]
        seen = np.isfinite(likelihoods[0])
        best, most = found[0], 0.0
        for one, likelihood in zip(found, likelihoods):
            both = seen & np.isfinite(likelihood)
            gain = float((likelihood - likelihoods[0])[both].sum())
            if gain > most and both.sum() >= SEEN_TOO * seen.sum():
                best, most = one, gain
        return None if best.start is None else transferred(best.start, best.config, self.config)

    def without(self, outlying: np.ndarray) -> Problem:
        """The same problem with the fixes `outlying` (f,) left out, too."""
        other = copy.copy(self)
        other.outlying = self.outlying | outlying
        fixes = with_covariances(self.drive.gnss, self.claimed, 0.0, other.outlying)
        other.recording = replace(self.recording, gnss=fixes)
        other.base = other.residual(other.values, other.recording)
        other.mask = self.mask & np.isfinite(other.base.z[:, 0])
        return other

    def configured(self, recording: Recording, values: dict) -> Problem:
        """The same drive, `recording`, with other parameters given; the work it makes counts with that of this."""
        others = [{**values, 'gnss.time_offset': start['gnss.time_offset']} for start in self.others]
        other = Problem(recording, values, others=others)
        other.runs = self.runs
        return other

    def observed(self, values: dict) -> Residual:
        """The innovations of the filter with these parameters, with all its adaptation but exact time offsets."""
        config = FilterConfig.from_parameters({**values, **exact_offsets(values)})
        return self.innovations(run(config, self.drive.imu, self.drive.gnss, aiding_of(self.drive),
                                     keep=np.zeros(len(self.drive.imu), dtype=bool)))

    def filtered(self, values: dict, recording: Recording, keep: np.ndarray | None = None, through: Callable = run):
        """A run with other parameters or another recording, from the same start: what `through` returns for it.

        keep: the samples whose states are kept, (n,) bool; all where None. through: `run`, or `run_with_constraints`.
        """
        config = FilterConfig.from_parameters(values)
        self.runs.append(len(recording.imu))
        return through(config, recording.imu, recording.gnss, aiding_of(recording),
                       transferred(self.start, self.config, config), keep)

    def residual(self, values: dict, recording: Recording) -> Residual:
        """The innovations with other parameters or another recording (of the same fixes)."""
        found, said = self.filtered(values, recording, np.zeros(len(recording.imu), dtype=bool), run_with_constraints)
        return replace(self.innovations(found), beside=self.beside(found, said)).counting(self.counted)

    def beside(self, of: Run, said: Constrained) -> np.ndarray:
        """Residuals of heights and constraints and their variances, (f, 2, b): means over the time since the last fix.

        If they are correlated over longer times they say less than their number suggests, so the variances are
        multiplied by `self.lasting` (b,).
        """
        innovations, n = of.innovations, len(self.stamp)
        found = np.full((n, 2, len(BESIDE)), np.nan)
        if len(innovations.index) and of.config.mechanization != PLANAR:
            found[innovations.index, 0, 0], found[innovations.index, 1, 0] = innovations.z_down, innovations.s_down
        # the fix that comes next; a run may differ from others by which constraint it applied when
        slot = np.searchsorted(self.stamp, self.recording.imu.stamp[said.index])
        for kind, first, count in ((Kind.NON_HOLONOMIC, 1, 2), (Kind.ZERO_VELOCITY, 3, 3)):
            mine = (said.kind == kind) & (slot < n)
            times = np.bincount(slot[mine], minlength=n)
            for k in range(count):
                z = np.bincount(slot[mine], said.z[mine, k], n)
                s = np.bincount(slot[mine], said.s[mine, k], n)
                with np.errstate(invalid='ignore', divide='ignore'):
                    found[:, :, first + k] = np.where(times >= FEWEST_SAID, [z / times, s / times], np.nan).T
        found[:, 1][found[:, 1] <= 0] = np.nan
        found[:, 1] *= self.lasting
        return found

    def innovations(self, of: Run) -> Residual:
        """The innovations of a run that was given these fixes."""
        innovations, n = of.innovations, len(self.stamp)
        z, s, yaw, velocity = np.full((n, 2), np.nan), np.full((n, 3), np.nan), np.zeros(n), np.zeros((n, 2))
        z[innovations.index], s[innovations.index] = innovations.z, innovations.s
        yaw[innovations.index], velocity[innovations.index] = innovations.yaw, innovations.velocity
        return Residual(z, s, yaw, velocity)

    @property
    def each(self) -> tuple[Problem, ...]:
        """The problem of each drive: of one drive itself (see `drives.Drives`)."""
        return (self,)

    def of(self, recording: Recording) -> Problem:
        """The problem of the drive that `recording` was made from."""
        return self

    def attitude(self, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
        """Roll and pitch, rad, at each IMU sample of `recording`, which was made from this drive."""
        return self._attitude()[:2]

    @property
    def diluted(self) -> float:
        """Relative bias of a regression on that attitude (attenuation, C. Spearman, 1904): the variance of its errors,
        by the filter's sigmas, over the variance of roll and pitch."""
        return self._attitude()[2]

    def _strapdown_attitude(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Roll and pitch, rad, at each IMU sample from a strapdown run with the other parameters as configured, 0
        before its start; and `diluted`."""
        imu, config = self.recording.imu, FilterConfig.from_parameters({**self.values, 'mechanization': 'strapdown'})
        result = run(config, imu, self.recording.gnss, aiding_of(self.recording))
        roll, pitch = np.zeros((2, len(imu)))
        roll[result.index], pitch[result.index] = result.roll, result.pitch
        first = result.config.layout.index('phi_n')
        signal = result.roll.var() + result.pitch.var()
        error = float((result.sigma[:, first:first + 2] ** 2).sum(axis=1).mean())
        return roll, pitch, min(error / signal, 1.0) if signal > 0 else 1.0

    def assume(self, unknowns: Sequence[Unknown], x) -> tuple[dict, Recording]:
        """Parameters and recording with `unknowns` at `x`."""
        values, recording = self.values, self.recording
        for unknown, value in zip(unknowns, x):
            values, recording = unknown.apply(values, recording, float(value))
        return values, recording

    def moved(self, unknowns: Sequence[Unknown], x) -> Problem:
        """The same problem with `unknowns` at `x` in its parameters and its recording."""
        other = copy.copy(self)
        other.values, other.recording = self.assume(unknowns, x)
        return other

    def corrected(self, unknowns: Sequence[Unknown], x) -> dict:
        """The parameters as given with the effects among `unknowns` at `x`; noise levels are not an effect."""
        values = self.given
        for unknown, value in zip(unknowns, x):
            if not unknown.noise:
                values, _ = unknown.apply(values, self.recording, float(value))
        return values

    def residuals(self, unknowns: Sequence[Unknown], points) -> list[Residual]:
        """The innovations at several `points`, on all cores."""
        def one(x):
            return self.residual(*self.assume(unknowns, x))

        return on_all_cores(one, points)


def without_adaptation(values: dict, recording: Recording) -> dict:
    """`values` for a filter whose innovations show what its model lacks: it uses each fix with its stated covariance,
    and nothing adapts. Standstills are off if `recording` does not distinguish them from motion, as each false one is a
    step in the innovations."""
    shown = standstills_show(recording.imu, recording.gnss) if values['vehicle.zero_velocity'] else None
    return {**values, 'gnss.sigma': 0.0, 'gnss.adapt_sigma': False, 'gnss.gate_probability': 1.0,
            'gnss.robust_sigma': 0.0, 'vehicle.learn_drift': False, **exact_offsets(values),
            'imu.adapt_noise': False, 'vehicle.zero_velocity': values['vehicle.zero_velocity'] and (
                shown is None or shown[0])}


def exact_offsets(values: dict) -> dict:
    """The parameters that make all time offsets exact: a filter that estimates these itself hides wrong ones."""
    return {'gnss.time_offset_sigma': 0.0, **exact_inputs(values)}


def exact_inputs(values: dict) -> dict:
    """The same for the time offsets of all inputs but the fixes."""
    return {f'{one.name}.time_offset_sigma': 0.0 for one in aiding(values)}


def averaged(imu: ImuSamples, rate: float) -> ImuSamples:
    """Samples averaged to no more than about `rate` Hz, for speed: each stands for its interval, so do their means.

    No mean reaches over a gap. In a bend at 0.3 rad/s the axes turn by 3 degrees within 0.2 s, which makes the mean
    specific force smaller by 1e-4.
    """
    step = np.diff(imu.stamp)
    count = int(round(1e9 / rate / max(np.median(step), 1))) if len(step) else 1
    if count < 2:
        return imu
    breaks = np.flatnonzero((step <= 0) | (step > 3 * np.median(step))) + 1
    edges = np.concatenate([[0], breaks, [len(imu)]])
    starts = np.concatenate([np.arange(a, b, count) for a, b in zip(edges[:-1], edges[1:])])
    length = np.diff(np.append(starts, len(imu)))
    last = starts + length - 1
    return replace(imu.select(last), specific_force=np.add.reduceat(imu.specific_force, starts) / length[:, None],
                   angular_rate=np.add.reduceat(imu.angular_rate, starts) / length[:, None])


def stated_covariances(fixes: Fixes, values: dict) -> np.ndarray:
    """Covariances (f, 3, 3) m^2, east-north-up, that a filter with `values` assigns to `fixes`."""
    config = FilterConfig.from_parameters(values)
    event, _, _ = config.inputs[Kind.POSITION].events(config.gnss, fixes)
    covariance = np.zeros((len(fixes), 3, 3))
    for (i, j), column in (((0, 0), Event.R_EE), ((0, 1), Event.R_NE), ((1, 0), Event.R_NE), ((1, 1), Event.R_NN),
                           ((2, 2), Event.R_DD)):
        covariance[:, i, j] = event[:, column]
    return covariance


def with_covariances(fixes: Fixes, claimed: np.ndarray, x: float, outlying: np.ndarray) -> Fixes:
    """`fixes` with the covariances `claimed` times exp(2 x), plus FLOOR^2; those `outlying` (f,) are marked invalid."""
    covariance = np.exp(2 * x) * claimed + FLOOR**2 * np.eye(3)
    without = is_without_altitude(claimed[:, 2, 2])
    covariance[without, 2, 2] = claimed[without, 2, 2]
    return replace(fixes, covariance=covariance, covariance_type=np.full(len(fixes), 3, dtype=np.uint8),
                   status=np.where(outlying, np.int8(-1), fixes.status))


def _refused(of: Run, count: int) -> np.ndarray:
    """(f,) bool: whether the filter refused a fix, of `count`; none if it refused more than MOST_OUTLIERS."""
    refused = np.zeros(count, dtype=bool)
    mine = (of.measured.kind == Kind.POSITION) & (of.measured.event[:, Event.VERDICT] == Verdict.REFUSED)
    refused[of.measured.index[mine]] = True
    return refused if refused.mean() < MOST_OUTLIERS else np.zeros(count, dtype=bool)


def on_all_cores(work: Callable, items: Iterable, between: Callable[[], None] = lambda: None) -> list:
    """`work` of each of `items`, in threads: a filter runs without the interpreter's lock. between: called after each
    item if there is only one thread, where nothing else could run meanwhile."""
    if threads() > 1:
        with ThreadPoolExecutor(threads()) as pool:
            return list(pool.map(work, items))
    found = []
    for item in items:
        found.append(work(item))
        between()
    return found


def block_begins(problem: Problem, length: float = FIX_BLOCK) -> np.ndarray:
    """Indices, among the fixes of the mask, at which blocks of `length` s begin."""
    block = (problem.stamp[problem.mask] - problem.stamp[0]) // round(length * 1e9)
    return np.unique(block, return_index=True)[1]


def blocks(problem: Problem) -> list[np.ndarray]:
    """`block_begins` for FIX_BLOCK, and for LONG_BLOCK if the recording is long enough."""
    long = block_begins(problem, LONG_BLOCK)
    return [block_begins(problem), *([long] if len(long) >= FEWEST_BLOCKS else [])]
