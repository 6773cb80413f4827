"""Errors of a filter on data that it was not fitted to: with all fixes used, and in outages."""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..evaluation import metrics
from ..evaluation.comparison import aiding_of, samples_to_keep, truth_of
from ..evaluation.metrics import Errors, Truth, position_errors
from ..evaluation.outages import Outages, outage_begins, outages_of
from ..evaluation.outages import summary as outage_summary
from ..evaluation.verdict import Consistency, Trust, trust_in_sigmas
from ..filter.config import FilterConfig
from ..filter.runs.replay import run, run_with_outages
from ..samples import ImuSamples, Recording
from .clock import GNSS, IMU, OWN, lateness_against, shifted_truth
from .folds import in_mask, part_masks
from .problem import Problem, on_all_cores
from .residuals import tempered

#: number of sigmas beyond which the likelihood of an error in an outage decreases with its logarithm only. Larger than
#: for innovations: a sigma that is too small in outages must count
END_TAIL = 6.0
SMALLEST_ERROR = 0.1  # m, smallest sigma that is assumed for an error in an outage


@dataclass(frozen=True)
class MeasuredErrors:
    """Errors of one model: at the epochs of the truth with the fixes used, in outages, and of the predicted fixes.

    independent: whether there is another truth than the fixes that the filter was given. stamp, likelihood (k,): ns and
    log likelihood of the predicted fixes. drives: the errors in each of several drives, by name. late: s by which the
    truth is estimated to be stamped later than the track; without_offset: the errors without that offset, if the truth
    may have a clock of its own.
    """

    continuous: Errors
    outages: list[Outages]
    independent: bool
    stamp: np.ndarray
    likelihood: np.ndarray
    drives: dict[str, MeasuredErrors] = field(default_factory=dict)
    late: float = 0.0
    without_offset: MeasuredErrors | None = None

    def select(self, epochs: Callable, fixes: np.ndarray) -> MeasuredErrors:
        """The part at the stamps for which `epochs` returns true, with the fixes of the mask `fixes` (k,)."""
        return replace(self, continuous=self.continuous.select(epochs(self.continuous.stamp)), stamp=self.stamp[fixes],
                       likelihood=self.likelihood[fixes],
                       without_offset=self.without_offset and self.without_offset.select(epochs, fixes))

    def summary(self) -> dict:
        """The numbers for `report.json`."""
        return {'horizontal_rmse_m': metrics.rms(self.continuous.horizontal),
                'outages': [outage_summary(outages) for outages in self.outages]}

    def trust(self, nis: np.ndarray) -> Trust:
        """Whether the errors agree with the filter's sigmas. nis (f,): of its innovations, NaN without one; it stands
        for the errors with fixes if the truth is the same fixes."""
        nees = self.continuous.nees if self.independent else nis[np.isfinite(nis)]
        return trust_in_sigmas([Consistency(None, nees), *(o.consistency for o in self.outages)])

    def scores(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Stamps and log likelihoods of the predicted positions: of each fix, and at the ends of the outages of each
        duration. They depend on the errors and on the sigmas.
        """
        outages = (self.without_offset or self).outages
        ends = [(o.begin, _end_scores(o)) for o in outages if len(o.begin)]
        return [(self.stamp, self.likelihood), *ends]


def _end_scores(outages: Outages) -> np.ndarray:
    """Log likelihood of the error at the end of each outage, (o,), with a circular covariance that includes that of the
    truth: fixes that serve as the truth have errors, too."""
    error = np.array([e.horizontal[-1] for e in outages.errors])
    variance = np.maximum([e.variance[-1] for e in outages.errors], SMALLEST_ERROR**2)
    return -0.5 * (2 * np.log(variance) + tempered(error**2 / variance, END_TAIL))


def measure_errors(problem: Problem, recording: Recording, imu: ImuSamples, models: Sequence[dict], durations,
                   spacing: float, judged: Sequence[np.ndarray] | None = None,
                   between: Callable[[], None] = lambda: None, announces: bool = False) -> MeasuredErrors:
    """Errors in one drive of a model with parameters `models`: one set, or one for each part, fitted to the others.

    recording: with all fixes, for the truth. imu: the samples that the filter gets. judged: masks of the parts in which
    errors are measured, by default those of `part_masks`. between: called after each model (`on_all_cores`). announces:
    as for `run_with_outages`.
    """
    first = int(problem.stamp[problem.mask][0])
    # by the stamps of the fixes, so that models with different time offsets have the same outages
    begins = outage_begins(problem.began, problem.full.gnss, 0.0, spacing, min(durations, default=0.0),
                           max(durations, default=0.0))
    if len(models) == 1:
        judged = [problem.mask]
    elif judged is None:
        judged = part_masks(problem)
    whole = len(models) == 1

    def one(model):
        values, part = model
        found = _run(problem, recording, imu, values, durations,
                     begins if whole else begins[in_mask(begins, problem, part)], announces)
        return found.select(lambda stamp: (whole | in_mask(stamp, problem, part)) & (stamp >= first),
                            np.isfinite(found.likelihood) & part)
    return _joined(on_all_cores(one, zip(models, judged), between))


def all_drives_together(drives: dict[str, MeasuredErrors]) -> MeasuredErrors:
    """The errors of all `drives` (by name) together."""
    return replace(_joined(list(drives.values())), drives=drives if len(drives) > 1 else {})


def _joined(found: Sequence[MeasuredErrors]) -> MeasuredErrors:
    """The errors in several parts of a drive, or in drives on one time axis, in the order of time."""
    if len(found) == 1:
        return found[0]
    stamp, likelihood = (np.concatenate([getattr(m, name) for m in found]) for name in ('stamp', 'likelihood'))
    order = np.argsort(stamp, kind='stable')
    durations = sorted({o.duration for m in found for o in m.outages})
    outages = [_joined_outages([o for m in found for o in m.outages if o.duration == d]) for d in durations]
    without_offset = [m.without_offset or m for m in found] if any(m.without_offset for m in found) else []
    return MeasuredErrors(_joined_errors([m.continuous for m in found]), outages, all(m.independent for m in found),
                          stamp[order], likelihood[order], late=float(np.mean([m.late for m in found])),
                          without_offset=_joined(without_offset) if without_offset else None)


def _run(problem: Problem, recording: Recording, imu: ImuSamples, values: dict, durations,
         begins: np.ndarray, announces: bool) -> MeasuredErrors:
    """One filter through the recording: errors with the fixes used, in outages, and the likelihood of each fix (f,)."""
    config, delay = FilterConfig.from_parameters(values), round(values['gnss.time_offset'] * 1e9)
    truth, clock = truth_of(recording, values), problem.reference_clock
    if recording.reference is not None and clock == GNSS:
        truth = replace(shifted_truth(truth, delay), receiver_clock=True)
    keep = samples_to_keep(imu, truth.reference.stamp)
    coasting = None
    if durations:
        result, coasting = run_with_outages(config, imu, problem.full.gnss, begins - delay, max(durations),
                                            aiding_of(recording), keep, announces=announces)
    else:
        result = run(config, imu, problem.full.gnss, aiding_of(recording), keep=keep)
    likelihood = problem.innovations(result).log_likelihood()

    def against(truth: Truth, shift: int) -> MeasuredErrors:
        """Errors against `truth`, whose stamps are earlier by `shift` (ns) than the original ones; the errors get the
        original stamps, by which models are compared."""
        outages = outages_of(result, coasting, truth, durations, config.imu.restart_gap) if coasting else []
        errors = position_errors(result, truth, np.zeros(len(truth), dtype=bool))
        return MeasuredErrors(_later(errors, shift), [
            replace(o, begin=o.begin + delay, errors=[_later(e, shift) for e in o.errors]) for o in outages],
            recording.reference is not None, problem.stamp, likelihood)

    if clock in (IMU, GNSS):
        return against(truth, delay if clock == GNSS else 0)
    late = lateness_against(result, truth)
    shift = round(late * 1e9)
    without_offset = against(shifted_truth(truth, shift), shift)
    return without_offset if clock == OWN else replace(against(truth, 0), late=late, without_offset=without_offset)


def _later(errors: Errors, shift: int) -> Errors:
    return replace(errors, stamp=errors.stamp + shift)


def _joined_errors(parts: list[Errors]) -> Errors:
    order = np.argsort(np.concatenate([e.stamp for e in parts]), kind='stable')
    return Errors(**{name: np.concatenate([getattr(e, name) for e in parts])[order]
                     for name in Errors.__dataclass_fields__})


def _joined_outages(parts: list[Outages]) -> Outages:
    order = np.argsort(np.concatenate([o.begin for o in parts]), kind='stable')
    joined = {name: np.concatenate([getattr(o, name) for o in parts])[order]
              for name in ('begin', 'max_error', 'distance', 'within', 'growth', 'sigma', 'kept', 'announced',
                           'crossed')}
    errors = [e for o in parts for e in o.errors]
    return Outages(duration=parts[0].duration, time=parts[0].time, errors=[errors[i] for i in order], **joined)


def in_common(one: MeasuredErrors, other: MeasuredErrors) -> MeasuredErrors:
    """`one` with only the epochs and outages that `other` has, too, so that their means can be compared."""
    return replace(
        one, continuous=one.continuous.select(np.isin(one.continuous.stamp, other.continuous.stamp)),
        outages=[a.select(np.isin(a.begin, b.begin)) for a, b in zip(one.outages, other.outages)],
        drives={name: in_common(drive, other.drives[name]) for name, drive in one.drives.items()},
        without_offset=one.without_offset and other.without_offset and in_common(one.without_offset,
                                                                                 other.without_offset))


def outages_nearest(measured: MeasuredErrors, duration: float = 30.0) -> Outages | None:
    """The outages whose duration is nearest to `duration`, s; None without any."""
    there = [outages for outages in measured.outages if len(outages.begin)]
    return min(there, key=lambda o: abs(o.duration - duration)) if there else None


def errors_near_30_s(before: MeasuredErrors, after: MeasuredErrors) -> tuple[float, float, float] | None:
    """Duration of the outages nearest to 30 s, and the mean of the largest error in them before and after, m; None
    without any."""
    one, other = map(outages_nearest, without_clock_of_truth(before, after))
    if one is None or other is None or one.duration != other.duration:
        return None
    return one.duration, float(one.max_error.mean()), float(other.max_error.mean())


def without_clock_of_truth(before: MeasuredErrors, after: MeasuredErrors) -> tuple[MeasuredErrors, MeasuredErrors]:
    """Both without the time offset of the truth, if the truth may have a clock of its own and the change increases this
    offset: a wrong clock of the truth must not decide against the change."""
    if before.without_offset and after.without_offset and abs(after.late) > abs(before.late):
        return before.without_offset, after.without_offset
    return before, after
