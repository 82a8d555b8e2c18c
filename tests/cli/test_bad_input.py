"""What bad input gets: one sentence that names the file, the right exit code, and nothing half-written.

The list is the interface's. ``run`` (conftest) checks for every failure: exactly one line on standard error, nothing on
standard output, no traceback. Here each case checks the code, the sentence, and that the output folder is as it was.
"""

from __future__ import annotations

import json
import os
import re
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from stereocal.store.images import write_image

BOARD = ("--inner-corners", "6x5")
Damage = Callable[[Path], None]


def everything(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """An output folder with results of an earlier job."""
    folder = tmp_path / "results"
    (folder / "figures").mkdir(parents=True)
    (folder / "calibration.json").write_text("earlier")
    (folder / "figures" / "rig.png").write_text("earlier")
    return folder


def keep_first_bytes(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def make_empty(path: Path) -> None:
    path.write_bytes(b"")


def make_text(path: Path) -> None:
    path.write_text("this is no image\n")


def make_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def remove(path: Path) -> None:
    path.unlink()


def make_bomb(path: Path) -> None:
    """A PNG whose header claims 60000x60000 pixels."""
    import struct
    import zlib

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 100)))


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (remove, "does not exist|cannot be read"),
        (make_empty, r"is empty \(0 bytes\)"),
        (keep_first_bytes, "is damaged or cut short"),
        (make_text, "is not an image"),
        (make_folder, "is a folder|holds no photographs"),
        (make_bomb, "60000x60000 pixels|more than"),
    ],
)
@pytest.mark.parametrize("command", ["detect", "rectify", "disparity"])
def test_a_photograph_that_cannot_be_used(
    run: Any, copy: Path, calibrated: Path, results: Path, command: str, damage: Damage, sentence: str
) -> None:
    bad = copy / "scene" / "left.png"
    damage(bad)
    before = everything(results)
    calibration = (calibrated / "calibration.json",)
    words: dict[str, tuple[object, ...]] = {
        "detect": (bad, *BOARD, "--draw", results),
        "rectify": (*calibration, bad, copy / "scene" / "right.png", "--out", results),
        "disparity": (*calibration, bad, copy / "scene" / "right.png", "--out", results),
    }
    answer = run(command, *words[command])
    assert answer.code == 1
    assert str(bad) in answer.err
    assert re.search(sentence, answer.err), answer.err
    assert everything(results) == before


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (make_empty, r"is empty \(0 bytes\)"),
        (keep_first_bytes, "is damaged or cut short"),
        (make_text, "is not an image"),
        (remove, "has no partner"),
        (lambda path: Image.new("L", (200, 150)).save(path), "is 200x150, but most photographs are 320x240"),
    ],
)
def test_calibrate_stops_at_a_bad_photograph_and_says_how_to_go_on(
    run: Any, copy: Path, results: Path, damage: Damage, sentence: str
) -> None:
    bad, partner = copy / "left" / "02.png", copy / "right" / "02.png"
    damage(bad)
    before = everything(results)
    words = ("calibrate", copy / "left", copy / "right", *BOARD, "--out", results)
    answer = run(*words)
    assert answer.code == 1
    assert str(partner if damage is remove else bad) in answer.err
    assert re.search(sentence, answer.err), answer.err
    assert "--skip-bad" in answer.err
    assert everything(results) == before
    skipped = run(*words, "--skip-bad", "--json")
    assert skipped.code == 0
    assert skipped.json["pairs_used"] == 4
    assert re.search(sentence, skipped.json["skipped"][0])


@pytest.mark.parametrize(
    "mode", ["16-bit grey", "16-bit colour", "RGBA", "palette", "grey with alpha", "1 channel jpeg"]
)
def test_unusual_images_are_read_as_they_are(
    run: Any, copy: Path, photographs: Path, tmp_path: Path, mode: str
) -> None:
    """What can be used is used: the corners are those of the plain image."""
    source = copy / "left" / "01.png"
    plain = Image.open(source).convert("L")
    target = tmp_path / "unusual.png"
    if mode == "16-bit grey":
        Image.fromarray(np.asarray(plain).astype(np.uint16) * 257).save(target)
    elif mode == "16-bit colour":
        write_image(target, np.repeat(np.asarray(plain)[..., None], 3, axis=2).astype(np.uint16) * 257)
    elif mode == "RGBA":
        plain.convert("RGBA").save(target)
    elif mode == "palette":
        plain.convert("P").save(target)
    elif mode == "grey with alpha":
        plain.convert("LA").save(target)
    else:
        target = target.with_suffix(".jpg")
        plain.save(target, quality=98)
    answer = run("detect", source, target, *BOARD, "--json")
    assert answer.code == 0
    plain_corners, corners = (np.array(entry["corners"]) for entry in answer.json)
    np.testing.assert_allclose(corners, plain_corners, atol=0.05 if mode == "1 channel jpeg" else 1e-3)


