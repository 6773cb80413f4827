"""From the result of a search to corrected parameters: which corrections are proven together, and the report on it."""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects.base import Effect
from ..evaluation.verdict import BETTER, CANNOT_TELL, WORSE, Verdict
from . import learned_mounting
from .candidate_proof import by_drive_of, sizes_with_sigma
from .detection import detect
from .drives import Drives, select_fixes
from .error_changes import RUNS, candidates, compared, gain_proven, objection_to_errors, predicts_worse, verdict_on
from .estimate import PLAIN, Estimate
from .exact import sigmas
from .findings import Diagnosis, Finding
from .fit import FittedModel
from .folds import part_masks, which_part
from .held_out import HeldOut
from .known import SearchState
from .measured import MeasuredErrors, errors_near_30_s, in_common
from .noise import LARGEST_FACTOR
from .noise_levels import WORTH, choose, learns_scatter, multiplied, predictions
from .plausible import implausible
from .problem import Problem
from .trial_runs import CHOOSING, LOOKING, MEASURING, TrialRuns
from .unexplained import Correlation, correlations

TURNING = 0.03  # rad/s, smallest root mean square of the yaw rate with which a recording has enough turns
SPEEDING = 0.15  # m/s^2, smallest root mean square of the acceleration with which it has enough changes of speed
LONGEST_GAP = 30.0  # s, longest time without a fix that is not remarked on: such a part shows little
#: ratio to a bound from which on a fitted noise level counts as at this bound: a fit comes near it, not onto it
AT_BOUND = 0.95
#: what shows how small a noise level is, by its name; else _AT_REST
_SHOWN_BY = {'gnss.sigma': 'The filter learns it from the fixes (gnss.adapt_sigma)'}
_AT_REST = 'A recording at rest shows how large it is (configure)'
MOUNTING = 'mounting_rotation'
#: why a finding is reported but not added
NO_PROOF = 'no smaller error is proven with it'
#: the same, of an effect that only says how fixes scatter
LEARNED = f'{NO_PROOF}, and the filter learns itself how the fixes scatter (gnss.adapt_sigma)'
#: the same, if predictions are certainly worse with it
PREDICTS_WORSE = 'errors and sigmas together predict positions less well with it'
#: why parameters stay although all changes together make errors smaller
NOT_EACH = 'not each change is proven by itself'
#: remarks on boolean settings, by the value with which positions are predicted better than with the given one
_SWITCHED = {
    'imu.adapt_noise': {
        False: 'What the IMU scatters from one sample to the next is no noise that adds up',
        True: 'The IMU is noisier in motion than its noise densities say'},
    'vehicle.zero_velocity': {
        False: 'Standstills cannot be told from motion in this recording',
        True: 'The filter tells standstills from motion in this recording'}}


@dataclass(frozen=True)
class Correction:
    """One way to correct the parameters.

    values: fitted to all data. by_part: fitted with each part held out in turn. factors: of the noise levels. effects:
    whether effects are part of it. settings: findings of a direct look at the recording. beside: the same correction
    without its noise levels or switched settings, which have to be better than that.
    """

    values: dict
    by_part: list[dict]
    factors: dict[str, float]
    effects: bool
    settings: tuple[Finding, ...] = ()
    beside: tuple[Correction, ...] = ()

    def switched(self, name: str) -> Correction:
        """The same correction with the other value of a boolean setting."""
        values, *by_part = ({**v, name: not v[name]} for v in (self.values, *self.by_part))
        return replace(self, values=values, by_part=by_part,
                       beside=(self, *(one.switched(name) for one in self.beside)))


@dataclass(frozen=True)
class MeasuredCorrection:
    """A correction, its errors at the full rate, and those of the corrections beside it."""

    correction: Correction
    errors: MeasuredErrors
    beside: tuple[MeasuredErrors, ...] = ()


