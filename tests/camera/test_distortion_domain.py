"""Where a lens cannot be undone: lenses wild enough to fold twice, to have poles, and to come back from both.

The domain's definition is the witness here: det ∂f/∂x > 0 at a thousand and more places of the way from the centre.
"""

from __future__ import annotations

import numpy as np
import pytest

from stereocal.base.checks import Float
from stereocal.camera.distortion import MODELS, distort_normalized, undistort_normalized
from stereocal.camera.distortion_base import BackwardModel
from stereocal.camera.distortion_inverse import open_way

BACKENDS = pytest.mark.parametrize("backend", ["numba", "numpy"])

# A tilted lens with a fold so narrow that 32 places of the way step over it, and a point that has an answer before it.
FOLDED = [0.03740893601675155, -0.07168834058320844, -0.016433309250569583, -0.009981061208703687,
          -0.19901631347526816, -0.13913194643577798, -0.2466950740520055, -0.0768963428410098,
          -0.015789567082088073, -0.029974507320746295, -0.02225508421810172, -0.026034966345625028,
          0.039647385419813774, -0.13796054553925097]  # fmt: skip


def wild_lens(count: int, rng: np.random.Generator) -> Float:
    """The first `count` coefficients of OpenCV's fourteen, several times those of any lens that is sold."""
    half_width = [0.4, 0.3, 0.02, 0.02, 0.2, 0.5, 0.3, 0.2, 0.03, 0.03, 0.03, 0.03, 0.2, 0.2]
    return (rng.uniform(-1, 1, 14) * half_width)[:count]


def in_domain(name: str, x: Float, k: Float) -> np.ndarray:
    """Whether the determinant is positive at 1500 places of the way to each x."""
    model, t = MODELS[name], np.arange(1, 1501)[:, None] / 1500
    slope = model.undistort_jacobians if isinstance(model, BackwardModel) else model.jacobians
    with np.errstate(all="ignore"):
        return np.array([(np.linalg.det(slope(t * p, k)[1]) > 0).all() for p in x])


class FoldedToy(BackwardModel):
    """Backward, by the recipe and no more: x_u = x_d exp(a s), which turns over at s = −1/(2a)."""

    name = "folded_toy"
    parameter_names = ("a",)

    def undistort_jacobians(self, x_d: Float, k: Float) -> tuple[Float, Float, Float]:
        s = np.sum(x_d * x_d, axis=1)
        e = np.exp(k[0] * s)
        outer = x_d[:, :, None] * x_d[:, None, :]
        J = e[:, None, None] * (np.eye(2) + 2 * k[0] * outer)
        return x_d * e[:, None], J, (x_d * (e * s)[:, None])[:, :, None]


@BACKENDS
def test_the_answer_before_a_narrow_fold_is_found(backend: str) -> None:
    y = np.array([[4.537685916110263, -3.233021911421956], [-2.1788629106310475, 1.5006639041119127]])
    x = undistort_normalized(y, FOLDED, "tilted", backend=backend)
    np.testing.assert_allclose(x, [[0.98151439, -0.65617754], [-0.93567115, 0.71264972]], atol=1e-8)
    np.testing.assert_allclose(distort_normalized(x, FOLDED, "tilted"), y, atol=1e-11)


def far_points(rng: np.random.Generator) -> Float:
    return np.asarray(rng.uniform(-5, 5, (60, 2)) * rng.choice([0.1, 0.5, 1], (60, 1)))


# This seed's third and eighth lens fold and come back: stations at fixed places take them for sound.
@pytest.mark.parametrize("name", ["rational", "thin_prism", "tilted"])
def test_wild_lenses_have_no_wrong_answer(name: str) -> None:
    rng = np.random.default_rng(5)
    answered = 0
    for _ in range(12):
        k = wild_lens(MODELS[name].parameter_count, rng)
        x = undistort_normalized(far_points(rng), k, name)
        x = x[np.isfinite(x[:, 0])]
        answered += len(x)
        assert in_domain(name, x, k).all()
    assert answered > 12 * 20


