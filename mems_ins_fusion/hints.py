"""Messages that all tools have in common: the version, and a suggestion for a name that does not exist."""
from __future__ import annotations

import difflib
from collections.abc import Iterable

from . import __version__

VERSION = f'mems_ins_fusion {__version__}'


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Suggestion that is appended to a message which refuses `name`: the only name in `known` that begins with it, else
    the most similar one; '' without any. Of names with a common part before the dot, what follows it is compared."""
    known = list(known)
    longer = [one for one in known if name and one.startswith(f'{name}_')]
    group = name[:name.rfind('.') + 1]
    within = [one.removeprefix(group) for one in known if group and one.startswith(group)]
    similar = ([f'{group}{one}' for one in difflib.get_close_matches(name.removeprefix(group), within, n=1)] if within
               else difflib.get_close_matches(name, known, n=1))
    close = longer if len(longer) == 1 else similar
    return f"; did you mean '{close[0]}'?" if close else ''
