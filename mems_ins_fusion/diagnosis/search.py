"""The search: find the residual, trace it to an effect the model lacks, add that effect, prove it (DESIGN, 5).

Each step takes what is known so far (`Known`, never changed) and returns what is known after it.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects.gnss_outliers import far_off
from . import learned_mounting
from .agreement import plainest_in_one
from .drives import Drives
from .estimate import Estimate
from .exact import sigmas
from .findings import Finding
from .fit import Model, fit, scores
from .folds import parts
from .held_out import CERTAIN, held_out
from .judgement import all_in_all, compared, objection
from .judging import CLOSE, COMPARED, REFITTED, Judged, judge, prune, small, with_candidate
from .known import Known
from .measured import saved
from .noise import calibrated, noise_unknowns
from .outliers import isolated
from .plausible import implausible
from .tracing import (
    SIGNIFICANCE,
    Candidate,
    effect_unknowns,
    group,
    trace,
)
from .trial_runs import TrialRuns

#: candidates that are fitted in one round from each start, to see which explains most
TRIED = 3
#: share of the largest gain that a candidate needs to be fitted
PART = 0.2
#: candidates that are fitted in one round from all starts together, as each fit takes long
MOST_TRIED = 4
#: share of the work of a search after which a round traces from one start alone: each further one takes as long
ONE_START = 0.6
#: the same, after which a round that has failed with a candidate tries no other
ONE_CANDIDATE = 0.8
#: of the way from noise levels as configured to those fitted: the start between them
BETWEEN = 0.5
#: position errors all in all that differ by this factor tell effects apart
DIFFERENT = 1.1
#: noise levels that differ by less than this (natural logarithm) make no other start
SAME_START = 0.7
#: what lasts, and what changes and so can do all that it does: the plainer one is tried first
VARIED = dict.fromkeys(('gnss_time_offset', 'gnss_lag'), ('gnss_latency', 'gnss_coloured_noise'))


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
    views = starts(known)[:1 if trials.enough(ONE_START) else None]
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
    others = f' or {len(names) - 1} others' if len(names) > 2 else ''.join(f' or {name}' for name in names[1:])
    trials.searching(f'adding {names[0]}{others}')
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
            judged = judge(known, candidate, with_candidate(known, candidate, known.model.x, trials), trials)
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
    for x in (configured, (1 - BETWEEN) * configured + BETWEEN * model.x)[:1 if known.rounds else 2]:
        if all(np.abs(x[:n] - other[:n]).max() > SAME_START for other in found):
            found.append(x)
    return found


def _tried(known: Known, significant, candidates: list[Candidate], trials: TrialRuns) -> Known:
    """With the best of the significant candidates in the model, if it helps on held-out data.

    Of those that explain the same, the position errors decide where these differ: a reference may know more. What
    cannot be is told and makes room for the next. What the recordings show for certain without a filter goes first.
    """
    chosen = {candidate.name: candidate for candidate, _ in significant}
    models = {candidate.name: with_candidate(known, candidate, view, trials) for candidate, view in significant}
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
        judged = {n: judge(known, chosen[n], models[n], trials) for n in names if n in models}
        best = judged[names[0]]
        for n in names[1:]:
            if n in judged and not judged[n].against and (
                    best.against or all_in_all(compared(best.errors, judged[n].errors)) < 1 / DIFFERENT):
                best = judged[n]
        others = [n for n in names if n != best.candidate.name and not _denied(n, candidates, trials) and (
            n not in judged or all_in_all(compared(best.errors, judged[n].errors)) < DIFFERENT)]
        sizes = trials.told(name, best.parameters) if best.against else best.parameters
        finding = Finding(best.candidate.name, [best.candidate.name, *others], sizes, best.candidate.gain,
                          best.candidate.p_adjusted, not best.against, best.proof, best.against, drives=best.drives,
                          apart=best.apart, saves=saved(known.errors, best.errors))
        if not best.against:
            return _taken(known, best, finding, failed)
        failed.append(finding)
        if trials.enough(ONE_CANDIDATE):
            break
    names = {f.name for f in failed}
    return replace(known, findings=_with_findings(known.findings, failed), chosen=(*known.chosen, order[0]),
                   effects=tuple(e for e in known.effects if e.name not in names),
                   rejected=(*known.rejected, *(e for e in known.effects if e.name in names)))


def _denied(name: str, candidates: Sequence[Candidate], trials: TrialRuns) -> bool:
    """Whether the recordings, or reason, deny what the candidate of this name would have to be."""
    return any(c.name == name and implausible(name, {n: Estimate(x, None, '') for n, x in c.values().items()},
                                              trials.shown) for c in candidates)


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
    """Without the effects and parameters that effects added later have left undetermined: what is added has to be as
    plain in the end as when it was added."""
    model, reasons = known.model, {}
    sigma = sigmas(model, trials.beside.track, trials.origin.given)
    for finding in known.findings:
        own = [i for i, u in enumerate(model.unknowns) if u.effect == finding.name and not u.noise]
        if finding.added and own and finding.name not in trials.certain and (why := small(model, own, sigma)):
            reasons[finding.name] = f'{why} with the effects that were added later'
    kept = [i for i, u in enumerate(model.unknowns) if u.noise or u.effect not in reasons]
    if reasons:
        model = fit(known.problem, [model.unknowns[i] for i in kept], model.x[kept], REFITTED)
    pruned = prune(model, known.noise)
    if pruned is known.model:
        return known
    left = {u.name for u in pruned.unknowns}
    gone = {u.name: 'not determined by this recording' for u in known.model.unknowns
            if u.name not in left and u.effect not in reasons}
    findings = []
    for finding in known.findings:
        own = {u.name for u in known.model.unknowns if u.effect == finding.name and not u.noise}
        if finding.added and own and not own & left:
            finding = replace(finding, added=False, reason=reasons.get(
                finding.name, 'not determined with the effects that were added later'))
        findings.append(finding)
    estimates = tuple(_by_part(pruned, known.noise))
    known = replace(known, model=pruned, estimates=estimates, findings=tuple(findings), hidden=known.hidden | gone)
    return replace(known, errors=trials.errors(known.by_part()))


def _by_part(model: Model, noise: int) -> list[np.ndarray]:
    """The unknowns of `model` by the part that is held out."""
    return [model.refitted(model.problem.mask & ~part, noise)[0] for part in parts(model.problem)]
