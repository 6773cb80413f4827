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

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from ..errors import InputError
from ..evaluation.comparison import aiding_of, samples_to_keep, truth_of
from ..evaluation.metrics import Errors
from ..evaluation.outages import run_outages
from ..filter.config import FilterConfig
from ..filter.measurements.registry import aiding
from ..filter.runs.betting import Bets
from ..filter.runs.changing import Dropped
from ..filter.runs.usable import usable
from ..parameters.params_file import yaml_value
from ..samples import Recording
from .advice import Advice, advised
from .diagnose import diagnose
from .findings import Finding
from .gathering import JUMP, chunks
from .held_out import HeldOut
from .quantity import ALL, COARSE, FINE, INITIALISING, NOTHING, SUSPECT, Findings, Kept, Quantity, together

#: s of samples before the first analysis
FIRST = 120.0
#: the next ones of all that is kept come when there is so much more, as a part of what there was, then each window:
#: what two minutes do not show, three often do
MORE = 0.5
#: s: the latest samples are analysed as often, and as many of them: a change shows there first
LATEST = 240.0
#: north and east, m
Place = tuple[float, float]
#: s before a chunk, for two filters to find their state in
SETTLING = 180.0
#: s without fixes, of trials: short ones are many, and show what is sharp soon; long ones what is small against the
#: noise of the fixes
OUTAGES = (5.0, 10.0, 30.0)
#: s without fixes, that the analyses judge by
ANALYSED = (10.0, 30.0)
#: part of an outage at whose end the fixes are compared with the prediction: their mean
JUDGED = 0.3
#: m: an outage in which less was driven says nothing
DRIVEN = 20.0
#: probability that anything is called FINE by chance, in all the time that a filter runs: of the k-th trial it is
#: 6 / (pi k)^2 of that
FALSE_ALARMS = 0.01
#: outages in which what is applied and does good is taken back once at most: a day of the shortest ones
TAKEN_BACK = 17_000.0
#: sigmas that two estimates of the same are apart, which are two values
APART = 3.0
#: behind the name of a value on trial where another one of the same effect is applied
OTHER = ', another value'
#: of a parameter in a line to copy
DIGITS = 5
#: s: a chunk that is shorter is of samples with wild stamps
SHORTEST = 1.0
#: part of the samples before an analysis that are there: the first stamp of a chunk is not the last of the one before
NEARLY = 0.99


@dataclass
class Trial:
    """A finding on trial. sets: parameters as it would have them. needed: wealth with which it is proven.

    applied: whether it is part of the parameters that drive. harmful: it was, and has been taken back. seen: whether no
    later analysis speaks against it. kept: for the next drive, where it is applied. advice: what would show more of it.
    errors: by duration, m, without it and with it
    in each outage. bets: by duration.
    """

    finding: Finding
    sets: dict
    needed: float
    applied: bool = False
    proven: bool = False
    harmful: bool = False
    seen: bool = True
    kept: Kept | None = None
    advice: Advice | None = None
    errors: dict[float, list[tuple[float, float]]] = field(default_factory=lambda: {d: [] for d in OUTAGES})
    bets: dict[float, Bets] = field(default_factory=lambda: {d: Bets() for d in OUTAGES})

    @property
    def wealth(self) -> float:
        """For the finding: of the bets on each duration, in equal parts."""
        return float(np.mean([np.exp(bets.pro) for bets in self.bets.values()]))

    @property
    def harm(self) -> float:
        """Against it."""
        return float(np.mean([np.exp(bets.con) for bets in self.bets.values()]))

    @property
    def rejected(self) -> bool:
        if self.applied:
            return self.harm >= TAKEN_BACK
        return self.harmful or (not self.proven and self.harm >= self.needed)

    @property
    def state(self) -> str:
        if self.proven:
            return FINE if self.seen else SUSPECT
        return SUSPECT if self.applied or self.rejected or not self.seen else COARSE

    def take(self, errors: dict[float, list[tuple[Place, Place]]], now: int = 0) -> None:
        """What the outages of one more chunk say, by duration: how far the fixes were from either filter, m. now: ns,
        its end."""
        before = self.proven
        for duration, bets in self.bets.items():
            for without, with_it in errors[duration]:
                self.errors[duration].append((float(np.hypot(*without)), float(np.hypot(*with_it))))
                bets.take(without, with_it)
                if self.applied:
                    bets.con = max(bets.con, 0.0)
                self.proven = self.proven or self.wealth >= self.needed
        if self.kept and self.proven and not before:
            self.kept = replace(self.kept, found=now)

    def apply(self, now: int) -> None:
        """Be part of the parameters that drive. What was seen before says nothing against that any more. now: ns."""
        self.applied = True
        self.kept = Kept(self.finding.name, self.finding.parameters, self.sets, now)
        for bets in self.bets.values():
            bets.con = 0.0

    def begin_anew(self) -> None:
        """The parameters that drive have changed: what was seen before compared others."""
        for bets in self.bets.values():
            bets.begin_anew()
        self.errors = {duration: [] for duration in OUTAGES}

    def differs(self, finding: Finding) -> bool:
        """Whether `finding`, of the same effect, has other values. Where this one is applied, it is what is left."""
        own = {} if self.applied else self.finding.parameters
        sigmas = {name: e.sigma for name, e in self.finding.parameters.items() if e.known}
        values = {name: e.value for name, e in own.items() if e.known}
        return any(e.known and name in sigmas and abs(e.value - values.get(name, 0.0)) > APART * np.hypot(
            e.sigma, sigmas[name]) for name, e in finding.parameters.items())


