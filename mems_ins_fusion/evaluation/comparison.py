"""One recording through the filter with each sensor error model, at each update interval, and in outages."""
from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from itertools import combinations
from queue import Empty, SimpleQueue

import numpy as np

from ..errors import InputError
from ..filter.config import FilterConfig
from ..filter.measurements import wheel_vibration
from ..filter.measurements.position import is_fix
from ..filter.runs.replay import run as replay
from ..filter.runs.results import Run
from ..filter.runs.smoothing import smoothed
from ..filter.runs.usable import usable_samples
from ..navigation.earth import to_local
from ..navigation.frames import FLU_TO_FRD
from ..samples import Aiding, Fixes, ImuSamples, Recording
from ..threads import threads
from . import metrics
from .intervals import Difference, holm, paired
from .metrics import Errors, Truth, position_errors, truth_from_fixes, turning_at
from .outages import Distance, Outages, outage_begins, run_outages, smooth_outages
from .outages import summary as outage_summary

#: Hz, rate at which states are kept, in addition to those around the epochs of the truth
KEPT_RATE = 10.0
#: largest number of epochs at which errors are measured, and of states kept of a run; longer recordings are thinned
MOST_EPOCHS = 40_000
#: s, largest step back of the stamps within a stretch; a larger one begins a new stretch
_BACK = 1
#: largest number of stretches; if there are more, every sample is kept
_MOST_BREAKS = 100
#: p-value, adjusted for the number of comparisons, below which a difference is significant
COMPARISON_P = 0.05


class ReplayError(InputError):
    """A recording that cannot be replayed as asked: one line that says why."""


@dataclass(frozen=True)
class RunResult:
    """One run: the fixes used, its states at KEPT_RATE and around the epochs of the truth, its errors and their
    summary, and the number of IMU samples processed. independent: whether the truth contains none of these fixes.
    """

    model: str
    interval: float
    fixes: Fixes
    run: Run
    errors: Errors
    summary: dict
    samples: int
    independent: bool


@dataclass(frozen=True)
class OutageResult:
    """The outages of one model and one duration. smoothed: those of the smoothed trajectory, where it was asked for."""

    model: str
    interval: float
    outages: Outages
    smoothed: Outages | None = None


@dataclass(frozen=True)
class PairResult:
    """Two models on the same data: first minus second of the mean square error, m^2, or in outages (with a duration)
    of the mean largest error, m. rms: of both, m."""

    first: str
    second: str
    interval: float
    duration: float | None
    difference: Difference
    p_adjusted: float
    rms: tuple[float, float]

    @property
    def significant(self) -> bool:
        return self.p_adjusted < COMPARISON_P

    @property
    def better(self) -> str:
        return self.first if self.difference.mean < 0 else self.second


@dataclass(frozen=True)
class Comparison:
    """All runs on one recording. smoothed: those at the shortest interval, smoothed, where that was asked for."""

    recording: Recording
    mechanization: str
    truth: Truth
    runs: list[RunResult]
    outages: list[OutageResult]
    pairs: list[PairResult]
    fixes_given: dict[float, np.ndarray]  # by update interval: times of the fixes given to the runs, ns
    smoothed: list[RunResult] = field(default_factory=list)

    def run_of(self, model: str, interval: float) -> RunResult:
        return next(r for r in self.runs if r.model == model and r.interval == interval)

    def smoothed_of(self, model: str) -> RunResult | None:
        return next((r for r in self.smoothed if r.model == model), None)

    @property
    def intervals(self) -> list[float]:
        return sorted({r.interval for r in self.runs})

    @property
    def models(self) -> list[str]:
        return list(dict.fromkeys(r.model for r in self.runs))

    @property
    def durations(self) -> list[float]:
        return sorted({r.outages.duration for r in self.outages})


def time_span(recording: Recording, start: float, stop: float) -> Recording:
    """The part of `recording` from `start` to `stop` s after its first IMU sample; stop 0: to its end."""
    if not start and not stop:
        return recording
    seen = usable_samples(recording.imu)
    origin = int((seen if len(seen) else recording.imu).stamp[0])
    last = origin + round(stop * 1e9) if stop else np.iinfo(np.int64).max

    def part(samples):
        return samples.select((samples.stamp >= origin + round(start * 1e9)) & (samples.stamp <= last))

    shorter = recording.having({name: part(samples) for name, samples in recording.streams().items()})
    for name, samples in (('IMU sample', shorter.imu), ('fix', shorter.gnss)):
        if not len(samples):
            raise ReplayError(f'{recording.name}: no {name} between start {start:g} s and '
                              + (f'stop {stop:g} s' if stop else 'the end'))
    return shorter


