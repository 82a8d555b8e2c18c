from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import stereocal as sc
from stereocal.cli.main import main
from stereocal.store.images import write_image
from stereocal.workflow.crosschecks import find_calibration, run_crosscheck


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    camera = sc.Camera([[430, 0, 322], [0, 431, 244], [0, 0, 1]], [-0.38, 0.15, 0, 0, 0], (640, 480))
    rig = sc.StereoRig(camera, camera, sc.rotation_matrix([0.01, 0.02, 0]), [-60.0, 0, 0])
    file = tmp_path / "calibration.json"
    sc.save_calibration(rig, file)
    return file


def test_a_file_alone_is_enough(calibration: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["crosscheck", str(calibration)]) == 0
    shown = capsys.readouterr().out
    assert "rectification maps" in shown
    assert "five iterations" in shown
    assert "steps agree with OpenCV" in shown


def test_the_folder_that_calibrate_wrote_will_do(calibration: Path) -> None:
    assert find_calibration(calibration.parent) == calibration
    assert run_crosscheck(calibration.parent).as_dict()["pairs"] == 0


def test_photographs_without_a_board_are_told_what_is_missing(
    calibration: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for side in ("left", "right"):
        (calibration.parent / side).mkdir()
        for i in range(2):
            image = np.full((480, 640), 100 + i, np.uint8)
            write_image(calibration.parent / side / f"{i}.png", image)
    words = ["crosscheck", str(calibration), "--left", str(calibration.parent / "left")]
    assert main([*words, "--right", str(calibration.parent / "right")]) == 1
    assert "--inner-corners 9x6 --square 25mm" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "sentence"),
    [("nowhere.json", "nowhere.json"), ("empty", "holds no calibration")],
    ids=["missing", "empty"],
)
def test_what_is_not_there_is_named(
    tmp_path: Path, name: str, sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty").mkdir()
    assert main(["crosscheck", str(tmp_path / name)]) == 1
    error = capsys.readouterr().err
    assert sentence in error
    assert "Traceback" not in error