class Online:
    """The diagnosis of a vehicle whose filter has the checked parameters `values`.

    find: an analysis, recording and parameters to findings; by default what `diagnose` would add. kept: what an earlier
    drive has proven; it drives, and is SUSPECT until it is proven again.
    """

    def __init__(self, values: dict, find: Callable[[Recording, dict], list[Finding]] | None = None,
                 kept: Sequence[Kept] = ()):
        self._values, self._find = {**values, 'bag': []}, find or found
        self._applies = values['diagnosis.online'] == 'apply'
        self._length = values['diagnosis.window']
        self._window: Recording | None = None
        self._since = self._lately = 0.0  # s of samples since the last analysis, and the last one of the latest ones
        self.trials: dict[str, Trial] = {}  # of what is not applied
        self.applied: dict[str, Trial] = {}
        self._begun = self._analyses = self._begins = 0  # trials, analyses; ns, the first stamp
        self._why = ''
        for one in kept if self._applies else ():
            self.applied[one.name] = Trial(_known(one, one.parameters), one.sets, self._next_needed(), applied=True,
                                           kept=one)

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
        chunk = usable(chunk, self._values['imu.max_specific_force'], self._values['imu.max_angular_rate'])
        if _seconds(chunk) < SHORTEST:
            return self.quantities()
        if self._window is not None and _jumps(self._window, chunk):
            self._window, self._since, self._lately = None, 0.0, 0.0
        if not self._begins:
            self._begins = int(chunk.imu.stamp[0])
            for trial in self.applied.values():
                trial.finding = _known(trial.kept, trial.kept.aged(self._begins))
        before, self._window = self._window, _cut(_joined(self._window, chunk), self._length)
        self._since += _seconds(chunk)
        self._lately += _seconds(chunk)
        gone = [one for one in dropped if one.name in self.applied]
        if gone:
            self._begin_anew_since(gone)
        elif before is not None:
            self._try(chunk)
        young = _seconds(self._window) <= LATEST
        if self._lately >= NEARLY * LATEST and not young:  # before all that is kept, where both are due
            self._lately = 0.0
            self._analyse(_cut(self._window, LATEST), latest=True)
        elif self._since >= NEARLY * self._due:
            self._since, self._lately = 0.0, 0.0 if young else self._lately
            self._analyses += 1
            self._analyse(self._window, latest=young)
        return self.quantities()

    def _analyse(self, part: Recording, latest: bool) -> None:
        """Trials of what is found in `part`. latest: it is young enough to say that a value has changed."""
        try:
            findings, self._why = self._find(part, {**self._values, **self.sets}), ''
        except InputError as error:
            findings, self._why = [], str(error)
        names = {finding.name for finding in findings}
        for name, trial in self.trials.items():
            trial.seen = name in names or (latest and trial.seen)
        for finding in findings:
            self._put_on_trial(finding, latest)

    def _put_on_trial(self, finding: Finding, latest: bool) -> None:
        name, driving, trial = finding.name, self.applied.get(finding.name), self.trials.get(finding.name)
        if driving is not None:
            if not latest or not driving.differs(finding):
                return
            driving.seen = False
        if trial is None or trial.rejected or (latest and trial.differs(finding)):
            self.trials[name] = Trial(finding, finding.changes, self._next_needed(),
                                      advice=advised(finding, self._window, {**self._values, **self.sets}))

    def _next_needed(self) -> float:
        """Wealth with which the next trial is proven."""
        self._begun += 1
        return (np.pi * self._begun) ** 2 / (6.0 * FALSE_ALARMS)

    def _try(self, chunk: Recording) -> None:
        """The outages of `chunk` through the present filter, and through that of each trial."""
        running = [trial for trial in self.trials.values() if not trial.rejected]
        if not (running or self.applied) or not len(chunk.gnss):
            return
        part = _cut(self._window, SETTLING + _seconds(chunk))
        values = {**self._values, **self.sets}
        present = predicted(part, values, chunk)
        for trial in running:
            trial.take(_pairs(present, predicted(part, {**values, **trial.sets}, chunk)), self._now)
        for name, trial in self.applied.items():
            other = predicted(part, {**self._values, **self._sets(without=name)}, chunk)
            trial.take(_pairs(other, present), self._now)
        if self._applies:
            self._decide()

    def _decide(self) -> None:
        """Apply what is proven, and take back what does harm; one at a time, as each changes what others compare."""
        harmful = next((name for name, trial in self.applied.items() if trial.rejected), None)
        proven = next((name for name, trial in self.trials.items() if trial.proven), None)
        if harmful is not None:
            trial = self._take_back(harmful)
            self._window = _cut(self._window, LATEST)  # what came before the change is of another vehicle
        elif proven is not None:
            if proven in self.applied:
                self._window = _cut(self._window, LATEST)
            trial = self._apply(proven)
        else:
            return
        for other in (*self.trials.values(), *self.applied.values()):
            if other is not trial:
                other.begin_anew()

    def _take_back(self, name: str) -> Trial:
        """Have the trial of this name no longer in the parameters that drive."""
        trial = self.applied.pop(name)
        trial.applied, trial.proven, trial.harmful, trial.kept = False, False, True, None
        self.trials.setdefault(name, trial)
        return trial

    def _begin_anew_since(self, dropped: Sequence[Dropped]) -> None:
        """The vehicle is another one since the filter has dropped what was right before."""
        for one in dropped:
            self._take_back(one.name)
        for trial in (*self.trials.values(), *self.applied.values()):
            trial.begin_anew()
        since = max(one.since for one in dropped)
        self._window = _cut(self._window, (int(self._window.imu.stamp[-1]) - since) * 1e-9)
        self._since = self._lately = _seconds(self._window)
        self._analyses = 0

    def _apply(self, name: str) -> Trial:
        """Have the trial of this name in the parameters that drive."""
        trial = self.applied[name] = self.trials.pop(name)
        trial.apply(self._now)
        return trial

    def accept(self) -> list[Quantity]:
        """Apply all that is on trial and has not been shown to do harm, as a user asks."""
        for name in [name for name, trial in self.trials.items() if not trial.rejected]:
            self._apply(name)
        return self.quantities()

    def reject(self) -> list[Quantity]:
        """Take back all that is applied, and end all trials, as a user asks; what is found again is tried again."""
        self.trials, self.applied = {}, {}
        return self.quantities()

    def reset(self) -> list[Quantity]:
        """Forget all but how many trials there have been, as after work on the vehicle."""
        self._window, self._since, self._lately, self._analyses = None, 0.0, 0.0, 0
        return self.reject()

    def quantities(self) -> list[Quantity]:
        """What is known now, one for each finding; one of the name `all` before the first analysis."""
        now = self._now
        told = [_quantity(now, name, trial) for name, trial in self.applied.items()]
        told += [_quantity(now, f'{name}{OTHER if name in self.applied else ""}', trial)
                 for name, trial in self.trials.items()]
        if told:
            return told
        if self._window is None:
            return []
        if not self._analyses:
            return [Quantity(now, ALL, INITIALISING, {}, text=f'{self._since:.0f} of {self._due:.0f} s of samples '
                             'for a first analysis')]
        return [Quantity(now, ALL, NOTHING, {}, text=f'nothing found in {self._analyses} analyses'
                         f"{f' ({self._why})' if self._why else ''}")]


