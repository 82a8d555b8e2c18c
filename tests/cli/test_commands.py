"""Each command on good input: what it finds, what it writes, what it prints."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

import stereocal as sc
from stereocal.cli.commands import app
from stereocal.cli.main import main
from stereocal.store.clouds import read_ply
from stereocal.store.disparity_files import read_disparity, read_pfm
from stereocal.synthetic.rig import SyntheticRig

BOARD = ("--inner-corners", "6x5")


def names(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_detect_finds_the_true_corners(run: Any, photographs: Path, rendered: SyntheticRig, tmp_path: Path) -> None:
    answer = run(
        "detect", photographs / "left", *BOARD, "--out", tmp_path / "c.csv", "--draw", tmp_path / "d", "--json"
    )
    assert answer.code == 0
    entries = answer.json
    assert [Path(entry["image"]).name for entry in entries] == [f"{k:02d}.png" for k in range(1, 6)]
    for entry, truth in zip(entries, rendered.left_corners, strict=True):
        assert entry["found"] is True
        distance = np.linalg.norm(np.array(entry["corners"]) - truth, axis=1)
        assert distance.max() < 0.1
    rows = list(csv.DictReader((tmp_path / "c.csv").open()))
    assert len(rows) == 5 * 30
    assert [float(rows[7]["x"]), float(rows[7]["y"])] == entries[0]["corners"][7]
    assert (rows[7]["column"], rows[7]["row"]) == ("1", "1")
    assert names(tmp_path / "d") == {f"{k:02d}.png" for k in range(1, 6)}


def test_detect_prints_a_line_an_image(run: Any, photographs: Path) -> None:
    answer = run("detect", photographs / "left" / "01.png", photographs / "scene" / "left.png", *BOARD)
    assert answer.code == 0
    lines = answer.out.splitlines()
    assert "01.png" in lines[0]
    assert "  found" in lines[0]
    assert "scene/left.png" in lines[1]
    assert "not found" in lines[1]
    assert "1 of 2 photographs show the 6x5 board" in answer.out
    assert answer.err == ""


def test_calibrate_recovers_the_rig(calibrated: Path, rendered: SyntheticRig) -> None:
    rig = sc.load_calibration(calibrated / "calibration.json")
    assert rig.baseline == pytest.approx(rendered.rig.baseline, rel=2e-3)
    assert rig.left.K[0, 0] == pytest.approx(rendered.rig.left.K[0, 0], rel=5e-3)
    document = json.loads((calibrated / "calibration.json").read_text())
    assert document["pairs_used"] == 5
    assert [(pair["left"], pair["right"], pair["used"], pair["reason"]) for pair in document["pairs"]] == [
        (f"{k:02d}.png", f"{k:02d}.png", True, None) for k in range(1, 6)
    ]
    assert document["rms"] < 0.1
    assert (document["square_size"], document["unit"], document["inner_corners"]) == (25.0, "mm", [6, 5])
    for side in ("left", "right"):
        assert set(document[side]) >= {"image_size", "model", "K", "dist", "rms"}
        assert document[side]["image_size"] == [320, 240]
    assert np.shape(document["R"]) == (3, 3)
    assert np.shape(document["T"]) == (3,)
    assert document["std"]["left.fx"] > 0
    assert np.shape(document["covariance"]) == (len(document["parameter_names"]),) * 2


def test_calibrate_writes_what_opencv_reads(calibrated: Path) -> None:
    rig = sc.load_calibration(calibrated / "calibration.json")
    storage = cv2.FileStorage(str(calibrated / "calibration.yml"), cv2.FILE_STORAGE_READ)
    for name, value in (("M1", rig.left.K), ("M2", rig.right.K), ("R", rig.R)):
        np.testing.assert_array_equal(storage.getNode(name).mat(), value)
    np.testing.assert_array_equal(storage.getNode("T").mat().ravel(), rig.T)
    np.testing.assert_array_equal(storage.getNode("D1").mat().ravel(), rig.left.dist)


def test_calibrate_writes_report_and_figures(calibrated: Path) -> None:
    written = names(calibrated)
    assert written >= {"calibration.json", "calibration.yml", "report.html", "report.json"}
    assert written >= {f"figures/{name}.png" for name in ("corners_left", "corners_right", "rectified_pair", "rig")}
    page = (calibrated / "report.html").read_text()
    assert "<html" in page
    assert 'src="http' not in page
    report = json.loads((calibrated / "report.json").read_text())
    assert report


def test_calibrate_prints_the_next_command(run: Any, photographs: Path, tmp_path: Path) -> None:
    out = tmp_path / "my results"
    answer = run("calibrate", photographs / "left", photographs / "right", *BOARD, "--out", out)
    assert answer.code == 0
    assert answer.err == ""
    assert "5 of 5 pairs used" in answer.out
    assert "root mean square distance" in answer.out
    assert f"stereocal disparity '{out}/calibration.json' LEFT.jpg RIGHT.jpg" in answer.out


def test_calibrate_json_is_the_document_and_nothing_else(run: Any, photographs: Path, tmp_path: Path) -> None:
    words = ("calibrate", photographs / "left", photographs / "right", *BOARD, "--square", "1in", "--json")
    answer = run(*words, "--out", tmp_path / "a")
    assert answer.code == 0
    assert answer.err == ""
    saved = json.loads((tmp_path / "a" / "calibration.json").read_text())
    for key in ("pairs", "pairs_used", "rms", "left", "right", "R", "T", "baseline", "square_size", "inner_corners"):
        assert answer.json[key] == saved[key], key
    assert answer.json["square_size"] == pytest.approx(25.4)
    again = run(*words, "--out", tmp_path / "b").json
    for key in ("left", "right", "R", "T", "rms"):
        assert again[key] == answer.json[key], "results depend on the order in which threads finish"


def test_side_by_side_frames_calibrate_to_the_same_rig(
    run: Any, photographs: Path, calibrated: Path, tmp_path: Path
) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    for path in sorted((photographs / "left").iterdir()):
        halves = [np.asarray(Image.open(photographs / side / path.name)) for side in ("left", "right")]
        Image.fromarray(np.hstack(halves)).save(frames / path.name)
    answer = run("calibrate", frames, "--side-by-side", *BOARD, "--square", "25mm", "--out", tmp_path / "o", "--json")
    saved = json.loads((calibrated / "calibration.json").read_text())
    assert answer.json["T"] == saved["T"]
    assert answer.json["left"]["K"] == saved["left"]["K"]


def test_swapped_cameras_are_named_and_swap_puts_them_right(
    run: Any, photographs: Path, calibrated: Path, tmp_path: Path
) -> None:
    wrong = (photographs / "right", photographs / "left", *BOARD, "--square", "25mm")
    answer = run("calibrate", *wrong, "--out", tmp_path / "wrong")
    assert "warning: The cameras are swapped" in answer.out
    assert "--swap" in answer.out
    mended = run("calibrate", *wrong, "--swap", "--out", tmp_path / "o", "--json").json
    saved = json.loads((calibrated / "calibration.json").read_text())
    assert mended["T"] == saved["T"]
    assert mended["left"]["K"] == saved["left"]["K"]


def test_the_boards_shape_can_be_an_unknown(run: Any, photographs: Path, calibrated: Path, tmp_path: Path) -> None:
    words = ("calibrate", photographs / "left", photographs / "right", *BOARD, "--board-warp", "bow", "--json")
    answer = run(*words, "--out", tmp_path / "o")
    saved = json.loads((calibrated / "calibration.json").read_text())
    assert saved["board_shape"] == "flat"
    assert saved["board_points"] is None
    assert answer.json["board_shape"] == "bow"
    assert np.shape(answer.json["board_points"]) == (30, 3)
    assert answer.json["rms"] <= saved["rms"]


def test_a_scene_adds_its_block_and_the_papers_sweep(run: Any, photographs: Path, tmp_path: Path) -> None:
    scene = (photographs / "scene" / "left.png", photographs / "scene" / "right.png")
    words = ("calibrate", photographs / "left", photographs / "right", *BOARD, "--scene", *scene)
    assert run(*words, "--out", tmp_path / "o").code == 0
    figures = {path.name for path in (tmp_path / "o" / "figures").iterdir()}
    assert {"scene_disparity.png", "scene_rectified.png", "sweep_windows.png", "sweep_speckles.png"} <= figures
    document = json.loads((tmp_path / "o" / "report.json").read_text())
    assert any(verdict["block"] == "disparity" for verdict in document["verdicts"])


def test_a_pair_without_a_board_is_left_out_with_the_reason(run: Any, copy: Path, tmp_path: Path) -> None:
    scene = Image.open(copy / "scene" / "left.png").convert("L")
    scene.save(copy / "left" / "03.png")
    answer = run("calibrate", copy / "left", copy / "right", *BOARD, "--out", tmp_path / "o", "--json")
    assert answer.json["pairs_used"] == 4
    left_out = answer.json["pairs"][2]
    assert left_out["used"] is False
    assert "no 6x5 board in the left photograph" in left_out["reason"]


def test_rectify_puts_points_on_one_row(run: Any, photographs: Path, calibrated: Path, tmp_path: Path) -> None:
    answer = run(
        "rectify", calibrated / "calibration.json", photographs / "left", photographs / "right",
        "--out", tmp_path / "r", "--json",
    )  # fmt: skip
    assert answer.code == 0
    assert answer.json["pairs"] == 5
    assert names(tmp_path / "r") == {
        f"{kind}_{k:02d}.png" for kind in ("left", "right", "epipolar") for k in range(1, 6)
    } | {"rectification.json"}
    board = sc.Chessboard((6, 5), 25.0)
    differences = []
    for k in range(1, 6):
        pair = [sc.read_image(tmp_path / "r" / f"{side}_{k:02d}.png") for side in ("left", "right")]
        left, right = (sc.detect_chessboard(image, board) for image in pair)
        if left is not None and right is not None:
            differences.append(left[:, 1] - right[:, 1])
    assert len(differences) >= 3
    assert np.abs(np.concatenate(differences)).max() < 0.2


@pytest.mark.parametrize("method", ["sad", "bm", "census", "sgm"])
def test_disparity_is_near_the_truth(
    run: Any, photographs: Path, calibrated: Path, rendered: SyntheticRig, tmp_path: Path, method: str
) -> None:
    from stereocal.workflow.demonstration import disparity_errors
    from stereocal.workflow.rectified_pairs import load_rig, rectify_for_viewing

    scene = photographs / "scene"
    answer = run(
        "disparity", calibrated / "calibration.json", scene / "left.png", scene / "right.png",
        "--method", method, "--num-disparities", 48, "--out", tmp_path / "d", "--json",
    )  # fmt: skip
    assert answer.code == 0
    assert names(tmp_path / "d") == {
        "cloud.ply", "depth.pfm", "disparity.pfm", "disparity.png", "disparity_color.png", "disparity_figure.png",
        "left_rectified.png", "rectification.json",
    }  # fmt: skip
    assert {Path(name).name for name in answer.json["files"]} == names(tmp_path / "d")
    disparity = read_disparity(tmp_path / "d" / "disparity.pfm")
    assert answer.json["density"] == pytest.approx(np.isfinite(disparity).mean())
    assert answer.json["seconds"] > 0
    errors = disparity_errors(rendered, rectify_for_viewing(load_rig(calibrated / "calibration.json")), disparity)
    assert np.nanmedian(np.abs(errors.in_map)) < 0.5
    # the 16-bit file holds the same to 1/512 px
    coarse = read_disparity(tmp_path / "d" / "disparity.png")
    both = np.isfinite(coarse)
    np.testing.assert_array_equal(both, np.isfinite(disparity))
    np.testing.assert_allclose(coarse[both], disparity[both], atol=1 / 256)
    # depth and cloud are of the same map
    depth = read_pfm(tmp_path / "d" / "depth.pfm")
    near = np.isfinite(depth) & (disparity >= 1)
    points, colours = read_ply(tmp_path / "d" / "cloud.ply")
    assert len(points) == answer.json["points"] == np.count_nonzero(near)
    assert colours is not None
    np.testing.assert_array_equal(np.sort(points[:, 2]), np.sort(depth[near]))


@pytest.mark.parametrize("least", [-8, 260])
def test_disparities_that_sixteen_bits_cannot_hold(
    run: Any, photographs: Path, calibrated: Path, tmp_path: Path, least: int
) -> None:
    """As of cameras of 12 megapixels: the rest is written, and what is left out is said."""
    scene = photographs / "scene"
    answer = run(
        "disparity", calibrated / "calibration.json", scene / "left.png", scene / "right.png", "--method", "sad",
        "--min-disparity", least, "--num-disparities", 8, "--speckle-size", 0, "--out", tmp_path / "d", "--json",
    )  # fmt: skip
    assert answer.code == 0
    assert "disparity.png" not in names(tmp_path / "d")
    disparity = read_disparity(tmp_path / "d" / "disparity.pfm")
    assert least <= np.nanmin(disparity) < np.nanmax(disparity) < least + 8
    assert any("read disparity.pfm" in warning for warning in answer.json["warnings"])


def test_disparity_reads_opencvs_file_as_well(run: Any, photographs: Path, calibrated: Path, tmp_path: Path) -> None:
    scene = photographs / "scene"
    maps = []
    for name in ("calibration.json", "calibration.yml"):
        out = tmp_path / name
        answer = run(
            "disparity", calibrated / name, scene / "left.png", scene / "right.png", "--method", "bm", "--out", out
        )
        assert answer.code == 0
        maps.append(read_disparity(out / "disparity.pfm"))
    np.testing.assert_array_equal(maps[0], maps[1])


def test_sweep_writes_table_and_figures_and_resumes(
    run: Any, photographs: Path, calibrated: Path, tmp_path: Path
) -> None:
    scene = photographs / "scene"
    words = ("sweep", calibrated / "calibration.json", scene / "left.png", scene / "right.png", "--out", tmp_path / "s")
    first = run(*words, "--blocks", "5:17:4", "--speckles", "0:50:50", "--json")
    assert first.code == 0
    assert first.json["cells"] == 8
    assert {"sweep.csv", "figure7.png", "figure8.png"} <= names(tmp_path / "s")
    again = run(*words, "--blocks", "5:21:4", "--speckles", "0:50:50", "--json")
    assert again.json["cells"] == 10
    assert again.json["resumed"] == 4


def test_convert_names_what_changes_its_meaning(run: Any, calibrated: Path, tmp_path: Path) -> None:
    answer = run("convert", calibrated / "calibration.json", tmp_path / "rig.xml", "--json")
    assert answer.code == 0
    assert answer.json["format"] == "stereocal"
    assert any("unit" in remark for remark in answer.json["remarks"])
    rig = sc.load_calibration(calibrated / "calibration.json")
    np.testing.assert_array_equal(sc.load_calibration(tmp_path / "rig.xml").T, rig.T)
    refused = run("convert", calibrated / "calibration.json", tmp_path / "camchain.yaml", "--to", "kalibr")
    assert refused.code == 1
    assert "k3" in refused.err
    assert not (tmp_path / "camchain.yaml").exists()


def test_fetch_finds_what_is_there_already(run: Any, data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STEREOCAL_DATA", str(data))
    answer = run("fetch", "opencv_sample", "--json")
    assert answer.code == 0
    assert answer.json["downloaded"] is False
    assert len(answer.json["left"]) == len(answer.json["right"]) == 13
    unknown = run("fetch", "nonsense")
    assert unknown.code == 1
    assert "opencv_sample" in unknown.err


@pytest.mark.parametrize("name", ["ros", "mrcal"])
def test_crosscheck_judges_files_of_other_tools_in_the_unit_of_the_board(
    run: Any, photographs: Path, calibrated: Path, tmp_path: Path, name: str
) -> None:
    """ROS has metres, the board millimetres; both are folders. The calibration stays at its optimum."""
    assert run("convert", calibrated, tmp_path / "rig", "--to", name).code == 0
    words = ("--left", photographs / "left", "--right", photographs / "right", *BOARD, "--square", "25mm")
    answer = run("crosscheck", tmp_path / "rig", *words, "--json")
    assert answer.code == 0
    judged = next(step for step in answer.json["steps"] if step["step"] == "the given calibration")
    assert judged["agrees"]
    assert "It is at the optimum" in judged["finding"]
    exchanged = ("--left", photographs / "right", "--right", photographs / "left", *BOARD, "--square", "25mm")
    if name == "ros":
        answer = run("crosscheck", tmp_path / "rig", *exchanged, "--json")
        judged = next(step for step in answer.json["steps"] if step["step"] == "the given calibration")
        assert "swapped" in judged["finding"]


def test_bench_compares_with_opencv(run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from stereocal.workflow import benchmarks

    chosen = benchmarks.chosen
    monkeypatch.setattr(benchmarks, "chosen", lambda *options: chosen(*options)[:2])
    answer = run("bench", "filter_speckles", "--markdown", tmp_path / "table.md", "--json")
    assert answer.code == 0
    assert len(answer.json) == 2
    for entry in answer.json:
        assert set(entry) >= {"kernel", "case", "ours_ms", "opencv_ms", "ratio", "agreement"}
        assert entry["ratio_low"] <= entry["ratio"] <= entry["ratio_high"]
        assert entry["kernel"] == "filter_speckles"
        assert entry["ratio"] == pytest.approx(entry["ours_ms"] / entry["opencv_ms"], rel=0.5)
    assert "\n| kernel |" in (tmp_path / "table.md").read_text()
    assert run("bench", "nonsense").code == 1
    (tmp_path / "mine.py").write_text("def mine(disparity, **options):\n    return disparity\n")
    answer = run(
        "bench", "--register", f"filter_speckles={tmp_path / 'mine.py'}:mine", "--figure", tmp_path / "bench.png"
    )
    assert answer.code == 0
    assert "yours" in answer.out
    assert (tmp_path / "bench.png").stat().st_size > 10_000


@pytest.mark.parametrize("ending", ["pdf", "svg", "png"])
def test_board_is_true_to_scale(run: Any, tmp_path: Path, ending: str) -> None:
    out = tmp_path / f"board.{ending}"
    answer = run("board", *BOARD, "--square", "2cm", "--paper", "A4", "--out", out, "--json")
    assert answer.code == 0
    assert answer.json["square_size"] == 20.0
    assert out.stat().st_size > 500
    if ending == "png":
        picture = Image.open(out)
        pixel = 25.4 / picture.info["dpi"][0]
        image = np.pad(np.asarray(picture.convert("L"))[::6, ::6], 20, constant_values=255)
        corners = sc.detect_chessboard(image, sc.Chessboard((6, 5)))
        assert corners is not None
        side = np.linalg.norm(corners[1] - corners[0]) * 6 * pixel
        assert side == pytest.approx(20.0, abs=0.1)


def test_demo_keeps_its_bounds(run: Any, tmp_path: Path) -> None:
    answer = run("demo", "--out", tmp_path / "demo", "--pairs", 4, "--json")
    assert answer.json["holds"], [check for check in answer.json["checks"] if not check["holds"]]
    assert answer.code == 0
    written = names(tmp_path / "demo")
    assert written >= {"calibration.json", "calibration.yml", "report.html", "report.json", "demo.json", "demo.png"}
    assert json.loads((tmp_path / "demo" / "demo.json").read_text())["holds"]


def test_demo_with_a_broken_bound_fails(
    run: Any, rendered: SyntheticRig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The comparison can fail: a calibration with a square that is wrong by 0.4 % is not within the bounds."""
    from stereocal.workflow import demonstration

    calibrate = demonstration.calibrate_rig

    def with_wrong_square(*words: Any, square: str, **options: Any) -> Any:
        return calibrate(*words, square="25.1mm", **options)

    monkeypatch.setattr(demonstration, "render_rig", lambda **_: rendered)
    monkeypatch.setattr(demonstration, "calibrate_rig", with_wrong_square)
    code = main(["demo", "--out", str(tmp_path / "demo"), "--json"])
    assert code == 1
    checks = json.loads((tmp_path / "demo" / "demo.json").read_text())["checks"]
    baseline = next(check for check in checks if check["measure"] == "baseline")
    assert not baseline["holds"]
    assert baseline["value"] == pytest.approx(0.4, abs=0.1)


@pytest.mark.parametrize("command", [name for name in app if not name.startswith("-")])
def test_every_command_has_help_with_an_example(run: Any, command: str) -> None:
    answer = run(command, "--help")
    assert answer.code == 0
    assert f"Example: stereocal {command}" in " ".join(answer.out.split())
    assert "--json" in answer.out


def test_the_command_as_a_process() -> None:
    version = subprocess.run(
        [sys.executable, "-m", "stereocal", "--version"], capture_output=True, text=True, check=True
    )
    assert version.stdout.strip() == sc.__version__
    wrong = subprocess.run([sys.executable, "-m", "stereocal", "nonsense"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2
    assert wrong.stdout == ""
    assert wrong.stderr.count("\n") == 1


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_a_reader_that_leaves_early_is_no_failure(photographs: Path, options: list[str]) -> None:
    words = [sys.executable, "-m", "stereocal", "detect", str(photographs / "left"), *BOARD, *options]
    job = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert job.stdout is not None
    job.stdout.close()
    _, err = job.communicate(timeout=120)
    assert job.returncode == 0
    assert err == ""
