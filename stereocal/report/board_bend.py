"""Is the board flat? One step of the fit with the board's shape set free.

A flat model of a bent board leaves residuals, but fewer than the bend is worth: the poses, the lens and the rig move to
take up what they can. So the shape cannot be read off the residuals alone; everything has to be free together. From the
flat optimum one Gauss–Newton step of the larger problem tells, to first order, where its optimum lies. Unknowns are the
rig's parameters θ, the shape β with board points X + Φβ, and each view's pose (ω, τ):

    [U  W] [δz]   [b_z]
    [Wᵀ V] [δv] = [b_v],     z = (θ, β),

V is block diagonal, so that the poses are eliminated view by view, (U − Σ W_v V_v⁻¹ W_vᵀ) δz = b_z − Σ W_v V_v⁻¹ b_v.
Φ spans the heights of all corners over the board's plane, without the plane itself (3 of N dimensions, which the poses
already have), and the two ways a print is stretched: aspect and shear.

δβ is the bend, with its covariance σ²S⁻¹; δθ is how far the flat model pushed the cameras, and through ∂Z/∂θ how far
depth is off because of it. The improvement of the squared residuals per added unknown, over what noise alone would buy,
is the F statistic that tells a bend from chance.

Sources: Strobl and Hirzinger (2011); OpenCV's calibrateCameraRO, which iterates the same problem with points instead
of a basis; the step and its use as a test are ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.report.evidence import Evidence, project, projection_jacobian
from stereocal.report.rig_parameters import rig_of_vector, rig_vector, steps


@dataclass(frozen=True)
class BoardBend:
    """What the step says.

    Attributes
    ----------
    heights : ndarray of shape (N,)
        Of the corners over the board's plane, board units; positive away from the camera.
    sigma : ndarray of shape (N,)
        Their standard errors.
    rms : float
        RMS of the heights, with the part that noise explains taken off.
    parameter_change : ndarray of shape (n,)
        δθ: from the flat optimum to the free one.
    change_covariance : ndarray of shape (n, n)
        Covariance that δθ has by chance if the board is flat: Cov(θ, free) − Cov(θ, flat), as for any nested models.
    f_statistic : float
        Improvement per added unknown over the noise that is left; about 1 by chance.
    """

    heights: Float
    sigma: Float
    rms: float
    parameter_change: Float
    change_covariance: Float
    f_statistic: float


def bend_basis(object_points: Float) -> Float:
    """Φ: shapes a board can take, without those that a pose already has, (N, 3, N − 3 + 2)."""
    X = object_points - object_points.mean(axis=0)
    count = len(X)
    plane = np.linalg.qr(np.stack([np.ones(count), X[:, 0], X[:, 1]], axis=1))[0]
    heights = np.linalg.svd(np.eye(count) - plane @ plane.T)[0][:, : count - 3]
    basis = np.zeros((count, 3, count - 1))
    basis[:, 2, : count - 3] = heights
    size = np.sqrt(np.mean(X[:, :2] ** 2))
    basis[:, 0, count - 3], basis[:, 1, count - 3] = X[:, 0] / size, -X[:, 1] / size
    basis[:, 0, count - 2], basis[:, 1, count - 2] = X[:, 1] / size, X[:, 0] / size
    return basis


def free_the_board(evidence: Evidence, free: NDArray[np.bool_]) -> BoardBend | None:
    """Take one step with the board's shape free.

    Parameters
    ----------
    evidence : Evidence
        A fit at its optimum.
    free : ndarray of bool, shape (n,)
        Which of the rig's parameters the fit had free.

    Returns
    -------
    BoardBend, or None
        None if the views are too few to tell.
    """
    basis = bend_basis(evidence.object_points)
    shapes = basis.shape[2]
    parameters = int(np.count_nonzero(free))
    freedom = evidence.residuals.size - 6 * evidence.view_count - parameters - shapes
    if freedom < evidence.residuals.size // 4:
        return None
    J_rig = _rig_jacobian(evidence)[..., free]  # (2, V, N, 2, p)
    U, b = np.zeros((parameters + shapes,) * 2), np.zeros(parameters + shapes)
    R = np.asarray(evidence.rig.R)
    sides = (
        (evidence.rig.left, evidence.points_left, evidence.left_residuals, np.eye(3)),
        (evidence.rig.right, evidence.points_right, evidence.right_residuals, R),
    )
    V, b_v = np.zeros((evidence.view_count, 6, 6)), np.zeros((evidence.view_count, 6))
    W = np.zeros((evidence.view_count, parameters + shapes, 6))
    for side, (camera, points, residuals, turn) in enumerate(sides):
        J_X = projection_jacobian(camera, points) @ turn  # by the point in the left camera's frame
        J_shape = np.einsum("vnij,vjk,nks->vnis", J_X, evidence.rotations, basis)
        J_pose = np.concatenate([np.cross(evidence.points_left[:, :, None, :], J_X), J_X], axis=-1)
        J = np.concatenate([J_rig[side], J_shape], axis=-1).reshape(evidence.view_count, -1, parameters + shapes)
        P, r = J_pose.reshape(evidence.view_count, -1, 6), residuals.reshape(evidence.view_count, -1)
        flat = J.reshape(-1, parameters + shapes)
        U += flat.T @ flat
        b += flat.T @ r.ravel()
        V += np.einsum("vki,vkj->vij", P, P)
        b_v += np.einsum("vki,vk->vi", P, r)
        W += np.swapaxes(J, 1, 2) @ P
    V_inv_Wt = np.linalg.solve(V, np.swapaxes(W, 1, 2))
    S = U - np.einsum("vij,vjk->ik", W, V_inv_Wt)
    g = b - np.einsum("vji,vj->i", V_inv_Wt, b_v)
    scale = 1 / np.sqrt(np.maximum(np.diag(S), 1e-300))
    S_inv = np.linalg.pinv(S * np.outer(scale, scale), rcond=1e-13, hermitian=True) * np.outer(scale, scale)
    step = S_inv @ g
    gain = float(g @ step)
    left_over = max(float(np.sum(evidence.residuals**2)) - gain, 1e-300)
    variance = left_over / freedom
    beta, cov_beta = step[parameters:], variance * S_inv[parameters:, parameters:]
    heights = basis[:, 2] @ beta
    sigma = np.sqrt(np.maximum(np.einsum("ns,st,nt->n", basis[:, 2], cov_beta, basis[:, 2]), 0))
    excess = float(np.mean(heights**2) - np.mean(sigma**2))
    change = np.zeros(len(free))
    change[free] = step[:parameters]
    flat_inverse = np.linalg.pinv(S[:parameters, :parameters], hermitian=True)
    chance = np.zeros((len(free), len(free)))
    at = np.flatnonzero(free)
    chance[np.ix_(at, at)] = variance * (S_inv[:parameters, :parameters] - flat_inverse)
    return BoardBend(heights, sigma, float(np.sqrt(max(excess, 0.0))), change, chance, gain / shapes / variance)


def _rig_jacobian(evidence: Evidence) -> Float:
    """∂x/∂θ of every projection by central differences, (2, V, N, 2, n)."""
    theta, h = rig_vector(evidence.rig), steps(evidence.rig)
    columns = []
    for i, step in enumerate(h):
        moved = []
        for sign in (1, -1):
            shift = np.zeros_like(theta)
            shift[i] = sign * step
            rig = rig_of_vector(theta + shift, evidence.rig)
            right = evidence.points_left @ np.asarray(rig.R).T + np.ravel(rig.T)
            moved.append(np.stack([project(rig.left, evidence.points_left), project(rig.right, right)]))
        columns.append((moved[0] - moved[1]) / (2 * step))
    return np.stack(columns, axis=-1)
