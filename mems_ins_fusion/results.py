"""Results, folders and files, that are either complete or not there, even if several processes write at once or end
early."""
from __future__ import annotations

import ctypes
import errno
import fcntl
import json
import math
import os
import re
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

from mems_ins_fusion.errors import InputError
from mems_ins_fusion.guard import interruption_delayed, stop_if_interrupted

#: end of the names of unfinished results, and of one that is being replaced
_UNFINISHED, _FORMER = '.unfinished', '.former'
#: of renameat2 (linux/fs.h, fcntl.h): paths relative to the current folder; exchange of two names
_HERE, _EXCHANGE = -100, 2
#: error numbers of a write without room
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


#: the option of the tools that replaces an existing result
_OPTION = '--overwrite'


class ResultError(InputError):
    """A result that cannot be written; the text is one line with the path."""


class ResultBusy(ResultError):
    """A result that another process is writing now."""


@contextmanager
def result_folder(path, overwrite: bool = False, marker: str = 'report.json', option: str = _OPTION):
    """A folder to write a result into; it gets the name `path` when the block ends without an exception.

    Until then its files are in a folder with a temporary name beside `path`, which is removed if the block fails. If
    two processes write the same result at once, the second one is refused; remains of a process that was killed are
    removed. marker: the file by which a result of this package is recognized; a folder without it is never replaced.
    option: option of the user for `overwrite`, for the message. Raises ResultError if `path` exists and `overwrite` is
    false, or if it cannot be written.
    """
    path = asked = Path(path)
    with _said(path):
        check_free(asked, overwrite, marker, option)
        path = _real(path)
        path.parent.mkdir(parents=True, exist_ok=True)
    work = lock = None
    try:
        with _said(path), interruption_delayed():  # an interruption here would leave the folder
            work, lock = _claim(path)
        with _said(path, work):
            yield work
            check_free(asked, overwrite, marker, option)
            stop_if_interrupted()
            _replace(path, work)
    finally:
        if work is not None:
            shutil.rmtree(work, ignore_errors=True)
            os.close(lock)


def check_free(path, overwrite: bool = False, marker: str = 'report.json', option: str = _OPTION) -> None:
    """Raise ResultError if a result cannot get the name `path`; for tools that take long before they write."""
    path = Path(path)
    with _said(path):
        if path.is_symlink() and not path.exists():
            raise ResultError(f'{path} is a symbolic link to nothing')
        if not os.path.lexists(path):
            return
        if not path.is_dir():
            raise ResultError(f'{path} is a file, not a folder of results')
        if not any(path.iterdir()):
            return
        if not (path / marker).is_file():
            raise ResultError(f'{path} holds other files than results (no {marker}); choose another output')
        if not overwrite:
            raise _taken(path, option)


def _taken(path: Path, option: str = _OPTION) -> ResultError:
    return ResultError(f'{path} exists already; choose another output, or replace it with {option}')


@contextmanager
def _said(path: Path, work: Path | None = None):
    """Convert errors of the file system to ResultError; with `work` only those of writing below it, or for lack of
    room."""
    try:
        yield
    except OSError as error:
        inside = work is None or error.errno in _NO_ROOM or str(work) in str(error.filename)
        if not inside or not error.strerror:
            raise
        raise ResultError(f'cannot write {path}: {error.strerror}') from None
    except ValueError as error:
        if 'null byte' not in str(error):
            raise
        raise ResultError(f'cannot write {str(path)!r}: the name holds a null byte') from None


def _real(path: Path) -> Path:
    """The absolute path, with links resolved, so that two spellings of a path are equal."""
    if path.is_symlink() and path.exists():
        return path.resolve()
    path = path.absolute()
    return path.parent.resolve() / path.name if path.name != '..' else path.resolve()


