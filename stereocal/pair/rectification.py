"""Calibrated rectification: from a calibrated rig to two pictures whose rows match, and to the matrix that gives depth.

The steps, each in its own module:

1. ``rectifying_rotations``  both cameras are turned until they share orientation and rows: R₁, R₂, and the baseline b
   along the rows (or columns).
2. ``rectified_view``        focal length f, principal points and zoom of the new pictures: P₁, P₂, and the regions of
   interest.
3. here                      P₁ = K₁ [I | 0], P₂ = K₂ [I | b e], e the baseline's axis, and Q.
4. ``rectification_advice``  what is odd about the rig, in words.

A point (X, Y, Z) of the rectified left frame is seen at x₁ = f X/Z + cx₁ and x₂ = f (X + b)/Z + cx₂. So the disparity
d = x₁ − x₂ = −f b/Z + (cx₁ − cx₂), and Q, which undoes it, is

        | 1  0    0     −cx₁           |
    Q = | 0  1    0     −cy            |        Q (x₁, y, d, 1)ᵀ ∝ (X, Y, Z, 1)ᵀ.
        | 0  0    0      f             |
        | 0  0  −1/b  (cx₁ − cx₂)/b    |

With the first camera on the left b < 0 and d > 0. With cameras swapped b > 0, d < 0 and Z stays positive: the depth is
right, but matchers that search from 0 upwards find nothing, which is why :func:`rectify` says so in words.

The focal length is the mean of both cameras' focal lengths *across* the epipolar lines (f_y for rows), times the new
picture's scale, because it is across the lines that both pictures must agree.

Sources: J.-Y. Bouguet, *Camera Calibration Toolbox for Matlab*; OpenCV's ``stereoRectify`` (the choices in step 2).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float, as_image_size, require_choice
from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.pair.rectification_advice import rig_warnings, view_warnings
from stereocal.pair.rectified_view import (
    Size,
    border_rectangles,
    centred_principal_point,
    common_view,
    region_of_interest,
    zoom_to_fill,
)
from stereocal.pair.rectifying_rotations import rectifying_rotations

if TYPE_CHECKING:
    from stereocal.camera.model import Camera
    from stereocal.pair.rig import StereoRig

_NOTHING_IN_COMMON = "this rig cannot be rectified such that both cameras fill a rectangle of the pictures"
Maps = tuple[NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True)
class Rectification:
    """Two pictures' way into a common frame in which rows match.

    Attributes
    ----------
    rig : StereoRig
        What was rectified.
    R1, R2 : ndarray of shape (3, 3)
        Rotations from each camera's frame into its rectified frame.
    P1, P2 : ndarray of shape (3, 4)
        Projections from the rectified LEFT frame into the rectified pictures.
    Q : ndarray of shape (4, 4)
        Takes (x, y, disparity, 1) of the left rectified picture to homogeneous (X, Y, Z, 1) in the rectified left
        frame.
    roi1, roi2 : tuple of 4 ints
        x, y, width, height of a rectangle of each rectified picture in which every pixel comes from the camera.
    image_size : (int, int)
        Width and height of the rectified pictures.
    axis : int
        0: epipolar lines are rows. 1: they are columns (a vertical rig).
    """

    rig: StereoRig = field(repr=False)
    R1: Float
    R2: Float
    P1: Float
    P2: Float
    Q: Float
    roi1: tuple[int, ...]
    roi2: tuple[int, ...]
    image_size: Size
    axis: int

    @cached_property
    def warnings(self) -> list[str]:
        """What is odd about this rig and what to do about it, a sentence each; empty for a healthy one."""
        turned = rectifying_rotations(np.asarray(self.rig.R), np.ravel(self.rig.T))
        return rig_warnings(self.rig, turned) + view_warnings(self)

    @cached_property
    def _maps(self) -> tuple[Maps, Maps]:
        from stereocal.camera.undistortion import undistortion_maps

        left, right = self.rig.left, self.rig.right
        size = self.image_size
        return (
            undistortion_maps(left.K, left.dist, size, R=self.R1, P=self.P1, model=left.model),
            undistortion_maps(right.K, right.dist, size, R=self.R2, P=self.P2, model=right.model),
        )

    def maps(self) -> tuple[Maps, Maps]:
        """Return ((map_x, map_y) of the left picture, (map_x, map_y) of the right one), float32, computed once."""
        return self._maps

    def apply(
        self,
        left: ArrayLike,
        right: ArrayLike,
        *,
        interpolation: str = "bilinear",
        border_value: float = 0,
        only_valid: bool = False,
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """Rectify a pair of images.

        Parameters
        ----------
        left, right : array_like of shape (H, W) or (H, W, C)
            As the cameras took them.
        interpolation : {"bilinear", "nearest", "bicubic"}
            See :func:`stereocal.remap`.
        border_value : float
            What stands where a camera did not look.
        only_valid : bool
            Whether to blank what :meth:`valid_mask` rules out: the ghosts that a lens formula shows beyond the edge.

        Returns
        -------
        left, right : ndarray
            The rectified images, of the dtypes given.

        Raises
        ------
        InputError
            If an image has not the size that its camera was calibrated at.
        """
        from stereocal.camera.resampling import remap
        from stereocal.camera.undistortion import require_size

        pictures = []
        sides = (("left image", left, self.rig.left), ("right image", right, self.rig.right))
        for (name, image, camera), maps in zip(sides, self._maps, strict=True):
            require_size(image, camera, name)
            pictures.append(remap(image, *maps, interpolation=interpolation, border_value=border_value))
            if only_valid:
                pictures[-1][~self.valid_mask(name.removesuffix(" image"))] = border_value
        return pictures[0], pictures[1]

    def valid_mask(self, which: str = "both") -> NDArray[np.bool_]:
        """Tell which pixels of the rectified pictures truly come from the cameras.

        Parameters
        ----------
        which : {"both", "left", "right"}
            Of the left picture, of the right one, or of both at the same pixel.

        Returns
        -------
        ndarray of shape (height, width), bool
            False where the camera did not look, and where its lens formula folds over beyond the image's edge.
        """
        from stereocal.camera.undistortion import valid_pixels

        require_choice(which, ("both", "left", "right"), "which")
        sides = {
            "left": (self._maps[0], self.rig.left, self.R1, self.P1),
            "right": (self._maps[1], self.rig.right, self.R2, self.P2),
        }
        masks = [
            valid_pixels(maps, camera, R=R, P=P)
            for name, (maps, camera, R, P) in sides.items()
            if which in ("both", name)
        ]
        return np.asarray(np.logical_and.reduce(masks))

    def rectify_points(self, points: ArrayLike, which: str = "left") -> Float:
        """Take pixels of a photograph to the rectified picture.

        Parameters
        ----------
        points : array_like of shape (N, 2)
            Pixels of the photograph.
        which : {"left", "right"}
            Whose.

        Returns
        -------
        ndarray of shape (N, 2)
            Matching points have the same y (the same x for a vertical rig).
        """
        require_choice(which, ("left", "right"), "which")
        if which == "left":
            return self.rig.left.undistort_points(points, R=self.R1, P=self.P1[:, :3])
        return self.rig.right.undistort_points(points, R=self.R2, P=self.P2[:, :3])


def rectify(
    rig: StereoRig,
    *,
    alpha: float | None = None,
    zero_disparity: bool = True,
    image_size: Size | None = None,
    view: str = "opencv",
) -> Rectification:
    """Rectify a calibrated rig: R₁, R₂, P₁, P₂ and Q, such that matching points lie on one row.

    Parameters
    ----------
    rig : StereoRig
        Two cameras, of any lens models, and X_right = R X_left + T.
    alpha : float from 0 to 1, optional
        0 zooms in until no black pixel is left, 1 zooms out until no pixel of either camera is lost; without it the
        zoom keeps the focal length.
    zero_disparity : bool
        Whether both pictures share their principal point, so that disparity 0 is at infinity.
    image_size : (int, int), optional
        Width and height of the rectified pictures; without it, those of the cameras.
    view : {"opencv", "common"}
        The frame: OpenCV's rule, or the one that keeps all of the rectangle that both cameras fill (alpha must then be
        None).

    Returns
    -------
    Rectification
        With a sentence in ``.warnings`` for each thing that is odd about the rig.

    Raises
    ------
    InputError
        If an argument is out of range, or the cameras' image sizes differ.
    DegenerateGeometryError
        If the cameras stand at the same point, or see nothing in common (view="common").

    Notes
    -----
    Answers to ``cv2.stereoRectify``: R₁, R₂, P₁, P₂ and Q agree to 1e-9, ROIs are equal, for horizontal and vertical
    rigs and every lens of OpenCV's family; its alpha = −1 is None here. One case is a matter of rounding: at alpha 0
    the sides that decide the zoom fall exactly on the picture's edge, and a ROI of OpenCV's may start one pixel off.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> rectification = sc.rectify(rig)
    >>> rectification.P2.round(3) + 0.0
    array([[ 5.0e+02,  0.0e+00,  3.2e+02, -3.0e+04],
           [ 0.0e+00,  5.0e+02,  2.4e+02,  0.0e+00],
           [ 0.0e+00,  0.0e+00,  1.0e+00,  0.0e+00]])
    """
    if alpha is not None and not 0 <= alpha <= 1:
        raise InputError(f"alpha must be from 0 (no black pixels) to 1 (no pixel lost), or None, but is {alpha:g}")
    require_choice(view, ("opencv", "common"), "view")
    if view == "common" and alpha is not None:
        raise InputError("alpha must be None with view='common', which chooses the zoom itself")
    old = as_image_size(rig.left.image_size)
    if as_image_size(rig.right.image_size) != old:
        raise InputError(
            f"the left camera was calibrated at {old[0]}x{old[1]} and the right one at "
            f"{rig.right.image_size[0]}x{rig.right.image_size[1]}; both must have the same image size"
        )
    size = old if image_size is None else as_image_size(image_size)
    turned = rectifying_rotations(np.asarray(rig.R), np.ravel(rig.T))
    axis, b = turned.axis, turned.baseline
    across = 1 - axis
    f = (rig.left.K[across, across] + rig.right.K[across, across]) * (size[across] / old[across] / 2)
    sides = ((rig.left, turned.R1), (rig.right, turned.R2))
    if view == "opencv":
        frame = _frame_as_opencv(sides, f, across, alpha, zero_disparity, size)
    else:
        try:
            frame = _frame_of_common_view(sides, f, across, zero_disparity, size)
        except DegenerateGeometryError as error:
            causes = " ".join(rig_warnings(rig, turned))
            raise DegenerateGeometryError(f"{_NOTHING_IN_COMMON}: {causes or error}") from error
    f *= frame.zoom
    P1, P2 = (np.column_stack([_pinhole(f, c), np.zeros(3)]) for c in frame.centres)
    P2[axis, 3] = b * f
    Q = np.array(
        [
            [1, 0, 0, -frame.centres[0, 0]],
            [0, 1, 0, -frame.centres[0, 1]],
            [0, 0, 0, f],
            [0, 0, -1 / b, (frame.centres[0, axis] - frame.centres[1, axis]) / b],
        ]
    )
    return Rectification(rig, turned.R1, turned.R2, P1, P2, Q, *frame.rois, size, axis)


class _Frame(NamedTuple):
    """Principal points of the two pictures, zoom, regions of interest."""

    centres: Float
    zoom: float
    rois: tuple[tuple[int, ...], tuple[int, ...]]


Sides = tuple[tuple["Camera", Float], tuple["Camera", Float]]


def _frame_as_opencv(
    sides: Sides, f: float, across: int, alpha: float | None, zero_disparity: bool, size: Size
) -> _Frame:
    """Centre the pictures, then zoom by alpha between 'no black pixel' and 'no pixel lost'."""
    centres = np.array([centred_principal_point(camera, R, f) for camera, R in sides])
    shared = slice(None) if zero_disparity else across
    centres[:, shared] = centres[:, shared].mean(axis=0)
    rectangles = [border_rectangles(camera, R, _pinhole(f, c)) for (camera, R), c in zip(sides, centres, strict=True)]
    new_centres = centres * (np.array(size) / np.array(sides[0][0].image_size))
    views = list(zip(rectangles, centres, new_centres, strict=True))
    zoom = 1.0
    if alpha is not None:
        fill = max(zoom_to_fill(inner, c, new, size, cover=True) for (inner, _), c, new in views)
        fit = min(zoom_to_fill(outer, c, new, size, cover=False) for (_, outer), c, new in views)
        zoom = fill * (1 - alpha) + fit * alpha
    rois = [region_of_interest(inner, c, new, zoom, size) for (inner, _), c, new in views]
    return _Frame(new_centres, zoom, (rois[0], rois[1]))


def _frame_of_common_view(sides: Sides, f: float, across: int, zero_disparity: bool, size: Size) -> _Frame:
    """Fit the rectangle that both cameras fill into the picture."""
    inner = [border_rectangles(camera, R, _pinhole(f, np.zeros(2)))[0] for camera, R in sides]
    shared = (zero_disparity or across == 0, zero_disparity or across == 1)
    centres, zoom = common_view(inner, size, shared=shared)
    rois = [region_of_interest(r, np.zeros(2), c, zoom, size) for r, c in zip(inner, centres, strict=True)]
    return _Frame(centres, zoom, (rois[0], rois[1]))


def _pinhole(f: float, centre: Float) -> Float:
    return np.array([[f, 0, centre[0]], [0, f, centre[1]], [0, 0, 1]])