def _known(kept: Kept, parameters: dict) -> Finding:
    """A finding of an earlier drive, with these parameters of the effect now."""
    return Finding(kept.name, [kept.name], parameters, 0.0, 0.0, True, HeldOut(0.0, 1.0, []), changes=kept.sets)


def found(recording: Recording, values: dict, progress: Callable = lambda part, what: None) -> list[Finding]:
    """What `diagnose` finds in `recording`, proves there, and has parameters against."""
    return [f for f in diagnose(recording, values, progress, durations=ANALYSED).findings if f.added and f.changes]


def predicted(part: Recording, values: dict, chunk: Recording) -> dict[float, dict[int, tuple[Place, float]]]:
    """By duration and begin (ns, as fixes are stamped): how far the filter with `values` is from the fixes at the end
    of an outage, m, and the distance driven. Outages begin and end in `chunk`, at the end of `part`, and do not
    overlap."""
    delay = round(values['gnss.time_offset'] * 1e9)
    config, truth = FilterConfig.from_parameters(values), truth_of(part, values)
    keep = samples_to_keep(part.imu, truth.reference.stamp)
    first, last = (int(chunk.gnss.stamp[i]) for i in (0, -1))
    results = {}
    for duration in OUTAGES:
        length = round(duration * 1e9)
        begin = np.arange(first, last - length + 1, length)
        stamps = np.unique(part.gnss.stamp)
        begin = np.unique(stamps[np.searchsorted(stamps, begin)])
        outages, = run_outages(config, part.imu, part.gnss, truth, [duration], begin - delay, aiding_of(part), keep)
        results[duration] = {b + delay: (_misfit(errors, b + round((1.0 - JUDGED) * length)), distance) for
                             b, errors, distance in zip(outages.begin.tolist(), outages.errors, outages.distance)}
    return results


