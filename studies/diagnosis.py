"""How often the diagnosis is right: drives with effects that it is not told of, scored as a confusion matrix.

By hand: `python studies/diagnosis.py --seeds N [--first SEED] [--scenarios NAME,..] [--minutes M]`. The recordings
are simulated with seeds, signs and sizes that the diagnosis never sees. What came out is in docs/diagnosis_study.md.
"""
from __future__ import annotations

import argparse
import copy
import sys
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from mems_ins_fusion.diagnosis.diagnose import diagnose  # noqa: E402
from mems_ins_fusion.diagnosis.fit import fit, scores  # noqa: E402
from mems_ins_fusion.diagnosis.measured import MeasuredErrors, measure_errors
from mems_ins_fusion.diagnosis.noise import noise_unknowns  # noqa: E402
from mems_ins_fusion.diagnosis.problem import Problem  # noqa: E402
from mems_ins_fusion.diagnosis.tracing import trace  # noqa: E402
from mems_ins_fusion.effects.base import Effect, EffectParameter  # noqa: E402
from mems_ins_fusion.effects.registry import EFFECTS  # noqa: E402
from mems_ins_fusion.parameters import table  # noqa: E402
from mems_ins_fusion.simulation.drive import simulate_drive, stream  # noqa: E402
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording  # noqa: E402

DURATION = 600.0
RECEIVER = GnssNoise(sigma=0.5)
DURATIONS, SPACING = (10.0, 30.0), 30.0
#: a parameter counts as identifiable from here on, in sigmas; sizes are drawn between these
SMALLEST, LARGEST = 6.0, 15.0
PLAIN = 25.0  # twice the log likelihood ratio of the truth: 5 sigma
LIMIT = 1.10  # error after, over that of a filter that knows the effect


class Quadratic(Effect):
    """Not in the library: the accelerometers read k f^2 too much, f_x and f_y."""

    name = 'quadratic accelerometer'
    parameters = (EffectParameter('k', '1/(m/s^2)', 0.1),)

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        return specific_force + values['k'] * specific_force**2 * [1.0, 1.0, 0.0], angular_rate


class SpeedBias(Effect):
    """Not in the library: the vertical gyroscope reads k v too much, v the speed."""

    name = 'speed-dependent gyroscope bias'
    parameters = (EffectParameter('k', '(rad/s)/(m/s)', 5e-4),)

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        speed = np.linalg.norm(drive.velocity, axis=1)
        return specific_force, angular_rate + values['k'] * speed[:, None] * [0.0, 0.0, 1.0]


OUTSIDE = (Quadratic(), SpeedBias())
#: an IMU good enough to show in 10 min what the default one's own slow errors hide
GOOD_IMU = {'accelerometer.gauss_markov.sigma': [0.01], 'gyroscope.gauss_markov.sigma': [1e-4],
            'accelerometer.initial_sigma': [0.02], 'gyroscope.initial_sigma': [1e-3]}
#: effects that need more than the defaults: two show only through the constraint that they violate
SETTINGS = {'sideslip': {'vehicle.non_holonomic': True}, 'mounting_rotation': {'vehicle.non_holonomic': True},
            'g_sensitivity': GOOD_IMU, 'twist_yaw': {'twist.yaw_sigma': 1e-6},
            'pressure_dynamic': {'pressure.dynamic_sigma': 1e-6},
            'gnss_coloured_noise': GOOD_IMU}
