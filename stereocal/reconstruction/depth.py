"""From disparity to depth: where each matched pixel is in space, and how far that can be trusted.

In a rectified pair a point at (X, Y, Z) is seen in the left image at x = f X/Z + cx and in the right one at
x' = f (X - B)/Z + cx', B the baseline. The difference of the two columns holds the depth alone:

    d = x - x' = f B / Z + (cx - cx')        so        Z = f B / (d - (cx - cx')).

Rectification writes that as one 4x4 matrix Q, which takes (x, y, d) to homogeneous coordinates,

    [X Y Z W]ᵀ ~ Q [x y d 1]ᵀ,      Q = [[1, 0, 0, -cx], [0, 1, 0, -cy], [0, 0, 0, f], [0, 0, 1/B, -(cx - cx')/B]],

and the point is (X, Y, Z)/W. For a rig whose cameras stand one above the other the disparity is y - y', and Q alone
knows of it: nothing below asks which way the baseline runs.

**How good the depth is.** Let the disparity be off by σ_d. With Z = z/W, both linear in d,

    ∂Z/∂d = (Q[2, 2] - Z Q[3, 2]) / W = -Z²/(f B),        σ_Z = |∂Z/∂d| σ_d = Z² σ_d / (f B),

so the error grows with the SQUARE of the distance: a rig that is good to 1 cm at 1 m is good to 25 cm at 5 m. The
calibration's own error comes on top of it.

Units of length are those of Q's baseline, which are those of the board's ``square_size``. The frame is the rectified
left camera's: x right, y down, z forward.

Sources: R. Hartley and A. Zisserman, *Multiple View Geometry* (2004), chapter 11; D. Gallup et al., *Variable
baseline/resolution stereo* (2008), for the law of the square.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float, as_array, require_positive
from stereocal.base.errors import DegenerateGeometryError, InputError

Points = NDArray[np.float32]
"""A map of points, (H, W, 3), or of one length a pixel, (H, W); NaN where there is none."""


def reprojection_matrix(
    focal_length: float,
    principal_point: tuple[float, float],
    baseline: float,
    *,
    principal_offset: float = 0.0,
) -> Float:
    """Return Q of a rectified horizontal pair from its five numbers: Z = f B / (d + doffs).

    Parameters
    ----------
    focal_length : float
        f of both rectified cameras, pixels.
    principal_point : (float, float)
        (cx, cy) of the left camera, pixels.
    baseline : float
        B > 0, in the unit that the points are wanted in.
    principal_offset : float
        doffs = cx' - cx, the right camera's principal point less the left one's (Middlebury's ``doffs``), pixels.

    Returns
    -------
    ndarray of shape (4, 4), float64

    Raises
    ------
    InputError
        If the focal length or the baseline is not above 0, or a number is not finite.

    Notes
    -----
    The Q that ``cv2.stereoRectify`` returns for such a rig (tested equal). With a calibrated rig take the Q of
    :func:`stereocal.rectify`; this one is for data sets that publish f, B and doffs.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> Q = sc.reprojection_matrix(500.0, (320.0, 240.0), 60.0)
    >>> X = Q @ [320, 240, 30, 1]
    >>> (X[:3] / X[3]).round(6) + 0.0  # Z = f B / d
    array([   0.,    0., 1000.])
    """
    f = require_positive(focal_length, "focal_length")
    B = require_positive(baseline, "baseline")
    cx, cy = as_array(principal_point, (2,), "principal_point")
    (doffs,) = as_array([principal_offset], (1,), "principal_offset")
    return np.array([[1, 0, 0, -cx], [0, 1, 0, -cy], [0, 0, 0, f], [0, 0, 1 / B, doffs / B]], dtype=np.float64)


def disparity_to_points(disparity: ArrayLike, Q: ArrayLike) -> Points:
    """Return the point in space of every pixel, (X, Y, Z)/W with [X Y Z W]ᵀ = Q [x y d 1]ᵀ.

    Parameters
    ----------
    disparity : array_like of shape (H, W)
        Of the left image, pixels; NaN, infinite or masked where there is none.
    Q : array_like of shape (4, 4)
        Reprojection matrix, as of :func:`stereocal.rectify` or ``cv2.stereoRectify``; horizontal or vertical rig.

    Returns
    -------
    ndarray of shape (H, W, 3), float32
        In the rectified left camera's frame and the unit of Q's baseline. NaN, all three coordinates, where the
        disparity is not finite. A disparity of exactly W = 0 is a point at infinity and comes back as such; one beyond
        it lies behind the camera (Z < 0) and can only be a wrong match.

    Raises
    ------
    InputError
        If `disparity` is not (H, W) or Q not 4x4 and finite.
    DegenerateGeometryError
        If Q's last row does not depend on the disparity, so that every depth would be the same.

    Notes
    -----
    Answers to ``cv2.reprojectImageTo3D``: the same float32 to the last bit wherever there is a disparity (OpenCV gives
    a point, far away, even where there is none).

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> Q = sc.reprojection_matrix(500.0, (320.0, 240.0), 60.0)
    >>> disparity = np.full((480, 640), 30.0, np.float32)
    >>> points = sc.disparity_to_points(disparity, Q)
    >>> points[240, 320].round(3) + 0.0
    array([   0.,    0., 1000.], dtype=float32)
    """
    d, matrix = _disparity_and_q(disparity, Q)
    height, width = d.shape
    y, x = np.ogrid[:height, :width]
    # Rows of Q one by one: four (H, W) planes rather than one (H, W, 4) array of doubles.
    numerators = [(q[0] * x + q[1] * y + q[2] * d + q[3]).astype(np.float32) for q in matrix[:3]]
    W = matrix[3, 0] * x + matrix[3, 1] * y + matrix[3, 2] * d + matrix[3, 3]
    points = np.empty((height, width, 3), dtype=np.float32)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        for axis, numerator in enumerate(numerators):
            points[..., axis] = numerator / W  # float32 over float64, then rounded: OpenCV's own order
    points[~np.isfinite(d)] = np.nan
    return points


def disparity_to_depth(disparity: ArrayLike, Q: ArrayLike) -> Points:
    """Return the depth of every pixel, Z = f B / (d - (cx - cx')).

    Parameters
    ----------
    disparity : array_like of shape (H, W)
        Of the left image, pixels; NaN, infinite or masked where there is none.
    Q : array_like of shape (4, 4)
        Reprojection matrix, as of :func:`stereocal.rectify`.

    Returns
    -------
    ndarray of shape (H, W), float32
        Distance along the left camera's optical axis, in the unit of Q's baseline; NaN where there is no disparity.

    Raises
    ------
    InputError, DegenerateGeometryError
        As :func:`disparity_to_points`, whose third coordinate this is.

    Notes
    -----
    Answers to ``cv2.reprojectImageTo3D(…)[..., 2]``: the same bits.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> Q = sc.reprojection_matrix(500.0, (320.0, 240.0), 60.0)
    >>> disparity = np.array([[30.0, 60.0, np.nan]], np.float32)
    >>> sc.disparity_to_depth(disparity, Q)  # f B / d
    array([[1000.,  500.,   nan]], dtype=float32)
    """
    d, matrix = _disparity_and_q(disparity, Q)
    Z, W = _depth_and_denominator(d, matrix)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        depth = (Z.astype(np.float32) / W).astype(np.float32)
    depth[~np.isfinite(d)] = np.nan
    return depth


def sigma_z(disparity: ArrayLike, Q: ArrayLike, *, sigma_d: ArrayLike = 0.25) -> Points:
    """Return the standard deviation of every pixel's depth, σ_Z = Z² σ_d / (f B).

    Parameters
    ----------
    disparity : array_like of shape (H, W)
        Of the left image, pixels; NaN, infinite or masked where there is none.
    Q : array_like of shape (4, 4)
        Reprojection matrix, as of :func:`stereocal.rectify`.
    sigma_d : float or array_like of shape (H, W)
        Standard deviation of the disparity, pixels: one number, or one a pixel. A matcher with a subpixel step reaches
        0.1 to 0.3 on textured surfaces; one that answers in whole pixels has 1/√12 = 0.29 by rounding alone.

    Returns
    -------
    ndarray of shape (H, W), float32
        In the unit of Q's baseline; NaN where there is no disparity.

    Raises
    ------
    InputError
        As :func:`disparity_to_points`, or if `sigma_d` is negative or neither a number nor (H, W).

    Notes
    -----
    The matcher's part alone: the calibration's uncertainty (focal length, baseline, rotation) adds to it, and a wrong
    match is no matter of σ. To first order, so valid while σ_Z is small beside Z.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> Q = sc.reprojection_matrix(500.0, (320.0, 240.0), 60.0)
    >>> sc.sigma_z(np.array([[30.0, 60.0]], np.float32), Q, sigma_d=0.3).round(3)  # Z^2 sigma_d / (f B)
    array([[10. ,  2.5]], dtype=float32)
    """
    d, matrix = _disparity_and_q(disparity, Q)
    try:
        sigma = np.asarray(sigma_d, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"sigma_d must be one number or an array of shape {d.shape}, pixels") from error
    if sigma.ndim and sigma.shape != d.shape:
        raise InputError(f"sigma_d must be one number or an array of shape {d.shape}, but has {sigma.shape}")
    if np.any(sigma < 0):
        raise InputError("sigma_d must not be negative: it is a standard deviation in pixels")
    Z, W = _depth_and_denominator(d, matrix)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        slope = (matrix[2, 2] - Z / W * matrix[3, 2]) / W
        result = (np.abs(slope) * sigma).astype(np.float32)
    result[~np.isfinite(d)] = np.nan
    return result


def _depth_and_denominator(d: Float, Q: Float) -> tuple[Float, Float]:
    """Return rows 3 and 4 of Q [x y d 1]ᵀ, both (H, W)."""
    y, x = np.ogrid[: d.shape[0], : d.shape[1]]
    return (
        Q[2, 0] * x + Q[2, 1] * y + Q[2, 2] * d + Q[2, 3],
        Q[3, 0] * x + Q[3, 1] * y + Q[3, 2] * d + Q[3, 3],
    )


def _disparity_and_q(disparity: ArrayLike, Q: ArrayLike) -> tuple[Float, Float]:
    if isinstance(disparity, np.ma.MaskedArray):
        disparity = np.where(np.ma.getmaskarray(disparity), np.nan, np.ma.getdata(disparity))
    d = as_array(disparity, (None, None), "disparity", finite=False)
    d = np.where(np.isfinite(d), d, np.nan)
    matrix = as_array(Q, (4, 4), "Q")
    if matrix[3, 2] == 0:
        raise DegenerateGeometryError(
            "Q's last row does not depend on the disparity (Q[3, 2] = 0, a baseline without end), so no depth follows "
            "from it; give the Q of a rectified rig"
        )
    return d, matrix
