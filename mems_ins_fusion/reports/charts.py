"""Charts over time (or frequency) on a page, with a common time axis: zoom by dragging, values under the cursor.

Drawn by uPlot (Leon Sorokin, MIT licence: `uplot/LICENSE`), which is part of the page; nothing is downloaded.
"""
from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .html import Html, _text

#: largest number of points of a line; of longer lines the smallest and the largest value of each part are kept
POINTS = 1200
_HERE = Path(__file__).parent


@dataclass
class Line:
    """One line of a chart. y (n,): at the chart's x. dots: points without a line. dash: lengths on and off, px."""

    name: str
    colour: str
    y: np.ndarray
    width: float = 1.2
    dots: bool = False
    dash: tuple[float, ...] = ()


@dataclass
class Chart:
    """One chart: x (n,) ascending, s since the recording's start (Hz with `frequency`), and lines with one unit.

    band: names of two lines between which the chart is shaded. log: whether the y axis begins logarithmic.
    """

    title: str
    unit: str
    x: np.ndarray
    lines: list[Line]
    band: tuple[str, str] | None = None
    log: bool = False
    frequency: bool = False

    def content(self) -> dict:
        """The chart as JSON."""
        keep = self._kept()
        return {'title': self.title, 'unit': self.unit, 'log': self.log, 'frequency': self.frequency,
                'x': [float(f'{v:.6g}') if self.frequency else round(float(v), 2) for v in self.x[keep]],
                'band': [1 + [line.name for line in self.lines].index(name) for name in self.band or ()],
                'lines': [{'name': line.name, 'colour': line.colour, 'width': line.width, 'dots': line.dots,
                           'dash': line.dash, 'y': [float(f'{v:.4g}') if np.isfinite(v) else None
                                                    for v in np.asarray(line.y, dtype=float)[keep]]}
                          for line in self.lines]}

    def _kept(self) -> np.ndarray:
        """The points that are drawn: of each part those at which one of the lines is smallest or largest."""
        n = len(self.x)
        if n <= POINTS:
            return np.arange(n)
        edges = np.linspace(0, n, POINTS // (2 * len(self.lines)) + 1).astype(int)
        kept = [0, n - 1]
        for line in self.lines:
            values = np.nan_to_num(np.asarray(line.y, dtype=float))
            for first, last in zip(edges[:-1], edges[1:]):
                part = values[first:last]
                kept += [first + int(np.argmin(part)), first + int(np.argmax(part))]
        return np.unique(kept)


def charts(drawn: list[Chart], label: str) -> Html:
    """The charts with a common time axis. label: text for people who cannot see them."""
    content = json.dumps([chart.content() for chart in drawn if len(chart.x)], allow_nan=False,
                         separators=(',', ':')).replace('<', '\\u003c')
    return Html(f'<div class="charts" role="img" aria-label="{_text(label)}">\n<div class="plots"></div>\n'
                f'<script type="application/json">{content}</script>\n</div>')


def library() -> Html:
    """uPlot and the script that draws the charts; once, at the end of a page, before the script of the track."""
    style, source, ours = ((_HERE / name).read_text(encoding='utf-8') for name in
                           ('uplot/uPlot.min.css', 'uplot/uPlot.iife.min.js', 'charts.js'))
    licence = (_HERE / 'uplot' / 'LICENSE').read_text(encoding='utf-8')
    return Html(f'<style>{style}</style>\n<script>\n/* uPlot. {licence} */\n{source.replace("https://", "")}\n'
                f'{ours}</script>\n')
