"""The exception for errors that the user can correct."""
from __future__ import annotations


class InputError(ValueError):
    """A file, an option, a parameter or a recording cannot be used; the text says why in one line.

    Every tool prints the text and ends with status 2. Any other exception, including a ValueError of a library, is
    reported as a defect of the program (`guard`).
    """
