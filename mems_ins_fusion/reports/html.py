"""Self-contained HTML reports: one file with its figures inside, no network, readable on a phone and on paper.

    parts = [section('Allan deviation', paragraph('...'), figure(fig, 'Allan deviation of the gyroscopes'))]
    path.write_text(page('IMU at rest', parts, summary='record_1, 2.8 h'), encoding='utf-8')

The answer comes first (`answer.py`); evidence follows in folded sections (`folded`). Plain text is escaped; `Html` is
not. The only script is that of the interactive track (`track.py`).
"""
from __future__ import annotations

import base64
import html
import io
import math
import re
import textwrap
from numbers import Integral
from pathlib import Path


class Html(str):
    """Text that is HTML already. A plain str is escaped instead."""


#: inches, width of a figure for phones, on which letters of 10 points are as large as on paper
PHONE = 4.2
#: inches, height of a panel in it
PANEL = 1.9
#: mean width of a letter as a share of its height
LETTER = 0.55
#: points, height of the letters of a legend below all axes
_LEGEND = 8
#: points, height of the numbers at the axes of panels below each other
_SMALL = 7
_STYLE = (Path(__file__).parent / 'page.css').read_text(encoding='ascii')


def page(title: str, sections, summary: str = '', script: Html = Html('')) -> str:
    """A whole document. sections: what `section` returned; with more than three a table of contents is added.
    script: that of the interactive track, if there is one."""
    parts = [Html(s) if isinstance(s, Html) else paragraph(s) for s in sections]
    head = f'<h1>{_text(title)}</h1>' + (f'<p class="summary">{_text(summary)}</p>' if summary else '')
    return (f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f'<title>{_text(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<header>{head}</header>\n'
            f'{_contents(parts)}<main>\n' + '\n'.join(parts) + f'\n</main>\n{script}</body>\n</html>\n')


def section(title: str, *parts: str) -> Html:
    """A headed section; a part that is plain text becomes a paragraph."""
    body = '\n'.join(p if isinstance(p, Html) else paragraph(p) for p in parts if p)
    return Html(f'<section id="{_anchor(title)}">\n<h2>{_text(title)}</h2>\n{body}\n</section>')


def folded(title: str, *parts: str) -> Html:
    """A section of which only the heading is shown until it is opened; on paper all of it."""
    body = '\n'.join(p if isinstance(p, Html) else paragraph(p) for p in parts if p)
    # a link to a place inside `details` opens it
    return Html(f'<details>\n<summary><h2>{_text(title)}</h2></summary>\n<div id="{_anchor(title)}">\n{body}\n</div>\n'
                '</details>')


def paragraph(text: str) -> Html:
    return Html(f'<p>{_text(text)}</p>')


def note(text: str, kind: str = 'note') -> Html:
    """A set-off remark. kind: 'note', 'warning' or 'good'."""
    if kind not in ('note', 'warning', 'good'):
        raise ValueError(f"kind of a note must be 'note', 'warning' or 'good', got {kind!r}")
    return Html(f'<div class="{kind}">{_text(text)}</div>')


def preformatted(text: str) -> Html:
    """Text with its line breaks: a command, a file."""
    return Html(f'<pre>{_text(text)}</pre>')


def command(text: str) -> Html:
    """A command to type: lines break only between its words."""
    words = ' '.join(f'<span>{_text(word)}</span>' for word in text.split(' '))
    return Html(f'<pre class="command">{words}</pre>')


def bullets(items) -> Html:
    return Html('<ul>' + ''.join(f'<li>{_text(item)}</li>' for item in items) + '</ul>')


