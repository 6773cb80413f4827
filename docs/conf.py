"""The documentation as a site: `make docs`."""
import re
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from docutils.nodes import SkipNode  # noqa: E402
from latex2mathml.converter import convert  # noqa: E402

from mems_ins_fusion import __version__  # noqa: E402

project = 'mems_ins_fusion'
author = 'mems_ins_fusion developers'
release = __version__

extensions = ['myst_parser', 'sphinx.ext.autodoc']
html_math_renderer = 'mathml'
myst_enable_extensions = ['dollarmath']
myst_heading_anchors = 4
exclude_patterns = ['figures', 'site', '_build']
html_theme = 'furo'
html_title = 'mems_ins_fusion'
html_static_path = ['site']
html_css_files = ['wrap.css']
html_show_sourcelink = False
html_show_copyright = False

autodoc_member_order = 'bysource'
autodoc_typehints = 'signature'
# what needs ROS is not among the pages of the library
autodoc_mock_imports = ['rclpy']


def _plain(app, what, name, obj, options, lines):
    """Docstrings are plain English with `code` in them: what reStructuredText would take for markup is text."""
    parts = re.split(r'(`[^`]*`)', '\n'.join(lines))
    # "\\ " ends the code where a letter follows, as in `Parameter`s
    lines[:] = ''.join(f'``{" ".join(part[1:-1].split())}``\\ ' if part.startswith('`') else
                       re.sub(r'([\\*|_])', r'\\\1', part) for part in parts).split('\n')


def _inline_math(writer, node):
    writer.body.append(convert(node.astext()))
    raise SkipNode


def _displayed_math(writer, node):
    writer.body.append(f'<div class="math">{convert(node.astext(), display="block")}</div>')
    raise SkipNode


def setup(app):
    app.connect('autodoc-process-docstring', _plain)
    # MathML, which browsers draw by themselves: nothing is fetched
    app.add_html_math_renderer('mathml', (_inline_math, None), (_displayed_math, None))
