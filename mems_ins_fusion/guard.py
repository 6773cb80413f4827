"""Handling of all exceptions and signals in a tool: the user gets one line, and the shell an exit status.

0: done. 2: the input cannot be used. 130: interrupted, by Ctrl-C or SIGTERM, after cleaning up.
"""
from __future__ import annotations

import errno
import hashlib
import os
import platform
import signal
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

from mems_ins_fusion.errors import InputError

BAD_INPUT, INTERRUPTED = 2, 130
#: s for which a tool may clean up after a signal; then it is ended, so that Ctrl-C always works
GRACE = 10.0
_AGAIN = 0.05  # s until a lost interruption is repeated
_PACKAGE = Path(__file__).parent
_INTERRUPTED = 'interrupted, nothing was written'
#: errors by limits of the system: error numbers and parts of the text, and how a user raises the limit
_LIMITS = (
    ((errno.EMFILE, errno.ENFILE, 'Too many open files'),
     'too many files are open at once: raise that limit of this shell (ulimit -n)'),
    ((errno.EAGAIN, "can't start new thread", 'Resource temporarily unavailable'),
     'no further process or thread may be started: raise that limit of this user (ulimit -u, or pids of a container)'),
    ((errno.ENOMEM, 'failed to map segment', 'annot allocate memory'),
     'there is no memory left: raise its limit (ulimit -v, or that of the container)'))


def guarded(tool: str, argv: list[str], work: Callable[[], int | None]) -> int:
    """Run `work`; returns its exit status, or that of an exception or signal, which is reported in one line on standard
    error."""
    interruption = _Interruption(tool)
    warnings.simplefilter('ignore', RuntimeWarning)  # NumPy warnings about impossible values of sensors
    warnings.formatwarning = lambda message, *_, **__: f'{tool}: {one_line(message)}\n'
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, 'reconfigure'):  # characters that the terminal cannot show must not end the tool
            stream.reconfigure(errors='backslashreplace')
    if wrong := [word for word in argv if not _is_utf8(word)]:  # such text could not be written to a result
        return _say(tool, f'the name {os.fsencode(wrong[0])!r} is not UTF-8; rename it')
    try:
        with interruption:
            status = work() or 0
            sys.stdout.flush()
            return status
    except BrokenPipeError:  # the reader of the output, such as `head`, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        return _say(tool, _INTERRUPTED, INTERRUPTED)
    except Exception as error:
        if interruption.requested:  # a library may have raised another error instead
            return _say(tool, _INTERRUPTED, INTERRUPTED)
        return _say(tool, _reason(tool, argv, error))


def stop_if_interrupted() -> None:
    """Raise KeyboardInterrupt if a signal has come: a library may have caught the one that the handler raised."""
    if (running := _Interruption.running) is not None and running.requested and not running.heard:
        raise KeyboardInterrupt


@contextmanager
def interruption_delayed():
    """A short block that is not interrupted: KeyboardInterrupt is raised at its end."""
    running = _Interruption.running
    if running is None:
        yield
        return
    running.delayed = True
    try:
        yield
    finally:
        running.delayed = False
    stop_if_interrupted()


def heard_interruption() -> None:
    """To be called by code that catches KeyboardInterrupt and still has to write something."""
    if _Interruption.running is not None:
        _Interruption.running.heard = True


def refuse(tool: str, error: InputError) -> int:
    """Print the message of an InputError; returns the exit status."""
    return _say(tool, one_line(error))


def one_line(error) -> str:
    """The text of an exception or a warning as one line without control characters; its type if it has no text."""
    text = ' '.join(str(error).split()) or type(error).__name__
    return ''.join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def identity(error: BaseException) -> str:
    """A short identifier of the defect behind `error`, the same with other data and in other versions.

    It is computed from the type of the exception and the two innermost functions of the package in its traceback,
    without line numbers.
    """
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if _PACKAGE in Path(frame.filename).parents]
    where = [f'{Path(frame.filename).stem}.{frame.name}' for frame in frames[-2:]]
    return hashlib.blake2b(' '.join([type(error).__name__, *where]).encode(), digest_size=3).hexdigest().upper()