def concluded(known: SearchState, trials: TrialRuns) -> Diagnosis:
    """The diagnosis: the corrections that are proven, and the errors before and after."""
    trials.origin.watched(None)
    trials.tell(CHOOSING, 'choosing noise levels')
    known = _scatter_proven(known, trials)
    given = trials.origin.given
    configured = Correction(given, [given], {}, False)
    fitted = _with_noise_levels(configured, trials)
    ran = _fixes_while_running(configured, trials)
    # errors are measured with filters fitted to a part; the filter of corrected.yaml has to run, too
    estimates = _estimates(known, trials)
    corrections = [option for option in _options(known, estimates, fitted, configured, trials)
                   if _fixes_while_running(option, trials) >= RUNS * ran]
    trials.tell(MEASURING, 'measuring errors')
    before, noise_only = (trials.errors(models, full=True) for models in ([given], fitted.by_part))
    tried = _as_measured(corrections, trials)
    many = candidates(before, [one.errors for one in tried[:-1]])
    correction, after, verdict, judged_on, against = _chosen([
        (one, verdict_on(before, one.errors, one.correction.effects, many)) for one in tried],
        before, trials.without_standstills, lambda one: trials.errors([one.values], full=True))
    comparison = compared(before, judged_on.errors)
    if correction.values != given:  # one filter may start later than the other
        before, after = in_common(before, after), in_common(after, before)
    # what a direct look at the recording shows is told, whatever corrected.yaml holds
    direct = correction.settings or next(
        (tuple(_only_told(f, against) for f in option.settings) for option in corrections if option.settings), ())
    hidden = _not_shown(known, direct)
    # a finding is added only where corrected.yaml holds it
    findings = _final_findings(known, estimates, hidden, correction.values, trials)
    findings = [*(findings if correction.effects else (
        replace(_only_told(f, against), parameters=trials.told(f.name, f.parameters)) for f in findings)),
                *direct]
    model, origin = known.model, trials.origin
    drives = origin.each
    residuals = {'before': origin.before, 'fitted': origin.observed(fitted.values),
                 'after': origin.observed(correction.values), 'search': model.residual}
    trials.tell(LOOKING, 'looking at what is left')
    rests = [correlations(moved, select_fixes(model.scores, where), select_fixes(model.residual, where))
             for moved, where in zip(model.moved().each, origin.slices)]
    explained = {u.name: float(np.exp(x)) for u, x in zip(model.unknowns, model.x) if u.noise}
    remarks = [_remarks(p) for p in drives]
    whole = Diagnosis(
        recordings=trials.recordings, values=given, problem=origin, residuals=residuals,
        detections={stage: detect(r, origin.mask) for stage, r in residuals.items()}, noise=correction.factors,
        explained=explained, rounds=list(known.rounds), chosen=list(known.chosen), findings=findings,
        hidden=hidden, corrected=correction.values,
        verdict=verdict, tried=_said(given, judged_on.correction),
        before=before, fitted=noise_only, after=after, comparison=comparison,
        correlations=[one for found in rests for one in found],
        remarks=[said for said in remarks[0] if all(said in other for other in remarks)]
        + _noise_remarks(model, correction.factors)
        + [f'{_SWITCHED[name][now]}: '
           + ('errors are no larger' if name in trials.without_standstills else 'positions are predicted better')
           + f' with {name}: {str(now).lower()}.' for name, now in _switched(given, correction.values).items()])
    if len(drives) < 2:
        return whole
    return replace(whole, drives=[_in_drive(whole, k, rests[k], remarks[k]) for k in range(len(drives))])


