"""Innovations as a function of what is assumed, and the likelihood of that: the ground on which a diagnosis stands.

Whatever is assumed - noise levels, effects - the filter is run again and its innovations z_k with covariances S_k are
the residual; log L = -1/2 sum(log det S_k + rho(z_k^T S_k^-1 z_k)). Derivatives are differences between runs; with
them the score and the Fisher information follow (F. C. Schweppe, "Evaluation of likelihood functions for Gaussian
signals", 1965; R. K. Mehra, "On the identification of variances and adaptive Kalman filtering", 1970). rho is the
identity up to TAIL^2 and grows with the logarithm beyond: a fix that is far off counts as one that is off.

The filter that is looked through is not quite the one of the user: what adapts to a misfit - fixes weighted down,
refused, or believed less the worse they fit - hides that misfit (`looked_through`).
"""
from __future__ import annotations

import copy
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ..evaluation.comparison import aiding_of, samples_to_keep, thin
from ..filter.config import SENSORS, FilterConfig
from ..filter.layout import PLANAR, Event, Kind, Verdict
from ..filter.replay import Constrained, run, run_with_constraints
from ..filter.results import Run
from ..filter.start import transferred
from ..samples import Fixes, ImuSamples, Recording
from .clock import GNSS, IMU

#: innovations of the first seconds after the start belong to the alignment
SETTLING = 20.0
#: s between the fixes used; what comes more often is withheld and serves as the truth
UPDATE_INTERVAL = 1.0
#: the many runs of a diagnosis take IMU samples at no more than this rate, Hz, in a long recording at a lower one, but
#: not below the other; errors are measured at the full rate
FASTEST_RATE, SLOWEST_RATE, MANY_SAMPLES = 12.5, 5.0, 20_000
#: samples among which the start is looked for to the sample, later only to a tenth of a second
_ALIGNING = 100_000
#: innovations beyond this many sigma count by their logarithm
TAIL = 3.0
#: what is added to each fix, m: a diagnosis looks for metres, and no model of a car is right to a centimetre
FLOOR = 0.1
#: a fit ends when a step gains less than this in log likelihood
ENOUGH_GAIN = 0.2
#: a model must let the filter see this part of the fixes
FEWEST_SEEN = 0.98
#: more outliers than this part of the fixes are none
MOST_OUTLIERS = 0.2
#: what is measured beside the position of a fix: its height, and what the constraints say
BESIDE = ('height', 'sideways', 'upwards', 'north at rest', 'east at rest', 'down at rest')
#: constraints since the last fix that make a mean; innovations that tell how long they last, and up to how many fixes
FEWEST_SAID, FEWEST_LASTING, LASTING = 3, 50, 30
#: length of a block over which scores may go together, s; longer ones count where there are so many
BLOCK, LONG_BLOCK, FEWEST_BLOCKS = 20.0, 60.0, 10
#: a standard deviation counts what goes together over such a part of a drive, too
LONGEST_PART = 8


class DiagnosisError(ValueError):
    """A recording that cannot be diagnosed: one line that says why, and what recording it takes."""


