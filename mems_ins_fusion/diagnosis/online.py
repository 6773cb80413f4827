"""The diagnosis of a vehicle while it drives: what `diagnose` finds in the last minutes, proven on what comes after.

The samples come in chunks (`gathering.py`), of which each ends at a stamp of the IMU: what is said after a chunk
depends on nothing but the samples until then, live and in a replay. What an analysis finds is on trial from then on:
two filters, with the parameters as they are and with the finding, go without fixes for 5, 10 and 30 s again and again
through samples that neither the estimate nor the analysis has seen. What the fixes at the end of each outage say of the
two is a bet (`filter/runs/betting.py`): a finding that does not help is proven with a probability that is bounded
however often one looks, and no sigma is asked, neither of the estimate nor of the filters. The same with the two
filters changed over says that a finding does harm.

With diagnosis.online `apply` a proven finding becomes part of the parameters that drive, and the filter without it goes
through the outages beside. What was true for an hour may be wrong from one minute to the next (a driver that restarts,
an antenna that is moved), and an hour of good outages must not have to be lost first: the wealth against it never falls
below what it began with. Where the finding does good, such a wealth comes to 1 / a once in 1 / a outages at most (J.
Shin, A. Ramdas and A. Rinaldo, "E-detectors", New England J. of Statistics in Data Science 2, 2024).
"""
from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from ..effects.registry import effect_called
from ..errors import InputError
from ..filter.runs.changing import Dropped
from ..filter.runs.usable import usable
from ..samples import Recording
from .advice import WORTH, Advice, advised
from .diagnose import diagnose
from .direct import looked
from .estimate import Estimate, systematic
from .false_alarms import FalseAlarms
from .findings import Finding
from .gathering import CHUNK
from .held_out import HeldOut
from .quantity import ALL, COARSE, FINE, INITIALISING, NOTHING, Findings, Kept, Quantity, together
from .trial import DOUBTED, Trial
from .trial_outages import SETTLING, Predictions, pairs
from .window import behind, cut, joined, jumps, seconds

#: s of samples before the first analysis
FIRST = 120.0
#: the next ones of all that is kept come when there is so much more, as a part of what there was, then each window:
#: what two minutes do not show, three often do
MORE = 0.5
#: s: the latest samples are analysed as often, and as many of them: a change shows there first
LATEST = 240.0
#: s of samples from one look to the next where more than LATEST are kept; else there is one after each chunk
LOOKED = 60.0
#: s without fixes, that the analyses judge by
ANALYSED = (10.0, 30.0)
#: s of a core that an analysis takes at most, beside what the chunks take anyway: 10 to 30 of some minutes at 100 Hz.
#: With diagnosis.share of it that is the time after which its result counts, live and in a replay
ANALYSIS = 60.0
#: behind the name of a value on trial where another one of the same effect is applied
OTHER = ', another value'
#: s: a chunk that is shorter is of samples with wild stamps
SHORTEST = 1.0
#: s of samples before a trial whose outages show for how long errors last
SEEN = 60.0
#: part of the samples before an analysis that are there: the first stamp of a chunk is not the last of the one before
NEARLY = 0.99

#: recording and parameters to what is found there
Find = Callable[[Recording, dict], list[Finding]]


class Abandoned(Exception):
    """Raised in an analysis by who does it (`Online.is_abandoned`): nobody wants its result any more."""


