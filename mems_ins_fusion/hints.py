"""What every tool tells alike: the version, and what a name that does not exist may have meant."""
from __future__ import annotations

import difflib
from collections.abc import Iterable

from . import __version__

VERSION = f'mems_ins_fusion {__version__}'

def did_you_mean(name: str, known: Iterable[str]) -> str:
    """How the sentence that refuses `name` goes on: with the most similar of `known`, or not at all."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean '{close[0]}'?" if close else ''
