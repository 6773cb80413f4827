"""Close the loop: find the residual, trace it to an effect the model lacks, add that effect, prove it (DESIGN, 5).

Each step takes what is known so far (`Known`, never changed) and returns what is known after it.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..effects.base import Effect
from ..effects.gnss_outliers import far_off
from ..effects.registry import EFFECTS
from ..recordings.several import one_after_another
from ..samples import Recording
from . import learned
from .agreement import by_drive, contradicted, plainest_in_one, said
from .clock import whose
from .detection import Detection, detect
from .drives import Drives, part, problems
from .estimate import Estimate, widened
from .levels import choose, multiplied
from .outliers import isolated, without_far_off
from .plausible import implausible
from .proof import (
    CERTAIN,
    HeldOut,
    Measured,
    all_in_all,
    compared,
    gain_of,
    harm,
    held_out,
    measure,
    objection,
    of_all,
    parts,
    saved,
    together,
    unproven,
    which_part,
)
from .residuals import (
    LARGEST_FACTOR,
    Model,
    Problem,
    Residual,
    calibrated,
    fit,
    noise_unknowns,
    on_all_cores,
    refined,
    scores,
)
from .rest import GoesWith, goes_with
from .tracing import (
    SIGNIFICANCE,
    Candidate,
    also_determined,
    determined,
    effect_unknowns,
    group,
    refined_unknowns,
    trace,
)

#: fewer innovations than this decide nothing
FEWEST_FIXES = 60
#: a recording has turns, and changes of speed, where these happen: rad/s and m/s^2 (root mean square)
TURNING, SPEEDING = 0.03, 0.15
MOST_ROUNDS = 6
#: a search that has filtered so many IMU samples is content with what it has: half a minute on two cores, whatever the
#: recording, and the same result on each machine
ENOUGH = 6_000_000
#: errors are measured no more often than this, s
REFERENCE_INTERVAL = 0.1
#: candidates of one round that are fitted to see which explains most, if their gain is this part of the largest, and
#: how close in log likelihood equals come
TRIED, PART, CLOSE, MOST_TRIED = 3, 0.2, 3.3, 4
#: position errors all in all that differ by this factor tell effects apart
DIFFERENT = 1.1
#: a parameter is not determined where values this many times apart fit equally well
APART = 1.5
#: iterations of a fit that is only compared with others
COMPARED = 3
#: and of one from a maximum that has moved little
REFITTED = 4
#: noise levels that differ by less than this (natural logarithm) make no other start
SAME_START = 0.7
#: an effect is one from so many sigma on, and a parameter of it has a value
PLAIN, SHOWN = 3.0, 2.0
MOUNTING = 'mounting_rotation'
#: what lasts, and what changes and so can do all that it does: the plainer one is tried first
VARIED = {'gnss_time_offset': 'gnss_latency'}
#: decisions are made on about so many outages, so far apart, s
FEW_OUTAGES, CLOSEST_OUTAGES = 40, 10.0

#: the parts of the work, by the time they usually take: where they begin, and how many choices there are among levels
SEARCHING, CHOOSING, MEASURING, LOOKING, USUAL_CHOICES = 0.05, 0.72, 0.88, 0.95, 15

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Finding:
    """One thing that was traced.

    group: names of what the recording cannot tell it from, itself first. changes: the parameters as the correction
    sets them. reason: why it was not added. seen: where it was not fitted, what shows it. drives: what each of several
    drives says alone, by name. apart: the drives contradict each other. saves: duration of outages, s, and the
    median of the largest error without it and with it, m, each beside what was found before.
    """

    name: str
    group: list[str]
    parameters: dict[str, Estimate]
    gain: float
    p: float
    added: bool
    held_out: HeldOut
    reason: str = ''
    changes: dict = field(default_factory=dict)
    seen: str = ''
    drives: dict[str, dict[str, Estimate]] = field(default_factory=dict)
    apart: bool = False
    saves: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Diagnosis:
    """What `diagnose` found. Residuals and detections: of the filter of the user as configured, with the noise levels
    alone that predict best, and with all that was found; 'search': of the best model of the search, which hides nothing
    and is what is left unexplained.

    noise: factors on noise levels in `corrected`. explained: those with which the innovations are explained best, and
    which no filter has to use. drives: the same diagnosis as it looks in each of several drives. left_out: why other
    drives are not in it, by name.
    """

    recordings: tuple[Recording, ...]
    values: dict
    problem: Drives
    residuals: dict[str, Residual]
    detections: dict[str, Detection]
    noise: dict[str, float]
    explained: dict[str, float]
    rounds: list[list[Candidate]]
    chosen: list[str]  # the candidate that each round tried to add; none in the last one
    findings: list[Finding]
    hidden: dict[str, str]  # effects and parameters that the data cannot show, and why
    corrected: dict
    better: bool  # whether `corrected` is proven; else it is `values`
    before: Measured
    fitted: Measured
    after: Measured
    comparison: list[dict]
    rest: list[GoesWith]
    remarks: list[str] = field(default_factory=list)
    drives: list[Diagnosis] = field(default_factory=list)
    left_out: dict[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Of the recordings."""
        return ', '.join(recording.name for recording in self.recordings)

    @property
    def recording(self) -> Recording:
        """The recording of a diagnosis of one drive, the first one of several."""
        return self.recordings[0]

    @property
    def unexplained(self) -> bool:
        return self.detections['search'].lacking or bool(self.rest)