@dataclass
class Analysis:
    """An analysis that has begun. due: number of the chunk with whose answer the result counts, whenever that is there.
    latest: whether it is of the latest samples alone. trials: what was on trial when it began. shown: what looks have
    found since. findings: None until it is done. problem: why there are none."""

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

    find: an analysis, recording and parameters to findings; by default what `diagnose` would add. look: the same
    without a filter, each LOOKED s, and what is as given; by default `looked`. kept: what an earlier drive has proven;
    it drives, and is SUSPECT until it is proven again.

    An analysis takes longer than the chunks wait for: its result counts with the answer to a later chunk, the same one
    whenever it is there. `analyse` does it before; else that chunk waits for it.
    """

    def __init__(self, values: dict, find: Find | None = None, look: Find | None = None, kept: Sequence[Kept] = ()):
        self._values, self._find, self._look = {**values, 'bag': []}, find or found, look or looked
        self._applies = values['diagnosis.online'] == 'apply'
        self._length = values['diagnosis.window']
        self._wait = math.ceil(ANALYSIS / (CHUNK * values['diagnosis.share'])) - 1  # chunks, of an analysis
        self._taken = self._concluded = 0  # chunks, and analyses whose result counts
        self._analysis: Analysis | None = None  # which has begun, and whose result does not count yet
        self._doing: Analysis | None = None
        self._window: Recording | None = None
        # s of samples since the last analysis, the last one of the latest ones, and the last look
        self._since = self._lately = self._unseen = 0.0
        self.trials: dict[str, Trial] = {}  # of what is not applied
        self.applied: dict[str, Trial] = {}
        self._analyses = self._begins = 0  # number of analyses; ns, the first stamp
        self._false_alarms = FalseAlarms()
        self._why = ''
        self._as_given: dict[str, Finding] = {}  # what looks have shown that is not off for certain
        self._advice: dict[str, Advice] = {}  # what would show more of that
        self._unadvised: list[Trial] = []  # those that came on trial with the newest answer
        for one in kept if self._applies else ():
            self.applied[one.name] = Trial(_known(one, one.parameters), one.sets, applied=True, kept=one,
                                           **self._false_alarms.next())

    @property
    def _due(self) -> float:
        """s of samples from one analysis of all that is kept to the next."""
        later = FIRST * MORE * (1.0 + MORE) ** (self._analyses - 1)
        return min(later if self._analyses else FIRST, self._length)

    @property
    def _now(self) -> int:
        """Stamp of the newest sample, ns."""
        return 0 if self._window is None else int(self._window.imu.stamp[-1])

    @property
    def wanted(self) -> Findings:
        """What the filters should have."""
        tried = {name: trial.sets for name, trial in self.trials.items() if self._applies and not trial.rejected}
        return Findings({name: trial.sets for name, trial in self.applied.items()}, tried)

    @property
    def sets(self) -> dict:
        """Parameters that it should have, beside those that it was given."""
        return self._sets()

    def _sets(self, without: str = '') -> dict:
        return together(trial for name, trial in self.applied.items() if name != without)

    def take(self, chunk: Recording, dropped: Sequence[Dropped] = ()) -> list[Quantity]:
        """What is known after `chunk`, the samples since the one before it. dropped: what the filter that drives has
        dropped in it."""
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
        before, self._window = self._window, cut(joined(self._window, chunk), self._length)
        self._since += seconds(chunk)
        self._lately += seconds(chunk)
        gone = [one for one in dropped if one.name in self.applied]
        if gone:
            self._begin_anew_since(gone)
        elif before is not None:
            self._try(chunk, before)
        self._unseen += seconds(chunk)
        shown = self._looked() if self._unseen >= NEARLY * self._between or self._is_doubted else []
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
        return CHUNK if seconds(self._window) <= LATEST else LOOKED

    @property
    def _is_doubted(self) -> bool:
        """Whether what is applied would be taken back if the last minutes showed another value: a look decides it."""
        return self._applies and any(trial.seen and trial.harm >= DOUBTED for trial in self.applied.values())

    def _looked(self) -> list[Finding]:
        """What a look at the latest samples shows to be off."""
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
        """Begin one where one is due, of the latest samples or of all that is kept, whichever has waited longer as a
        part of its interval; one after the other."""
        young = seconds(self._window) <= LATEST
        latest, whole = 0.0 if young else self._lately / LATEST, self._since / self._due
        if self._analysis is not None or max(latest, whole) < NEARLY:
            return
        part = self._window
        if latest >= NEARLY and latest >= whole:
            self._lately, part = 0.0, cut(self._window, LATEST)
        else:
            self._since, self._lately = 0.0, 0.0 if young else self._lately
            self._analyses += 1
        self._analysis = Analysis(part, {**self._values, **self.sets}, self._taken + self._wait,
                                  young or part is not self._window, dict(self.trials))

    @property
    def is_awaited(self) -> bool:
        """Whether the next chunk needs the result of an analysis that is not there."""
        analysis = self._analysis
        return analysis is not None and analysis.findings is None and self._taken + 1 >= analysis.due

    @property
    def is_abandoned(self) -> bool:
        """Whether nobody wants the result of the analysis that is being done any more."""
        return self._doing is not None and self._doing is not self._analysis

    def analyse(self) -> None:
        """Do the analysis that has begun, where there is one that is not done. What is called from time to time while
        it goes on may `take` the next chunk unless the result `is_awaited`, and raises Abandoned where it
        `is_abandoned`."""
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
        """Trials of what the analysis has found. What came on trial since it began is of later samples, and stays."""
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
        """latest: as of `Analysis`. again: what has lost on trial may be tried once more. What drove until a change may
        come back with the next one."""
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
        """Find what would show more of what came on trial with the newest answer, else of what has not been seen well
        enough yet. It is told with the next one, whose
        chunk does it where nobody has before: it takes several times as long as the answer itself."""
        for trial in self._unadvised:
            trial.advice = advised(trial.finding, self._window, {**self._values, **self.sets})
        # in the first minutes all time goes into looks and trials
        name = next((name for name in self._unsettled if name not in self._advice), None)
        if not self._unadvised and name is not None and seconds(self._window) > LATEST:
            self._advice[name] = advised(_not_seen_as_usual(self._as_given[name]), self._window,
                                         {**self._values, **self.sets})
        self._unadvised = []

    @property
    def _unsettled(self) -> list[str]:
        """What is as given as far as looks show, and not for certain."""
        return [name for name, one in self._as_given.items()
                if not (one.settled or name in self.trials or name in self.applied)]

    def _is_worth_saying(self, name: str) -> bool:
        """Whether the advice on what is as given still is: not where its sigma has become as small anyway."""
        one, advice = self._as_given.get(name), self._advice[name]
        if one is None or one.settled:
            return False
        now = one.parameters.get(advice.parameter) if advice else None
        return now is None or now.sigma > WORTH * advice.now

    @property
    def begun(self) -> int:
        """How many trials there have been."""
        return self._false_alarms.begun

    def _try(self, chunk: Recording, before: Recording) -> None:
        """The outages of `chunk` through the present filter, and through that of each trial. before: the window without
        it."""
        running = [trial for trial in self.trials.values() if not trial.rejected]
        if not (running or self.applied) or not len(chunk.gnss):
            return
        values, known = {**self._values, **self.sets}, {}
        compared = [(trial, values, {**values, **trial.sets}) for trial in running]
        compared += [(trial, {**self._values, **self._sets(without=name)}, values)
                     for name, trial in self.applied.items()]
        for trial, *both in compared:
            latest = cut(before, SEEN)
            if not trial.taken and len(latest.gnss):  # for how long errors last, before anything is staked
                trial.see(_outages(trial, both, before, latest, {}))
            trial.take(_outages(trial, both, self._window, chunk, known), self._now)
        self._false_alarms.pass_on((*self.trials.values(), *self.applied.values()))
        if self._applies:
            self._decide()

    def _decide(self) -> None:
        """Apply what is proven, and take back what does harm; one at a time, as each changes what others compare."""
        proven = next((name for name, trial in self.trials.items() if trial.proven), None)
        if proven not in self.applied and self._take_back_harmful():
            return
        if proven in self.applied:  # another value is proven, which takes its place
            self._window = cut(self._window, LATEST)
        if proven is not None:
            self._apply(proven)

    def _take_back_harmful(self) -> bool:
        """Take back one of those applied that does harm; whether there is one."""
        harmful = next((name for name, trial in self.applied.items() if trial.rejected), None)
        if harmful is not None:
            self._take_back(harmful)
            self._window = cut(self._window, LATEST)  # what came before the change is of another vehicle
        return harmful is not None

    def _take_back(self, name: str) -> None:
        """Have the trial of this name no longer in the parameters that drive."""
        self._as_given, self._advice = {}, {}  # of the vehicle as it was, too
        trial = self.applied.pop(name)
        trial.applied, trial.proven, trial.harmful, trial.kept = False, False, True, None
        self.trials[name] = trial  # another value on trial is what was left beside this one
        self._changed_by(trial)

    def _apply(self, name: str) -> None:
        """Have the trial of this name in the parameters that drive."""
        trial = self.applied[name] = self.trials.pop(name)
        trial.apply(self._now)
        self._changed_by(trial)

    def _changed_by(self, trial: Trial) -> None:
        """The parameters that drive are others: an analysis that goes on is of those before, and so is what the other
        trials have shown."""
        self._analysis = None
        if effect_called(trial.finding.name).held(self._values) != self._values:
            return  # each of the filters estimates it, and predicts as before
        for other in (*self.trials.values(), *self.applied.values()):
            if other is not trial:
                other.begin_anew()

    def _begin_anew_since(self, dropped: Sequence[Dropped]) -> None:
        """The vehicle is another one since the filter has dropped what was right before."""
        for one in dropped:
            self._take_back(one.name)
            self.trials[one.name].begin_anew()
        since = max(one.since for one in dropped)
        self._window = cut(self._window, (int(self._window.imu.stamp[-1]) - since) * 1e-9)
        self._since = self._lately = seconds(self._window)
        self._analyses = self._concluded = 0

    def accept(self) -> list[Quantity]:
        """Apply all that is on trial and has not been shown to do harm, as a user asks."""
        for name in [name for name, trial in self.trials.items() if not trial.rejected]:
            self._apply(name)
        return self.quantities()

    def reject(self) -> list[Quantity]:
        """Take back all that is applied, and end all trials, as a user asks; what is found again is tried again."""
        self.trials, self.applied, self._analysis, self._unadvised = {}, {}, None, []
        return self.quantities()

    def reset(self) -> list[Quantity]:
        """Forget all but how many trials there have been, as after work on the vehicle."""
        self._window, self._since, self._lately, self._analyses, self._concluded = None, 0.0, 0.0, 0, 0
        self._as_given, self._advice = {}, {}
        return self.reject()

    def quantities(self) -> list[Quantity]:
        """What is known now, one for each finding, or one of the name `all`; and one for each quantity that is as given
        as far as looks show."""
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
            return [Quantity(now, ALL, NOTHING, {}, text=f'nothing found in {self._concluded} analyses'
                             f"{f' ({self._why})' if self._why else ''}"), *as_given]
        if self._analysis is None:
            text = f'{self._since:.0f} of {self._due:.0f} s of samples for a first analysis'
        else:
            left = (self._analysis.due - self._taken) * CHUNK
            text = f'a first analysis goes on, told in {left:.0f} s; the latest minutes are looked at meanwhile'
        return [Quantity(now, ALL, INITIALISING, {}, text=text), *as_given]


def _outages(trial: Trial, both: list[dict], window: Recording, chunk: Recording, known: dict):
    """By duration, how far the fixes are from the filters with `both` parameters in the outages of `chunk`, at the end
    of `window`. known: predictions of this chunk, by the first sample of the filters."""
    part, effect = cut(window, SETTLING + seconds(chunk)), effect_called(trial.finding.name)
    # samples from before a change would lead the filter astray that is right after it
    since = max(trial.finding.since, int(part.imu.stamp[0]))
    predictions = known.setdefault(since, Predictions(behind(part, since), chunk))
    lasting = effect.lasting(both[-1])
    return {d: outages if d >= lasting else []
            for d, outages in pairs(*(predictions.of(effect.held(one)) for one in both)).items()}


def as_given_quantity(now: int, one: Finding, advice: Advice | None) -> Quantity:
    """What is as given as far as a look has shown, in words. now: ns, stamp of the newest sample."""
    left = ', '.join(f'{parameter} {e.text()}' for parameter, e in one.parameters.items())
    return Quantity(now, one.name, FINE if one.settled else COARSE if left else INITIALISING, one.parameters,
                    text=f'{left} left of what is given' if left else 'does not show in what was driven so far',
                    advice=advice.text() if advice else '')


def _not_seen_as_usual(one: Finding) -> Finding:
    """`one` with the usual size of what has not been seen at all as its sigma."""
    usual = {p.name: Estimate(0.0, p.prior_scale, p.unit) for p in effect_called(one.name).traced}
    return replace(one, parameters={**usual, **one.parameters})


def _known(kept: Kept, parameters: dict) -> Finding:
    """A finding of an earlier drive, with these parameters of the effect now."""
    return Finding(kept.name, [kept.name], parameters, 0.0, 0.0, True, HeldOut(0.0, 1.0, []), changes=kept.sets)


def found(recording: Recording, values: dict, progress: Callable = lambda part, what: None) -> list[Finding]:
    """What `diagnose` finds in `recording`, proves there, and has parameters against."""
    return [replace(f, least=systematic(f.parameters)) for f in diagnose(
        recording, values, progress, durations=ANALYSED).findings if f.added and f.changes]
