"""Parameters as a page shows them."""
from __future__ import annotations

from collections.abc import Mapping

from ..parameters import table
from ..parameters.params_file import yaml_value
from . import html

#: hashes of recordings, which say nothing to a reader of the page
_LEFT_OUT = ('fitted_to',)


def settings_table(values: Mapping, caption: str = '') -> html.Html:
    """The parameters `values`, by name, each with its unit."""
    known, rows = table.parameters_of(dict(values)), []
    for name in (name for name in values if name not in _LEFT_OUT):
        unit = known[name].shown_unit if name in known else ''
        rows.append([name, f'{yaml_value(values[name])} {unit}'.rstrip()])
    return html.table(['parameter', 'value'], rows, caption)