@dataclass(frozen=True)
class Residual:
    """Innovations of one run, by the fixes used (f,): z (f, 2) north-east m, s (f, 3) covariance nn, ne, ee, m^2; NaN
    where a fix was not applied. yaw (f,) rad and velocity (f, 2) m/s of the prediction.

    beside (f, 2, b): innovation and variance of what else was measured since the fix before, each a number of its own;
    NaN where there was nothing."""

    z: np.ndarray
    s: np.ndarray
    yaw: np.ndarray
    velocity: np.ndarray
    beside: np.ndarray | None = None

    def __post_init__(self):
        if self.beside is None:
            object.__setattr__(self, 'beside', np.empty((len(self.z), 2, 0)))

    def log_likelihood(self) -> np.ndarray:
        """The likelihood of each innovation, (f,), without the constant."""
        determinant = self.s[:, 0] * self.s[:, 2] - self.s[:, 1] ** 2
        of_fixes = -0.5 * (np.log(determinant) + tempered(self.nis()))
        z, s = self.beside[:, 0], self.beside[:, 1]
        return of_fixes - 0.5 * np.nan_to_num(np.log(s) + tempered(z**2 / s)).sum(axis=1)

    @property
    def of_fixes(self) -> Residual:
        """The innovations of the positions alone."""
        return replace(self, beside=None)

    def nis(self) -> np.ndarray:
        """Normalized innovation squared, (f,)."""
        return (self.whitened() ** 2).sum(axis=1)

    def factors(self):
        """Cholesky factors of the covariances: l_nn, l_en, l_ee, (f,) each."""
        l_nn = np.sqrt(self.s[:, 0])
        l_en = self.s[:, 1] / l_nn
        return l_nn, l_en, np.sqrt(self.s[:, 2] - l_en**2)

    def whitened(self) -> np.ndarray:
        """S^(-1/2) z, (f, 2): independent and of unit variance where the model is right."""
        return _whiten(self.factors(), self.z)

    def along_across(self) -> np.ndarray:
        """Whitened innovations along and across the track, (f, 2)."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        turned = np.stack([c * self.z[:, 0] + s * self.z[:, 1], c * self.z[:, 1] - s * self.z[:, 0]], axis=1)
        nn, ne, ee = self.s.T
        rotated = np.stack([c * c * nn + 2 * c * s * ne + s * s * ee, (c * c - s * s) * ne + c * s * (ee - nn),
                            s * s * nn - 2 * c * s * ne + c * c * ee], axis=1)
        return replace(self, z=turned, s=rotated).whitened()


def tempered(nis: np.ndarray, tail: float = TAIL) -> np.ndarray:
    """rho: `nis` up to tail^2, growing with its logarithm beyond."""
    return np.where(nis > tail**2, tail**2 * (1 + np.log(np.maximum(nis, 1e-12) / tail**2)), nis)


def lasting(beside: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """By how much the mean of many innovations scatters more than a single one of them divided by their number: the
    variance of the long run over that of one, (b,), by autocorrelations up to LASTING fixes, as long as they are
    positive (M. S. Bartlett, 1946). 1 where there is too little to tell."""
    found = np.ones(beside.shape[2])
    for k in range(len(found)):
        z, s = beside[mask, :, k].T
        u = z / np.sqrt(s)
        there = np.isfinite(u)
        if there.sum() < FEWEST_LASTING:
            continue
        u = np.where(there, np.clip(u, -TAIL, TAIL), 0.0)
        power = (u**2).sum() / there.sum()
        for lag in range(1, LASTING):
            pairs = (there[lag:] & there[:-lag]).sum()
            rho = (u[lag:] * u[:-lag]).sum() / max(pairs, 1) / power
            if pairs < FEWEST_LASTING or rho < 0:
                break
            found[k] += 2 * rho
    return found


def _whiten(factors, z):
    l_nn, l_en, l_ee = factors
    first = z[:, 0] / l_nn
    return np.stack([first, (z[:, 1] - l_en * first) / l_ee], axis=1)


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


@dataclass(frozen=True)
class Unknown:
    """One number that is assumed and can be varied.

    apply(values, recording, x) gives the parameters and the recording with it at x; `base` is its value as configured
    and `step` a difference over which the innovations change linearly. prior: standard deviation of what is plausible;
    usual: a size that would surprise nobody. one_sided: forward differences only, at a bound or where they are good
    enough. variance: it stands for the square of what it is named after. factor_on: it is the logarithm of a factor on
    this, or None.
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
        """The effect whose parameter it is, the first part of its name."""
        return self.name.split('.')[0]

    @property
    def parameter(self) -> str:
        """The name of that parameter."""
        return self.name.split('.')[1]

    def near(self, x: float) -> tuple[float, float]:
        """Between which values it may be that is about `x`, where it stands for a size: half and twice that."""
        if self.factor_on is not None:
            return x - np.log(2.0), x + np.log(2.0)
        return (0.25 * x, 4.0 * x) if self.variance and x > 0 else (-np.inf, np.inf)

    def meant(self, x: float, sigma: float) -> tuple[float, float]:
        """Value and sigma of what it is named after."""
        if self.factor_on is not None:
            value = self.factor_on * float(np.exp(x))
            return value, value * float(sigma)
        if not self.variance:
            return float(x), float(sigma)
        root = float(np.sqrt(max(x, 0.0)))
        return root, float(sigma / (2 * root)) if root > 0 else float(np.sqrt(sigma))


