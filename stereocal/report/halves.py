"""Block 4, the other half: two calibrations from half the views each, against the uncertainty that was promised.

Two halves of the views share the cameras and nothing else: neither corners, nor poses, nor luck. If the covariance is
honest, the calibrations A and B differ by what it says, and no more.

Parameters are the wrong thing to compare: fx, cx, p2 and a small rotation of the camera trade off against each other,
so that they differ while the cameras do the same. Compared is what the cameras *do*: a pixel's ray under A is
projected by B. The frame of a camera is not fixed by its images, so B may first be turned by the small rotation ω
that fits best (after mrcal). To first order, with the ray's sensitivity J_θ = ∂x/∂θ and G = ∂x/∂ω on a grid of
pixels,

    Δ = Π J_θ (θ_A − θ_B),   Π = I − G (GᵀG)⁻¹ Gᵀ,   expected: Cov(Δ) = Π J_θ (Σ_A + Σ_B) J_θᵀ Π.

The ratio √(Σ‖Δ‖² / tr Cov(Δ)) is about 1 for an honest covariance. Above 2 or 3 something moves that the noise does not
explain: a bent board, unsynchronised shutters, a loose rig.

Sources: mrcal, *A tour of mrcal: cross-validation*; the linear form is ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import StereocalError
from stereocal.report.evidence import Evidence, Refit, projection_jacobian
from stereocal.report.figures_geometry import draw_field
from stereocal.report.rig_parameters import lens_domain, rig_of_vector, rig_vector, steps
from stereocal.report.verdicts import Picture, Verdict, judge

_COLUMNS = 16


@dataclass(frozen=True)
class Halves:
    """How two half-data calibrations differ.

    Attributes
    ----------
    grid : tuple of (rows, columns)
        Of the maps.
    difference : ndarray of shape (2, rows, columns)
        Projection difference over the image, left and right, pixels; NaN where the lens cannot be undone.
    expected : ndarray of shape (2, rows, columns)
        One σ of it, by both covariances.
    seen : ndarray of bool, shape (2, rows, columns)
        Where corners were seen; only there it is judged.
    """

    grid: tuple[int, int]
    difference: Float
    expected: Float
    seen: Any

    @property
    def ratios(self) -> Float:
        """√(Σ‖Δ‖² / Σ expected²) where corners were seen, left and right."""
        inside = self.seen & np.isfinite(self.difference)
        return np.array(
            [
                np.sqrt(np.sum(d[s] ** 2) / np.sum(e[s] ** 2)) if s.any() else np.nan
                for d, e, s in zip(self.difference, self.expected, inside, strict=True)
            ]
        )


def compare_halves(evidence: Evidence, refit: Refit, *, seed: int = 0) -> Halves | None:
    """Calibrate two halves of the views and compare what the cameras do.

    Parameters
    ----------
    evidence : Evidence
    refit : callable
        Calibrates from lists of left and right corners.
    seed : int
        Deals the views.

    Returns
    -------
    Halves, or None
        None if a half could not be calibrated.
    """
    dealt = np.random.default_rng(seed).permutation(evidence.view_count)
    fits = []
    for half in (dealt[::2], dealt[1::2]):
        try:
            fits.append(refit([evidence.left[v] for v in half], [evidence.right[v] for v in half]))
        except (StereocalError, np.linalg.LinAlgError):
            return None
    change = rig_vector(fits[0].rig) - rig_vector(fits[1].rig)
    covariance = np.asarray(fits[0].covariance) + np.asarray(fits[1].covariance)
    if not np.isfinite(covariance).all():
        return None
    width, height = evidence.image_size
    shape = (max(3, round(_COLUMNS * height / width)), _COLUMNS)
    differences, expected, seen = [], [], []
    for side, corners in enumerate((evidence.left, evidence.right)):
        delta, sigma = _camera_difference(evidence, side, shape, change, covariance)
        differences.append(delta)
        expected.append(sigma)
        seen.append(_seen(corners.reshape(-1, 2), evidence.image_size, shape))
    return Halves(shape, np.stack(differences), np.stack(expected), np.stack(seen))


def _camera_difference(
    evidence: Evidence, side: int, shape: tuple[int, int], change: Float, covariance: Float
) -> tuple[Float, Float]:
    """‖Δ‖ and its expected σ on the grid for one camera, both (rows, columns)."""
    rig = evidence.rig
    camera = (rig.left, rig.right)[side]
    width, height = evidence.image_size
    x, y = np.meshgrid(np.linspace(0, width - 1, shape[1]), np.linspace(0, height - 1, shape[0]))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    known = lens_domain(camera).contains(pixels)
    ideal = np.asarray(camera.undistort_points(pixels[known], P=np.eye(3)))
    finite = np.isfinite(ideal).all(axis=1)
    known[known] = finite
    rays = np.concatenate([ideal[finite], np.ones((int(finite.sum()), 1))], axis=1)
    start = 0 if side == 0 else 5 + len(np.ravel(rig.left.dist))
    stop = start + 5 + len(np.ravel(camera.dist))
    theta, h = rig_vector(rig), steps(rig)
    columns = []
    for i in range(start, stop):
        moved = []
        for sign in (1, -1):
            shifted = theta.copy()
            shifted[i] += sign * h[i]
            other = rig_of_vector(shifted, rig)
            moved.append(np.asarray((other.left, other.right)[side].project(rays)))
        columns.append((moved[0] - moved[1]) / (2 * h[i]))
    J = np.stack(columns, axis=-1)  # (M, 2, p)
    J_X = projection_jacobian(camera, rays)
    G = np.cross(rays[:, None, :], J_X).reshape(-1, 3)
    weights = np.repeat(_seen_weights(evidence, side, pixels[known]), 2)
    fit = np.linalg.solve(G.T @ (weights[:, None] * G), G.T * weights)
    flat = J.reshape(-1, stop - start)
    free = flat - G @ (fit @ flat)
    delta = (free @ change[start:stop]).reshape(-1, 2)
    variance = np.einsum("ki,ij,kj->k", free, covariance[start:stop, start:stop], free).reshape(-1, 2)
    result = np.full((2, len(pixels)), np.nan)
    result[0, known] = np.linalg.norm(delta, axis=1)
    result[1, known] = np.sqrt(variance.sum(axis=1))
    return result[0].reshape(shape), result[1].reshape(shape)


def _seen(points: Float, image_size: tuple[int, int], shape: tuple[int, int]) -> Any:
    """Grid nodes with a corner within one and a half grid steps."""
    width, height = image_size
    x, y = np.linspace(0, width - 1, shape[1]), np.linspace(0, height - 1, shape[0])
    reach = 1.5 * width / shape[1]
    near = np.zeros(shape, dtype=bool)
    for row, column in np.ndindex(shape):
        near[row, column] = bool(np.any(np.hypot(points[:, 0] - x[column], points[:, 1] - y[row]) < reach))
    return near


def _seen_weights(evidence: Evidence, side: int, pixels: Float) -> Float:
    """1 where corners were seen, else 0: the best rotation is found there (everywhere if that leaves too little)."""
    points = (evidence.left, evidence.right)[side].reshape(-1, 2)
    reach = 1.5 * evidence.image_size[0] / _COLUMNS
    near = np.array([float(np.any(np.hypot(*(points - p).T) < reach)) for p in pixels])
    return near if near.sum() >= 4 else np.ones(len(pixels))


def judge_halves(halves: Halves, image_size: tuple[int, int]) -> tuple[Verdict, dict[str, Any], tuple[Picture, ...]]:
    """The verdict, the facts and the pictures of a comparison."""
    ratios = halves.ratios
    worse = int(np.nanargmax(ratios))
    name = ("left", "right")[worse]
    inside = halves.seen[worse] & np.isfinite(halves.difference[worse])
    verdict = judge(
        "generalisation", "halves", float(ratios[worse]),
        "How far two calibrations from half the views differ, over the σ that both promise; the worse camera.",
        cause="Something changes between views that the model does not know: a bent board, shutters out of step, "
        "a loose rig.",
        action="Glue the board down, hold it still for each pair, tighten the cameras; then photograph again.",
    )  # fmt: skip
    facts = {
        "ratio": {"left": float(ratios[0]), "right": float(ratios[1])},
        "difference_rms": float(np.sqrt(np.mean(halves.difference[worse][inside] ** 2))),
        "expected_rms": float(np.sqrt(np.mean(halves.expected[worse][inside] ** 2))),
    }
    # one scale for both, set where corners were seen: beyond, both run away
    top = 1.5 * float(max(halves.difference[worse][inside].max(), halves.expected[worse][inside].max()))
    pictures = (
        Picture("halves_difference",
                f"How far the {name} cameras of two half-data calibrations part, pixels. Beyond the boards' "
                "reach both guess.",
                lambda: draw_field(halves.difference[worse], image_size, title=f"two halves part, {name}",
                                   label="projection difference, px", limit=top)),
        Picture("halves_expected", "One σ of that difference, as both covariances promise it.",
                lambda: draw_field(halves.expected[worse], image_size, title=f"promised σ, {name}",
                                   label="σ, px", limit=top)),
    )  # fmt: skip
    return verdict, facts, pictures
