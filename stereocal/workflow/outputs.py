"""A folder of results, written whole or not at all.

A job that fails half way, is interrupted, or fills the disk must leave what was there before. So every command writes
into a staging folder on the same disk, and only when all of it is there are the files renamed into place, one system
call each. The staging folder is made before the work starts: a folder that cannot be written is found out in the
first second, not after the last photograph.
"""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stereocal.base.errors import DataFileError

DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class StagedFolder:
    """The folder that a command writes into, until it is published.

    Attributes
    ----------
    staging : Path
        Where to write.
    final : Path
        Where the files will stand.
    """

    def __init__(self, staging: Path, final: Path) -> None:
        self.staging = staging
        self.final = final

    def path(self, name: str) -> Path:
        """Return where to write the file `name` (a relative path); its folder is made."""
        target = self.staging / name
        target.parent.mkdir(parents=True, exist_ok=True)
        return target

    def names(self) -> list[str]:
        """Return the relative paths of all files written so far, sorted."""
        return sorted(path.relative_to(self.staging).as_posix() for path in self.staging.rglob("*") if path.is_file())

    def published(self) -> list[Path]:
        """Return where the files written so far will stand, sorted."""
        return [self.final / name for name in self.names()]


@contextmanager
def staged_folder(folder: str | os.PathLike[str]) -> Iterator[StagedFolder]:
    """Open a folder of results that is published when the block ends well, and leaves no trace when it does not.

    Parameters
    ----------
    folder : str or os.PathLike
        Made if need be, with its parents. Files of other names that stand there stay.

    Raises
    ------
    DataFileError
        If the folder cannot be made or written, or the disk is full.
    """
    final = Path(folder)
    made = _make_folder(final)
    try:
        staging = Path(tempfile.mkdtemp(prefix=".stereocal-", dir=final))
    except OSError as error:
        _remove_folders(made)
        raise _cannot_write(final, error) from error
    try:
        staged = StagedFolder(staging, final)
        yield staged
        for name in staged.names():
            (final / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(staging / name, final / name)
        made = []
    except OSError as error:
        full = error.filename is None and error.errno in DISK_FULL  # what write() raises names no file
        if not full and not _is_inside(error.filename, staging):
            raise
        raise _cannot_write(final, error) from error
    except DataFileError as error:
        if _is_inside(error.path, staging):  # say where the user wanted it, not where it was staged
            where = final / os.path.relpath(error.path, staging)
            raise DataFileError(where, error.problem) from error
        raise
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        _remove_folders(made)


def _make_folder(final: Path) -> list[Path]:
    """Make the folder and its parents, and return those made, deepest first."""
    missing = []
    probe = final
    while not probe.exists() and not probe.is_symlink():
        missing.append(probe)
        probe = probe.parent
    if not probe.is_dir():
        raise DataFileError(probe, "is a file, not a folder; choose another folder for --out")
    try:
        final.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        _remove_folders(missing)
        raise _cannot_write(final, error) from error
    return missing


def _remove_folders(folders: list[Path]) -> None:
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:  # another program has put something there meanwhile: leave it
            return


def _is_inside(path: object, folder: Path) -> bool:
    return isinstance(path, (str, os.PathLike)) and Path(path).is_relative_to(folder)


def _cannot_write(folder: Path, error: OSError) -> DataFileError:
    return DataFileError(folder, f"cannot be written ({error.strerror or error}); choose another folder with --out")
