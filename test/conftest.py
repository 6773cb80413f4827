"""What several tests need."""
from __future__ import annotations

import os
import signal
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


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """With `--dist loadfile`: as there, but a test that ends its process fails once, and the rest of its file goes on.

    pytest-xdist 3.8 runs such a test again in each new process, and at times waits for ever for one that has ended.
    """
    from xdist.scheduler import LoadFileScheduling

    class Files(LoadFileScheduling):
        def remove_node(self, node):
            files = self.assigned_work.pop(node)
            for tests in files.values():
                for test, is_done in tests.items():
                    if not is_done:
                        tests[test] = True
                        self.workqueue.update((name, t) for name, t in files.items() if not all(t.values()))
                        return test
            return None

        def _reschedule(self, node):
            if node in self.registered_collections:  # else it is a new one, and is given work when it knows the tests
                super()._reschedule(node)

    return Files(config, log) if config.getoption('dist') == 'loadfile' else None


@pytest.fixture(autouse=True)
def signals_as_before():
    """A node or a tool in the process of the tests asks for signals as if it were its own; its children would, too."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in handlers.items():
        if handler is not None and handler is not signal.getsignal(number):
            signal.signal(number, handler)


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
