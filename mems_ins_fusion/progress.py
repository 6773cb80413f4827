"""Progress of a tool on standard error: a bar on a terminal, single lines in a log."""
from __future__ import annotations

import sys
import time

#: s between two lines in a log; a shorter task writes none
PERIOD = 20.0


class Progress:
    """A context manager that is called with the part done, 0 to 1, and the present stage in words."""

    def __init__(self, name: str, period: float = PERIOD):
        self._name, self._period = name, period
        self._bar = None

    def __enter__(self):
        self._began = self._said = time.monotonic()
        if sys.stderr.isatty():
            from tqdm import tqdm  # imported here, as it is slow

            self._bar = tqdm(total=100, desc=self._name, mininterval=0.02, file=sys.stderr,
                             bar_format='{desc}: {percentage:3.0f}%|{bar}| {elapsed}, about {remaining} more {postfix}')
        return self

    def __exit__(self, *exception):
        if self._bar is not None:
            self._bar.close()

    def __call__(self, part: float, what: str = '') -> None:
        if self._bar is None:
            self._write_now_and_then(part, what)
            return
        if what != self._bar.postfix:  # a new stage is shown at once
            self._bar.set_postfix_str(what)
        self._bar.update(max(round(100 * part) - self._bar.n, 0))

    def _write_now_and_then(self, part, what):
        now = time.monotonic()
        if now - self._said >= self._period:
            self._said = now
            doing = f' {what},' if what else ''
            print(f'{self._name}: {100 * part:.0f} %,{doing} {now - self._began:.0f} s', file=sys.stderr, flush=True)