def looked_through(values: dict) -> dict:
    """`values` for the filter that a diagnosis looks through: each fix believed as stated, nothing that adapts."""
    return {**values, 'gnss.sigma': 0.0, 'gnss.adapt_sigma': False, 'gnss.gate_probability': 1.0,
            'gnss.robust_sigma': 0.0, 'gnss.time_offset_sigma': 0.0, 'vehicle.learn_drift': False}


class Problem:
    """A recording and the parameters it is filtered with; runs of it that differ by what is assumed alone.

    given: the parameters as given; values: those of the filter that is looked through. full: the recording with the
    fixes used; drive: the same with averaged samples; recording: as `drive`, as that filter sees it - covariances
    spelled out, fixes that the filter as given refuses left out. stamp (f,) ns of the fixes; mask (f,): which count.
    reference_clock: the clock in which the truth runs (`clock.whose`).
    """

    def __init__(self, recording: Recording, values: dict, interval: float = UPDATE_INTERVAL):
        self.reference_clock = GNSS if recording.reference is None else IMU
        self.given = {**values, 'gnss.time_offset_sigma': 0.0}
        self.values = looked_through(values)
        given = FilterConfig.from_parameters(self.given)
        keep = samples_to_keep(recording.imu, recording.imu.stamp[:_ALIGNING])
        first = run(given, recording.imu, recording.gnss, aiding_of(recording), keep=keep)
        if first.start is None:
            reason = first.notices[-1].text if first.notices else 'no fixes'
            raise DiagnosisError(f'{recording.name}: {reason}')
        began = int(first.stamp[0])
        self.used = thin(recording.gnss, interval, began)
        self.full = replace(recording, gnss=recording.gnss.select(self.used))
        seconds = max((recording.imu.stamp[-1] - recording.imu.stamp[0]) * 1e-9, 1.0)
        rate = float(np.clip(MANY_SAMPLES / seconds, SLOWEST_RATE, FASTEST_RATE))
        self.drive = replace(self.full, imu=averaged(recording.imu, rate))
        self.stamp = self.drive.gnss.stamp
        watched = run(given, self.drive.imu, self.drive.gnss, aiding_of(recording),
                      keep=np.zeros(len(self.drive.imu), dtype=bool))
        self.before = self.innovations(watched)
        self.claimed = stated(self.drive.gnss, self.given)
        self.outlying = _refused(watched, len(self.stamp))
        self.recording = replace(self.drive, gnss=believed(self.drive.gnss, self.claimed, 0.0, self.outlying))
        self.config = FilterConfig.from_parameters(self.values)
        self.start = run(self.config, self.recording.imu, self.recording.gnss, aiding_of(recording),
                         keep=np.zeros(len(self.recording.imu), dtype=bool)).start
        if self.start is None:
            raise DiagnosisError(f'{recording.name}: the filter starts only with fixes that it does not believe later')
        self._attitude = cache(self._strapdown_attitude)
        self.runs: list[int] = []  # IMU samples of each run, of this problem and those made from it
        self.lasting = np.ones(len(BESIDE))
        self.base = self.residual(self.values, self.recording)
        settled = self.stamp > began + round(SETTLING * 1e9)
        self.mask = settled & np.isfinite(self.base.z[:, 0])
        self.lasting = lasting(self.base.beside, self.mask)
        self.base.beside[:, 1] *= self.lasting

    def without(self, outlying: np.ndarray) -> Problem:
        """The same problem with the fixes `outlying` (f,) left out, too."""
        other = copy.copy(self)
        other.outlying = self.outlying | outlying
        other.recording = replace(self.recording, gnss=believed(self.drive.gnss, self.claimed, 0.0, other.outlying))
        other.base = other.residual(other.values, other.recording)
        other.mask = self.mask & np.isfinite(other.base.z[:, 0])
        return other

    def observed(self, values: dict) -> Residual:
        """The innovations of the filter of a user with these parameters, whatever it makes of its fixes."""
        config = FilterConfig.from_parameters(values)
        return self.innovations(run(config, self.drive.imu, self.drive.gnss, aiding_of(self.drive),
                                     keep=np.zeros(len(self.drive.imu), dtype=bool)))

    def filtered(self, values: dict, recording: Recording, keep: np.ndarray | None = None, through: Callable = run):
        """A run under other parameters or with another recording, from the same start: what `through` makes of it.

        keep: the samples whose states are kept, (n,) bool; all where None. through: `run`, or `run_with_constraints`.
        """
        config = FilterConfig.from_parameters(values)
        self.runs.append(len(recording.imu))
        return through(config, recording.imu, recording.gnss, aiding_of(recording),
                       transferred(self.start, self.config, config), keep)

    def residual(self, values: dict, recording: Recording) -> Residual:
        """The innovations under other parameters or with another recording (of the same fixes)."""
        found, said = self.filtered(values, recording, np.zeros(len(recording.imu), dtype=bool), run_with_constraints)
        return replace(self.innovations(found), beside=self.beside(found, said))

    def beside(self, of: Run, said: Constrained) -> np.ndarray:
        """Heights and constraints of a run, (f, 2, b): means over the time since the fix before.

        What lasts longer than that is worth less than it seems: variances are multiplied by `self.lasting` (b,).
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
        """By what part a regression on that attitude may come out too small, as it is not exact: the variance of its
        errors, as far as it knows them, over that of roll and pitch (C. Spearman, 1904)."""
        return self._attitude()[2]

    def _strapdown_attitude(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Roll and pitch, rad, at each IMU sample by a strapdown run of what was configured; 0 before its start. And
        `diluted`."""
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
        """The same problem with `unknowns` at `x` as what is assumed."""
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


