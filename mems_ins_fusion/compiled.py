"""`njit` of numba with a cache that is renewed when any source of compiled code changes.

numba itself compares only the file of a function: after a change to a function that it calls in another file, it would
use the old code. Here the folder of the compiled code is named by a digest of all these files. If the folder cannot be
read or written, the code is compiled at each start.

While numba compiles, the user gets a message, and signals are delayed until the end of a compiler pass: an exception
within a pass could be lost, or end in a traceback.

For versions of numba whose internals are known, compiled_parts.py halves the time of compilation.
"""
from __future__ import annotations

import fcntl
import gc
import hashlib
import os
import signal
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numba
import numpy as np
from numba.core import event
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

from .guard import one_line

#: oldest and newest version of numba with which `compiled_parts` was tested; it is not used with other versions
_TRIED = (0, 59), (0, 68)
_IS_TRIED = _TRIED[0] <= tuple(numba.version_info[:2]) <= _TRIED[1]
# numba imports `scipy.linalg` for matrix products in some array functions, which are not used here. The import would
# take a quarter of the time until the filter is ready
_unwanted = 'scipy.linalg.cython_blas'
if _IS_TRIED and _unwanted not in sys.modules:
    sys.modules[_unwanted] = None
    import numba.np.arraymath  # noqa: E402, F401
    del sys.modules[_unwanted]
if _IS_TRIED:
    from .compiled_parts import compile_in_parts

#: thresholds of the garbage collector while numba compiles: it makes many objects that stay, which the collector would
#: examine again and again
_GARBAGE_THRESHOLDS = 100_000, 20, 20
#: packages with compiled functions, or with code that these use
_PACKAGES = ('navigation', 'filter', 'sensor_errors', 'characterization', 'effects')


def sources() -> list[Path]:
    """The files whose contents determine whether compiled code is valid."""
    package = Path(__file__).parent
    return [package / 'compiled_parts.py', package / 'compiled_lanes.py',
            *(source for folder in _PACKAGES for source in sorted((package / folder).rglob('*.py')))]


def _folder() -> Path:
    digest = hashlib.blake2b(f'{numba.__version__} {np.__version__}'.encode(), digest_size=8)
    for source in sources():
        digest.update(source.read_bytes())
    try:
        home = Path.home()
    except RuntimeError:  # a user without one
        home = Path('/')
    base = numba.config.CACHE_DIR or os.environ.get('XDG_CACHE_HOME') or home / '.cache'
    return Path(base) / 'mems_ins_fusion' / digest.hexdigest()


FOLDER = _folder()


def njit(function=None, **options):
    """As `numba.njit(cache=True, **options)`, bare or with options."""
    if function is None:
        return lambda function: njit(function, **options)
    if numba.config.DISABLE_JIT:
        return function
    compiled = compile_in_parts(function, options) if _IS_TRIED else numba.njit(**options)(function)
    compiled._cache = _Cache(function)
    return compiled


def tell(say) -> None:
    """Use `say(text)` for messages about compilation; without it they go to stderr."""
    _compilation.say = say


class _Locator(_CacheLocator):
    """Location of the compiled functions of one module, independent of where the package is installed."""

    def __init__(self, function, file):
        self._folder = FOLDER / function.__module__
        self._line = function.__code__.co_firstlineno
        self._py_file = file

    @classmethod
    def from_function(cls, function, file):
        return cls(function, file)

    def get_cache_path(self):
        return str(self._folder)

    def get_source_stamp(self):
        return None  # the name of the folder contains the digest

    def get_disambiguator(self):
        return str(self._line)

    def ensure_cache_path(self):
        self._folder.mkdir(parents=True, exist_ok=True)


class _Files(CompileResultCacheImpl):
    _locator_classes = (_Locator,)


