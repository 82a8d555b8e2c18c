"""Where compiled kernels are kept.

Numba keeps them beside the source, in ``__pycache__``, or else in the user's cache folder. Where it can write to
neither (a package that root installed and a service without a home uses, a container that is read-only) it refuses to
import them. There a folder among the temporary files serves. ``NUMBA_CACHE_DIR``, if set, goes before all of this.

What is read from such a folder is run as code, so it must be this user's own: no link, and nobody else may write to it.
"""

from __future__ import annotations

import os
import sys

VARIABLE = "NUMBA_CACHE_DIR"


def provide_kernel_cache() -> str | None:
    """Name a folder for compiled kernels, in ``NUMBA_CACHE_DIR``, if Numba would find none.

    Returns
    -------
    str or None
        The folder, or None where Numba needs no help.
    """
    beside = os.path.join(os.path.dirname(os.path.abspath(__file__)), "__pycache__")
    if os.environ.get(VARIABLE) or _can_write(beside) or _can_write(_user_cache()):
        return None
    folder = _own_folder()
    os.environ[VARIABLE] = folder  # for the processes started from here, too
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = folder
    return folder


def _can_write(folder: str) -> bool:
    """Whether files could be made in `folder`, which need not exist yet."""
    while not os.path.lexists(folder) and folder != os.path.dirname(folder):
        folder = os.path.dirname(folder)
    return os.path.isdir(folder) and os.access(folder, os.W_OK | os.X_OK)


def _user_cache() -> str:
    """Where Numba's second choice lies."""
    home = os.path.expanduser("~")
    if sys.platform == "win32":
        return os.environ.get("LOCALAPPDATA") or os.path.join(home, "AppData", "Local")
    if sys.platform == "darwin":
        return os.path.join(home, "Library", "Caches")
    return os.environ.get("XDG_CACHE_HOME") or os.path.join(home, ".cache")


def _own_folder() -> str:
    """Return this user's folder among the temporary files, or a fresh one if somebody else's stands in its place."""
    import stat
    import tempfile  # as slow to import as all that ``import stereocal`` needs otherwise

    user = os.getuid() if hasattr(os, "getuid") else 0
    folder = os.path.join(tempfile.gettempdir(), f"stereocal-kernels-{user}")
    if not os.path.lexists(folder):
        os.makedirs(folder, mode=0o700, exist_ok=True)
    found = os.lstat(folder)
    ours = stat.S_ISDIR(found.st_mode) and found.st_uid == user and not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    if ours or sys.platform == "win32":  # where the temporary folder is the user's own
        return folder
    return tempfile.mkdtemp(prefix="stereocal-kernels-")