def add_noise(fixes: Fixes, sigma: float, seed: int) -> Fixes:
    """`fixes` with white noise of `sigma` m added to north and east, and its variance to their covariances."""
    if sigma == 0:
        return fixes
    noise = sigma * np.random.default_rng(seed).standard_normal((2, len(fixes)))
    meridian, prime_vertical = metrics.radii(fixes.latitude)
    known = fixes.covariance_type > 0
    covariance = np.where(known[:, None, None], fixes.covariance, 0.0)
    covariance[:, [0, 1], [0, 1]] += sigma**2
    covariance[:, 2, 2] += np.where(known, 0.0, 4 * sigma**2)
    return replace(fixes, latitude=fixes.latitude + noise[0] / (meridian + fixes.height),
                   longitude=fixes.longitude + noise[1] / ((prime_vertical + fixes.height) * np.cos(fixes.latitude)),
                   covariance=covariance, covariance_type=np.where(known, fixes.covariance_type, 2).astype(np.uint8))


def aiding_of(recording: Recording) -> Aiding:
    """The inputs in `recording` besides the fixes, for the filter."""
    return Aiding({name: samples for name, samples in recording.streams().items()
                   if name not in ('imu', 'gnss', 'reference', 'temperature')})


def fixes_apart(fixes: Fixes, interval: float, start: int = 0) -> np.ndarray:
    """Which of `fixes` to use, (n,) bool, so that from `start` (ns) on they are `interval` s apart; 0 uses all.

    All fixes until `start` are used: the filter needs them to start, and the start is not compared. After it, the first
    valid fix in each slot of `interval` is used; the slots begin half a fix interval early, because of jitter. They are
    counted from the first fix, so that filters that start at different times get the same fixes.
    """
    valid = is_fix(fixes)
    if interval == 0 or valid.sum() < 2:
        return valid
    stamp = fixes.stamp[valid]
    spacing = np.median(np.diff(np.sort(stamp)))
    slot = ((stamp - stamp.min() + spacing / 2) // (interval * 1e9)).astype(np.int64)
    used = stamp < start + spacing / 2
    used[np.unique(slot, return_index=True)[1]] = True
    use = np.zeros(len(fixes), dtype=bool)
    use[np.flatnonzero(valid)[used]] = True
    return use


def truth_of(recording: Recording, values: dict) -> Truth:
    """The reference of `recording`, or its fixes (those of the receiver, before noise is added) without one.

    If there are more than MOST_EPOCHS positions, every second, third ... is used.
    """
    antenna = values['gnss.lever_arm']
    if recording.reference is None:
        truth = truth_from_fixes(recording.gnss, FLU_TO_FRD @ np.asarray(antenna), values['gnss.time_offset'], 'fixes')
    else:
        arm = values['reference_lever_arm'] or antenna
        truth = Truth(recording.reference, FLU_TO_FRD @ np.asarray(arm, dtype=float),
                      np.zeros(len(recording.reference)), 'reference')
    return truth.select(slice(None, None, -(-len(truth) // MOST_EPOCHS))) if len(truth) > MOST_EPOCHS else truth


@dataclass(frozen=True)
class Protocol:
    """The runs and outages of one comparison: the parameters of a replay.

    filters: by sensor error model; the first one is used for the common start. intervals (ascending) and durations: s.
    spacing: s between the begins of outages. noise: m, standard deviation of the noise added to the fixes, from `seed`.
    until: s after which no fix is given; 0: to the end. offset: ns, time offset of the fixes. restart_gap: s, of the
    IMU.
    """

    filters: dict[str, FilterConfig]
    intervals: tuple[float, ...]
    durations: tuple[float, ...]
    spacing: float
    noise: float
    seed: int
    until: float
    smoothing: bool
    offset: int
    restart_gap: float

    @classmethod
    def from_parameters(cls, values: dict) -> Protocol:
        """values: checked parameters."""
        filters = {model: FilterConfig.from_parameters({**values, 'sensor_error_model': model})
                   for model in values['models']}
        return cls(filters, tuple(sorted(set(values['update_intervals']))), tuple(values['outage_durations']),
                   values['outage_spacing'], values['fix_noise'], values['seed'], values['fixes_until'],
                   values['smoothing'], round(values['gnss.time_offset'] * 1e9), values['imu.restart_gap'])

    @property
    def first(self) -> FilterConfig:
        return next(iter(self.filters.values()))


def compare(recording: Recording, values: dict, progress: Callable[[float], None] = lambda part: None) -> Comparison:
    """Replay `recording` with each of `models`, at each of `update_intervals`, and in the outages.

    values: checked parameters. progress: called from time to time with the part that is done; an exception in it ends
    the comparison. Raises ReplayError where the filter does not start.
    """
    protocol = Protocol.from_parameters(values)
    work = _Work(recording, protocol, truth_of(recording, values))
    tasks = [(model, interval) for model in protocol.filters for interval in protocol.intervals]
    share = 0.6 if protocol.durations else 1.0
    runs = work.in_threads(work.run, tasks, lambda part: progress(share * part))
    runs = work.measure(runs)
    begin = work.outage_begins(runs)
    share_of_smoothing = 0.5 if protocol.smoothing else 0.0
    found = work.in_threads(work.outages, [(model, begin) for model in protocol.filters] if protocol.durations else [],
                            lambda part: progress(share + (1 - share) * (1 - share_of_smoothing) * part))
    smoothed_runs, smoothed_found = work.smoothed(
        runs, begin, lambda part: progress(1 - (1 - share) * share_of_smoothing * (1 - part)))
    models, found = list(protocol.filters), _common([*found, *smoothed_found])
    of_model = dict(zip(models, found[len(models):]))
    outages = [OutageResult(model, work.shortest, o, of_model[model][i] if of_model else None)
               for model, results in zip(models, found) for i, o in enumerate(results)]
    given = {interval: work.given(interval) for interval in protocol.intervals}
    return Comparison(work.recording, values['mechanization'], work.truth, runs, outages, _pairs(runs, outages), given,
                      smoothed_runs)


class _Work:
    """Data that all runs on one recording share."""

    def __init__(self, recording: Recording, protocol: Protocol, truth: Truth):
        self.protocol = protocol
        self.recording = recording
        self.fixes = add_noise(recording.gnss, protocol.noise, protocol.seed)
        self.until = int(recording.imu.stamp[0]) + round(protocol.until * 1e9) if protocol.until else 0
        if self.until:
            self.fixes = self.fixes.select(self.fixes.stamp <= self.until)
        self.truth = truth
        if not len(self.truth):
            raise ReplayError(f'{recording.name}: there is no valid position to compare with')
        self.shortest = protocol.intervals[0]
        self.turning = turning_at(recording.imu, protocol.first.conditioning, self.truth.reference.stamp)
        self.aiding = aiding_of(recording)
        self.keep = samples_to_keep(recording.imu, self.truth.reference.stamp)
        self.start = self._start()

    def _start(self) -> int:
        """Time of the start of the filter with all fixes, ns, in the clock of the fixes."""
        every = self.fixes.select(fixes_apart(self.fixes, 0.0))
        run = replay(self.protocol.first, self.recording.imu, every, self.aiding, keep=self.keep)
        if not len(run.stamp):
            reason = next((n.text for n in reversed(run.notices) if n.level == 'error'), 'no usable fix')
            raise ReplayError(f'{self.recording.name}: {reason}')
        return int(run.stamp[0]) + self.protocol.offset

    def _use(self, interval: float) -> np.ndarray:
        return fixes_apart(self.fixes, interval, self.start)

    def given(self, interval: float) -> np.ndarray:
        """Stamps of the fixes given to the runs of `interval`, ns of the IMU's clock."""
        return np.sort(self.fixes.stamp[self._use(interval)]) - self.protocol.offset

    def in_threads(self, function, tasks, progress):
        """function(*task) for each task on all cores (the kernel holds no lock), in the order of `tasks`."""
        with ThreadPoolExecutor(threads()) as pool:
            done = SimpleQueue()  # in C: a signal cannot leave one of its locks behind, as it can those of `wait`
            futures = [pool.submit(function, *task) for task in tasks]
            try:
                for future in futures:
                    future.add_done_callback(done.put)
                left = len(futures)
                while left:
                    with suppress(Empty):
                        done.get(timeout=0.1)
                        left -= 1
                    progress(1 - left / len(futures))
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
            return [future.result() for future in futures]

    def run(self, model: str, interval: float) -> tuple[str, float, np.ndarray, Run]:
        use = self._use(interval)
        run = replay(self.protocol.filters[model], self.recording.imu, self.fixes.select(use), self.aiding,
                     keep=self.keep)
        return model, interval, use, _without_views(run)

    def measure(self, runs) -> list[RunResult]:
        """The errors of `runs`, from the time on at which all of them had started."""
        first = max(self.until, *(run.stamp[0] for *_, run in runs))
        return [self._result(*run, first) for run in runs]

    def _result(self, model: str, interval: float, use: np.ndarray, run: Run, first: int) -> RunResult:
        """`run` with its errors from `first` (ns) on."""
        withheld = self._withheld(use)
        independent = bool(withheld.any())
        judged = (self.truth.reference.stamp >= first) & (withheld if independent else ~withheld)
        errors = position_errors(run, self.truth.select(judged), self.turning[judged], self.protocol.restart_gap)
        if not len(errors):
            raise ReplayError(f'{self.recording.name}: no position of the {self.truth.source} falls into the '
                              f'run at update interval {interval:g} s')
        summary = metrics.summary(errors) | {'relative_translation_percent': self._relative(run, errors)}
        return RunResult(model, interval, self.fixes.select(use), run, errors, summary,
                         len(self.recording.imu) - int(run.index[0]), independent)

    def smoothed(self, runs: list[RunResult], begin: np.ndarray,
                 progress: Callable[[float], None]) -> tuple[list[RunResult], list[list[Outages]]]:
        """The smoothed runs at the shortest interval, and the smoothed outages of each model; empty if not asked for.
        """
        if not self.protocol.smoothing:
            return [], []
        keep = samples_to_keep(self.recording.imu, np.empty(0, dtype=np.int64))
        results, outages = [], []
        shortest = [r for r in runs if r.interval == self.shortest]
        for i, filtered in enumerate(shortest):
            config = self.protocol.filters[filtered.model]
            given = config, self.recording.imu, filtered.fixes
            run = smoothed(*given, self.aiding, keep)
            first = max(int(filtered.errors.stamp[0]), int(run.stamp[0]))
            results.append(self._result(filtered.model, self.shortest, self._use(self.shortest), run, first))
            progress((i + 0.3) / len(shortest))
            if self.protocol.durations:
                outages.append(smooth_outages(*given, self.truth, self.protocol.durations, begin, self.aiding,
                                              keep, run))
            progress((i + 1) / len(shortest))
        return results, outages

    def _relative(self, run: Run, errors: Errors) -> float | None:
        """The relative translation error, in percent of the path."""
        reference = self.truth.reference
        reference = reference.select(np.searchsorted(reference.stamp, errors.stamp))
        north, east, _ = to_local(reference.latitude, reference.longitude, reference.height,
                                  np.array([reference.latitude[0], reference.longitude[0], reference.height[0]]))
        truth = np.column_stack([north, east])
        estimate, turned = truth + np.column_stack([errors.north, errors.east]), errors.heading
        if reference.yaw is None and self.recording.reference is not None:  # fixes are too noisy for a course
            turned = metrics.turned_by_course(errors.stamp, truth, estimate)
        return metrics.relative_translation_percent(errors.stamp, truth, estimate, turned,
                                                    Distance(run).at(errors.stamp))

    def _withheld(self, use: np.ndarray) -> np.ndarray:
        """Which epochs of the truth are not fixes that the filter used."""
        stamp = self.truth.reference.stamp
        if self.recording.reference is not None or self.protocol.noise > 0:
            return np.ones(len(stamp), dtype=bool)
        used = self.fixes.stamp[use] - self.protocol.offset
        return ~np.isin(stamp, used)

    def outage_begins(self, runs: list[RunResult]) -> np.ndarray:
        if not self.protocol.durations:
            return np.empty(0, dtype=np.int64)
        first = max(r.run.stamp[0] for r in runs if r.interval == self.shortest)
        return outage_begins(first, self.fixes.select(self._use(self.shortest)), 1e-9 * self.protocol.offset,
                             self.protocol.spacing, min(self.protocol.durations), max(self.protocol.durations))

    def outages(self, model: str, begin: np.ndarray) -> list[Outages]:
        fixes = self.fixes.select(self._use(self.shortest))
        return run_outages(self.protocol.filters[model], self.recording.imu, fixes, self.truth,
                           self.protocol.durations, begin, self.aiding, self.keep)


def samples_to_keep(imu: ImuSamples, epochs: np.ndarray) -> np.ndarray:
    """(n,) bool: the samples on both sides of each epoch (m,) ns, and KEPT_RATE of them a second, in long recordings
    fewer."""
    keep = np.zeros(len(imu), dtype=bool)
    steps = np.diff(imu.stamp)
    seconds = len(imu) * float(np.median(steps)) * 1e-9 if len(steps) else 0.0
    interval = round(max(1 / KEPT_RATE, seconds / MOST_EPOCHS) * 1e9)
    breaks = np.flatnonzero(steps < -_BACK * 10**9) + 1
    if len(breaks) > _MOST_BREAKS:
        return ~keep
    edges = [0, *breaks.tolist(), len(imu)]
    for first, last in zip(edges[:-1], edges[1:]):
        top = np.maximum.accumulate(imu.stamp[first:last])
        advancing = first + np.concatenate([[0], np.flatnonzero(np.diff(top) > 0) + 1])
        stamp = imu.stamp[advancing]
        slot = (stamp - stamp[0]) // interval
        keep[advancing[np.concatenate([[True], np.diff(slot) > 0])]] = True
        after = np.searchsorted(stamp, epochs)
        for index in (after - 1, after):
            keep[advancing[index[(index >= 0) & (index < len(stamp))]]] = True
        keep[advancing[-1]] = True
    return keep


def _without_views(run: Run) -> Run:
    """`run` with copies of its arrays, which are views of larger ones, so that the larger ones can be freed."""
    arrays = {f.name: getattr(run, f.name) for f in fields(run)}
    return replace(run, **{name: array.copy() for name, array in arrays.items()
                           if isinstance(array, np.ndarray) and array.base is not None})


def _common(found: list[list[Outages]]) -> list[list[Outages]]:
    """The outages that all models have."""
    if not found:
        return found
    common = [set.intersection(*(set(o.begin.tolist()) for o in same)) for same in zip(*found)]
    return [[o.select(np.isin(o.begin, list(begins))) for o, begins in zip(results, common)] for results in found]


def _pairs(runs: list[RunResult], outages: list[OutageResult]) -> list[PairResult]:
    """All pairs of models at each interval and in the outages of each duration, tested together (Holm)."""
    found = []
    for a, b in combinations(runs, 2):
        if a.interval == b.interval and a.model != b.model:
            difference = paired(a.errors.horizontal**2, b.errors.horizontal**2)
            found.append((a, b, None, difference, (metrics.rms(a.errors.horizontal), metrics.rms(b.errors.horizontal))))
    for a, b in combinations(outages, 2):
        if a.outages.duration == b.outages.duration and a.model != b.model and len(a.outages.begin):
            difference = paired(a.outages.max_error, b.outages.max_error)
            found.append((a, b, a.outages.duration, difference,
                          (metrics.rms(a.outages.max_error), metrics.rms(b.outages.max_error))))
    found = [f for f in found if f[3] is not None]
    adjusted = holm([f[3].p for f in found])
    return [PairResult(a.model, b.model, a.interval, duration, difference, p, both)
            for (a, b, duration, difference, both), p in zip(found, adjusted)]


def run_row(result: RunResult, mechanization: str, name: str) -> dict:
    """One entry of `runs`, or of `smoothed`, in `report.json`."""
    run = result.run
    heard = None if run.memory is None else wheel_vibration.summary(run.memory)
    return {'recording': name, 'model': result.model, 'mechanization': mechanization,
            'update_interval_s': result.interval, **result.summary,
            'nis_mean': float(run.innovations.nis.mean()) if len(run.innovations.nis) else None,
            'independent_truth': result.independent,
            'imu_samples': result.samples, 'fixes_used': len(run.innovations.nis),
            **({'wheel_vibration': heard} if heard else {}), 'filter_seconds': run.filter_seconds}


def outage_row(result: OutageResult, mechanization: str, name: str) -> dict:
    """One entry of `outages` in `report.json`."""
    return {'recording': name, 'model': result.model, 'mechanization': mechanization,
            'update_interval_s': result.interval, **outage_summary(result.outages),
            **({'smoothed': outage_summary(result.smoothed)} if result.smoothed else {})}
