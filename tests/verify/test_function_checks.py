from __future__ import annotations

import re

import numpy as np
import pytest

import stereocal as sc
from stereocal.verify.function_cases import CASES
from stereocal.verify.function_checks import check_function

pytest_plugins = ["pytester"]


@pytest.mark.parametrize("kernel", sorted(CASES))
def test_our_own_function_agrees_with_both_oracles(kernel: str) -> None:
    for against in ("stereocal", "opencv"):
        report = check_function(kernel, CASES[kernel].stereocal, against=against)
        assert report.agrees, str(report)


@pytest.mark.parametrize(
    ("kernel", "sentence", "mistaken"),
    [(kernel, sentence, mistaken) for kernel, case in CASES.items() for sentence, mistaken in case.mistakes],
)
def test_each_known_mistake_is_named(kernel: str, sentence: str, mistaken) -> None:
    report = check_function(kernel, mistaken)
    assert not report.agrees
    assert report.explanation == sentence


def test_no_homography_of_opencv_has_a_lower_cost_than_ours() -> None:
    rng, case = np.random.default_rng(0), CASES["fit_homography"]

    def cost(H: np.ndarray, src: np.ndarray, dst: np.ndarray) -> float:
        p = np.column_stack([src, np.ones(len(src))]) @ H.T
        return float(np.sum((p[:, :2] / p[:, 2:] - dst) ** 2))

    for _ in range(20):
        src, dst = case.draw(rng)
        assert cost(case.stereocal(src, dst), src, dst) <= cost(case.opencv(src, dst), src, dst) * (1 + 1e-12)


def response(image, block_size, k):
    return sc.harris_response(image, block_size=block_size, k=k)


@pytest.mark.parametrize(
    ("kernel", "function", "words"),
    [
        ("harris_response", lambda i, b, k: 255 * response(i, b, k), "constant factor"),
        ("harris_response", lambda i, b, k: response(i, b, k).T, "transposed"),
        ("harris_response", lambda i, b, k: np.roll(response(i, b, k), 1, 1), "shifted by 1 pixels in x"),
        ("harris_response", lambda i, b, k: np.pad(response(i, b, k)[4:-4, 4:-4], 4), "border only"),
        ("harris_response", lambda i, b, k: response(i, b, k) + (response(i, b, k) > 0) * 1e-3, "of the values differ"),
        ("rotation_matrix", lambda r: sc.rotation_matrix(r).T, "transposed"),
        ("rotation_matrix", lambda r: np.eye(4), r"shape \(4, 4\), but \(3, 3\) is needed"),
        ("project_points", lambda *a: sc.project_points(*a)[:, ::-1], "swapped"),
        ("project_points", lambda *a: sc.project_points(*a) + 1, r"shifted by \(-1, -1\) everywhere"),
        ("rotation_matrix", lambda r: 1 / 0, "raised ZeroDivisionError"),
        ("undistort_points", lambda p, K, dist: np.full_like(p, np.nan), "of the values differ"),
    ],
)
def test_usual_mistakes_are_named(kernel: str, function, words: str) -> None:
    report = check_function(kernel, function)
    assert not report.agrees
    assert report.difference > report.tolerance
    assert re.search(words, report.explanation), report.explanation


def test_the_function_cannot_spoil_the_input() -> None:
    def spoils(image, block_size, k):
        result = response(image, block_size, k)
        image[:] = 0
        return result

    assert check_function("harris_response", spoils).agrees


def test_unknown_kernel_names_the_known_ones() -> None:
    with pytest.raises(sc.InputError, match="harris_response"):
        check_function("hariss", response)


def test_the_fixture_serves_another_test_suite(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        import numpy as np
        import stereocal as sc

        def test_right(stereocal_check):
            assert stereocal_check("rotation_matrix", sc.rotation_matrix).cases == 12

        def test_wrong(stereocal_check):
            stereocal_check("rotation_matrix", lambda rvec: np.eye(3))
        """
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")  # the entry point brings the fixture
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*rotation_matrix: DIFFERS*"])