def _scatter_proven(known: SearchState, trials: TrialRuns) -> SearchState:
    """`known` in which an effect that only says how fixes scatter, where the filter learns that itself, is not added
    unless errors are certainly smaller with it: predictions of fixes whose scatter is known are better even where the
    vehicle is no better known. It stays in the model, because the other estimates and sigmas were fitted together with
    it."""
    scatter = {effect.name for effect in trials.library if effect.only_scatter and learns_scatter(trials.origin.given)}
    for finding in [f for f in known.findings if f.added and f.name in scatter]:
        without = replace(known, findings=tuple(
            _only_told(f, LEARNED) if f is finding else f for f in known.findings))
        errors = (trials.errors(one.by_part(), full=True) for one in (without, known))
        if verdict_on(*errors, effects=True).answer != BETTER:
            known = without
    return known


def _chosen(tried: list[tuple[MeasuredCorrection, Verdict]], before: MeasuredErrors,
            wanted: dict[str, bool], as_written: Callable[[Correction], MeasuredErrors],
            ) -> tuple[Correction, MeasuredErrors, Verdict, MeasuredCorrection, str]:
    """The correction for corrected.yaml.

    tried: the best predictions first, the given parameters last. wanted: settings that the recording asks for
    (`TrialRuns.without_standstills`); preferred if they do no harm. as_written: errors with the values of
    corrected.yaml, which are fitted to all data.

    Corrections with effects come first, because other noise levels can hide effects; then those with certainly smaller
    errors, which matter more to a user than better predictions. The first one is taken that meets three conditions:
    - Each of its parts is proven by itself, so that a params file that has the effects already gets the same noise
      levels as one that has not. Effects are proven by the likelihood of held-out data, noise levels and settings
      against the same filter without them (`_each_part_proven`).
    - Its errors are certainly smaller, or no error is larger. The latter is enough, because errors against withheld
      fixes need not show an effect: fixes that are stamped late are late where they are withheld, too.
    - No error is larger with the values of corrected.yaml. They differ from those of the parts where the recording
      leaves a range open. These errors are of the data that the values were fitted to, so they are rather too small:
      an error that is larger even there is larger.
    If there is none, the first one with effects and certainly smaller errors that meets the third is taken, as the
    given parameters are worse; else the given parameters.

    Returns the correction, its errors, the verdict, what this is about (the correction, or if the given parameters
    stay, `_alternative`), and what speaks against the effects that are left out.
    """
    against, refused = '', []
    ordered = sorted(tried[:-1], key=lambda found: (
        not found[0].correction.effects, found[1].answer != BETTER, not _has(found[0].correction.values, wanted)))
    stand = [found for found in ordered if _each_part_proven(found[0], wanted)]
    for one, verdict in [*stand, *(f for f in ordered if f[0].correction.effects and f[1].answer == BETTER)]:
        worse = '' if verdict.answer == BETTER else _worse(before, one.errors) or (
            NO_PROOF if verdict.answer == WORSE else '')
        if not worse:
            worse = _worse(before, as_written(one.correction))
            refused.append((one, worse))
        if not worse:
            return one.correction, one.errors, verdict, one, against or NO_PROOF
        if one.correction.effects:
            against = worse
    best, verdict = _alternative(tried, refused)
    kept, _ = tried[-1]
    return kept.correction, kept.errors, verdict, best, against or NO_PROOF


def _alternative(tried: list[tuple[MeasuredCorrection, Verdict]], refused: list[tuple[MeasuredCorrection, str]],
                 ) -> tuple[MeasuredCorrection, Verdict]:
    """What to report where the given parameters stay: of what was tried, as for `_chosen`, the best predictions that
    come with a smaller error, as a reader is told the error; else the best predictions. It is not BETTER. refused: of
    what was tried, what is worse with the values of corrected.yaml."""
    smaller = [found for found in tried[:-1] if found[1].shown and found[1].shown.smaller]
    best, verdict = [*smaller, *tried][0]
    if verdict.answer == BETTER:
        worse = next((why for one, why in refused if one is best and why), NOT_EACH)
        verdict = replace(verdict, answer=CANNOT_TELL, why=(worse,))
    return best, verdict


