"""The search: find the residual, trace it to an effect the model lacks, add that effect, prove it (DESIGN, 5).

Each step takes what is known so far (`Known`, never changed) and returns what is known after it.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects.base import Effect
from ..effects.gnss_outliers import far_off
from . import learned_mounting
from .agreement import by_drive, contradicted, plainest_in_one, said
from .drives import Drives
from .estimate import Estimate, widened
from .findings import Finding
from .fit import Model, fit, refined, scores
from .folds import parts
from .held_out import CERTAIN, HeldOut, gain_of, held_out
from .judgement import all_in_all, compared, objection
from .measured import Measured, saved
from .noise import calibrated, noise_unknowns
from .outliers import isolated
from .plausible import implausible
from .problem import Problem
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
from .trial_runs import TrialRuns

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
#: effects that make fixes seem of another time
OF_FIXES = 'gnss_time_offset', 'gnss_latency', 'gnss_lag'
#: what lasts, and what changes and so can do all that it does: the plainer one is tried first
VARIED = dict.fromkeys(('gnss_time_offset', 'gnss_lag'), ('gnss_latency', 'gnss_coloured_noise'))


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


def begin(trials: TrialRuns) -> Known:
    """The model without effects: fixes that are off alone set aside, noise levels fitted."""
    trials.searching('fitting noise levels')
    problem = trials.origin
    noise = noise_unknowns(problem)
    [at] = problem.residuals(noise, [calibrated(problem, noise)])
    problem = problem.without(isolated(at, problem.mask) | _far_off(problem))
    noise = noise_unknowns(problem)
    model = fit(problem, noise, calibrated(problem, noise))
    return _hidden(Known(problem, model, trials.errors([trials.origin.given]), trials.library))


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
    reasons |= {name: why for name, why in learned_mounting.hides(known.problem.given).items() if name in reasons}
    fitted = {e.name for e in known.effects if e.traced}
    hidden = {name: why for name, why in reasons.items() if why and name in fitted}
    return replace(known, hidden=known.hidden | hidden,
                   effects=tuple(e for e in known.effects if not reasons[e.name]))


# one round: trace, try, judge

def add_best(known: Known, trials: TrialRuns) -> Known:
    """Trace from several starts, and add the best candidate that helps on held-out data.

    A `Known` without a further choice where nothing is significant."""
    if not known.effects:
        return known
    trials.searching('testing effects')
    views = starts(known)[:1 if trials.enough(0.6) else None]
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
    names += [plain for plain, varied in VARIED.items() if plain not in names and any(n in names for n in varied)
              and plain in best and best[plain][0].p_adjusted <= SIGNIFICANCE]
    # what is far off need not show where the search begins
    names += [name for name, sizes in trials.starts.items() if sizes and name not in names and name in best
              and best[name][0].scores is not None and (name in trials.certain or not known.rounds[:-1])]
    trials.searching(f'adding {" or ".join(names)}')
    return _tried(known, [best[name] for name in names], candidates, trials)


def replaced(known: Known, trials: TrialRuns) -> Known:
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
            trials.searching(f'trying {effect.name}')
            judged = _judged(known, candidate, _with(known, candidate, known.model.x, trials), trials)
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


def _tried(known: Known, significant, candidates: list[Candidate], trials: TrialRuns) -> Known:
    """With the best of the significant candidates in the model, if it helps on held-out data.

    Of those that explain the same, the position errors decide where these differ: a reference may know more. What
    cannot be is told and makes room for the next. What the recordings show for certain without a filter goes first.
    """
    chosen = {candidate.name: candidate for candidate, _ in significant}
    models = {candidate.name: _with(known, candidate, view, trials) for candidate, view in significant}
    mask = np.logical_and.reduce([model.problem.mask for model in models.values()])
    # another mechanization measures other things beside the fixes
    comparable = all(model.problem is known.problem for model in models.values())
    merit = {name: float(np.nansum((m.residual if comparable else m.residual.of_fixes).log_likelihood()[mask]))
             - len(chosen[name].theta) for name, m in models.items()}
    order = sorted(models, key=lambda name: (max(merit.get(n, -np.inf) for n in (name, *VARIED.get(name, ()))),
                                             name in VARIED), reverse=True)
    first = [*trials.certain, *(name for name in order if name not in trials.certain)]
    order.sort(key=first.index)
    failed: list[Finding] = []
    for name in order:
        # nothing stands for what the recordings show for certain
        alike = [name] if name in trials.certain else [
            e.name for e in known.effects if e.name in merit and abs(merit[e.name] - merit[name]) < CLOSE
            and e.name not in {f.name for f in failed}]
        same = [] if name in trials.certain else [
            n for n in group(chosen[alike[0]], candidates, known.problem.mask) if n not in alike]
        names = [*alike, *same]
        judged = {n: _judged(known, chosen[n], models[n], trials) for n in names if n in models}
        best = judged[names[0]]
        for n in names[1:]:
            if n in judged and not judged[n].against and (
                    best.against or all_in_all(compared(best.errors, judged[n].errors)) < 1 / DIFFERENT):
                best = judged[n]
        others = [n for n in names if n != best.candidate.name and (
            n not in judged or all_in_all(compared(best.errors, judged[n].errors)) < DIFFERENT)]
        sizes = trials.told(name, best.parameters) if best.against else best.parameters
        finding = Finding(best.candidate.name, [best.candidate.name, *others], sizes, best.candidate.gain,
                          best.candidate.p_adjusted, not best.against, best.proof, best.against, drives=best.drives,
                          apart=best.apart, saves=saved(known.errors, best.errors))
        if not best.against:
            return _taken(known, best, finding, failed)
        failed.append(finding)
        if trials.enough(0.8):
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


def _with(known: Known, candidate: Candidate, view: np.ndarray, trials: TrialRuns) -> Model:
    """The present model with one candidate added and all fitted again from `view`, well enough to compare."""
    model = known.model
    if candidate.effect.replaces_model(candidate.values()):
        problem = known.problem.configured(trials.recordings,
                                           candidate.effect.adjusted(known.problem.given, candidate.values()))
        noise = noise_unknowns(problem)
        kept = [u for u in model.unknowns if not u.noise]
        x = np.append(calibrated(problem, noise), model.x[known.noise:])
        return fit(problem, [*noise, *kept], x, COMPARED)
    begin = [max(t, u.step) if u.variance else np.clip(t, -u.prior / 5, u.prior / 5)
             for t, u in zip(candidate.theta, candidate.unknowns)]
    begins = [begin, *([sizes[u.parameter] for u in candidate.unknowns]
                       for sizes in trials.starts.get(candidate.name, ()))]
    fits = [fit(known.problem, [*model.unknowns, *candidate.unknowns], np.concatenate([view, start]), COMPARED)
            for start in begins]
    return max(fits, key=lambda m: m.likelihood(known.problem.mask))


def _judged(known: Known, candidate: Candidate, model: Model, trials: TrialRuns) -> Judged:
    """What `candidate`, fitted as `model`, comes to on data it was not fitted to."""
    first = len(known.model.unknowns)
    if model.problem is not known.problem:
        # another mechanization has no parameter of its own that could have been fitted to the data
        model = refined(model)
        proof = gain_of(known.problem, known.model.residual, model.residual)
        alone = fit(known.problem.moved(known.model.unknowns, known.model.x), candidate.unknowns, candidate.theta)
        diluted = max(p.diluted for p in known.problem.each)
        parameters = {name: _diluted(e, diluted) for name, e in _estimates(candidate, alone, 0).items()}
        errors = trials.errors([model.problem.corrected(model.unknowns, model.x)])
        against = objection(proof, compared(known.errors, errors))
        return Judged(candidate, model, parameters, {}, proof, errors, against)
    model = refined(model)
    # what one drive has and another has not may be nothing in all together
    drives, apart = by_drive_of(model, candidate.effect, known.noise, range(first, len(model.unknowns)))
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
    errors = trials.errors([known.problem.corrected(model.unknowns, x) for x in proof.estimates])
    against = (implausible(candidate.name, parameters, trials.shown) or _of_another_clock(known, candidate, trials)
               or contradiction or _small(model, first) or objection(proof, compared(known.errors, errors)))
    return Judged(candidate, model, parameters, hidden, proof, errors, against, drives, apart)


def _of_another_clock(known: Known, candidate: Candidate, trials: TrialRuns) -> str:
    """Why an offset of the fixes cannot be believed: a speed that comes late makes them seem early."""
    added = [finding.name for finding in known.findings if finding.added]
    late = trials.unset(added) if candidate.name in OF_FIXES else ()
    return f'{" and ".join(late)} {"come" if len(late) > 1 else "comes"} late for certain, which has to be set first' \
        if late else ''


def _diluted(estimate: Estimate, part: float) -> Estimate:
    """With what a regression on something that is not exact lacks in its sigma; what is less than SHOWN was tried."""
    if not estimate.known:
        return estimate
    sigma = float(np.hypot(estimate.sigma, part * estimate.value))
    if abs(estimate.value) < SHOWN * sigma:
        return Estimate(1.0, None, estimate.unit)
    return replace(estimate, sigma=sigma)


def by_drive_of(model: Model, effect: Effect, noise: int, own: Sequence[int]):
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
    own = len(trial.unknowns) > len(known.model.unknowns)
    return _refined(known, candidate.effect, trial) if candidate.effect.refined and own else (trial, {})


def _refined(known: Known, effect: Effect, trial: Model) -> tuple[Model, dict[str, str]]:
    """`trial` with the parameters that were tried estimated, too, from each start: where these end as good ones at
    other values, the data do not determine the effect's parameters."""
    first = len(known.model.unknowns)
    kept = {u.name for u in trial.unknowns[first:]}
    fits = []
    for fixed in effect.tried:
        factors = refined_unknowns(effect, fixed)
        own = [u for u in effect_unknowns(effect, fixed, known.problem.attitude) if u.name in kept]
        unknowns = [*known.model.unknowns, *own, *factors]
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

