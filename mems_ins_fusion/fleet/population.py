"""Statements about vehicles from measurements of their recordings: the vehicle is the unit.

A hundred recordings of one car show the errors with this car, not those with cars in general. So each vehicle has the
same weight, with the mean over its recordings, and intervals are those of Student's t over vehicles. This is what a
linear mixed model with a random effect for each vehicle gives if vehicles differ more than the recordings of one (J. C.
Pinheiro, D. M. Bates, "Mixed-Effects Models in S and S-PLUS", 2000, chapter 1). With one or two vehicles no statement
about vehicles is possible; then recordings are the unit, and the output says so.
"""
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..evaluation.intervals import FEWEST, Difference, mean_with_error, ratio
from ..evaluation.verdict import FELT, Change, Verdict, decide, power_of
from ..recordings.motion import robust_sigma

VEHICLES, RECORDINGS = 'vehicles', 'recordings'


@dataclass(frozen=True)
class Candidate:
    """A sensor error model to compare; params_file: if several were tried on one recording, else ''."""

    params_file: str
    model: str

    def words(self, several_files: bool) -> str:
        name = self.model.replace('_', ' ')
        return f'{self.params_file or "defaults"}: {name}' if several_files else name


@dataclass(frozen=True, order=True)
class ComparedQuantity:
    """A quantity to compare. without: s without fixes; 0: with fixes. interval: s between fixes."""

    without: float
    interval: float

    def words(self) -> str:
        return f'{self.without:g} s without fixes' if self.without else f'fixes each {self.interval:g} s'


#: by quantity, candidate and (vehicle, recording): m, the RMS error with fixes, or of the largest errors without
Errors = dict[ComparedQuantity, dict[Candidate, dict[tuple[str, str], float]]]


def errors_of(results: Sequence[dict], outages: Sequence[dict]) -> Errors:
    """The errors in the tables `results` and `outages`."""
    found: Errors = {}
    numbers = [(row, ComparedQuantity(0.0, row['update_interval_s'] or 0.0), row['horizontal_rmse_m'])
               for row in results]
    numbers += [(row, ComparedQuantity(row['duration_s'], row['update_interval_s'] or 0.0), row['max_error_rms_m'])
                for row in outages]
    files: dict[str, set[str]] = {}
    for row, _, _ in numbers:
        files.setdefault(row['recording_id'], set()).add(row['params_file'] or '')
    # vehicles with different params files: these are not alternatives
    choice = any(len(names) > 1 for names in files.values())
    for row, where, error in numbers:
        if error is not None and row['recording_id'] and not row['stage']:
            candidate = Candidate((row['params_file'] or '') if choice else '', row['model'])
            found.setdefault(where, {}).setdefault(candidate, {})[row['vehicle'], row['recording_id']] = error
    return dict(sorted(found.items()))


def over_vehicles(values: dict[tuple[str, str], float]) -> tuple[np.ndarray, str]:
    """The means over the recordings of each vehicle, or each recording if there are too few vehicles; and which of
    both.

    values: by vehicle and recording.
    """
    groups: dict[str, list[float]] = {}
    for (vehicle, _), value in sorted(values.items()):
        groups.setdefault(vehicle, []).append(value)
    if len(groups) >= FEWEST:
        return np.array([np.mean(some) for some in groups.values()]), VEHICLES
    return np.array([value for _, value in sorted(values.items())]), RECORDINGS


def mean_of(values: np.ndarray) -> Difference | None:
    """The mean of independent `values` (n,) with its standard error; None if there are too few."""
    return mean_with_error(values, independent=True)


