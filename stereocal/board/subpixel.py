"""Subpixel corners: fit the picture of two crossing edges, not its gradient.

Near an inner corner the image is the product of two blurred steps. With u and v the distances of a pixel from the two
edge lines, and a blur of standard deviation s/sqrt(2) (lens, motion and pixel together),

    I(x, y) = a + b erf(u / s) erf(v / s),        u = n1 . (p - c),   v = n2 . (p - c),

which is exact for a Gaussian blur where the edges cross at a right angle, and very nearly so otherwise. Seven
unknowns: the corner c = (cx, cy), the angles of the two lines, s, and the levels a (middle grey) and b (half the
contrast). They are fitted to every pixel of a window by Levenberg-Marquardt. With independent noise of standard
deviation sigma the fit is the maximum-likelihood estimate, and (J^T J)^-1 sigma^2, sigma estimated from the
residuals, is its covariance: no unbiased method can do better in that window (the Cramer-Rao bound). What residuals
cannot show (edges that run along the pixels, noise that is not independent, a shadow's edge) the corner's neighbours
do: :mod:`stereocal.board.corner_errors` corrects the covariances.

``cv2.cornerSubPix`` instead asks for the point that all gradients in the window are perpendicular to. Its pixels
on the edges count alike whether sharp or noisy, and a window that reaches the next corner pulls it there.

**The window** is the parallelogram of the corner's own grid steps, ``|xi|, |eta| <= h``: it follows spacing and
orientation, and reaches no other edge while h + 2.2 s / step < 1. It is no wider than a cap in pixels, which bounds
the time. A wider window averages more noise, sigma^2 / h, but trusts the lines further: where they bend otherwise than
by the parabola below, by beta a step, the corner is off by beta h^2. The sum of both, with sigma known at h0 = 0.52,

    sigma^2 h0 / h + beta^2 h^4        is least at        h^5 = h0 sigma^2 / (4 beta^2),

so that clear pictures are fitted with h0, and noisy ones with up to 0.75.

**The bend of the lines.** Distortion bends straight lines: over a window of 40 px by several hundredths of a pixel,
more than the noise. The fit knows the bend from the neighbours: with the second difference P(i+1) - 2 P(i) + P(i-1)
of the corners along line 1, its component d1 along n1 makes the line u = d1 xi^2 / 2, xi counted in steps. So corners
are fitted twice, first without bends, then with those of the first fit.

**The light.** A lens darkens towards its corners, and lamps stand on one side. A level that changes over the window
pulls the corner by a hundredth of a pixel and more, in proportion to the blur. It is treated as the bend is: the
levels a and b of the first fit, corner by corner, have slopes along the grid, and the second fit takes them out of
the pixels. Steps, bends and slopes are :mod:`stereocal.board.subpixel_geometry`.

Sources: Lucchese and Mitra, *Using saddle points for subpixel feature detection*, 2002, and Duda and Frese, *Accurate
detection and localization of checkerboard corners for calibration*, BMVC 2018, fit the region too; the product of error
functions is the closed form of a blurred corner. The bend, the light and the window by the grid are ours.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float, as_points
from stereocal.base.compile_ahead import compile_ahead, has_compiled, wait_for
from stereocal.base.errors import InputError
from stereocal.base.gray import to_gray
from stereocal.board.chessboard import Chessboard, as_inner_corners
from stereocal.board.corner_errors import judge_corners, median
from stereocal.board.subpixel_geometry import grid_steps, light_slopes
from stereocal.board.subpixel_masks import FitInputs, fit_suspects

HALF_WINDOW = 0.52
"""Half side of the window in steps of the grid."""
FIRST_HALF_WINDOW = 0.3
"""Half side of the window of the first of the two fits."""
LARGEST_HALF_WINDOW = 24.0
"""Half side of the window in pixels, at most."""

WIDEST_HALF_WINDOW = 0.75
"""The same where there is much noise."""
BEND_ERROR = 0.025
"""By how much lines bend otherwise than a parabola over one step, px, on photographs of printed boards."""

_FEW = 5  # corners that tell the blur before the others are fitted


@dataclass(frozen=True)
class SaddleFit:
    """Fitted saddles, in the order of the corners given.

    Attributes
    ----------
    corners : ndarray of shape (N, 2)
        x, y.
    covariances : ndarray of shape (N, 2, 2)
        Of the corners, px^2.
    edge_widths : ndarray of shape (N,)
        Standard deviation of the blur of the edges, s/sqrt(2), px.
    contrasts : ndarray of shape (N,)
        2 abs(b), light minus dark, grey levels.
    noise : ndarray of shape (N,)
        Standard deviation of the residuals, grey levels.
    converged : ndarray of shape (N,), bool
    strays : ndarray of shape (N,), bool
        Corners that stand where their neighbours do not see them, or whose picture is not a corner's alone; their
        covariances say so.
    own_covariances : ndarray of shape (N, 2, 2)
        As the residuals of each fit alone would have them: (J^T J)^-1 sigma^2.
    """

    corners: Float
    covariances: Float
    edge_widths: Float
    contrasts: Float
    noise: Float
    converged: NDArray[np.bool_]
    strays: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, np.bool_))
    own_covariances: Float = field(default_factory=lambda: np.zeros((0, 2, 2)))


def compile_fits_ahead(dtype: np.dtype[Any]) -> None:
    """Let another process compile the fit for images of a dtype while this one searches: half of a first detection."""
    from stereocal.board.subpixel_kernels import fit_saddles

    if not has_compiled(fit_saddles):
        compile_ahead(f"{__name__}:compile_fits({dtype.name!r})", fit_saddles)


def compile_fits(dtype: str) -> None:
    """Compile the fit for images of a dtype and for the logarithms and levels of images, by fits to a small board."""
    dark = np.add.outer(np.arange(4), np.arange(4)) % 2
    image = np.kron(230 - 200 * dark, np.ones((16, 16)))
    grid = np.stack(np.meshgrid([15.5, 31.5, 47.5], [15.5, 31.5, 47.5]), axis=-1)
    for kind in dict.fromkeys((dtype, "float32")):
        fit_corner_grid(image.astype(kind), grid)


def fit_corner_grid(
    gray: NDArray[Any], grid: Float, *, half_window: float | None = None, blur: float | None = None
) -> SaddleFit:
    """Fit the blurred saddle at every corner of a full grid.

    Parameters
    ----------
    gray : ndarray of shape (H, W)
        The image, any real dtype.
    grid : ndarray of shape (J, I, 2)
        Corners to half a blur or so.
    half_window : float, optional
        In steps of the grid; otherwise by the noise, see above.
    blur : float, optional
        Start of s, px; otherwise a tenth of the steps, 1.5 at least.
    """
    from stereocal.board.subpixel_kernels import fit_saddles

    wait_for(fit_saddles)
    shape, given = grid.shape[:2], np.ascontiguousarray(grid.reshape(-1, 2))
    n = len(given)
    theta, covariance, info = np.empty((n, 7)), np.empty((n, 2, 2)), np.empty((n, 4))
    # First without bends, because second differences of corners as given would be noise, and in a small window.
    steps, _ = _flat_steps(given, shape)
    length = np.hypot(steps[:, ::2], steps[:, 1::2])
    shortest = length.min(axis=1)
    if blur is None:
        narrow = np.abs(steps[:, 0] * steps[:, 3] - steps[:, 1] * steps[:, 2]) / length.max(axis=1)
        width = np.minimum(np.maximum(1.2, 0.1 * narrow), 4.0)
    else:
        width = np.full(n, blur)
    half = _window(np.maximum(FIRST_HALF_WINDOW, 11.0 / shortest), HALF_WINDOW, length)
    zero, no_limit, all_pixels = np.zeros((n, 2)), np.zeros(n), np.ones(n, np.int64)
    # the first fit is a start for the second: of a large window some of the pixels will do
    area = 4 * half * half * np.abs(steps[:, 0] * steps[:, 3] - steps[:, 1] * steps[:, 2])
    sparse = np.where(area > 1000, 4, np.where(area > 250, 2, 1))
    if blur is None and n > 2 * _FEW:
        width = np.minimum(width, _blur_of_a_few(gray, given, steps, half, width, shortest, sparse))
    fit_saddles(
        gray,
        given,
        steps,
        zero,
        half,
        2 * width + 2,
        np.zeros((n, 5)),
        width,
        True,
        2e-2,
        12,
        no_limit,
        sparse,
        theta,
        covariance,
        info,
    )
    # A corner that ran away keeps its place: its neighbours still need it.
    near = np.hypot(*(theta[:, :2] - given).T) < 0.35 * shortest
    points = np.where(near[:, None], theta[:, :2], given)
    if near.any():
        _calm(theta, near)
    if half_window is None:
        half_window = _half_window(
            covariance[near] / sparse[near, None, None], half[near], theta[near, 4], shortest[near]
        )
    steps, bends = _flat_steps(points, shape)
    half = _window(np.full(n, half_window), half_window, np.hypot(steps[:, ::2], steps[:, 1::2]))
    light = light_slopes(np.stack([theta[:, 5], np.abs(theta[:, 6])], -1).reshape(*shape, 2)).reshape(-1, 5)
    band = 2 * theta[:, 4] + 1
    fit_saddles(
        gray,
        points,
        steps,
        bends,
        half,
        band,
        light,
        width,
        False,
        2e-3,
        15,
        no_limit,
        all_pixels,
        theta,
        covariance,
        info,
    )
    late = np.nonzero(info[:, 2] == 0)[0]
    if late.size:  # where the picture is not the model's (overexposed, in a shadow's edge) the way may be long
        again = [np.ascontiguousarray(a[late]) for a in (points, steps, bends, half, band, light, width)]
        results = [theta[late], covariance[late], info[late]]
        fit_saddles(gray, *again, False, 2e-3, 100, no_limit[late], all_pixels[late], *results)
        theta[late], covariance[late], info[late] = results
    inputs = FitInputs(points, steps, bends, half, band, light, width)
    doubtful = fit_suspects(gray, (shape[0], shape[1]), inputs, (theta, covariance, info))
    converged = (info[:, 2] > 0) & (np.hypot(*(theta[:, :2] - given).T) < 0.35 * shortest)
    return _with_honest_covariances((theta, covariance, info), converged, doubtful, shape, median(half))


def _blur_of_a_few(
    gray: NDArray[Any],
    given: Float,
    steps: Float,
    half: Float,
    width: Float,
    shortest: Float,
    sparse: NDArray[np.int64],
) -> float:
    """Start of s for all: that of a few corners, fitted first from far above.

    The bands along the lines are as wide as the blur may be. Once it is known, most of their pixels can be left out,
    and the way to the optimum is short: the first fits take a quarter less time at squares of 35 px, and three quarters
    less at 100 px.
    """
    from stereocal.board.subpixel_kernels import fit_saddles

    few = np.linspace(0, len(given) - 1, _FEW).astype(int)
    corners, steps, half, width = given[few], steps[few], half[few], width[few]
    theta, covariance, info, no_light = np.empty((_FEW, 7)), np.empty((_FEW, 2, 2)), np.empty((_FEW, 4)), (_FEW, 5)
    frame = (corners, steps, np.zeros((_FEW, 2)), half, 2 * width + 2, np.zeros(no_light), width)
    fit_saddles(gray, *frame, True, 5e-2, 12, np.zeros(_FEW), sparse[few], theta, covariance, info)
    near = np.hypot(*(theta[:, :2] - corners).T) < 0.35 * shortest[few]
    s = np.sort(np.abs(theta[near, 4]))
    return max(1.2, 1.2 * float(s[len(s) // 2])) if s.size else np.inf


def _calm(theta: Float, near: NDArray[np.bool_]) -> None:
    """Start the second fit of corners that ran away from the levels and the blur of the others."""
    if near.all():
        theta[:, 4] = np.abs(theta[:, 4])
        return
    typical = np.median(theta[near], axis=0)
    signs = np.where(theta[:, 6] < 0, -1, 1)
    theta[:, 4] = np.where(near, np.abs(theta[:, 4]), abs(typical[4]))
    theta[:, 5] = np.where(near, theta[:, 5], typical[5])
    theta[:, 6] = np.where(near, theta[:, 6], signs * median(np.abs(theta[near, 6])))


def _half_window(covariance: Float, half: Float, s: Float, shortest: Float) -> float:
    """Half window in steps, by the noise of the first fit: h^5 = 0.13 (sigma / BEND_ERROR)^2."""
    spread = np.trace(covariance, axis1=1, axis2=2) / 2 * half / HALF_WINDOW
    spread = spread[np.isfinite(spread)]
    if not spread.size:
        return HALF_WINDOW
    wide = (0.13 * median(spread) / BEND_ERROR**2) ** 0.2
    free = 1 - 2.2 * median(s / shortest)
    return max(HALF_WINDOW, min(wide, WIDEST_HALF_WINDOW, free))


def _with_honest_covariances(
    results: tuple[Float, Float, Float],
    converged: NDArray[np.bool_],
    doubtful: NDArray[np.bool_],
    shape: tuple[int, ...],
    half: float,
) -> SaddleFit:
    """The fits' own covariances, corrected by what the neighbours say."""
    theta, covariance, info = results
    corners = theta[:, :2].copy()
    judged = judge_corners(
        np.where(np.isfinite(corners), corners, 0.0),
        np.where(converged[:, None, None], covariance, np.nan),
        (shape[0], shape[1]),
        correlation=max(0.0, 1 - 0.5 / half),
        doubtful=doubtful,
    )
    stray = np.sum(judged.distances**2, axis=1) / 2
    return SaddleFit(
        corners,
        judged.factor * covariance + stray[:, None, None] * np.eye(2),
        np.abs(theta[:, 4]) / np.sqrt(2),
        2 * np.abs(theta[:, 6]),
        np.sqrt(info[:, 0]),
        converged,
        judged.strays,
        covariance,
    )