@dataclass(frozen=True)
class Bench:
    """The recordings on the bench: what errors a filter makes in them.

    recordings: with all fixes, as many as the problem has drives. offset_sigma: gnss.time_offset_sigma as given, which
    the search does without.
    """

    recordings: tuple[Recording, ...]
    origin: Drives
    library: tuple[Effect, ...]
    durations: tuple[float, ...]
    spacing: float
    tell: Progress
    offset_sigma: float
    measured: dict[str, Measured] = field(default_factory=dict)  # by the filters asked for

    @cached_property
    def judging(self) -> tuple[Recording, ...]:
        """The recordings for the truth: where that are the fixes, a fix that is far off is none."""
        return tuple(replace(r, gnss=without_far_off(r.gnss)) for r in self.recordings)

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

        full: with all IMU samples, by the protocol that is reported; else for decisions. These look at the covariance as
        the model has it: scaled by what innovations show, it would hold the truth whatever the model lacks.
        """
        decides = {} if full else {'gnss.adapt_covariance': False}
        models = [{**values, 'gnss.time_offset_sigma': self.offset_sigma, **decides} for values in models]
        asked = repr((full, [sorted(values.items()) for values in models]))
        if asked not in self.measured:
            self.measured[asked] = self._measured(models, full)
        return self.measured[asked]

    def _measured(self, models: list[dict], full: bool) -> Measured:
        judged = parts(self.origin) if len(models) > 1 else [self.origin.mask]
        found = {}
        for recording, judging, problem, where in zip(self.recordings, self.judging, self.origin.each,
                                                      self.origin.slices):
            seconds = float(np.ptp(problem.stamp[problem.mask])) * 1e-9
            mine = [(values, mask[where]) for values, mask in zip(models, judged) if mask[where].any()]
            spacing = self.spacing if full else max(CLOSEST_OUTAGES, seconds / FEW_OUTAGES)
            found[recording.name] = measure(
                problem, judging, (problem.full if full else problem.drive).imu, [values for values, _ in mine],
                fitting(self.durations, problem), spacing, [mask for _, mask in mine])
        return together(found)

    def each(self, configurations: Sequence[dict]) -> list[Measured]:
        """Of several filters, for the choice of noise levels."""
        found = on_all_cores(lambda values: self.errors([values]), configurations)
        count = len(self.measured)
        self.tell(CHOOSING + (MEASURING - CHOOSING) * count / (count + USUAL_CHOICES), 'choosing noise levels')
        return found


@dataclass(frozen=True)
class Known:
    """What is known after a step: the model, what was found, and what is still to be tried.

    estimates: the unknowns by the part that is held out. errors: those of the user's filter with the effects so far,
    in each part with the estimate from the others.
    """

    problem: Problem
    model: Model
    errors: Measured
    effects: tuple[Effect, ...]
    rejected: tuple[Effect, ...] = ()
    estimates: tuple[np.ndarray, ...] = ()
    findings: tuple[Finding, ...] = ()
    rounds: tuple[list[Candidate], ...] = ()
    chosen: tuple[str, ...] = ()
    hidden: dict[str, str] = field(default_factory=dict)

    @property
    def noise(self) -> int:
        """How many of the unknowns, the first ones, are noise levels."""
        return sum(u.noise for u in self.model.unknowns)

    def corrected(self) -> dict:
        """The user's parameters with the effects found so far."""
        return self.problem.corrected(self.model.unknowns, self.model.x)

    def by_part(self) -> list[dict]:
        """The same by the part that is held out; one for all where nothing was estimated."""
        return [self.problem.corrected(self.model.unknowns, x) for x in self.estimates] or [self.corrected()]


def diagnose(recordings: Recording | Sequence[Recording], values: dict, progress: Progress = lambda part, what: None,
             effects: Sequence[Effect] | None = None, durations=(10.0, 30.0, 60.0), spacing: float = 30.0) -> Diagnosis:
    """Diagnose `recordings`, one or several of one vehicle, as filtered with `values` (checked parameters).

    effects: the candidates, by default all of the registry. Raises DiagnosisError where no recording can be diagnosed
    at all. `progress` is called with the part of the work done and what is being done.
    """
    progress(0.02, 'filtering')
    given = [recordings] if isinstance(recordings, Recording) else list(recordings)
    thinned = [_thinned(recording) for recording in one_after_another(given)]
    found, left_out = problems(thinned, values, FEWEST_FIXES)
    thinned = [recording for recording in thinned if recording.name not in left_out]
    for problem, recording in zip(found, thinned):
        problem.reference_clock = whose(recording, values['reference_clock']).name
    library = tuple(effects if effects is not None else EFFECTS.values())
    bench = Bench(tuple(thinned), Drives(found), library, tuple(durations), spacing, progress,
                  values['gnss.time_offset_sigma'])
    first = begin(bench)
    known = replaced(first, bench)
    for _ in range(MOST_ROUNDS):
        further = add_best(known, bench)
        if len(further.chosen) == len(known.chosen):
            further = replaced(further, bench)
        found_none = len(further.chosen) == len(known.chosen)
        known = further
        if found_none or bench.enough():
            break
    known = without_undetermined(without_superseded(known, bench), bench)
    return replace(concluded(known, first, bench), left_out=left_out)


def _thinned(recording: Recording) -> Recording:
    """With no more of the reference than errors are measured at."""
    if recording.reference is None:
        return recording
    slot = (recording.reference.stamp - recording.reference.stamp[0]) // round(REFERENCE_INTERVAL * 1e9)
    return replace(recording, reference=recording.reference.select(np.unique(slot, return_index=True)[1]))


