"""What is drawn on a terminal while a command works."""

from __future__ import annotations

import io

import pytest
from numba import njit
from rich.console import Console

from stereocal.cli import terminal


@pytest.fixture(params=[True, False], ids=["terminal", "file"])
def console(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Console:
    """The console of standard error, which here writes into memory."""
    console = Console(file=io.StringIO(), force_terminal=request.param, width=100)
    monkeypatch.setattr(terminal, "errors", lambda: console)
    return console


def written(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_the_bar_says_when_it_waits_for_a_compilation(console: Console) -> None:
    @njit
    def twice(x: float) -> float:
        return 2.0 * x

    with terminal.Terminal().stage("Working", 2) as step:
        step()
        assert "compiling" not in written(console)
        assert twice(1.5) == 3.0
        assert ("Working (compiling kernels, once)" in written(console)) == console.is_terminal
        told = len(written(console))
        assert twice(2.5) == 5.0  # compiled already
        step()
    assert "compiling" not in written(console)[told:]
    if not console.is_terminal:
        assert written(console).strip() == ""
