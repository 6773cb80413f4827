"""Close the loop: find the residual, trace it to an effect the model lacks, add that effect, prove it (DESIGN, 5)."""
from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects.base import Effect
from ..effects.registry import EFFECTS
from ..samples import Recording
from .detection import Detection, detect
from .proof import HeldOut, Measured, all_in_all, compared, gain_of, held_out, measure, objection, parts
from .residuals import DiagnosisError, Model, Problem, Residual, fit, noise_unknowns
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
MOST_ROUNDS = 8
#: errors are measured no more often than this, s
REFERENCE_INTERVAL = 0.1
#: candidates of one round that are fitted to see which explains most, if their gain is this part of the largest, and
#: how close in log likelihood equals come
TRIED, PART, CLOSE = 4, 0.3, 3.3
#: position errors all in all that differ by this factor tell effects apart
DIFFERENT = 1.1
#: a parameter is not determined where values this many times apart fit equally well
APART = 1.5
#: iterations of a fit that is only compared with others
COMPARED = 3
#: noise levels with a factor above this may stand for an effect; a start this much below in log likelihood is none
SWALLOWED, HOPELESS = 1.5, 50.0
#: a fitted noise level this many times the configured one is worth a remark
NOISE_FACTOR = 3.0

Progress = Callable[[float, str], None]


@dataclass
class Finding:
    """One effect that was traced. parameters: name -> (value, sigma or None where it was only tried, unit).

    reason: why it was not added.
    """

    effect: Effect
    group: list[str]
    parameters: dict[str, tuple[float, float | None, str]]
    gain: float
    p: float
    added: bool
    held_out: HeldOut
    reason: str = ''

    @property
    def name(self) -> str:
        return self.effect.name


@dataclass
class Diagnosis:
    """What `diagnose` found. Residuals and detections: as configured, with fitted noise levels, and at the end."""

    recording: Recording
    values: dict
    problem: Problem
    residuals: dict[str, Residual]
    detections: dict[str, Detection]
    noise: dict[str, float]  # fitted noise levels, as factors
    rounds: list[list[Candidate]]
    chosen: list[str]  # the candidate that each round tried to add; none in the last one
    findings: list[Finding]
    hidden: dict[str, str]  # effects and parameters that the data cannot show, and why
    corrected: dict
    before: Measured
    fitted: Measured
    after: Measured
    comparison: list[dict]
    rest: list[GoesWith]
    remarks: list[str] = field(default_factory=list)

    @property
    def unexplained(self) -> bool:
        return not self.detections['after'].consistent or bool(self.rest)


def diagnose(recording: Recording, values: dict, progress: Progress = lambda part, what: None,
             effects: Sequence[Effect] | None = None, durations=(10.0, 30.0, 60.0), spacing: float = 30.0) -> Diagnosis:
    """Diagnose `recording` as filtered with `values` (checked parameters).

    effects: the candidates, by default all of the registry. Raises DiagnosisError where the recording cannot be
    diagnosed at all. `progress` is called with the part of the work done and what is being done.
    """
    progress(0.02, 'filtering')
    if recording.reference is not None:
        slot = (recording.reference.stamp - recording.reference.stamp[0]) // round(REFERENCE_INTERVAL * 1e9)
        kept = np.unique(slot, return_index=True)[1]
        recording = replace(recording, reference=recording.reference.select(kept))
    problem = Problem(recording, values)
    if problem.mask.sum() < FEWEST_FIXES:
        raise DiagnosisError(f'{recording.name}: {int(problem.mask.sum())} fixes while the filter runs, at least '
                             f'{FEWEST_FIXES} are needed: record some minutes of driving with fixes every second')
    durations = [d for d in durations if d < 0.3 * (problem.stamp[-1] - problem.stamp[0]) * 1e-9]
    work = _Work(recording, problem, list(effects if effects is not None else EFFECTS.values()), durations, spacing,
                 progress)
    work.fit_noise()
    for _ in range(MOST_ROUNDS):
        if not work.add_best():
            break
    work.drop_superseded()
    work.drop_undetermined()
    return work.finish()