def table(columns, rows, caption: str = '', digits: int = 3) -> Html:
    """A table; numbers right-aligned with `digits` significant digits, None and NaN as a dash.

    columns: headings with units. rows: sequences of str, numbers or None, one per column. On a narrow page each row
    becomes a block with the heading before each cell; a table of two columns does not change.
    """
    rows = [list(row) for row in rows]
    wrong = next((row for row in rows if len(row) != len(columns)), None)
    if wrong is not None:
        raise ValueError(f'a row of {len(wrong)} cells in a table of {len(columns)} columns: {wrong}')
    numeric = [any(_is_number(row[i]) for row in rows) for i in range(len(columns))]
    style = [' class="number"' if n else '' for n in numeric]
    heading = ''.join(f'<th scope="col"{s}>{_text(c)}</th>' for c, s in zip(columns, style))
    label = [f' data-label="{_text(c)}"' for c in columns]
    body = '\n'.join('<tr>' + ''.join(f'<td{s}{h}>{_cell(v, digits)}</td>' for v, s, h in zip(row, style, label))
                     + '</tr>' for row in rows)
    title = f'<caption>{_text(caption)}</caption>' if caption else ''
    pairs = ' class="pairs"' if len(columns) == 2 else ''
    return Html(f'<table{pairs}>{title}\n<thead><tr>{heading}</tr></thead>\n<tbody>\n{body}\n</tbody></table>')


