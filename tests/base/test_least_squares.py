"""The dense solver against SciPy's, on problems with known answers."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from strategies import seeds

from stereocal.base.errors import InputError
from stereocal.base.least_squares import central_differences, minimize_least_squares

PROBLEMS = {
    "rosenbrock": (lambda x: np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]]), [-1.2, 1.0], [1, 1]),
    "powell singular": (
        lambda x: np.array(
            [x[0] + 10 * x[1], np.sqrt(5) * (x[2] - x[3]), (x[1] - 2 * x[2]) ** 2, np.sqrt(10) * (x[0] - x[3]) ** 2]
        ),
        [3.0, -1, 0, 1],
        [0, 0, 0, 0],
    ),
    "helical valley": (
        lambda x: np.array(
            [
                10 * (x[2] - 10 * (np.arctan(x[1] / x[0]) / (2 * np.pi) + (0.5 if x[0] < 0 else 0.0))),
                10 * (np.hypot(x[0], x[1]) - 1),
                x[2],
            ]
        ),
        [-1.0, 0.0, 0],
        [1, 0, 0],
    ),
    "badly scaled": (
        lambda x: np.array([1e6 * (x[0] - 1e-6), 1e-6 * (x[1] - 1e6), x[0] * x[1] - 1]),
        [1.0, 1],
        [1e-6, 1e6],
    ),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_classic_problems(name: str) -> None:
    residuals, start, answer = PROBLEMS[name]
    result = minimize_least_squares(residuals, start, max_iterations=2000)
    assert result.converged
    assert result.cost < 1e-12
    if name != "powell singular":  # its Jacobian is singular at the answer: x is found to the fourth root only
        np.testing.assert_allclose(result.x, answer, rtol=1e-5, atol=1e-6)


@settings(max_examples=30)
@given(seeds)
def test_curve_fits_equal_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 4, 40)
    y = rng.uniform(1, 3) * np.exp(-rng.uniform(0.3, 2) * t) + rng.uniform(-1, 1) + rng.normal(0, 0.05, 40)

    def residuals(x: np.ndarray) -> np.ndarray:
        return x[0] * np.exp(-x[1] * t) + x[2] - y

    ours = minimize_least_squares(residuals, [1.0, 1.0, 0.0], max_iterations=500)
    theirs = scipy.optimize.least_squares(residuals, [1.0, 1.0, 0.0], method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert ours.cost <= 2 * theirs.cost * (1 + 1e-9)


def test_linear_problem_and_its_covariance() -> None:
    rng = np.random.default_rng(3)
    A, b = rng.normal(size=(30, 4)), rng.normal(size=30)
    result = minimize_least_squares(lambda x: A @ x - b, np.zeros(4), jacobian=lambda x: A)
    expected, rest, _, _ = np.linalg.lstsq(A, b)
    np.testing.assert_allclose(result.x, expected, atol=1e-10)
    np.testing.assert_allclose(result.covariance(), rest[0] / 26 * np.linalg.inv(A.T @ A), rtol=1e-8)


def test_a_step_into_nan_is_refused() -> None:
    with np.errstate(invalid="ignore"):
        result = minimize_least_squares(lambda x: np.array([np.sqrt(x[0]) - 0.1]), [4.0])
    np.testing.assert_allclose(result.x, [0.01], rtol=1e-6)


def test_a_start_without_a_value_is_an_error() -> None:
    with pytest.raises(InputError, match="not finite at the start"):
        minimize_least_squares(lambda x: np.array([np.nan]), [1.0])


def test_central_differences_are_exact_to_ten_digits() -> None:
    J = central_differences(lambda x: np.array([np.sin(x[0]) * x[1], np.exp(x[1])]), np.array([0.7, 1.3]))
    np.testing.assert_allclose(J, [[np.cos(0.7) * 1.3, np.sin(0.7)], [0, np.exp(1.3)]], rtol=1e-9, atol=1e-10)