def _flat_steps(points: Float, shape: tuple[int, ...]) -> tuple[Float, Float]:
    steps, bends = grid_steps(points.reshape(*shape, 2))
    return steps.reshape(-1, 4), bends.reshape(-1, 2)


def _window(half: Float, most: float, length: Float) -> Float:
    """Half windows in steps: no more than the cap in pixels; at least 3 pixels of the shorter step, but 0.8 steps."""
    capped = np.minimum(np.minimum(half, most), LARGEST_HALF_WINDOW / length.max(axis=1))
    return np.maximum(capped, np.minimum(0.8, 3.0 / length.min(axis=1)))


def refine_corners(
    image: ArrayLike, corners: ArrayLike, board: Chessboard | tuple[int, int], *, half_window: float | None = None
) -> Float:
    """Refine the corners of a board by fitting I = a + b erf(u/s) erf(v/s) around each.

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, 3)
        Grey or RGB.
    corners : array_like of shape (N, 2)
        All corners of the board, row by row (in either direction), to a pixel or so.
    board : Chessboard or (columns, rows)
        Says which corners are neighbours: window, orientation and bend follow from them.
    half_window : float, optional
        Half side of the window, in steps of the grid (0.3 to 0.7); by default 0.52, and more where there is much noise.

    Returns
    -------
    ndarray of shape (N, 2), float64
        The corners. One whose fit fails is returned as given.

    Raises
    ------
    InputError
        If the number of corners is not the board's.

    Notes
    -----
    Answers to ``cv2.cornerSubPix``, with a fifth to a half of its error on renders with known truth.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> dark = np.add.outer(np.arange(7), np.arange(8)) % 2
    >>> image = np.pad(np.kron(230 - 200 * dark, np.ones((30, 30))), 60, constant_values=230).astype(np.uint8)
    >>> truth = np.array([[89.5 + 30 * i, 89.5 + 30 * j] for j in range(6) for i in range(7)])
    >>> refined = sc.refine_corners(image, truth + 0.4, (7, 6))
    >>> bool(abs(refined - truth).max() < 0.01)
    True
    """
    columns, rows = board.inner_corners if isinstance(board, Chessboard) else as_inner_corners(board)
    points = as_points(corners, 2, "corners")
    if len(points) != columns * rows:
        raise InputError(f"corners holds {len(points)} points, but a {columns}x{rows} board has {columns * rows}")
    fit = fit_corner_grid(to_gray(image), points.reshape(rows, columns, 2), half_window=half_window)
    return np.where(fit.converged[:, None], fit.corners, points)