def without_superseded(known: Known, trials: TrialRuns) -> Known:
    """Without what an effect that was added later has made superfluous, unless it is shown without a filter."""
    for finding in [f for f in known.findings if f.added and f.name not in trials.certain][:-1]:
        model = known.model
        kept = [i for i, u in enumerate(model.unknowns) if u.effect != finding.name or u.noise]
        if len(kept) == len(model.unknowns):
            continue
        without = fit(known.problem, [model.unknowns[i] for i in kept], model.x[kept], COMPARED)
        proof = held_out(model, without, known.noise)
        estimates = _by_part(without, known.noise)
        errors = trials.errors([known.problem.corrected(without.unknowns, x) for x in estimates])
        against = objection(proof, compared(errors, known.errors))
        if against:
            dropped = replace(finding, added=False, held_out=proof,
                              reason=f'superseded by an effect that was added later: {against}')
            known = replace(known, model=without, estimates=tuple(estimates), errors=errors, findings=tuple(
                dropped if f is finding else f for f in known.findings))
    return known


def without_undetermined(known: Known, trials: TrialRuns) -> Known:
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
    return replace(known, errors=trials.errors(known.by_part()))


def _by_part(model: Model, noise: int) -> list[np.ndarray]:
    """The unknowns of `model` by the part that is held out."""
    return [model.refitted(model.problem.mask & ~part, noise)[0] for part in parts(model.problem)]
