"""Zhang's closed form: the camera matrix from the homographies of a plane, the pose from one of them.

The homography of a board z = 0 is H = [h1 h2 h3] = λ K [r1 r2 t]. r1 and r2 are unit vectors at a right angle, so
with the symmetric B = K⁻ᵀK⁻¹ (the image of the absolute conic)

    h1ᵀ B h2 = 0,        h1ᵀ B h1 − h2ᵀ B h2 = 0.

Both are linear in b = (B11, B12, B22, B13, B23, B33): with v_ij the row for which h_iᵀ B h_j = v_ijᵀ b, each view
gives the two rows v12ᵀ and (v11 − v22)ᵀ of V b = 0. b is the right singular vector of V for its smallest singular
value, and B its matrix, which is positive definite up to sign if there is a camera behind it. Then B ∝ K⁻ᵀK⁻¹ is a
Cholesky factorisation, and K its inverse (Zhang's appendix B writes that factorisation out).

What is known beforehand leaves b with fewer unknowns, and fewer views suffice:

==============================  ==============  =================================================
known                           unknowns of b   views
==============================  ==============  =================================================
nothing                         6               3
zero skew (B12 = 0)             5               2
principal point, zero skew      3               1 (origin moved there: B12 = B13 = B23 = 0)
==============================  ==============  =================================================

Boards that stand parallel give the same two equations again and again: their planes share one vanishing line. V then
has two small singular values, not one. That is what degeneracy means here, whatever the number of views.

Pose: λ = 1/‖K⁻¹h1‖ (mean of the first two columns), r1 = λK⁻¹h1, r2 = λK⁻¹h2, t = λK⁻¹h3. For noise r1 and r2 are not
quite at a right angle; both are turned by the same amount until they are, and r3 = r1 × r2.

Source: Zhang, *A flexible new technique for camera calibration*, PAMI 22 (2000), section 3.1 and appendices B and C.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_array, as_camera_matrix
from stereocal.base.errors import DegenerateGeometryError, InputError

# Second smallest singular value of V (rows and columns balanced) below which it counts as zero.
_RANK = 1e-9

# Rows and columns of B's six entries, and how often each stands in hᵢᵀ B hⱼ (half, for what is said twice below).
_FIRST, _SECOND = np.array([0, 0, 1, 2, 2, 2]), np.array([0, 1, 1, 0, 1, 2])
_OFF_DIAGONAL = np.array([0.5, 1, 0.5, 1, 1, 0.5])
# The entries that are left where the origin is the principal point and there is no skew: B11, B22, B33.
_CENTRED = [0, 2, 5]

_ADVICE = "photograph the board tilted by 30 to 45 degrees, to a different side each time"


def zhang_intrinsics(
    homographies: Sequence[ArrayLike] | ArrayLike,
    *,
    skew: bool | None = None,
    principal_point: ArrayLike | None = None,
) -> Float:
    """Find K from homographies of a plane: V b = 0, B = K⁻ᵀK⁻¹.

    Parameters
    ----------
    homographies : sequence of (3, 3) array_like
        From the board's plane to pixels, one a view.
    skew : bool, optional
        Whether K[0, 1] is unknown. By default it is, from three views on, as Zhang has it; with two, or with
        `principal_point`, it is 0.
    principal_point : array_like of 2 numbers, optional
        (cx, cy) where it is known; then one view is enough, unless it is seen without tilt.

    Returns
    -------
    ndarray of shape (3, 3)
        K.

    Raises
    ------
    InputError
        If a homography is not a finite 3x3 matrix.
    DegenerateGeometryError
        If there are too few views, if all boards are parallel, or if B is not positive definite, so that there is no
        such camera.

    Notes
    -----
    OpenCV's ``initCameraMatrix2D`` solves the case of a known principal point only.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> board = sc.Chessboard((7, 6), 25.0)
    >>> tilts = [(0.4, 0, 0), (-0.4, 0.1, 0), (0, 0.4, 0.1), (0.1, -0.4, 0), (0.3, 0.3, 0.2), (-0.3, 0.3, 0)]
    >>> camera = sc.Camera(K, None, (640, 480))
    >>> views = [camera.project(board.object_points, tilt, [-75, -60, 400]) for tilt in tilts]
    >>> sc.zhang_intrinsics([sc.fit_homography(board.object_points, view) for view in views]).round(3) + 0.0
    array([[500.,   0., 320.],
           [  0., 500., 240.],
           [  0.,   0.,   1.]])
    """
    H = _stack(homographies)
    if skew is None:
        skew = len(H) >= 3 and principal_point is None
    if skew and principal_point is not None:
        raise InputError("skew cannot be estimated with a fixed principal_point; leave one of them out")
    needed = 1 if principal_point is not None else 3 if skew else 2
    if len(H) < needed:
        raise DegenerateGeometryError(
            f"{len(H)} views are too few: Zhang's closed form needs {needed} "
            f"{'with skew' if skew else 'without skew'}; {_ADVICE}"
        )
    centre = as_array(np.ravel(principal_point), (2,), "principal_point") if principal_point is not None else None
    return camera_of_homographies(H, skew=skew, centre=centre)


def camera_of_homographies(H: Float, *, skew: bool, centre: Float | None) -> Float:
    """Do the work of :func:`zhang_intrinsics`, on homographies (V, 3, 3) that need no checking."""
    # Pixels are scaled to order one, or the entries of b would span six orders of magnitude.
    N = _image_normalization(H, centre)
    b = _smallest_conic(N @ H, skew=skew, centred=centre is not None)
    return _camera_of_conic(b, N)


def zhang_pose(K: ArrayLike, H: ArrayLike) -> tuple[Float, Float]:
    """Find the pose of a board from its homography: [r1 r2 t] = λ K⁻¹ H.

    Parameters
    ----------
    K : array_like of shape (3, 3)
        Camera matrix.
    H : array_like of shape (3, 3)
        Homography from the board's plane z = 0 to (undistorted) pixels.

    Returns
    -------
    R : ndarray of shape (3, 3)
        Rotation from board to camera, the nearest to what H says.
    t : ndarray of shape (3,)
        Translation; t[2] > 0: the board's origin is in front of the camera.

    Raises
    ------
    DegenerateGeometryError
        If H has no inverse: the board is seen edge-on.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> H = K @ np.array([[1, 0, -75], [0, 1, -60], [0, 0, 400]])  # a board that faces the camera
    >>> R, t = sc.zhang_pose(K, H)
    >>> bool(np.allclose(R, np.eye(3)))
    True
    >>> t.round(6)
    array([-75., -60., 400.])
    """
    matrix, h = as_camera_matrix(K), as_array(H, (3, 3), "H")
    if abs(np.linalg.det(h / np.linalg.norm(h))) < 1e-14:
        raise DegenerateGeometryError("the homography is singular: the board is seen edge-on; leave this view out")
    R, t = poses_of_homographies(matrix, h[None])
    return R[0], t[0]


def poses_of_homographies(K: Float, H: Float) -> tuple[Float, Float]:
    """Find all poses at once: H of shape (V, 3, 3) to R (V, 3, 3) and t (V, 3).

    The rotation nearest to two unit vectors p, q that should be at a right angle turns both by the same amount: p + q
    and p − q are at a right angle already, and r1, r2 = (â ± b̂)/√2 of these two directions.
    """
    (fx, skew, cx), (_, fy, cy), _ = K.tolist()
    K_inverse = np.array(
        [[1 / fx, -skew / (fx * fy), (skew * cy - cx * fy) / (fx * fy)], [0, 1 / fy, -cy / fy], [0, 0, 1]]
    )
    M = (K_inverse @ H).transpose(2, 1, 0)  # [column, row, view]
    lengths = np.sqrt(np.einsum("crv,crv->cv", M[:2], M[:2]))
    sign = np.where(M[2, 2] < 0, -1.0, 1.0)
    p, q = M[:2] * (sign / lengths)[:, None]
    ab = np.array([p + q, p - q])
    a, b = ab / np.sqrt(2 * np.einsum("crv,crv->cv", ab, ab))[:, None]
    R = np.empty((len(H), 3, 3))
    R[:, :, 0], R[:, :, 1] = r1, r2 = (a + b).T, (a - b).T
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        R[:, i, 2] = r1[:, j] * r2[:, k] - r1[:, k] * r2[:, j]
    return R, np.ascontiguousarray((M[2] * (2 * sign / (lengths[0] + lengths[1]))).T)


def _stack(homographies: Sequence[ArrayLike] | ArrayLike) -> Float:
    H = np.asarray(homographies, dtype=np.float64)
    if H.ndim == 2:
        H = H[None]
    H = as_array(H, (None, 3, 3), "homographies")
    return np.asarray(H / np.linalg.norm(H.reshape(-1, 9), axis=1)[:, None, None])


def _image_normalization(H: Float, centre: Float | None) -> Float:
    """A similarity of the image that brings the boards' origins to order one; to the principal point, if known."""
    seen = H[H[:, 2, 2] != 0]
    count = max(len(seen), 1)
    x, y = seen[:, :2, 2].T / seen[:, 2, 2]
    middle = centre if centre is not None else (x.sum() / count, y.sum() / count)
    # the size of the image is not known: the origins' distance from (0, 0) tells its order of magnitude
    scale = float(np.sqrt(x * x + y * y).sum()) / count or 1.0
    return np.array([[1 / scale, 0, -middle[0] / scale], [0, 1 / scale, -middle[1] / scale], [0, 0, 1.0]])