def _misfit(errors: Errors, begin: int) -> Place:
    """The mean error from `begin` on, ns; NaN where there is none."""
    late = errors.stamp >= begin
    return (float(errors.north[late].mean()), float(errors.east[late].mean())) if late.any() else (np.nan, np.nan)


def _pairs(present: dict, other: dict) -> dict[float, list[tuple[Place, Place]]]:
    """By duration, the errors of the same outages of two filters in which the vehicle was driven."""
    found = {}
    for duration in OUTAGES:
        a, b = present[duration], other[duration]
        pairs = [(a[begin][0], b[begin][0]) for begin in sorted(a.keys() & b.keys()) if a[begin][1] > DRIVEN]
        found[duration] = [pair for pair in pairs if np.isfinite(sum(pair[0]) + sum(pair[1]))]
    return found


def _quantity(now: int, name: str, trial: Trial) -> Quantity:
    better = {d: (*np.mean(pairs, axis=0).tolist(), len(pairs)) for d, pairs in trial.errors.items() if pairs}
    lines = tuple(f'{parameter}: {yaml_value(_told(value))}' for parameter, value in trial.sets.items())
    said = ', '.join(f'{parameter} {e.text()}' for parameter, e in trial.finding.parameters.items())
    gain = ''.join(f'; {d:g} s without fixes {a:.2f} m without it and {b:.2f} m with it, {n} times'
                   for d, (a, b, n) in better.items())
    return Quantity(now, name, trial.state, trial.finding.parameters, lines, better,
                    f"{said}{gain}{_why(trial)}; {'applied' if trial.applied else 'to set'}: {'; '.join(lines)}",
                    trial.applied, trial.kept, trial.advice.text() if trial.advice and not trial.proven else '')


