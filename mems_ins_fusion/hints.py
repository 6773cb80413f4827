"""What every tool tells alike: the version, and what a name that does not exist may have meant."""
from __future__ import annotations

import difflib
from collections.abc import Iterable

from . import __version__

VERSION = f'mems_ins_fusion {__version__}'

def did_you_mean(name: str, known: Iterable[str]) -> str:
    """How the sentence that refuses `name` goes on: with the one of `known` that begins so, else with the most similar,
    or not at all."""
    known = list(known)
    longer = [one for one in known if name and one.startswith(f'{name}_')]
    close = longer if len(longer) == 1 else difflib.get_close_matches(name, known, n=1)
    return f"; did you mean '{close[0]}'?" if close else ''
