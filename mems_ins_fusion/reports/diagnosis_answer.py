"""The answer of a diagnosis: whether to use corrected.yaml, by its results on held-out data, and what to do."""
from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..diagnosis.conclusion import MOUNTING
from ..diagnosis.detection import COLOURED, Detection
from ..diagnosis.findings import Diagnosis, Finding
from ..evaluation.verdict import BETTER, CANNOT_TELL, NO, NOT_USABLE, SAME, Verdict
from ..parameters.params_file import yaml_value
from ..recordings.checker import INFO
from ..recordings.remarks import Remark, checked_text
from .answer import BAD, GOOD, WARNING, YOURS, Answer, Step, cure, let_configure, topics_of
from .diagnosis import (
    capital,
    changed_parameters,
    origin_text,
    outage_error_lines,
    rounded_value,
    subject,
    unexplained_text,
)
from .effect_words import description, looks_the_same, size_text, vehicle_check
from .verdict import because, change_text, trust_text

#: effects that are observed, not fitted, and whose text does not contain their size
WITH_SIZE = {MOUNTING}


def answer(diagnosis: Diagnosis, checked: list[Remark], output: str, bags: Sequence[str],
           params_file: str = YOURS) -> Answer:
    """Whether to use corrected.yaml, what was wrong, what it costs, what remains, what to do.

    checked: findings of the checker. output: folder of the results. bags: paths of the recordings. params_file: as
    given, for the commands.
    """
    d = diagnosis
    out = [f'{name} was left out: {why}' for name, why in d.left_out.items()]
    found = [found_text(f, d) for f in sorted((f for f in d.findings if f.added), key=_left)] + settings_texts(d)
    shown = [shown_text(d.detections['before'])] if d.detections['before'].lacking else []
    # no warning for what is corrected; messages with a parameter come before those on innovations
    said = [f for f in checked if f.severity != INFO and not set(f.settings) & set(changed_parameters(d))]
    to_set, said = ([checked_text(f, topics_of(d.values)) for f in said if bool(f.settings) == wanted]
                    for wanted in (True, False))
    tried = [tried_text(f, d) for f in d.findings if not f.added]
    left = [unexplained_text(d)] if d.unexplained else []
    lacking = bool(d.detections['after' if d.changed else 'before'].lacking)
    settings = [name for f in checked if f.severity != INFO for name in f.settings if name not in changed_parameters(d)]
    return Answer(_grade(d, lacking), headline(d.verdict, d.changed, d.tried),
                  [*out, *found, *to_set, *shown, *said], outage_error_lines(d),
                  _steps(d, output, bags, params_file, settings),
                  trust_text(d.trust, 'With corrected.yaml, ' if d.changed else 'As configured, '),
                  [*tried, *left, *(text for text in d.remarks
                                    if not any(name in text for name in changed_parameters(d)))],
                  because(d.verdict))


def _grade(d: Diagnosis, lacking: bool) -> str:
    """lacking: whether innovations show that something is wrong. A changed file without a proven gain is not GOOD."""
    untrue = d.trust.answer == NO
    if d.better:
        return WARNING if untrue else GOOD
    return BAD if untrue else WARNING if lacking or d.changed else GOOD


def not_usable(found: list[Remark], values: dict, bags: Sequence[str]) -> tuple[Verdict, Answer]:
    """The answer if something in the recording is certainly wrong, so that no effect can be estimated from it.

    found: findings of severity error. values: parameters. bags: paths of the recordings, for the command.
    """
    said = [checked_text(f, topics_of(values)) for f in found]
    verdict = Verdict(NOT_USABLE, why=tuple(said))
    return verdict, Answer(BAD, headline(verdict), said, [], [cure(found, bags)])


