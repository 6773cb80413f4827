"""How many cores there are for a process, and how many threads it may keep busy."""
from __future__ import annotations

import os


def cores() -> int:
    """The cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count() or 1


def threads() -> int:
    """What OMP_NUM_THREADS says, as for NumPy's own threads; else as many as there are cores."""
    asked = os.environ.get('OMP_NUM_THREADS', '')
    return int(asked) if asked.isdigit() and int(asked) > 0 else cores()
