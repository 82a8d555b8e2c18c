"""The rig as each view sees it, and how far it deviates from the rig of all.

Each camera, calibrated alone, gives the pose R_i, t_i of the board in view i, X_camera = R_i X + t_i, with a
covariance. A pair of views (i of the left, j of the right camera) then sees a rig of its own,

    R_ij = R_right,j R_left,iᵀ,     T_ij = t_right,j − R_ij t_left,i.

Against a common rig (R, T) the right camera's board is turned by ω and its centre displaced by d,

    exp([ω]ₓ) = R_right,j (R R_left,i)ᵀ,     d = c_right,j − (R c_left,i + T),

c the board's centre in each camera. (ω, d) are of the size of their uncertainty in a healthy view.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.base.homogeneous import cross_matrix
from stereocal.base.rotations import rotation_matrix, rotation_vector
from stereocal.camera.model import Camera

Rig = tuple[Float, Float]
Turns = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ViewPoses:
    """One camera's poses of the board.

    Attributes
    ----------
    camera : Camera
    object_points : ndarray of shape (N, 3)
    corners : list of ndarray of shape (N, 2)
        Measured.
    R : ndarray of shape (V, 3, 3)
    t : ndarray of shape (V, 3)
    centres : ndarray of shape (V, 3)
        Of the board, in the camera's frame.
    covariances : ndarray of shape (V, 6, 6)
        Of a small turn of the board about its centre (camera axes) and of the centre.
    rms : float
        Of the camera's calibration, pixels.
    """

    camera: Camera
    object_points: Float
    corners: list[Float]
    R: Float
    t: Float
    centres: Float
    covariances: Float
    rms: float

    def turned(self, turns: Turns, orders: list[NDArray[np.int64]]) -> ViewPoses:
        """Return the same views with the corners of view i listed in orders[turns[i]]."""
        middle = self.object_points.mean(axis=0)
        R, t, corners = self.R.copy(), self.t.copy(), list(self.corners)
        for i, turn in enumerate(turns):
            if turn:
                D = board_turn(self.object_points, orders[turn])
                R[i] = self.R[i] @ D
                t[i] = self.R[i] @ (middle - D @ middle) + self.t[i]
                corners[i] = self.corners[i][orders[turn]]
        return replace(self, R=R, t=t, corners=corners)


def board_turn(object_points: Float, order: NDArray[np.int64]) -> Float:
    """Return the rotation D about the board's normal with X[order] − X̄ = D (X − X̄).

    Parameters
    ----------
    object_points : ndarray of shape (N, 3)
    order : ndarray of shape (N,), int

    Returns
    -------
    ndarray of shape (3, 3)
    """
    centred = object_points - object_points.mean(axis=0)
    moved = centred[order]
    sine = float(np.sum(centred[:, 0] * moved[:, 1] - centred[:, 1] * moved[:, 0]))
    return rotation_matrix([0, 0, np.arctan2(sine, float(np.sum(centred[:, :2] * moved[:, :2])))])


def view_poses(object_points: Float, corners: list[Float], image_size: tuple[int, int], model: str) -> ViewPoses:
    """Calibrate one camera alone and return its poses with their covariances.

    Parameters
    ----------
    object_points : ndarray of shape (N, 3)
    corners : list of ndarray of shape (N, 2)
    image_size : (int, int)
    model : str

    Returns
    -------
    ViewPoses
        Covariances for the noise that the calibration shows, intrinsics taken as known.
    """
    from stereocal.camera.calibration import calibrate_camera

    fit = calibrate_camera([object_points] * len(corners), corners, image_size, model=model)
    camera = fit.camera
    R = np.array([rotation_matrix(r) for r in fit.rvecs])
    t = np.asarray(fit.tvecs, dtype=float)
    middle = object_points.mean(axis=0)
    centres = R @ middle + t
    arms = np.einsum("vab,nb->vna", R, object_points - middle)
    covariances = np.empty((len(R), 6, 6))
    per_axis = fit.rms**2 / 2
    for i in range(len(R)):
        J = motion_jacobian(pixel_gradients(camera, centres[i] + arms[i]), arms[i])
        covariances[i] = per_axis * np.linalg.inv(J.T @ J)
    return ViewPoses(camera, object_points, corners, R, t, centres, covariances, float(fit.rms))


def motion_jacobian(by_point: Float, arms: Float) -> Float:
    """Return ∂(pixels)/∂(turn about the centre, displacement) of points that move together.

    Parameters
    ----------
    by_point : ndarray of shape (N, 2, 3)
        ∂(u, v)/∂X of each point, see :func:`pixel_gradients`.
    arms : ndarray of shape (N, 3)
        From the centre of the turn to each point.

    Returns
    -------
    ndarray of shape (2N, 6)
        Rows u₀ v₀ u₁ v₁ …
    """
    # a turn ω moves a point by ω × arm = −[arm]ₓ ω
    turns = np.array([-cross_matrix(arm) for arm in arms])
    return np.concatenate([by_point @ turns, by_point], axis=2).reshape(-1, 6)


def pixel_gradients(camera: Camera, points: Float) -> Float:
    """Return ∂(u, v)/∂X of points in the camera's frame by central differences, of shape (N, 2, 3)."""
    step = 1e-5 * float(np.abs(points[:, 2]).mean())
    moved = points + step * np.concatenate([np.eye(3), -np.eye(3)])[:, None]
    seen = camera.project(moved.reshape(-1, 3)).reshape(2, 3, len(points), 2)
    return np.moveaxis((seen[0] - seen[1]) / (2 * step), 0, -1)