def on_all_cores(work: Callable, items: Iterable) -> list:
    """What `work` makes of each of `items`: a filter runs without the interpreter's lock."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(work, items))


def stated(fixes: Fixes, values: dict) -> np.ndarray:
    """Covariances (f, 3, 3) m^2, east-north-up, that the filter takes `fixes` to have."""
    covariance = np.array(fixes.covariance, dtype=float)
    diagonal = np.einsum('fii->fi', covariance)
    told = (fixes.covariance_type > 0) & np.isfinite(diagonal).all(axis=1) & (diagonal[:, :2] > 0).all(axis=1)
    covariance[~told] = values['gnss.default_sigma'] ** 2 * np.diag([1.0, 1.0, 4.0])
    covariance[diagonal[:, 2] <= 0, 2, 2] = 4 * diagonal[diagonal[:, 2] <= 0, :2].max(axis=1)
    if values['gnss.sigma'] > 0:
        covariance[:, :2, :2] = values['gnss.sigma'] ** 2 * np.eye(2)
        covariance[:, 2, 2] = np.maximum(covariance[:, 2, 2], values['gnss.sigma'] ** 2)
    covariance[:, :2, 2] = covariance[:, 2, :2] = 0.0
    return covariance


def believed(fixes: Fixes, claimed: np.ndarray, x: float, outlying: np.ndarray) -> Fixes:
    """`fixes` with exp(x) times the standard deviations `claimed`, and FLOOR; those `outlying` (f,) are none."""
    covariance = np.exp(2 * x) * claimed + FLOOR**2 * np.eye(3)
    return replace(fixes, covariance=covariance, covariance_type=np.full(len(fixes), 3, dtype=np.uint8),
                   status=np.where(outlying, np.int8(-1), fixes.status))


def _refused(of: Run, count: int) -> np.ndarray:
    """Which of `count` fixes the filter refused, (f,): where it refuses many, it is the one that is wrong."""
    refused = np.zeros(count, dtype=bool)
    mine = (of.measured.kind == Kind.POSITION) & (of.measured.record[:, Event.VERDICT] == Verdict.REFUSED)
    refused[of.measured.index[mine]] = True
    return refused if refused.mean() < MOST_OUTLIERS else np.zeros(count, dtype=bool)


def block_begins(problem: Problem, length: float = BLOCK) -> np.ndarray:
    """Where blocks of `length` seconds begin among the fixes that count."""
    block = (problem.stamp[problem.mask] - problem.stamp[0]) // round(length * 1e9)
    return np.unique(block, return_index=True)[1]


def blocks(problem: Problem) -> list[np.ndarray]:
    """The same for each length over which scores may go together: a receiver's errors last for minutes."""
    long = block_begins(problem, LONG_BLOCK)
    return [block_begins(problem), *([long] if len(long) >= FEWEST_BLOCKS else [])]


