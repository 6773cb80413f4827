"""A candidate of the search in detail: fitted together with all other unknowns, and its proof on held-out data."""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects.base import Effect
from .agreement import by_drive, contradicted, drives_text
from .error_changes import compared, objection
from .estimate import PLAIN, Estimate, widened
from .exact import sigmas
from .findings import Finding
from .fit import FittedModel, fit, fitted_further
from .held_out import HeldOut, certainly_better, gain_of, held_out
from .known import SearchState
from .measured import MeasuredErrors
from .noise import calibrated, noise_unknowns
from .plausible import implausible
from .tracing import Candidate, also_determined, determined, effect_unknowns, refined_unknowns
from .trial_runs import TrialRuns

#: largest difference of the log likelihoods of two fits from different starts that count as equally good
CLOSE = 3.3
#: ratio of two values that fit equally well, above which a parameter is not determined
APART = 1.5
#: sigmas from the best value, beyond which another one that fits as well is outside its 95 % interval: the same
OUTSIDE = 2.0
COMPARED = 3  # number of iterations of a fit that is only compared with others
REFITTED = 4  # number of iterations of a fit that starts near its maximum
SHOWN = 2.0  # smallest ratio of value and sigma with which a parameter of an effect is kept
#: effects that fixes with wrong time stamps can cause
OF_FIXES = 'gnss_time_offset', 'gnss_latency', 'gnss_lag'


@dataclass(frozen=True)
class TestedCandidate:
    """A candidate with its proof. model: with it. parameters: its sizes. hidden: by name, why a parameter is not
    determined. proof, errors: on held-out data. against: in words, why it is not added; empty if it is. drives: its
    sizes in each drive. drives_contradict: whether these contradict each other."""

    candidate: Candidate
    model: FittedModel
    parameters: dict[str, Estimate]
    hidden: dict[str, str]
    proof: HeldOut
    errors: MeasuredErrors
    against: str
    drives: dict[str, dict[str, Estimate]] = field(default_factory=dict)
    drives_contradict: bool = False


def with_candidate(known: SearchState, candidate: Candidate, view: np.ndarray, trials: TrialRuns) -> FittedModel:
    """The present model with one candidate, fitted from the unknowns `view` with few iterations, for a comparison."""
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
    begins = [begin, *([sizes[u.parameter] ** (2 if u.variance else 1) for u in candidate.unknowns]
                       for sizes in trials.starts.get(candidate.name, ()))]
    fits = [fit(known.problem, [*model.unknowns, *candidate.unknowns], np.concatenate([view, start]), COMPARED)
            for start in begins]
    return max(fits, key=lambda m: m.likelihood(known.problem.mask))


def tested_on_held_out(known: SearchState, candidate: Candidate, model: FittedModel,
                       trials: TrialRuns) -> TestedCandidate:
    """The proof of `candidate`, which `model` contains, on data that it was not fitted to."""
    first = len(known.model.unknowns)
    if model.problem is not known.problem:
        # another mechanization has no parameter of its own that could have been fitted to the data
        model = fitted_further(model)
        proof = gain_of(known.problem, known.model.residual, model.residual)
        alone = fit(known.problem.moved(known.model.unknowns, known.model.x), candidate.unknowns, candidate.theta)
        diluted = max(p.diluted for p in known.problem.each)
        parameters = {name: _diluted(e, diluted) for name, e in _estimates(candidate, alone, 0, alone.sigma()).items()}
        errors = trials.errors([model.problem.corrected(model.unknowns, model.x)])
        against = objection(proof, compared(known.errors, errors))
        return TestedCandidate(candidate, model, parameters, {}, proof, errors, against)
    model = fitted_further(model)
    # an effect that only one of the drives has can be undetermined in all of them together
    drives, apart = by_drive_of(model, candidate.effect, known.noise, range(first, len(model.unknowns)))
    contradiction = f'the drives contradict each other ({drives_text(drives)})' if apart else ''
    model, hidden = _completed(known, candidate, prune(model, first))
    if len(model.unknowns) == first:
        return TestedCandidate(candidate, known.model, {}, {}, HeldOut(0.0, 1.0, []), known.errors,
                               contradiction or 'not determined once all is fitted together', drives, apart)
    sigma = sigmas(model, trials.beside.track, trials.origin.given)
    parameters = {name: e for name, e in _estimates(candidate, model, first, sigma).items()
                  if f'{candidate.name}.{name}' not in hidden}
    # the model without it gets the chance of the same noise levels
    shorter = fit(known.problem, known.model.unknowns, model.x[:first], COMPARED)
    mask = known.problem.mask
    shorter = max(known.model, shorter, key=lambda m: m.likelihood(mask))
    proof = held_out(model, shorter, known.noise)
    errors = trials.errors([known.problem.corrected(model.unknowns, x) for x in proof.estimates])
    # where the recordings show for certain that it is there, the sigma of the fit alone is enough
    plain = model.sigma() if candidate.name in trials.certain else sigma
    against = (implausible(candidate.name, parameters, trials.shown) or _of_another_clock(known, candidate, trials)
               or contradiction or too_small_effect(model, range(first, len(model.unknowns)), plain)
               or objection(proof, compared(known.errors, errors)))
    return TestedCandidate(candidate, model, parameters, hidden, proof, errors, against, drives, apart)


def _of_another_clock(known: SearchState, candidate: Candidate, trials: TrialRuns) -> str:
    """In words, why a time offset of the fixes is not reliable: another input is late, which makes fixes appear early.
    Empty if none is."""
    added = [finding.name for finding in known.findings if finding.added]
    late = trials.unset(added) if candidate.name in OF_FIXES else ()
    return f'{" and ".join(late)} {"come" if len(late) > 1 else "comes"} late for certain, which has to be set first' \
        if late else ''