def empty_figure(width: float, height: float):
    """A Matplotlib figure without a window; size in inches. Matplotlib is imported only if a figure is drawn."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout='constrained')


def figure(drawing, caption: str = '', narrow: bytes = b'') -> Html:
    """A Matplotlib figure, or the bytes of a PNG, embedded.

    narrow: the PNG for phones (`narrow_bytes`), if `drawing` is bytes. The caption is also the text alternative.
    """
    data = drawing if isinstance(drawing, bytes) else image_bytes(drawing)
    label = f'<figcaption>{_text(caption)}</figcaption>' if caption else ''
    small = narrow if narrow or isinstance(drawing, bytes) else narrow_bytes(drawing)
    image = f'<img src="{_png_url(data)}" alt="{_text(caption)}">'
    # two images, not two sources of a picture: a phone would also print the source that it has chosen by its width
    phone = f'<img class="narrow" src="{_png_url(small)}" alt="{_text(caption)}">' if small else ''
    return Html(f'<figure>{image}{phone}{label}</figure>')


def _png_url(data: bytes) -> str:
    return f'data:image/png;base64,{base64.b64encode(data).decode("ascii")}'


def image_bytes(drawing, dpi: int = 120) -> bytes:
    """A Matplotlib figure as PNG; the bytes depend only on the figure."""
    buffer = io.BytesIO()
    drawing.savefig(buffer, format='png', dpi=dpi, metadata={'Software': None})
    return buffer.getvalue()


def narrow_bytes(drawing) -> bytes:
    """A Matplotlib figure as PNG for phones, with letters of the usual size: three or more panels in a row are put
    below each other, legends of panels below all panels, in fewer columns, and labels are broken into lines. This
    changes the figure, so it has to be the last output of it."""
    width, height = drawing.get_size_inches()
    rows = _stacked(drawing)
    below = bool(drawing.legends or len(drawing.axes) > 1 and _with_legend(drawing))
    beside = 0.2 * len(_legend_of(drawing)[1]) if below else 0.0
    drawing.set_size_inches(PHONE, PANEL * rows + beside if rows else min(max(1.4 * PHONE * height / width, 3.0), 7.0))
    labels = [(text, 0.9 * PHONE) for text in drawing.texts]  # and the width for each, inches
    for axes in drawing.axes:
        place = axes.get_position()
        wide, high = place.width * PHONE, place.height * drawing.get_figheight()
        if rows:
            wide, high = (0.7 if rows == len(drawing.axes) else 0.35) * PHONE, 0.7 * PANEL
        labels += [(axes.title, wide), (axes.xaxis.label, wide), (axes.yaxis.label, high)]
    for label, room in labels:
        letters = int(72.0 * room / (LETTER * label.get_fontsize()))
        label.set_text(textwrap.fill(label.get_text(), max(letters, 8)))
    if below:
        legend_below(drawing)
    return image_bytes(drawing, dpi=110)


def _stacked(drawing) -> int:
    """Put three or more panels in a row into two columns, or one if their widths differ. Returns the number of rows, 0
    if nothing was changed."""
    from matplotlib.gridspec import GridSpec

    grid = drawing.axes[0].get_subplotspec().get_gridspec()
    if grid.ncols < 3:
        return 0
    columns = 2 if len(set(grid.get_width_ratios())) == 1 else 1
    rows = -(-len(drawing.axes) // columns)
    stack = GridSpec(rows, columns, figure=drawing)
    for place, axes in enumerate(drawing.axes):
        axes.set_subplotspec(stack[divmod(place, columns)])
        axes.tick_params(labelbottom=True, labelsize=_SMALL)
        axes.title.set(x=1.0, ha='right')  # a power of ten may be at the left
    return rows


def legend_below(drawing) -> None:
    """A legend of the figure below all axes, in as many columns as fit its width. It has the entries of the panels'
    legends, which are removed, or of the first panels without one. (matplotlib 3.7 has `loc='outside lower center'` for
    this.)"""
    handles, labels = _legend_of(drawing)
    for legend in [*drawing.legends, *(axes.get_legend() for axes in _with_legend(drawing))]:
        legend.remove()
    widest = 0.5 + LETTER * _LEGEND / 72.0 * max(map(len, labels))  # inches, including the line
    columns = max(min(int(drawing.get_figwidth() / widest), 4), 1)
    bottom = (0.15 + 0.18 * -(-len(labels) // columns)) / drawing.get_figheight()
    drawing.get_layout_engine().set(rect=(0.0, bottom, 1.0, 1.0 - bottom))
    drawing.legend(handles, labels, loc='lower center', ncols=columns, fontsize=_LEGEND)


def _with_legend(drawing) -> list:
    return [axes for axes in drawing.axes if axes.get_legend()]


def _legend_of(drawing) -> tuple[list, list[str]]:
    """Lines and names for the legend below all axes."""
    shown = [axes.get_legend_handles_labels() for axes in _with_legend(drawing) or drawing.axes[:1]]
    return [line for lines, _ in shown for line in lines], [name for _, names in shown for name in names]


def number(value, digits: int = 4) -> str:
    """`value` with `digits` significant digits, as 1380 and not 1.38e+03; a dash for None.

    Powers of ten only from 10 million on and below a ten-thousandth.
    """
    if value is None or not math.isfinite(value):
        return '\N{EN DASH}'
    if isinstance(value, Integral) or (float(value).is_integer() and abs(value) < 10**digits):
        return f'{int(value):d}'
    rounded = float(f'{value:.{digits - 1}e}')
    if 1e-4 <= abs(rounded) < 1e7:
        return f'{rounded:.{max(digits - 1 - math.floor(math.log10(abs(rounded))), 0)}f}'
    mantissa, power = f'{rounded:.{digits - 1}e}'.split('e')
    return f'{mantissa}e{int(power)}'


def _is_number(value) -> bool:
    return hasattr(value, '__float__') and not isinstance(value, (str, bool))


def _cell(value, digits) -> str:
    if value is None:
        return '\N{EN DASH}'
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    if _is_number(value):
        return number(value, digits)
    return _text(value).replace('_', '_<wbr>')  # a long name may be broken there


def _text(value) -> str:
    return value if isinstance(value, Html) else html.escape(str(value))


def _anchor(title: str) -> str:
    return re.sub(r'\W+', '-', title.lower()).strip('-')


def _contents(parts) -> str:
    titles = [t for p in parts for t in re.findall(r'<section id="([^"]*)">\n<h2>(.*?)</h2>', p)
              or [m[::-1] for m in re.findall(r'<h2>(.*?)</h2></summary>\n<div id="([^"]*)">', p)]]
    if len(titles) <= 3:
        return ''
    return '<nav><ul>' + ''.join(f'<li><a href="#{a}">{t}</a></li>' for a, t in titles) + '</ul></nav>\n'
