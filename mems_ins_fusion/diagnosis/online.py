"""Diagnosis while driving: the findings of `diagnose` from the last minutes, proven on the samples after them.

The samples come in chunks (`gathering.py`), each of which ends at a stamp of the IMU. The state after a chunk depends
only on the samples up to its end, live and in a replay. A finding of an analysis is *on trial* at first: two filters,
one with the present parameters and one with the finding, are run without fixes for 5, 10 and 30 s again and again, on
samples that neither the estimate nor the analysis has used. The fixes at the end of each outage decide a bet
(`filter/runs/betting.py`). The probability that a finding that does not help is ever proven is bounded, however often
this is repeated, and does not depend on the sigmas of the estimate or of the filters. The same test with the two
filters exchanged shows that a finding does harm.

With diagnosis.online `apply` a proven finding becomes part of the parameters that are used, and the filter without it
is run in the outages for comparison. A finding that was right for an hour may become wrong at any time (a driver
restarts, an antenna is moved), and the evidence of this hour must not delay its removal: the wealth against the finding
never falls below its initial value. If the finding is right, this wealth reaches 1 / a at most once in 1 / a outages
(J. Shin, A. Ramdas and A. Rinaldo, "E-detectors", New England J. of Statistics in Data Science 2, 2024).
"""
from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from ..effects.registry import effect_called
from ..errors import InputError
from ..filter.runs.changing import Dropped
from ..filter.runs.usable import usable
from ..parameters import table
from ..samples import Recording
from .advice import WORTH, Advice, advised
from .diagnose import diagnose
from .direct import direct_findings
from .estimate import Estimate, systematic
from .false_alarms import FalseAlarms
from .findings import Finding
from .gathering import CHUNK
from .held_out import HeldOut
from .quantity import (
    ALL,
    COARSE,
    FINE,
    INITIALISING,
    NOTHING,
    EarlierFinding,
    FilterFindings,
    FindingState,
    merged_settings,
)
from .trial import Trial
from .trial_outages import SETTLING, Predictions, has_estimate_alone, paired_errors
from .window import from_stamp, joined_recordings, jumps, last_seconds, seconds

#: s of samples before the first analysis. Chosen, not measured
FIRST = 120.0
#: growth of the kept samples, relative, until the next analysis of all of them; with a full window, one in each window.
#: Three minutes often show what two do not
MORE = 0.5
#: s, length of the latest samples that are analysed separately, and interval of these analyses: a change of the vehicle
#: is found in them first
LATEST = 240.0
#: s of samples between two looks if more than LATEST are kept and nothing is applied; otherwise there is one after each
#: chunk: what is applied and has become wrong is to go soon
LOOKED = 60.0
#: s, durations of outages by which analyses compare
ANALYSED = (10.0, 30.0)
#: s of CPU time for an analysis, besides that for the chunks; it takes 10 to 30 for some minutes at 100 Hz. Divided by
#: diagnosis.share, it is the time after which the result is used, live and in a replay
ANALYSIS = 60.0
#: end of the name of a value on trial if another value of the same effect is applied
OTHER = ', another value'
#: s, shortest chunk that is used: a shorter one has faulty stamps
SHORTEST = 1.0
#: s of samples before a trial in whose outages the correlation time of the errors is estimated
SEEN = 60.0
#: share of the wanted samples with which an analysis begins: between two chunks an interval is missing
NEARLY = 0.99

#: function from recording and parameters to findings
Find = Callable[[Recording, dict], list[Finding]]


class Abandoned(Exception):
    """Raised in an analysis (`Online.is_abandoned`) whose result is no longer needed."""


@dataclass
class Analysis:
    """An analysis that has begun. due: number of the chunk with whose answer the result is used, even if it is ready
    earlier. latest: whether it uses only the latest samples. trials: those at its begin. shown: findings of looks since
    then. findings: None until it is done. problem: why there are none."""

    part: Recording
    values: dict
    due: int
    latest: bool
    trials: dict[str, Trial]
    shown: set[str] = field(default_factory=set)
    findings: list[Finding] | None = None
    problem: str = ''