#: further inputs: their rates, Hz, and the effects that only a recording with them shows, with that of their stamps
RATES = {'speed': 10.0, 'velocity': 5.0, 'heading': 5.0, 'twist': 20.0, 'pressure': 10.0}
STAMPS = {f'{name}_time_offset': name for name in RATES if name != 'pressure'}
#: smoothed by a low pass with a time constant, s, between these: late by that, and more than late
LAGS = {f'{name} lag': f'{name}_lag' for name in STAMPS.values()}
SMALLEST_LAG, LARGEST_LAG = 0.3, 1.2
#: what the filter estimates by itself unless it is told not to (SETTINGS)
ESTIMATED = {'twist_yaw': 'twist', 'pressure_dynamic': 'pressure'}
#: input of each effect of one
OF_INPUT = STAMPS | {f'{name}_lag': name for name in STAMPS.values()} | ESTIMATED
HILLS = 'hills'  # the road's grade tilts the body: the library's tilt, without a value
#: effects whose simulated parameters are estimated, on level roads; those of real roads: diagnosis_on_roads.py
FLAT = ('gnss_time_offset', 'gnss_lever_arm', 'gnss_coloured_noise', 'accelerometer_scale', 'gyroscope_scale',
        'mounting_rotation', 'tilt', 'g_sensitivity', 'temperature', 'accelerometer_lever_arm', 'sideslip')
SINGLE = (*FLAT, HILLS, *STAMPS, *LAGS, *ESTIMATED)
#: pairs of effects that are not each other's group
PAIRS = (('gnss_time_offset', 'gyroscope_scale'), ('gnss_lever_arm', 'accelerometer_scale'),
         ('gnss_time_offset', 'mounting_rotation'), ('gyroscope_scale', 'gnss_lever_arm'),
         ('g_sensitivity', 'gnss_time_offset'))


@dataclass
class Case:
    """One drive and what came of it. true: effect -> parameter -> value. ratio: error after over the oracle's."""

    scenario: str
    seed: int
    true: dict[str, dict[str, float]]
    found: list[list[str]] = field(default_factory=list)  # groups of the effects added, the winner first
    errors: dict[str, float] = field(default_factory=dict)  # of the true effects' estimated parameters, in sigmas
    unexplained: bool = False
    left: float = np.inf  # outside the library: twice the log likelihood that the recording without it would gain
    ratios: list[float] = field(default_factory=list)  # with all fixes, and by duration of the outages
    improved: list[float] = field(default_factory=list)  # error after over before
    seconds: float = 0.0
    failure: str = ''
    notes: list[str] = field(default_factory=list)

    @property
    def first(self) -> list[str]:
        return self.found[0] if self.found else []


def settings(names) -> dict:
    """Parameters of the filter for a scenario with these effects; the simulated reference is the IMU's position."""
    values = {'reference_lever_arm': [0.0, 0.0, 0.0]}
    for name in names:
        values |= SETTINGS.get(name, {})
        if name in OF_INPUT:
            values[f'{OF_INPUT[name]}_topic'] = f'/{OF_INPUT[name]}'
    return table.check(values)


def sizes(recording, values: dict, effect: Effect, rng) -> dict[str, float]:
    """Random sizes of the effect's parameters that this drive, clean, determines; empty where it determines none."""
    problem = Problem(recording, values)
    noise = noise_unknowns(problem)
    at, nuisance = scores(problem, noise, np.zeros(len(noise)))
    if effect.name == 'gnss_coloured_noise':
        return {'sigma': rng.uniform(1.0, 2.5), 'tau': float(np.exp(rng.uniform(np.log(10), np.log(160))))}
    usual = {p.name: p.prior_scale for p in effect.parameters}
    effect = copy.copy(effect)
    effect.tried = tuple(t for t in effect.tried if not set(t) & set(usual))  # what is simulated is looked for
    [candidate] = trace(problem, nuisance, at, [effect], problem.mask)
    return {name: float(rng.choice([-1, 1]) * max(rng.uniform(SMALLEST, LARGEST) * sigma,
                                                  rng.uniform(0.3, 1.0) * usual[name]))
            for name, sigma in zip((u.parameter for u in candidate.unknowns), candidate.sigma)
            if sigma <= usual.get(name, 0.0)}


def simulated(names, seed: int, truth: dict, hills: bool = False):
    values = settings(names)
    sensors = SensorErrors.from_parameters(values, values['sensor_error_model'])
    effects = {**EFFECTS, **{e.name: e for e in OUTSIDE}}
    drive = simulate_drive(DURATION, seed, hills=hills)
    return simulate_recording(drive, sensors, RECEIVER, [(effects[n], theta) for n, theta in truth.items()],
                              seed=seed, aiding=SimulatedAiding(twist_lateral_sigma=0.05, **{
                                  f'{OF_INPUT[name]}_rate': RATES[OF_INPUT[name]] for name in names
                                  if name in OF_INPUT})).recording