def fitting(durations: Sequence[float], problem: Problem) -> tuple[float, ...]:
    """The durations of outages, s, of which a drive holds enough."""
    return tuple(d for d in durations if d < 0.3 * (problem.stamp[-1] - problem.stamp[0]) * 1e-9)


def begin(bench: Bench) -> Known:
    """The model without effects: fixes that are off alone set aside, noise levels fitted."""
    bench.searching('fitting noise levels')
    problem = bench.origin
    noise = noise_unknowns(problem)
    [at] = problem.residuals(noise, [calibrated(problem, noise)])
    problem = problem.without(isolated(at, problem.mask) | _far_off(problem))
    noise = noise_unknowns(problem)
    model = fit(problem, noise, calibrated(problem, noise))
    return _hidden(Known(problem, model, bench.errors([bench.origin.given]), bench.library))


def _far_off(problem: Drives) -> np.ndarray:
    """Which fixes neither those before nor those after them explain, (f,) bool."""
    found = np.zeros(len(problem.stamp), dtype=bool)
    for drive, where in zip(problem.each, problem.slices):
        found[where.start + far_off(drive.drive.gnss)[0]] = True
    return found


def _hidden(known: Known) -> Known:
    """Without the effects of which none of the drives can say anything."""
    reasons = {}
    for e in known.effects:
        own = [e.hidden(known.problem.given, p.recording) for p in known.problem.each]
        reasons[e.name] = own[0] if all(own) else ''
    reasons |= {name: why for name, why in learned.hides(known.problem.given).items() if name in reasons}
    fitted = {e.name for e in known.effects if e.traced}
    hidden = {name: why for name, why in reasons.items() if why and name in fitted}
    return replace(known, hidden=known.hidden | hidden,
                   effects=tuple(e for e in known.effects if not reasons[e.name]))


# one round: trace, try, judge

def add_best(known: Known, bench: Bench) -> Known:
    """Trace from several starts, and add the best candidate that helps on held-out data.

    A `Known` without a further choice where nothing is significant."""
    if not known.effects:
        return known
    bench.searching('testing effects')
    views = starts(known)[:1 if bench.enough(0.6) else None]
    best: dict[str, tuple[Candidate, np.ndarray]] = {}
    significant: list[tuple[int, Candidate, np.ndarray]] = []
    for view in views:
        at, nuisance = scores(known.problem, known.model.unknowns, view)
        moved = known.problem.moved(known.model.unknowns, view)
        traced = trace(moved, nuisance, at, known.effects, known.problem.mask)
        for candidate in traced:
            if candidate.name not in best or candidate.p < best[candidate.name][0].p:
                best[candidate.name] = candidate, view
        plain = [c for c in traced if c.p_adjusted <= SIGNIFICANCE and c.scores is not None]
        plain.sort(key=lambda c: 2 * len(c.theta) - c.gain)
        significant += [(rank, c, view) for rank, c in enumerate(plain[:TRIED]) if c.gain >= PART * plain[0].gain]
        alone = plainest_in_one(traced, moved)
        if alone is not None and alone[1] <= SIGNIFICANCE:
            significant.append((TRIED, alone[0], view))
    candidates = sorted((c for c, _ in best.values()), key=lambda c: (c.p, -c.gain))
    known = replace(known, rounds=(*known.rounds, candidates))
    if not significant:
        return known
    # each from the start where it explains most, those first that are first at some start
    names = [c.name for _, c, _ in sorted(significant, key=lambda found: (found[0], best[found[1].name][0].p))]
    names = list(dict.fromkeys(names))[:MOST_TRIED]
    bench.searching(f'adding {" or ".join(names)}')
    return _tried(known, [best[name] for name in names], candidates, bench)


def replaced(known: Known, bench: Bench) -> Known:
    """With what another mechanization takes out, if that one predicts better for certain.

    Nothing of it is fitted to the data, so it needs no score test, which a planar filter on hills may fail: the slopes
    are in its noise levels then.
    """
    for effect in known.effects:
        for fixed in effect.tried:
            unknowns = effect_unknowns(effect, fixed, known.problem.attitude)
            candidate = Candidate(effect, unknowns, np.ones(len(unknowns)), np.full(len(unknowns), np.inf), 0.0, 1.0,
                                  None, [], fixed)
            if not effect.replaces_model(candidate.values()):
                continue
            bench.searching(f'trying {effect.name}')
            judged = _judged(known, candidate, _with(known, candidate, known.model.x, bench), bench)
            if judged.against or judged.proof.p > CERTAIN:
                continue
            candidate = replace(candidate, gain=2 * judged.proof.gain, p=judged.proof.p, p_adjusted=judged.proof.p)
            finding = Finding(effect.name, [effect.name], judged.parameters, candidate.gain, candidate.p, True,
                              judged.proof, saves=saved(known.errors, judged.errors))
            return _taken(replace(known, rounds=(*known.rounds, [candidate])), judged, finding, [])
    return known


def starts(known: Known) -> list[np.ndarray]:
    """The unknowns at different noise levels: as fitted, as configured with the receiver's as it shows, and at first
    between them.

    Fitted levels may have swallowed an effect, and configured ones may hide it behind others.
    """
    model, n = known.model, known.noise
    configured = calibrated(known.problem, model.unknowns, model.x)
    found = [model.x]
    for x in (configured, 0.5 * (configured + model.x))[:1 if known.rounds else 2]:
        if all(np.abs(x[:n] - other[:n]).max() > SAME_START for other in found):
            found.append(x)
    return found


