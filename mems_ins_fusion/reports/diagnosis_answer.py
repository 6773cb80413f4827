"""The answer of a diagnosis: whether to use corrected.yaml, by its own held-out numbers, and what to do."""
from __future__ import annotations

import shlex

import numpy as np

from ..diagnosis.conclusion import MOUNTING
from ..diagnosis.detection import COLOURED, Detection
from ..diagnosis.findings import Diagnosis, Finding
from ..diagnosis.measured import nearest
from ..diagnosis.parts import FEWEST_DRIVES
from ..parameters.params_file import yaml_value
from ..recordings.checker import INFO
from ..recordings.checker import Finding as Checked
from . import html
from .answer import BAD, GOOD, WARNING, Answer, Step, checked_text, held_text, topics_of
from .diagnosis import capital, changed, cost, rounded_value, tailed, this, unexplained_text
from .effect_words import check, looks_the_same, size, what

#: 95 % ellipses that hold the truth less often than this, %, are too small; said of so many outages
COVERED, FEWEST_OUTAGES = 85.0, 5
#: seen, not fitted, and with a size that the text of what is seen does not have
WITH_SIZE = {MOUNTING}


def answer(diagnosis: Diagnosis, checked: list[Checked], output: str) -> Answer:
    """Whether to use corrected.yaml, what was wrong, what it costs, what remains, what to do.

    checked: what the checker found. output: folder of the results, for the command.
    """
    d = diagnosis
    measured = d.after if d.better else d.before
    shares = {o['duration_s']: o['within_95_percent'] for o in measured.summary()['outages']
              if o['count'] >= FEWEST_OUTAGES}
    consistent = not d.detections['after' if d.better else 'before'].lacking
    covered = not shares or min(shares.values()) >= COVERED
    grade = GOOD if consistent and covered else WARNING if d.better else BAD
    out = [f'{name} was left out: {why}' for name, why in d.left_out.items()]
    found = [found_text(f, d) for f in d.findings if f.added]
    shown = [shown_text(d.detections['before'])] if d.detections['before'].lacking else []
    said = [checked_text(f, topics_of(d.values)) for f in checked if f.severity != INFO]
    tried = [tried_text(f) for f in d.findings if not f.added]
    left = [unexplained_text(d)] if d.unexplained else []
    return Answer(grade, _headline(d), [*out, *found, *shown, *said], cost(d), _steps(d, output),
                  _trust(d.better, consistent, shares), [*tried, *left, *d.remarks])


def found_text(f: Finding, d: Diagnosis) -> str:
    """What was found: what it is, how sure, what corrected.yaml does about it, and what that gains."""
    others = [what(name) for name in f.group if name != f.name]
    group = f' ({capital(this(d))} cannot tell it from: {"; ".join(others)}.)' if others else ''
    also = f' {capital(looks_the_same(f.name))}.' if looks_the_same(f.name) and f.parameters else ''
    return f'{capital(what(f.name))} ({f.name}): {_size(f)}.{group}{also}{_change(f, d)}{_saves(f)}'


def _size(f: Finding) -> str:
    """How large it is; where it was not fitted, what shows it."""
    if 'mechanization' in f.changes:
        return 'as the attitude of the strapdown mechanization shows'
    sizes = ', '.join(size(f.name, name, estimate) for name, estimate in f.parameters.items())
    if not f.seen:
        return sizes or 'its size is not determined'
    return f'{sizes}; {f.seen}' if f.name in WITH_SIZE else f.seen


def _change(f: Finding, d: Diagnosis) -> str:
    """The new values, and those before."""
    new = changed(d)
    said = [f'{name} to {yaml_value(new[name])} (it was {yaml_value(rounded_value(d.values[name]))})'
            for name in f.changes if name in new and name not in d.noise]
    return f' corrected.yaml sets {", ".join(said)}.' if said else ''


def _saves(f: Finding) -> str:
    """What it gains in metres."""
    if f.saves is None:
        return ''
    duration, before, after = f.saves
    one, other = (html.number(v, 2) for v in (before, after))
    gain = f'goes from {one} m to {other} m' if one != other else f'stays at {one} m'
    return f' With it the error {gain} (median of the largest in {duration:g} s without fixes).'


def shown_text(detection: Detection) -> str:
    """What the innovations of the filter as configured show, without the words of statistics."""
    said = []
    if detection.nis_mean > detection.nis_bounds[1]:
        said.append(f'the fixes lie {np.sqrt(detection.nis_mean / 2):.2g} times as far from where it expects them as '
                    'it thinks they can')
    if detection.ljung_box_p < COLOURED:
        said.append('its errors last from one fix to the next, as those of a wrong setting do and noise does not')
    return f'The filter as configured: {"; ".join(said) or "it is always off to the same side"}.'


def tried_text(f: Finding) -> str:
    """What looked like an effect and is none, or none that helps."""
    if f.seen:
        return f'{capital(what(f.name))}: {f.seen}. Nothing is changed: {f.reason}.'
    sizes = ', '.join(size(f.name, name, estimate) for name, estimate in f.parameters.items())
    return f'Looked at, and left alone: {what(f.name)} ({f.name}{f", {sizes}" if sizes else ""}): {f.reason}.'


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
    old, new = nearest(d.before), nearest(d.after)
    if old is None or new is None:
        old, new = (html.number(s['horizontal_rmse_m'], 2) for s in (before, after))
        return f'{where}, the position error goes from {old} m to {new} m RMS'
    was, now = (html.number(float(np.median(o.max_error)), 2) for o in (old, new))
    said = (f'{where}, the largest error in {old.duration:g} s without fixes goes from {was} m to {now} m (median of '
            f'{len(new.begin)} outages')
    if tailed([old, new]):
        means = [float(o.max_error.mean()) for o in (old, new)]
        said += f'; mean {html.number(means[0], 2)} m to {html.number(means[1], 2)} m, as a few are much larger'
    return said + ')'


def _trust(better: bool, consistent: bool, shares: dict[float, float]) -> str:
    which = 'With corrected.yaml' if better else 'As configured'
    if shares and min(shares.values()) < COVERED:
        worst = min(shares, key=shares.get)
        return (f'{which}, no: after {worst:g} s without fixes its 95 % ellipse held the truth in only '
                f'{html.number(shares[worst], 2)} %.')
    held = (f'yes: its 95 % ellipse held the truth {held_text(min(shares.values()))}' if shares
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