def draw(names, seed: int, scenario: str = '') -> dict:
    """True effects and sizes for this seed; without those that this drive cannot show."""
    rng = stream(seed, 'study ' + (scenario if scenario in LAGS else ' '.join(names)))
    truth = {}
    if scenario in LAGS:
        return {LAGS[scenario]: {'tau': rng.uniform(SMALLEST_LAG, LARGEST_LAG)}}
    for name in names:
        outside = {e.name: e for e in OUTSIDE}
        if name in outside:
            parameter = outside[name].parameters[0]
            truth[name] = {parameter.name: float(rng.choice([-1, 1]) * rng.uniform(1, 2) * parameter.prior_scale)}
        elif name in EFFECTS:
            clean = simulated(names, seed, {'temperature': {}} if name == 'temperature' else {})
            chosen = sizes(clean, settings(names), EFFECTS[name], rng)
            if chosen:
                truth[name] = chosen
    return truth


def study(scenario: str, names, seed: int) -> Case:
    """Simulate, diagnose and score one drive."""
    truth = draw(names, seed, scenario)
    case = Case(scenario, seed, truth)
    if scenario not in ('none', HILLS) and len(truth) < len(names):
        case.failure = 'not identifiable'
        return case
    values, recording = settings(names), simulated(names, seed, truth, hills=scenario == HILLS)
    for name in truth:
        if not plain(recording, oracle({k: v for k, v in truth.items() if k != name}, values, scenario),
                     oracle(truth, values, scenario)):
            case.failure = f'too small in this drive: {name}'
            return case
    began = time.perf_counter()
    result = diagnose(recording, values, durations=DURATIONS, spacing=SPACING)
    case.seconds = time.perf_counter() - began
    added = [f for f in result.findings if f.added]
    case.found, case.unexplained = [f.group for f in added], result.unexplained
    case.notes = [f'{f.name} {f.parameters} p {f.p:.1g} held out {f.held_out.gain:.1f} p {f.held_out.p:.2g} '
                  f'{f.reason}' for f in result.findings]
    case.notes += [f'{r.where} goes with {r.what}: gain {r.gain:.0f}' for r in result.correlations[:4]]
    for finding in added:
        for name, estimate in finding.parameters.items():
            if finding.name in truth and estimate.known:
                # the parameters that were not simulated are truly zero
                true = EFFECTS[finding.name].as_traced({**EFFECTS[finding.name].complete({}), **truth[finding.name]})
                case.errors[f'{finding.name}.{name}'] = (estimate.value - true.get(name, 0.0)) / estimate.sigma
    knowing = oracle(truth, values, scenario)
    if knowing is not None:
        problem = Problem(recording, values)
        known = measure_errors(problem, recording, problem.full.imu, [knowing], DURATIONS, SPACING)
        case.ratios = ratios(result.after, known)
    case.improved = ratios(result.after, result.before)
    if scenario in [e.name for e in OUTSIDE]:
        case.left = twice_gain(result.residuals['after'].log_likelihood(),
                               tuned(Problem(simulated(names, seed, {}), values)), result.problem.mask)
    return case


def plain(recording, without: dict | None, knowing: dict | None) -> bool:
    """Whether the innovations speak for the truth at all: twice the log likelihood ratio, noise levels fitted."""
    if knowing is None:
        return True
    one, other = Problem(recording, without), Problem(recording, knowing)
    return twice_gain(tuned(one), tuned(other), one.mask & other.mask) > PLAIN


def tuned(problem: Problem) -> np.ndarray:
    """Log likelihood of each fix with fitted noise levels."""
    noise = noise_unknowns(problem)
    return fit(problem, noise, np.zeros(len(noise))).residual.log_likelihood()


