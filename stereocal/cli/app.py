"""The application, and what all commands share: how they answer, and what counts as wrong usage."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

from cyclopts import App, Parameter
from rich.console import RenderableType

from stereocal import __version__
from stereocal.base.errors import InputError
from stereocal.cli.terminal import print_json, results

app = App(
    name="stereocal",
    version=__version__,
    help_format="markdown",
    suppress_keyboard_interrupt=False,
    help="Stereo camera calibration and disparity maps, every algorithm its own, each checked against OpenCV.\n\n"
    "Start with `stereocal demo`. With your own photographs: `stereocal board` prints a target, `stereocal calibrate` "
    "turns two folders of photographs into a calibrated rig and a report, `stereocal disparity` makes depth of a pair.",
)


class UsageError(Exception):
    """What was typed does not make sense: exit code 2."""


@contextmanager
def usage() -> Iterator[None]:
    """Take an InputError for what it is while words are parsed: wrong usage."""
    try:
        yield
    except InputError as error:
        raise UsageError(str(error)) from error


def answer(output: Output | None, document: Callable[[], object], summary: Iterable[RenderableType]) -> None:
    """Print the result: one JSON document, or lines for a person."""
    if output is not None and output.json:
        print_json(document())
        return
    console = results()
    for line in list(summary):  # all of it first: a summary is not cut off half way
        console.print(line)


@Parameter(name="*", group="Output")
@dataclass(frozen=True)
class Output:
    """How a command answers."""

    json: Annotated[bool, Parameter(negative="")] = False
    """Print the result as one JSON document on standard output, and nothing else."""
    debug: Annotated[bool, Parameter(negative="")] = False
    """Show the traceback of an error."""