def _told(value):
    """A parameter with as many digits as are worth copying: no sigma here is so small a part of its value."""
    if isinstance(value, list):
        return [_told(one) for one in value]
    return float(f'{value:.{DIGITS}g}') if isinstance(value, float) else value


def _why(trial: Trial) -> str:
    """Why it is SUSPECT, for the sentence."""
    if trial.rejected:
        return '; predictions are worse with it'
    if not trial.seen:
        return '; the last minutes show another value' if trial.applied else '; not found in the last minutes'
    return '; not proven in this drive yet' if trial.applied and not trial.proven else ''


def _seconds(recording: Recording) -> float:
    return float(recording.imu.stamp[-1] - recording.imu.stamp[0]) * 1e-9 if len(recording.imu) else 0.0


def _jumps(before: Recording, after: Recording) -> bool:
    """Whether the stamps of two recordings in a row jump."""
    return not 0 < int(after.imu.stamp[0]) - int(before.imu.stamp[-1]) <= JUMP


def _joined(before: Recording | None, after: Recording) -> Recording:
    """Two recordings in a row as one."""
    if before is None:
        return after
    streams, later = before.streams(), after.streams()
    for name, samples in later.items():
        if name in streams:
            own = {f.name: (getattr(streams[name], f.name), getattr(samples, f.name)) for f in fields(samples)}
            streams[name] = type(samples)(**{n: None if b is None else np.concatenate([a, b])
                                             for n, (a, b) in own.items()})
        else:
            streams[name] = samples
    return before.having(streams)


def _cut(recording: Recording, seconds: float) -> Recording:
    """The last `seconds` of a recording."""
    begin = int(recording.imu.stamp[-1]) - round(seconds * 1e9)
    return recording.having({name: samples.select(samples.stamp > begin)
                             for name, samples in recording.streams().items()})


class Watch:
    """A recording as a live node is told of it, chunk by chunk. said: each quantity when it was news.

    progress: called from time to time with the part that is done; what it raises ends all. find, kept: as of `Online`.
    """

    def __init__(self, recording: Recording, values: dict, progress: Callable[[float], None] = lambda part: None,
                 find: Callable[[Recording, dict], list[Finding]] | None = None, kept: Sequence[Kept] = ()):
        self.said: list[Quantity] = []
        self._progress, self._done, self._told = progress, 0.0, {}
        self._work = Online(values, find or (lambda part, given: found(part, given, lambda _, what: progress(
            self._done))), kept)
        self._chunks, self._span = chunks(recording, aiding(values)), recording.imu.stamp[[0, -1]].tolist()

    @property
    def wanted(self) -> Findings:
        """What the filters should have."""
        return self._work.wanted

    def take(self, dropped: Sequence[Dropped] = ()) -> Findings | None:
        """What they should have after the next chunk, in which it has `dropped` findings; None behind the last one."""
        self._progress(self._done)
        chunk = next(self._chunks, None)
        if chunk is None:
            return None
        begin, end = self._span
        self._done = (int(chunk.imu.stamp[-1]) - begin) / max(end - begin, 1)
        for quantity in self._work.take(chunk, dropped):
            if self._told.get(quantity.name) != quantity.said:
                self.said.append(quantity)
            self._told[quantity.name] = quantity.said
        return self.wanted


def watched(recording: Recording, values: dict, progress: Callable[[float], None] = lambda part: None
            ) -> list[Quantity]:
    """What is said of `recording` as a live node says it that changes nothing."""
    watch = Watch(recording, values, progress)
    while watch.take() is not None:
        pass
    return watch.said