@dataclass(frozen=True)
class Judged:
    """A candidate, the model with it, its parameters, and what it does on data it was not fitted to."""

    candidate: Candidate
    model: Model
    parameters: dict[str, Estimate]
    hidden: dict[str, str]
    proof: HeldOut
    errors: Measured
    against: str
    drives: dict[str, dict[str, Estimate]] = field(default_factory=dict)
    apart: bool = False


def _tried(known: Known, significant, candidates: list[Candidate], bench: Bench) -> Known:
    """With the best of the significant candidates in the model, if it helps on held-out data.

    Of those that explain the same, the position errors decide where these differ: a reference may know more. What
    cannot be is told and makes room for the next.
    """
    chosen = {candidate.name: candidate for candidate, _ in significant}
    models = {candidate.name: _with(known, candidate, view, bench) for candidate, view in significant}
    mask = np.logical_and.reduce([model.problem.mask for model in models.values()])
    # another mechanization measures other things beside the fixes
    comparable = all(model.problem is known.problem for model in models.values())
    merit = {name: float(np.nansum((m.residual if comparable else m.residual.of_fixes).log_likelihood()[mask]))
             - len(chosen[name].theta) for name, m in models.items()}
    order = sorted(models, key=lambda name: (max(merit[name], merit.get(VARIED.get(name), -np.inf)), name in VARIED),
                   reverse=True)
    failed: list[Finding] = []
    for name in order:
        alike = [e.name for e in known.effects if e.name in merit and merit[e.name] > merit[name] - CLOSE
                 and e.name not in {f.name for f in failed}]
        same = [n for n in group(chosen[alike[0]], candidates, known.problem.mask) if n not in alike]
        names = [*alike, *same]
        judged = {n: _judged(known, chosen[n], models[n], bench) for n in names if n in models}
        best = judged[names[0]]
        for n in names[1:]:
            if n in judged and not judged[n].against and (
                    best.against or all_in_all(compared(best.errors, judged[n].errors)) < 1 / DIFFERENT):
                best = judged[n]
        others = [n for n in names if n != best.candidate.name and (
            n not in judged or all_in_all(compared(best.errors, judged[n].errors)) < DIFFERENT)]
        finding = Finding(best.candidate.name, [best.candidate.name, *others], best.parameters, best.candidate.gain,
                          best.candidate.p_adjusted, not best.against, best.proof, best.against, drives=best.drives,
                          apart=best.apart, saves=saved(known.errors, best.errors))
        if not best.against:
            return _taken(known, best, finding, failed)
        failed.append(finding)
        if bench.enough(0.8):
            break
    names = {f.name for f in failed}
    return replace(known, findings=_with_findings(known.findings, failed), chosen=(*known.chosen, order[0]),
                   effects=tuple(e for e in known.effects if e.name not in names),
                   rejected=(*known.rejected, *(e for e in known.effects if e.name in names)))


def _with_findings(findings, new: Sequence[Finding]) -> tuple[Finding, ...]:
    names = {f.name for f in new}
    return (*(f for f in findings if f.name not in names), *new)


def _taken(known: Known, best: Judged, finding: Finding, failed: list[Finding]) -> Known:
    """With what was judged in the model; what did not help before may help now."""
    effects = tuple(e for e in dict.fromkeys((*known.effects, *known.rejected)) if e.name != finding.name)
    return _hidden(replace(
        known, problem=best.model.problem, model=best.model, errors=best.errors, estimates=tuple(best.proof.estimates),
        findings=_with_findings(known.findings, [*failed, finding]), chosen=(*known.chosen, finding.name),
        effects=effects, rejected=(), hidden=known.hidden | best.hidden))


def _with(known: Known, candidate: Candidate, view: np.ndarray, bench: Bench) -> Model:
    """The present model with one candidate added and all fitted again from `view`, well enough to compare."""
    model = known.model
    if candidate.effect.replaces_model(candidate.values()):
        problem = known.problem.configured(bench.recordings,
                                           candidate.effect.adjusted(known.problem.given, candidate.values()))
        noise = noise_unknowns(problem)
        kept = [u for u in model.unknowns if not u.noise]
        x = np.append(calibrated(problem, noise), model.x[known.noise:])
        return fit(problem, [*noise, *kept], x, COMPARED)
    begin = [max(t, u.step) if u.variance else np.clip(t, -u.prior / 5, u.prior / 5)
             for t, u in zip(candidate.theta, candidate.unknowns)]
    return fit(known.problem, [*model.unknowns, *candidate.unknowns], np.concatenate([view, begin]), COMPARED)