def _said(given: dict, correction: Correction) -> str:
    """What a correction consists of, in words."""
    if correction.effects or any(f.added for f in correction.settings):
        return 'what was found'
    switched = [f'{name}: {str(now).lower()}' for name, now in _switched(given, correction.values).items()]
    return ' and '.join([*(['other noise levels'] if correction.factors else []), *switched])


def _has(values: dict, settings: dict) -> bool:
    return {**values, **settings} == values


def _each_part_proven(one: MeasuredCorrection, wanted: dict[str, bool]) -> bool:
    """Whether the noise levels and settings of a correction are proven against the same filter without them. For
    `wanted` settings it is enough that nothing is worse."""
    return all(
        not _worse(errors, one.errors) if wanted and {**without.values, **wanted} == one.correction.values
        else gain_proven(errors, one.errors) for without, errors in zip(one.correction.beside, one.beside, strict=True))


def _worse(before: MeasuredErrors, after: MeasuredErrors) -> str:
    """In words, what is certainly worse with `after` than with `before`; empty if nothing is."""
    return objection_to_errors(compared(before, after)) or (PREDICTS_WORSE if predicts_worse(before, after) else '')


def _in_drive(whole: Diagnosis, k: int, rest: list[Correlation], remarks: list[str]) -> Diagnosis:
    """The part of a diagnosis of several drives that is about the k-th."""
    problem, recording, where = whole.problem.each[k], whole.recordings[k], whole.problem.slices[k]
    residuals = {stage: select_fixes(r, where) for stage, r in whole.residuals.items()}
    return replace(
        whole, recordings=(recording,), problem=Drives([problem]), residuals=residuals, correlations=rest,
        remarks=remarks,
        detections={stage: detect(r, problem.mask) for stage, r in residuals.items()},
        before=whole.before.drives[recording.name], fitted=whole.fitted.drives[recording.name],
        after=whole.after.drives[recording.name],
        comparison=[row for row in whole.comparison if row.get('drive') == recording.name])


def _options(known: SearchState, estimates: dict[str, dict[str, Estimate]], fitted: Correction, configured: Correction,
             trials: TrialRuns) -> list[Correction]:
    """Corrections to be compared: noise levels alone, effects with and without them; last the given parameters."""
    effects = configured
    if any(f.added for f in known.findings):
        proven = _proven_sigmas(known, estimates, trials)
        effects = Correction({**known.corrected(), **proven}, [{**values, **proven} for values in known.by_part()], {},
                             True)
    effects = _with_mounting(_with_settings(effects, trials), trials)
    options = [fitted]
    if effects.values != configured.values:
        options += [_with_noise_levels(replace(effects, factors=fitted.factors), trials), effects]
    return [*(option for option in options if option.values != configured.values),
            replace(configured, settings=tuple(_only_told(f, '') for f in effects.settings))]


def _as_measured(corrections: Sequence[Correction], trials: TrialRuns) -> list[MeasuredCorrection]:
    """The corrections with their errors at the full rate, the best predictions first, the given parameters last. Each
    is also tried with the other value of a boolean setting (`TrialRuns.switches`)."""
    configured, options = corrections[-1], list(corrections[:-1])
    # the same corrections without noise levels are options, too, in case that these have no gain
    there = [correction.values for correction in corrections]
    options += [one for option in options for one in option.beside if one.values not in there]
    options += [correction.switched(name) for correction in (*options, configured) for name in trials.switches]

    def measured(correction):
        return trials.errors(correction.by_part, full=True)

    def merit(tried):
        changed = bool(_switched(configured.values, tried.correction.values))
        return _merit(tried.errors) - changed * WORTH / predictions(tried.errors)
    found = [MeasuredCorrection(option, measured(option), tuple(measured(one) for one in option.beside))
             for option in options]
    return [*sorted(found, key=merit, reverse=True), MeasuredCorrection(configured, measured(configured))]


