"""Two fleets side by side, for people and for CI: is the second one worse for certain?"""
from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from .. import __version__
from ..errors import InputError
from ..evaluation.verdict import BETTER, CANNOT_TELL, SAME, WORSE, Change, Verdict
from ..reports.html import number
from . import population, tables


class GateError(InputError):
    """Two outputs that cannot be compared: one line that says why."""


@dataclass(frozen=True)
class Gate:
    """verdict: on the second fleet against the first; unit: what counts once. both: recordings that are in both;
    lost: those that have a result in the first and failed in the second, with the reason."""

    first: Path
    second: Path
    verdict: Verdict
    unit: str
    both: int
    lost: dict[str, str]

    @property
    def worse(self) -> bool:
        """Whether a release must not go out: errors that are larger for certain, or recordings that fail now."""
        return self.verdict.answer == WORSE or bool(self.verdict.losses) or bool(self.lost)

    def lines(self) -> list[str]:
        """The answer first."""
        words = {BETTER: 'better', SAME: 'the same', WORSE: 'worse', CANNOT_TELL: 'not to be told from each other'}
        answer = words.get(self.verdict.answer, self.verdict.answer)
        head = f'{self.second} is {answer}' if self.verdict.answer != CANNOT_TELL else \
            f'{self.first} and {self.second} are {answer}'
        if self.verdict.answer == CANNOT_TELL and self.verdict.losses:
            head = f'{self.second} is worse in some and better in others'
        said = [f'{head}: {self.both} recordings in both, the unit are {self.unit}.']
        said += [f'  {_text(c)}' for c in self.verdict.changes]
        said += [f'  {recording} has no result any more: {why}' for recording, why in self.lost.items()]
        return said

    def json(self) -> dict:
        return {'tool': 'fleet compare', 'version': __version__,
                'verdict': {'answer': self.verdict.answer, 'because': [_text(c) for c in self.verdict.changes]},
                'worse_for_certain': self.worse, 'unit': self.unit, 'recordings': self.both, 'lost': self.lost,
                'changes': [{'where': c.where, 'before_m': c.before, 'after_m': c.after, 'count': c.count,
                             'interval_m': c.interval(self.verdict.level)} for c in self.verdict.changes]}


def _text(change: Change) -> str:
    interval = change.interval()
    sure = 'too few to say' if interval is None else f'95 % interval of the difference {interval[0]:+.3g} to ' \
                                                    f'{interval[1]:+.3g} m'
    return f'{change.where}: {number(change.before, 3)} m before, {number(change.after, 3)} m after; {sure}'


def compare(first, second) -> Gate:
    """Compare the outputs of two fleets. GateError, or TableError, where that is not possible."""
    first, second = Path(first), Path(second)
    results = [(tables.read(d, 'results'), tables.read(d, 'outages')) for d in (first, second)]
    recordings = [{row['recording_id']: row for row in tables.read(d, 'recordings') if row['status'] != 'duplicate'}
                  for d in (first, second)]
    shared = [i for i, row in recordings[0].items() if row['status'] == 'done'
              and recordings[1].get(i, {}).get('status') == 'done']
    lost = {recordings[1][i]['recording']: recordings[1][i]['reason'] or 'not done' for i, row in recordings[0].items()
            if row['status'] == 'done' and i in recordings[1] and recordings[1][i]['status'] != 'done'}
    if not shared and not lost:
        raise GateError(f'{first} and {second} have no recording in common that has a result in both')
    verdict, unit = population.compared(*(population.errors_of(*some) for some in results))
    if not verdict.changes and not lost:
        raise GateError(f'{first} and {second} have no errors in common: compare fleets with --task replay')
    return Gate(first, second, verdict, unit, len(shared), lost)


def report_text(gate: Gate) -> str:
    """The content of a report for programs."""
    return json.dumps(gate.json(), indent=1) + '\n'