def _judged(known: Known, candidate: Candidate, model: Model, bench: Bench) -> Judged:
    """What `candidate`, fitted as `model`, comes to on data it was not fitted to."""
    first = len(known.model.unknowns)
    if model.problem is not known.problem:
        # another mechanization has no parameter of its own that could have been fitted to the data
        model = refined(model)
        proof = gain_of(known.problem, known.model.residual, model.residual)
        alone = fit(known.problem.moved(known.model.unknowns, known.model.x), candidate.unknowns, candidate.theta)
        diluted = max(p.diluted for p in known.problem.each)
        parameters = {name: _diluted(e, diluted) for name, e in _estimates(candidate, alone, 0).items()}
        errors = bench.errors([model.problem.corrected(model.unknowns, model.x)])
        against = objection(proof, compared(known.errors, errors))
        return Judged(candidate, model, parameters, {}, proof, errors, against)
    model = refined(model)
    # what one drive has and another has not may be nothing in all together
    drives, apart = _by_drive(model, candidate.effect, known.noise, range(first, len(model.unknowns)))
    contradiction = f'the drives contradict each other ({said(drives)})' if apart else ''
    model, hidden = _completed(known, candidate, _pruned(model, first))
    if len(model.unknowns) == first:
        return Judged(candidate, known.model, {}, {}, HeldOut(0.0, 1.0, []), known.errors,
                      contradiction or 'not determined once all is fitted together', drives, apart)
    parameters = {name: e for name, e in _estimates(candidate, model, first).items()
                  if f'{candidate.name}.{name}' not in hidden}
    # the same noise levels may suit the shorter model better, too
    shorter = fit(known.problem, known.model.unknowns, model.x[:first], COMPARED)
    mask = known.problem.mask
    shorter = max(known.model, shorter, key=lambda m: m.likelihood(mask))
    proof = held_out(model, shorter, known.noise)
    errors = bench.errors([known.problem.corrected(model.unknowns, x) for x in proof.estimates])
    against = (implausible(candidate.name, parameters) or contradiction or _small(model, first)
               or objection(proof, compared(known.errors, errors)))
    return Judged(candidate, model, parameters, hidden, proof, errors, against, drives, apart)


def _diluted(estimate: Estimate, part: float) -> Estimate:
    """With what a regression on something that is not exact lacks in its sigma; what is less than SHOWN was tried."""
    if not estimate.known:
        return estimate
    sigma = float(np.hypot(estimate.sigma, part * estimate.value))
    if abs(estimate.value) < SHOWN * sigma:
        return Estimate(1.0, None, estimate.unit)
    return replace(estimate, sigma=sigma)


def _by_drive(model: Model, effect: Effect, noise: int, own: Sequence[int]):
    """What each of several drives says of the unknowns `own` (indices), and whether they contradict each other."""
    units = {p.name: p.unit for p in effect.traced}
    own = [i for i in own if model.unknowns[i].factor_on is None and not model.unknowns[i].variance]
    drives = {name: {p: replace(e, unit=units[p]) for p, e in found.items()}
              for name, found in by_drive(model, noise, own).items()} if own else {}
    return drives, contradicted(model, noise, own)


def _small(model: Model, first: int) -> str:
    """An objection to an effect none of whose parameters is PLAIN; empty where one is."""
    sigma = model.sigma()
    plain = [u.variance or u.factor_on is None and abs(x) >= PLAIN * s
             for u, x, s in zip(model.unknowns[first:], model.x[first:], sigma[first:])]
    return '' if any(plain) else f'less than {PLAIN:g} sigma'


def _pruned(trial: Model, first: int) -> Model:
    """`trial` without those of its unknowns from `first` on that turn out not to be determined, or not to be there.

    What can trade against another one of its effect (`_refined`) stays: together they are determined.
    """
    x, sigma = trial.x[first:], trial.sigma()[first:]
    keep = determined(x, sigma, trial.unknowns[first:]) & (np.abs(x) >= SHOWN * sigma)
    keep |= np.array([u.variance or u.factor_on is not None for u in trial.unknowns[first:]], dtype=bool)
    if keep.all():
        return trial
    kept = np.append(np.ones(first, dtype=bool), keep)
    return fit(trial.problem, [u for u, k in zip(trial.unknowns, kept) if k], trial.x[kept], REFITTED)


def _completed(known: Known, candidate: Candidate, trial: Model) -> tuple[Model, dict[str, str]]:
    """`trial` with what else of its effect the data determine now that noise levels need not stand for it."""
    present = {u.name for u in trial.unknowns}
    missing = [u for u in effect_unknowns(candidate.effect, candidate.fixed, trial.problem.attitude)
               if u.name not in present and u.parameter in candidate.undetermined]
    more = also_determined(trial.moved(), missing, trial.scores, trial.residual, trial.problem.mask)
    if more:
        first, start = len(trial.unknowns), np.append(trial.x, np.zeros(len(more)))
        trial = _pruned(fit(trial.problem, [*trial.unknowns, *more], start, REFITTED), first)
    return _refined(known, candidate.effect, trial) if candidate.effect.refined else (trial, {})


def _refined(known: Known, effect: Effect, trial: Model) -> tuple[Model, dict[str, str]]:
    """`trial` with the parameters that were tried estimated, too, from each start: where these end as good ones at
    other values, the data do not determine the effect's parameters."""
    first = len(known.model.unknowns)
    fits = []
    for fixed in effect.tried:
        factors = refined_unknowns(effect, fixed)
        unknowns = [*known.model.unknowns, *effect_unknowns(effect, fixed, known.problem.attitude), *factors]
        fits.append(fit(trial.problem, unknowns, np.append(trial.x, np.zeros(len(factors))), REFITTED))
    mask = trial.problem.mask
    best = max(fits, key=lambda m: m.likelihood(mask))
    good = [m for m in fits if m.likelihood(mask) > best.likelihood(mask) - CLOSE]
    hidden = {}
    for i in range(first, len(best.unknowns)):
        unknown = best.unknowns[i]
        found = [m.unknowns[i].meant(m.x[i], 0.0)[0] for m in good]
        if max(found) > APART * min(found):
            unit = next(p.unit for p in effect.traced if p.name == unknown.parameter)
            between = Estimate(None, None, unit, (min(found), max(found)))
            hidden[unknown.name] = f'{between.text()} explain the recording equally well'
    return best, hidden


