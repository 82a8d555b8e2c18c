"""The ways a job fails, as exception types.

Every error of the library is a :class:`StereocalError`, so a program catches one type; the command line turns it
into one sentence on stderr. Each message says what is wrong, with what (the file, the argument), and what to do.

================================  =======================================================
:class:`InputError`               an argument is not what the function needs (a ValueError)
:class:`DataFileError`            a file cannot be read, written or understood
:class:`DegenerateGeometryError`  the data is well formed, but does not determine the answer
:class:`ConvergenceError`         a solver stopped without reaching an optimum
================================  =======================================================
"""

from __future__ import annotations

import os


class StereocalError(Exception):
    """Base of every error that stereocal raises on purpose."""


class InputError(StereocalError, ValueError):
    """An argument has the wrong shape, dtype, range or number of points."""


class DataFileError(StereocalError, ValueError):
    """A file cannot be read, written or understood.

    Parameters
    ----------
    path : str or os.PathLike
        The file; it opens the message.
    problem : str
        What is wrong and what to do about it; made one line of at most 400 characters, for it may quote the file.
    """

    def __init__(self, path: str | os.PathLike[str], problem: str) -> None:
        self.path = os.fspath(path)
        line = " ".join(problem.split())
        self.problem = line if len(line) <= 400 else f"{line[:300]} … {line[-95:]}"
        super().__init__(f"{self.path}: {self.problem}")


class DegenerateGeometryError(StereocalError, ValueError):
    """The data is well formed, but does not determine the answer: all views parallel, collinear points."""


class ConvergenceError(StereocalError, RuntimeError):
    """A solver stopped without reaching an optimum."""
