"""What is missing to know an effect better: the manoeuvre that shows most of it, by its Fisher information.

Manoeuvres are simulated on a level road with the receiver of the recording and go through the filter with the present
parameters. Differences between runs with and without a small part of the effect give the information of each, which
adds to what is known (`fit.scores`). The part of a sigma that is no matter of samples (`Finding.least`) stays.
"""
from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..effects.registry import effect_called
from ..errors import InputError
from ..samples import Recording
from ..simulation.drive import Path, follow
from ..simulation.manoeuvres import ASKED, asked
from ..simulation.simulation import GnssNoise, SensorErrors, simulate_recording
from .findings import Finding
from .fit import scores
from .problem import Problem
from .tracing import effect_unknowns

#: s of a simulated drive before a manoeuvre: the filter has to know its heading
BEFORE = 80.0
#: s from the begin of a manoeuvre, for all the same: some are shorter, and go straight on then
DURATION = 30.0
#: m/s: on a road in town
SPEED = 9.0
#: Hz of the simulated IMU: twice what a diagnosis looks at
RATE = 25.0
#: a manoeuvre that leaves more of a sigma is not worth a sentence
WORTH = 0.8
#: part of a variance that is a matter of more samples, at least
TINY = 1e-6
#: s between two fixes at least: what a diagnosis uses
FIX_INTERVAL = 1.0


@dataclass(frozen=True)
class Advice:
    """A manoeuvre (in words) and what it does to a parameter: its standard deviation now and behind it, in its unit."""

    manoeuvre: str
    parameter: str
    unit: str
    now: float
    then: float

    def text(self) -> str:
        unit = '' if self.unit == '-' else f' {self.unit}'
        return (f'{self.manoeuvre} would bring the sigma of {self.parameter} from {self.now:.2g} to '
                f'{self.then:.2g}{unit}')


def advised(finding: Finding, recording: Recording, values: dict) -> Advice | None:
    """The manoeuvre that makes the sigma of a parameter of `finding` smallest, as a part of what it is now; None where
    none is worth it.

    recording: what the receiver claims and how often it comes. values: checked parameters of the filter.
    """
    effect = effect_called(finding.name)
    known = {name: e for name, e in finding.parameters.items() if e.known and e.sigma > 0.0}
    tried = {name: e.value for name, e in finding.parameters.items() if name in effect.refined}
    unknowns = [u for u in effect_unknowns(effect, tried) if u.parameter in known]
    if not unknowns or any(u.variance for u in unknowns):  # a noise shows with time, whatever is driven
        return None
    sigma = np.array([known[u.parameter].sigma for u in unknowns])
    least = np.array([finding.least.get(u.parameter, 0.0) for u in unknowns])
    own = np.maximum(sigma**2 - least**2, TINY * sigma**2)
    best = None
    for name in ASKED:
        information = shown(name, unknowns, recording, values)
        then = np.sqrt(np.diag(np.linalg.inv(np.diag(1.0 / own) + information)) + np.minimum(least, sigma)**2)
        worst = int(np.argmin(then / sigma))
        if then[worst] < WORTH * sigma[worst] and (best is None or then[worst] / sigma[worst] < best.then / best.now):
            best = Advice(name, unknowns[worst].parameter, known[unknowns[worst].parameter].unit, float(sigma[worst]),
                          float(then[worst]))
    return best


def shown(name: str, unknowns: list, recording: Recording, values: dict) -> np.ndarray:
    """Fisher information (p, p) of `unknowns` in DURATION s from the begin of the manoeuvre `name`."""
    path = Path(asked(name, SPEED, BEFORE, DURATION))
    drive = follow(path, BEFORE + DURATION + 5.0, RATE)
    # with their noise: of perfect sensors, standing and driving straight on at one speed look the same
    sensors = SensorErrors.from_parameters(values, values['sensor_error_model'])
    simulated = simulate_recording(drive, sensors, receiver(recording),
                                   mounting_rpy=values['imu.mounting_rpy']).recording
    try:
        problem = Problem(simulated, values)
    except InputError:
        return np.zeros((len(unknowns),) * 2)
    begin = simulated.imu.stamp[0] + round(BEFORE * 1e9)
    mask = problem.mask & (problem.stamp > begin)
    _, found = scores(problem, unknowns, np.zeros(len(unknowns)))
    return found.information(mask)


def receiver(recording: Recording) -> GnssNoise:
    """A receiver whose fixes are as sure and as frequent as those of `recording`, one a FIX_INTERVAL at most."""
    fixes = recording.gnss
    variance = np.median(0.5 * (fixes.covariance[:, 0, 0] + fixes.covariance[:, 1, 1])) if len(fixes) else 0.0
    interval = float(np.median(np.diff(fixes.stamp))) * 1e-9 if len(fixes) > 1 else FIX_INTERVAL
    return GnssNoise(float(np.sqrt(variance)) or 1.0, rate=1.0 / max(interval, FIX_INTERVAL))