class Online:
    """The diagnosis of a vehicle whose filter has the checked parameters `values`.

    find: an analysis, from recording and parameters to findings; by default those that `diagnose` would add. look: a
    quick one without a filter, with the parameters that are applied; by default `direct_findings`. After each chunk
    while something is applied or at most LATEST s are kept, else each LOOKED s.
    kept: findings proven in an earlier drive, which are applied and are SUSPECT until they are proven again.

    An analysis takes longer than a chunk: its result is used with the answer to a later chunk, always the same one.
    `analyse` does it in advance; otherwise this chunk waits for it.
    """

    def __init__(self, values: dict, find: Find | None = None, look: Find | None = None,
                 kept: Sequence[EarlierFinding] = ()):
        self._values = {**values, 'bag': []}
        self._find, self._look = find or findings_in_recording, look or direct_findings
        self._applies = values['diagnosis.online'] == 'apply'
        self._length = values['diagnosis.window']
        self._wait = math.ceil(ANALYSIS / (CHUNK * values['diagnosis.share'])) - 1  # number of chunks for an analysis
        self._taken = self._concluded = 0  # numbers of chunks, and of analyses whose result has been used
        self._analysis: Analysis | None = None  # it has begun, and its result has not been used yet
        self._doing: Analysis | None = None
        self._window: Recording | None = None
        # s of samples since the last analysis, the last one of the latest ones, and the last look
        self._since = self._lately = self._unseen = 0.0
        self.trials: dict[str, Trial] = {}  # findings that are not applied
        self.applied: dict[str, Trial] = {}
        self._analyses = self._begins = 0  # number of analyses; ns, the first stamp
        self._false_alarms = FalseAlarms()
        self._why = ''
        self._as_given: dict[str, Finding] = {}  # parameters that looks have confirmed
        self._advice: dict[str, Advice] = {}  # manoeuvres that would show them better
        self._unadvised: list[Trial] = []  # trials that began with the newest answer
        for one in kept if self._applies else ():
            self.applied[one.name] = Trial(_known(one, one.parameters), one.sets, applied=True, kept=one,
                                           **self._false_alarms.next())

    @property
    def _due(self) -> float:
        """s of samples between two analyses of all samples that are kept."""
        later = FIRST * MORE * (1.0 + MORE) ** (self._analyses - 1)
        return min(later if self._analyses else FIRST, self._length)

    @property
    def _now(self) -> int:
        """Stamp of the newest sample, ns."""
        return 0 if self._window is None else int(self._window.imu.stamp[-1])

    @property
    def wanted(self) -> FilterFindings:
        """The findings for the filters."""
        tried = {name: trial.sets for name, trial in self.trials.items() if self._applies and not trial.rejected}
        doubted = frozenset(name for name, trial in self.applied.items() if not trial.seen)
        return FilterFindings({name: trial.sets for name, trial in self.applied.items()}, tried, doubted)

    @property
    def sets(self) -> dict:
        """Changes of the given parameters for the filter that drives."""
        return self._sets()

    def _sets(self, without: str = '') -> dict:
        return merged_settings(trial for name, trial in self.applied.items() if name != without)

    def take(self, chunk: Recording, dropped: Sequence[Dropped] = ()) -> list[FindingState]:
        """The findings after `chunk`, the samples since the previous one. dropped: findings that the filter has dropped
        in it."""
        self.advise()
        chunk = usable(chunk, self._values['imu.max_specific_force'], self._values['imu.max_angular_rate'])
        if seconds(chunk) < SHORTEST:
            return self.quantities()
        self._taken += 1
        if self._window is not None and jumps(self._window, chunk):
            self._window, self._since, self._lately, self._analysis = None, 0.0, 0.0, None
            self._as_given, self._advice = {}, {}
        if not self._begins:
            self._begins = int(chunk.imu.stamp[0])
            for trial in self.applied.values():
                trial.finding = _known(trial.kept, trial.kept.aged(self._begins))
        before, self._window = self._window, last_seconds(joined_recordings(self._window, chunk), self._length)
        self._since += seconds(chunk)
        self._lately += seconds(chunk)
        gone = [one for one in dropped if one.name in self.applied]
        if gone:
            self._begin_anew_since(gone)
        elif before is not None:
            self._try(chunk, before)
        self._unseen += seconds(chunk)
        shown = self._looked() if self._unseen >= NEARLY * self._between else []
        for finding in shown:
            self._put_on_trial(finding, latest=True, again=False)
        self._begin_analysis()
        if self._analysis is not None:
            self._analysis.shown |= {finding.name for finding in shown}
            if self._taken >= self._analysis.due:
                self._conclude()
        for name, trial in self.applied.items():
            trial.seen = name not in self.trials or self.trials[name].rejected
        if self._applies:
            self._take_back_harmful()
        return self.quantities()

    @property
    def _between(self) -> float:
        """s of samples from one look to the next."""
        return CHUNK if self.applied or seconds(self._window) <= LATEST else LOOKED

    def _looked(self) -> list[Finding]:
        """Findings of a look at the latest samples."""
        self._unseen = 0.0
        seen = self._look(self._window, {**self._values, **self.sets})
        off = {one.name for one in seen if one.added}
        self._as_given = {name: one for name, one in self._as_given.items() if name not in off}
        for one in seen:
            before = self._as_given.get(one.name)
            if not one.added and (before is None or one.says_more_than(before)):
                self._as_given[one.name] = one
        self._advice = {name: advice for name, advice in self._advice.items() if self._is_worth_saying(name)}
        return [one for one in seen if one.added]

    def _begin_analysis(self) -> None:
        """Begin an analysis that is due, of the latest samples or of all that are kept: the one that has waited longer
        relative to its interval. Only one runs at a time."""
        young = seconds(self._window) <= LATEST
        latest, whole = 0.0 if young else self._lately / LATEST, self._since / self._due
        if self._analysis is not None or max(latest, whole) < NEARLY:
            return
        part = self._window
        if latest >= NEARLY and latest >= whole:
            self._lately, part = 0.0, last_seconds(self._window, LATEST)
        else:
            self._since, self._lately = 0.0, 0.0 if young else self._lately
            self._analyses += 1
        self._analysis = Analysis(part, {**self._values, **self.sets}, self._taken + self._wait,
                                  young or part is not self._window, dict(self.trials))

    @property
    def is_awaited(self) -> bool:
        """Whether the next chunk needs the result of an analysis that is not done."""
        analysis = self._analysis
        return analysis is not None and analysis.findings is None and self._taken + 1 >= analysis.due

    @property
    def is_abandoned(self) -> bool:
        """Whether the result of the running analysis is no longer needed."""
        return self._doing is not None and self._doing is not self._analysis

    def analyse(self) -> None:
        """Do the analysis that has begun, if it is not done. The function that is called from time to time meanwhile
        may `take` the next chunk unless the result `is_awaited`, and raises Abandoned if it `is_abandoned`."""
        analysis = self._analysis
        if analysis is None or analysis.findings is not None:
            return
        self._doing = analysis
        try:
            analysis.findings = self._find(analysis.part, analysis.values)
        except InputError as error:
            analysis.findings, analysis.problem = [], str(error)
        except Abandoned:
            pass
        finally:
            self._doing = None

    def _conclude(self) -> None:
        """Put the findings of the analysis on trial. Trials that began after it are of later samples and continue."""
        self.analyse()
        analysis, self._analysis = self._analysis, None
        self._why = analysis.problem
        self._concluded += 1
        names = analysis.shown | {finding.name for finding in analysis.findings}
        before = {name for name, trial in self.trials.items() if analysis.trials.get(name) is trial}
        for name in before:
            trial = self.trials[name]
            trial.seen = name in names or (analysis.latest and trial.seen)
        since = int(analysis.part.imu.stamp[0])
        for finding in analysis.findings:
            if finding.name in before or finding.name not in self.trials:
                self._put_on_trial(replace(finding, since=since), analysis.latest)

    def _put_on_trial(self, finding: Finding, latest: bool, again: bool = True) -> None:
        """latest: as in `Analysis`. again: whether findings that have lost a trial may be tried again. A value that was
        applied before a change of the vehicle may come back with the next change."""
        name, driving, trial = finding.name, self.applied.get(finding.name), self.trials.get(finding.name)
        if driving is not None and not (latest and driving.differs(finding)):
            return
        lost = trial is not None and trial.rejected and (again or trial.harmful)
        if trial is None or lost or (latest and trial.differs(finding)):
            self.trials[name] = Trial(finding, finding.changes, **self._false_alarms.next())
            self._unadvised.append(self.trials[name])
        elif not trial.rejected and trial.is_refined_by(finding):
            trial.refine(finding)
            self._unadvised.append(trial)

    def advise(self) -> None:
        """Find manoeuvres that would show the findings with new trials better, else one of the parameters that are not
        confirmed with certainty. The advice is part of the next answer. If it has not been found before the next chunk,
        this chunk does it, which takes several times as long as the answer itself."""
        for trial in self._unadvised:
            trial.advice = advised(trial.finding, self._window, {**self._values, **self.sets})
        # in the first minutes all time is used for looks and trials
        name = next((name for name in self._unsettled if name not in self._advice), None)
        if not self._unadvised and name is not None and seconds(self._window) > LATEST:
            self._advice[name] = advised(_not_seen_as_usual(self._as_given[name]), self._window,
                                         {**self._values, **self.sets})
        self._unadvised = []

    @property
    def _unsettled(self) -> list[str]:
        """Parameters that looks have confirmed, but not with certainty."""
        return [name for name, one in self._as_given.items()
                if not (one.settled or name in self.trials or name in self.applied)]

    def _is_worth_saying(self, name: str) -> bool:
        """Whether the advice on a confirmed parameter is still useful: its sigma has not become as small anyway."""
        one, advice = self._as_given.get(name), self._advice[name]
        if one is None or one.settled:
            return False
        now = one.parameters.get(advice.parameter) if advice else None
        return now is None or now.sigma > WORTH * advice.now

    @property
    def begun(self) -> int:
        """Number of trials so far."""
        return self._false_alarms.begun

    def _try(self, chunk: Recording, before: Recording) -> None:
        """Run the outages of `chunk` with the present filter and with that of each trial. before: the window without
        it."""
        running = [trial for trial in self.trials.values() if not trial.rejected]
        if not (running or self.applied) or not len(chunk.gnss):
            return
        values, known = {**self._values, **self.sets}, {}
        compared = [(trial, values, {**values, **trial.sets}) for trial in running]
        compared += [(trial, {**self._values, **self._sets(without=name)}, values)
                     for name, trial in self.applied.items()]
        for trial, *both in compared:
            latest = last_seconds(before, SEEN)
            if not trial.taken and len(latest.gnss):  # for the correlation time of the errors
                trial.see(paired_errors(*_outages(trial, both, before, latest, {})))
            present, other = _outages(trial, both, self._window, chunk, known)
            trial.take(paired_errors(present, other), self._now, alone=has_estimate_alone(other, present))
        self._false_alarms.pass_on((*self.trials.values(), *self.applied.values()))
        if self._applies:
            self._decide()

    def _decide(self) -> None:
        """Apply a proven finding, or remove a harmful one; one at a time, as each changes the filters that others are
        compared with."""
        proven = next((name for name, trial in self.trials.items() if trial.proven), None)
        if proven not in self.applied and self._take_back_harmful():
            return
        if proven in self.applied:  # the proven value replaces the applied one
            self._window = last_seconds(self._window, LATEST)
        if proven is not None:
            self._apply(proven)

    def _take_back_harmful(self) -> bool:
        """Remove an applied finding that does harm; returns whether there is one."""
        harmful = next((name for name, trial in self.applied.items() if trial.rejected), None)
        if harmful is not None:
            self._take_back(harmful)
            # earlier samples are those of the vehicle before the change
            self._window = last_seconds(self._window, LATEST)
        return harmful is not None

    def _take_back(self, name: str) -> None:
        """Remove the finding of this name from the parameters that are used."""
        self._as_given, self._advice = {}, {}  # these also belong to the vehicle before the change
        trial = self.applied.pop(name)
        trial.applied, trial.proven, trial.harmful, trial.kept = False, False, True, None
        self.trials[name] = trial  # another value on trial was relative to this one
        self._changed_by(trial)

    def _apply(self, name: str) -> None:
        """Add the finding of this name to the parameters that are used."""
        trial = self.applied[name] = self.trials.pop(name)
        trial.apply(self._now)
        self._changed_by(trial)

    def _changed_by(self, trial: Trial) -> None:
        """The parameters that are used have changed: a running analysis and the results of the other trials refer to
        the earlier ones."""
        self._analysis = None
        if effect_called(trial.finding.name).held(self._values) != self._values:
            return  # each of the filters estimates it, so the predictions have not changed
        for other in (*self.trials.values(), *self.applied.values()):
            if other is not trial:
                other.begin_anew()

    def _begin_anew_since(self, dropped: Sequence[Dropped]) -> None:
        """Begin anew after a change of the vehicle, because of which the filter has dropped a finding."""
        for one in dropped:
            self._take_back(one.name)
            self.trials[one.name].begin_anew()
        since = max(one.since for one in dropped)
        self._window = last_seconds(self._window, (int(self._window.imu.stamp[-1]) - since) * 1e-9)
        self._since = self._lately = seconds(self._window)
        self._analyses = self._concluded = 0

    def accept(self) -> list[FindingState]:
        """Apply all findings on trial that have not been shown to do harm, on request of the user."""
        for name in [name for name, trial in self.trials.items() if not trial.rejected]:
            self._apply(name)
        return self.quantities()

    def reject(self) -> list[FindingState]:
        """Remove all applied findings and end all trials, on request of the user. A finding may be tried again later.
        """
        self.trials, self.applied, self._analysis, self._unadvised = {}, {}, None, []
        return self.quantities()

    def reset(self) -> list[FindingState]:
        """Forget everything except the number of trials, as after work on the vehicle."""
        self._window, self._since, self._lately, self._analyses, self._concluded = None, 0.0, 0.0, 0, 0
        self._as_given, self._advice = {}, {}
        return self.reject()

    def quantities(self) -> list[FindingState]:
        """The present findings, or one entry with the name `all`; and one for each confirmed parameter."""
        now = self._now
        told = [trial.quantity(now, name) for name, trial in self.applied.items()]
        told += [trial.quantity(now, f'{name}{OTHER if name in self.applied else ""}')
                 for name, trial in self.trials.items()]
        as_given = [as_given_quantity(now, one, self._advice.get(name)) for name, one in self._as_given.items()
                    if name not in self.trials and name not in self.applied]
        if told:
            return told + as_given
        if self._window is None:
            return []
        if self._concluded:
            return [FindingState(now, ALL, NOTHING, {}, text=f'nothing found in {self._concluded} analyses'
                                 f"{f' ({self._why})' if self._why else ''}"), *as_given]
        if self._analysis is None:
            text = f'{self._since:.0f} of {self._due:.0f} s of samples for a first analysis'
        else:
            left = (self._analysis.due - self._taken) * CHUNK
            text = f'a first analysis goes on, told in {left:.0f} s; the latest minutes are looked at meanwhile'
        return [FindingState(now, ALL, INITIALISING, {}, text=text), *as_given]