@pytest.mark.parametrize("name", ["brown", "thin_prism", "tilted"])
def test_both_backends_answer_alike_of_wild_lenses(name: str) -> None:
    rng = np.random.default_rng(5)
    for _ in range(3):
        k, y = wild_lens(MODELS[name].parameter_count, rng), far_points(rng)
        x, reference = (undistort_normalized(y, k, name, backend=backend) for backend in ("numba", "numpy"))
        np.testing.assert_allclose(x, reference, rtol=1e-9, atol=1e-9)


@BACKENDS
def test_behind_a_pole_that_a_zero_all_but_cancels_there_is_no_answer(backend: str) -> None:
    """(1 − s/1.0001) / (1 − s): every step of the way shows an ideal lens, but for 1e-4 of it."""
    k = [-1 / 1.0001, 0, 1e-5, 0, 0, -1.0, 0, 0]
    x = undistort_normalized([[0.5, 0.3], [1.1, 0.9]], k, "rational", backend=backend)
    np.testing.assert_allclose(x[0], [0.5, 0.3], atol=1e-3)
    assert np.isnan(x[1]).all()


@BACKENDS
def test_the_rational_function_s_formula_is_masked_beyond_its_folds(backend: str) -> None:
    rng = np.random.default_rng(3)
    neutral, folded = MODELS["rational_function"].neutral(), 0
    for _ in range(20):
        k = neutral + rng.uniform(-0.05, 0.05, 18)
        x_d = rng.uniform(-5, 5, (60, 2))
        x = undistort_normalized(x_d, k, "rational_function", backend=backend)
        inside = in_domain("rational_function", x_d, k)
        np.testing.assert_array_equal(np.isfinite(x), np.column_stack([inside, inside]))
        formula = MODELS["rational_function"].undistort_jacobians(x_d, k)[0]
        np.testing.assert_allclose(x[inside], formula[inside], rtol=1e-12)
        folded += np.count_nonzero(~inside & (x_d @ k[15:17] + k[17] > 0))
    assert folded > 10


@BACKENDS
def test_points_that_are_not_finite_have_no_answer(backend: str) -> None:
    k = MODELS["rational_function"].neutral() + 0.01
    x = undistort_normalized([[np.nan, 0], [np.inf, 0], [0.1, 0.2]], k, "rational_function", backend=backend)
    np.testing.assert_array_equal(np.isnan(x[:, 0]), [True, True, False])
    assert len(undistort_normalized(np.zeros((0, 2)), k, "rational_function", backend=backend)) == 0


def test_a_model_of_the_recipe_is_masked_by_its_base_class() -> None:
    """It turns over at r = √5; a point far out would fall on the centre. What else is asked does not matter."""
    toy, k = FoldedToy(), np.array([-0.1])
    near = np.array([[1.0, 0], [0, -2.2]])
    far = np.array([[2.3, 0], [0, 3.0], [180.0, 0], [9e4, 0]])
    together = toy.undistort(np.vstack([near, far]), k)
    np.testing.assert_allclose(together[:2], near * np.exp([[-0.1], [-0.484]]), rtol=1e-14)
    assert np.isnan(together[2:]).all()
    np.testing.assert_array_equal(toy.undistort(near, k), together[:2])
    np.testing.assert_allclose(toy.distort(together[:2], k), near, atol=1e-9)


def test_a_way_ends_before_the_fold() -> None:
    """r(1 − r²/3) folds at r = 1: of the way to r = 4 a quarter is free, and all of that to r = 0.999."""
    brown, k = MODELS["brown"], np.array([-1 / 3, 0, 0, 0, 0])
    ends = np.array([[4.0, 0], [0, 0.999], [0.6, 0.8001]])
    far = open_way(lambda x: brown.jacobians(x, k)[:2], ends)
    assert 0.15 < far[0] <= 0.25
    assert far[1] == 1
    assert far[2] < 1
