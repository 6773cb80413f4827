"""Functions for workers of the tests, whose processes import this file: it needs nothing that takes its time."""
from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def double(value):
    return 2 * value


def refuse(value):
    raise ValueError(f'{value} is refused')


def die(value):
    """Ends the process for the item 'die'."""
    if value == 'die':
        os.kill(os.getpid(), signal.SIGKILL)
    return value


def die_once(path):
    """Ends the process as long as there is no file `path`."""
    if not Path(path).exists():
        Path(path).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 'done'


def wait_for_long(path):
    """Tells the number of its process in the file `path` and goes on for minutes."""
    Path(path).write_text(str(os.getpid()))
    time.sleep(300)


def core_count(_):
    from mems_ins_fusion.threads import threads

    return threads()