@dataclass(frozen=True)
class Scores:
    """Derivatives of the log likelihood by some unknowns, zero where a fix does not count.

    score (f, p): each fix's share of the gradient. sensitivity (f, p, 5): whitened derivatives of innovation and
    covariance, scaled so that their products are the Fisher information.
    """

    score: np.ndarray
    sensitivity: np.ndarray

    def gradient(self, mask: np.ndarray) -> np.ndarray:
        return self.score[mask].sum(axis=0)

    def information(self, mask: np.ndarray, other: Scores | None = None) -> np.ndarray:
        """Fisher information (p, p), or (p, q) with those of `other`."""
        other = other or self
        return np.einsum('fpi,fqi->pq', self.sensitivity[mask], other.sensitivity[mask])

    def joined(self, other: Scores) -> Scores:
        return Scores(np.concatenate([self.score, other.score], axis=1),
                      np.concatenate([self.sensitivity, other.sensitivity], axis=1))


def scores(problem: Problem, unknowns: Sequence[Unknown], x, at: Residual | None = None,
           quick: bool = False) -> tuple[Residual, Scores]:
    """Residual at `x` and the scores of `unknowns` there, by differences between runs of the filter.

    Central differences, or forward ones, as each unknown asks; quick: forward ones for all.
    """
    x = np.asarray(x, dtype=float)
    if quick:
        unknowns = [replace(u, one_sided=True) for u in unknowns]
    points = [] if at is not None else [x]
    for i, unknown in enumerate(unknowns):
        for sign in (1,) if unknown.one_sided else (1, -1):
            points.append(x + sign * unknown.step * (np.arange(len(x)) == i))
    found = problem.residuals(unknowns, points)
    if at is None:
        at, *found = found
    pairs = []
    for unknown in unknowns:
        plus = found.pop(0)
        pairs.append((plus, at, unknown.step) if unknown.one_sided else (plus, found.pop(0), 2 * unknown.step))
    return at, _scores(at, pairs, problem.mask)


def _scores(at: Residual, pairs, mask) -> Scores:
    """d log L = -tr(S^-1 dS) / 2 + z' S^-1 dS S^-1 z / 2 - dz' S^-1 z, with information tr(S^-1 dS S^-1 dS) / 2 +
    dz' S^-1 dz; pairs: residuals on both sides and the distance between them."""
    factors, u = at.factors(), np.nan_to_num(at.whitened())
    shifts = [np.nan_to_num(_whiten(factors, (plus.z - minus.z) / step)) for plus, minus, step in pairs]
    shapes = [np.nan_to_num(_whiten_matrix(factors, (plus.s - minus.s) / step)) for plus, minus, step in pairs]
    d, m = np.stack(shifts, axis=1), np.stack(shapes, axis=1)
    weight = TAIL**2 / np.maximum((u**2).sum(axis=1), TAIL**2)  # the slope of rho
    squares = np.stack([weight * u[:, 0] ** 2 - 1, 2 * weight * u[:, 0] * u[:, 1], weight * u[:, 1] ** 2 - 1], axis=1)
    score = 0.5 * np.einsum('fpi,fi->fp', m, squares) - weight[:, None] * np.einsum('fpi,fi->fp', d, u)
    sensitivity = np.sqrt(weight)[:, None, None] * np.concatenate([d, m * np.sqrt([0.5, 1.0, 0.5])], axis=2)
    more = _scores_beside(at, pairs)
    score, sensitivity = score + more.score, np.concatenate([sensitivity, more.sensitivity], axis=2)
    score[~mask], sensitivity[~mask] = 0.0, 0.0
    return Scores(score, sensitivity)


def _scores_beside(at: Residual, pairs) -> Scores:
    """The same of the innovations that are numbers of their own."""
    z, s = at.beside[:, 0], at.beside[:, 1]
    u = np.nan_to_num(z / np.sqrt(s))
    change = np.stack([(plus.beside - minus.beside) / step for plus, minus, step in pairs], axis=1)  # (f, p, 2, b)
    d, m = np.nan_to_num(change[:, :, 0] / np.sqrt(s)[:, None]), np.nan_to_num(change[:, :, 1] / s[:, None])
    weight = TAIL**2 / np.maximum(u**2, TAIL**2)
    score = (0.5 * m * (weight * u**2 - 1)[:, None] - d * (weight * u)[:, None]).sum(axis=2)
    weight = np.tile(np.sqrt(weight), 2)[:, None]
    return Scores(score, weight * np.concatenate([d, m * np.sqrt(0.5)], axis=2))


