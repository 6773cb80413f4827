"""Several drives of one vehicle as one problem: what is unknown is shared, each drive is filtered on its own.

Effects and noise levels belong to the vehicle. The states of the filter, its sensors' biases among them, begin anew in
each drive. So the innovations of all drives stand one after another, and likelihoods, scores and information add.
"""
from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace

import numpy as np

from ..samples import Recording
from .problem import DiagnosisError, Problem, Unknown, on_all_cores
from .residuals import Residual


class Drives:
    """The problems of several drives as one: as `Problem`, with what is there for each fix one drive after another.

    each: the problem of each drive. slices: where its fixes stand.
    """

    def __init__(self, problems: Sequence[Problem]):
        self.each = tuple(problems)
        self.given, self.values = self.each[0].given, self.each[0].values
        ends = np.cumsum([0, *(len(p.stamp) for p in self.each)])
        self.slices = [slice(a, b) for a, b in zip(ends[:-1], ends[1:])]
        self.stamp, self.mask, self.claimed, self.outlying = (
            np.concatenate([getattr(p, name) for p in self.each]) for name in ('stamp', 'mask', 'claimed', 'outlying'))
        self.before = joined_residuals([p.before for p in self.each])
        self.base = joined_residuals([p.base for p in self.each])
        self._by_name = {p.recording.name: p for p in self.each}
        self._watch: list[Callable[[], None] | None] = [None]

    def watched(self, watch: Callable[[], None] | None) -> None:
        """Call `watch` after each batch of runs, of this problem and those made from it."""
        self._watch[0] = watch

    def _made(self, problems: Sequence[Problem]) -> Drives:
        other = Drives(problems)
        other._watch = self._watch
        return other

    @property
    def work(self) -> int:
        """IMU samples that were filtered, of this problem and those made from it."""
        return sum(sum(p.runs) for p in self.each)

    def of(self, recording: Recording) -> Problem:
        return self._by_name[recording.name]

    def attitude(self, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
        return self.of(recording).attitude(recording)

    def without(self, outlying: np.ndarray) -> Drives:
        """The same problem with the fixes `outlying` (f,) left out, too."""
        return self._made([p.without(outlying[where]) for p, where in zip(self.each, self.slices)])

    def configured(self, recordings: Sequence[Recording], values: dict) -> Drives:
        """The same drives, `recordings`, with other parameters given; the work it makes counts with that of this."""
        return self._made([p.configured(recording, values)
                           for p, recording in zip(self.each, recordings)]).without(self.outlying)

    def observed(self, values: dict) -> Residual:
        return joined_residuals(on_all_cores(lambda p: p.observed(values), self.each))

    def moved(self, unknowns: Sequence[Unknown], x) -> Drives:
        return self._made([p.moved(unknowns, x) for p in self.each])

    def corrected(self, unknowns: Sequence[Unknown], x) -> dict:
        return self.each[0].corrected(unknowns, x)

    def residuals(self, unknowns: Sequence[Unknown], points) -> list[Residual]:
        """The innovations at several `points`, on all cores."""
        def one(of):
            x, problem = of
            return problem.residual(*problem.assume(unknowns, x))

        count = len(self.each)
        found = on_all_cores(one, [(x, p) for x in points for p in self.each])
        if self._watch[0] is not None:
            self._watch[0]()
        return [joined_residuals(found[i:i + count]) for i in range(0, len(found), count)]


def joined_residuals(residuals: Sequence[Residual]) -> Residual:
    """Innovations of several drives, one after another."""
    columns = {f.name: [getattr(r, f.name) for r in residuals] for f in fields(Residual)}
    return Residual(**{name: None if any(c is None for c in column) else np.concatenate(column)
                       for name, column in columns.items()})


def select_fixes(of, where: slice):
    """The fixes `where` of a Residual, or of Scores."""
    arrays = {f.name: getattr(of, f.name) for f in fields(of)}
    return replace(of, **{name: None if array is None else array[where] for name, array in arrays.items()})


def problems(recordings: Sequence[Recording], values: dict, fewest: int,
             others: Sequence[dict] = ()) -> tuple[list[Problem], dict[str, str]]:
    """The problem of each drive, and why others have none: they do not start, or have fewer than `fewest` fixes.

    others: as of `Problem`. Raises DiagnosisError where there is none.
    """
    found, left_out = [], {}
    for recording in recordings:
        try:
            problem = Problem(recording, values, others=others)
            count = int(problem.mask.sum())
            if count < fewest:
                raise DiagnosisError(f'{recording.name}: {count} fixes while the filter runs, {fewest} are needed: '
                                     'record a longer drive')
            found.append(problem)
        except DiagnosisError as error:
            left_out[recording.name] = str(error)
    if not found:
        raise DiagnosisError('; '.join(left_out.values()))
    return found, left_out