def _outages(trial: Trial, both: list[dict], window: Recording, chunk: Recording, known: dict) -> list[dict]:
    """What the filters with `both` parameters predict in the outages of `chunk`, at the end of `window`, each as of
    `trial_outages.predicted`. known: predictions of this chunk, by the first sample of the filters."""
    part, effect = last_seconds(window, SETTLING + seconds(chunk)), effect_called(trial.finding.name)
    # with samples from before a change, the filter that is right after it would start with errors
    since = max(trial.finding.since, int(part.imu.stamp[0]))
    predictions = known.setdefault(since, Predictions(from_stamp(part, since), chunk))
    lasting = effect.lasting(both[-1])
    return [{d: outages if d >= lasting else {} for d, outages in predictions.of(effect.held(one)).items()}
            for one in both]


def as_given_quantity(now: int, one: Finding, advice: Advice | None) -> FindingState:
    """A confirmed parameter in words. now: ns, stamp of the newest sample."""
    left = ', '.join(f'{parameter} {e.text()}' for parameter, e in one.parameters.items())
    return FindingState(now, one.name, FINE if one.settled else COARSE if left else INITIALISING, one.parameters,
                        text=f'{left} left of what is given' if left else 'does not show in what was driven so far',
                        advice=advice.text() if advice else '')


