"""Loads the filter's compiled functions before the first message; if they or those of the diagnosis while driving are
not compiled, compiles in a child process.

A signal that interrupts the compiler in this process may be lost, end in a traceback or crash the process. A child
process can be stopped at any time, and its compiled functions are in the cache.
"""
from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np

from ..compiled import FOLDER
from ..filter.config import FilterConfig
from ..filter.runs.imus import Imus
from ..filter.runs.live import FusionFilter
from ..filter.runs.odometry import ORIENTATION, POSE_COVARIANCE
from ..navigation.earth import to_local
from ..parameters import table
from .output import Prediction, SmoothFrame
from .run import Stop

#: file in the cache's folder which shows that everything has been compiled
_MARK = 'fusion_node.compiled'


def load(fusion: FusionFilter, stop: Stop, imus: Imus | None = None) -> None:
    """Load the compiled functions for `fusion`, several `imus` and the node's outputs. Raises KeyboardInterrupt when
    `stop` is requested in this time."""
    mark = FOLDER / _MARK
    kept = _is_writable(mark.parent)
    if kept and not mark.exists():
        _compile_in_child(stop)
    _warm_up(fusion)
    if imus is not None:
        imus.warm_up()
    if kept:
        mark.touch()


def _is_writable(folder):
    """Whether the folder is writable, so that functions compiled by a child process are found in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return False
    return os.access(folder, os.W_OK)


def _compile_in_child(stop):
    child = subprocess.Popen([sys.executable, '-m', __name__], start_new_session=True)
    try:
        while child.poll() is None:
            if stop.requested:
                raise KeyboardInterrupt
            time.sleep(0.05)
    finally:
        child.kill()
        child.wait()


def _warm_up(fusion):
    fusion.warm_up()
    estimate = FusionFilter(fusion.config)
    estimate.odometry[ORIENTATION:POSE_COVARIANCE] = 0.0, 0.0, 0.0, 1.0
    smooth = SmoothFrame(estimate)
    smooth.advance(0)
    smooth.advance(10_000_000)
    Prediction(estimate).advance(0.01)
    to_local(*np.zeros((3, 1)), np.zeros(3))  # of several fixes: the looks at the mounting and at other inputs


def _compile():
    """Compile what a node with the usual parameters needs, and the diagnosis while driving: its process has a small
    share of a core, so that compiling there would delay the first findings."""
    from ..diagnosis.online import warm_up
    from ..simulation.simulation import simulate_drive, simulate_recording

    _warm_up(FusionFilter(FilterConfig.from_parameters(table.defaults())))
    warm_up(simulate_recording(simulate_drive(60.0, seed=1, rate=20.0)).recording)


if __name__ == '__main__':
    _compile()
