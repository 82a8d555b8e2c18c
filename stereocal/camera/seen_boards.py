"""The boards that a camera sees: a homography a view, and from it the pose for any camera matrix.

[r1 r2 t] = λ K⁻¹ H gives the pose but for the sign of λ, which is that of a point known to be in front of the camera.
The board's origin will not do: where only a part of a large board is seen, from near, it may stand behind. So each H is
taken about the middle (X_m, Y_m) of the corners seen in its view,

    (u, v, 1)ᵀ ∝ H (X − X_m, Y − Y_m, 1)ᵀ,

which is in front and well inside of the image; the pose found there is brought back to the board's origin by
t − R (X_m, Y_m, 0)ᵀ. What K says about H (``zhang``) is the same about any origin.

Noise can still put a corner of a near board behind the camera. Such a view is given the pose that faces the camera: H
near the middle is its derivative there, J = ∂(u, v)/∂(X, Y), whose homography has the last row (0, 0, 1).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.compile_ahead import wait_for
from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.camera.bundle import Bundle
from stereocal.camera.homography import fit_homography
from stereocal.camera.zhang import poses_of_homographies


@dataclass(frozen=True)
class SeenBoards:
    """The homographies of all views, each about the middle of the corners seen in it.

    Attributes
    ----------
    H : ndarray of shape (V, 3, 3)
        (u, v, 1) ∝ H (X − X_m, Y − Y_m, 1).
    middle : ndarray of shape (V, 2)
        (X_m, Y_m).
    bundle : Bundle
        Whose corners they fit.
    """

    H: Float
    middle: Float
    bundle: Bundle

    def poses(self, K: Float) -> tuple[Float, Float]:
        """Return R (V, 3, 3) and t (V, 3) of the boards before a camera K, every corner in front of it."""
        R, t = poses_of_homographies(K, self.H)
        offsets, X = self.bundle.offsets, self.bundle.points
        size = np.ptp(self.bundle.by_axes[:2], axis=1)  # no corner is further from the middle, nor nearer by more
        sure = bool((t[:, 2] > np.abs(R[:, 2, :2]) @ size).all())
        t -= _times(R, self.middle)
        if sure:
            return R, t
        view = np.repeat(np.arange(len(t)), np.diff(offsets))
        depth = R[view, 2, 0] * X[:, 0] + R[view, 2, 1] * X[:, 1] + t[view, 2]
        behind = np.minimum.reduceat(depth, offsets[:-1]) <= 0
        if behind.any():
            H = self.H[behind]
            u = H[:, :2, 2] / H[:, 2:, 2]
            H[:, :2, :2] = (H[:, :2, :2] - u[:, :, None] * H[:, 2:, :2]) / H[:, 2:, 2:]
            H[:, :2, 2], H[:, 2] = u, (0.0, 0.0, 1.0)
            R[behind], t[behind] = poses_of_homographies(K, H)
            t[behind] -= _times(R[behind], self.middle[behind])
        return R, t


def _times(R: Float, points: Float) -> Float:
    """R (x, y, 0) of each view."""
    return np.asarray(R[:, :, 0] * points[:, :1] + R[:, :, 1] * points[:, 1:])


def seen_boards(bundle: Bundle, *, backend: str = "numba") -> SeenBoards:
    """Return the homographies of the blocks of a one-camera bundle, of the board's x and y.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    backend : {"numba", "numpy"}
        All at once, or one by one with :func:`~stereocal.camera.homography.fit_homography`.

    Returns
    -------
    SeenBoards

    Raises
    ------
    DegenerateGeometryError
        Names the views whose points lie on one line.
    """
    count = len(bundle.offsets) - 1
    H, middle, bad = np.zeros((count, 3, 3)), np.zeros((count, 2)), np.zeros(count, dtype=np.bool_)
    if backend == "numba":
        from stereocal.camera.homography_kernels import homographies_kernel

        wait_for(homographies_kernel)
        widest = int(np.diff(bundle.offsets).max())
        scratch = np.ones((5, widest)), np.empty((18, 9)), np.empty(9), np.empty((2, 9)), np.empty((2, 3))
        homographies_kernel(bundle.by_axes, bundle.offsets, H.reshape(count, 9), middle, bad, *scratch)
    else:
        for i in range(count):
            rows = slice(bundle.offsets[i], bundle.offsets[i + 1])
            middle[i] = bundle.points[rows, :2].mean(axis=0)
            try:
                H[i] = fit_homography(bundle.points[rows, :2] - middle[i], bundle.measured[rows], refine=False)
            except DegenerateGeometryError:
                bad[i] = True
    if bad.any():
        spread = np.ptp(bundle.points, axis=0)
        if spread[2] > 0.1 * spread[:2].max():
            raise InputError(
                "object_points must lie in the plane z = 0, x and y across the board, but they span "
                f"{spread[0]:.4g} x {spread[1]:.4g} x {spread[2]:.4g}"
            )
        raise DegenerateGeometryError(
            f"the points of view {', '.join(map(str, bundle.view_of_block[bad]))} lie on one line, in the board or in "
            "the image, which fixes no pose; leave these views out, or photograph the board less edge-on"
        )
    return SeenBoards(H, middle, bundle)