class _Cache(FunctionCache):
    """numba's cache of one function. Errors only cost time, and several processes may write it at once."""

    _impl_class = _Files

    def load_overload(self, sig, target_context):
        try:
            found = super().load_overload(sig, target_context)
        except Exception as error:  # unpickling damaged files raises nearly anything
            _compilation.say_once(f'the compiled code in {FOLDER} cannot be used ({_reason(error)})')
            self._forget()
            return None
        # it has another signature if a process ended between writing numba's two files
        return found if found is not None and tuple(found.signature.args) == tuple(sig) else None

    def _forget(self):
        try:
            self.flush()
        except OSError:
            pass

    def save_overload(self, sig, data):
        with _compilation.signals:
            try:
                with _locked(FOLDER):
                    super().save_overload(sig, data)
                    _compilation.keep_seconds()
            except Exception as error:
                _compilation.say_once(f'compiled code cannot be kept in {FOLDER} ({_reason(error)}): each start '
                                      'compiles it again; NUMBA_CACHE_DIR may name another folder')


def _reason(error: Exception) -> str:
    return getattr(error, 'strerror', None) or one_line(error)


@contextmanager
def _locked(folder: Path):
    """Lock for one process: numba reads its index, takes the next free number in it and writes two files."""
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / 'lock', 'w') as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


class _WaitingSignals:
    """Delays SIGINT and SIGTERM while the block, which is reentrant, runs, or until `deliver`."""

    def __init__(self):
        self._depth = 0
        self._handlers = {}
        self._came = []

    def __enter__(self):
        self._depth += 1
        # signals are handled only in the main thread
        if self._depth == 1 and threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                if signal.getsignal(number) is not None:  # None: somebody's who is not Python
                    self._handlers[number] = signal.signal(number, lambda number, frame: self._came.append(number))

    def __exit__(self, *exception):
        self._depth -= 1
        if self._depth == 0:
            self._restore()

    def deliver(self) -> None:
        """Deliver the delayed signals to the original handlers now."""
        if self._came:
            self._restore()

    def _restore(self):
        handlers, self._handlers = self._handlers, {}
        came, self._came = self._came, []
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in came:
            signal.raise_signal(number)


class _Compilation(event.Listener):
    """Listener of numba's compiler in this process: messages to the user, time of compilation, delay of signals."""

    def __init__(self):
        self.say = lambda text: print(f'mems_ins_fusion: {text}', file=sys.stderr, flush=True)
        self.signals = _WaitingSignals()
        self._said: set[str] = set()
        self._depth = 0
        self._began = self._seconds = 0.0
        self._thresholds = gc.get_threshold()
        event.register('numba:compile', self)
        event.register('numba:run_pass', self)

    def on_start(self, event):
        if event.kind == 'numba:compile':
            self._depth += 1
            self.signals.__enter__()
            if self._depth == 1:
                self._thresholds = gc.get_threshold()
                gc.set_threshold(*_GARBAGE_THRESHOLDS)
                self._began = time.monotonic()
                if not self._seconds:
                    last = _last_seconds()
                    took = 'about a minute' if last is None else f'{last:.0f} s last time'
                    self.say(f'compiling the filter, once for each version of it ({took})')
        elif self._depth:
            self.signals.deliver()

    def on_end(self, event):
        if event.kind == 'numba:compile':
            self._depth -= 1
            if self._depth == 0:
                self._seconds += time.monotonic() - self._began
                gc.set_threshold(*self._thresholds)
            self.signals.__exit__()

    def say_once(self, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self.say(text)

    def keep_seconds(self) -> None:
        """Save the time of compilation in this process, unless it was small."""
        if self._seconds > (_seconds(FOLDER / 'seconds') or 0.0):
            (FOLDER / 'seconds').write_text(f'{self._seconds:.1f}\n')


def _last_seconds() -> float | None:
    """The time of the last compilation, s, of this version or another; None for the first time."""
    files = sorted(FOLDER.parent.glob('*/seconds'), key=lambda path: path.stat().st_mtime)
    return _seconds(files[-1]) if files else None


def _seconds(path: Path) -> float | None:
    try:
        return float(path.read_text())
    except (OSError, ValueError):
        return None


_compilation = _Compilation()
