"""The answer that stands first: on a page, on the console and in report.json, in the same words."""
from __future__ import annotations

import re
import shlex
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field

from ..filter.measurements.registry import AIDING
from ..recordings.remarks import Remark
from .html import Html, bullets, command, folded, paragraph

GOOD, WARNING, BAD = 'good', 'warning', 'bad'
#: in a command, where it is not known which params file was given
YOURS = 'YOUR_FILE.yaml'
#: characters of a line on a console
WIDTH = 100
#: what the checker looks at, each with a parameter of its topic
_CHECKED = ('imu', 'gnss', 'temperature', *(one.name for one in AIDING))
#: what stands where a line was cut
_CUT = ' ...'
#: a space at which no line ends, and where it belongs: between a number and its unit
_TOGETHER = '\N{NO-BREAK SPACE}'
_UNIT = re.compile(r'(?<=\d) (?=(?:%|m|s|deg)(?!\w))')


@dataclass(frozen=True)
class Step:
    """One thing to do next. command: what to type, if anything."""

    what: str
    command: str = ''


@dataclass
class Answer:
    """The summary of a result for a person.

    grade: GOOD, WARNING or BAD. headline: one sentence. wrong: what is wrong or unknown. cost: errors without fixes, m.
    steps: what to do next. trust: whether the filter's sigmas are right. remains: what is not solved. why: the evidence
    for the headline.
    """

    grade: str
    headline: str
    wrong: list[str] = field(default_factory=list)
    cost: list[str] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    trust: str = ''
    remains: list[str] = field(default_factory=list)
    why: list[str] = field(default_factory=list)

    @property
    def label(self) -> str:
        """Heading of `wrong`: most of its points only limit how good the result is."""
        return 'wrong' if self.grade == BAD else 'note'

    @property
    def noted(self) -> list[str]:
        """`wrong` without the points of the headline."""
        return [text for text in self.wrong if text not in self.headline]

    def short(self) -> list[str]:
        """The answer in a few console lines of WIDTH: headline, the most important point that is wrong, trust, and what
        to do next, which is never shortened."""
        noted = self.noted
        wrong = [shorten(f'{self.label}: {noted[0]}', _more(len(noted) - 1))] if noted else []
        trust = [shorten(f'trust: {self.trust}')] if self.trust else []
        steps = [line for s in self.first
                 for line in (typed(f'next: {s.command}') if s.command else textwrap.wrap(
                     f'next: {s.what}', WIDTH, subsequent_indent='    '))]
        head = [line.replace(_TOGETHER, ' ') for line in textwrap.wrap(_UNIT.sub(_TOGETHER, self.headline), WIDTH)]
        return [*head[:1], *([shorten(' '.join(head[1:]))] if head[1:] else []), *wrong, *trust, *steps]

    def lines(self) -> list[str]:
        """The whole answer as console lines."""
        parts = [('why', self.why), (self.label, self.wrong), ('error', self.cost),
                 ('trust', [self.trust] if self.trust else []), ('remains', self.remains)]
        said = [self.headline, *(f'{name}: {text}' for name, texts in parts for text in texts)]
        for step in self.steps:
            said += [f'next: {step.what}', *([f'    {step.command}'] if step.command else [])]
        return said

    def html(self) -> Html:
        """The answer for the top of the page, like that of the console."""
        parts = [(self.label, self.noted[:1]), ('error', self._error()),
                 ('trust', [self.trust] if self.trust else [])]
        lines = ''.join(f'<p><b>{name}:</b> {paragraph(text)[3:-4]}</p>' for name, texts in parts for text in texts)
        headline = Html(paragraph(self.headline).replace('<p>', '<p class="headline">', 1))
        return Html(f'<section id="answer" class="answer {self.grade}">\n{headline}\n{lines}{self._steps(self.first)}\n'
                    '</section>')

    def _error(self) -> list[str]:
        """The middle line of `cost`, unless the headline has its numbers."""
        return [text for text in self.cost[len(self.cost) // 2:][:1] if text.split(';')[0] not in self.headline]

    def evidence(self) -> Html:
        """The whole answer for the page, folded."""
        parts = [_part('Why', self.why), _part('What is wrong, or not known', self.wrong),
                 _part('Errors, with fixes and without', self.cost),
                 _part('Can its own uncertainty be trusted?', [self.trust] if self.trust else []),
                 _part('What remains', self.remains),
                 '<h3>What to do next</h3>' + self._steps(self.steps) if self.steps else '']
        return folded('The answer in full', *(Html(part) for part in parts if part))

    @property
    def first(self) -> list[Step]:
        """The next thing to do: the first step that is a command."""
        return [s for s in self.steps if s.command][:1] or self.steps[:1]

    def _steps(self, steps: list[Step]) -> str:
        if not steps:
            return ''
        items = [f'{paragraph(s.what)}{command(s.command) if s.command else ""}' for s in steps]
        return ''.join(items) if len(items) == 1 else '<ol>' + ''.join(f'<li>{item}</li>' for item in items) + '</ol>'

    def json(self) -> dict:
        """The answer for report.json."""
        return {'grade': self.grade, 'headline': self.headline, 'wrong': self.wrong, 'cost': self.cost,
                'trust': self.trust, 'remains': self.remains, 'why': self.why,
                'steps': [{'what': s.what, 'command': s.command} for s in self.steps]}


def shorten(text: str, ending: str = '') -> str:
    """`text` in one line of WIDTH with `ending`. A longer text is cut at the end of a clause if one ends in the second
    half of the line, otherwise between words, but never inside brackets."""
    room = WIDTH - len(ending)
    kept = textwrap.shorten(text, room, placeholder=_CUT)
    if not kept.endswith(_CUT):
        return kept + ending
    kept = kept.removesuffix(_CUT)
    clause = max(kept.rfind(mark) for mark in (': ', '; ', ', ', '. ', ' ('))
    if kept.rfind('(') > kept.rfind(')'):
        kept = kept[:kept.rfind('(')]
    elif clause > room // 2:
        kept = kept[:clause]
    return kept.rstrip(' ,;:.') + _CUT + ending


def typed(command: str) -> list[str]:
    """`command` in lines of WIDTH that can be typed or copied; it is never cut."""
    if len(command) <= WIDTH:
        return [command]
    lines = ['']
    for word in re.findall(r"(?:'[^']*'|\S)+", command):  # quoted text stays on one line
        if lines[-1] and len(lines[-1]) + 1 + len(word) > WIDTH - 2:
            lines.append('   ')
        lines[-1] += f' {word}' if lines[-1] else word
    return [*(f'{line} \\' for line in lines[:-1]), lines[-1]]


def _more(count: int) -> str:
    return f' (and {count} more)' if count else ''


def _part(title: str, texts: list[str]) -> str:
    if not texts:
        return ''
    return f'<h3>{title}</h3>' + (bullets(texts) if len(texts) > 1 else paragraph(texts[0]))


def cure(wrong: Sequence[Remark], bags: Sequence[str]) -> Step:
    """What to do if recordings are certainly wrong. bags: their paths."""
    return let_configure(bags) if any(f.settings for f in wrong) else Step(
        'Correct this where the messages come from, and record again.')


def let_configure(bags: Sequence[str]) -> Step:
    """What to do if recordings contradict parameters. bags: paths."""
    return Step('Let configure write a params file, or set by hand what is wrong:',
                f'python -m mems_ins_fusion configure --bag {shlex.join(bags)} --output configured.yaml')


def topics_of(values: dict) -> dict[str, str]:
    """The topics by the names that the checker uses. values: parameters."""
    return {name: values.get(f'{name}_topic', '') for name in _CHECKED}
