"""Parameters on a page."""
from __future__ import annotations

from collections.abc import Mapping

from ..parameters import table
from ..parameters.params_file import yaml_value
from . import html

#: parameter that is not shown: hashes of recordings
_LEFT_OUT = ('fitted_to',)


def settings_table(values: Mapping, caption: str = '', evidence: Mapping[str, str] | None = None) -> html.Html:
    """The parameters `values` by name, each with its unit, and with its `evidence` if there is any."""
    known, rows = table.parameters_of(dict(values)), []
    for name in (name for name in values if name not in _LEFT_OUT):
        unit = known[name].shown_unit if name in known else ''
        rows.append([name, f'{yaml_value(values[name])} {unit}'.rstrip(), *([evidence[name]] if evidence else [])])
    return html.table(['parameter', 'value', *(['evidence'] if evidence else [])], rows, caption)
