"""The three sets of real photographs, from the folder to the rig. Skipped where they are not."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stereocal.store.disparity_files import read_disparity


def calibrate(run: Any, data: Path, name: str, board: str, square: str, out: Path) -> dict[str, Any]:
    words = (data / name / "left", data / name / "right", "--inner-corners", board, "--square", square)
    answer = run("calibrate", *words, "--out", out, "--json")
    assert answer.code == 0
    result: dict[str, Any] = answer.json
    assert all(
        Path(pair["left"]).name.lstrip("left") == Path(pair["right"]).name.lstrip("right") for pair in result["pairs"]
    )
    return result


def test_uvc_paper(run: Any, data: Path, tmp_path: Path) -> None:
    result = calibrate(run, data, "uvc_paper", "7x6", "1", tmp_path / "rig")
    assert result["pairs_used"] >= 20
    assert result["rms"] <= 0.43
    assert 2.82 <= result["baseline"] <= 2.86
    scene = data / "uvc_paper" / "scene"
    answer = run(
        "disparity", tmp_path / "rig" / "calibration.json", scene / "L000700.jpg", scene / "R000700.jpg",
        "--out", tmp_path / "depth", "--json",
    )  # fmt: skip
    assert answer.json["density"] > 0.6
    disparity = read_disparity(tmp_path / "depth" / "disparity.pfm")

    def near(column: int, row: int) -> float:
        """Median disparity around a pixel of the rectified left image."""
        return float(np.nanmedian(disparity[row - 8 : row + 9, column - 8 : column + 9]))

    clothes, chest, wardrobe = near(103, 349), near(293, 220), near(408, 210)
    assert clothes > chest + 5, "the heap of clothes is nearer than the person"
    assert chest > wardrobe + 3, "the person stands in front of the wardrobe"


def test_opencv_sample(run: Any, data: Path, tmp_path: Path) -> None:
    result = calibrate(run, data, "opencv_sample", "9x6", "30mm", tmp_path)
    assert result["pairs_used"] == 13
    assert result["rms"] <= 0.216
    assert np.linalg.norm(result["T"]) == pytest.approx(99.80, abs=0.3)
    assert result["unit"] == "mm"


def test_bumblebee2_chess(run: Any, data: Path, tmp_path: Path) -> None:
    result = calibrate(run, data, "bumblebee2_chess", "6x4", "3cm", tmp_path)
    assert result["pairs_used"] == 11
    assert result["rms"] <= 0.095
    assert 120.0 <= result["baseline"] <= 120.5


@pytest.mark.parametrize(
    ("name", "board"), [("uvc_paper", "7x6"), ("opencv_sample", "9x6"), ("bumblebee2_chess", "6x4")]
)
def test_detect_says_which_board_is_there_instead(run: Any, data: Path, name: str, board: str) -> None:
    answer = run("detect", data / name / "left", "--inner-corners", "5x3")
    assert answer.code == 0
    assert "0 of" in answer.out
    if name != "uvc_paper":  # there, 7x7 corners are to be seen
        assert f"--inner-corners {board}" in answer.out
