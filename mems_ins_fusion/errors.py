"""The one kind of error that is a user's to mend."""
from __future__ import annotations


class InputError(ValueError):
    """What was given - a file, an option, a parameter, a recording - cannot be used: one line that says why.

    Every tool prints it and ends with status 2. Any other exception, a library's ValueError among them, is a defect of
    the program and told as one (`guard`).
    """
