"""Files written whole or not at all.

A job that is interrupted, or a disk that fills up, must leave what was there before. So a file is written under a
temporary name in the same folder, flushed to the disk, and renamed over the old one, which POSIX and Windows do in one
step.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from stereocal.base.errors import DataFileError


def write_whole(path: str | os.PathLike[str], content: bytes | str | Callable[[BinaryIO], object]) -> Path:
    """Write a file whole or not at all, its folder made if need be.

    Parameters
    ----------
    path : str or os.PathLike
        Where to.
    content : bytes, str or callable
        The bytes, the text (UTF-8), or a function that writes into the open binary file it is given.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    DataFileError
        If the folder cannot be made or the file cannot be written; what stood there before is untouched.
    """
    target = Path(path)
    temporary = ""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        descriptor, temporary = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
        with os.fdopen(descriptor, "wb") as stream:
            if callable(content):
                content(stream)
            else:
                stream.write(content.encode() if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, target)
    except OSError as error:
        _discard(temporary)
        raise DataFileError(target, f"cannot be written ({error.strerror or error}); choose another folder") from error
    except BaseException:
        _discard(temporary)
        raise
    return target


def _discard(temporary: str) -> None:
    if temporary and os.path.exists(temporary):
        os.unlink(temporary)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