def _claim(path: Path) -> tuple[Path, int]:
    """A new folder for the result `path`, locked by this process, and the lock.

    A lock ends with its process, however that ends: a folder without a lock is left over.
    """
    parent = os.open(path.parent, os.O_RDONLY)
    try:
        if not path.parent.name.endswith(_UNFINISHED):  # the folder is a result that this process has locked
            fcntl.flock(parent, fcntl.LOCK_EX)  # others must not look at the folder before it is locked
        for folder in _left_over(path, _UNFINISHED):
            _remove_left_over(folder, path)
        for folder in _left_over(path, _FORMER):
            if not path.exists() and (folder / path.name).exists():
                (folder / path.name).rename(path)
            shutil.rmtree(folder, ignore_errors=True)
        work = Path(tempfile.mkdtemp(prefix=f'.{path.name}.', suffix=_UNFINISHED, dir=path.parent))
        lock = os.open(work, os.O_RDONLY)
        fcntl.flock(lock, fcntl.LOCK_EX)
        work.chmod(0o755)
        return work, lock
    finally:
        os.close(parent)


def _left_over(path: Path, suffix: str) -> list[Path]:
    pattern = re.compile(re.escape(f'.{path.name}.') + '[a-z0-9_]{8}' + re.escape(suffix))
    return [p for p in path.parent.iterdir() if pattern.fullmatch(p.name) and not p.is_symlink()]


def _remove_left_over(folder: Path, path: Path) -> None:
    try:
        lock = os.open(folder, os.O_RDONLY)
    except FileNotFoundError:  # it has been finished in the meantime
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise ResultBusy(f'another run is writing {path} at this moment; wait for it or choose another output') \
            from None
    else:
        shutil.rmtree(folder, ignore_errors=True)
    finally:
        os.close(lock)


def _replace(path: Path, new: Path) -> None:
    """Rename the folder `new` to `path`; an earlier result there gets its name, or is removed."""
    if not path.exists() or not any(path.iterdir()):
        new.rename(path)
        return
    if _exchange(path, new):  # so that there is a result at any moment
        return
    old = Path(tempfile.mkdtemp(prefix=f'.{path.name}.', suffix=_FORMER, dir=path.parent))
    path.rename(old / path.name)
    new.rename(path)
    shutil.rmtree(old, ignore_errors=True)


def _exchange(path: Path, other: Path) -> bool:
    """Exchange the names of two folders in one step; False if the system or the file system cannot do this."""
    rename = getattr(ctypes.CDLL(None, use_errno=True), 'renameat2', None)
    return rename is not None and rename(_HERE, os.fsencode(path), _HERE, os.fsencode(other), _EXCHANGE) == 0


def json_text(content, **layout) -> str:
    """`content` as JSON; numbers that are not finite are null, as JSON has no other value for them.

    layout: of `json.dumps`.
    """
    return json.dumps(plain(content), allow_nan=False, **layout)


def plain(content):
    """`content` in types of JSON, arrays and numbers of NumPy as well; None for numbers that are not finite."""
    if isinstance(content, dict):
        return {str(name): plain(value) for name, value in content.items()}
    content = content.tolist() if hasattr(content, 'tolist') else content
    if isinstance(content, (list, tuple)):
        return [plain(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def check_files_free(paths, overwrite: bool = False) -> None:
    """Raise ResultError if one of the files `paths` exists and `overwrite` is false, or if it is a folder."""
    for path in map(Path, paths):
        if path.is_dir():
            raise ResultError(f'{path} is a folder, not a file')
        if path.exists() and not overwrite:
            raise _taken(path)


def write_files(texts: dict, overwrite: bool = False) -> None:
    """Write `texts`, by path: all of them to temporary names first, which are then renamed. Raises ResultError."""
    check_files_free(texts, overwrite)
    made = []
    try:
        for path, text in texts.items():
            path = Path(path).absolute()
            path.parent.mkdir(parents=True, exist_ok=True)
            work = path.with_name(f'.{path.name}.new')
            made.append((work, path))
            work.write_text(text, encoding='utf-8')
        stop_if_interrupted()
        for work, path in made:
            work.replace(path)
    except OSError as error:
        raise ResultError(f'cannot write {error.filename}: {error.strerror}') from None
    finally:
        for work, _ in made:
            work.unlink(missing_ok=True)