def _fixes_while_running(correction: Correction, trials: TrialRuns) -> int:
    """The number of fixes at which the filter with a correction runs, i.e. is aligned."""
    return int(np.isfinite(trials.origin.observed(correction.values).z[trials.origin.mask, 0]).sum())


def _only_told(finding: Finding, against: str) -> Finding:
    return replace(finding, added=False, changes={}, reason=finding.reason or against or NO_PROOF)


def _with_settings(correction: Correction, trials: TrialRuns) -> Correction:
    """`correction` with findings of a direct look at the recording, and with the settings against them if these help.
    """
    for effect in trials.library:
        sightings = {p.recording.name: effect.seen(trials.origin.given, p.full) for p in trials.origin.each}
        sightings = {name: sighting for name, sighting in sightings.items() if sighting is not None}
        if not sightings:
            continue
        units = {p.name: p.unit for p in effect.parameters}
        drives = {name: {n: Estimate(v, s, units[n]) for n, (v, s) in sighting.parameters.items()}
                  for name, sighting in sightings.items()}
        # the settings are those for the drive in which it is largest
        most = max(sightings, key=lambda name: drives[name][effect.principal].value)
        sighting, several = sightings[most], len(trials.origin.each) > 1
        rest = [name for name in sightings if name != most]
        text = sighting.text + (f' (in {most}{"; also in " if rest else ""}{", ".join(rest)})' if several else '')
        finding = Finding(effect.name, [effect.name], drives[most], 0.0, 0.0, False, HeldOut(0.0, 1.0, []), seen=text,
                          drives=drives if several else {})
        further = [{**values, **sighting.helps} for values in (correction.values, *correction.by_part)]
        if further[0] == correction.values:
            finding = replace(finding, reason='the settings are made for it already')
        else:
            # judged as they would drive: a filter that adapts to the noise of its samples may not need them
            before, after = (trials.errors(models, full=True) for models in (correction.by_part, further[1:]))
            if verdict_on(before, after, effects=True).answer == BETTER:
                sets = {n: v for n, v in further[0].items() if v != correction.values[n]}
                finding = replace(finding, added=True, changes=sets, saves=errors_near_30_s(before, after))
                correction = replace(correction, values=further[0], by_part=further[1:], effects=True)
            else:
                finding = replace(finding, reason='no smaller error is proven with the settings against it')
        correction = replace(correction, settings=(*correction.settings, finding))
    return correction


def _with_mounting(correction: Correction, trials: TrialRuns) -> Correction:
    """`correction` with the mounting angles that the filter estimates itself, if it does and they do no harm."""
    if MOUNTING not in {e.name for e in trials.library}:
        return correction
    found = learned_mounting.combined_angles([learned_mounting.learned_angles(p.full, correction.values)
                                              for p in trials.origin.each])
    if found is None or not found.plain:
        return correction
    effect = next(e for e in trials.library if e.name == MOUNTING)

    def turned(values, angles):
        return effect.adjusted(values, {'roll': 0.0, **{n: angles[n] if n in found.plain else 0.0
                                                        for n in learned_mounting.STATES}})

    whole = {name: e.value for name, e in found.whole.items()}
    parted = correction.by_part * (len(part_masks(trials.origin)) if len(correction.by_part) == 1 else 1)
    # each part gets the angles from other data, or from one half of the data, so that errors contain their scatter
    halves = found.halves or [whole]
    by_part = [turned(values, halves[k % len(halves)]) for k, values in enumerate(parted)]
    values = turned(correction.values, {n: whole.get(n, 0.0) for n in learned_mounting.STATES})
    finding = Finding(MOUNTING, [MOUNTING], found.plain, 0.0, 0.0, True, HeldOut(0.0, 1.0, []),
                      changes={'imu.mounting_rpy': values['imu.mounting_rpy']},
                      seen='the filter finds it itself in each drive, within a minute or two of it',
                      drives={p.recording.name: own for p, own in zip(trials.origin.each, found.drives)})
    before, after = trials.errors(correction.by_part), trials.errors(by_part)
    finding = replace(finding, saves=errors_near_30_s(before, after))
    reason = implausible(MOUNTING, found.plain) or found.contradicted
    reason = reason or objection_to_errors(compared(before, after))  # the filter's own states have proven it
    if reason:
        return replace(correction, settings=(*correction.settings, _only_told(finding, reason)))
    return replace(correction, values=values, by_part=by_part, settings=(*correction.settings, finding))


