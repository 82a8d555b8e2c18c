"""Block 4, generalisation: the error on views that the fit has not seen. The headline of the report.

A fit is judged on what it was not shown. The views are dealt into k folds; for each fold the rig is calibrated on the
others, the views of the fold are only *placed* (six pose parameters each, found from both images with the rig fixed),
and their residuals are counted. The RMS over all folds is the held-out RMS. If it is near the fitted RMS, the
calibration has learnt the cameras; if it is far above, it has learnt the views.

The pose of a held-out view is found by Gauss–Newton from both images, all views of a fold at once: with the board point
X in the left camera's frame, a small turn ω and shift τ of the board move it by ω × X + τ, so that

    ∂x/∂(ω, τ) = ∂x/∂X · [−[X]ₓ, I],

and the right camera's adds R. Six unknowns against 4N components: the pose takes up 6/(4N) of the squared noise, which
is given back when the held-out noise is quoted per axis.

Sources: mrcal's tour (cross-validation: a low RMS is not validity); Hastie, Tibshirani and Friedman, *The Elements of
Statistical Learning* (2009), section 7.10.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import StereocalError
from stereocal.base.rotations import rotation_matrix
from stereocal.report.evidence import Evidence, Refit, place, project, projection_jacobian
from stereocal.report.halves import Halves, judge_halves
from stereocal.report.rectified import rectify_corners
from stereocal.report.verdicts import Block, Picture, Table, Verdict, judge


@dataclass(frozen=True)
class HeldOut:
    """Residuals of every view under a fit that has not seen it.

    Attributes
    ----------
    left, right : ndarray of shape (V, N, 2)
        Observed minus projected, pixels; NaN for views whose fold could not be fitted.
    epipolar : ndarray of shape (V, N)
        Δy after rectification by the fold's rig.
    failures : tuple of str
        Why folds could not be fitted.
    rigs : tuple
        The folds' rigs.
    """

    left: Float
    right: Float
    epipolar: Float
    failures: tuple[str, ...]
    rigs: tuple[Any, ...]

    @property
    def residuals(self) -> Float:
        """Both cameras, (2, V, N, 2)."""
        return np.stack([self.left, self.right])

    @property
    def rms(self) -> float:
        """OpenCV's RMS over the held-out views."""
        return float(np.sqrt(np.nanmean(np.sum(self.residuals**2, axis=-1))))

    @property
    def noise(self) -> float:
        """σ an axis, with the six degrees of freedom of each pose given back."""
        components = 4 * self.left.shape[1]
        return self.rms / np.sqrt(2) * np.sqrt(components / max(components - 6, 1))


def place_views(rig: Any, evidence: Evidence, views: Sequence[int], *, iterations: int = 6) -> tuple[Float, Float]:
    """Find the poses of views under a fixed rig, from both images, and return the residuals left and right.

    Parameters
    ----------
    rig : StereoRig
    evidence : Evidence
        The corners, and poses to start from.
    views : sequence of int
    iterations : int
        Gauss–Newton steps; from a pose of the full fit it converges to 1e-9 px in three or four.

    Returns
    -------
    left, right : ndarray of shape (len(views), N, 2)
        Observed minus projected, pixels.
    """
    index = np.asarray(views)
    observed = (evidence.left[index], evidence.right[index])
    R, t = evidence.rotations[index].copy(), evidence.translations[index].copy()
    turn, shift = np.asarray(rig.R), np.ravel(rig.T)
    for _ in range(iterations):
        X = place(evidence.object_points, R, t)
        A, g = np.zeros((len(index), 6, 6)), np.zeros((len(index), 6))
        for camera, points, rotation, corners in (
            (rig.left, X, np.eye(3), observed[0]),
            (rig.right, X @ turn.T + shift, turn, observed[1]),
        ):
            J_X = projection_jacobian(camera, points) @ rotation
            J = np.concatenate([np.cross(X[:, :, None, :], J_X), J_X], axis=-1)  # (ω × X) · J = ω · (X × J)
            A += np.einsum("vnij,vnik->vjk", J, J)
            g += np.einsum("vnij,vni->vj", J, corners - project(camera, points))
        step = np.linalg.solve(A, g[..., None])[..., 0]
        for v, (omega, tau) in enumerate(zip(step[:, :3], step[:, 3:], strict=True)):
            Q = rotation_matrix(omega)
            R[v], t[v] = Q @ R[v], Q @ t[v] + tau
        if np.abs(step).max() < 1e-10:
            break
    X = place(evidence.object_points, R, t)
    return observed[0] - project(rig.left, X), observed[1] - project(rig.right, X @ turn.T + shift)