def too_small_effect(model: FittedModel, own: Sequence[int], sigma: np.ndarray) -> str:
    """In words, that an effect is too small: none of its unknowns `own` (indices) is PLAIN times its sigma, or a size
    or a time is not larger than its sigma. Empty if it is not. sigma: (p,), of all unknowns.

    A variance cannot be negative, so whether there is one is decided by its likelihood, not here.
    """
    found = [(model.unknowns[i], model.x[i], sigma[i]) for i in own]
    if not any(u.variance or u.factor_on is None and abs(x) >= PLAIN * s for u, x, s in found):
        return f'less than {PLAIN:g} sigma'
    for unknown, x, s in found:
        if unknown.variance or unknown.factor_on is not None:
            value, own_sigma = unknown.meant(x, s)
            if value <= own_sigma:
                return f'{unknown.parameter} is not determined: its sigma is as large as the value'
    return ''


def sizes_with_sigma(finding: Finding, model: FittedModel, sigma: np.ndarray) -> dict[str, Estimate]:
    """The parameters of an effect that are in `model`; sigma: (p,) of all its unknowns."""
    return widened({u.parameter: Estimate(*u.meant(x, s), finding.parameters[u.parameter].unit)
                    for u, x, s in zip(model.unknowns, model.x, sigma)
                    if u.effect == finding.name and not u.noise and u.parameter in finding.parameters})


def _diluted(estimate: Estimate, part: float) -> Estimate:
    """`estimate` with the attenuation `part` of its regression in its sigma; without a value if that is below SHOWN
    sigma."""
    if not estimate.known:
        return estimate
    sigma = float(np.hypot(estimate.sigma, part * estimate.value))
    if abs(estimate.value) < SHOWN * sigma:
        return Estimate(1.0, None, estimate.unit)
    return replace(estimate, sigma=sigma)


def by_drive_of(model: FittedModel, effect: Effect, noise: int, own: Sequence[int]):
    """Estimates of the unknowns `own` (indices) from each of several drives, and whether they contradict each other."""
    units = {p.name: p.unit for p in effect.traced}
    own = [i for i in own if model.unknowns[i].factor_on is None and not model.unknowns[i].variance]
    drives = {name: {p: replace(e, unit=units[p]) for p, e in found.items()}
              for name, found in by_drive(model, noise, own).items()} if own else {}
    return drives, contradicted(model, noise, own)


def prune(trial: FittedModel, first: int) -> FittedModel:
    """`trial` without those of its unknowns from `first` on that are not determined, or not different from zero.

    Variances and factors (`_refined`) stay: they are determined together with the other unknowns of their effect.
    """
    x, sigma = trial.x[first:], trial.sigma()[first:]
    keep = determined(x, sigma, trial.unknowns[first:]) & (np.abs(x) >= SHOWN * sigma)
    keep |= np.array([u.variance or u.factor_on is not None for u in trial.unknowns[first:]], dtype=bool)
    if keep.all():
        return trial
    kept = np.append(np.ones(first, dtype=bool), keep)
    return fit(trial.problem, [u for u, k in zip(trial.unknowns, kept) if k], trial.x[kept], REFITTED)


def _completed(known: SearchState, candidate: Candidate, trial: FittedModel) -> tuple[FittedModel, dict[str, str]]:
    """`trial` with further parameters of its effect that are determined now, with noise levels fitted beside it; and
    why others are not."""
    present = {u.name for u in trial.unknowns}
    missing = [u for u in effect_unknowns(candidate.effect, candidate.fixed, trial.problem.attitude)
               if u.name not in present and u.parameter in candidate.undetermined]
    more = also_determined(trial.moved(), missing, trial.scores, trial.residual, trial.problem.mask)
    if more:
        first, start = len(trial.unknowns), np.append(trial.x, np.zeros(len(more)))
        trial = prune(fit(trial.problem, [*trial.unknowns, *more], start, REFITTED), first)
    own = len(trial.unknowns) > len(known.model.unknowns)
    return _refined(known, candidate.effect, trial) if candidate.effect.refined and own else (trial, {})


def _refined(known: SearchState, effect: Effect, trial: FittedModel) -> tuple[FittedModel, dict[str, str]]:
    """`trial` with those parameters estimated, too, that were fixed at several values so far (`Effect.tried`), from
    each of these values; and why parameters are not determined: fits that are equally good have other values."""
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
    good = [m for m in fits if not certainly_better(best, m, CLOSE)]
    hidden, sigma = {}, best.sigma()
    for i in range(first, len(best.unknowns)):
        unknown = best.unknowns[i]
        found = [m.unknowns[i].meant(m.x[i], 0.0)[0] for m in good]
        value, own = unknown.meant(best.x[i], sigma[i])
        if max(found) > APART * min(found) or max(abs(other - value) for other in found) > OUTSIDE * own:
            unit = next(p.unit for p in effect.traced if p.name == unknown.parameter)
            between = Estimate(None, None, unit, (min(found), max(found)))
            hidden[unknown.name] = f'{between.text()} explain the recording equally well'
    return best, hidden


def _estimates(best: Candidate, model: FittedModel, first: int, sigma: np.ndarray) -> dict[str, Estimate]:
    """Parameters of a finding, the unknowns of `model` from `first` on; sigma: (p,) of all of them."""
    units = {p.name: p.unit for p in best.effect.traced}
    found = {name: Estimate(value, None, units[name]) for name, value in best.fixed.items() if value}
    for unknown, x, s in zip(model.unknowns[first:], model.x[first:], sigma[first:]):
        found[unknown.parameter] = Estimate(*unknown.meant(x, s), units[unknown.parameter])
    return widened(found)
