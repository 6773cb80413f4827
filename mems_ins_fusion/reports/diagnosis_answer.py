"""The answer of a diagnosis: whether to use corrected.yaml, by its own held-out numbers, and what to do."""
from __future__ import annotations

import shlex

from ..diagnosis.diagnose import Diagnosis, Finding
from ..diagnosis.proof import CERTAIN, all_in_all
from ..parameters.params_file import yaml_value
from ..recordings.checker import INFO
from ..recordings.checker import Finding as Checked
from . import html
from .answer import BAD, GOOD, WARNING, Answer, Step, checked_text, held_text, topics_of
from .diagnosis import capital, changed, cost, parameters_text, touches, unexplained_text
from .effect_words import check, what

#: errors that change by less than this part are called unchanged
PRACTICAL = 0.03
#: 95 % ellipses that hold the truth less often than this, %, are too small; said of so many outages
COVERED, FEWEST_OUTAGES = 85.0, 5


def answer(diagnosis: Diagnosis, checked: list[Checked], output: str) -> Answer:
    """Whether to use corrected.yaml, what was wrong, what it costs, what to do.

    checked: what the checker found. output: folder of the results, for the command.
    """
    d, use = diagnosis, judged(diagnosis)
    after = d.after if use == 'use' else d.before
    shares = [o['within_95_percent'] for o in after.summary()['outages'] if o['count'] >= FEWEST_OUTAGES]
    consistent = d.detections['after' if use == 'use' else 'before'].consistent
    covered = not shares or min(shares) >= COVERED
    grade = GOOD if consistent and covered and use != 'worse' else WARNING if use == 'use' else BAD
    said = [checked_text(f, topics_of(d.values)) for f in checked if f.severity != INFO]
    found = [_found(f) for f in d.findings if f.added]
    shown = [] if d.detections['before'].consistent else [f"As configured: {' '.join(d.detections['before'].words())}"]
    left = [unexplained_text(d)] if d.unexplained else []
    return Answer(grade, _headline(d, use), [*found, *shown, *said, *left, *d.remarks], cost(d),
                  _steps(d, use, output), _trust(use, consistent, shares))


def _found(f: Finding) -> str:
    theta = {name: value for name, (value, _, _) in f.parameters.items()}
    how = 'corrected.yaml uses the strapdown mechanization' if f.effect.replaces_model(theta) else parameters_text(f)
    return f'{capital(what(f.name))}: {how}.'


def judged(d: Diagnosis) -> str:
    """What the errors say of corrected.yaml: 'use', 'worse', 'same', or 'nothing' where nothing was changed."""
    if not changed(d):
        return 'nothing'
    rows = [row for row in d.comparison if row.get('before') and row.get('after')]
    if any(row.get('p', 1.0) < CERTAIN and row['after'] > (1 + PRACTICAL) * row['before'] for row in rows):
        return 'worse'
    change = all_in_all(rows) if rows else 1.0
    if change > 1 + PRACTICAL:
        return 'worse'
    # noise levels alone were fitted to this very drive: an error has to shrink for certain
    proven = any(f.added for f in d.findings) or any(row.get('p', 1.0) < CERTAIN for row in rows)
    return 'use' if change < 1 - PRACTICAL and proven else 'same'


def _headline(d: Diagnosis, use: str) -> str:
    proof = _proof(d)
    if use == 'use':
        return f'Use corrected.yaml: {proof}.'
    if use == 'worse':
        return f'Do not use corrected.yaml, keep your parameters: {proof}.'
    if use == 'same':
        return f'It makes no difference whether you use corrected.yaml: {proof}.'
    return 'Keep your parameters: nothing was found that would make the filter better here.'


def _proof(d: Diagnosis) -> str:
    """The error before and after in one clause: of the outages nearest to 30 s, or of all where there are none."""
    where = ('on parts of the drive that the estimate did not use' if any(f.added for f in d.findings) else
             'with noise levels fitted to this drive')
    before, after = d.before.summary(), d.after.summary()
    pairs = [(o, n) for o, n in zip(before['outages'], after['outages']) if o['count'] and n['count']]
    if not pairs:
        old, new = (html.number(s['horizontal_rmse_m'], 2) for s in (before, after))
        return f'{where}, the position error goes from {old} m to {new} m RMS'
    old, new = min(pairs, key=lambda pair: abs(pair[0]['duration_s'] - 30.0))
    was, now = (html.number(o['max_error_median_m'], 2) for o in (old, new))
    return (f'{where}, the largest error in {old["duration_s"]:g} s without fixes goes from {was} m to {now} m (median '
            f'of {new["count"]} outages)')


def _trust(use: str, consistent: bool, shares: list[float]) -> str:
    which = 'With corrected.yaml' if use == 'use' else 'As configured'
    if shares and min(shares) < COVERED:
        return (f'{which}, no: after the outages of one duration its 95 % ellipse held the truth in only '
                f'{html.number(min(shares), 2)} %.')
    held = (f'yes: its 95 % ellipse held the truth {held_text(min(shares))}' if shares
            else 'for outages this recording is too short to say')
    if consistent:
        return f'{which}, {held}.'
    return f'{which}, without fixes {held}. From fix to fix not quite: the innovations are not as it expects.'


def _steps(d: Diagnosis, use: str, output: str) -> list[Step]:
    steps = []
    if use == 'use':
        steps.append(Step('Drive on with it:', 'python -m mems_ins_fusion fusion_node --ros-args --params-file '
                          + shlex.quote(f'{output}/corrected.yaml')))
    for f in d.findings if use == 'use' else ():
        values = ', '.join(f'{name}: {yaml_value(value)}' for name, value in changed(d).items()
                           if f.added and touches(f, d.values, name))
        if f.added and check(f.name):
            steps.append(Step(f'Check on the vehicle: {check(f.name)}' + (f' (corrected.yaml has {values}).' if values
                                                                          else '.')))
    if use != 'nothing' and not any(f.added for f in d.findings):
        steps.append(Step('No effect was added, only noise levels were fitted: record another drive with bends to both '
                          'sides, stops and braking before you rely on them.'))
    return steps
