"""A small rendered rig on disk, and a way to run a command in this process."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from stereocal.cli.main import main
from stereocal.synthetic.rig import SyntheticRig, render_rig

PAIRS = 5


@dataclass(frozen=True)
class Answer:
    """What a command said."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


Run = Callable[..., Answer]


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str]) -> Run:
    """Run ``stereocal WORDS…`` in this process; a failure must be one line on standard error and no traceback."""

    def call(*words: object) -> Answer:
        capfd.readouterr()
        code = main([str(word) for word in words])
        out, err = capfd.readouterr()
        if code:
            assert out == "", "a failed command prints no results"
            assert err.startswith("stereocal: ")
            assert err.count("\n") == 1, err
            assert "internal error" not in err, err
            assert ".stereocal-" not in err, "the sentence names a staging folder"
        return Answer(code, out, err)

    return call


@pytest.fixture(scope="session")
def rendered() -> SyntheticRig:
    """Five pairs of a 6x5 board and a room, small enough for a test."""
    from stereocal.board.chessboard import Chessboard

    return render_rig(seed=3, pairs=PAIRS, image_size=(320, 240), board=Chessboard((6, 5), 25.0), noise=1.0)


@pytest.fixture(scope="session")
def photographs(rendered: SyntheticRig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its photographs: left/01.png …, right/01.png …, scene/left.png, scene/right.png. Not to be changed."""
    folder = tmp_path_factory.mktemp("photographs")
    rendered.save_images(folder)
    return folder


@pytest.fixture(scope="session")
def calibrated(photographs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``calibrate`` makes of them. Not to be changed."""
    out = tmp_path_factory.mktemp("calibrated")
    words = ["calibrate", photographs / "left", photographs / "right", "--inner-corners", "6x5", "--square", "25mm"]
    assert main([str(word) for word in [*words, "--out", out]]) == 0
    return out


@pytest.fixture
def copy(photographs: Path, tmp_path: Path) -> Path:
    """A copy of the photographs that a test may damage."""
    shutil.copytree(photographs, tmp_path / "photographs")
    return tmp_path / "photographs"