def test_left_and_right_of_unequal_size(run: Any, copy: Path, calibrated: Path, results: Path) -> None:
    right = copy / "scene" / "right.png"
    Image.open(right).resize((160, 120)).save(right)
    before = everything(results)
    answer = run("disparity", calibrated / "calibration.json", copy / "scene" / "left.png", right, "--out", results)
    assert answer.code == 1
    assert f"{right}: is 160x120, but its left photograph is 320x240" in answer.err
    assert everything(results) == before


def test_photographs_of_another_size_than_the_rig(run: Any, copy: Path, calibrated: Path, results: Path) -> None:
    for side in ("left", "right"):
        path = copy / "scene" / f"{side}.png"
        Image.open(path).resize((160, 120)).save(path)
    scene = copy / "scene"
    before = everything(results)
    for command in ("disparity", "rectify"):
        answer = run(
            command, calibrated / "calibration.json", scene / "left.png", scene / "right.png", "--out", results
        )
        assert answer.code == 1
        assert "left.png: is 160x120, but the calibration is of 320x240 images" in answer.err
    assert everything(results) == before


def test_unpaired_files(run: Any, copy: Path, results: Path) -> None:
    for k, path in enumerate(sorted((copy / "right").iterdir())):
        path.rename(path.with_name(f"IMG_{chr(97 + k)}.png"))
    (copy / "right" / "IMG_a.png").unlink()
    before = everything(results)
    answer = run("calibrate", copy / "left", copy / "right", *BOARD, "--out", results)
    assert answer.code == 1
    assert "5 photographs left and 4 right" in answer.err
    assert everything(results) == before


def test_a_board_that_is_never_found(run: Any, copy: Path, results: Path) -> None:
    for folder, source in ((copy / "left", "left.png"), (copy / "right", "right.png")):
        for path in folder.iterdir():
            Image.open(copy / "scene" / source).save(path)
    before = everything(results)
    answer = run("calibrate", copy / "left", copy / "right", *BOARD, "--out", results)
    assert answer.code == 1
    assert "only 0 of 5 pairs can be used, and at least 3 are needed" in answer.err
    assert "check --inner-corners" in answer.err
    assert everything(results) == before


def test_a_board_found_in_fewer_than_three_pairs(run: Any, copy: Path, results: Path) -> None:
    for name in ("01.png", "02.png", "03.png"):
        Image.open(copy / "scene" / "left.png").save(copy / "left" / name)
    answer = run("calibrate", copy / "left", copy / "right", *BOARD, "--out", results)
    assert answer.code == 1
    assert "only 2 of 5 pairs can be used, and at least 3 are needed" in answer.err


def test_the_wrong_number_of_inner_corners(run: Any, photographs: Path, results: Path) -> None:
    before = everything(results)
    words = ("calibrate", photographs / "left", photographs / "right", "--out", results)
    answer = run(*words, "--inner-corners", "7x6")
    assert answer.code == 1
    assert "--inner-corners 6x5" in answer.err
    assert everything(results) == before