def _is_utf8(word: str) -> bool:
    return not any('\ud800' <= c <= '\udfff' for c in word)


def _say(tool: str, text: str, status: int = BAD_INPUT) -> int:
    try:
        print(f'{tool}: {text}', file=sys.stderr)
    except OSError:  # stderr is closed
        pass
    return status


def _reason(tool: str, argv: list[str], error: Exception) -> str:
    if isinstance(error, InputError):
        return one_line(error)
    if isinstance(error, MemoryError):
        return f'out of memory with {" ".join(argv)}; use a part of the recording (start, stop)'
    for signs, text in _LIMITS:
        if any(sign in str(error) if isinstance(sign, str) else sign == getattr(error, 'errno', None)
               for sign in signs):
            return text
    if isinstance(error, OSError) and error.strerror:
        return f'{error.filename}: {error.strerror}' if error.filename else error.strerror
    return (f'a defect of the program, not of yours, number {identity(error)}: {type(error).__name__}: '
            f'{one_line(error)}; called with: {one_line(" ".join(argv))}{_written(tool, argv)}')


def _written(tool: str, argv: list[str]) -> str:
    """Write the present exception to a file; returns the end of the message."""
    try:
        with tempfile.NamedTemporaryFile('w', prefix=f'mems_ins_fusion_{tool}_', suffix='.txt', delete=False,
                                         encoding='utf-8', errors='backslashreplace') as file:
            file.write(f'{tool} {argv!r}\nPython {sys.version}\n{platform.platform()}\n\n{traceback.format_exc()}')
    except OSError:
        return ''
    return f'; what is needed to find it is in {file.name}'


class _Interruption:
    """SIGINT and SIGTERM as one KeyboardInterrupt while the block runs; further signals do nothing.

    An exception in a destructor or in a library's callback is lost; that one is repeated. Where the main thread does
    not come back to Python within GRACE, out of a long computation of a library, another thread ends the process.
    """

    requested = False
    #: whether the code that caught the exception continues deliberately
    heard = False
    #: whether a block that is not interrupted runs
    delayed = False
    #: the instance whose block runs
    running: _Interruption | None = None

    def __init__(self, tool: str):
        self._tool = tool
        self._done = threading.Event()

    def __enter__(self):
        self._former = {}
        self._pipe = None
        self._outer, _Interruption.running = _Interruption.running, self
        if threading.current_thread() is threading.main_thread():
            self._former = {number: signal.signal(number, self._handle) for number in (signal.SIGINT, signal.SIGTERM)}
            self._watch()
        self._hook, sys.unraisablehook = sys.unraisablehook, self._lost
        return self

    def __exit__(self, *exception):
        sys.unraisablehook = self._hook
        _Interruption.running = self._outer
        self._done.set()
        if self._pipe is not None:
            signal.set_wakeup_fd(-1)
            os.close(self._pipe)  # ends the thread
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _watch(self):
        """Wait for signals in a thread, as the handlers of Python run only in the main thread."""
        incoming, self._pipe = os.pipe()
        os.set_blocking(self._pipe, False)
        # nodes have handlers of their own, which are kept
        signal.set_wakeup_fd(self._pipe, warn_on_full_buffer=False)
        try:
            threading.Thread(target=self._wait_for_signal, args=(incoming,), daemon=True).start()
        except RuntimeError:  # no thread can be started: signals are handled only in the main thread
            signal.set_wakeup_fd(-1)

    def _wait_for_signal(self, incoming: int):
        while heard := os.read(incoming, 1):
            if heard[0] in (signal.SIGINT, signal.SIGTERM) and not self._done.wait(GRACE):
                _say(self._tool, _INTERRUPTED)
                os._exit(INTERRUPTED)
        os.close(incoming)

    def _handle(self, number, frame):
        if not self.requested:
            self.requested = True
            if not self.delayed:
                raise KeyboardInterrupt

    def _lost(self, unraisable):
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            return self._hook(unraisable)
        self.requested = False
        timer = threading.Timer(_AGAIN, signal.raise_signal, (signal.SIGINT,))
        timer.daemon = True
        timer.start()
