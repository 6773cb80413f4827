"""The answer that stands first: on a page, on the console and in report.json, in the same words."""
from __future__ import annotations

from dataclasses import dataclass, field

from ..recordings.checker import Finding
from .html import Html, bullets, command, number, paragraph

GOOD, WARNING, BAD = 'good', 'warning', 'bad'


@dataclass(frozen=True)
class Step:
    """One thing to do next. command: what to type, if anything."""

    what: str
    command: str = ''


@dataclass
class Answer:
    """What a person wants to know of a result.

    grade: GOOD, WARNING or BAD. headline: one sentence. wrong: what is wrong. cost: in metres without fixes. steps:
    what to do next. trust: whether to believe the filter's own sigmas. remains: what is left of it all.
    """

    grade: str
    headline: str
    wrong: list[str] = field(default_factory=list)
    cost: list[str] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    trust: str = ''
    remains: list[str] = field(default_factory=list)

    def lines(self) -> list[str]:
        """For the console."""
        parts = [('wrong', self.wrong), ('cost', self.cost), ('trust', [self.trust] if self.trust else []),
                 ('remains', self.remains)]
        said = [self.headline, *(f'{name}: {text}' for name, texts in parts for text in texts)]
        for step in self.steps:
            said += [f'next: {step.what}', *([f'    {step.command}'] if step.command else [])]
        return said

    def html(self) -> Html:
        """For the page."""
        parts = [_part('What is wrong', self.wrong), _part('What it costs without fixes', self.cost),
                 _part('Can its own uncertainty be trusted?', [self.trust] if self.trust else []),
                 _part('What remains', self.remains), self._steps()]
        headline = Html(paragraph(self.headline).replace('<p>', '<p class="headline">', 1))
        return Html(f'<section id="answer" class="answer {self.grade}">\n' + '\n'.join([headline, *filter(None, parts)])
                    + '\n</section>')

    def _steps(self) -> str:
        if not self.steps:
            return ''
        items = ''.join(f'<li>{paragraph(s.what)}{command(s.command) if s.command else ""}</li>'
                        for s in self.steps)
        return f'<h3>What to do next</h3><ol>{items}</ol>'

    def json(self) -> dict:
        """For report.json."""
        return {'grade': self.grade, 'headline': self.headline, 'wrong': self.wrong, 'cost': self.cost,
                'trust': self.trust, 'remains': self.remains,
                'steps': [{'what': s.what, 'command': s.command} for s in self.steps]}


def _part(title: str, texts: list[str]) -> str:
    if not texts:
        return ''
    return f'<h3>{title}</h3>' + (bullets(texts) if len(texts) > 1 else paragraph(texts[0]))


def checked_text(finding: Finding, topics: dict[str, str]) -> str:
    """A finding of the checker with the topic it is about. topics: of `imu`, `gnss` and `temperature`."""
    names = ' and '.join(topics.get(part) or part for part in finding.topic.split('/'))
    return f'{names}: {finding.message}'


def held_text(share: float) -> str:
    """How often an ellipse held the truth, of outages of which at least `share` %."""
    return 'in all outages' if share == 100 else f'in at least {number(share, 2)} % of the outages'


def topics_of(values: dict) -> dict[str, str]:
    """The topics by what the checker calls them. values: parameters."""
    return {name: values[f'{name}_topic'] for name in ('imu', 'gnss', 'temperature')}
