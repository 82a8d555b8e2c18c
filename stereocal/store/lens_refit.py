"""Another lens model that draws nearly the same picture, and how nearly.

A format with fewer lens parameters than the calibration has (Kalibr's radtan knows no k3) cannot hold it, and cutting
the parameter off moves pixels: at the corner of a webcam's image k3 = −0.05 is a pixel or two. What can be had is the
best lens of the smaller family. For rays X of the pixels x of a grid over the image, seen by the given camera,

    minimise Σ ‖π(X; f_x, f_y, c_x, c_y, k) − x‖²   over focal lengths, principal point and lens,

by Levenberg–Marquardt from the given values cut off. The camera's frame stays, so that R and T of a rig still hold. The
misfit is judged on a finer grid, corners of the image included: its largest value and its RMS are what the smaller
family costs. Pixels that the given lens cannot have seen (its map folds there) are left out, and counted.

The same serves lenses of another kind (``division``, ``fov``, ``rational_function``, ``fisheye``): their rays are
fitted as well, from a start without distortion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import InputError
from stereocal.base.least_squares import minimize_least_squares
from stereocal.camera.model import Camera

FAMILIES = {4: "brown", 5: "brown", 8: "rational", 12: "thin_prism", 14: "tilted"}
"""The model of each number of OpenCV's distortion parameters; with 4, brown's k3 stays 0."""

_OF_OPENCV = ("pinhole", "polynomial", "brown", "rational", "thin_prism", "tilted")


@dataclass(frozen=True)
class LensRefit:
    """A camera of a smaller family, and its misfit.

    Attributes
    ----------
    camera : Camera
        What was fitted.
    largest, rms : float
        Distance over the image between where the two cameras draw the same rays, pixels.
    seen : float
        The share of the image's pixels that could be compared.
    """

    camera: Camera
    largest: float
    rms: float
    seen: float

    def sentence(self, side: str, given: Camera) -> str:
        """Say what was done, for `side` being "left camera" or the like."""
        count = np.count_nonzero(self.camera.dist) if self.camera.model != "brown" else 5 - (self.camera.dist[4] == 0)
        text = (
            f"The {side}'s lens ({given.model}) is fitted anew with {count} parameters: pixels move by "
            f"{self.rms:.2g} px (RMS over the image), {self.largest:.2g} px at most."
        )
        if self.seen < 1:
            text += f" Compared on the {100 * self.seen:.0f} % of the image where the given lens can be undone."
        return text


def refit_lens(camera: Camera, parameters: int) -> LensRefit:
    """Fit a lens of 4, 5, 8, 12 or 14 of OpenCV's parameters, with focal lengths and centre, to a camera.

    Parameters
    ----------
    camera : Camera
        Any model.
    parameters : {4, 5, 8, 12, 14}
        How many the result may have: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [τx τy]]]].

    Returns
    -------
    LensRefit

    Raises
    ------
    InputError
        If the lens can be undone hardly anywhere, or has a skew.
    """
    if camera.skew:
        raise InputError(f"a skew of {camera.skew:g} px cannot be fitted by a lens")
    model = FAMILIES[parameters]
    length = 5 if parameters == 4 else parameters
    rays, pixels, _ = _rays(camera, 24, 18)
    if len(rays) < 50:
        raise InputError("the lens can be undone hardly anywhere in the image: there is nothing to fit another one to")
    still = np.zeros(3)

    def unpacked(x: Float) -> Camera:
        K = np.array([[x[0], 0, x[2]], [0, x[1], x[3]], [0, 0, 1]])
        return Camera(K, np.concatenate([x[4:], np.zeros(length - parameters)]), camera.image_size, model)

    def residuals(x: Float) -> Float:
        if min(x[:2]) <= 0:
            return np.full(pixels.size, np.nan)
        return (unpacked(x).project(rays, still, still) - pixels).ravel()

    given = camera.dist[:parameters] if camera.model in _OF_OPENCV else np.zeros(0)
    lens = np.concatenate([given, np.zeros(parameters - len(given))])
    found = unpacked(minimize_least_squares(residuals, [camera.fx, camera.fy, camera.cx, camera.cy, *lens]).x)
    rays, pixels, seen = _rays(camera, 121, 91)
    misfit = np.linalg.norm(found.project(rays, still, still) - pixels, axis=1)
    return LensRefit(found, float(misfit.max()), float(np.sqrt(np.mean(misfit**2))), seen)


def _rays(camera: Camera, columns: int, rows: int) -> tuple[Float, Float, float]:
    """Return rays (N, 3), their pixels (N, 2), and the share of a grid's pixels that have one."""
    width, height = camera.image_size
    grid = np.stack(np.meshgrid(np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows)), -1)
    pixels = grid.reshape(-1, 2)
    ideal = camera.undistort_points(pixels)
    seen = np.isfinite(ideal).all(axis=1)
    x, y = ((ideal[seen] - camera.K[:2, 2]) / np.diag(camera.K)[:2]).T
    return np.column_stack([x, y, np.ones_like(x)]), pixels[seen], float(np.mean(seen))
