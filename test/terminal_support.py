"""A terminal for the tests: what a program writes to a person."""
from __future__ import annotations

import fcntl
import os
import pty
import struct
import termios


class Terminal:
    """80 columns wide; a context manager. `end` is for the program; `read` gives what came, b'' at the end."""

    def __enter__(self):
        self._ours, self.end = pty.openpty()
        fcntl.ioctl(self.end, termios.TIOCSWINSZ, struct.pack('HHHH', 24, 80, 0, 0))
        return self

    def __exit__(self, *exception):
        os.close(self._ours)

    def read(self) -> bytes:
        try:
            return os.read(self._ours, 4096)
        except OSError:  # nobody holds the other end any more
            return b''
