"""What several tests need."""
from __future__ import annotations

import os
from pathlib import Path

import pytest

os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'  # read where messages are imported: wrong types are errors, not garbage
# NumPy's own threads wait in a loop for small matrices, which doubles the CPU: a process of tests has one core anyway
os.environ.update(dict.fromkeys(('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS'), '1'))
_SHARED = Path(__file__).resolve().parents[2] / 'shared' / 'data'


def shared_data(name: str) -> Path:
    """The folder of a measured recording (see docs); skips the test where it is not there."""
    path = _SHARED / name
    if not path.exists():
        pytest.skip(f'measured recording {name} is not in {_SHARED.parent.name}/{_SHARED.name} beside the repository')
    return path


@pytest.fixture
def peer():
    """The test's side of the topics of a node, over real ROS 2."""
    from ros_support import Peer

    peer = Peer()
    yield peer
    peer.close()


@pytest.fixture(scope='session')
def browser():
    """A headless Chromium; skips where it, or its driver, is not installed."""
    from browser_support import Browser, missing

    if missing():
        pytest.skip(f'the pages cannot be rendered: {missing()}')
    with Browser() as opened:
        yield opened