def _with_noise_levels(correction: Correction, trials: TrialRuns) -> Correction:
    """`correction` with the noise levels that predict best; one of the starts of their search is its factors."""
    claimed = float(np.median(np.sqrt(trials.origin.claimed[:, 0, 0])))
    levels = choose(correction.values, trials.each, which_part(trials.origin), len(part_masks(trials.origin)), claimed,
                    correction.factors)
    factors = {name: factor for name, factor in levels.factors.items() if factor != 1.0}
    by_part = correction.by_part * (len(levels.by_part) if len(correction.by_part) == 1 else 1)
    return replace(correction, values=multiplied(correction.values, factors, claimed), factors=factors,
                   by_part=[multiplied(values, chosen, claimed) for values, chosen in zip(by_part, levels.by_part)],
                   beside=(replace(correction, factors={}),) if factors else ())


def _merit(measured: MeasuredErrors) -> float:
    """Mean log likelihood of the predicted positions; each prediction horizon has the same weight."""
    return float(np.mean([score.mean() for _, score in measured.scores() if len(score)]))


def _estimates(known: SearchState, trials: TrialRuns) -> dict[str, dict[str, Estimate]]:
    """The parameters of each finding that are in the last joint fit, by the name of its effect."""
    model = known.model
    sigma = sigmas(model, trials.beside.track, trials.origin.given)
    return {finding.name: sizes_with_sigma(finding, model, sigma) for finding in known.findings}


def _proven_sigmas(known: SearchState, estimates: dict[str, dict[str, Estimate]],
                   trials: TrialRuns) -> dict[str, float]:
    """Standard deviations of the values that the added effects correct, by the parameters in which they stand. A value
    that was not fitted keeps the given one."""
    given, found = trials.origin.given, {}
    added = {f.name for f in known.findings if f.added}
    for effect in (e for e in trials.library if e.name in added and any(n in estimates[e.name] for n in _stated(e))):
        for name, parameter in _stated(effect).items():
            estimate = estimates[effect.name].get(name)
            sigma = given[parameter] if estimate is None else estimate.sigma
            found[parameter] = max(found.get(parameter, 0.0), sigma)
    return found


def _stated(effect: Effect) -> dict[str, str]:
    """The parameters of `effect` whose standard deviation is a parameter of the YAML, with its name."""
    return {p.name: p.sigma_in for p in effect.traced if p.sigma_in}


def _final_findings(known: SearchState, estimates: dict[str, dict[str, Estimate]], hidden, corrected: dict,
                    trials: TrialRuns) -> list[Finding]:
    """All findings with the estimates of the last joint fit, and what each has changed in `corrected`."""
    model, found = known.model, []
    effects, given = {e.name: e for e in trials.library}, trials.origin.given
    for finding in known.findings:
        own, parameters = estimates[finding.name], finding.parameters
        if own:
            parameters = {n: own.get(n, e) for n, e in parameters.items() if n in own or e.sigma is None}
        parameters = {n: e for n, e in parameters.items() if f'{finding.name}.{n}' not in hidden}
        if not finding.added:  # what is less than PLAIN is no news
            parameters = {n: e for n, e in parameters.items() if not e.known or abs(e.value) >= PLAIN * e.sigma}
            if not finding.drives_contradict and (not parameters or finding.held_out.gain <= 0) and (
                    finding.name not in trials.certain):
                continue
        changes = {}
        if finding.added:
            effect = effects[finding.name]
            theta = {p.name: 0.0 for p in (*effect.parameters, *effect.traced)}
            theta |= {n: e.value for n, e in finding.parameters.items()}
            # of a parameter that is not told, too, as several values explain the recording equally well
            theta |= {u.parameter: u.meant(x, 0.0)[0] for u, x in zip(model.unknowns, model.x)
                      if u.effect == finding.name and not u.noise}
            moved = effect.adjusted(given, theta)
            stated = _stated(effects[finding.name]).values()
            changes = {n: corrected[n] for n in given
                       if moved[n] != given[n] or n in stated and corrected[n] != given[n]}
            own = [i for i, u in enumerate(model.unknowns) if u.effect == finding.name and not u.noise]
            finding = replace(finding, drives=by_drive_of(model, effect, known.noise, own)[0])
        found.append(replace(finding, parameters=parameters, changes=changes))
    return found


