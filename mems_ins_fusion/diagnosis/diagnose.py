"""Close the loop: find the residual, trace it to an effect the model lacks, add that effect, prove it (DESIGN, 5)."""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from ..effects.base import Effect
from ..effects.registry import EFFECTS
from ..samples import Recording
from .detection import Detection, correlations, detect
from .proof import HeldOut, Measured, compared, held_out, measure
from .residuals import DiagnosisError, Problem, Residual, Unknown, fit, noise_unknowns
from .tracing import SIGNIFICANCE, Candidate, group, trace

#: fewer innovations than this decide nothing
FEWEST_FIXES = 60
#: a recording has turns, and changes of speed, where these happen: rad/s and m/s^2 (root mean square)
TURNING, SPEEDING = 0.03, 0.15
MOST_EFFECTS = 5

Progress = Callable[[float, str], None]


@dataclass
class Finding:
    """One effect that was traced. parameters: name -> (value, sigma or None where it was only tried, unit).

    held_out: None where it was not tried. reason: why it was not added.
    """

    effect: Effect
    group: list[str]
    parameters: dict[str, tuple[float, float | None, str]]
    gain: float
    p: float
    added: bool
    held_out: HeldOut | None = None
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
    findings: list[Finding]
    hidden: dict[str, str]  # effects and parameters that the data cannot show, and why
    corrected: dict
    before: Measured
    fitted: Measured
    after: Measured
    comparison: list[dict]
    correlated: list[dict]
    remarks: list[str] = field(default_factory=list)

    @property
    def unexplained(self) -> bool:
        return not self.detections['after'].consistent


def diagnose(recording: Recording, values: dict, progress: Progress = lambda part, what: None,
             effects: Sequence[Effect] | None = None, durations=(10.0, 30.0, 60.0), spacing: float = 30.0) -> Diagnosis:
    """Diagnose `recording` as filtered with `values` (checked parameters).

    effects: the candidates, by default all of the registry. Raises DiagnosisError where the recording cannot be
    diagnosed at all. `progress` is called with the part of the work done and what is being done.
    """
    progress(0.02, 'filtering')
    problem = Problem(recording, values)
    if problem.mask.sum() < FEWEST_FIXES:
        raise DiagnosisError(f'{recording.name}: {int(problem.mask.sum())} fixes while the filter runs, at least '
                             f'{FEWEST_FIXES} are needed: record some minutes of driving with fixes every second')
    work = _Work(recording, problem, list(effects if effects is not None else EFFECTS.values()), progress)
    work.fit_noise()
    for _ in range(MOST_EFFECTS):
        if not work.add_best():
            break
    return work.finish(durations, spacing)


