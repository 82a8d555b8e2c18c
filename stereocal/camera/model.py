"""A camera: its matrix, its lens and the size of its images [eq 12].

    K = [[fx, s, cx], [0, fy, cy], [0, 0, 1]]

fx, fy are the focal length in pixels along rows and columns, (cx, cy) is the principal point, s the skew (0 for every
camera whose pixels are rectangles). The paper's [eq 12] writes W for K and (s_x, s_y) for (cx, cy).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_camera_matrix, as_image_size
from stereocal.camera.distortion import as_distortion, distort_points, distortion_model, model_meant, undistort_points
from stereocal.camera.projection import project_points


@dataclass(frozen=True, eq=False)
class Camera:
    """A camera with matrix K and a distortion model, [eq 12].

    Parameters
    ----------
    K : array_like of shape (3, 3)
        [[fx, s, cx], [0, fy, cy], [0, 0, 1]], pixels; (0, 0) is the centre of the first pixel.
    dist : array_like or None
        Coefficients of the model, OpenCV's order; None for none.
    image_size : (int, int)
        Width and height, pixels.
    model : str
        Distortion model: pinhole, polynomial, brown, rational, thin_prism, tilted, fisheye, fov, division,
        rational_function (see ``distortion``). Where it is not named, 8, 12 or 14 coefficients are taken for rational,
        thin_prism or tilted, as in OpenCV.

    Raises
    ------
    InputError
        If K is not a camera matrix, the coefficients do not fit the model, or the size is not positive.

    Examples
    --------
    >>> camera = Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], [-0.3, 0.1], (640, 480))
    >>> camera.project([[0.0, 0.0, 2.0]])
    array([[320., 240.]])
    """

    K: Float
    dist: Float
    image_size: tuple[int, int]
    model: str = "brown"

    def __init__(self, K: ArrayLike, dist: ArrayLike | None, image_size: tuple[int, int], model: str = "brown") -> None:
        matrix = as_camera_matrix(K).copy()
        model = model_meant(dist, model)
        k = as_distortion(dist, model).copy()
        matrix.flags.writeable = k.flags.writeable = False
        object.__setattr__(self, "K", matrix)
        object.__setattr__(self, "dist", k)
        object.__setattr__(self, "image_size", as_image_size(image_size))
        object.__setattr__(self, "model", model)

    @property
    def fx(self) -> float:
        """Focal length along rows, pixels."""
        return float(self.K[0, 0])

    @property
    def fy(self) -> float:
        """Focal length along columns, pixels."""
        return float(self.K[1, 1])

    @property
    def cx(self) -> float:
        """Principal point, x, pixels."""
        return float(self.K[0, 2])

    @property
    def cy(self) -> float:
        """Principal point, y, pixels."""
        return float(self.K[1, 2])

    @property
    def skew(self) -> float:
        """Skew s = K[0, 1], pixels."""
        return float(self.K[0, 1])

    def project(self, X: ArrayLike, rvec: ArrayLike = (0, 0, 0), tvec: ArrayLike = (0, 0, 0)) -> Float:
        """Project points of the board's or world's frame; see :func:`~stereocal.camera.projection.project_points`.

        Parameters
        ----------
        X : array_like of shape (N, 3)
            Points.
        rvec, tvec : array_like of 3 numbers
            Pose of their frame; by default X is in the camera's own.

        Returns
        -------
        ndarray of shape (N, 2)
        """
        return project_points(X, rvec, tvec, self.K, self.dist, model=self.model)

    def undistort_points(self, x: ArrayLike, *, R: ArrayLike | None = None, P: ArrayLike | None = None) -> Float:
        """Move pixels to where an ideal camera draws them; see ``distortion.undistort_points``."""
        return undistort_points(x, self.K, self.dist, model=self.model, R=R, P=P)

    def distort_points(self, x: ArrayLike) -> Float:
        """Move ideal pixels to where this camera draws them; see ``distortion.distort_points``."""
        return distort_points(x, self.K, self.dist, model=self.model)

    def summary(self) -> str:
        """Return the camera in a few lines of text."""
        names = distortion_model(self.model).parameter_names
        lens = "  ".join(f"{name} {value:.5g}" for name, value in zip(names, self.dist, strict=True)) or "none"
        skew = f"  skew {self.skew:.4f}" if self.skew else ""
        return (
            f"{self.image_size[0]}x{self.image_size[1]}, {self.model}\n"
            f"  fx {self.fx:.3f}  fy {self.fy:.3f}  cx {self.cx:.3f}  cy {self.cy:.3f}{skew}\n"
            f"  {lens}"
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Camera):
            return NotImplemented
        return (
            self.model == other.model
            and self.image_size == other.image_size
            and np.array_equal(self.K, other.K)
            and np.array_equal(self.dist, other.dist)
        )

    __hash__ = None  # type: ignore[assignment]
