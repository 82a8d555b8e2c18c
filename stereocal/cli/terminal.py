"""Standard output and standard error; progress bars.

Results go to standard output, so that they can be piped; everything else (progress, errors) goes to standard error.
With ``--json`` standard output is one JSON document and nothing else. Bars are drawn only on a terminal; while Numba
compiles kernels, which the first run on a machine does and later ones do not, the bar says what it waits for.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars


class _Results(Console):
    """A console whose reader may leave early, as `head` does: that is no failure of the job."""

    def on_broken_pipe(self) -> None:
        """Hand the reader's leaving on to ``main``, which ends the program well."""
        raise BrokenPipeError


def results() -> Console:
    """Return the console of standard output; lines are never broken in a file or a pipe."""
    return _Results(highlight=False, soft_wrap=True)


def errors() -> Console:
    """Return the console of standard error."""
    return Console(stderr=True, highlight=False, soft_wrap=True)


def complain(sentence: str) -> None:
    """Print one line on standard error, whatever the sentence holds."""
    print(f"stereocal: {' '.join(sentence.split())}", file=sys.stderr)


def print_json(document: Any) -> None:
    """Print one JSON document on standard output; what is not a number is null, as JSON has no NaN."""
    json.dump(_plain(document), sys.stdout, indent=2, ensure_ascii=False, allow_nan=False)
    sys.stdout.write("\n")
    sys.stdout.flush()


class Terminal:
    """Progress bars on standard error, if it is a terminal."""

    @contextmanager
    def stage(self, title: str, total: int | None = None) -> Iterator[Callable[[], None]]:
        """Open a bar of `total` steps; it vanishes when the stage is over."""
        console = errors()
        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with Bars(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
            task = bars.add_task(title, total=total)
            with ExitStack() as listening:
                if console.is_terminal:
                    listening.enter_context(_compilation_told(partial(bars.update, task), title))
                yield lambda: bars.advance(task)


@contextmanager
def _compilation_told(update: Callable[..., None], title: str) -> Iterator[None]:
    """Let the bar's text say so while kernels are compiled: minutes may pass in which it could not move."""
    from numba.core import event

    class Listener(event.Listener):
        depth = 0

        def on_start(self, event: event.Event) -> None:
            self.depth += 1
            update(description=f"{title} (compiling kernels, once)", refresh=True)

        def on_end(self, event: event.Event) -> None:
            self.depth -= 1
            if self.depth == 0:
                update(description=title, refresh=True)

    with event.install_listener("numba:compile", Listener()):
        yield


def _plain(value: Any) -> Any:
    """Return `value` with NaN and infinity as None, and arrays and paths as lists and text."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if hasattr(value, "tolist"):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int, str)) else str(value)