class _Work:
    """The model as it grows: noise levels first, then one effect after the other."""

    def __init__(self, recording, problem: Problem, effects: list[Effect], progress: Progress):
        self.recording, self.problem, self.progress = recording, problem, progress
        self.hidden = {e.name: e.hidden(problem.values, problem.recording) for e in effects}
        self.hidden = {name: why for name, why in self.hidden.items() if why}
        self.effects = [e for e in effects if e.name not in self.hidden]
        self.residuals = {'before': problem.base}
        self.detections = {'before': detect(problem.base, problem.mask)}
        self.noise: list[Unknown] = []
        self.unknowns: list[Unknown] = []
        self.x = np.zeros(0)
        self.findings: list[Finding] = []
        self.rounds: list[list[Candidate]] = []
        self.estimates: list[np.ndarray] = []
        self.origin = problem

    def fit_noise(self) -> None:
        self.progress(0.05, 'fitting noise levels')
        self.noise = noise_unknowns(self.problem)
        self._fit(self.noise, np.zeros(len(self.noise)))
        self.noise_x = self.x
        self.residuals['fitted'] = self.at
        self.detections['fitted'] = detect(self.at, self.problem.mask)

    def _fit(self, unknowns, x) -> None:
        self.unknowns = list(unknowns)
        self.x, self.covariance, self.at, self.scores = fit(self.problem, unknowns, x, self.problem.mask)

    def add_best(self) -> bool:
        """Trace, and add the best candidate that helps on held-out data; False when none is left."""
        share = 0.1 + 0.7 * len(self.rounds) / MOST_EFFECTS
        done = [0]

        def tested():
            done[0] += 1
            self.progress(share + 0.07 * done[0] / len(self.effects), 'testing effects')

        if not self.effects:
            return False
        candidates = trace(self.problem.moved(self.unknowns, self.x), self.scores, self.at, self.effects,
                           self.problem.mask, tested)
        self.rounds.append(candidates)
        significant = [c for c in candidates if c.p_adjusted <= SIGNIFICANCE and c.scores is not None]
        if not significant:
            return False
        # the blocks' few degrees of freedom make all small p alike: gain, less Akaike's price of a parameter, tells more
        best = max(significant, key=lambda c: c.gain - 2 * len(c.theta))
        self.progress(share + 0.08, f'adding {best.name}')
        names = group(best, candidates, self.problem.mask)
        self.effects = [e for e in self.effects if e.name not in names]
        if best.effect.replaces_model(best.values()):
            self._replace_model(best, names)
        else:
            self._add(best, names)
        return True

    def _add(self, best: Candidate, names: list[str]) -> None:
        before = (self.unknowns, self.x, self.covariance, self.at, self.scores)
        k = len(self.unknowns)
        start = [max(t, u.step) if u.variance else np.clip(t, -u.prior / 5, u.prior / 5)
                 for t, u in zip(best.theta, best.unknowns)]
        self._fit([*self.unknowns, *best.unknowns], np.concatenate([self.x, start]))
        proof = held_out(self.problem, self.unknowns, self.x, k)
        finding = Finding(best.effect, names, {}, best.gain, best.p_adjusted, proof.helps, proof)
        finding.parameters = self._parameters(best, k)
        self.findings.append(finding)
        if proof.helps:
            self.estimates = proof.estimates
        else:
            finding.reason = f'no gain on data it was not fitted to (log likelihood {proof.gain:+.1f}, p {proof.p:.2g})'
            self.unknowns, self.x, self.covariance, self.at, self.scores = before

    def _replace_model(self, best: Candidate, names: list[str]) -> None:
        """An effect that is taken out by another mechanization: the noise levels are fitted anew, without it as well."""
        parameters = self._estimates(best, best.theta, best.sigma)
        old_problem, old = self.problem, (self.unknowns, self.x, self.covariance, self.at, self.scores)
        likelihood = self.at.log_likelihood()
        self.problem = Problem(self.recording, best.effect.adjusted(old_problem.values, best.values()))
        mask = self.problem.mask & old_problem.mask
        self._fit(self.unknowns, self.x)
        gain = float((self.at.log_likelihood() - likelihood)[mask].sum())
        finding = Finding(best.effect, names, parameters, best.gain, best.p_adjusted, gain > chi2.ppf(0.999, 1) / 2,
                          HeldOut(gain, 0.0, []))
        self.findings.append(finding)
        if not finding.added:
            finding.reason = f'the other mechanization explains the recording no better (log likelihood {gain:+.1f})'
            self.problem = old_problem
            self.unknowns, self.x, self.covariance, self.at, self.scores = old
        else:
            self.hidden |= {e.name: e.hidden(self.problem.values, self.recording) for e in self.effects
                            if e.hidden(self.problem.values, self.recording)}
            self.effects = [e for e in self.effects if e.name not in self.hidden]
            self.estimates = []

    def _parameters(self, best: Candidate, k: int) -> dict:
        last = slice(k, k + len(best.unknowns))
        return self._estimates(best, self.x[last], np.sqrt(np.diag(self.covariance)[last]))

    @staticmethod
    def _estimates(best: Candidate, x, sigma) -> dict:
        units = {p.name: p.unit for p in best.effect.traced}
        found = {name: (value, None, units[name]) for name, value in best.fixed.items() if value}
        for unknown, value, s in zip(best.unknowns, x, sigma):
            name = unknown.name.split('.')[1]
            if unknown.variance:  # back to a standard deviation
                value = np.sqrt(max(value, 0.0))
                s = s / (2 * value) if value > 0 else np.inf
            found[name] = (float(value), float(s), units[name])
        return found

    def finish(self, durations, spacing: float) -> Diagnosis:
        self._final_estimates()
        corrected, _ = self.problem.assume(self.unknowns, self.x)
        noise_only, _ = self.origin.assume(self.noise, self.noise_x)
        folded = [self.problem.assume(self.unknowns, x)[0] for x in self.estimates] or [corrected]
        self.progress(0.85, 'measuring errors')
        durations = [d for d in durations if d < 0.3 * (self.origin.stamp[-1] - self.origin.stamp[0]) * 1e-9]
        before, fitted, after = (measure(self.origin, self.recording, models, durations, spacing)
                                 for models in ([self.origin.values], [noise_only], folded))
        self.residuals['after'], self.detections['after'] = self.at, detect(self.at, self.problem.mask)
        regressors = _regressors(self.problem)
        undetermined = {f'{c.name}.{name}': 'not determined by this recording'
                        for c in (self.rounds[-1] if self.rounds else []) for name in c.undetermined}
        return Diagnosis(
            recording=self.recording, values=self.origin.values, problem=self.problem, residuals=self.residuals,
            detections=self.detections, noise={u.name: float(np.exp(v)) for u, v in zip(self.noise, self.x)},
            rounds=self.rounds, findings=self.findings, hidden={**self.hidden, **undetermined}, corrected=corrected,
            before=before, fitted=fitted, after=after, comparison=compared(before, after),
            correlated=correlations(self.at, self.problem.mask, regressors), remarks=_remarks(self.problem, regressors))

    def _final_estimates(self) -> None:
        """All added parameters as the last joint fit left them; a group's name stands for its best member."""
        names = [u.name for u in self.unknowns]
        sigma = np.sqrt(np.diag(self.covariance))
        for finding in self.findings:
            for name, (value, s, unit) in list(finding.parameters.items()):
                key = f'{finding.name}.{name}'
                if finding.added and key in names:
                    i = names.index(key)
                    value, s = float(self.x[i]), float(sigma[i])
                    if self.unknowns[i].variance:
                        value = float(np.sqrt(max(value, 0.0)))
                        s = s / (2 * value) if value > 0 else np.inf
                    finding.parameters[name] = (value, s, unit)