def _not_shown(known: SearchState, settings: Sequence[Finding]) -> dict[str, str]:
    """Names of effects and parameters that the recordings do not show, with the reason, from the last test of each."""
    estimated = {u.name for u in known.model.unknowns}
    last = {c.name: c for candidates in known.rounds for c in candidates}
    undetermined = {f'{c.name}.{name}': 'not determined by this recording' for c in last.values()
                    for name in c.undetermined if f'{c.name}.{name}' not in estimated}
    found = {f.name for f in known.findings if f.added} | {f.name for f in settings}
    return {name: why for name, why in {**known.hidden, **undetermined}.items() if name not in found}


def _noise_remarks(model: FittedModel, chosen: dict[str, float]) -> list[str]:
    """Remarks on noise levels that rest on a bound: of the fit, or where one was chosen for the user, of that choice.

    At the upper one settings are wrong, or no effect explains the data. At the lower one the level is only known to be
    no larger, and the sigmas of what is fitted beside it are those with that level. Two kinds of levels rest there on
    most drives and are not said: one whose lower bound is its setting (`ONLY_LARGER`), and one of which the drive tells
    less than its prior (fixes to the centimetre, to which a diagnosis adds more than they scatter).
    """
    fitted = [(u.name, float(np.exp(x)), *np.exp(u.bounds), 2.0 * variance < u.prior**2)
              for u, x, variance in zip(model.unknowns, model.x, np.diag(model.covariance)) if u.noise]
    levels = [*(level for level in fitted if level[0] not in chosen),
              *((name, factor, 1 / LARGEST_FACTOR, LARGEST_FACTOR, True) for name, factor in chosen.items())]
    said = []
    for name, factor, smallest, largest, shown in levels:
        if factor > AT_BOUND * largest and name != 'gnss.sigma':
            said.append(
                f'{name} would have to be {factor:.0f} times as large as configured to explain this drive. No sensor '
                'is so much noisier than its settings: the cause is something that is not in the library of effects '
                '(vibration of the mount, samples that repeat, a scale or an axis that is not what it says).')
        if shown and smallest < 1.0 and factor * AT_BOUND < smallest:
            said.append(
                f'{name} would have to be {factor:.2g} times as large as configured, or smaller, to explain this drive '
                f'(smaller values are not tried). {_SHOWN_BY.get(name, _AT_REST)}.')
    return said


def _switched(given: dict, corrected: dict) -> dict[str, bool]:
    """The settings of `_SWITCHED` that are not as given, with their corrected values."""
    return {name: corrected[name] for name in _SWITCHED if given[name] != corrected[name]}


def _remarks(problem: Problem) -> list[str]:
    """Remarks on motion and fixes that the recording lacks, and what these would show."""
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
    if len(gaps) and gaps.max() > LONGEST_GAP:
        said.append(f'There are no fixes for {gaps.max():.0f} s in a part of the recording: it says little of that '
                    'part.')
    return said