def twice_gain(before: np.ndarray, after: np.ndarray, mask: np.ndarray) -> float:
    return float(2 * np.nansum((after - before)[mask]))


def oracle(truth: dict, values: dict, scenario: str) -> dict | None:
    """Parameters of a filter that knows the truth; None for what the library cannot correct."""
    if scenario == HILLS:
        return {**values, 'mechanization': 'strapdown'}
    for name, theta in truth.items():
        if name not in EFFECTS:
            return None
        values = EFFECTS[name].adjusted(values, EFFECTS[name].as_traced(EFFECTS[name].complete(theta)))
    return values


def ratios(one: MeasuredErrors, other: MeasuredErrors) -> list[float]:
    """Error of one model over another's: RMS with all fixes, mean largest error for each duration of outages."""
    found = [np.sqrt(np.mean(one.continuous.horizontal**2) / np.mean(other.continuous.horizontal**2))]
    return found + [float(np.mean(a.max_error) / np.mean(b.max_error)) for a, b in zip(one.outages, other.outages)]


def scenarios() -> dict[str, tuple[str, ...]]:
    """Names of the scenarios and the effects in each."""
    return {'none': (), **{name: (name,) for name in FLAT}, HILLS: (),
            **{name: (name,) for name in (*STAMPS, *ESTIMATED)}, **{name: (effect,) for name, effect in LAGS.items()},
            **{' + '.join(p): p for p in PAIRS},
            **{e.name: (e.name,) for e in OUTSIDE}}


def right(case: Case, group) -> bool:
    wanted = {'tilt'} if case.scenario == HILLS else set(case.true)
    if case.scenario in LAGS:  # most of it is an offset
        wanted.add(f'{OF_INPUT[LAGS[case.scenario]]}_time_offset')
    return bool(wanted & set(group))


def results_table(cases: list[Case]) -> str:
    """Everything measured, as Markdown: the confusion matrix first, then the scores."""
    done = [c for c in cases if not c.failure]
    return '\n\n'.join([_confusion(done), _scores(done), _summary(done, cases)]) + '\n'


def _confusion(cases) -> str:
    lines = ['| true | drives | added first (with what it is grouped with) |', '|---|---|---|']
    for scenario in dict.fromkeys(c.scenario for c in cases):
        mine = [c for c in cases if c.scenario == scenario]
        counts = Counter(_called(c.first) for c in mine)
        lines.append(f'| {scenario} | {len(mine)} | ' + '; '.join(f'{n} x {what}' for what, n in counts.most_common())
                     + ' |')
    return '\n'.join(lines)


def _called(group) -> str:
    if not group:
        return 'nothing'
    return group[0] + (f" (or {', '.join(group[1:])})" if len(group) > 1 else '')


def _scores(cases) -> str:
    lines = ['| true | drives | right first, or its group | it alone | other effects added as well | within 2 sigma | '
             'unexplained at the end | error after / knowing filter (all fixes, 10 s, 30 s outages) | after / before |',
             '|---|---|---|---|---|---|---|---|---|']
    for scenario in dict.fromkeys(c.scenario for c in cases):
        mine = [c for c in cases if c.scenario == scenario]
        n, inside = len(mine), [abs(e) < 2 for c in mine for e in c.errors.values()]
        wrong = sum(any(not right(c, g) for g in c.found) for c in mine)
        lines.append(f'| {scenario} | {n} | {sum(right(c, c.first) for c in mine)} | '
                     f'{sum(right(c, c.first) and len(c.first) == 1 for c in mine)} | {wrong} | '
                     f'{sum(inside)}/{len(inside)} | {sum(c.unexplained for c in mine)} | '
                     f"{_medians([c.ratios for c in mine])} | {_medians([c.improved for c in mine])} |")
    return '\n'.join(lines)


def _medians(rows) -> str:
    rows = [r for r in rows if r]
    return ', '.join(f'{m:.2f}' for m in np.median(rows, axis=0)) if rows else '-'