def _conic_rows(H: Float, columns: list[int]) -> Float:
    """The two rows of each view, v12 and v11 − v22, of which `columns` are wanted: (2V, len(columns))."""
    columns_of_H = H[:, :, :2]
    # Each view counts the same, whatever the distance of its board.
    scale = 1 / np.maximum(np.einsum("vij,vij->v", columns_of_H, columns_of_H), 1e-300)
    p, q = columns_of_H.transpose(2, 1, 0)
    p_scaled, q_scaled = p * scale, q * scale
    if columns == _CENTRED:  # B is diagonal: no products of different entries
        return np.concatenate([p_scaled * q, p_scaled * p - q_scaled * q], axis=1).T
    first, second, weight = _FIRST[columns], _SECOND[columns], _OFF_DIAGONAL[columns, None]
    p_i, q_i, p_j, q_j = p_scaled[first], q_scaled[first], p[second], q[second]
    return np.concatenate([(p_i * q_j + p_j * q_i) * weight, (p_i * p_j - q_i * q_j) * (2 * weight)], axis=1).T


def _smallest_conic(H: Float, *, skew: bool, centred: bool) -> Float:
    """The b of least ‖V b‖ among those that the assumptions allow; its six entries."""
    columns = _CENTRED if centred else [0, 1, 2, 3, 4, 5] if skew else [0, 2, 3, 4, 5]
    V = _conic_rows(H, columns)
    if len(V) < len(columns):  # two views and five unknowns: a row of zeros brings the null vector into the thin factor
        V = np.vstack([V, np.zeros((len(columns) - len(V), len(columns)))])
    norms = np.sqrt(np.einsum("ij,ij->j", V, V))
    balance = np.where(norms > 1e-300, norms, 1.0)
    singular_values, Vt = np.linalg.svd(V / balance, full_matrices=False)[1:]
    unknowns = len(columns)
    rank = int(np.count_nonzero(singular_values > _RANK * singular_values[0])) if singular_values[0] > 0 else 0
    if rank < unknowns - 1:
        raise DegenerateGeometryError(
            f"all {len(H)} views show the board in parallel planes (or turned about its own normal only), which "
            f"leaves the focal length open; {_ADVICE}"
        )
    b = np.zeros(6)
    b[columns] = Vt[unknowns - 1] / balance
    return b


