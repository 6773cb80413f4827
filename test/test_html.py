"""The helpers of the reports: self-contained, escaped, valid markup."""
from html.parser import HTMLParser

import numpy as np
import pytest

from mems_ins_fusion.reports import html


class Outline(HTMLParser):
    """Collects text and attributes, and checks that every element is closed in turn."""

    VOID = frozenset({'meta', 'img', 'br'})

    def __init__(self, document):
        super().__init__()
        self.open, self.text, self.sources = [], [], []
        self.feed(document)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in ('src', 'href')]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_page_is_well_formed_and_refers_to_nothing_outside():
    import matplotlib
    matplotlib.use('Agg')
    from matplotlib.figure import Figure
    drawing = Figure()
    drawing.subplots().plot([1, 2])
    document = html.page('A < B', [html.section(f'Part {i}', 'text', html.figure(drawing, 'curve', image=kind))
                                   for i, kind in enumerate(('png', 'svg', 'png', 'png'))])
    outline = Outline(document)
    assert 'A < B' in outline.text
    assert all(s.startswith(('data:image/', '#part-')) for s in outline.sources)
    assert sum(s.startswith('data:') for s in outline.sources) == 4


def test_text_of_others_cannot_become_markup():
    hostile = '<script>alert("x")</script>'
    document = html.page(hostile, [html.section(hostile, hostile, html.table([hostile], [[hostile]], hostile),
                                                html.note(hostile), html.preformatted(hostile))], summary=hostile)
    assert '<script' not in document


def test_table_shows_missing_values_as_a_dash_and_refuses_ragged_rows():
    cells = html.table(['axis', 'value'], [['x', 0.000123456], ['y', None], ['z', float('nan')], ['n', np.int64(7)]])
    assert '0.0001235' in cells and cells.count('\N{EN DASH}') == 2 and '>7<' in cells
    with pytest.raises(ValueError, match='a row of 1 cells'):
        html.table(['a', 'b'], [['x']])
