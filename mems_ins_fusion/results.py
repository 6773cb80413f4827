"""Results, folders and files, that are either complete or not there, however many write at once and however they
end."""
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

#: ends of the names of unfinished results, and of one that is being replaced
_UNFINISHED, _FORMER = '.unfinished', '.former'
#: of renameat2 (linux/fs.h, fcntl.h): paths are not relative to a folder; the two names change places
_HERE, _EXCHANGE = -100, 2
#: what a write fails with where there is no room for it, as opposed to a read
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EIO)


#: the option of the tools that replaces an existing result
_OPTION = '--overwrite'


class ResultError(InputError):
    """A result that cannot be written: one line that names the path."""


class ResultBusy(ResultError):
    """A result that another run is writing at this moment."""


@contextmanager
def result_folder(path, overwrite: bool = False, marker: str = 'report.json', option: str = _OPTION):
    """A folder to write a result into; it takes the name `path` when the block ends without an exception.

    Until then its files stand under a temporary name beside `path`, and they are removed if the block fails. Of two
    runs that write the same result at once the second is refused; what a killed run left behind is removed.
    marker: the file that tells a result of ours; a folder without it is somebody's own and is never replaced. option:
    what the user gives to set `overwrite`, for the message. Raises ResultError where `path` is taken and `overwrite` is
    false, or where it cannot be written.
    """
    path = asked = Path(path)
    with _said(path):
        check_free(asked, overwrite, marker, option)
        path = _real(path)
        path.parent.mkdir(parents=True, exist_ok=True)
    work = lock = None
    try:
        with _said(path), interruption_delayed():  # between a folder that exists and the block that removes it
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
    """ResultError where a result cannot take the name `path`; for what takes long before it writes."""
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
    """Failures of the file system as a ResultError; with `work` only those of writing, there or for want of room."""
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
    """The absolute path, so that two spellings of one are the same; a link to a folder is that folder."""
    if path.is_symlink() and path.exists():
        return path.resolve()
    path = path.absolute()
    return path.parent.resolve() / path.name if path.name != '..' else path.resolve()


def _claim(path: Path) -> tuple[Path, int]:
    """A new folder for the result `path`, locked by this process, and the lock.

    A lock ends with the process that holds it, however that ends: what nobody has locked is left over.
    """
    parent = os.open(path.parent, os.O_RDONLY)
    try:
        if not path.parent.name.endswith(_UNFINISHED):  # that is a result of this process, which it has locked
            fcntl.flock(parent, fcntl.LOCK_EX)  # between the making of a folder and its locking nobody may look
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
    except FileNotFoundError:  # it was finished meanwhile
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
    """Give the folder `new` the name `path`; a former result there takes its name, or is removed."""
    if not path.exists() or not any(path.iterdir()):
        new.rename(path)
        return
    if _exchange(path, new):  # at no moment is there none
        return
    old = Path(tempfile.mkdtemp(prefix=f'.{path.name}.', suffix=_FORMER, dir=path.parent))
    path.rename(old / path.name)
    new.rename(path)
    shutil.rmtree(old, ignore_errors=True)


def _exchange(path: Path, other: Path) -> bool:
    """Exchange the names of two folders in one step; False where the system or the file system does not know how."""
    rename = getattr(ctypes.CDLL(None, use_errno=True), 'renameat2', None)
    return rename is not None and rename(_HERE, os.fsencode(path), _HERE, os.fsencode(other), _EXCHANGE) == 0


def json_text(content, **layout) -> str:
    """`content` as JSON; a number that is none, such as an error beyond all numbers, is null: JSON has no other word.

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
    """ResultError where one of the files `paths` exists and `overwrite` is false, or is a folder."""
    for path in map(Path, paths):
        if path.is_dir():
            raise ResultError(f'{path} is a folder, not a file')
        if path.exists() and not overwrite:
            raise _taken(path)


def write_files(texts: dict, overwrite: bool = False) -> None:
    """Write `texts`, by path: all under temporary names first, then under their own. Raises ResultError."""
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