@dataclass(frozen=True)
class _Judged:
    """A candidate, the model with it, its parameters as in a Finding, and what it does on data it was not fitted to."""

    candidate: Candidate
    model: Model
    parameters: dict
    proof: HeldOut
    errors: Measured


class _Work:
    """The model as it grows: noise levels first, then one effect after the other."""

    def __init__(self, recording, problem: Problem, effects: list[Effect], durations, spacing, progress: Progress):
        self.recording, self.origin, self.progress = recording, problem, progress
        self.library, self.effects, self.hidden = effects, effects, {}
        self.durations, self.spacing = durations, spacing
        self._hide(problem)
        self.residuals = {'before': problem.base}
        self.detections = {'before': detect(problem.base, problem.mask)}
        self.findings: list[Finding] = []
        self.rounds: list[list[Candidate]] = []
        self.chosen: list[str] = []
        self.estimates: list[np.ndarray] = []
        self.rejected: list[Effect] = []

    def _hide(self, problem: Problem) -> None:
        """Set aside the effects of which this problem can say nothing."""
        reasons = {e.name: e.hidden(problem.values, problem.recording) for e in self.effects}
        self.hidden |= {name: why for name, why in reasons.items() if why}
        self.effects = [e for e in self.effects if not reasons[e.name]]

    def fit_noise(self) -> None:
        self.progress(0.05, 'fitting noise levels')
        noise = noise_unknowns(self.origin)
        self.noise_count = len(noise)
        self.model = self.noise_model = fit(self.origin, noise, np.zeros(len(noise)))
        self.residuals['fitted'] = self.model.residual
        self.detections['fitted'] = detect(self.model.residual, self.origin.mask)
        self.errors = self._quick_errors(self.model, [])

    def add_best(self) -> bool:
        """Trace, and add the best candidate that helps on held-out data; False when none is left."""
        share = 0.1 + 0.7 * len(self.rounds) / MOST_ROUNDS
        tested = [0]

        def progress():
            tested[0] += 1
            self.progress(share + 0.05 * tested[0] / len(self.effects), 'testing effects')

        if not self.effects:
            return False
        model = self.model
        candidates = trace(model.moved(), model.scores, model.residual, self.effects, model.problem.mask, progress)
        self.rounds.append(candidates)
        significant = [c for c in candidates if c.p_adjusted <= SIGNIFICANCE and c.scores is not None]
        if not significant:
            return False
        self.progress(share + 0.07, f"adding {' or '.join(c.name for c in significant[:TRIED])}")
        finding = self._tried(significant, candidates)
        # the others of its group stay: what of them is not the same as the winner may show in the next round
        self.effects = [e for e in self.effects if e.name != finding.name]
        self.chosen.append(finding.name)
        self.findings = [f for f in self.findings if f.name != finding.name] + [finding]
        if not finding.added:
            self.rejected.append(finding.effect)
        elif self.rejected:  # what did not help before may help now
            again = [*self.effects, *self.rejected]
            self.effects, self.rejected = [e for e in self.library if e in again], []
        return True

    def _tried(self, significant: list[Candidate], candidates: list[Candidate]) -> Finding:
        """The best candidate, in the model from now on if it helps on held-out data, and what it came to.

        Of those that explain the same, the position errors decide where these differ: a reference may know more.
        """
        names, models = self._best(significant, candidates)
        judged = {c.name: self._judged(c, models[c.name]) for c in significant if c.name in names and c.name in models}
        best = judged[names[0]]
        for name in names[1:]:
            if name in judged and all_in_all(compared(best.errors, judged[name].errors)) < 1 / DIFFERENT:
                best = judged[name]
        others = [name for name in names if name not in judged or
                  all_in_all(compared(best.errors, judged[name].errors)) < DIFFERENT]
        against = objection(best.proof, compared(self.errors, best.errors))
        if not against:
            self.model, self.estimates, self.errors = best.model, best.proof.estimates, best.errors
            self._hide(best.model.problem)
        candidate = best.candidate
        group = [candidate.name, *(name for name in others if name != candidate.name)]
        return Finding(candidate.effect, group, best.parameters, candidate.gain, candidate.p_adjusted, not against,
                       best.proof, against)

    def _best(self, significant: list[Candidate], candidates: list[Candidate]) -> tuple[list[str], dict[str, Model]]:
        """The candidate that explains most once it is in the model and all is fitted again, those that explain as much
        or the same after it, and the models that were fitted for this.

        The score test is linear, and at a model that is far off it ranks poorly; the likelihood does not. Equals are
        taken in the order of the registry.
        """
        by_gain = sorted(significant, key=lambda c: 2 * len(c.theta) - c.gain)[:TRIED]
        tried = [c for c in by_gain if c.gain >= PART * by_gain[0].gain]
        models = {c.name: self._with(c) for c in tried}
        mask = np.logical_and.reduce([model.problem.mask for model in models.values()])
        merit = {c.name: models[c.name].likelihood(mask) - len(c.theta) for c in tried}
        alike = [e.name for e in self.effects if merit.get(e.name, -np.inf) > max(merit.values()) - CLOSE]
        best = next(c for c in tried if c.name == alike[0])
        return list(dict.fromkeys([*alike, *group(best, candidates, self.model.problem.mask)])), models

    def _with(self, candidate: Candidate) -> Model:
        """The present model with one candidate added and all unknowns fitted again, well enough to compare."""
        model = self.model
        if candidate.effect.replaces_model(candidate.values()):
            problem = Problem(self.recording, candidate.effect.adjusted(model.problem.values, candidate.values()))
            return fit(problem, model.unknowns, model.x, COMPARED)
        begin = [max(t, u.step) if u.variance else np.clip(t, -u.prior / 5, u.prior / 5)
                 for t, u in zip(candidate.theta, candidate.unknowns)]
        return fit(model.problem, [*model.unknowns, *candidate.unknowns], np.concatenate([model.x, begin]), COMPARED)

    def _converged(self, trial: Model) -> Model:
        """`trial` fitted to the end, without what is not determined then.

        Noise levels that have swallowed the effect may not let go of it: so also from those configured, where these
        are not hopeless.
        """
        first, mask = len(self.model.unknowns), trial.problem.mask
        best = fit(trial.problem, trial.unknowns, trial.x)
        if trial.x[:self.noise_count].max() >= np.log(SWALLOWED):
            configured = np.concatenate([np.zeros(self.noise_count), trial.x[self.noise_count:]])
            [there] = trial.problem.residuals(trial.unknowns, [configured])
            if np.nansum(there.log_likelihood()[mask]) > best.likelihood(mask) - HOPELESS:
                other = fit(trial.problem, trial.unknowns, configured)
                best = max(best, other, key=lambda m: m.likelihood(mask))
        pruned = self._pruned(best, first)
        return pruned if len(pruned.unknowns) > first else best

    def _pruned(self, trial: Model, first: int) -> Model:
        """`trial` without those of its unknowns from `first` on that turn out not to be determined.

        What can trade against another one of its effect (`_refined`) stays: together they are determined.
        """
        keep = determined(trial.x[first:], trial.sigma()[first:], trial.unknowns[first:])
        keep |= np.array([u.variance or u.factor_on is not None for u in trial.unknowns[first:]], dtype=bool)
        if keep.all():
            return trial
        kept = np.append(np.ones(first, dtype=bool), keep)
        return fit(trial.problem, [u for u, k in zip(trial.unknowns, kept) if k], trial.x[kept])

    def _completed(self, candidate: Candidate, trial: Model) -> Model:
        """`trial` with what else of its effect the data determine now that noise levels need not stand for it."""
        known = {u.name for u in trial.unknowns}
        missing = [u for u in effect_unknowns(candidate.effect, candidate.fixed, trial.problem.attitude)
                   if u.name not in known]
        more = also_determined(trial.moved(), missing, trial.scores, trial.residual, trial.problem.mask)
        if more:
            first, start = len(trial.unknowns), np.append(trial.x, np.zeros(len(more)))
            trial = self._pruned(fit(trial.problem, [*trial.unknowns, *more], start), first)
        return self._refined(candidate.effect, trial) if candidate.effect.refined else trial

    def _refined(self, effect: Effect, trial: Model) -> Model:
        """`trial` with the parameters that were tried estimated, too, from each start: where these end as good ones at
        other values, the data do not determine the effect's parameters."""
        first = len(self.model.unknowns)
        fits = []
        for fixed in effect.tried:
            unknowns = [*self.model.unknowns, *effect_unknowns(effect, fixed, self.model.problem.attitude)]
            model = fit(trial.problem, unknowns, trial.x)
            refined = refined_unknowns(effect, fixed)
            fits.append(fit(trial.problem, [*unknowns, *refined], np.append(model.x, np.zeros(len(refined)))))
        mask = trial.problem.mask
        best = max(fits, key=lambda m: m.likelihood(mask))
        good = [m for m in fits if m.likelihood(mask) > best.likelihood(mask) - CLOSE]
        for i in range(first, len(best.unknowns)):
            found = [m.unknowns[i].meant(m.x[i], 0.0)[0] for m in good]
            if max(found) > APART * min(found):
                unknown = best.unknowns[i]
                unit = next(p.unit for p in effect.traced if p.name == unknown.parameter)
                self.hidden[unknown.name] = (f'{min(found):.2g} to {max(found):.2g} {unit} explain the recording '
                                             'equally well')
        return best

    def _judged(self, candidate: Candidate, model: Model) -> _Judged:
        """What `candidate`, fitted as `model`, comes to on data it was not fitted to."""
        if model.problem is self.model.problem:
            model = self._completed(candidate, self._converged(model))
            proof = held_out(model, self.model, self.noise_count)
            parameters = _estimates(candidate, model, len(self.model.unknowns))
        else:  # another mechanization has no parameter of its own that could have been fitted to the data
            model = fit(model.problem, model.unknowns, model.x)
            proof = gain_of(self.model.problem, self.model.residual, model.residual)
            alone = fit(self.model.problem.moved(model.unknowns, model.x), candidate.unknowns, candidate.theta)
            parameters = _estimates(candidate, alone, 0)
        return _Judged(candidate, model, parameters, proof, self._quick_errors(model, proof.estimates))

    def _quick_errors(self, model: Model, estimates: Sequence[np.ndarray]) -> Measured:
        """Errors of `model`, each by the estimate from other blocks, with the samples of the many runs."""
        assumed = [model.problem.assume(model.unknowns, x)[0] for x in estimates or [model.x]]
        return measure(self.origin, self.recording, self.origin.recording.imu, assumed, self.durations, self.spacing)

    def drop_superseded(self) -> None:
        """Take out again what an effect that was added later has made superfluous."""
        for finding in [f for f in self.findings if f.added][:-1]:
            kept = [i for i, u in enumerate(self.model.unknowns) if u.effect != finding.name]
            if len(kept) == len(self.model.unknowns):
                continue
            without = fit(self.model.problem, [self.model.unknowns[i] for i in kept], self.model.x[kept], COMPARED)
            proof = held_out(self.model, without, self.noise_count)
            estimates = self._by_part(without)
            errors = self._quick_errors(without, estimates)
            against = objection(proof, compared(errors, self.errors))
            if against:
                finding.added, finding.held_out = False, proof
                finding.reason = f'superseded by an effect that was added later: {against}'
                self.model, self.estimates, self.errors = without, estimates, errors

    def drop_undetermined(self) -> None:
        """Take out again the parameters that effects added later have left undetermined."""
        pruned = self._pruned(self.model, self.noise_count)
        if pruned is not self.model:
            left = {u.name for u in pruned.unknowns}
            self.hidden |= {u.name: 'not determined by this recording' for u in self.model.unknowns
                            if u.name not in left}
            for finding in self.findings:
                own = {u.name for u in self.model.unknowns if u.effect == finding.name}
                if finding.added and own and not own & left:
                    finding.added, finding.reason = False, 'not determined with the effects that were added later'
            self.model, self.estimates = pruned, self._by_part(pruned)

    def _by_part(self, model: Model) -> list[np.ndarray]:
        """The unknowns of `model` by the part that is held out."""
        return [model.refitted(model.problem.mask & ~part, self.noise_count)[0] for part in parts(model.problem)]

    def finish(self) -> Diagnosis:
        model = self.model
        problem = model.problem
        self._final_estimates()
        corrected, _ = problem.assume(model.unknowns, model.x)
        noise_only, _ = self.origin.assume(self.noise_model.unknowns, self.noise_model.x)
        folded = [problem.assume(model.unknowns, x)[0] for x in self.estimates] or [corrected]
        self.progress(0.85, 'measuring errors')

        def measured(models):
            return measure(self.origin, self.recording, self.origin.full.imu, models, self.durations, self.spacing)

        with ThreadPoolExecutor(os.cpu_count()) as pool:
            before, fitted, after = pool.map(measured, ([self.origin.values], [noise_only], folded))
        self.residuals['after'], self.detections['after'] = model.residual, detect(model.residual, problem.mask)
        rest = goes_with(model.moved(), model.scores, model.residual)
        noise = {u.name: float(np.exp(v)) for u, v in zip(self.noise_model.unknowns, model.x)}
        return Diagnosis(
            recording=self.recording, values=self.origin.values, problem=problem, residuals=self.residuals,
            detections=self.detections, noise=noise,
            rounds=self.rounds, chosen=self.chosen, findings=self.findings, hidden=self._not_shown(),
            corrected=corrected, before=before, fitted=fitted, after=after, comparison=compared(before, after),
            rest=rest, remarks=_remarks(problem) + _noise_remarks(noise))

    def _not_shown(self) -> dict[str, str]:
        """Effects and parameters of which nothing can be said, and why."""
        estimated = {u.name for u in self.model.unknowns}
        undetermined = {f'{c.name}.{name}': 'not determined by this recording'
                        for candidates in self.rounds for c in candidates for name in c.undetermined
                        if f'{c.name}.{name}' not in estimated}
        added = {f.name for f in self.findings if f.added}
        return {name: why for name, why in {**self.hidden, **undetermined}.items() if name not in added}

    def _final_estimates(self) -> None:
        """All added parameters as the last joint fit left them; what is not determined has no number."""
        model, sigma = self.model, self.model.sigma()
        for finding in self.findings:
            own = [i for i, u in enumerate(model.unknowns) if u.effect == finding.name]
            if finding.added and own:
                for i in own:
                    name = model.unknowns[i].parameter
                    unit = finding.parameters[name][2]
                    finding.parameters[name] = (*model.unknowns[i].meant(model.x[i], sigma[i]), unit)
            for name in [n for n in finding.parameters if f'{finding.name}.{n}' in self.hidden]:
                del finding.parameters[name]


def _estimates(best: Candidate, model: Model, first: int) -> dict:
    """Parameters of a finding, the unknowns of `model` from `first` on: name -> value, sigma, unit."""
    units = {p.name: p.unit for p in best.effect.traced}
    found = {name: (value, None, units[name]) for name, value in best.fixed.items() if value}
    sigma = model.sigma()
    for unknown, x, s in zip(model.unknowns[first:], model.x[first:], sigma[first:]):
        name = unknown.parameter
        found[name] = (*unknown.meant(x, s), units[name])
    return found


def _noise_remarks(factors: dict[str, float]) -> list[str]:
    """Noise levels far above those configured: wrong settings, or something that is in no effect of the library."""
    return [f'{name} had to be fitted {factor:.1f} times as large as configured: either it was set too small, or the '
            'noise stands for an effect that is not in the library.'
            for name, factor in factors.items() if factor > NOISE_FACTOR]


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
