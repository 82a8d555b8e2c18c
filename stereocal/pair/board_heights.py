"""The board's shape from what its corners leave over: heights above a plane.

A flat model of a bent board leaves residuals, the same corner by corner in all views, only seen from other sides. With
z_j the height of corner j, G_ij = ∂p/∂Z the pixels' change with it, M_i the board's motion in view i (6), k the
intrinsics,

    residual_ij = G_ij z_j + (∂p_ij/∂M_i) M_i + (∂p_ij/∂k) k + noise

is linear least squares in all of them at once. Motions and intrinsics are not wanted: they are projected out. A plane
added to z does the same as a motion, so z is determined up to a plane, and given with none. The two cameras are fitted
apart; that they find the same heights is the proof that it is the board.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.distortion import distort_normalized, to_pixels
from stereocal.pair.view_rigs import ViewPoses, motion_jacobian, pixel_gradients

# Heights that the views do not determine (all of them seen from straight ahead) are left at 0.
_SINGULAR = 1e-12


@dataclass(frozen=True, eq=False)
class BoardHeights:
    """Heights of a board's corners above the best plane, as each camera sees them.

    Attributes
    ----------
    left, right : ndarray of shape (N,)
        In the units of the board's square size.
    sigma : float
        Typical standard deviation of one of them.
    agreement : float
        Correlation of the two, from −1 to 1.
    """

    left: Float
    right: Float
    sigma: float
    agreement: float

    @property
    def mean(self) -> Float:
        """Both cameras' heights, averaged."""
        return (self.left + self.right) / 2

    @property
    def range(self) -> float:
        """The spread that holds 90 % of the heights."""
        low, high = np.percentile(self.mean, (5, 95))
        return float(high - low)


def board_heights(first: ViewPoses, second: ViewPoses) -> BoardHeights:
    """Fit the board's heights to the residuals of both cameras.

    Parameters
    ----------
    first, second : ViewPoses
        Left and right, corners in the same order in all views.

    Returns
    -------
    BoardHeights
    """
    left, sigma_left = _heights(first)
    right, sigma_right = _heights(second)
    spread = float(np.linalg.norm(left) * np.linalg.norm(right))
    agreement = float(left @ right) / spread if spread > 0 else 0.0
    return BoardHeights(left, right, float(np.hypot(sigma_left, sigma_right) / 2), agreement)


def _heights(poses: ViewPoses) -> tuple[Float, float]:
    """Heights by one camera and their standard deviation."""
    X = poses.object_points
    count = len(X)
    plane = np.column_stack([np.ones(count), X[:, :2] - X[:, :2].mean(axis=0)])
    flat = np.linalg.qr(plane)[0]
    shapes = np.linalg.svd(flat.T)[2][3:].T  # an orthonormal basis of heights without a plane
    rows: list[Float] = []
    nuisance: list[Float] = []
    residuals: list[Float] = []
    for i in range(len(poses.R)):
        arms = (X - X.mean(axis=0)) @ poses.R[i].T
        points = X @ poses.R[i].T + poses.t[i]
        seen = poses.camera.project(points)
        by_point = pixel_gradients(poses.camera, points)
        by_height = by_point @ poses.R[i][:, 2]
        motion = motion_jacobian(by_point, arms)
        basis = np.linalg.qr(motion)[0]
        block = (by_height[:, :, None] * shapes[:, None, :]).reshape(2 * count, -1)
        intrinsics = _intrinsic_jacobian(poses, points)
        r = (poses.corners[i] - seen).ravel()
        for target, array in ((rows, block), (nuisance, intrinsics), (residuals, r)):
            target.append(array - basis @ (basis.T @ array))
    A, N, r = np.concatenate(rows), np.concatenate(nuisance), np.concatenate(residuals)
    # tall matrices go through Q R first: R is small and has the same singular values
    Q, R = np.linalg.qr(N)
    U, s, _ = np.linalg.svd(R)
    basis = Q @ U[:, s > 1e-9 * s[0]]
    A, r = A - basis @ (basis.T @ A), r - basis @ (basis.T @ r)
    Q, R = np.linalg.qr(A)
    U, s, Vt = np.linalg.svd(R)
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=s > _SINGULAR * s[0])
    z = Vt.T @ (inverse * (U.T @ (Q.T @ r)))
    freedom = max(len(r) - 6 * len(poses.R) - basis.shape[1] - A.shape[1], 1)
    noise2 = float(np.sum((r - A @ z) ** 2)) / freedom
    variance = float(np.sum(inverse**2)) * noise2 / count
    return shapes @ z, float(np.sqrt(variance))


def _intrinsic_jacobian(poses: ViewPoses, points: Float) -> Float:
    """∂(pixels)/∂(fx, fy, cx, cy, distortion) by central differences, of shape (2N, 4 + n)."""
    camera = poses.camera
    x = points[:, :2] / points[:, 2:]
    columns = []
    for row, column in ((0, 0), (1, 1), (0, 2), (1, 2)):
        K = np.zeros((3, 3))
        K[row, column] = 1.0
        columns.append(to_pixels(distort_normalized(x, camera.dist, camera.model), K).ravel())
    for n in range(len(camera.dist)):
        step = np.zeros(len(camera.dist))
        step[n] = 1e-5
        above, below = (distort_normalized(x, camera.dist + s, camera.model) for s in (step, -step))
        columns.append((to_pixels(above - below, np.diag([camera.fx, camera.fy, 1.0])) / 2e-5).ravel())
    return np.stack(columns, axis=1)
