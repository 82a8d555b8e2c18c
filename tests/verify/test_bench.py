"""The benchmarks measure what they say, take a user's function and photographs, and ask another environment."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

import stereocal as sc
from stereocal.verify import bench
from stereocal.verify.bench import (
    BenchCase,
    BenchResult,
    all_cases,
    describe_agreement,
    markdown_summary,
    markdown_table,
    run_case,
)
from stereocal.verify.benchmark_photographs import photograph_cases
from stereocal.verify.benchmark_worker import OtherEnvironment
from stereocal.verify.peak_memory import peak_megabytes
from stereocal.workflow.benchmarks import load_function, run_bench


@pytest.fixture(autouse=True)
def _nothing_registered():
    yield
    bench._REGISTERED.clear()


def _spin(rounds: int) -> float:
    return float(sum(k * k for k in range(rounds)))


def test_ratio_is_of_the_work_done_and_its_quartiles_hold_it():
    case = BenchCase("spin", "3 to 1", lambda: _spin(30_000), lambda: _spin(10_000), lambda a, b: "no")
    result = run_case(case, seconds=0.3)
    assert result.ratio_low <= result.ratio <= result.ratio_high
    assert 2 < result.ratio < 4.5
    assert result.ratio == pytest.approx(result.ours_ms / result.opencv_ms, rel=0.3)


def test_a_function_of_the_users_own_takes_its_turn():
    left = np.random.default_rng(0).integers(0, 255, (60, 80), dtype=np.uint8)
    seen = []

    def my_harris(image, **options):
        seen.append(options)
        return sc.harris_response(image)

    results = sc.run_benchmarks(["harris_response"], extra={"harris_response": my_harris}, left=left, seconds=0)
    assert len(seen) >= 6  # once before the clock starts, then every turn
    assert (results[0].extra, results[0].extra_agreement) == ("my_harris", "identical")
    assert results[0].extra_ms > 0
    assert "my_harris" in markdown_table(results)
    assert "yours" not in markdown_table(sc.run_benchmarks(["harris_response"], left=left, seconds=0))


def test_every_builtin_case_says_what_to_call_a_function_with():
    cases = all_cases()
    assert all(case.arguments is not None for case in cases)
    # one of each kernel, called as the user's function would be, gives what ours gives
    small = [case for case in cases if not any(word in case.case for word in ("1920", "1280", "100", "absent"))]
    for kernel, case in {case.kernel: case for case in reversed(small)}.items():
        positional, named = case.arguments()
        result = getattr(sc, kernel)(*positional, **named)
        agreement = describe_agreement(case.ours(), result)
        assert agreement == "identical" or kernel == "rectify", kernel


@pytest.mark.parametrize(
    ("ours", "theirs", "words"),
    [
        (np.array([1.0, np.nan]), np.array([1.0, np.nan]), "identical"),
        (np.array([1.0, np.nan]), np.array([1.5, np.nan]), "max |Δ| 0.5"),
        (np.array([1.0, 2.0]), np.array([1.0, np.nan]), "max |Δ| 0; 50 % answered by one only"),
        (np.zeros(3), np.zeros(4), "shapes (3,) and (4,)"),
        ((np.zeros(2), np.ones(2)), (np.zeros(2), np.zeros(2)), "identical; max |Δ| 1"),
        (0.25, 0.25, "identical"),
        (np.zeros(2), None, "shapes (2,) and ()"),
        (np.zeros(2), object(), "not compared: ndarray and object"),
    ],
)
def test_agreement_in_words(ours, theirs, words):
    assert describe_agreement(ours, theirs) == words


def test_on_photographs_of_the_users_own():
    rng = np.random.default_rng(0)
    left = cv2.GaussianBlur(rng.integers(0, 255, (120, 200), dtype=np.uint8), (0, 0), 1.2)
    cases = photograph_cases(left, np.roll(left, -5, axis=1))
    kernels = [case.kernel for case in cases]
    assert kernels == [
        "harris_response",
        "undistortion_maps",
        "remap",
        "match_bm",
        "match_sad",
        "match_sgm",
        "filter_speckles",
    ]
    exact = {"match_bm", "match_sad", "filter_speckles"} | ({"remap"} if cv2.__version__ >= "5" else set())
    for case in cases:
        words = case.agreement(case.ours(), case.opencv())
        assert words == "identical" or case.kernel not in exact, (case.kernel, words)
        assert "200x120" in case.case
    for wrong in ((None, left), (left, left[:, :100]), (left[:10], left[:10])):
        with pytest.raises(sc.InputError):
            photograph_cases(*wrong)


def test_memory_is_what_the_call_takes():
    measured = peak_megabytes(lambda: np.ones(8_000_000))
    if not Path("/proc/self/clear_refs").exists():
        assert measured is None
        return
    assert 60 < measured < 75
    assert peak_megabytes(lambda: None) < 10


def test_another_environment_runs_the_same_case():
    case = next(case for case in all_cases(["filter_speckles"]) if case.case == "flat 640x480")
    with OtherEnvironment(sys.executable, ["filter_speckles"], seconds=0.01) as other:
        assert other.opencv_version == cv2.__version__
        there = other.run(case)
        assert (there.kernel, there.case, there.agreement) == (case.kernel, case.case, "identical")
        assert other.run(BenchCase("x", "y", lambda: 0, lambda: 0, lambda a, b: "")) is None


@pytest.mark.parametrize(("python", "words"), [("/no/python", "cannot be started"), ("/bin/false", "cannot run the")])
def test_an_environment_that_cannot_answer_is_named(python, words):
    with pytest.raises(sc.InputError, match=words):
        OtherEnvironment(python)


def test_functions_are_registered_by_name_by_path_and_by_decorator(tmp_path, monkeypatch):
    (tmp_path / "kernels_of_mine.py").write_text(
        "from stereocal.verify.bench import register\n"
        "@register('remap')\n"
        "def decorated(image, x, y, **options):\n    return image\n"
        "def plain(disparity, **options):\n    return disparity\n"
    )
    (tmp_path / "broken.py").write_text("import no_such_module\n")
    monkeypatch.chdir(tmp_path)
    load_function("filter_speckles=kernels_of_mine.py:plain")
    assert bench.registered()["filter_speckles"].__name__ == "plain"
    assert bench.registered()["remap"].__name__ == "decorated"
    load_function("match_bm=kernels_of_mine:plain")
    assert bench.registered()["match_bm"].__name__ == "plain"
    for words, sentence in (
        ("kernels_of_mine.py:missing", "has no function missing"),
        ("broken.py", "cannot be imported: ModuleNotFoundError"),
        ("no_such_thing:f", "cannot be imported"),
        ("json", "registers nothing"),
    ):
        with pytest.raises(sc.InputError, match=sentence):
            load_function(words)
    assert str(tmp_path) not in sys.path


def test_run_writes_a_picture_and_a_table(tmp_path):
    from PIL import Image

    rng = np.random.default_rng(0)
    image = cv2.GaussianBlur(rng.integers(0, 255, (60, 90), dtype=np.uint8), (0, 0), 1.0)
    for side in ("left", "right"):
        cv2.imwrite(str(tmp_path / f"{side}.png"), image)
    run = run_bench(
        left=tmp_path / "left.png", right=tmp_path / "right.png", seconds=0,
        markdown=tmp_path / "t.md", figure=tmp_path / "f.png",
    )  # fmt: skip
    assert [file.name for file in run.files] == ["t.md", "f.png"]
    table = (tmp_path / "t.md").read_text().splitlines()
    assert table[0] == run.machine
    assert cv2.__version__ in run.machine
    assert len(table) == 2 + (2 + 7) + 3 + 2 + len(run.results)  # machine, a row a kernel, heading, a row a case
    with Image.open(tmp_path / "f.png") as picture:
        assert min(picture.size) > 300
    json.dumps(run.as_list())
    with pytest.raises(sc.InputError, match=r"\.png, \.svg or \.pdf"):
        run_bench(["remap"], figure=tmp_path / "f.gif")
    with pytest.raises(sc.InputError, match="leave out --left"):
        run_bench(left=tmp_path / "left.png", other_pythons=[sys.executable])


def _result(kernel: str, case: str, **more: object) -> BenchResult:
    return BenchResult(kernel, case, 1.0, 4.0, 0.25, "identical", 0.24, 0.27, **more)


def test_summary_has_a_row_a_kernel_and_a_column_an_opencv():
    rows = [_result("remap", "a"), _result("remap", "b"), _result("match_bm", "c")]
    rows[1] = BenchResult("remap", "b", 3.0, 4.0, 0.75, "identical", 0.7, 0.8)
    lines = markdown_summary({"5.0.0": rows, "4.14.0": [rows[0], None, None]}).splitlines()
    assert lines[2] == "| remap | 2 | 0.50 (0.25–0.75) | 0.25 |"
    assert lines[3] == "| match_bm | 1 | 0.25 | – |"


def test_summary_keeps_opponents_apart_and_small_ratios_legible():
    rows = [_result("detect", "640x480, against slow"), _result("detect", "640x480, against fast")]
    rows[0] = BenchResult("detect", "640x480, against slow", 1.0, 200.0, 0.0049, "identical", 0.0, 0.1)
    assert markdown_summary({"5.0.0": rows}).splitlines()[2:] == [
        "| detect, against slow | 1 | 0.0049 |",
        "| detect, against fast | 1 | 0.25 |",
    ]


def test_readme_shows_the_table_that_bench_wrote():
    root = Path(__file__).parents[2]
    summary = (root / "docs" / "performance_table.md").read_text(encoding="utf-8").split("\n\n")[1]
    assert summary.startswith("| kernel | cases |")
    assert summary in (root / "README.md").read_text(encoding="utf-8")


def test_curves_are_of_cases_that_differ_in_one_thing():
    from stereocal.report.figures_benchmarks import (
        _DISPARITIES,
        _SIZE,
        BenchColumn,
        _megapixels,
        _number,
        _series,
        draw_benchmarks,
    )

    cases = [
        "640x480, D 64, block 5",
        "640x480, D 64, block 21",
        "640x480, D 128, block 21",
        "1280x960, D 64, block 21",
    ]
    rows = [_result("match_bm", case).as_dict() for case in cases]
    assert [x for x, _, _ in _series(rows, _number(_DISPARITIES), (_DISPARITIES,))["match_bm"]] == [64, 128]
    assert [x for x, _, _ in _series(rows, _megapixels, (_SIZE,))["match_bm"]] == [0.3072, 1.2288]
    assert _series(rows[:2], _megapixels, (_SIZE,)) == {}
    figure = draw_benchmarks([BenchColumn("OpenCV 5.0.0", tuple(rows)), BenchColumn("OpenCV 4.14.0", ({}, *rows[1:]))])
    assert len(figure.axes) == 3


@pytest.mark.parametrize("width", [80, 100, 120, 200])
def test_table_fits_the_terminal(width):
    from rich.console import Console

    from stereocal.cli.bench_table import BenchTable
    from stereocal.workflow.benchmarks import BenchRun, OtherResults

    rows = (
        _result("detect_chessboard", "640x480, against findChessboardCorners", ours_mb=1.0, opencv_mb=900.0),
        _result("remap", "640x480", extra="mine", extra_ms=3.0, extra_ratio=0.5, extra_agreement="max |Δ| 2"),
    )
    run = BenchRun(rows, "a machine", (), "5.0.0", (OtherResults("python", "4.14.0", (rows[0], None)),))
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(BenchTable(run))
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    assert "0.25" in text
    assert "findChessboardCorners" in text
    assert ("900" in text) == (width >= 100)