def _estimates(best: Candidate, model: Model, first: int) -> dict[str, Estimate]:
    """Parameters of a finding, the unknowns of `model` from `first` on."""
    units = {p.name: p.unit for p in best.effect.traced}
    found = {name: Estimate(value, None, units[name]) for name, value in best.fixed.items() if value}
    sigma = model.sigma()
    for unknown, x, s in zip(model.unknowns[first:], model.x[first:], sigma[first:]):
        found[unknown.parameter] = Estimate(*unknown.meant(x, s), units[unknown.parameter])
    return widened(found)


# when all rounds are over

def without_superseded(known: Known, bench: Bench) -> Known:
    """Without what an effect that was added later has made superfluous."""
    for finding in [f for f in known.findings if f.added][:-1]:
        model = known.model
        kept = [i for i, u in enumerate(model.unknowns) if u.effect != finding.name or u.noise]
        if len(kept) == len(model.unknowns):
            continue
        without = fit(known.problem, [model.unknowns[i] for i in kept], model.x[kept], COMPARED)
        proof = held_out(model, without, known.noise)
        estimates = _by_part(without, known.noise)
        errors = bench.errors([known.problem.corrected(without.unknowns, x) for x in estimates])
        against = objection(proof, compared(errors, known.errors))
        if against:
            dropped = replace(finding, added=False, held_out=proof,
                              reason=f'superseded by an effect that was added later: {against}')
            known = replace(known, model=without, estimates=tuple(estimates), errors=errors, findings=tuple(
                dropped if f is finding else f for f in known.findings))
    return known


def without_undetermined(known: Known, bench: Bench) -> Known:
    """Without the parameters that effects added later have left undetermined."""
    pruned = _pruned(known.model, known.noise)
    if pruned is known.model:
        return known
    left = {u.name for u in pruned.unknowns}
    gone = {u.name: 'not determined by this recording' for u in known.model.unknowns if u.name not in left}
    findings = []
    for finding in known.findings:
        own = {u.name for u in known.model.unknowns if u.effect == finding.name and not u.noise}
        if finding.added and own and not own & left:
            finding = replace(finding, added=False, reason='not determined with the effects that were added later')
        findings.append(finding)
    estimates = tuple(_by_part(pruned, known.noise))
    known = replace(known, model=pruned, estimates=estimates, findings=tuple(findings), hidden=known.hidden | gone)
    return replace(known, errors=bench.errors(known.by_part()))


def _by_part(model: Model, noise: int) -> list[np.ndarray]:
    """The unknowns of `model` by the part that is held out."""
    return [model.refitted(model.problem.mask & ~part, noise)[0] for part in parts(model.problem)]


@dataclass(frozen=True)
class Correction:
    """One way to correct the parameters: for the whole drive, and by the part that is held out."""

    values: dict
    by_part: list[dict]
    factors: dict[str, float]
    effects: bool
    settings: tuple[Finding, ...] = ()


def concluded(known: Known, first: Known, bench: Bench) -> Diagnosis:
    """The corrections that are proven, and the errors before and after."""
    bench.origin.watched(None)
    bench.tell(CHOOSING, 'choosing noise levels')
    given = bench.origin.given
    configured = Correction(given, [given], {}, False)
    fitted = _levelled(configured, bench)
    corrections, against = _settled(known, first, fitted, configured, bench)
    bench.tell(MEASURING, 'measuring errors')
    before, noise_only = (bench.errors(models, full=True) for models in ([given], fitted.by_part))
    for correction in corrections:  # the last one is what was given
        better = correction.values != given
        after = bench.errors(correction.by_part, full=True) if better else before
        comparison = compared(before, after)
        worse = unproven(comparison, correction.effects) if better else ''
        if not worse:
            break
        if correction.effects:
            against = worse
    hidden = _not_shown(known, correction.settings)
    # a finding is added only where corrected.yaml holds it
    findings = _final(known, hidden, correction.values, given, bench.library)
    findings = [*(findings if correction.effects else (_only_told(f, against) for f in findings)),
                *correction.settings]
    model, origin = known.model, bench.origin
    drives = origin.each
    residuals = {'before': origin.before, 'fitted': origin.observed(fitted.values),
                 'after': origin.observed(correction.values), 'search': model.residual}
    bench.tell(LOOKING, 'looking at what is left')
    rests = [goes_with(moved, part(model.scores, where), part(model.residual, where))
             for moved, where in zip(model.moved().each, origin.slices)]
    explained = {u.name: float(np.exp(x)) for u, x in zip(model.unknowns, model.x) if u.noise}
    remarks = [_remarks(p) for p in drives]
    whole = Diagnosis(
        recordings=bench.recordings, values=given, problem=origin, residuals=residuals,
        detections={stage: detect(r, origin.mask) for stage, r in residuals.items()}, noise=correction.factors,
        explained=explained, rounds=list(known.rounds), chosen=list(known.chosen), findings=findings,
        hidden=hidden, corrected=correction.values,
        better=better, before=before, fitted=noise_only, after=after, comparison=comparison,
        rest=[rest for found in rests for rest in found],
        remarks=[said for said in remarks[0] if all(said in other for other in remarks)]
        + _noise_remarks(explained | correction.factors))
    if len(drives) < 2:
        return whole
    return replace(whole, drives=[_in_drive(whole, k, rests[k], remarks[k]) for k in range(len(drives))])


