"""Which part of the plane the rectified pictures show: principal points, zoom, and the regions that hold pixels.

After the rotations are chosen, each camera sees the rectified plane through a new pinhole with focal length f and
principal point (cx, cy), which are free: they only crop and scale. They are chosen in two steps.

**Centre.** The four corners of each picture are undistorted, rotated and projected with focal length f; the principal
point is put where the mean of the four falls into the middle of the picture. Both cameras share cy (or cx, for a
vertical rig), or rows would not match. With `zero_disparity` they share both, so that points at infinity have disparity
0; else each camera keeps its own centre, the common field of view is wider, and Q's last entry makes up for it.

**Zoom.** Of the undistorted border of a picture two rectangles are taken: the *inner* one lies wholly within the
picture, the *outer* one holds all of it. Let s₀ be the zoom at which both inner rectangles fill the new picture (no
black pixel is left), s₁ the zoom at which both outer ones fit into it (no pixel is lost). alpha blends them, s =
(1 − alpha) s₀ + alpha s₁; without alpha s = 1. The region of interest (ROI) of a camera is its inner rectangle under s,
clipped to the picture, rounded inwards.

The rectangles come from a grid of 9 by 9 pixels, border included, and with OpenCV's five steps of its fixed-point
undistortion, because the point of this rule is to give the *same* pictures as ``cv2.stereoRectify``. Where the
distortion is strong, five steps are not enough, and the frame that OpenCV picks is a little off its own definition.
That costs nothing but a few pixels of crop: rectified rows match in any frame. Models that OpenCV does not know are
undistorted to convergence, and rays further than 75° off the axis, which no flat picture can show, are left out.

**The common view.** OpenCV's rule centres each picture and looks at zoom only, and so may cut off what both cameras see
while it shows what only one does. :func:`common_view` takes the rectangle that lies within *both* inner rectangles,
brings its middle to the middle of the picture, and zooms until it just fits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError
from stereocal.base.homogeneous import to_homogeneous
from stereocal.camera.undistortion import opencv_coefficients, tilt_matrix

if TYPE_CHECKING:
    from stereocal.camera.model import Camera

_GRID = 9
_OPENCV_STEPS = 5
_WIDEST = float(np.tan(np.radians(75)))
Size = tuple[int, int]


def undistort_border(points: Float, camera: Camera) -> Float:
    """Undistort pixels to normalised coordinates as ``cv2.stereoRectify`` sees them: five fixed-point steps.

    Parameters
    ----------
    points : ndarray of shape (N, 2)
        Pixels.
    camera : Camera
        Its model decides: OpenCV's family k1 … τy takes x ← (x₀ − tangential(x)) / radial(x) five times, the
        others are undistorted to convergence.

    Returns
    -------
    ndarray of shape (N, 2)
        (x, y) at z = 1; NaN for rays that a flat picture cannot show (models outside of OpenCV's family).
    """
    k = opencv_coefficients(camera.dist, camera.model)
    if k is None:
        rays = camera.undistort_points(points, P=np.eye(3))
        with np.errstate(invalid="ignore"):
            too_far = ~(np.hypot(rays[:, 0], rays[:, 1]) <= _WIDEST)
        return np.where(too_far[:, None], np.nan, rays)
    K = camera.K
    start = given = np.stack(
        [(points[:, 0] - K[0, 2]) * (1 / K[0, 0]), (points[:, 1] - K[1, 2]) * (1 / K[1, 1])], axis=1
    )
    if k[12] or k[13]:
        upright = to_homogeneous(start) @ np.linalg.inv(tilt_matrix(k[12], k[13])).T
        start = upright[:, :2] / upright[:, 2:]
    x0, y0 = start.T
    x, y = start.T.copy()
    alive = np.ones(len(points), dtype=bool)
    for _ in range(_OPENCV_STEPS):
        r2 = x * x + y * y
        shrink = (1 + ((k[7] * r2 + k[6]) * r2 + k[5]) * r2) / (1 + ((k[4] * r2 + k[1]) * r2 + k[0]) * r2)
        dx = 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x) + k[8] * r2 + k[9] * r2 * r2
        dy = k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y + k[10] * r2 + k[11] * r2 * r2
        # a negative factor would turn the point through the centre: OpenCV gives up and returns the distorted point
        alive &= shrink >= 0
        x = np.where(alive, (x0 - dx) * shrink, given[:, 0])
        y = np.where(alive, (y0 - dy) * shrink, given[:, 1])
    return np.stack([x, y], axis=1)


def centred_principal_point(camera: Camera, R: Float, focal_length: float) -> Float:
    """Return the principal point that puts the mean of the four rotated picture corners into the picture's middle.

    Parameters
    ----------
    camera : Camera
        The camera before rectification.
    R : ndarray of shape (3, 3)
        Its rectifying rotation.
    focal_length : float
        Of the rectified picture, in pixels.

    Returns
    -------
    ndarray of shape (2,)

    Notes
    -----
    OpenCV carries the corners in float32; so does this, or principal points would differ by 1e-5 px.
    """
    width, height = camera.image_size
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    corners = np.array([(0, 0), (width - 1, 0), (0, height - 1), (width - 1, height - 1)], dtype=float)
    rays = undistort_border(corners, camera)
    shrink = 1.0
    while np.isnan(rays).any():
        # a wide lens: move the corners towards the middle until a flat picture can show them
        shrink *= 0.9
        if shrink < 0.1:
            raise DegenerateGeometryError("the lens model cannot be undone near the image's middle; calibrate again")
        rays = undistort_border(middle + shrink * (corners - middle), camera)
    turned = to_homogeneous(rays.astype(np.float32).astype(float)) @ R.T
    projected = (turned[:, :2] / turned[:, 2:] * focal_length).astype(np.float32).astype(float)
    return np.asarray(middle - projected.mean(axis=0))


def border_rectangles(camera: Camera, R: Float, P: Float) -> tuple[Float, Float]:
    """Return the inner and the outer rectangle of a camera's rectified border as (x, y, width, height).

    Parameters
    ----------
    camera : Camera
        The camera before rectification.
    R : ndarray of shape (3, 3)
        Its rectifying rotation.
    P : ndarray of shape (3, 3)
        The new camera matrix.

    Returns
    -------
    inner, outer : ndarray of shape (4,)
        Pixels of the new picture: the largest rectangle within the border's four bent sides, and the smallest
        around them.
    """
    width, height = camera.image_size
    x = np.arange(_GRID) * ((width - 1) / (_GRID - 1))
    y = np.arange(_GRID) * ((height - 1) / (_GRID - 1))
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    x, y = undistort_border(pixels, camera).T
    H = P @ R
    per_w = 1 / (H[2, 0] * x + H[2, 1] * y + H[2, 2])
    u = ((H[0, 0] * x + H[0, 1] * y + H[0, 2]) * per_w).reshape(_GRID, _GRID)
    v = ((H[1, 0] * x + H[1, 1] * y + H[1, 2]) * per_w).reshape(_GRID, _GRID)
    if np.isnan(u).any():
        u, v = _nearest_known(u), _nearest_known(v)
    inner = _rectangle(u[:, 0].max(), v[0].max(), u[:, -1].min(), v[-1].min())
    return inner, _rectangle(u.min(), v.min(), u.max(), v.max())


def _nearest_known(grid: Float) -> Float:
    """Fill NaN nodes, which a flat picture cannot show, with the nearest node towards the middle of the grid."""
    known = np.argwhere(~np.isnan(grid))
    if len(known) == 0:
        raise DegenerateGeometryError("nothing of this camera's view can be shown on the rectified plane")
    filled = grid.copy()
    for i, j in np.argwhere(np.isnan(grid)):
        nearest = known[np.argmin(np.sum((known - (i, j)) ** 2, axis=1))]
        filled[i, j] = grid[tuple(nearest)]
    return filled


def _rectangle(x0: float, y0: float, x1: float, y1: float) -> Float:
    return np.array([x0, y0, x1 - x0, y1 - y0])


def zoom_to_fill(rectangle: Float, centre: Float, new_centre: Float, size: Size, *, cover: bool) -> float:
    """Return the zoom about the principal point at which a rectangle fills the picture (cover) or fits into it.

    Parameters
    ----------
    rectangle : ndarray of shape (4,)
        x, y, width, height at zoom 1.
    centre, new_centre : ndarray of shape (2,)
        The principal point at zoom 1 in the old picture, and in the new one.
    size : (int, int)
        Width and height of the new picture.
    cover : bool
        True: the largest of the four ratios (nothing of the picture is outside the rectangle); False: the smallest.
    """
    far = np.array(size) - 1 - new_centre
    corner, extent = rectangle[:2], rectangle[2:]
    ratios = np.concatenate([new_centre / (centre - corner), far / (corner + extent - centre)])
    return float(ratios.max() if cover else ratios.min())


def region_of_interest(inner: Float, centre: Float, new_centre: Float, zoom: float, size: Size) -> tuple[int, ...]:
    """Zoom the inner rectangle, round it inwards and clip it to the picture: (x, y, width, height).

    Notes
    -----
    All four are 0 where nothing is left, as in OpenCV.
    """
    x, y = np.ceil((inner[:2] - centre) * zoom + new_centre).astype(int)
    width, height = np.floor(inner[2:] * zoom).astype(int)
    x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + width, size[0]), min(y + height, size[1])
    if x1 <= x0 or y1 <= y0:
        return 0, 0, 0, 0
    return int(x0), int(y0), int(x1 - x0), int(y1 - y0)


def common_view(rectangles: list[Float], size: Size, *, shared: tuple[bool, bool]) -> tuple[Float, float]:
    """Frame what both cameras see: the principal points' shift and the zoom that fit it into the picture.

    Parameters
    ----------
    rectangles : list of two ndarrays of shape (4,)
        Inner rectangles (x, y, width, height) of the two pictures, relative to their principal points, at zoom 1.
    size : (int, int)
        Width and height of the new picture.
    shared : (bool, bool)
        Along x and along y: must both pictures have the same principal point? Where they need not, each picture is
        centred on what its own camera sees.

    Returns
    -------
    centres : ndarray of shape (2, 2)
        Principal points of the two pictures.
    zoom : float

    Raises
    ------
    DegenerateGeometryError
        If no rectangle is seen by both.
    """
    low = np.array([r[:2] for r in rectangles])
    high = np.array([r[:2] + r[2:] for r in rectangles])
    for axis in (0, 1):
        if shared[axis]:
            low[:, axis], high[:, axis] = low[:, axis].max(), high[:, axis].min()
    if not np.all(high > low):
        raise DegenerateGeometryError(
            "no part of the rectified plane is seen by both cameras; check that left and right belong together, and "
            "that the calibration fits these cameras"
        )
    last = np.array(size) - 1
    zoom = float((last / (high - low)).min())
    return last / 2 - zoom * (low + high) / 2, zoom
