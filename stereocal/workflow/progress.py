"""What a command tells about its progress, and to whom.

A command does not know whether a terminal, a notebook or nobody is watching. It opens a stage with a title and a
number of steps and calls back after each step; whoever called it decides what that looks like.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol


class Progress(Protocol):
    """Whoever watches a command."""

    def stage(self, title: str, total: int | None = None) -> AbstractContextManager[Callable[[], None]]:
        """Open a stage of `total` steps (None: unknown); the value is to be called after each step."""


class Silent:
    """Nobody watches."""

    @contextmanager
    def stage(self, title: str, total: int | None = None) -> Iterator[Callable[[], None]]:
        """Open a stage that nobody sees."""
        yield lambda: None
