"""A rig as a vector of parameters, and what a change of them does to depth.

The order is that of ``StereoCalibration.parameter_names``: fx, fy, cx, cy, skew and the lens of the left camera, the
same of the right, the rotation vector, T.

**Depth.** With x_l, x_r the undistorted, normalised image points and r₁, r₂, r₃ the rows of R, the point at depth Z
on the left ray projects to the right camera at ((r₁·x̂ Z + T₁) / (r₃·x̂ Z + T₃), …), x̂ = (x_l, 1). Solved for Z from
the coordinate along the baseline (the one a matcher measures):

    Z = (T₁ − x_r T₃) / (x_r r₃·x̂ − r₁·x̂).

Its derivative by each parameter is taken at fixed pixels, through the rays that they have. With the covariance Σ of the
parameters, σ_Z² = (∂Z/∂θ) Σ (∂Z/∂θ)ᵀ is the depth error that the calibration itself causes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float
from stereocal.base.rotations import rotation_matrix, rotation_vector
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig


def rig_vector(rig: StereoRig) -> Float:
    """The parameters of a rig in a row: left intrinsics and lens, right ones, rotation vector, T."""
    return np.concatenate(
        [_camera_vector(rig.left), _camera_vector(rig.right), rotation_vector(rig.R), np.ravel(rig.T)]
    )


def _camera_vector(camera: Camera) -> Float:
    K = np.asarray(camera.K)
    return np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2], K[0, 1]], np.ravel(camera.dist)])


def rig_of_vector(values: Float, like: StereoRig) -> StereoRig:
    """The rig of a vector of parameters, its cameras of the models and sizes of `like`."""
    split = 5 + len(np.ravel(like.left.dist))
    end = split + 5 + len(np.ravel(like.right.dist))
    left, right = _camera_of(values[:split], like.left), _camera_of(values[split:end], like.right)
    return StereoRig(left, right, rotation_matrix(values[end : end + 3]), values[end + 3 : end + 6])


def _camera_of(values: Float, like: Camera) -> Camera:
    fx, fy, cx, cy, skew = values[:5]
    return Camera([[fx, skew, cx], [0, fy, cy], [0, 0, 1]], values[5:], like.image_size, like.model)


def steps(rig: StereoRig) -> Float:
    """Steps for central differences of each parameter: small against its scale, large against rounding."""

    return np.concatenate([_camera_steps(rig.left), _camera_steps(rig.right), [1e-6] * 3, [1e-6 * rig.baseline] * 3])


def _camera_steps(camera: Camera) -> Float:
    return np.array([*[1e-5 * camera.K[0, 0]] * 5, *[1e-6] * len(np.ravel(camera.dist))])


def baseline_axis(rig: StereoRig) -> int:
    """The image coordinate along which a matcher searches: 0 for x, 1 for y."""
    return int(np.argmax(np.abs(np.ravel(rig.T)[:2])))


def depths(rig: StereoRig, left: Float, right: Float) -> Float:
    """Depth in the left camera of points given by both pixels: (M, 2), (M, 2) → (M,)."""
    eye = np.eye(3)
    return _depths(
        rig.R,
        rig.T,
        rig.left.undistort_points(left, P=eye),
        rig.right.undistort_points(right, P=eye),
        baseline_axis(rig),
    )


def _depths(R: Float, T: Float, x_l: Float, x_r: Float, axis: int) -> Float:
    ray = np.concatenate([x_l, np.ones((len(x_l), 1))], axis=1)
    along, forward = ray @ R[axis], ray @ R[2]
    seen = x_r[:, axis]
    return np.asarray((T[axis] - seen * T[2]) / (seen * forward - along))


def ray_jacobian(camera: Camera, rays: Float) -> Float:
    """How the rays of fixed pixels move when the camera's parameters do, ∂x/∂θ: (M, 2) → (M, 2, p).

    The pixel π(x, θ) stands still, so that ∂x/∂θ = −(∂π/∂x)⁻¹ ∂π/∂θ. Both are central differences of projections, which
    cost a tenth of an undistortion.
    """
    theta, h = _camera_vector(camera), _camera_steps(camera)
    by_theta = []
    for i, step in enumerate(h):
        pair = []
        for sign in (1.0, -1.0):
            moved = theta.copy()
            moved[i] += sign * step
            pair.append(_project_rays(_camera_of(moved, camera), rays))
        by_theta.append((pair[0] - pair[1]) / (2 * step))
    by_x = [
        (_project_rays(camera, rays + shift) - _project_rays(camera, rays - shift)) / 2e-6 for shift in 1e-6 * np.eye(2)
    ]
    return -np.linalg.solve(np.stack(by_x, axis=-1), np.stack(by_theta, axis=-1))


def _project_rays(camera: Camera, rays: Float) -> Float:
    return np.asarray(camera.project(np.concatenate([rays, np.ones((len(rays), 1))], axis=1)))


def depth_jacobian(rig: StereoRig, left: Float, right: Float) -> Float:
    """∂Z/∂θ at fixed pixels: (M, n), the parameters in the order of :func:`rig_vector`."""
    axis, eye = baseline_axis(rig), np.eye(3)
    x_l = np.asarray(rig.left.undistort_points(left, P=eye))
    x_r = np.asarray(rig.right.undistort_points(right, P=eye))
    R, T = np.asarray(rig.R), np.ravel(rig.T)

    def difference(ahead: Float, behind: Float, step: float) -> Float:
        return (ahead - behind) / (2 * step)

    by_left, by_right = [], []
    for shift in 1e-6 * np.eye(2):
        by_left.append(difference(_depths(R, T, x_l + shift, x_r, axis), _depths(R, T, x_l - shift, x_r, axis), 1e-6))
        by_right.append(difference(_depths(R, T, x_l, x_r + shift, axis), _depths(R, T, x_l, x_r - shift, axis), 1e-6))
    columns = [
        np.einsum("mi,mip->mp", np.stack(by_left, axis=1), ray_jacobian(rig.left, x_l)),
        np.einsum("mi,mip->mp", np.stack(by_right, axis=1), ray_jacobian(rig.right, x_r)),
    ]
    rvec, step = rotation_vector(R), 1e-6 * rig.baseline
    for shift in 1e-6 * np.eye(3):
        ahead, behind = (_depths(rotation_matrix(r), T, x_l, x_r, axis) for r in (rvec + shift, rvec - shift))
        columns.append(difference(ahead, behind, 1e-6)[:, None])
    for shift in step * np.eye(3):
        ahead, behind = (_depths(R, t, x_l, x_r, axis) for t in (T + shift, T - shift))
        columns.append(difference(ahead, behind, step)[:, None])
    return np.concatenate(columns, axis=1)


def scene_points(rig: StereoRig, pixels: Float, distance: ArrayLike) -> tuple[NDArray[np.bool_], Float, Float]:
    """Points at depth `distance` seen at `pixels` of the left camera, where the right camera sees them too.

    Parameters
    ----------
    rig : StereoRig
    pixels : ndarray of shape (M, 2)
    distance : float, or ndarray of shape (M,)

    Returns
    -------
    kept : ndarray of bool, shape (M,)
        Which pixels both cameras see.
    left, right : ndarray of shape (K, 2)
        Pixels of those kept.
    """
    x = np.asarray(rig.left.undistort_points(pixels, P=np.eye(3)))
    points = np.concatenate([x, np.ones((len(x), 1))], axis=1) * np.reshape(distance, (-1, 1))
    known = np.asarray(np.isfinite(points).all(axis=1), dtype=bool)
    seen = np.asarray(rig.right.project(points[known] @ np.asarray(rig.R).T + np.ravel(rig.T)))
    width, height = rig.right.image_size
    kept = known.copy()
    kept[known] = (
        np.isfinite(seen).all(axis=1) & (seen >= 0).all(axis=1) & (seen <= (width - 1, height - 1)).all(axis=1)
    )
    inside = kept[known]
    return kept, pixels[kept], seen[inside]


@dataclass(frozen=True)
class LensDomain:
    """How far from the principal point a lens model can be undone, in the image, direction by direction.

    Attributes
    ----------
    centre : ndarray of shape (2,)
        Principal point, pixels.
    angles : ndarray of shape (A,)
        Directions, radians, −π to π.
    reach : ndarray of shape (A,)
        Distance at which the model folds, pixels; infinite if it does not within the image.
    share : float
        Share of the image inside.
    """

    centre: Float
    angles: Float
    reach: Float
    share: float

    def contains(self, pixels: Float) -> NDArray[np.bool_]:
        """Which pixels lie inside, by a margin of 2 %: (M, 2) → (M,)."""
        offset = pixels - self.centre
        limit = np.interp(np.arctan2(offset[:, 1], offset[:, 0]), self.angles, self.reach, period=2 * np.pi)
        return np.asarray(np.linalg.norm(offset, axis=1) < 0.98 * limit, dtype=bool)


def lens_domain(camera: Camera, *, directions: int = 72, stations: int = 160) -> LensDomain:
    """March outwards from the principal point until the distortion folds or the image ends.

    Along each ray the model is monotonic as long as det ∂π/∂x > 0; where it turns, several rays share a pixel. Marching
    forwards needs no inverse, which is what fails there.

    Parameters
    ----------
    camera : Camera
    directions, stations : int
        How many rays, and points on each.

    Returns
    -------
    LensDomain
    """
    width, height = camera.image_size
    centre = np.array([camera.cx, camera.cy])
    phi = -np.pi + 2 * np.pi * np.arange(directions) / directions
    farthest = 2.5 * np.hypot(width, height) / min(camera.fx, camera.fy)
    r = farthest * (np.arange(1, stations + 1) / stations)
    x = r[:, None, None] * np.stack([np.cos(phi), np.sin(phi)], axis=1)  # (stations, directions, 2)
    flat, h = x.reshape(-1, 2), 1e-6
    with np.errstate(all="ignore"):
        pixel = _project_rays(camera, flat).reshape(x.shape) - centre
        columns = [(_project_rays(camera, flat + s) - _project_rays(camera, flat - s)) / (2 * h) for s in h * np.eye(2)]
        determinant = (columns[0][:, 0] * columns[1][:, 1] - columns[0][:, 1] * columns[1][:, 0]).reshape(x.shape[:2])
        fine = np.logical_and.accumulate(determinant > 0, axis=0)
    distance = np.where(fine, np.linalg.norm(pixel, axis=2), 0.0)
    fold = distance.max(axis=0)
    angle = np.arctan2(pixel[0, :, 1], pixel[0, :, 0])
    order = np.argsort(angle)
    angle, fold, folds = angle[order], fold[order], ~fine[-1, order]
    cos, sin = np.cos(angle), np.sin(angle)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 0, (width - 0.5 - centre[0]) / cos, (-0.5 - centre[0]) / cos)
        to_y = np.where(sin > 0, (height - 0.5 - centre[1]) / sin, (-0.5 - centre[1]) / sin)
    border = np.minimum(np.where(cos == 0, np.inf, to_x), np.where(sin == 0, np.inf, to_y))
    reached = np.where(folds, np.minimum(fold, border), border)
    share = float(np.sum(reached**2) / np.sum(border**2))
    return LensDomain(centre, angle, np.where(folds & (fold < border), fold, np.inf), share)