def _camera_of_conic(b: Float, N: Float) -> Float:
    """K from B = K⁻ᵀK⁻¹ up to scale, in pixels: B = L Lᵀ, K ∝ L⁻ᵀ.

    Nine numbers, written out: the functions for matrices would take longer to call than this takes to compute.
    """
    B11, B12, B22, B13, B23, B33 = b.tolist() if b[0] + b[2] + b[5] > 0 else (-b).tolist()
    L21, L31 = (B12 / B11, B13 / B11) if B11 > 0 else (0.0, 0.0)
    d2 = B22 - L21 * B12  # B = L D Lᵀ with a unit diagonal in L; D = (B11, d2, d3) is positive if B is
    L32 = (B23 - L31 * B12) / d2 if d2 > 0 else 0.0
    d3 = B33 - L31 * B13 - L32 * L32 * d2
    if not (B11 > 0 and d2 > 0 and d3 > 0):
        raise DegenerateGeometryError(
            "no camera fits the homographies (Zhang's B is not positive definite): the tilts are too small for the "
            f"noise, or the lens distortion is strong; {_ADVICE}"
        )
    # the rows of L⁻ᵀ, the last one scaled to 1; N⁻¹ then takes it to pixels
    scale, x0, y0 = 1 / float(N[0, 0]), float(N[0, 2]), float(N[1, 2])
    fx, fy = scale * math.sqrt(d3 / B11), scale * math.sqrt(d3 / d2)
    skew = -L21 * fy
    if abs(skew) < 1e-12 * fx:
        skew = 0.0
    return np.array([[fx, skew, scale * (L21 * L32 - L31 - x0)], [0.0, fy, scale * (-L32 - y0)], [0.0, 0.0, 1.0]])