def _whiten_matrix(factors, s):
    """L^-1 S L^-T of symmetric matrices (f, 3) nn, ne, ee."""
    l_nn, l_en, l_ee = factors
    nn = s[:, 0] / l_nn**2
    ne = (s[:, 1] / l_nn - l_en * nn) / l_ee
    ee = (s[:, 2] - 2 * l_en * s[:, 1] / l_nn + l_en**2 * nn) / l_ee**2
    return np.stack([nn, ne, ee], axis=1)


@dataclass(frozen=True)
class Model:
    """What is assumed and how well it fits: unknowns at x with covariance (p, p), and residual and scores there."""

    problem: Problem
    unknowns: list[Unknown]
    x: np.ndarray
    covariance: np.ndarray
    residual: Residual
    scores: Scores

    def likelihood(self, mask: np.ndarray) -> float:
        return float(np.nansum(self.residual.log_likelihood()[mask]))

    def sigma(self) -> np.ndarray:
        """Standard deviations of x, (p,): by the information, or by how the scores of blocks scatter, what is larger.

        The latter holds where innovations follow each other, too (P. J. Huber, 1967; W. K. Newey, K. D. West, 1987).
        """
        variance, score = np.diag(self.covariance), self.scores.score[self.problem.mask]
        seconds = np.ptp(self.problem.stamp[self.problem.mask]) * 1e-9
        for begins in (*blocks(self.problem), block_begins(self.problem, max(seconds / LONGEST_PART, BLOCK))):
            sums = np.add.reduceat(score, begins)
            variance = np.maximum(variance, np.diag(self.covariance @ (sums.T @ sums) @ self.covariance))
        return np.sqrt(variance)

    def moved(self) -> Problem:
        """The problem with this model as what is assumed."""
        return self.problem.moved(self.unknowns, self.x)

    def refitted(self, mask: np.ndarray, kept: int) -> tuple[np.ndarray, np.ndarray]:
        """x from the fixes in `mask` alone, by one step of scoring, and its covariance.

        The first `kept` unknowns stay as they are; their rows and columns of the covariance are zero.
        """
        base, prior = _priors(self.unknowns)
        gradient = self.scores.gradient(mask) - (self.x - base) / prior**2
        information = self.scores.information(mask) + np.diag(1 / prior**2)
        free = slice(kept, None)
        x, covariance = self.x.copy(), np.zeros_like(information)
        covariance[free, free] = np.linalg.inv(information[free, free])
        x[free] += np.clip(covariance[free, free] @ gradient[free], -prior[free], prior[free])
        # one step tells no more of what is a size
        low, high = np.array([u.near(at) for u, at in zip(self.unknowns, self.x)]).T
        return np.clip(x, low, high), covariance


def _priors(unknowns: Sequence[Unknown]) -> tuple[np.ndarray, np.ndarray]:
    return np.array([u.base for u in unknowns]), np.array([u.prior for u in unknowns])


def refined(model: Model, iterations: int = 8) -> Model:
    """`model` fitted further."""
    return fit(model.problem, model.unknowns, model.x, iterations, model)