def test_views_that_are_all_parallel(run: Any, tmp_path: Path, results: Path) -> None:
    """Zhang's equations do not determine the focal length when no view is tilted."""
    from stereocal.board.chessboard import Chessboard
    from stereocal.synthetic.rig import render_rig

    render_rig(
        seed=1, pairs=4, tilt=0.0, image_size=(320, 240), board=Chessboard((6, 5), 25.0), scene=False
    ).save_images(tmp_path / "flat")
    before = everything(results)
    answer = run("calibrate", tmp_path / "flat" / "left", tmp_path / "flat" / "right", *BOARD, "--out", results)
    assert answer.code == 1
    assert re.search("parallel|tilt", answer.err), answer.err
    assert everything(results) == before


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--square", "0"], "--square must be above 0"),
        (["--square", "-25mm"], "--square must be above 0"),
        (["--square", "nan"], "--square must be above 0"),
        (["--square", "25 furlongs"], "unknown unit"),
        (["--inner-corners", "6"], "--inner-corners must be COLUMNSxROWS"),
        (["--inner-corners", "1x5"], "--inner-corners must be from 2x2"),
        (["--model", "magic"], "Invalid value"),
        (["--bogus", "1"], "Unknown option"),
        (["--max-tilt"], "requires an argument"),
        (["extra.png"], "too many arguments"),
        (["--side-by-side"], "give LEFT and RIGHT, or one folder and --side-by-side"),
    ],
)
def test_wrong_usage_of_calibrate(run: Any, photographs: Path, results: Path, words: list[str], sentence: str) -> None:
    before = everything(results)
    positional = [photographs / "left", photographs / "right"]
    options = [] if "--inner-corners" in words else list(BOARD)
    answer = run("calibrate", *positional, *options, *words, "--out", results)
    assert answer.code == 2
    assert sentence in answer.err
    assert "stereocal calibrate --help" in answer.err
    assert everything(results) == before


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--method", "magic"], "Invalid value"),
        (["--block-size", "20"], "--block-size must be odd"),
        (["--block-size", "0"], "--block-size must be from 1 to 255"),
        (["--num-disparities", "0"], "--num-disparities must be from 1"),
        (["--num-disparities", "many"], "Invalid value"),
        (["--speckle-size", "-1"], "--speckle-size must be at least 0"),
    ],
)
def test_wrong_usage_of_disparity(
    run: Any, photographs: Path, calibrated: Path, words: list[str], sentence: str
) -> None:
    scene = photographs / "scene"
    answer = run("disparity", calibrated / "calibration.json", scene / "left.png", scene / "right.png", *words)
    assert answer.code == 2
    assert sentence in answer.err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["nonsense"], "Unknown command"),
        (["detect"], "requires an argument"),
        (["detect", "x.png"], "requires an argument|--inner-corners"),
        (["rectify", "c.json", "l.png", "r.png", "--alpha", "7"], "--alpha must be from 0"),
        (["board", "--square", "80mm", "--paper", "A6"], "does not fit"),
        (["board", "--paper", "papyrus"], "paper must be one of"),
        (["board", "--out", "board.gif"], r"\.pdf, \.svg or \.png"),
        (["sweep", "c.json", "l.png", "r.png", "--blocks", "9:5"], "--blocks is an empty range"),
    ],
)
def test_wrong_usage(run: Any, words: list[str], sentence: str) -> None:
    answer = run(*words)
    assert answer.code == 2
    assert re.search(sentence, answer.err), answer.err


def cut_short(path: Path) -> None:
    path.write_text(path.read_text()[:600])


def write(text: str) -> Damage:
    return lambda path: path.write_text(text) and None


def put_nan(path: Path) -> None:
    document = json.loads(path.read_text())
    document["left"]["K"][0][0] = None
    path.write_text(json.dumps(document).replace("null", "NaN"))


def put_no_rotation(path: Path) -> None:
    document = json.loads(path.read_text())
    document["R"][0][0] = 3.0
    path.write_text(json.dumps(document))


def nest_deeply(path: Path) -> None:
    path.write_text("[" * 200_000)


TAG = '%YAML:1.0\n---\nM1: !!python/object/apply:os.system ["touch HACKED"]\n'
LAUGHS = "%YAML:1.0\n---\na: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{b}: &{b} [{','.join(['*' + a] * 9)}]\n" for a, b in zip("abcdefghij", "bcdefghijk", strict=True)
)


@pytest.mark.parametrize(
    ("damage", "name"),
    [
        (remove, "calibration.json"),
        (make_empty, "calibration.json"),
        (cut_short, "calibration.json"),
        (cut_short, "calibration.yml"),
        (make_text, "calibration.json"),
        (put_nan, "calibration.json"),
        (put_no_rotation, "calibration.json"),
        (nest_deeply, "calibration.json"),
        (write(TAG), "calibration.yml"),
        (write(LAUGHS), "calibration.yml"),
        (lambda path: path.write_bytes(b"\x80\x04\x95cos\nsystem\n(S'touch HACKED'\ntR."), "calibration.json"),
    ],
)
def test_a_calibration_that_is_cut_short_or_hostile(
    run: Any, photographs: Path, calibrated: Path, results: Path, tmp_path: Path, damage: Damage, name: str
) -> None:
    bad = tmp_path / "bad" / name
    bad.parent.mkdir()
    bad.write_bytes((calibrated / name).read_bytes())
    damage(bad)
    before = everything(results)
    scene = photographs / "scene"
    for command in ("disparity", "rectify"):
        answer = run(command, bad, scene / "left.png", scene / "right.png", "--out", results)
        assert answer.code == 1
        assert str(bad) in answer.err
    assert everything(results) == before
    assert not any("HACKED" in str(path) for path in [*tmp_path.rglob("*"), *Path.cwd().iterdir()])


def test_a_calibration_of_one_camera(run: Any, photographs: Path, calibrated: Path, tmp_path: Path) -> None:
    import stereocal as sc

    single = tmp_path / "single.json"
    sc.save_calibration(sc.load_calibration(calibrated / "calibration.json").left, single)
    scene = photographs / "scene"
    answer = run("disparity", single, scene / "left.png", scene / "right.png")
    assert answer.code == 1
    assert f"{single}: holds one camera" in answer.err


