"""Trial runs of filters over the recordings: what errors they make, and how far the work is."""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..configuration.check import SMALL_OFFSET, SURE
from ..configuration.regression import weighted
from ..configuration.remaining import TIME_OFFSET, Remaining
from ..effects.aiding_time_offset import SeveralTimeOffsets
from ..effects.base import Effect
from ..filter.runs.usable import usable
from ..navigation.frames import mounting
from ..recordings.motion import compare_steering
from ..samples import Recording
from .drives import Drives
from .estimate import Estimate
from .folds import part_masks
from .measured import MeasuredErrors, all_drives_together, measure_errors
from .outliers import without_far_off
from .problem import Problem, exact_inputs, on_all_cores
from .starts import DirectEvidence

#: number of IMU samples filtered for one recording, after which a search begins no further round: less than a minute on
#: two cores. Counted in samples, not by the clock, so that each machine gives the same result
ENOUGH = 9_000_000
#: number of outages, about, in which errors are measured for a decision on an effect
FEW_OUTAGES = 40
CLOSEST_OUTAGES = 10.0  # s, shortest time between the beginnings of two of these outages
# progress that is shown (0 to 1) where a part of the work begins, from its usual duration:
SEARCHING = 0.05  # the search for effects
CHOOSING = 0.6  # the choice of noise levels
MEASURING = 0.88  # the errors for the report
LOOKING = 0.95  # what the effects leave unexplained
#: usual number of filters in the choice of noise levels; only for the progress that is shown
USUAL_CHOICES = 15

