"""Why a recording has no result: one line for a person, and an id that is the same wherever the reason is."""
from __future__ import annotations

import re
import zlib

from ..errors import InputError
from ..guard import identity, one_line

#: a worker ended while it had the recording, twice
WORKER_DIED = 'worker-died'
#: there was not enough memory
OUT_OF_MEMORY = 'out-of-memory'
#: the worker has another version of the package
OTHER_VERSION = 'other-version'
#: a failure with one of these may not happen again: the next run tries the recording once more
PASSING = (WORKER_DIED, OUT_OF_MEMORY, OTHER_VERSION)

#: what differs from one recording to the next in a message: what is quoted, paths, numbers
_PARTICULAR = re.compile(r"'[^']*'|\S*/\S*|[-+]?\d[\d.e+-]*")


def reason(error: BaseException) -> str:
    """The failure in one line."""
    if isinstance(error, MemoryError):
        return 'out of memory'
    if isinstance(error, OSError) and error.strerror:
        return f'{error.filename}: {error.strerror}' if error.filename else error.strerror
    text = one_line(error)
    return text if is_ours(error) else f'a defect of the program: {type(error).__name__}: {text}'


def is_ours(error: BaseException) -> bool:
    """Whether the package says by `error` that something is wrong with what it was given."""
    return isinstance(error, (OSError, InputError))


def error_id(error: BaseException, names=()) -> str:
    """What kind of failure this is, and six letters of its message without `names` of recordings, paths and numbers; of
    a defect of the program its number."""
    if isinstance(error, MemoryError):
        return OUT_OF_MEMORY
    if not is_ours(error):
        return f'defect-{identity(error)}'
    kind = re.sub('(?<=[a-z])(?=[A-Z])', '-', type(error).__name__).lower().removesuffix('-error').removesuffix('error')
    text = one_line(error)
    for name in sorted(filter(None, names), key=len, reverse=True):
        text = text.replace(name, '#')
    said = f'{zlib.crc32(_PARTICULAR.sub("#", text).encode()):08x}'[:6]
    return f'{kind}-{said}'