def hold_out(evidence: Evidence, refit: Refit, *, folds: int = 5, seed: int = 0) -> HeldOut:
    """k-fold by view: fit without the fold, place its views, count their residuals.

    Parameters
    ----------
    evidence : Evidence
    refit : callable
        Calibrates from lists of left and right corners.
    folds : int
        k; at most the number of views.
    seed : int
        Deals the views.

    Returns
    -------
    HeldOut
    """
    count = evidence.view_count
    dealt = np.random.default_rng(seed).permutation(count)
    left, right = np.full_like(evidence.left, np.nan), np.full_like(evidence.right, np.nan)
    epipolar = np.full(evidence.left.shape[:2], np.nan)
    failures, rigs = [], []
    for fold in np.array_split(dealt, min(folds, count)):
        rest = np.setdiff1d(np.arange(count), fold)
        try:
            rig = refit([evidence.left[v] for v in rest], [evidence.right[v] for v in rest]).rig
            left[fold], right[fold] = place_views(rig, evidence, fold.tolist())
        except (StereocalError, np.linalg.LinAlgError) as error:
            failures.append(str(error))
            continue
        epipolar[fold] = rectify_corners(rig, evidence.left[fold], evidence.right[fold]).across
        rigs.append(rig)
    return HeldOut(left, right, epipolar, tuple(failures), tuple(rigs))


def examine_generalisation(evidence: Evidence, held: HeldOut | None, halves: Halves | None, fitted_rms: float) -> Block:
    """Judge the held-out error.

    Parameters
    ----------
    evidence : Evidence
    held : HeldOut, optional
        None if there are too few views to hold any out.
    halves : Halves, optional
        The comparison of two half-data calibrations; None if there are too few views.
    fitted_rms : float
        RMS of the full fit, OpenCV's convention.

    Returns
    -------
    Block
    """
    few = "Too few pairs: leaving some out leaves too few to calibrate from."
    more = "Take 15 to 20 pairs with different places and tilts."
    measured = held is not None and np.isfinite(held.left).any()
    noise = held.noise if held is not None and measured else float("nan")
    whole = held.rms if held is not None and measured else float("nan")
    ratio = whole / fitted_rms
    verdicts: tuple[Verdict, ...] = (
        judge("generalisation", "held_out_rms", noise, "Residual an axis on views that the fit has not seen.",
              cause="The corners are noisy, or the model does not hold beyond the views it was fitted to."
              if measured else few,
              action="Add views that differ from each other; see Data for which." if measured else more),
        judge("generalisation", "held_out_ratio", ratio, "Held-out RMS over the RMS of the fit itself.",
              cause="The fit has more freedom than the views can fix." if measured else few,
              action="Add views, or use a model with fewer distortion parameters." if measured else more),
    )  # fmt: skip
    if held is None or not measured:
        return Block("generalisation", "Generalisation", few, verdicts, {"held_out_rms": None})
    view_rms = np.sqrt(np.mean(np.sum(held.residuals**2, axis=-1), axis=(0, 2)))
    lead = (
        f"On views that the fit has not seen the RMS is {whole:.3f} px, against {fitted_rms:.3f} px on views it has. "
        f"Quote the first one."
    )
    facts: dict[str, Any] = {
        "held_out_rms": whole,
        "held_out_noise_per_axis": noise,
        "ratio": ratio,
        "view_rms": view_rms.tolist(),
        "failures": list(held.failures),
    }
    rows = tuple((name, f"{value:.3f}") for name, value in zip(evidence.names, view_rms, strict=True))
    table = Table("Each pair under a fit without it, px", ("pair", "held-out RMS"), rows, True)
    pictures: tuple[Picture, ...] = ()
    if halves is not None:
        verdict, facts["halves"], pictures = judge_halves(halves, evidence.image_size)
        verdicts = (*verdicts, verdict)
    return Block("generalisation", "Generalisation", lead, verdicts, facts, (table,), pictures)
