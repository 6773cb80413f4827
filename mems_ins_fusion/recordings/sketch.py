"""Hashes of the content of a recording, by which the recordings that parameters were fitted to are recognized.

The smallest hashes of a set are a sample of it that does not depend on order, file or topics, so that a part of a
recording is recognized as well (A. Broder, "On the resemblance and containment of documents", 1997).
"""
from __future__ import annotations

import hashlib
from collections.abc import Iterable

import numpy as np

from ..samples import Fixes, Recording

#: number of hashes kept of a recording
KEPT = 8
#: two fixes are equal if their stamps, in ms, and their positions, in 1e-7 deg (a centimetre), are equal
_PER_MS, _PER_DEGREE = 10**6, 1e7


def sketch(recordings: Iterable[Fixes | None]) -> list[str]:
    """For the parameter `fitted_to`: the KEPT smallest hashes of the fixes of each recording."""
    return sorted({h for fixes in recordings for h in sorted(_hashes(fixes))[:KEPT]})


def fitted_to(recording: Recording, known: Iterable[str]) -> bool:
    """Whether parameters whose `fitted_to` is `known` were fitted to a part of `recording`."""
    known = set(known)
    return bool(known) and not known.isdisjoint(_hashes(recording.gnss))


def _hashes(fixes: Fixes | None) -> set[str]:
    if fixes is None or not len(fixes):
        return set()
    degrees = np.degrees(np.column_stack([fixes.latitude, fixes.longitude]))
    used = np.isfinite(degrees).all(axis=1)
    rows = np.column_stack([fixes.stamp[used] // _PER_MS, np.rint(degrees[used] * _PER_DEGREE).astype(np.int64)])
    # the letter keeps YAML from reading a number
    return {'h' + hashlib.blake2b(row.tobytes(), digest_size=5).hexdigest() for row in rows}