def _regressors(problem: Problem) -> dict[str, np.ndarray]:
    """What a residual may go with, at the fixes: time, speed, acceleration, turn rate, heading, temperature."""
    imu, stamp = problem.recording.imu, problem.stamp
    velocity = problem.base.velocity
    speed = np.hypot(*velocity.T)
    seconds = (stamp - stamp[0]) * 1e-9
    turn = np.gradient(np.unwrap(problem.base.yaw), seconds)
    acceleration = np.gradient(speed, seconds)
    found = {'time': seconds, 'speed': speed, 'acceleration': acceleration, 'turn rate': turn,
             'lateral acceleration': speed * turn, 'north part of the heading': np.cos(problem.base.yaw),
             'east part of the heading': np.sin(problem.base.yaw)}
    if imu.temperature is not None:
        at = np.clip(np.searchsorted(imu.stamp, stamp), 0, len(imu) - 1)
        found['temperature'] = imu.temperature[at]
    return found


def _remarks(problem: Problem, regressors: dict) -> list[str]:
    """What the recording lacks, and what recording would show more."""
    said, mask = [], problem.mask
    if np.sqrt(np.mean(regressors['turn rate'][mask] ** 2)) < TURNING:
        said.append('There are hardly any turns: lever arms, the gyroscope\'s scale and a mounting rotation need some '
                    'bends to both sides.')
    if np.sqrt(np.mean(regressors['acceleration'][mask] ** 2)) < SPEEDING:
        said.append('The speed hardly changes: a time offset, scale factors and a mounting rotation need some braking '
                    'and speeding up.')
    gaps = np.diff(problem.stamp) * 1e-9
    if len(gaps) and gaps.max() > 30:
        said.append(f'There are no fixes for {gaps.max():.0f} s in a part of the recording: it says little of that part.')
    return said