@pytest.mark.parametrize("command", ["calibrate", "rectify", "disparity", "detect", "board", "demo", "sweep"])
def test_an_output_folder_that_cannot_be_made(
    run: Any, photographs: Path, calibrated: Path, tmp_path: Path, command: str
) -> None:
    """A file stands where the folder should be: no user, not even root, can write there."""
    blocker = tmp_path / "blocker"
    blocker.write_text("mine")
    out = blocker / "out"
    calibration, scene = (
        calibrated / "calibration.json",
        (photographs / "scene" / "left.png", photographs / "scene" / "right.png"),
    )
    words: dict[str, tuple[object, ...]] = {
        "calibrate": (photographs / "left", photographs / "right", *BOARD, "--out", out),
        "rectify": (calibration, *scene, "--out", out),
        "disparity": (calibration, *scene, "--out", out),
        "detect": (photographs / "left", *BOARD, "--out", out / "corners.csv"),
        "board": ("--out", out / "board.pdf"),
        "demo": ("--out", out),
        "sweep": (calibration, *scene, "--out", out),
    }
    answer = run(command, *words[command])
    assert answer.code == 1
    assert str(blocker) in answer.err
    assert blocker.read_text() == "mine"


def test_a_full_disk(photographs: Path, results: Path) -> None:
    """No file may grow beyond 20 kB: the report cannot be written, and nothing else must have been."""
    before = everything(results)
    words = ["calibrate", photographs / "left", photographs / "right", *BOARD, "--out", results]
    job = subprocess.run(
        [sys.executable, "-m", "stereocal", *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
    )
    assert job.returncode == 1
    assert job.stdout == ""
    assert job.stderr.count("\n") == 1
    assert str(results) in job.stderr
    assert "File too large" in job.stderr
    assert everything(results) == before
    assert os.listdir(results.parent) == ["results"]


def test_termination_leaves_what_was_there(photographs: Path, results: Path) -> None:
    """SIGTERM in the middle of the work: the staging folder is gone, the old results are not."""
    before = everything(results)
    words = ["calibrate", photographs / "left", photographs / "right", *BOARD, "--out", results]
    job = subprocess.Popen(
        [sys.executable, "-m", "stereocal", *map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    try:
        while job.poll() is None and not list(results.glob(".stereocal-*")):
            pass
        job.terminate()
        job.communicate(timeout=60)
    finally:
        job.kill()
    assert job.returncode == 143
    assert everything(results) == before
    assert sorted(os.listdir(results)) == ["calibration.json", "figures"]


def test_debug_shows_the_traceback(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    from stereocal.cli.main import main

    assert main(["detect", str(tmp_path / "missing.png"), *BOARD, "--debug"]) == 1
    err = capfd.readouterr().err
    assert "Traceback" in err
    assert "missing.png: does not exist" in err


def test_crosscheck_says_what_is_missing(run: Any, photographs: Path, calibrated: Path, tmp_path: Path) -> None:
    left, right, file = photographs / "left", photographs / "right", calibrated / "calibration.yml"
    both = ("--left", left, "--right", right)
    (tmp_path / "empty").mkdir()
    for words, sentence in (
        ((tmp_path / "empty",), "holds no calibration"),
        ((file, "--right", right), "left photographs are missing"),
        ((file, *both), "add --inner-corners 9x6 --square 25mm"),
        ((file, "--left", left, "--right", tmp_path / "empty", *BOARD, "--square", "1"), "holds no photographs"),
        (
            (file, "--left", left, "--right", right, "--inner-corners", "8x7", "--square", "1"),
            "is it 8x7 inner corners",
        ),
        ((file, "--left", tmp_path / "nothing", "--right", right, *BOARD, "--square", "1"), "does not exist"),
    ):
        answer = run("crosscheck", *words)
        assert answer.code == 1
        assert sentence in answer.err, answer.err


def test_bench_says_what_is_wrong(run: Any, photographs: Path, tmp_path: Path) -> None:
    scene = photographs / "scene"
    for words, sentence in (
        (("remap", "--with", "/no/python"), "cannot be started"),
        (("remap", "--register", "remap=no_such_module:f"), "cannot be imported"),
        (("remap", "--figure", tmp_path / "f.gif"), ".png, .svg or .pdf"),
        (("--right", scene / "right.png"), "left photograph is missing"),
        (("calibrate_camera", "--left", scene / "left.png"), "no benchmark of calibrate_camera"),
        (("--left", scene / "left.png", "--with", "python"), "leave out --left"),
    ):
        answer = run("bench", *words)
        assert answer.code == 1
        assert sentence in answer.err, answer.err
    assert not list(tmp_path.iterdir())
