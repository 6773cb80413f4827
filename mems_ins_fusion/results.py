"""Results, folders and files, that are either complete or not there."""
from __future__ import annotations

import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path


class ResultError(ValueError):
    """A result that cannot be written: one line that names the path."""


@contextmanager
def result_folder(path, overwrite: bool = False, marker: str = 'report.json'):
    """A folder to write a result into; it takes the name `path` when the block ends without an exception.

    Until then its files stand under a temporary name beside `path`, and they are removed if the block fails.
    marker: the file that tells a result of ours; a folder without it is somebody's own and is never replaced.
    Raises ResultError where `path` is taken and `overwrite` is false, or where it cannot be written.
    """
    path = Path(path).absolute()
    _check_free(path, overwrite, marker)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        work = Path(tempfile.mkdtemp(prefix=f'.{path.name}.', dir=path.parent))
    except OSError as error:
        raise ResultError(f'cannot write {path}: {error.strerror}') from None
    try:
        work.chmod(0o755)
        yield work
        _replace(path, work)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _check_free(path: Path, overwrite: bool, marker: str) -> None:
    if not path.exists():
        return
    if not path.is_dir():
        raise ResultError(f'{path} is a file, not a folder of results')
    if not any(path.iterdir()):
        return
    if not (path / marker).is_file():
        raise ResultError(f'{path} holds other files than results (no {marker}); choose another output')
    if not overwrite:
        raise ResultError(f'{path} exists already; choose another output or ask for it to be overwritten')


def _replace(path: Path, new: Path) -> None:
    """Give the folder `new` the name `path`; a former result there is removed after that."""
    if not path.exists() or not any(path.iterdir()):
        new.rename(path)
        return
    old = Path(tempfile.mkdtemp(prefix=f'.{path.name}.old.', dir=path.parent))
    path.rename(old / path.name)
    new.rename(path)
    shutil.rmtree(old)


def check_free(paths, overwrite: bool = False) -> None:
    """ResultError where one of the files `paths` exists and `overwrite` is false, or is a folder."""
    for path in map(Path, paths):
        if path.is_dir():
            raise ResultError(f'{path} is a folder, not a file')
        if path.exists() and not overwrite:
            raise ResultError(f'{path} exists already; choose another output or ask for it to be overwritten')


def write_files(texts: dict, overwrite: bool = False) -> None:
    """Write `texts`, by path: all under temporary names first, then under their own. Raises ResultError."""
    check_free(texts, overwrite)
    made = []
    try:
        for path, text in texts.items():
            path = Path(path).absolute()
            path.parent.mkdir(parents=True, exist_ok=True)
            work = path.with_name(f'.{path.name}.new')
            made.append((work, path))
            work.write_text(text, encoding='utf-8')
        for work, path in made:
            work.replace(path)
    except OSError as error:
        raise ResultError(f'cannot write {error.filename}: {error.strerror}') from None
    finally:
        for work, _ in made:
            work.unlink(missing_ok=True)