def _summary(cases, everything) -> str:
    """The targets of issue 5."""
    single = [c for c in cases if c.scenario in SINGLE]
    pairs = [c for c in cases if ' + ' in c.scenario]
    every = [c for c in cases if c.scenario in [e.name for e in OUTSIDE]]
    outside = [c for c in every if c.left > PLAIN]
    none = [c for c in cases if c.scenario == 'none']
    both = sum(all(any(name in g for g in c.found) for name in c.true) for c in pairs)
    inside = [abs(e) < 2 for c in cases for e in c.errors.values()]
    grouped = sum(c.unexplained or len(c.first) > 1 for c in outside)
    single_wrong = sum(len(c.first) == 1 and not c.unexplained for c in outside)
    first, mixed = sum(right(c, c.first) for c in single), sum(right(c, c.first) for c in pairs)
    close = [max(c.ratios) <= LIMIT for c in single + pairs if c.ratios]
    rows = [('right effect first, or its group: one effect', first, len(single), '95 %'),
            ('right effect first, or its group: two effects', mixed, len(pairs), '95 %'),
            ('both effects found, or their groups', both, len(pairs), ''),
            ('value within 2 sigma', sum(inside), len(inside), '90 %'),
            ('an effect added where there is none', sum(bool(c.found) for c in none), len(none), '5 % or fewer'),
            ('an effect added that is neither there nor grouped with one', sum(any(not right(c, g) for g in c.found)
                                                                            for c in single + pairs),
             len(single + pairs), ''),
            ('outside the library: something left to explain', len(outside), len(every), ''),
            ('of these: unexplained, or grouped', grouped, len(outside), '100 %'),
            ('of these: one effect alone is blamed, nothing unexplained', single_wrong, len(outside), '0 %'),
            ('of these: no effect blamed, the noise levels have taken it up',
             len(outside) - grouped - single_wrong, len(outside), ''),
            ('errors after all within 10 % of the knowing filter', sum(close), len(close), '100 %')]
    lines = ['| score | count | share | target |', '|---|---|---|---|']
    lines += [f'| {what} | {k} of {n} | {100 * k / n:.0f} % | {target} |' for what, k, n, target in rows if n]
    skipped = Counter(c.scenario for c in everything if c.failure)
    lines += ['', 'Not counted, as the clean drive does not determine the effect, or it failed: '
              + (', '.join(f'{n} x {name}' for name, n in skipped.items()) or 'none') + '.',
              f'A diagnosis took {np.mean([c.seconds for c in cases]):.1f} s on average.' if cases else '']
    return '\n'.join(lines)


def _rounded(tree):
    return {k: _rounded(v) for k, v in tree.items()} if isinstance(tree, dict) else float(f'{tree:.2g}')


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('--seeds', type=int, default=2, help='drives for each scenario')
    parser.add_argument('--first', type=int, default=1000, help='first seed')
    parser.add_argument('--scenarios', default='', help='only these, separated by commas')
    parser.add_argument('--minutes', type=float, default=np.inf, help='begin no drive later than this')
    options = parser.parse_args(arguments)
    chosen = {name: effects for name, effects in scenarios().items()
              if not options.scenarios or name in options.scenarios.split(',')}
    cases, began = [], time.monotonic()
    for seed in range(options.first, options.first + options.seeds):
        for name, effects in chosen.items():
            if time.monotonic() - began > 60 * options.minutes:
                break
            try:
                case = study(name, effects, seed)
            except ValueError as error:  # what a user would be told in one line
                case = Case(name, seed, {}, failure=str(error))
            cases.append(case)
            for line in case.notes:
                print('    ' + line, file=sys.stderr)
            print(f"{seed} {name} {_rounded(case.true)}: {case.failure or case.found} unexplained {case.unexplained} "
                  f"errors {_rounded(case.errors)} ratios {np.round(case.ratios, 2)} left {case.left:.0f} "
                  f"{case.seconds:.1f} s",
                  file=sys.stderr, flush=True)
    print(results_table(cases))
    return 0


if __name__ == '__main__':
    sys.exit(main())
