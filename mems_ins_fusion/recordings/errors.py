"""Exceptions and warnings for recordings."""
from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager

from mems_ins_fusion.errors import InputError


class RecordingError(InputError):
    """A recording that cannot be used: one line that names the file and what is wrong with it."""


class RecordingWarning(UserWarning):
    """A recording that can be used, but not all of it, or not without an assumption that is stated."""


@contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """A list that holds the texts of the RecordingWarnings of the block when the block has ended."""
    texts: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter('always', RecordingWarning)
        yield texts
    texts += [str(w.message) for w in caught if issubclass(w.category, RecordingWarning)]


@contextmanager
def needs_rosbags(what: str):
    """Context for imports of rosbags or its dependencies: raises RecordingError where `what` needs them."""
    try:
        yield
    except ImportError:
        raise RecordingError(f'{what} needs rosbags: pip install "rosbags>=0.11"') from None
