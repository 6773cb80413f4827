"""Self-contained HTML reports: one file with its figures inside, plain CSS, no script, readable on paper too.

    parts = [section('Allan deviation', paragraph('...'), figure(fig, 'Allan deviation of the gyroscopes'))]
    path.write_text(page('IMU at rest', parts, summary='record_1, 2.8 h'), encoding='utf-8')

Text is escaped; the parts of a page are `Html`, which is not.
"""
from __future__ import annotations

import base64
import html
import io
import math
import re
from numbers import Integral


class Html(str):
    """Text that is HTML already. A plain str given in its place is escaped."""


_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; color: #1c2024; background: #fff;
       max-width: 62rem; margin: 0 auto; padding: 1.5rem 1rem 4rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; padding-bottom: .2rem; border-bottom: 1px solid #d0d7de; }
p { margin: .6rem 0; max-width: 48rem; }
p.summary { color: #57606a; font-size: 1.05rem; }
nav ul { columns: 2; padding-left: 1.2rem; margin: 1rem 0; }
a { color: #0550ae; }
div.scroll { overflow-x: auto; margin: .8rem 0; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
caption { caption-side: top; text-align: left; color: #57606a; padding-bottom: .3rem; }
th, td { padding: .25rem .7rem; border-bottom: 1px solid #e4e8ec; text-align: left; vertical-align: top; }
td.number, th.number { text-align: right; white-space: nowrap; }
thead th { border-bottom: 2px solid #8c959f; vertical-align: bottom; }
figure { margin: 1rem 0; }
figure img { max-width: 100%; height: auto; }
figcaption { color: #57606a; font-size: .9rem; max-width: 48rem; }
.note, .warning, .good { padding: .5rem .8rem; border-left: .3rem solid; margin: .8rem 0; max-width: 48rem; }
.note { border-color: #54aeff; background: #f1f8ff; }
.warning { border-color: #d4a72c; background: #fff8e1; }
.good { border-color: #4ac26b; background: #effbf2; }
pre { background: #f6f8fa; padding: .7rem; overflow-x: auto; font-size: .85rem; }
@media print { body { max-width: none; } h2 { break-after: avoid; } figure, table { break-inside: avoid; } }
"""


def page(title: str, sections, summary: str = '') -> str:
    """A whole document. sections: what `section` returned; with more than three a table of contents is added."""
    parts = [Html(s) if isinstance(s, Html) else paragraph(s) for s in sections]
    head = f'<h1>{_text(title)}</h1>' + (f'<p class="summary">{_text(summary)}</p>' if summary else '')
    return (f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f'<title>{_text(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<header>{head}</header>\n'
            f'{_contents(parts)}<main>\n' + '\n'.join(parts) + '\n</main>\n</body>\n</html>\n')


def section(title: str, *parts: str) -> Html:
    """A headed section; a part that is plain text becomes a paragraph."""
    body = '\n'.join(p if isinstance(p, Html) else paragraph(p) for p in parts if p)
    return Html(f'<section id="{_anchor(title)}">\n<h2>{_text(title)}</h2>\n{body}\n</section>')


def paragraph(text: str) -> Html:
    return Html(f'<p>{_text(text)}</p>')


def note(text: str, kind: str = 'note') -> Html:
    """A set-off remark. kind: 'note', 'warning' or 'good'."""
    if kind not in ('note', 'warning', 'good'):
        raise ValueError(f"kind of a note must be 'note', 'warning' or 'good', got {kind!r}")
    return Html(f'<div class="{kind}">{_text(text)}</div>')


def preformatted(text: str) -> Html:
    """Text as it stands: a command, a file."""
    return Html(f'<pre>{_text(text)}</pre>')


def bullets(items) -> Html:
    return Html('<ul>' + ''.join(f'<li>{_text(item)}</li>' for item in items) + '</ul>')


def table(columns, rows, caption: str = '', digits: int = 4) -> Html:
    """A table; numbers right-aligned to `digits` significant digits, None and NaN as a dash.

    columns: headings, units included. rows: sequences of str, numbers or None, one per column.
    """
    rows = [list(row) for row in rows]
    wrong = next((row for row in rows if len(row) != len(columns)), None)
    if wrong is not None:
        raise ValueError(f'a row of {len(wrong)} cells in a table of {len(columns)} columns: {wrong}')
    numeric = [any(_is_number(row[i]) for row in rows) for i in range(len(columns))]
    style = [' class="number"' if n else '' for n in numeric]
    heading = ''.join(f'<th scope="col"{s}>{_text(c)}</th>' for c, s in zip(columns, style))
    body = '\n'.join('<tr>' + ''.join(f'<td{s}>{_cell(v, digits)}</td>' for v, s in zip(row, style)) + '</tr>'
                     for row in rows)
    title = f'<caption>{_text(caption)}</caption>' if caption else ''
    return Html(f'<div class="scroll"><table>{title}\n<thead><tr>{heading}</tr></thead>\n'
                f'<tbody>\n{body}\n</tbody>\n</table></div>')


def figure(drawing, caption: str = '', image: str = 'png', dpi: int = 120) -> Html:
    """A Matplotlib figure or the bytes of an image, embedded.

    image: 'png', or 'svg' for a drawing of few points. The caption is the image's text alternative too.
    """
    mime = {'png': 'image/png', 'svg': 'image/svg+xml'}[image]
    data = drawing if isinstance(drawing, bytes) else image_bytes(drawing, image, dpi)
    encoded = base64.b64encode(data).decode('ascii')
    label = f'<figcaption>{_text(caption)}</figcaption>' if caption else ''
    return Html(f'<figure><img src="data:{mime};base64,{encoded}" alt="{_text(caption)}">{label}</figure>')


def image_bytes(drawing, image: str = 'png', dpi: int = 120) -> bytes:
    """A Matplotlib figure as PNG or SVG, the same bytes for the same figure."""
    buffer = io.BytesIO()
    metadata = {'png': {'Software': None}, 'svg': {'Date': None}}[image]
    crop = None if drawing.get_layout_engine() else 'tight'  # which draws twice
    drawing.savefig(buffer, format=image, dpi=dpi, bbox_inches=crop, metadata=metadata)
    return buffer.getvalue()


def number(value, digits: int = 4) -> str:
    """`value` for a person: `digits` significant digits, powers of ten only where needed, a dash for none."""
    if value is None or not math.isfinite(value):
        return '\N{EN DASH}'
    if isinstance(value, Integral) or (float(value).is_integer() and abs(value) < 10**digits):
        return f'{int(value):d}'
    return f'{value:.{digits}g}'


def _is_number(value) -> bool:
    return hasattr(value, '__float__') and not isinstance(value, (str, bool))


def _cell(value, digits) -> str:
    if value is None:
        return '\N{EN DASH}'
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    return number(value, digits) if _is_number(value) else _text(value)


def _text(value) -> str:
    return value if isinstance(value, Html) else html.escape(str(value))


def _anchor(title: str) -> str:
    return re.sub(r'\W+', '-', title.lower()).strip('-')


def _contents(parts) -> str:
    titles = [t for p in parts for t in re.findall(r'<section id="([^"]*)">\n<h2>(.*?)</h2>', p)]
    if len(titles) <= 3:
        return ''
    return '<nav><ul>' + ''.join(f'<li><a href="#{a}">{t}</a></li>' for a, t in titles) + '</ul></nav>\n'