#: purposes for which errors are measured
FOR_EFFECTS, FOR_LEVELS, REPORTED = 'decisions on effects', 'the choice of noise levels', 'the report'

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class TrialRuns:
    """Trial runs of filters over the recordings: what errors they make.

    recordings: with all fixes, one for each drive of `origin`. origin: the drives with the parameters as given.
    starts: by effect, further sizes from which it is fitted. beside: what the recordings show without a filter. tell:
    called with the progress (0 to 1) and what is being done. working: called between two steps of the work without a
    change of the progress.
    """

    recordings: tuple[Recording, ...]
    origin: Drives
    library: tuple[Effect, ...]
    durations: tuple[float, ...]
    spacing: float
    tell: Progress
    starts: dict[str, list[dict[str, float]]] = field(default_factory=dict)
    beside: DirectEvidence = DirectEvidence()
    working: Callable[[], None] = lambda: None
    measured: dict[str, MeasuredErrors] = field(default_factory=dict)  # by the filters asked for

    @cached_property
    def without_outliers(self) -> tuple[Recording, ...]:
        """The recordings that errors are measured against. Fixes that are far off are left out: they are no truth."""
        return tuple(replace(r, gnss=without_far_off(r.gnss)) for r in self.recordings)

    @cached_property
    def shown(self) -> dict[str, Estimate]:
        """Parameters of effects (`effect.parameter`) that the recordings show without a filter, beyond the given
        parameters."""
        found = {} if self.turned is None else {'gyroscope_scale.z': self.turned}
        track = self.beside.track
        if track is not None and track.shown:
            lag = track.smoothing - self.origin.given['gnss.lag_per_acceleration']
            found['gnss_lag.lag'] = Estimate(lag, track.smoothing_sigma, 's^2')
        found |= {f'{name}_lag.tau': Estimate(one.tau, one.sigma, 's') for name, one in self.beside.low_passes.items()}
        return found | {name: Estimate(one.value, one.sigma, 's') for name, one in self._left.items()}

    @property
    def _left(self) -> dict[str, Remaining]:
        """By effect and its parameter: each time offset that the recordings show, minus the given one."""
        left = {f'{name}_lag.delay' if name in self.beside.low_passes else f'{name}_time_offset.time_offset': clock
                for name, clock in self.beside.clocks.items()}
        track = self.beside.track
        if track is not None and track.shown:
            lag = track.lag - self.origin.given['gnss.time_offset']
            left['gnss_time_offset.time_offset'] = Remaining(TIME_OFFSET, lag, track.lag_sigma)
        return left

    @property
    def certain(self) -> tuple[str, ...]:
        """Names of the effects of time offsets and low passes that the recordings show for certain without a filter,
        beyond the given parameters; first the effect that sets those of several inputs together."""
        together = [effect.name for effect in self.library if isinstance(effect, SeveralTimeOffsets)]
        return (*together, *(name.split('.')[0] for name, left in self._left.items()
                             if left.certain(SMALL_OFFSET, SURE)))

    def told(self, name: str, sizes: dict[str, Estimate]) -> dict[str, Estimate]:
        """The `sizes` to report of an effect that is not added: what the recordings show for certain is reported as
        they show it, not as it was fitted."""
        return {n: self.shown.get(f'{name}.{n}', e) for n, e in sizes.items()} if name in self.certain else sizes

    def unset(self, added: Sequence[str]) -> tuple[str, ...]:
        """Names of the inputs (not of the fixes) that certainly have a time offset which none of the effects `added`
        sets."""
        several = {name for effect in self.library if isinstance(effect, SeveralTimeOffsets) and effect.name in added
                   for name in effect.known}
        return tuple(name for name in self.beside.late if name not in several
                     and not {f'{name}_time_offset', f'{name}_lag'} & set(added))

    @cached_property
    def turned(self) -> Estimate | None:
        """Scale factor error of the vertical gyroscope: by which part it turns further than the course of the fixes.
        None if a scale is configured, or without a turn that shows it."""
        up = -mounting(self.origin.given['imu.mounting_rpy'])[2]
        seen = [usable(recording) for recording in self.without_outliers]
        found = [compare_steering(recording.imu, recording.gnss, up) for recording in seen if len(recording.gnss) > 1]
        found = [steering for steering in found if steering is not None and steering.tells and steering.scale > 0.0]
        if not found or any(self.origin.given['gyroscope.scale']):
            return None
        value, sigma = weighted(*np.array([steering.turned for steering in found]).T)
        return Estimate(float(value) - 1.0, float(sigma), '-')

    @property
    def without_standstills(self) -> dict[str, bool]:
        """Parameters that switch standstills off, if they are on and one of the drives does not distinguish them from
        motion; else none."""
        name = 'vehicle.zero_velocity'
        used = self.origin.given[name] and not all(problem.values[name] for problem in self.origin.each)
        return {name: False} if used else {}

    @property
    def switches(self) -> tuple[str, ...]:
        """Names of the boolean parameters that are also tried with the other value. `imu.adapt_noise`: the scatter of
        samples overstates noise that a sensor has filtered, and vibration, which both integrate to nothing.
        `vehicle.zero_velocity`: if it is off, or a drive does not distinguish standstills from motion."""
        doubtful = not all(problem.values['vehicle.zero_velocity'] for problem in self.origin.each)
        scatter = self.origin.given['mechanization'] == 'strapdown'
        return (*(['imu.adapt_noise'] if scatter else []), *(['vehicle.zero_velocity'] if doubtful else []))

    def enough(self, share: float = 1.0) -> bool:
        """Whether more than this share of the largest amount of work of a search is done."""
        return self.done > share

    @property
    def done(self) -> float:
        """Work of the search so far, as a share of the largest amount (ENOUGH)."""
        return self.origin.work / (ENOUGH * len(self.recordings))

    def searching(self, what: str) -> None:
        """Report `what` is being done and the progress, now and after each batch of work."""
        def tell():
            self.tell(SEARCHING + (CHOOSING - SEARCHING) * min(1.0, self.done), what)
        tell()
        self.origin.watched(tell)

    def errors(self, models: Sequence[dict], full: bool = False) -> MeasuredErrors:
        """Errors of one filter (one model), or of several, each in the part of the data that it was not fitted to.

        full: with all that a driving filter adapts, in the outages of the report. Else for decisions on effects: with
        exact time offsets of the inputs, as a filter that estimates them hides wrong ones; without
        `gnss.adapt_covariance`, as a covariance that follows the innovations holds the truth whatever effect the model
        lacks; without `imu.adapt_noise`, as these samples are means over an interval, whose differences show
        motion more than noise; and without standstills that are not distinguished from motion, as they hold the
        position in place also if the rest of the model is wrong.
        """
        decides = {'gnss.adapt_covariance': False, 'imu.adapt_noise': False, **self.without_standstills}
        return self._kept(list(models), REPORTED) if full else self._kept(
            [{**values, **decides, **exact_inputs(values)} for values in models], FOR_EFFECTS)

    def each(self, configurations: Sequence[dict]) -> list[MeasuredErrors]:
        """Errors of each of several filters, for the choice of noise levels: with all that a driving filter adapts, as
        a filter that does not adapt needs other levels."""
        found = on_all_cores(lambda values: self._kept([values], FOR_LEVELS), configurations)
        count = len(self.measured)
        self.tell(CHOOSING + (MEASURING - CHOOSING) * count / (count + USUAL_CHOICES), 'choosing noise levels')
        return found

    def _kept(self, models: list[dict], use: str) -> MeasuredErrors:
        asked = repr((use, [sorted(values.items()) for values in models]))
        if asked not in self.measured:
            self.measured[asked] = self._measured(models, use)
        return self.measured[asked]

    def _measured(self, models: list[dict], use: str) -> MeasuredErrors:
        judged = part_masks(self.origin) if len(models) > 1 else [self.origin.mask]
        found = {}
        for recording, truth, problem, where in zip(self.recordings, self.without_outliers, self.origin.each,
                                                    self.origin.slices):
            mine = [(values, mask[where]) for values, mask in zip(models, judged) if mask[where].any()]
            found[recording.name] = measure_errors(
                problem, truth, (problem.drive if use == FOR_EFFECTS else problem.full).imu,
                [values for values, _ in mine], short_enough(self.durations, problem), self._between(problem, use),
                [mask for _, mask in mine], self.working, use == REPORTED)
        return all_drives_together(found)

    def _between(self, problem: Problem, use: str) -> float:
        """s between the beginnings of outages. For noise levels there are as many outages as in the report: a longer
        drive shows the levels better."""
        few = max(CLOSEST_OUTAGES, float(np.ptp(problem.stamp[problem.mask])) * 1e-9 / FEW_OUTAGES)
        return {FOR_EFFECTS: few, FOR_LEVELS: min(few, max(CLOSEST_OUTAGES, self.spacing)), REPORTED: self.spacing}[use]


def short_enough(durations: Sequence[float], problem: Problem) -> tuple[float, ...]:
    """The `durations` of outages, s, that are short enough for the drive."""
    return tuple(d for d in durations if d < 0.3 * (problem.stamp[-1] - problem.stamp[0]) * 1e-9)
