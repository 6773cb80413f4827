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
from .folds import parts
from .measured import Measured, measure, together
from .outliers import without_far_off
from .problem import Problem, on_all_cores
from .starts import Shown

#: IMU samples filtered after which a search begins no further round: less than a minute on two cores, whatever the
#: recording, and the same result on each machine
ENOUGH = 9_000_000
#: outages that decisions on effects are made on, about
FEW_OUTAGES = 40
#: s between two of them at least
CLOSEST_OUTAGES = 10.0
#: share of the usual time after which the search begins
SEARCHING = 0.05
#: the same of the choice of noise levels
CHOOSING = 0.6
#: the same of measuring errors
MEASURING = 0.88
#: the same of looking at what is left
LOOKING = 0.95
#: filters that are tried in the choice of noise levels, usually
USUAL_CHOICES = 15

#: what errors are measured for
FOR_EFFECTS, FOR_LEVELS, REPORTED = 'decisions on effects', 'the choice of noise levels', 'the report'

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class TrialRuns:
    """Trial runs of filters over the recordings: what errors they make.

    recordings: with all fixes, as many as the problem has drives. offset_sigma: gnss.time_offset_sigma as given, which
    the search does without. starts: sizes of effects, by name, from which they are fitted, too. beside: what the
    recordings show without a filter. working: called between two steps of the work where there is nothing to tell.
    """

    recordings: tuple[Recording, ...]
    origin: Drives
    library: tuple[Effect, ...]
    durations: tuple[float, ...]
    spacing: float
    tell: Progress
    offset_sigma: float
    starts: dict[str, list[dict[str, float]]] = field(default_factory=dict)
    beside: Shown = Shown()
    working: Callable[[], None] = lambda: None
    measured: dict[str, Measured] = field(default_factory=dict)  # by the filters asked for

    @cached_property
    def judging(self) -> tuple[Recording, ...]:
        """The recordings for the truth: where that are the fixes, a fix that is far off is none."""
        return tuple(replace(r, gnss=without_far_off(r.gnss)) for r in self.recordings)

    @cached_property
    def shown(self) -> dict[str, Estimate]:
        """What the recordings show without a filter of parameters of effects, `effect.parameter`, beyond the parameters
        as given."""
        found = {} if self.turned is None else {'gyroscope_scale.z': self.turned}
        track = self.beside.track
        if track is not None and track.shown:
            lag = track.smoothing - self.origin.given['gnss.lag_per_acceleration']
            found['gnss_lag.lag'] = Estimate(lag, track.smoothing_sigma, 's^2')
        left = {f'{name}.time_offset': one for name, one in self._left.items()}
        return found | {name: Estimate(one.value, one.sigma, 's') for name, one in left.items()}

    @property
    def _left(self) -> dict[str, Remaining]:
        """What the parameters as given leave of each time offset that is shown, by its effect."""
        left = {f'{name}_time_offset': clock for name, clock in self.beside.clocks.items()}
        track = self.beside.track
        if track is not None and track.shown:
            lag = track.lag - self.origin.given['gnss.time_offset']
            left['gnss_time_offset'] = Remaining(TIME_OFFSET, lag, track.lag_sigma)
        return left

    @property
    def certain(self) -> tuple[str, ...]:
        """Time offsets that the recordings show for certain without a filter, beside the parameters as given: those of
        several inputs together first."""
        together = [effect.name for effect in self.library if isinstance(effect, SeveralTimeOffsets)]
        return (*together, *(name for name, left in self._left.items() if left.certain(SMALL_OFFSET, SURE)))

    def told(self, name: str, sizes: dict[str, Estimate]) -> dict[str, Estimate]:
        """The `sizes` of an effect that is not added: what the recordings show for certain has one size everywhere."""
        return {n: self.shown.get(f'{name}.{n}', e) for n, e in sizes.items()} if name in self.certain else sizes

    def unset(self, added: Sequence[str]) -> tuple[str, ...]:
        """The inputs besides the fixes whose clocks are off for certain and which none of the effects `added` sets."""
        several = {name for effect in self.library if isinstance(effect, SeveralTimeOffsets) and effect.name in added
                   for name in effect.known}
        return tuple(name for name in self.beside.late if name not in several and f'{name}_time_offset' not in added)

    @cached_property
    def turned(self) -> Estimate | None:
        """By which part the gyroscopes turn further than the course of the fixes, beyond the scale in the parameters;
        None where no turn tells."""
        up = -mounting(self.origin.given['imu.mounting_rpy'])[2]
        seen = [usable(recording) for recording in self.judging]
        found = [compare_steering(recording.imu, recording.gnss, up) for recording in seen if len(recording.gnss) > 1]
        found = [steering for steering in found if steering is not None and steering.tells and steering.scale > 0.0]
        if not found or any(self.origin.given['gyroscope.scale']):
            return None
        value, sigma = weighted(*np.array([steering.turned for steering in found]).T)
        return Estimate(float(value) - 1.0, float(sigma), '-')

    @property
    def without_standstills(self) -> dict[str, bool]:
        """The parameter that leaves standstills out, where the parameters as given use them and a drive cannot tell
        them from motion; else none."""
        name = 'vehicle.zero_velocity'
        used = self.origin.given[name] and not all(problem.values[name] for problem in self.origin.each)
        return {name: False} if used else {}

    @property
    def switches(self) -> tuple[str, ...]:
        """The settings that are tried the other way round: noise from what samples scatter, as what a sensor filters
        before it samples, and what swings about a mean, adds up to nothing; and standstills, where the parameters as
        given do without, or a drive cannot tell them from motion."""
        doubtful = not all(problem.values['vehicle.zero_velocity'] for problem in self.origin.each)
        scatter = self.origin.given['mechanization'] == 'strapdown'
        return (*(['imu.adapt_noise'] if scatter else []), *(['vehicle.zero_velocity'] if doubtful else []))

    def enough(self, share: float = 1.0) -> bool:
        """Whether this share of the work of a search is done."""
        return self.done > share

    @property
    def done(self) -> float:
        """The share of the most that there may be to do that is done."""
        return self.origin.work / (ENOUGH * len(self.recordings))

    def searching(self, what: str) -> None:
        """Tell what is being done, now and after each batch of work."""
        def tell():
            self.tell(SEARCHING + (CHOOSING - SEARCHING) * min(1.0, self.done), what)
        tell()
        self.origin.watched(tell)

    def errors(self, models: Sequence[dict], full: bool = False) -> Measured:
        """Of one filter, or of those fitted to all parts but one, in these parts.

        full: as they drive, by the protocol that is reported; else for decisions on effects. These look at the
        covariance as the model has it: scaled by what innovations show, it would hold the truth whatever the model
        lacks; and the samples are means, between which a motion is not smooth enough to tell noise from it. Standstills
        that cannot be told from motion keep positions near whatever is right or wrong else.
        """
        decides = {} if full else {'gnss.adapt_covariance': False, 'imu.adapt_noise': False, **self.without_standstills}
        return self._kept([{**values, **decides} for values in models], REPORTED if full else FOR_EFFECTS)

    def each(self, configurations: Sequence[dict]) -> list[Measured]:
        """Of several filters as they drive, for the choice of noise levels: a filter that adapts to nothing asks for
        levels that one that does has no use for."""
        found = on_all_cores(lambda values: self._kept([values], FOR_LEVELS), configurations)
        count = len(self.measured)
        self.tell(CHOOSING + (MEASURING - CHOOSING) * count / (count + USUAL_CHOICES), 'choosing noise levels')
        return found

    def _kept(self, models: list[dict], use: str) -> Measured:
        models = [{**values, 'gnss.time_offset_sigma': self.offset_sigma} for values in models]
        asked = repr((use, [sorted(values.items()) for values in models]))
        if asked not in self.measured:
            self.measured[asked] = self._measured(models, use)
        return self.measured[asked]

    def _measured(self, models: list[dict], use: str) -> Measured:
        judged = parts(self.origin) if len(models) > 1 else [self.origin.mask]
        found = {}
        for recording, judging, problem, where in zip(self.recordings, self.judging, self.origin.each,
                                                      self.origin.slices):
            mine = [(values, mask[where]) for values, mask in zip(models, judged) if mask[where].any()]
            found[recording.name] = measure(
                problem, judging, (problem.drive if use == FOR_EFFECTS else problem.full).imu,
                [values for values, _ in mine], fitting(self.durations, problem), self._between(problem, use),
                [mask for _, mask in mine], self.working)
        return together(found)

    def _between(self, problem: Problem, use: str) -> float:
        """s between outages. Noise levels are chosen in as many as are reported, as a long drive tells more of them."""
        few = max(CLOSEST_OUTAGES, float(np.ptp(problem.stamp[problem.mask])) * 1e-9 / FEW_OUTAGES)
        return {FOR_EFFECTS: few, FOR_LEVELS: min(few, max(CLOSEST_OUTAGES, self.spacing)), REPORTED: self.spacing}[use]


def fitting(durations: Sequence[float], problem: Problem) -> tuple[float, ...]:
    """The durations of outages, s, of which a drive holds enough."""
    return tuple(d for d in durations if d < 0.3 * (problem.stamp[-1] - problem.stamp[0]) * 1e-9)