def _in_drive(whole: Diagnosis, k: int, rest: list[GoesWith], remarks: list[str]) -> Diagnosis:
    """The diagnosis of several drives as it looks in the k-th."""
    problem, recording, where = whole.problem.each[k], whole.recordings[k], whole.problem.slices[k]
    residuals = {stage: part(r, where) for stage, r in whole.residuals.items()}
    return replace(
        whole, recordings=(recording,), problem=Drives([problem]), residuals=residuals, rest=rest, remarks=remarks,
        detections={stage: detect(r, problem.mask) for stage, r in residuals.items()},
        before=whole.before.drives[recording.name], fitted=whole.fitted.drives[recording.name],
        after=whole.after.drives[recording.name],
        comparison=[row for row in whole.comparison if row.get('drive') == recording.name])


def _settled(known: Known, first: Known, fitted: Correction, configured: Correction,
             bench: Bench) -> tuple[list[Correction], str]:
    """What is proven together, the best first: effects with or without other noise levels, these alone, nothing. And
    what speaks against effects that are not."""
    options, against = [fitted], ''
    effects = configured
    if any(f.added for f in known.findings):
        effects = Correction(known.corrected(), known.by_part(), {}, True)
    effects = _with_mounting(_with_settings(effects, bench), bench)
    told = effects.settings
    if effects.values != configured.values:
        options += [_levelled(replace(effects, factors=fitted.factors), bench), effects]
    proven = []
    for option in options:
        if option.values == configured.values:
            continue
        errors = bench.errors(option.by_part)
        worse = unproven(compared(first.errors, errors), option.effects)
        if not worse and _merit(errors) > _merit(first.errors):
            proven.append((_merit(errors), option))
        elif option.effects:
            against = worse or 'positions are predicted less well with it'
    proven = [option for _, option in sorted(proven, key=lambda found: -found[0])]
    return [option if option.settings else replace(option, settings=tuple(_only_told(f, against) for f in told))
            for option in (*proven, configured)], against


def _only_told(finding: Finding, against: str) -> Finding:
    return replace(finding, added=False, changes={}, reason=finding.reason or against or 'errors do not shrink with it')


def _with_settings(correction: Correction, bench: Bench) -> Correction:
    """With what a direct look at the recording shows, and the settings against it where these help."""
    for effect in bench.library:
        sightings = {p.recording.name: effect.seen(bench.origin.given, p.full) for p in bench.origin.each}
        sightings = {name: sighting for name, sighting in sightings.items() if sighting is not None}
        if not sightings:
            continue
        units = {p.name: p.unit for p in effect.parameters}
        drives = {name: {n: Estimate(v, s, units[n]) for n, (v, s) in sighting.parameters.items()}
                  for name, sighting in sightings.items()}
        # the settings against it are those for the drive that has most of it
        most = max(sightings, key=lambda name: drives[name][effect.principal].value)
        sighting, several = sightings[most], len(bench.origin.each) > 1
        rest = [name for name in sightings if name != most]
        text = sighting.text + (f' (in {most}{"; also in " if rest else ""}{", ".join(rest)})' if several else '')
        finding = Finding(effect.name, [effect.name], drives[most], 0.0, 0.0, False, HeldOut(0.0, 1.0, []), seen=text,
                          drives=drives if several else {})
        further = [{**values, **sighting.helps} for values in (correction.values, *correction.by_part)]
        if further[0] == correction.values:
            finding = replace(finding, reason='the settings are made for it already')
        else:
            before, after = bench.errors(correction.by_part), bench.errors(further[1:])
            # what was counted in the samples needs no error that shrinks for a proof
            worse = unproven(compared(before, after), effects=True)
            if not worse:
                changes = {n: v for n, v in further[0].items() if v != correction.values[n]}
                finding = replace(finding, added=True, changes=changes, saves=saved(before, after))
                correction = replace(correction, values=further[0], by_part=further[1:], effects=True)
            else:
                finding = replace(finding, reason=f'with the settings against it {worse}')
        correction = replace(correction, settings=(*correction.settings, finding))
    return correction


def _with_mounting(correction: Correction, bench: Bench) -> Correction:
    """With the mounting's angles as the filter has learned them, where they are there and do no harm."""
    if MOUNTING not in {e.name for e in bench.library}:
        return correction
    found = learned.together([learned.angles(p.full, correction.values) for p in bench.origin.each])
    if found is None or not found.plain:
        return correction
    effect = next(e for e in bench.library if e.name == MOUNTING)

    def turned(values, angles):
        return effect.adjusted(values, {'roll': 0.0, **{n: angles[n] if n in found.plain else 0.0
                                                        for n in learned.STATES}})

    whole = {name: e.value for name, e in found.whole.items()}
    parted = correction.by_part * (len(parts(bench.origin)) if len(correction.by_part) == 1 else 1)
    # each part in turn with angles of other data, or of one half of them, so that their scatter is in the errors
    halves = found.halves or [whole]
    by_part = [turned(values, halves[k % len(halves)]) for k, values in enumerate(parted)]
    values = turned(correction.values, {n: whole.get(n, 0.0) for n in learned.STATES})
    finding = Finding(MOUNTING, [MOUNTING], found.plain, 0.0, 0.0, True, HeldOut(0.0, 1.0, []),
                      changes={'imu.mounting_rpy': values['imu.mounting_rpy']},
                      seen='the filter finds it itself in each drive, within a minute or two of it',
                      drives={p.recording.name: own for p, own in zip(bench.origin.each, found.drives)})
    before, after = bench.errors(correction.by_part), bench.errors(by_part)
    finding = replace(finding, saves=saved(before, after))
    reason = implausible(MOUNTING, found.plain) or found.contradicted or harm(compared(before, after))
    if reason:
        return replace(correction, settings=(*correction.settings, _only_told(finding, reason)))
    return replace(correction, values=values, by_part=by_part, settings=(*correction.settings, finding))


