"""Where the iteration starts: candidates for the camera matrix, the poses that go with them, and the first lens.

Each candidate K is judged by what it is for: the poses [r1 r2 t] = λK⁻¹H are taken from the homographies, the corners
are projected by an ideal lens, and the candidate with the least distance to the measured corners wins. Candidates
are, in turn,

1. Zhang's closed form without skew;
2. Zhang's closed form with the principal point at the middle of the image, fx and fy free;
3. a focal-length search: fx = fy = 0.25 … 8 image widths, in steps of 2^¼, principal point in the middle.

The first is right for good views of a mild lens. Noise, small tilts and strong distortion throw it off (B is not
positive definite, or the principal point lands outside of the image) and the others stand in: a fixed focal length
cannot fail, and the search only has to come within the basin of Levenberg–Marquardt.

The lens starts from none, or, for models whose parameters do not begin at zero or that undo badly, in stages: a fit
with k1, k2, and then the model's own k (and a scale of the focal length) fitted to that lens's curve at the corners
seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError
from stereocal.base.least_squares import minimize_least_squares
from stereocal.camera.distortion_base import DistortionModel
from stereocal.camera.distortion_polynomial import Polynomial
from stereocal.camera.homography import fit_homography
from stereocal.camera.zhang import poses_of_homographies, zhang_intrinsics


@dataclass
class Start:
    """A start: K and the poses of the views, and the reprojection error of an ideal lens with them."""

    K: Float
    R: Float
    t: Float
    error: float


def homographies_of_views(objects: list[Float], images: list[Float]) -> Float:
    """Return H of every view, (V, 3, 3)."""
    return np.stack([fit_homography(X[:, :2], y, refine=False) for X, y in zip(objects, images, strict=True)])


def start_from(K: Float, H: Float, objects: list[Float], images: list[Float]) -> Start:
    """Return the start with a given K: poses from the homographies, and their error."""
    R, t = poses_of_homographies(K, H)
    total, count = 0.0, 0
    for X, y, R_v, t_v in zip(objects, images, R, t, strict=True):
        h = (X @ R_v.T + t_v) @ K.T
        if np.any(h[:, 2] <= 0):
            return Start(K, R, t, np.inf)
        total += float(np.sum((h[:, :2] / h[:, 2:] - y) ** 2))
        count += len(X)
    return Start(K, R, t, float(np.sqrt(total / count)))


def candidate_starts(
    H: Float,
    objects: list[Float],
    images: list[Float],
    image_size: tuple[int, int],
    *,
    aspect_ratio: float | None = None,
) -> list[Start]:
    """Return starts, the most promising first; the focal-length search always yields one.

    Parameters
    ----------
    H : ndarray of shape (V, 3, 3)
        Homographies of the views.
    objects, images : list of ndarray
        Board points and corners.
    image_size : (int, int)
        Width and height.
    aspect_ratio : float, optional
        fx / fy where it is known.

    Returns
    -------
    list of Start
    """
    width, height = image_size
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    starts = []
    for options in ({"skew": False}, {"principal_point": middle}):
        try:
            K = zhang_intrinsics(H, **options)
        except DegenerateGeometryError:
            continue  # this closed form has no answer here; the next candidate stands in
        if _plausible(K, width, height):
            if aspect_ratio is not None:
                K[0, 0] = aspect_ratio * K[1, 1]
            starts.append(start_from(K, H, objects, images))
    starts = [start for start in starts if np.isfinite(start.error)]
    starts.sort(key=lambda start: start.error)
    return starts + focal_search(H, objects, images, image_size, aspect_ratio=aspect_ratio)


def focal_search(
    H: Float,
    objects: list[Float],
    images: list[Float],
    image_size: tuple[int, int],
    *,
    aspect_ratio: float | None = None,
) -> list[Start]:
    """Return the starts with fx = 0.25 … 8 widths that are local minima of the error, best first."""
    width, height = image_size
    a = aspect_ratio or 1.0
    starts = []
    for f in width * 2.0 ** np.arange(-2, 3.01, 0.25):
        K = np.array([[f, 0, (width - 1) / 2], [0, f / a, (height - 1) / 2], [0, 0, 1.0]])
        starts.append(start_from(K, H, objects, images))
    errors = np.array([np.inf, *(start.error for start in starts), np.inf])
    least = [i for i in range(len(starts)) if errors[i + 1] <= min(errors[i], errors[i + 2]) and errors[i + 1] < np.inf]
    return sorted((starts[i] for i in least), key=lambda start: start.error)


def _plausible(K: Float, width: int, height: int) -> bool:
    return bool(
        0.1 * width < K[0, 0] < 20 * width
        and 0.4 < K[0, 0] / K[1, 1] < 2.5
        and -0.25 * width < K[0, 2] < 1.25 * width
        and -0.25 * height < K[1, 2] < 1.25 * height
    )


def convert_lens(target: DistortionModel, k12: Float, x: Float) -> tuple[Float, float]:
    """Return the k of `target`, and a scale a of the focal length, with a·x_d(x; k) = the curve of k1, k2 at points x.

    Parameters
    ----------
    target : DistortionModel
        The model to start.
    k12 : ndarray of shape (2,)
        Coefficients of the polynomial model.
    x : ndarray of shape (N, 2)
        Ideal points that were seen.

    Returns
    -------
    k : ndarray
    scale : float
    """
    wanted = Polynomial().distort(x, k12)
    free = np.array([name not in target.fixed_by_default for name in target.parameter_names])
    k = target.start()

    def curve(p: Float) -> Float:
        trial = k.copy()
        trial[free] = p[1:]
        return np.asarray((p[0] * target.distort(x, trial) - wanted).ravel())

    fit = minimize_least_squares(curve, np.concatenate([[1.0], k[free]]), max_iterations=60)
    k[free] = fit.x[1:]
    return k, float(fit.x[0])