def change(where: ComparedQuantity, before: dict, after: dict) -> tuple[Change, str] | None:
    """The change from one candidate to another on the recordings that both have, and its unit; None if there are none.

    before, after: m, by vehicle and recording.
    """
    both = sorted(before.keys() & after.keys())
    if not both:
        return None
    power = power_of(where.without or None)  # averages are those of mean squares, not of their roots
    (old, unit), (new, _) = (over_vehicles({key: e[key]**power for key in both}) for e in (before, after))
    means = [float(np.mean(e))**(1 / power) for e in (old, new)]
    found = ratio(new, old, FELT**power, independent=True)
    return Change(where.without or None, *means, len(old), found, where.words()), unit


def compared(before: Errors, after: Errors) -> tuple[Verdict, str]:
    """The verdict on two fleets at the recordings that both have, over all quantities, and the unit.

    Models are matched by name; where they share none, the first of each.
    """
    changes, units = [], []
    for where in sorted(before.keys() & after.keys()):
        first, second = before[where], after[where]
        pairs = [(c, c) for c in first if c in second] or [(next(iter(first)), next(iter(second)))]
        for a, b in pairs:
            found = change(where, first[a], second[b])
            if found is not None:
                changes.append(found[0])
                units.append(found[1])
    return decide(changes), VEHICLES if VEHICLES in units else RECORDINGS


@dataclass(frozen=True)
class CandidateRank:
    """Result of a candidate for a quantity. mean: m, over units; low, high: its 95 % interval or None. count: number of
    units (`unit`). answer: of the verdict against the best candidate; '' for the best."""

    where: ComparedQuantity
    candidate: Candidate
    mean: float
    low: float | None
    high: float | None
    count: int
    unit: str
    answer: str


def standings(errors: Errors) -> list[CandidateRank]:
    """The candidates for each quantity, the best first."""
    found = []
    for where, candidates in errors.items():
        means = {c: over_vehicles(e) for c, e in candidates.items()}
        best, *others = sorted(candidates, key=lambda c: (float(means[c][0].mean()), c.model, c.params_file))
        for candidate in (best, *others):
            values, unit = means[candidate]
            mean = mean_of(values)
            low, high = mean.interval() if mean else (None, None)
            against = change(where, candidates[best], candidates[candidate]) if candidate != best else None
            found.append(CandidateRank(where, candidate, float(values.mean()), low, high, len(values), unit,
                                       decide([against[0]]).answer if against else ''))
    return found


@dataclass(frozen=True)
class Outlier:
    """A vehicle that differs from the others. value: of it. middle: median of all. distance: in robust standard
    deviations."""

    vehicle: str
    what: str
    value: float
    middle: float
    unit: str
    distance: float


#: distance from the median of all vehicles, in standard deviations by the median deviation, above which a vehicle is
#: reported
FAR = 4.0
#: smallest number of vehicles in which outliers are looked for
FEWEST_VEHICLES = 5


def by_effect(effects: Sequence[dict]) -> dict[tuple[str, str, str, str], dict[str, float]]:
    """Median over the recordings of each vehicle, for each parameter of each effect: by source, effect, parameter and
    unit, then by vehicle."""
    found: dict[tuple, dict[str, list]] = {}
    for row in effects:
        if row['value'] is not None and row['recording_id']:
            key = (row['source'], row['effect'], row['parameter'], row['unit'] or '')
            found.setdefault(key, {}).setdefault(row['vehicle'], []).append(row['value'])
    return {key: {vehicle: float(np.median(values)) for vehicle, values in sorted(vehicles.items())}
            for key, vehicles in sorted(found.items())}


def outliers(values: dict[str, float], what: str, unit: str) -> list[Outlier]:
    """Vehicles whose values are far from those of the others. values: by vehicle."""
    numbers = np.array(list(values.values()))
    if len(numbers) < FEWEST_VEHICLES:
        return []
    middle = float(np.median(numbers))
    sigma = robust_sigma(numbers)
    if sigma == 0.0:
        return []
    return [Outlier(vehicle, what, value, middle, unit, abs(value - middle) / sigma)
            for vehicle, value in values.items() if abs(value - middle) > FAR * sigma]