def found_text(f: Finding, d: Diagnosis) -> str:
    """What was found: the effect, its certainty, what corrected.yaml does about it, and the gain."""
    also = f' {capital(looks_the_same(f.name))}.' if looks_the_same(f.name) and f.parameters else ''
    size_first = not f.seen or f.name in WITH_SIZE
    said = f'{_size(f, d)}: {description(f.name)}' if size_first else f'{description(f.name)}: {f.seen}'
    return f'{f.name}: {said}.{_group(f, d)}{also}{_change(f, d)}{_saves(f) if d.better else ""}'


def settings_texts(d: Diagnosis) -> list[str]:
    """Other changes in corrected.yaml, and the reasons."""
    of_effects = {name for f in d.findings if f.added for name in f.changes} - set(d.noise)
    return [f'corrected.yaml sets {name} to {_shown(value)}: {origin_text(d, name)}.'
            for name, value in changed_parameters(d).items() if name not in of_effects]


def _shown(value) -> str:
    return yaml_value(rounded_value(value, 3))


def _group(f: Finding, d: Diagnosis) -> str:
    """Effects that it may be instead."""
    others = [description(name) for name in f.group if name != f.name]
    return f' ({capital(subject(d))} cannot tell it from: {"; ".join(others)}.)' if others else ''


def _size(f: Finding, d: Diagnosis) -> str:
    """Its size, or why it is not given; of an effect that was not fitted, the evidence."""
    if 'mechanization' in f.changes:
        return 'as the attitude of the strapdown mechanization shows'
    sizes = ', '.join(size_text(f.name, name, estimate) for name, estimate in f.parameters.items())
    if not f.seen:
        why = '; '.join(f'{name.split(".")[1]}: {why}' for name, why in d.hidden.items()
                        if name.startswith(f'{f.name}.'))
        return _beside(f, d, sizes) or why or 'its size is not determined'
    return f'{sizes}; {f.seen}' if f.name in WITH_SIZE else f.seen


def _beside(f: Finding, d: Diagnosis, sizes: str) -> str:
    """`sizes`; of a time offset that is in addition to one of the params file, said so."""
    if not any(name.endswith('.time_offset') and d.values[name] for name in f.changes):
        return sizes
    return sizes.replace('too late', 'later than your file says').replace('too early', 'earlier than your file says')


def _change(f: Finding, d: Diagnosis) -> str:
    """The new values, and the earlier ones."""
    new = changed_parameters(d)
    said = [f'{name} to {_shown(new[name])} (it was {_shown(d.values[name])})'
            for name in f.changes if name in new and name not in d.noise]
    return f' corrected.yaml sets {", ".join(said)}.' if said else ''


def _left(f: Finding) -> float:
    """The share of the error without fixes that a finding left when it was added; 1 where that is not known."""
    return f.saves[2] / f.saves[1] if f.saves is not None and f.saves[1] else 1.0


def _saves(f: Finding) -> str:
    """The gain over what was found before, as a ratio: metres would be those of other outages than in the rest of the
    page."""
    part = round(100 * (1 - _left(f)))
    if not part:
        return ''
    return (f' When it was added, the error in {f.saves[0]:g} s without fixes became {abs(part)} % '
            f'{"smaller" if part > 0 else "larger"}.')


def shown_text(detection: Detection) -> str:
    """What the innovations of the filter as configured show, without terms of statistics."""
    said = []
    if detection.nis_mean > detection.nis_bounds[1]:
        said.append(f'the fixes lie {np.sqrt(detection.nis_mean / 2):.2g} times as far from where it expects them as '
                    'it thinks they can')
    if detection.ljung_box_p < COLOURED:
        said.append('its errors change sign from fix to fix: it follows the fixes too closely, as with a noise of the '
                    'IMU that is too high, or of the fixes that is too low' if detection.alternates else
                    'its errors last from one fix to the next, as those of a wrong setting do and noise does not')
    return f'The filter as configured: {"; ".join(said) or "it is always off to the same side"}.'