def fit(problem: Problem, unknowns: Sequence[Unknown], x, iterations: int = 8, begun: Model | None = None) -> Model:
    """The maximum of the likelihood.

    Fisher's scoring with Levenberg's damping; each unknown has a weak Gaussian prior about its base. begun: a model
    that was fitted at `x` already.
    """
    base, prior = _priors(unknowns)
    bounds = np.reshape([u.bounds for u in unknowns], (-1, 2)).T
    x, mask = np.clip(np.asarray(x, dtype=float), *bounds), problem.mask
    at, found = (begun.residual, begun.scores) if begun else scores(problem, unknowns, x)
    value, damping = _objective(at, mask, x, base, prior), 1e-3
    for _ in range(iterations):
        gradient = found.gradient(mask) - (x - base) / prior**2
        information = found.information(mask) + np.diag(1 / prior**2)
        moved = False
        for _ in range(5):
            step = np.linalg.solve(information + damping * np.diag(np.diag(information)), gradient)
            step = np.clip(x + np.clip(step, -prior, prior), *bounds) - x
            [trial] = problem.residuals(unknowns, [x + step])
            better = _objective(trial, mask, x + step, base, prior)
            if better > value:
                moved, gain = True, better - value
                x, value, damping = x + step, better, max(damping / 10, 1e-6)
                at, found = scores(problem, unknowns, x, trial)
                break
            damping = max(10 * damping, 1e-2)
        if not moved or gain < ENOUGH_GAIN:
            break
    return Model(problem, list(unknowns), x, np.linalg.inv(found.information(mask) + np.diag(1 / prior**2)), at, found)


def _objective(residual: Residual, mask, x, base, prior) -> float:
    likelihood = residual.log_likelihood()[mask]
    seen = np.isfinite(likelihood)
    if seen.mean() < FEWEST_SEEN:
        return -np.inf
    likelihood = np.where(seen, likelihood, likelihood[seen].min())
    return float(likelihood.sum() - 0.5 * (((x - base) / prior) ** 2).sum())


#: the parameters that say how noisy the sensors are, by model
MODEL_NOISE = {'random_walk': 'random_walk.q', 'gauss_markov': 'gauss_markov.sigma',
                'autoregressive': 'autoregressive.b0'}
#: how far a fit may take a noise level, natural logarithm: what is usual, and what is no noise of that sensor any more
NOISE_PRIOR, RECEIVER_PRIOR = 1.0, 1.5
SMALLEST_FACTOR, LARGEST_FACTOR, LARGEST_RECEIVER = 3.0, 10.0, 100.0


def noise_unknowns(problem: Problem) -> list[Unknown]:
    """Logarithms of the noise levels as factors: of the receiver, of each kind of sensor, of the constraint."""
    model = MODEL_NOISE[problem.values['sensor_error_model']]

    def receiver(values, recording, x):
        own = problem.of(recording)
        return values, replace(recording, gnss=replace(
            recording.gnss, covariance=believed(own.drive.gnss, own.claimed, x, own.outlying).covariance))

    groups = {f'{sensor}.noise': [f'{sensor}.noise_density', f'{sensor}.{model}'] for sensor in SENSORS}
    if problem.values['vehicle.non_holonomic']:
        groups['vehicle.non_holonomic_sigma'] = ['vehicle.non_holonomic_sigma']
    sensors = [Unknown(name, _scaled(names), 0.0, 0.05, NOISE_PRIOR, one_sided=True, noise=True,
                       bounds=(-np.log(SMALLEST_FACTOR), np.log(LARGEST_FACTOR))) for name, names in groups.items()]
    return [Unknown('gnss.sigma', receiver, 0.0, 0.05, RECEIVER_PRIOR, one_sided=True, noise=True,
                    bounds=(-np.log(SMALLEST_FACTOR), np.log(LARGEST_RECEIVER))), *sensors]


def _scaled(names: Sequence[str]) -> Callable:
    def apply(values, recording, x):
        for name in names:
            values = scaled(values, name, float(np.exp(x)))
        return values, recording
    return apply


def scaled(values: dict, name: str, factor: float) -> dict:
    """`values` with `factor` on one of them, a number or one for each axis."""
    value = values[name]
    return {**values, name: [v * factor for v in value] if isinstance(value, (list, tuple)) else value * factor}


def calibrated(problem: Problem, unknowns: Sequence[Unknown], x=None) -> np.ndarray:
    """`x` with the noise levels as configured, but for the receiver's: that which explains the innovations best."""
    start = np.zeros(len(unknowns)) if x is None else np.array(x, dtype=float)
    start[[u.noise for u in unknowns]] = 0.0

    def at(level):
        return np.append(level, start[1:])

    levels = np.log([0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0])
    found = [_objective(r, problem.mask, at(level), *_priors(unknowns))
             for level, r in zip(levels, problem.residuals(unknowns, [at(level) for level in levels]))]
    return at(levels[int(np.argmax(found))])
