"""The interactive track of a page: layers of positions with values under the cursor, drawn by `track.js`.

It is to scale, with the error against time below it (a chart of `charts.py`), and needs no network: a base map is
downloaded only on request. Without scripts, and on paper, a static figure is shown instead.
"""
from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..navigation.earth import radii
from ..results import json_text
from .charts import library
from .html import Html, _text

#: largest number of points of a layer
POINTS = 2500
_HINT = ('Drag to move, wheel or two fingers to zoom, point at a line to read time, speed, error and sigma there. '
         'Click a name to hide or show it. Below, the error against time, dotted twice the sigma of the first line: '
         'drag to zoom, double click for all.')


@dataclass
class Layer:
    """One line or set of points on the map.

    time (n,): s since the recording's start. east, north (n,): m. values: under the cursor, by name (`speed` m/s,
    `error` m, `sigma` m: the filter's horizontal standard deviation), (n,) each; a layer with `error` is also drawn
    against time. first: index of the first point of each piece, for a layer of several pieces. ends (p, 4): east and
    north of the estimate and of the truth at the end of each piece. points: radius in pixels for a layer without a
    line.
    """

    name: str
    colour: str
    time: np.ndarray
    east: np.ndarray
    north: np.ndarray
    values: dict[str, np.ndarray]
    width: float = 2.0
    shown: bool = True
    first: np.ndarray | None = None
    ends: np.ndarray | None = None
    points: float = 0.0
    hollow: bool = False
    dash: tuple[float, ...] = ()

    def content(self) -> dict:
        """The layer as JSON, with at most about POINTS points."""
        keep = self._kept()
        content = {'name': self.name, 'colour': self.colour, 'shown': self.shown, 'width': self.width,
                   't': _rounded(self.time[keep], 2), 'x': _rounded(self.east[keep], 2),
                   'y': _rounded(self.north[keep], 2)}
        content |= {name: _rounded(values[keep], 3 if name == 'error' else 2) for name, values in self.values.items()}
        if self.first is not None:
            content['first'] = np.searchsorted(keep, self.first).tolist()
        if self.ends is not None:
            content['ends'] = [_rounded(end, 2) for end in self.ends]
        return content | {name: value for name, value in (('points', self.points), ('hollow', self.hollow),
                                                          ('dash', self.dash)) if value}

    def _kept(self) -> np.ndarray:
        every = -(-len(self.time) // POINTS)
        keep = np.zeros(len(self.time), dtype=bool)
        keep[::max(every, 1)] = True
        if self.first is not None:  # both ends of each piece
            keep[self.first] = True
            keep[self.first[1:] - 1] = True
        keep[-1:] = True
        return np.flatnonzero(keep)


def _rounded(values, digits: int) -> list:
    return [float(v) if np.isfinite(v) else None for v in np.round(np.asarray(values, dtype=float), digits)]


def track(layers: list[Layer], still: Html, datum: np.ndarray | None = None) -> Html:
    """The interactive track. still: figure without scripts, and on paper. datum: latitude and longitude of the origin
    (rad) and its height (m); without it, no base map is offered."""
    content = json_text({'layers': [layer.content() for layer in layers if len(layer.time)],
                         'place': None if datum is None else _place(*datum)},
                        separators=(',', ':')).replace('<', '\\u003c')
    return Html(f'<div class="track">\n<div class="still">{still}</div>\n<div class="live">\n'
                '<div class="layers"></div>\n<div class="ground"><canvas class="map" tabindex="0" role="img" '
                'aria-label="Track from above"></canvas>\n'
                '<div class="said" aria-live="polite" hidden></div></div>\n'
                '<div class="time" role="img" aria-label="Error against time"></div>\n<div class="tools">'
                '<label>colour <select><option value="">by line</option><option value="error">by error</option>'
                '<option value="speed">by speed</option><option value="sigma">by sigma</option></select></label>'
                '<span class="scale"></span><span class="from"></span>'
                '<button type="button" data-zoom="in">+</button>'
                '<button type="button" data-zoom="out">\N{MINUS SIGN}</button>'
                '<button type="button" data-zoom="all">whole track</button>'
                '<button type="button" data-zoom="log">error: logarithmic</button>'
                '<button type="button" data-zoom="map">base map ...</button></div>\n'
                f'<p class="hint">{_text(_HINT)}</p>\n</div>\n'
                f'<script type="application/json">{content}</script>\n</div>')


def _place(latitude: float, longitude: float, height: float) -> list[float]:
    """Latitude and longitude (rad), and metres north and east per radian of each."""
    meridian, prime = radii(latitude)
    return [float(v) for v in (latitude, longitude, meridian + height, (prime + height) * np.cos(latitude))]


def script() -> Html:
    """The script that draws the tracks and the charts; once, at the end of a page."""
    source = (Path(__file__).parent / 'track.js').read_text(encoding='utf-8')
    return Html(f'{library()}<script>\n{source}</script>')
