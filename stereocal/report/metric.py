"""Block 6, metric: does the rig measure the board as it is?

Every pair of corners is triangulated from its two pixels alone, without the fitted pose, and the board that comes out
is measured: the side of its squares (mean, spread, bias), how flat it is, and, if all views bend the same way, its
shape.

**Squares used in the fit cannot validate absolute scale.** The fit put the squares' size into T, so the mean square
comes out right whatever the true size: a board of 26 mm called 25 mm gives a perfect report and depths 4 % short.
What the squares do validate is that scale is the *same* everywhere: over the image, near and far. For the absolute
scale measure a distance that was not in the fit (``known_distance``).

**Shape of the board.** If corner j of the board stands off its place by δ_j, every view shows it: its residual is
d = ∂x/∂X R δ_j. Over V views and two cameras these are 4V equations for three unknowns,

    δ_j = (Σ JᵀJ)⁻¹ Σ Jᵀ d,   J = ∂x/∂X R,

one small solve a corner. Only what bends counts: the part of δ that a similarity of the whole board explains is not
shape. It is a single step from the flat fit, so it tells that a board bends and how, and understates by how much.

Sources: RealSense's definition of plane-fit RMS; Strobl and Hirzinger (2011) for boards of unknown shape.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.report.evidence import Evidence, projection_jacobian
from stereocal.report.rectified import rectified_points
from stereocal.report.verdicts import Block, Table, judge


def triangulate_corners(evidence: Evidence) -> Float:
    """Every corner from its two pixels: (V, N, 3) in the rectified left camera's frame; NaN where undistortion fails.

    For a rectified pair the depth is f·B/d; the point is the ray of the left pixel at that depth.
    """
    a, b, r = rectified_points(evidence.rig, evidence.left, evidence.right)
    axis = r.axis
    f, P1, P2 = r.P1[0, 0], r.P1, r.P2
    disparity = a[..., axis] - b[..., axis] - (P1[axis, 2] - P2[axis, 2])
    z = -P2[axis, 3] / np.where(np.abs(disparity) > 1e-9, disparity, np.nan)
    # of the two rows that should agree, their mean
    across = 1 - axis
    mean_row = (a[..., across] - P1[across, 2] + b[..., across] - P2[across, 2]) / 2
    along = a[..., axis] - P1[axis, 2]
    xyz = np.empty((*z.shape, 3))
    xyz[..., axis], xyz[..., across], xyz[..., 2] = along * z / f, mean_row * z / f, z
    return xyz


def square_sides(points: Float, columns: int, rows: int) -> Float:
    """Sides of all squares of triangulated boards: (V, N, 3) → (V, edges)."""
    grid = points.reshape(len(points), rows, columns, 3)
    across = np.linalg.norm(np.diff(grid, axis=2), axis=-1).reshape(len(points), -1)
    down = np.linalg.norm(np.diff(grid, axis=1), axis=-1).reshape(len(points), -1)
    return np.concatenate([across, down], axis=1)


def plane_distances(points: Float) -> Float:
    """Distance of each point from the plane through its own board: (V, N, 3) → (V, N)."""
    centred = points - points.mean(axis=1, keepdims=True)
    normals = np.linalg.svd(centred, full_matrices=False)[2][:, 2]
    return np.asarray(np.einsum("vnk,vk->vn", centred, normals))


def board_shape(evidence: Evidence) -> tuple[Float, Float]:
    """Where the board's corners stand off a flat grid, all views together.

    Returns
    -------
    shape : ndarray of shape (N, 3)
        δ in the board's frame and units, without the part that a similarity explains.
    sigma : ndarray of shape (N, 3)
        Standard errors of δ, from the corner noise.
    """
    N = len(evidence.object_points)
    A, g = np.zeros((N, 3, 3)), np.zeros((N, 3))
    R = np.asarray(evidence.rig.R)
    for camera, points, residuals, turn in (
        (evidence.rig.left, evidence.points_left, evidence.left_residuals, np.eye(3)),
        (evidence.rig.right, evidence.points_right, evidence.right_residuals, R),
    ):
        J = np.einsum("vnij,jk,vkl->vnil", projection_jacobian(camera, points), turn, evidence.rotations)
        A += np.einsum("vnij,vnik->njk", J, J)
        g += np.einsum("vnij,vni->nj", J, residuals)
    inverse = np.linalg.inv(A)
    delta = np.einsum("njk,nk->nj", inverse, g)
    sigma = evidence.noise * np.sqrt(np.einsum("njj->nj", inverse))
    return delta - _similarity_part(evidence.object_points, delta), sigma


def _similarity_part(X: Float, delta: Float) -> Float:
    """The part of a displacement field that a small rotation, shift and change of scale explains."""
    centred = X - X.mean(axis=0)
    modes = [np.tile(axis, (len(X), 1)) for axis in np.eye(3)]
    modes += [np.cross(axis, centred) for axis in np.eye(3)]
    modes.append(centred)
    basis = np.stack([m.ravel() for m in modes], axis=1)
    return np.asarray((basis @ np.linalg.lstsq(basis, delta.ravel(), rcond=None)[0]).reshape(-1, 3))


def examine_metric(evidence: Evidence) -> Block:
    """Measure and judge the triangulated boards.

    Returns
    -------
    Block
    """
    points = triangulate_corners(evidence)
    whole = np.isfinite(points).all(axis=(1, 2))
    points = points[whole]
    size, unit = evidence.square_size, evidence.unit
    sides = square_sides(points, evidence.columns, evidence.rows)
    bias = 100 * (float(sides.mean()) / size - 1)
    flat = plane_distances(points)
    plane_rms = float(np.sqrt(np.mean(flat**2)))
    f, baseline = float(evidence.rig.left.K[0, 0]), float(evidence.rig.baseline)
    sigma_depth = points[..., 2] ** 2 * np.sqrt(2) * evidence.noise / (f * baseline)
    plane_sigma = float(np.sqrt(float(np.mean(sigma_depth**2))))
    shape, sigma = board_shape(evidence)
    excess = float(np.mean(shape[:, 2] ** 2) - np.mean(sigma[:, 2] ** 2))
    out_of_plane = float(np.sqrt(max(excess, 0.0)))
    bend = 100 * out_of_plane / size
    verdicts = (
        judge("metric", "square_bias", abs(bias), "Mean triangulated square against its size. It cannot validate "
              "absolute scale: the fit has used the same squares.",
              cause="The geometry of the two cameras contradicts the board's.",
              action="See the fit and the epipolar block."),
        judge("metric", "plane", plane_rms / max(plane_sigma, 1e-300),
              "RMS distance of triangulated corners from their board's plane, over what corner noise alone gives.",
              cause="The board bends, or the shutters are not synchronous.",
              action="Glue the board to glass or aluminium.",
              at_worst="usable"),
        judge("metric", "board_shape", bend, "How far the board's corners stand out of its plane, equally in all "
              "views.",
              cause="The board is bent or folded.",
              action="Glue the board to something flat, or calibrate with the board's shape as unknowns (board_warp)."),
    )  # fmt: skip
    near, far = (float(z) for z in np.percentile(evidence.points_left[..., 2].mean(axis=1), (25, 75)))
    facts = {
        "square_mean": float(sides.mean()), "square_sd": float(sides.std()), "square_bias_percent": bias,
        "plane_rms": plane_rms, "plane_rms_expected": plane_sigma, "board_bend_rms": out_of_plane,
        "board_bend_max": float(np.abs(shape[:, 2]).max()), "board_shape": shape.tolist(),
        "distance_quartiles": [near, far],
    }  # fmt: skip
    lead = (
        f"Triangulated squares measure {sides.mean():.4g} ± {sides.std():.2g} {unit} (size {size:g}); boards are flat "
        f"to {plane_rms:.3g} {unit} RMS, where corner noise alone gives {plane_sigma:.3g}. Squares used in the fit "
        "cannot validate absolute scale: measure a known distance for that."
    )
    rows = tuple(
        (name, f"{s.mean():.5g}", f"{s.std():.2g}", f"{float(np.sqrt(np.mean(d**2))):.3g}", f"{p[:, 2].mean():.4g}")
        for name, s, d, p in zip(np.array(evidence.names)[whole], sides, flat, points, strict=True)
    )
    table = Table(
        f"Each board, triangulated ({unit})",
        ("pair", "mean square", "sd", "off its plane, RMS", "distance"),
        rows,
        True,
    )
    return Block("metric", "Metric", lead, verdicts, facts, (table,))