def tried_text(f: Finding, d: Diagnosis) -> str:
    """Candidates that are no effect, or whose correction does not help."""
    if f.seen:
        return f'{capital(description(f.name))}: {f.seen}. Nothing is changed: {f.reason}.'
    sizes = ', '.join(size_text(f.name, name, estimate) for name, estimate in f.parameters.items())
    sizes = f', {sizes}' if sizes else ''
    return f'Looked at, and left alone: {description(f.name)} ({f.name}{sizes}): {f.reason}.{_group(f, d)}'


def headline(verdict: Verdict, changed: bool = False, tried: str = 'what was found') -> str:
    """Whether to use the correction, with the interval of its gain. changed: whether corrected.yaml differs from the
    given file. tried: what the verdict refers to."""
    if verdict.answer == NOT_USABLE:
        return f'Not usable: {verdict.why[0]}'
    if verdict.shown is None:
        return 'Keep your parameters: nothing was found that makes the filter better.'
    proof = change_text(verdict.shown, verdict.level)
    if changed and verdict.answer != BETTER:
        what_of_it = 'makes no difference' if verdict.answer == SAME else 'is not proven to make errors smaller'
        return f'corrected.yaml {what_of_it}: {proof}.'
    if verdict.why:
        return f'Keep your parameters: {verdict.why[0]}; with {tried}, {proof}.'
    if verdict.answer == BETTER:
        return f'Use corrected.yaml: {proof}.'
    if verdict.answer == CANNOT_TELL and verdict.shown.smaller:
        return f'Keep your parameters, no gain is proven: with {tried}, {proof}.'
    return 'Keep your parameters: nothing that was tried makes errors smaller.'


def _steps(d: Diagnosis, output: str, bags: Sequence[str], params_file: str, settings: list[str]) -> list[Step]:
    """settings: names of parameters that the recording contradicts."""
    steps = []
    if d.better:
        but = ', but do not believe its sigmas' if d.trust.answer == NO else ''
        steps.append(Step(f'Drive on with it{but}:', 'python -m mems_ins_fusion fusion_node --ros-args --params-file '
                          + shlex.quote(f'{output}/corrected.yaml')))
    new = changed_parameters(d)
    for f in d.findings if d.changed else ():
        values = ', '.join(f'{name}: {_shown(new[name])}' for name in f.changes if name in new)
        if f.added and vehicle_check(f.name):
            steps.append(Step(f'Check on the vehicle: {vehicle_check(f.name)}'
                              + (f' (corrected.yaml has {values}).' if values else '.')))
    if any(f.drives_contradict for f in d.findings):
        steps.append(Step('The drives contradict each other in what is left alone above: find out what was changed '
                          'between them, and diagnose them apart.'))
    if d.changed and not d.better:
        steps.append(Step('Each change has its reason above it in corrected.yaml, and no error is larger for certain. '
                          'Compare both files on another drive:',
                          f'python -m mems_ins_fusion compare {shlex.quote(params_file)} '
                          f'{shlex.quote(f"{output}/corrected.yaml")} --bag ANOTHER_DRIVE --output compared'))
    if settings and not d.better:
        steps.insert(0, replace(let_configure(bags), what=f'Set {" and ".join(settings)} as configure writes '
                                f'{"them" if settings[1:] else "it"}, and diagnose again:'))
    elif not d.changed and d.verdict.answer == CANNOT_TELL and d.verdict.changes and (d.findings or d.unexplained):
        steps.append(Step('Record a longer drive, with bends to both sides, stops and braking: it may tell.'))
    elif not d.changed and params_file != YOURS:
        steps.append(Step('Drive on with your parameters:', 'python -m mems_ins_fusion fusion_node --ros-args '
                          f'--params-file {shlex.quote(params_file)}'))
    if d.better and not any(f.added for f in d.findings):
        steps.append(Step('No effect was added, only noise levels were chosen: record another drive with bends to both '
                          'sides, stops and braking before you rely on them.'))
    return steps