def _not_seen_as_usual(one: Finding) -> Finding:
    """`one` with the usual size as the sigma of parameters that have not been observed at all."""
    usual = {p.name: Estimate(0.0, p.prior_scale, p.unit) for p in effect_called(one.name).traced}
    return replace(one, parameters={**usual, **one.parameters})


def _known(kept: EarlierFinding, parameters: dict) -> Finding:
    """A finding of an earlier drive, with the parameters of the effect for now."""
    return Finding(kept.name, [kept.name], parameters, 0.0, 0.0, True, HeldOut(0.0, 1.0, []), changes=kept.sets)


def findings_in_recording(recording: Recording, values: dict,
                          progress: Callable = lambda part, what: None) -> list[Finding]:
    """Findings of `diagnose` in `recording` that it proves there, and contradictions to parameters."""
    return [replace(f, least=systematic(f.parameters)) for f in diagnose(
        recording, values, progress, durations=ANALYSED).findings if f.added and f.changes]


def warm_up(recording: Recording) -> None:
    """Load the compiled functions of looks, outages and analyses, or compile them, by using them on `recording`, about
    a minute of a drive."""
    values = table.check({'imu.lever_arm': [1.0, 0.0, 0.0]})  # the effect with compiled functions of its own
    direct_findings(recording, values)
    Predictions(recording, last_seconds(recording, CHUNK)).of(values)
