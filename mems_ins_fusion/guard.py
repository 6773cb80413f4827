"""The last net under every tool: whatever happens, a user reads one line and the shell gets an exit status.

0: done. 2: what was given cannot be used. 130: interrupted, by Ctrl-C or SIGTERM, after cleaning up.
"""
from __future__ import annotations

import os
import platform
import signal
import sys
import tempfile
import threading
import traceback
import warnings
from collections.abc import Callable

#: where defects are to be reported; the maintainer of package.xml
REPORT_TO = 'maintainers@mems-ins-fusion.example'
BAD_INPUT, INTERRUPTED = 2, 130
_AGAIN = 0.05  # s until a lost interruption is repeated


def guarded(tool: str, argv: list[str], work: Callable[[], int | None]) -> int:
    """The exit status of `work`, or that of what stopped it, which is then said in one line on standard error."""
    interruption = _Interruption()
    warnings.simplefilter('ignore', RuntimeWarning)  # NumPy on values that no sensor delivers
    warnings.formatwarning = lambda message, *_, **__: f'{tool}: {one_line(message)}\n'
    try:
        with interruption:
            status = work() or 0
            sys.stdout.flush()
            return status
    except BrokenPipeError:  # whoever read the output has seen enough of it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        return _say(tool, 'interrupted, nothing was written', INTERRUPTED)
    except Exception as error:
        if interruption.requested:  # libraries turn it into errors of their own
            return _say(tool, 'interrupted, nothing was written', INTERRUPTED)
        return _say(tool, _reason(tool, argv, error))


def refuse(tool: str, error: ValueError) -> int:
    """Say what is wrong with the input, as one of the package's own errors puts it; the exit status.

    Raises `error` again where it is a library's: that is a defect, and its text tells a user nothing.
    """
    if type(error) is not ValueError and not type(error).__module__.startswith('mems_ins_fusion'):
        raise error
    return _say(tool, one_line(error))


def one_line(error) -> str:
    """The text of an exception or a warning as one line without control characters, its type where it has none."""
    text = ' '.join(str(error).split()) or type(error).__name__
    return ''.join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def _say(tool: str, text: str, status: int = BAD_INPUT) -> int:
    try:
        print(f'{tool}: {text}', file=sys.stderr)
    except OSError:  # nobody listens
        pass
    return status


def _reason(tool: str, argv: list[str], error: Exception) -> str:
    if isinstance(error, MemoryError):
        return f'out of memory with {" ".join(argv)}; use a part of the recording (start, stop)'
    if isinstance(error, OSError) and error.strerror:
        return f'{error.filename}: {error.strerror}' if error.filename else error.strerror
    return (f'a defect of the program, not of yours: {type(error).__name__}: {one_line(error)}; called with: '
            f'{one_line(" ".join(argv))}; please report it to {REPORT_TO}{_written(tool, argv)}')


def _written(tool: str, argv: list[str]) -> str:
    """Write the present exception to a file; how the sentence goes on."""
    try:
        with tempfile.NamedTemporaryFile('w', prefix=f'mems_ins_fusion_{tool}_', suffix='.txt', delete=False,
                                         encoding='utf-8', errors='backslashreplace') as file:
            file.write(f'{tool} {argv!r}\nPython {sys.version}\n{platform.platform()}\n\n{traceback.format_exc()}')
    except OSError:
        return ''
    return f' with the file {file.name}'


class _Interruption:
    """SIGINT and SIGTERM as one KeyboardInterrupt while the block runs; further signals do nothing.

    An exception in a destructor or in a library's callback is lost; that one is repeated.
    """

    requested = False

    def __enter__(self):
        self._former = {}
        if threading.current_thread() is threading.main_thread():
            self._former = {number: signal.signal(number, self._handle) for number in (signal.SIGINT, signal.SIGTERM)}
        self._hook, sys.unraisablehook = sys.unraisablehook, self._lost
        return self

    def __exit__(self, *exception):
        sys.unraisablehook = self._hook
        for number, handler in self._former.items():
            signal.signal(number, handler)

    def _handle(self, number, frame):
        if not self.requested:
            self.requested = True
            raise KeyboardInterrupt

    def _lost(self, unraisable):
        if not issubclass(unraisable.exc_type, KeyboardInterrupt):
            return self._hook(unraisable)
        self.requested = False
        timer = threading.Timer(_AGAIN, signal.raise_signal, (signal.SIGINT,))
        timer.daemon = True
        timer.start()
