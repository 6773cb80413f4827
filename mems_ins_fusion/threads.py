"""Number of cores for a process, and of threads that it may use."""
from __future__ import annotations

import os


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count() or 1


def threads() -> int:
    """Number of threads: OMP_NUM_THREADS if it is set, as for NumPy's own threads, else the number of cores."""
    asked = os.environ.get('OMP_NUM_THREADS', '')
    return int(asked) if asked.isdigit() and int(asked) > 0 else cores()
