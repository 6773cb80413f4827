"""The answer of a diagnosis: whether to use corrected.yaml, by its own held-out numbers, and what to do."""
from __future__ import annotations

import shlex

import numpy as np

from ..diagnosis.diagnose import Diagnosis, Finding
from ..diagnosis.proof import FEWEST_DRIVES
from ..parameters.params_file import yaml_value
from ..recordings.checker import INFO
from ..recordings.checker import Finding as Checked
from . import html
from .answer import BAD, GOOD, WARNING, Answer, Step, checked_text, held_text, topics_of
from .diagnosis import capital, changed, cost, parameters_text, this, unexplained_text
from .effect_words import check, what

#: means and medians that differ by more than this factor tell of a few large errors
TAILS = 1.5
#: 95 % ellipses that hold the truth less often than this, %, are too small; said of so many outages
COVERED, FEWEST_OUTAGES = 85.0, 5


def answer(diagnosis: Diagnosis, checked: list[Checked], output: str) -> Answer:
    """Whether to use corrected.yaml, what was wrong, what it costs, what to do.

    checked: what the checker found. output: folder of the results, for the command.
    """
    d = diagnosis
    after = d.after if d.better else d.before
    shares = [o['within_95_percent'] for o in after.summary()['outages'] if o['count'] >= FEWEST_OUTAGES]
    consistent = not d.detections['after' if d.better else 'before'].lacking
    covered = not shares or min(shares) >= COVERED
    grade = GOOD if consistent and covered else WARNING if d.better else BAD
    said = [checked_text(f, topics_of(d.values)) for f in checked if f.severity != INFO]
    found = [found_text(f, d) for f in d.findings if f.added]
    out = [f'{name} was left out: {why}' for name, why in d.left_out.items()]
    tried = [tried_text(f) for f in d.findings if not f.added]
    shown = [] if not d.detections['before'].lacking else [f"As configured: {' '.join(d.detections['before'].words())}"]
    left = [unexplained_text(d)] if d.unexplained else []
    return Answer(grade, _headline(d), [*found, *tried, *shown, *said, *left, *out, *d.remarks], cost(d),
                  _steps(d, output), _trust(d.better, consistent, shares))


def found_text(f: Finding, d: Diagnosis) -> str:
    """What was found: what it is, how sure, and what corrected.yaml does about it."""
    how = 'corrected.yaml uses the strapdown mechanization' if 'mechanization' in f.changes else parameters_text(f)
    others = [what(name) for name in f.group if name != f.name]
    group = f' (in {this(d)} the same as: {"; ".join(others)})' if others else ''
    return f'{capital(what(f.name))}: {how}{group}{_seen(f)}.'


def _seen(f: Finding) -> str:
    return f'; {f.seen}' if f.seen else ''


def tried_text(f: Finding) -> str:
    """What looked like an effect and is none, or none that helps."""
    if f.seen:
        return f'{capital(what(f.name))}: {f.seen}. Nothing is changed: {f.reason}.'
    return f'Looked at, and left alone: {what(f.name)} ({parameters_text(f)}): {f.reason}.'


def _headline(d: Diagnosis) -> str:
    if d.better:
        return f'Use corrected.yaml: {_proof(d)}.'
    tried = [f for f in d.findings if not f.added]
    also = ' Something was found that does not help; see below.' if tried else ''
    return ('Keep your parameters: nothing was found that makes the filter better here for certain, and corrected.yaml '
            f'holds them as they are.{also}')


def _proof(d: Diagnosis) -> str:
    """The error before and after in one clause: of the outages nearest to 30 s, or of all where there are none."""
    where = ('on parts of the drives that' if d.drives else 'on parts of the drive that') + ' the estimate did not use'
    if len(d.drives) >= FEWEST_DRIVES:
        where = 'in each drive, with what the others say'
    before, after = d.before.summary(), d.after.summary()
    pairs = [(o, n) for o, n in zip(d.before.outages, d.after.outages) if len(o.begin) and len(n.begin)]
    if not pairs:
        old, new = (html.number(s['horizontal_rmse_m'], 2) for s in (before, after))
        return f'{where}, the position error goes from {old} m to {new} m RMS'
    old, new = min(pairs, key=lambda pair: abs(pair[0].duration - 30.0))
    was, now = (html.number(float(np.median(o.max_error)), 2) for o in (old, new))
    said = (f'{where}, the largest error in {old.duration:g} s without fixes goes from {was} m to {now} m (median of '
            f'{len(new.begin)} outages')
    means = [float(o.max_error.mean()) for o in (old, new)]
    if any(mean > TAILS * np.median(o.max_error) for mean, o in zip(means, (old, new))):
        said += f'; mean {html.number(means[0], 2)} m to {html.number(means[1], 2)} m, as a few are much larger'
    return said + ')'


def _trust(better: bool, consistent: bool, shares: list[float]) -> str:
    which = 'With corrected.yaml' if better else 'As configured'
    if shares and min(shares) < COVERED:
        return (f'{which}, no: after the outages of one duration its 95 % ellipse held the truth in only '
                f'{html.number(min(shares), 2)} %.')
    held = (f'yes: its 95 % ellipse held the truth {held_text(min(shares))}' if shares
            else 'for outages this recording is too short to say')
    if consistent:
        return f'{which}, {held}.'
    return f'{which}, without fixes {held}. From fix to fix not quite: the innovations are not as it expects.'


def _steps(d: Diagnosis, output: str) -> list[Step]:
    steps = []
    if d.better:
        steps.append(Step('Drive on with it:', 'python -m mems_ins_fusion fusion_node --ros-args --params-file '
                          + shlex.quote(f'{output}/corrected.yaml')))
    new = changed(d)
    for f in d.findings if d.better else ():
        values = ', '.join(f'{name}: {yaml_value(new[name])}' for name in f.changes if name in new)
        if f.added and check(f.name):
            steps.append(Step(f'Check on the vehicle: {check(f.name)}' + (f' (corrected.yaml has {values}).' if values
                                                                          else '.')))
    if any(f.apart for f in d.findings):
        steps.append(Step('The drives contradict each other in what is left alone above: find out what was changed '
                          'between them, and diagnose them apart.'))
    if d.better and not any(f.added for f in d.findings):
        steps.append(Step('No effect was added, only noise levels were chosen: record another drive with bends to both '
                          'sides, stops and braking before you rely on them.'))
    return steps