def _levelled(correction: Correction, bench: Bench) -> Correction:
    """`correction` with the noise levels that predict best; its factors are where the search begins, too."""
    claimed = float(np.median(np.sqrt(bench.origin.claimed[:, 0, 0])))
    levels = choose(correction.values, bench.each, which_part(bench.origin), len(parts(bench.origin)), claimed,
                    correction.factors)
    factors = {name: factor for name, factor in levels.factors.items() if factor != 1.0}
    by_part = correction.by_part * (len(levels.by_part) if len(correction.by_part) == 1 else 1)
    return replace(correction, values=multiplied(correction.values, factors, claimed), factors=factors,
                   by_part=[multiplied(values, chosen, claimed) for values, chosen in zip(by_part, levels.by_part)])


def _merit(measured: Measured) -> float:
    """Mean log likelihood of what was predicted, all horizons alike."""
    return float(np.mean([score.mean() for _, score in measured.scores() if len(score)]))


def _final(known: Known, hidden, corrected: dict, given: dict, library: Sequence[Effect]) -> list[Finding]:
    """All findings with the estimates of the last joint fit, and what each has changed in `corrected`."""
    model, sigma, found = known.model, known.model.sigma(), []
    effects = {e.name: e for e in library}
    for finding in known.findings:
        own = widened({u.parameter: Estimate(*u.meant(x, s), finding.parameters[u.parameter].unit)
                       for u, x, s in zip(model.unknowns, model.x, sigma)
                       if u.effect == finding.name and not u.noise and u.parameter in finding.parameters})
        parameters = finding.parameters
        if finding.added and own:
            parameters = {n: own.get(n, e) for n, e in parameters.items() if n in own or e.sigma is None}
        parameters = {n: e for n, e in parameters.items() if f'{finding.name}.{n}' not in hidden}
        if not finding.added:  # what is less than PLAIN is no news
            parameters = {n: e for n, e in parameters.items() if not e.known or abs(e.value) >= PLAIN * e.sigma}
            if not finding.apart and (not parameters or finding.held_out.gain <= 0):
                continue
        changes = {}
        if finding.added:
            effect = effects[finding.name]
            theta = {p.name: 0.0 for p in (*effect.parameters, *effect.traced)}
            theta |= {n: e.value for n, e in finding.parameters.items()}
            moved = effect.adjusted(given, theta)
            changes = {n: corrected[n] for n in given if moved[n] != given[n]}
            own = [i for i, u in enumerate(model.unknowns) if u.effect == finding.name and not u.noise]
            finding = replace(finding, drives=_by_drive(model, effect, known.noise, own)[0])
        found.append(replace(finding, parameters=parameters, changes=changes))
    return found


def _not_shown(known: Known, settings: Sequence[Finding]) -> dict[str, str]:
    """Effects and parameters of which nothing can be said, and why: as each effect was tested last."""
    estimated = {u.name for u in known.model.unknowns}
    last = {c.name: c for candidates in known.rounds for c in candidates}
    undetermined = {f'{c.name}.{name}': 'not determined by this recording' for c in last.values()
                    for name in c.undetermined if f'{c.name}.{name}' not in estimated}
    found = {f.name for f in known.findings if f.added} | {f.name for f in settings}
    return {name: why for name, why in {**known.hidden, **undetermined}.items() if name not in found}


def _noise_remarks(factors: dict[str, float]) -> list[str]:
    """Noise levels that are none: wrong settings, or something that is in no effect of the library."""
    return [f'{name} would have to be {factor:.0f} times as large as configured to explain this drive: no sensor is so '
            'much noisier than its settings, so this stands for something that is not in the library (vibration of the '
            'mount, samples that repeat, a scale or an axis that is not what it says).'
            for name, factor in factors.items() if name != 'gnss.sigma' and factor > 0.95 * LARGEST_FACTOR]


def _remarks(problem: Problem) -> list[str]:
    """What the recording lacks, and what recording would show more."""
    said, mask, seconds = [], problem.mask, (problem.stamp - problem.stamp[0]) * 1e-9
    turn = np.gradient(np.unwrap(problem.base.yaw), seconds)
    acceleration = np.gradient(np.hypot(*problem.base.velocity.T), seconds)
    if np.sqrt(np.mean(turn[mask] ** 2)) < TURNING:
        said.append('There are hardly any turns: lever arms, the gyroscope\'s scale and a mounting rotation need some '
                    'bends to both sides.')
    if np.sqrt(np.mean(acceleration[mask] ** 2)) < SPEEDING:
        said.append('The speed hardly changes: a time offset, scale factors and a mounting rotation need some braking '
                    'and speeding up.')
    gaps = np.diff(seconds)
    if len(gaps) and gaps.max() > 30:
        said.append(f'There are no fixes for {gaps.max():.0f} s in a part of the recording: it says little of that '
                    'part.')
    return said
