"""Two cameras fixed to each other: what a stereo calibration finds.

    X_right = R X_left + T

takes a point from the left camera's frame to the right one's. The right camera's centre stands at −RᵀT in the left
frame; the baseline ‖T‖ is the distance of the centres, in the board's units of length. For a rig whose left camera
comes first, T[0] < 0.

From R, T and the camera matrices follow the two matrices of epipolar geometry,

    E = [T]ₓ R,        x̂_rightᵀ E x̂_left = 0 on the normalised plane,
    F = K_right⁻ᵀ E K_left⁻¹,        p̂_rightᵀ F p̂_left = 0 in undistorted pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_array, as_rotation
from stereocal.base.errors import InputError
from stereocal.base.homogeneous import cross_matrix
from stereocal.base.rotations import rotation_vector
from stereocal.camera.model import Camera


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Two cameras with X_right = R X_left + T.

    Parameters
    ----------
    left, right : Camera
        The cameras.
    R : array_like of shape (3, 3)
        Rotation from the left camera's frame to the right one's.
    T : array_like of 3 numbers
        Translation, in the board's units.

    Raises
    ------
    InputError
        If R is not a rotation or T is not three finite numbers.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> camera = sc.Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], None, (640, 480))
    >>> rig = sc.StereoRig(camera, camera, np.eye(3), [-60.0, 0, 0])
    >>> float(rig.baseline)
    60.0
    """

    left: Camera
    right: Camera
    R: Float
    T: Float

    def __init__(self, left: Camera, right: Camera, R: ArrayLike, T: ArrayLike) -> None:
        if not isinstance(left, Camera) or not isinstance(right, Camera):
            raise InputError("left and right must be Camera objects")
        rotation = as_rotation(R).copy()
        translation = as_array(np.ravel(np.asarray(T, dtype=np.float64)), (3,), "T").copy()
        rotation.flags.writeable = translation.flags.writeable = False
        object.__setattr__(self, "left", left)
        object.__setattr__(self, "right", right)
        object.__setattr__(self, "R", rotation)
        object.__setattr__(self, "T", translation)

    @property
    def baseline(self) -> float:
        """Distance of the two centres, ‖T‖, in the board's units."""
        return float(np.linalg.norm(self.T))

    @property
    def E(self) -> Float:
        """Essential matrix [T]ₓ R."""
        return cross_matrix(self.T) @ self.R

    @property
    def F(self) -> Float:
        """Fundamental matrix K_right⁻ᵀ E K_left⁻¹ of undistorted pixels, scaled to F[2, 2] = 1 where that is not 0."""
        F = np.linalg.inv(self.right.K).T @ self.E @ np.linalg.inv(self.left.K)
        return np.asarray(F / F[2, 2] if abs(F[2, 2]) > 1e-12 * np.abs(F).max() else F / np.linalg.norm(F))

    def summary(self) -> str:
        """Return the rig in a few lines of text."""
        om, T = rotation_vector(self.R), self.T
        return (
            f"left   {self.left.summary()}\nright  {self.right.summary()}\n"
            f"rotation left to right (rvec, rad)  {om[0]:.6f} {om[1]:.6f} {om[2]:.6f}"
            f"   {np.degrees(np.linalg.norm(om)):.3f} deg\n"
            f"translation  {T[0]:.6g} {T[1]:.6g} {T[2]:.6g}   baseline {self.baseline:.6g}"
        )

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, StereoRig):
            return NotImplemented
        return (
            self.left == other.left
            and self.right == other.right
            and np.array_equal(self.R, other.R)
            and np.array_equal(self.T, other.T)
        )

    __hash__ = None  # type: ignore[assignment]
