"""`njit` of numba, compiled once and cached for as long as no source of compiled code changes.

numba by itself looks only at the file a function stands in: after a change to a function that it calls from another
file, it would go on with the old one. Here the cache's folder is named after the contents of all of them.
"""
from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numba

#: packages with compiled functions
_SOURCES = ('navigation', 'filter', 'sensor_errors', 'characterization', 'effects')


def _cache_folder() -> str:
    package = Path(__file__).parent
    digest = hashlib.blake2b(numba.__version__.encode(), digest_size=8)
    for folder in _SOURCES:
        for source in sorted((package / folder).glob('*.py')):
            digest.update(source.read_bytes())
    base = numba.config.CACHE_DIR or os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache'
    return str(Path(base) / 'mems_ins_fusion' / digest.hexdigest())


_FOLDER = _cache_folder()


def njit(function=None, **options):
    """As `numba.njit(cache=True, **options)`, bare or with options."""
    if function is None:
        return lambda function: njit(function, **options)
    others = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _FOLDER
    try:
        return numba.njit(cache=True, **options)(function)
    finally:
        numba.config.CACHE_DIR = others


def is_cold() -> bool:
    """Whether nothing has been compiled yet from these sources."""
    return not any(Path(_FOLDER).glob('filter*'))
