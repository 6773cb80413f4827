"""The helpers of the reports: self-contained, escaped, valid markup."""
from html.parser import HTMLParser

import numpy as np
import pytest
from browser_support import check_page

from mems_ins_fusion.reports import html
from mems_ins_fusion.reports.settings import settings_table


class Outline(HTMLParser):
    """Collects text and attributes, and checks that every element is closed in turn."""

    VOID = frozenset({'meta', 'img', 'br', 'wbr', 'source'})

    def __init__(self, document):
        super().__init__()
        self.open, self.text, self.sources = [], [], []
        self.feed(document)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.sources += [value for name, value in attrs if name in ('src', 'srcset', 'href')]
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def test_page_is_well_formed_and_refers_to_nothing_outside():
    drawing = html.empty_figure(6, 4)
    drawing.subplots().plot([1, 2])
    document = html.page('A < B', [html.section(f'Part {i}', 'text', html.figure(drawing, 'curve')) for i in range(4)])
    outline = Outline(document)
    assert 'A < B' in outline.text
    assert all(s.startswith(('data:image/', '#part-')) for s in outline.sources)
    assert sum(s.startswith('data:') for s in outline.sources) == 2 * 4  # each also for a phone


def test_text_of_others_cannot_become_markup():
    hostile = '<script>alert("x")</script>'
    document = html.page(hostile, [html.section(hostile, hostile, html.table([hostile], [[hostile]], hostile),
                                                html.note(hostile), html.preformatted(hostile))], summary=hostile)
    assert '<script' not in document


def test_table_shows_missing_values_as_a_dash_and_refuses_ragged_rows():
    cells = html.table(['axis', 'value'], [['x', 0.000123456], ['y', None], ['z', float('nan')], ['n', np.int64(7)]])
    assert '0.000123<' in cells and cells.count('\N{EN DASH}') == 2 and '>7<' in cells
    with pytest.raises(ValueError, match='a row of 1 cells'):
        html.table(['a', 'b'], [['x']])


@pytest.mark.parametrize('value, digits, text', [
    (1380.2, 3, '1380'), (99.96, 3, '100'), (0.0371, 3, '0.0371'), (5.704, 3, '5.70'), (12345.6, 4, '12350'),
    (0.00012345, 3, '0.000123'), (0.0000203, 3, '2.03e-5'), (0.99996, 4, '1.000'), (-1380.2, 3, '-1380'), (2, 3, '2'),
    (3.0, 3, '3'), (1.5e8, 3, '1.50e8'), (0.0, 3, '0'), (float('nan'), 3, '\N{EN DASH}'), (None, 3, '\N{EN DASH}')])
def test_numbers_are_as_people_write_them(value, digits, text):
    assert html.number(value, digits) == text


def test_parameters_stand_in_rows_of_two_with_their_units():
    # given numbers, texts, and hashes that are for tools
    shown = settings_table({'gnss.time_offset': -0.2, 'imu.mounting_rpy': [0.0, 0.1, 0.2], 'imu_topic': '/imu/data',
                            'fitted_to': ['h00']})
    # then each number has its unit, and on a phone name and value stay side by side
    said = [text.strip() for text in Outline(shown).text]
    assert '-0.2 s' in said and '[0.0, 0.1, 0.2] rad' in said and "'/imu/data'" in said
    assert 'fitted_to' not in shown and '<table class="pairs">' in shown
    assert 'pairs' not in html.table(['a', 'b', 'c'], [[1, 2, 3]])
    # and what a value stands on is beside it
    said = Outline(settings_table({'gnss.sigma': 0.0}, evidence={'gnss.sigma': 'the stated sigma is used'})).text
    assert {'0.0 m', 'evidence', 'the stated sigma is used'} <= {text.strip() for text in said}


def test_a_folded_section_is_in_the_contents():
    parts = [html.section('A'), html.folded('B & C', 'evidence'), html.section('D'), html.folded('E', 'more')]
    document = html.page('T', parts)
    Outline(document)
    assert '<a href="#b-c">B &amp; C</a>' in document and '<div id="b-c">' in document


@pytest.mark.parametrize('columns, widths', [(2, None), (3, None), (3, (2.4, 1.2, 1.0))])
def test_on_a_phone_no_label_and_no_legend_of_a_figure_is_cut_off(monkeypatch, columns, widths):
    # given panels in a row with long labels, and a legend below them with more names than fit into a line of a phone
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    figure = Figure(figsize=(9, 4), layout='constrained')
    FigureCanvasAgg(figure)
    panels = figure.subplots(1, columns, width_ratios=widths)
    for number in range(5):
        panels[0].plot([number, number + 1], label=f'model {number}, with a fix each second')
    for axes in panels:
        axes.set(xlabel='speed times turn rate to the left, m/s^2', title='in turns and on straight roads')
    figure.suptitle('as configured: NIS 3.79 (1.65 to 2.39 expected), Ljung-Box p < 0.001')
    html.legend_below(figure)
    seen = []

    def drawn(drawing, **options):
        drawing.canvas.draw()
        seen.extend(part.get_window_extent() for part in (
            *drawing.legends, *drawing.texts, *(axes.xaxis.label for axes in drawing.axes),
            *(axes.title for axes in drawing.axes)))
        return b''
    # when it is drawn for a phone
    monkeypatch.setattr(html, 'image_bytes', drawn)
    html.narrow_bytes(figure)
    # then all of it is inside, and nothing lies on anything else
    whole = figure.bbox
    assert figure.get_figwidth() == html.PHONE and len(seen) == 2 + 2 * columns
    assert all(box.x0 >= whole.x0 and box.x1 <= whole.x1 and box.y0 >= whole.y0 and box.y1 <= whole.y1 for box in seen)
    assert not any(one.overlaps(other) for i, one in enumerate(seen) for other in seen[:i])


@pytest.mark.parametrize(['columns', 'below'], [(3, True), (2, True), (1, False)])
def test_on_a_phone_no_legend_covers_the_lines_of_a_small_panel(columns, below):
    # given panels beside each other, the first of which has the legend of all
    figure = html.empty_figure(11, 4)
    panels = figure.subplots(1, columns, squeeze=False)[0]
    for axes in panels:
        axes.plot([0, 1], [0, 1], label='random walk')
        axes.plot([0, 1], [1, 0], label='Gauss-Markov')
    panels[0].legend()
    # when they are drawn for a phone
    html.narrow_bytes(figure)
    # then it stands below all, and stays where a single panel has room for it
    assert (panels[0].get_legend() is None) == below == bool(figure.legends)
    for legend in figure.legends:
        assert [text.get_text() for text in legend.get_texts()] == ['random walk', 'Gauss-Markov']


def test_a_phone_shows_figures_for_phones_and_paper_does_not(browser, tmp_path):
    figure = html.empty_figure(11, 4)
    for axes in figure.subplots(1, 3):
        axes.plot([0, 1], [0, 1])
    page = tmp_path / 'page.html'
    page.write_text(html.page('Title', [html.section('Part', html.figure(figure, 'three panels'))]))
    assert page.read_text().count('<img') == 2
    check_page(browser, page)
    browser.open(page, 400)
    shown = browser.run("return [...document.images].filter(e => e.offsetParent !== null).map(e => e.className)")
    assert shown == ['narrow']
