"""Close the loop: the diagnosis of recordings, from the first filter to parameters that are proven (DESIGN, 5)."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects.aiding_time_offset import SeveralTimeOffsets
from ..effects.base import Effect
from ..filter.runs.usable import usable
from ..recordings.several import one_after_another
from ..samples import Recording
from .clock import reference_clock_of
from .conclusion import concluded
from .drives import Drives, problems
from .findings import Diagnosis
from .problem import DiagnosisError
from .search import (
    add_best,
    begin,
    with_offset_known_better,
    with_other_mechanization,
    without_superseded,
    without_undetermined,
)
from .starts import TIME_OFFSET, other_starts, shown_without_filter
from .trial_runs import Progress, TrialRuns

#: fewer innovations than this decide nothing
FEWEST_FIXES = 60
MOST_ROUNDS = 6  # of a search, each of which may add an effect
#: errors are measured no more often than this, s
REFERENCE_INTERVAL = 0.1


def diagnose(recordings: Recording | Sequence[Recording], values: dict, progress: Progress = lambda part, what: None,
             effects: Sequence[Effect] | None = None, durations=(10.0, 30.0, 60.0), spacing: float = 30.0) -> Diagnosis:
    """Diagnose `recordings`, one or several of one vehicle, as filtered with `values` (checked parameters).

    effects: the candidates, by default all there are, those of named inputs too. Raises DiagnosisError where no
    recording can be diagnosed at all. `progress` is called often, with the part of the work done and what it is.
    """
    told: tuple = (0.0, '')

    def tell(*now) -> None:
        nonlocal told
        told = now
        progress(*now)

    tell(0.02, 'filtering')
    given = [recordings] if isinstance(recordings, Recording) else list(recordings)
    given = [usable(r, values['imu.max_specific_force'], values['imu.max_angular_rate']) for r in given]
    for recording in given:
        if len(recording.imu) < 2 or not len(recording.gnss):
            raise DiagnosisError(f'{recording.name}: no {"fix" if len(recording.imu) > 1 else "IMU sample"} that could '
                                 'be used')
    thinned = [_thinned(recording) for recording in one_after_another(given)]
    shown = shown_without_filter(thinned, values)
    others = other_starts(shown.track, values)
    found, left_out = problems(thinned, values, FEWEST_FIXES, others)
    thinned = [recording for recording in thinned if recording.name not in left_out]
    for problem, recording in zip(found, thinned):
        problem.reference_clock = reference_clock_of(recording, values['reference_clock']).name
    library = tuple(effects if effects is not None else shown.effects(values))
    sizes = {'gnss_time_offset': [{'time_offset': other[TIME_OFFSET] - values[TIME_OFFSET]} for other in others],
             **{f'{name}_time_offset': [{'time_offset': left.value}] for name, left in shown.clocks.items()},
             **{f'{name}_lag': [{'delay': shown.clocks[name].value, 'tau': one.tau}]
                for name, one in shown.low_passes.items()},
             **{effect.name: [{'share': 1.0}] for effect in library if isinstance(effect, SeveralTimeOffsets)}}
    trials = TrialRuns(tuple(thinned), Drives(found), library, tuple(durations), spacing, tell,
                       sizes, shown, working=lambda: progress(*told))
    first = begin(trials)
    known = with_other_mechanization(first, trials)
    for _ in range(MOST_ROUNDS):
        further = add_best(known, trials)
        found_none = len(further.chosen) == len(known.chosen)
        # what was in the way of another mechanization may be out of it now
        known = with_other_mechanization(further, trials) if further.model is not known.model else further
        if found_none or trials.enough():
            break
    known = without_undetermined(without_superseded(known, trials), trials)
    known = with_offset_known_better(known, trials)
    return replace(concluded(known, trials), left_out=left_out)


def _thinned(recording: Recording) -> Recording:
    """With no more of the reference than errors are measured at."""
    if recording.reference is None:
        return recording
    slot = (recording.reference.stamp - recording.reference.stamp[0]) // round(REFERENCE_INTERVAL * 1e9)
    return replace(recording, reference=recording.reference.select(np.unique(slot, return_index=True)[1]))
