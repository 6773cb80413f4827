"""The search for effects that the model lacks: test all candidates on the innovations, add the best one, and keep it if
predictions of held-out data become better (docs/closing_the_loop.md).

Each step takes the state of the search (`SearchState`, which is never changed) and returns the state after it.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects.gnss_outliers import far_off
from . import learned_mounting
from .agreement import plainest_in_one
from .candidate_proof import (
    CLOSE,
    COMPARED,
    REFITTED,
    TestedCandidate,
    prune,
    sizes_with_sigma,
    tested_on_held_out,
    too_small_effect,
    with_candidate,
)
from .drives import Drives
from .error_changes import compared, objection, objection_to_errors, overall_ratio
from .estimate import Estimate
from .exact import sigmas
from .findings import Finding
from .fit import FittedModel, fit, scores
from .folds import part_masks
from .held_out import CERTAIN, held_out
from .known import SearchState
from .measured import errors_near_30_s
from .noise import calibrated, noise_unknowns
from .outliers import isolated
from .plausible import implausible
from .tracing import (
    FAMILY_ERROR_RATE,
    Candidate,
    effect_unknowns,
    group,
    trace,
)
from .trial_runs import TrialRuns

#: number of candidates that one round fits from one start, to see which of them explains most
TRIED = 3
#: smallest gain of a candidate that is fitted, as a share of the largest gain
PART = 0.2
#: largest number of candidates that one round fits, of all starts together: each fit takes seconds
MOST_TRIED = 4
#: share of the largest amount of work (`TrialRuns.done`) after which a round tests from one start only: each further
#: start takes as long
ONE_START = 0.6
#: the same share, after which a round tries no other candidate if the first one has failed
ONE_CANDIDATE = 0.8
#: noise levels of the third start, on the way from the configured ones (0) to the fitted ones (1)
BETWEEN = 0.5
#: ratio of two position errors above which two effects that explain the same innovations are distinguished
DIFFERENT = 1.1
#: difference of noise levels (natural logarithm) below which two starts are the same
SAME_START = 0.7
#: largest ratio of the sigma of a time offset and the stated one with which it replaces the stated offset: as much as
#: with half as many data more
SHARPER = 0.8
#: for effects that are constant, those that vary with time and so explain the same data, too. The constant one is tried
#: first
VARIED = dict.fromkeys(('gnss_time_offset', 'gnss_lag'), ('gnss_latency', 'gnss_coloured_noise'))


def begin(trials: TrialRuns) -> SearchState:
    """The search before its first round: no effects, noise levels fitted, single fixes that are far off left out."""
    trials.searching('fitting noise levels')
    problem = trials.origin
    noise = noise_unknowns(problem)
    [at] = problem.residuals(noise, [calibrated(problem, noise)])
    problem = problem.without(isolated(at, problem.mask) | _far_off(problem))
    noise = noise_unknowns(problem)
    model = fit(problem, noise, calibrated(problem, noise))
    return _without_hidden(SearchState(problem, model, trials.errors([trials.origin.given]), trials.library))


def _far_off(problem: Drives) -> np.ndarray:
    """(f,) bool: whether a fix is far from where the fixes before it and those after it place the vehicle."""
    found = np.zeros(len(problem.stamp), dtype=bool)
    for drive, where in zip(problem.each, problem.slices):
        found[where.start + far_off(drive.drive.gnss)[0]] = True
    return found


def _without_hidden(known: SearchState) -> SearchState:
    """`known` without the effects that do not show in any of the drives."""
    reasons = {}
    for e in known.effects:
        own = [e.hidden(known.problem.given, p.recording) for p in known.problem.each]
        reasons[e.name] = own[0] if all(own) else ''
    reasons |= {name: why for name, why in learned_mounting.estimated_by_filter(known.problem.given).items()
                if name in reasons}
    fitted = {e.name for e in known.effects if e.traced}
    hidden = {name: why for name, why in reasons.items() if why and name in fitted}
    return replace(known, hidden=known.hidden | hidden,
                   effects=tuple(e for e in known.effects if not reasons[e.name]))


# one round: score tests, fits, proof on held-out data

def add_best(known: SearchState, trials: TrialRuns) -> SearchState:
    """`known` with the best candidate that improves predictions of held-out data; score tests are made from several
    starts. `chosen` stays as it is if nothing is significant."""
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
        plain = [c for c in traced if c.p_adjusted <= FAMILY_ERROR_RATE and c.scores is not None]
        plain.sort(key=lambda c: 2 * len(c.theta) - c.gain)
        significant += [(rank, c, view) for rank, c in enumerate(plain[:TRIED]) if c.gain >= PART * plain[0].gain]
        alone = plainest_in_one(traced, moved)
        if alone is not None and alone[1] <= FAMILY_ERROR_RATE:
            significant.append((TRIED, alone[0], view))
    candidates = sorted((c for c, _ in best.values()), key=lambda c: (c.p, -c.gain))
    known = replace(known, rounds=(*known.rounds, candidates))
    best |= {name: (_with_all(best[name][0], known), best[name][1]) for name in trials.certain if name in best}
    # each is fitted from the start where it explains most; first those that explain most of all at a start
    names = [c.name for _, c, _ in sorted(significant, key=lambda found: (found[0], best[found[1].name][0].p))]
    names = list(dict.fromkeys(names))[:MOST_TRIED]
    names += [plain for plain, varied in VARIED.items() if plain not in names and any(n in names for n in varied)
              and plain in best and best[plain][0].p_adjusted <= FAMILY_ERROR_RATE]
    # an effect that is large may not show at noise levels that were fitted without it
    names += [name for name, sizes in trials.starts.items() if sizes and name not in names and name in best
              and (name in trials.certain or best[name][0].scores is not None and not known.rounds[:-1])]
    if not names:
        return known
    others = f' or {len(names) - 1} others' if len(names) > 2 else ''.join(f' or {name}' for name in names[1:])
    trials.searching(f'adding {names[0]}{others}')
    return _with_best_of(known, [best[name] for name in names], candidates, trials)


def _with_all(candidate: Candidate, known: SearchState) -> Candidate:
    """A candidate that recordings show for certain without a filter, with all its parameters. An input that is far off
    is refused by the filter, so that innovations show nothing of it until it is nearly right."""
    if not candidate.undetermined:
        return candidate
    unknowns = effect_unknowns(candidate.effect, candidate.fixed, known.problem.attitude)
    return replace(candidate, unknowns=unknowns, theta=np.zeros(len(unknowns)), sigma=np.full(len(unknowns), np.inf),
                   undetermined=[])


def with_other_mechanization(known: SearchState, trials: TrialRuns) -> SearchState:
    """`known` with the mechanization that an effect asks for (tilt: strapdown), if that certainly predicts better.

    Nothing is fitted to the data for it, so no score test is needed. On hills a filter without tilt may not pass it,
    because its fitted noise levels contain the slopes.
    """
    for effect in known.effects:
        for fixed in effect.tried:
            unknowns = effect_unknowns(effect, fixed, known.problem.attitude)
            candidate = Candidate(effect, unknowns, np.ones(len(unknowns)), np.full(len(unknowns), np.inf), 0.0, 1.0,
                                  None, [], fixed)
            if not effect.replaces_model(candidate.values()):
                continue
            trials.searching(f'trying {effect.name}')
            judged = tested_on_held_out(known, candidate, with_candidate(known, candidate, known.model.x, trials),
                                        trials)
            if judged.against or judged.proof.p > CERTAIN:
                continue
            candidate = replace(candidate, gain=2 * judged.proof.gain, p=judged.proof.p, p_adjusted=judged.proof.p)
            finding = Finding(effect.name, [effect.name], judged.parameters, candidate.gain, candidate.p, True,
                              judged.proof, saves=errors_near_30_s(known.errors, judged.errors))
            return _with_added(replace(known, rounds=(*known.rounds, [candidate])), judged, finding, [])
    return known


def starts(known: SearchState) -> list[np.ndarray]:
    """The unknowns at which score tests are made: with noise levels as fitted, as configured (the receiver's as its
    fixes scatter), and in the first round with those between the two.

    An effect may not show at fitted levels, because they have grown to explain it, nor at configured ones, if other
    effects are larger there.
    """
    model, n = known.model, known.noise
    configured = calibrated(known.problem, model.unknowns, model.x)
    found = [model.x]
    for x in (configured, (1 - BETWEEN) * configured + BETWEEN * model.x)[:1 if known.rounds else 2]:
        if all(np.abs(x[:n] - other[:n]).max() > SAME_START for other in found):
            found.append(x)
    return found


def _with_best_of(known: SearchState, significant, candidates: list[Candidate], trials: TrialRuns) -> SearchState:
    """`known` with the best of the significant candidates, if it improves predictions of held-out data.

    If several explain the same innovations, the one with the smaller position errors is taken: a reference may show
    what fixes do not. A candidate that fails is reported, and the next one is tried. Those that the recordings show for
    certain without a filter are tried first.
    """
    chosen = {candidate.name: candidate for candidate, _ in significant}
    models = {candidate.name: with_candidate(known, candidate, view, trials) for candidate, view in significant}
    mask = np.logical_and.reduce([model.problem.mask for model in models.values()])
    # with another mechanization there are other measurements besides the fixes: only those of the fixes are compared
    comparable = all(model.problem is known.problem for model in models.values())
    merit = {name: float(np.nansum((m.residual if comparable else m.residual.of_fixes).log_likelihood()[mask]))
             - len(chosen[name].theta) for name, m in models.items()}
    order = sorted(models, key=lambda name: (max(merit.get(n, -np.inf) for n in (name, *VARIED.get(name, ()))),
                                             name in VARIED), reverse=True)
    first = [*trials.certain, *(name for name in order if name not in trials.certain)]
    order.sort(key=first.index)
    failed: list[Finding] = []
    for name in order:
        # an effect that the recordings show for certain is in no group with others
        alike = [name] if name in trials.certain else [
            e.name for e in known.effects if e.name in merit and abs(merit[e.name] - merit[name]) < CLOSE
            and e.name not in {f.name for f in failed}]
        same = [] if name in trials.certain else [
            n for n in group(chosen[alike[0]], candidates, known.problem.mask) if n not in alike]
        names = [*alike, *same]
        judged = {n: tested_on_held_out(known, chosen[n], models[n], trials) for n in names if n in models}
        best = judged[names[0]]
        for n in names[1:]:
            if n in judged and not judged[n].against and (
                    best.against or overall_ratio(compared(best.errors, judged[n].errors)) < 1 / DIFFERENT):
                best = judged[n]
        others = [n for n in names if n != best.candidate.name and not _is_ruled_out(n, candidates, trials) and (
            n not in judged or overall_ratio(compared(best.errors, judged[n].errors)) < DIFFERENT)]
        sizes = trials.told(name, best.parameters) if best.against else best.parameters
        finding = Finding(best.candidate.name, [best.candidate.name, *others], sizes, best.candidate.gain,
                          best.candidate.p_adjusted, not best.against, best.proof, best.against, drives=best.drives,
                          drives_contradict=best.drives_contradict, saves=errors_near_30_s(known.errors, best.errors))
        if not best.against:
            return _with_added(known, best, finding, failed)
        failed.append(finding)
        if trials.enough(ONE_CANDIDATE):
            break
    names = {f.name for f in failed}
    return replace(known, findings=_with_findings(known.findings, failed), chosen=(*known.chosen, order[0]),
                   effects=tuple(e for e in known.effects if e.name not in names),
                   rejected=(*known.rejected, *(e for e in known.effects if e.name in names)))


def _is_ruled_out(name: str, candidates: Sequence[Candidate], trials: TrialRuns) -> bool:
    """Whether the candidate of this name has a size that no vehicle has, or that the recordings contradict."""
    return any(c.name == name and implausible(name, {n: Estimate(x, None, '') for n, x in c.values().items()},
                                              trials.shown) for c in candidates)


def _with_findings(findings, new: Sequence[Finding]) -> tuple[Finding, ...]:
    names = {f.name for f in new}
    return (*(f for f in findings if f.name not in names), *new)


def _with_added(known: SearchState, best: TestedCandidate, finding: Finding, failed: list[Finding]) -> SearchState:
    """`known` with the effect that was judged. Effects that failed before are candidates again: they may help now."""
    effects = tuple(e for e in dict.fromkeys((*known.effects, *known.rejected)) if e.name != finding.name)
    return _without_hidden(replace(
        known, problem=best.model.problem, model=best.model, errors=best.errors, estimates=tuple(best.proof.estimates),
        findings=_with_findings(known.findings, [*failed, finding]), chosen=(*known.chosen, finding.name),
        effects=effects, rejected=(), hidden=known.hidden | best.hidden))


# when all rounds are over

def without_superseded(known: SearchState, trials: TrialRuns) -> SearchState:
    """`known` without the effects that are no longer needed since another one was added, unless the recordings show
    them without a filter."""
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


def without_undetermined(known: SearchState, trials: TrialRuns) -> SearchState:
    """`known` without the effects and parameters that are not determined any more since others were added, or that no
    vehicle can have: the limits are those for adding an effect."""
    model, reasons, impossible = known.model, {}, {}
    sigma = sigmas(model, trials.beside.track, trials.origin.given)
    for finding in known.findings:
        own = [i for i, u in enumerate(model.unknowns) if u.effect == finding.name and not u.noise]
        if not (finding.added and own):
            continue
        sizes = sizes_with_sigma(finding, model, sigma)
        why = implausible(finding.name, sizes, trials.shown)
        if why:
            impossible[finding.name] = sizes
        elif finding.name not in trials.certain and (less := too_small_effect(model, own, sigma)):
            why = f'{less} with the effects that were added later'
        if why:
            reasons[finding.name] = why
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
            finding = replace(finding, added=False, parameters=finding.parameters | impossible.get(finding.name, {}),
                              reason=reasons.get(
                                  finding.name, 'not determined with the effects that were added later'))
        findings.append(finding)
    estimates = tuple(_by_part(pruned, known.noise))
    known = replace(known, model=pruned, estimates=estimates, findings=tuple(findings), hidden=known.hidden | gone)
    return replace(known, errors=trials.errors(known.by_part()))


def with_offset_known_better(known: SearchState, trials: TrialRuns) -> SearchState:
    """`known` with another value of gnss.time_offset, where the params file states one, not zero, with its sigma and
    the recordings tell it with a plainly smaller one.

    That there is an offset is not in question then, so what is left of it need not be different from zero for certain:
    by that, a stated value that is one or two sigma off would stay only because the search begins at it. It is set if
    predictions of held-out data gain, for certain or not, and no error grows.
    """
    stated = trials.origin.given['gnss.time_offset_sigma']
    effect = next((e for e in (*known.effects, *known.rejected) if e.name == 'gnss_time_offset'), None)
    if not stated or not trials.origin.given['gnss.time_offset'] or effect is None:
        return known
    unknowns = [*known.model.unknowns, *effect_unknowns(effect, {})]
    model = fit(known.problem, unknowns, np.append(known.model.x, 0.0), REFITTED)
    sigma = float(sigmas(model, trials.beside.track, trials.origin.given)[-1])
    if sigma > SHARPER * stated:
        return known
    proof = held_out(model, known.model, known.noise, support=0.0)
    errors = trials.errors([known.problem.corrected(unknowns, x) for x in proof.estimates])
    if proof.gain <= 0.0 or objection_to_errors(compared(known.errors, errors)):
        return known
    [parameter] = effect.traced
    finding = Finding(effect.name, [effect.name], {parameter.name: Estimate(float(model.x[-1]), sigma, parameter.unit)},
                      2 * proof.gain, proof.p, True, proof, saves=errors_near_30_s(known.errors, errors))
    return replace(known, model=model, errors=errors, estimates=tuple(proof.estimates),
                   findings=_with_findings(known.findings, [finding]),
                   effects=tuple(e for e in known.effects if e.name != effect.name))


def _by_part(model: FittedModel, noise: int) -> list[np.ndarray]:
    """The unknowns of `model`, fitted with each of the parts held out in turn."""
    return [model.refitted(model.problem.mask & ~part, noise)[0] for part in part_masks(model.problem)]