def deviation(first: ViewPoses, second: ViewPoses, i: Turns, j: Turns, rig: Rig) -> tuple[Float, Float]:
    """Return (ω, d) of pairs of views from a rig, and their covariances.

    Parameters
    ----------
    first, second : ViewPoses
        Left and right.
    i, j : ndarray of shape (n,), int
        Views of the left and of the right camera.
    rig : (R, T)

    Returns
    -------
    xi : ndarray of shape (n, 6)
    covariances : ndarray of shape (n, 6, 6)
    """
    R, T = rig
    turns = second.R[j] @ np.swapaxes(R @ first.R[i], 1, 2)
    omega = np.array([rotation_vector(turn) for turn in turns])
    xi = np.hstack([omega, second.centres[j] - (first.centres[i] @ R.T + T)])
    both = np.kron(np.eye(2), R)
    return xi, second.covariances[j] + both @ first.covariances[i] @ both.T


def predicted_errors(first: ViewPoses, second: ViewPoses, i: Turns, j: Turns, rig: Rig) -> Float:
    """Return the RMS distance between the corners that the left view predicts in the right one and those measured.

    Parameters
    ----------
    first, second, i, j, rig
        See :func:`deviation`. A j below 0 stands for no partner.

    Returns
    -------
    ndarray of shape (n,)
        Pixels; NaN without a partner.
    """
    R, T = rig
    errors = np.full(len(i), np.nan)
    for n, (a, b) in enumerate(zip(i, j, strict=True)):
        if b >= 0:
            points = (first.object_points @ first.R[a].T + first.t[a]) @ R.T + T
            seen = second.camera.project(points)
            errors[n] = np.sqrt(np.mean(np.sum((seen - second.corners[b]) ** 2, axis=1)))
    return np.nan_to_num(errors, nan=np.inf)


def rough_errors(first: ViewPoses, second: ViewPoses, rigs: Float, shifts: Float, D: Float) -> Float:
    """Return what the deviations amount to in pixels, roughly, for many rigs and all pairs of views.

    Parameters
    ----------
    first, second : ViewPoses
    rigs : ndarray of shape (m, 3, 3)
        R of each rig.
    shifts : ndarray of shape (m, 3)
        T of each rig.
    D : ndarray of shape (3, 3)
        A turn of the right board about its normal.

    Returns
    -------
    ndarray of shape (m, V, V)
        [rig, left view, right view].
    """
    radius = float(np.sqrt(np.mean(np.sum((first.object_points - first.object_points.mean(axis=0)) ** 2, axis=1))))
    f = float(np.sqrt(second.camera.K[0, 0] * second.camera.K[1, 1]))
    turned = second.R @ D
    # |ω| from the trace of R_right (R R_left)ᵀ
    predicted = np.einsum("mab,ibc->miac", rigs, first.R)
    trace = np.einsum("jac,miac->mij", turned, predicted)
    angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    centres = np.einsum("mab,ib->mia", rigs, first.centres) + shifts[:, None]
    d = second.centres[None, None] - centres[:, :, None]
    depth = np.maximum(second.centres[:, 2], 1e-9)
    across = np.hypot(d[..., 0], d[..., 1])
    return np.asarray(f / depth * np.sqrt(across**2 + (radius / depth * d[..., 2]) ** 2 + (0.5 * radius * angle) ** 2))


def average_rig(first: ViewPoses, second: ViewPoses, i: Turns, j: Turns, rig: Rig) -> Rig:
    """Move a rig to the weighted least-squares mean of what the pairs see.

    Parameters
    ----------
    first, second, i, j
        See :func:`deviation`.
    rig : (R, T)
        Where to begin, near the answer.

    Returns
    -------
    (R, T)
    """
    R, T = rig
    for _ in range(5):
        xi, covariances = deviation(first, second, i, j, (R, T))
        shift, _ = common_motion(xi, covariances, first.centres[i] @ R.T)
        turn = rotation_matrix(shift[:3])
        R, T = turn @ R, T + shift[3:]
    return R, T


def common_motion(xi: Float, covariances: Float, arms: Float) -> tuple[Float, float]:
    """Return the ω₀, d₀ that explain deviations best, ω = ω₀ and d = ω₀ × c + d₀, and the χ² that is left.

    Parameters
    ----------
    xi : ndarray of shape (n, 6)
    covariances : ndarray of shape (n, 6, 6)
    arms : ndarray of shape (n, 3)
        c: from the camera's centre of turning to the board's.

    Returns
    -------
    motion : ndarray of shape (6,)
    chi2 : float
    """
    A, b = whiten(motion_design(arms), xi, covariances)
    motion, *_ = np.linalg.lstsq(A.reshape(-1, 6), b.ravel(), rcond=None)
    return np.asarray(motion), float(np.sum((A.reshape(-1, 6) @ motion - b.ravel()) ** 2))


def motion_design(arms: Float) -> Float:
    """Return the (n, 6, 6) matrices that take (ω₀, d₀) to (ω, d) = (ω₀, ω₀ × c + d₀)."""
    A = np.tile(np.eye(6), (len(arms), 1, 1))
    A[:, 3:, :3] = [-cross_matrix(c) for c in arms]
    return A


def whiten(design: Float, xi: Float, covariances: Float) -> tuple[Float, Float]:
    """Divide design and deviations by the square root of the covariances: unit noise afterwards."""
    W = np.linalg.inv(np.linalg.cholesky(covariances))
    return W @ design, (W @ xi[..., None])[..., 0]
