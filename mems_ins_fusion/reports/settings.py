"""Parameters as a page shows them."""
from __future__ import annotations

from collections.abc import Mapping

from ..parameters import table
from ..parameters.params_file import yaml_value
from . import html

#: hashes of recordings, which say nothing to a reader of the page
_LEFT_OUT = ('fitted_to',)
#: what stands for a unit where there is none
_NO_UNIT = ('', '-', 'text')


def settings_table(values: Mapping, caption: str = '') -> html.Html:
    """The parameters `values`, by name, each with its unit."""
    known, rows = table.parameters_of(dict(values)), []
    for name in (name for name in values if name not in _LEFT_OUT):
        unit = known[name].unit if name in known else ''
        rows.append([name, yaml_value(values[name]) + (f' {unit}' if unit not in _NO_UNIT else '')])
    return html.table(['parameter', 'value'], rows, caption)
