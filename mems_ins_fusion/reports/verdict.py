"""Verdicts in words, the same in every tool: the results of `evaluation.verdict` in sentences and as JSON."""
from __future__ import annotations

import math
from collections.abc import Sequence

from ..configuration.remaining import TIME_OFFSET, Remaining
from ..evaluation.verdict import NO, TOO_CAREFUL, YES, Change, EllipseCount, ErrorOverSigma, Trust, Verdict
from ..recordings.remarks import ERROR, Remark
from .html import number


def certainly_wrong(findings: Sequence[Remark], values: dict) -> list[Remark]:
    """Reasons why a recording is not usable with the parameters `values`."""
    # a planar filter needs three of the six axes
    return [f for f in findings if f.severity == ERROR and not (values['mechanization'] == 'planar'
                                                                and 'axes' in f.values)]


def unsettled_text(left: Remaining) -> str:
    """Why a params file is not ready: the remaining range of a quantity. Angles in degrees."""
    if not math.isfinite(left.sigma):
        return f'the {left.name} is not shown'
    what, unit, digits = (('time offset between IMU and fixes', 's', 2) if left.name == TIME_OFFSET else
                          (f'{left.name} of the mounting', 'deg', 1))
    value, sigma = (left.value, left.sigma) if unit == 's' else map(math.degrees, (left.value, left.sigma))
    known = f'may be off by {value:.{digits}f} +- ' if left.certain(0.0, 0.5) else 'is known to '
    return f'the {what} {known}{sigma:.{digits}f} {unit}: more turns and changes of speed, or diagnose, would tell'


def where_text(change: Change) -> str:
    """The error that a change refers to."""
    of = f'{change.where}, ' if change.where else ''
    if change.duration is not None:
        return f'{of}in {change.duration:g} s without fixes'
    return f'{of}with fixes' + (f' each {change.every:g} s' if change.every else '')


def change_text(change: Change, level: float, before_is: str = '') -> str:
    """A change with its interval: the error, after instead of before, and the 95 % interval of the difference.
    before_is: name of the first one, where it is not obvious."""
    before, after = (f'{number(v, _digits(change))} m' for v in (change.before, change.after))
    said = f'{where_text(change)} the error is {after} instead of {before}{f" {before_is}" if before_is else ""}'
    interval = change.interval(level)
    return f'{said} (95 %: {span_text(*interval)})' if interval else f'{said} (too few to say more)'


def _digits(change: Change) -> int:
    """Two digits, or three if both numbers would have the same text."""
    return 2 if number(change.before, 2) != number(change.after, 2) else 3


def span_text(low: float, high: float) -> str:
    """Interval of the difference of an error, m."""
    if _size(abs(low)) == _size(abs(high)) == '0':
        return 'the same'
    if low >= 0 or high <= 0:
        near, far = sorted((abs(low), abs(high)))
        digits = 2 if _size(near) != _size(far) else 3
        return f'{_size(near, digits)} to {_size(far, digits)} m {"more" if low >= 0 else "less"}'
    return f'{_size(-low)} m less to {_size(high)} m more'


def _size(metres: float, digits: int = 2) -> str:
    return number(metres, digits) if metres >= 0.005 else '0'


def counted_text(change: Change) -> str:
    """What was counted for a change."""
    if change.duration is None:
        return f'root mean square at {change.count} positions'
    return f'mean of the largest error in {change.count} outages'


def because(verdict: Verdict) -> list[str]:
    """The evidence for the verdict, as lines."""
    said = [*verdict.why]
    if verdict.fitted_here:
        said.append('the parameters were fitted to this very recording: what it shows is no proof of a gain')
    certain = {id(c): word for found, word in ((verdict.gains, 'better'), (verdict.losses, 'worse')) for c in found}
    said += [f'{certain.get(id(c), "no certain difference")}: {change_text(c, verdict.level)}; {counted_text(c)}'
             for c in verdict.changes]
    return said or ['nothing was measured that could be compared']


def verdict_json(verdict: Verdict, trust: Trust | None = None) -> dict:
    """The verdict for report.json."""
    return {'answer': verdict.answer, 'because': because(verdict),
            'fitted_to_this_recording': verdict.fitted_here,
            'changes': [{'recording': c.where or None, 'duration_s': c.duration, 'every_s': c.every, 'count': c.count,
                         'before_m': c.before, 'after_m': c.after, 'interval_m': c.interval(verdict.level)}
                        for c in verdict.changes]} | ({} if trust is None else {'trust': trust_json(trust)})


def trust_json(trust: Trust) -> dict:
    """The consistency of the sigmas for report.json."""
    return {'answer': trust.answer, 'because': trust_text(trust),
            'outages': [{'duration_s': h.duration, 'held': h.held, 'count': h.count, 'interval': [h.low, h.high],
                         'p': h.p} for h in trust.held],
            'error_over_sigma': [{'duration_s': s.duration, 'value': s.value, 'interval': [s.low, s.high]}
                                 for s in trust.scales]}


def trust_text(trust: Trust, which: str = '') -> str:
    """Whether sigmas are right, in a sentence. which: name of the filter, where it is not obvious."""
    said = {YES: 'yes', NO: 'no, its sigmas are too small', TOO_CAREFUL: 'its sigmas are too large'}.get(
        trust.answer, 'cannot tell')
    evidence = [held_text(trust.shown)] if trust.shown and trust.answer != TOO_CAREFUL else []
    if trust.scale and (trust.answer in (NO, TOO_CAREFUL) or not evidence):
        evidence.append(scale_text(trust.scale))
    said = ': '.join([said, '; '.join(evidence)]) if evidence else f'{said}: the recording is too short'
    return f'{which}{said}.'


def too_small_text(trust: Trust) -> str:
    """Evidence that its sigmas are too small."""
    return held_text(trust.shown) if trust.scale is None else scale_text(trust.scale)


def held_text(held: EllipseCount) -> str:
    """Share of the errors inside the ellipse."""
    return (f'the 95 % ellipse held the truth in {held.held} of {held.count} outages of {held.duration:g} s '
            f'({100 * held.low:.0f} to {100 * held.high:.0f} %)')


def scale_text(scale: ErrorOverSigma) -> str:
    """Ratio of the errors to the sigmas."""
    where = 'with fixes' if scale.duration is None else f'in {scale.duration:g} s without fixes'
    return f'errors {where} are {scale.value:.2g} sigma RMS ({scale.low:.2g} to {scale.high:.2g}; 1 is right)'
