"""The Brown–Conrady family, as OpenCV has it: brown (5), rational (8), thin_prism (12) and tilted (14).

With x = (x, y), s = r² = x² + y²,

    x_d = x f(s) + ( 2 p1 x y + p2 (s + 2x²),  p1 (s + 2y²) + 2 p2 x y ) + ( s1 s + s2 s²,  s3 s + s4 s² ),

    f(s) = (1 + k1 s + k2 s² + k3 s³) / (1 + k4 s + k5 s² + k6 s³) = c / q.

The first term is radial: a lens is round. The second is tangential: its elements are not quite on one axis (Conrady,
1919; Brown, 1966). The denominator (Claus and Fitzgibbon, 2005) lets wide lenses be fitted; the thin prism terms
stand for elements that are tilted (Weng, Cohen and Herniou, 1992). A sensor that is tilted by design (Scheimpflug)
maps the result through the homography of that tilt,

    (x_d, 1) ~ [[R33, 0, −R13], [0, R33, −R23], [0, 0, 1]] R (x_d′, 1),   R = R_y(τy) R_x(τx).

The order of k is OpenCV's: k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 τx τy; each model is a beginning of that list.

Derivatives follow line by line from the formula, with f′ = df/ds = (c′ − f q′) / q, ∂s/∂x = 2x.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.distortion_base import ForwardModel
from stereocal.camera.distortion_inverse import first_turning_point, invert_map, invert_radial, invert_radial_compiled

NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tau_x", "tau_y")
_NOT_RADIAL = [2, 3, 8, 9, 10, 11, 12, 13]


class Brown(ForwardModel):
    """Brown–Conrady: k1, k2, p1, p2, k3.

    Notes
    -----
    OpenCV's default model of five coefficients. The subclasses only lengthen the list of parameters.
    """

    name = "brown"
    parameter_names: tuple[str, ...] = NAMES[:5]

    def distort(self, x: Float, k: Float) -> Float:
        """Return x_d = x f(r²) + tangential + thin prism, through the tilt if there is one."""
        k = _padded(k)
        s = np.sum(x * x, axis=1)
        f = _polynomial(s, k[0], k[1], k[4]) / _polynomial(s, k[5], k[6], k[7])
        u, v = x[:, 0], x[:, 1]
        xy = u * v
        x_d = np.empty_like(x)
        x_d[:, 0] = u * f + 2 * k[2] * xy + k[3] * (s + 2 * u * u) + s * (k[8] + k[9] * s)
        x_d[:, 1] = v * f + k[2] * (s + 2 * v * v) + 2 * k[3] * xy + s * (k[10] + k[11] * s)
        return _tilted(x_d, k[12], k[13]) if k[12] or k[13] else x_d

    def undistort(self, x_d: Float, k: Float) -> Float:
        """Return x with distort(x, k) = x_d, to 1e-12; NaN outside the domain (see ``distortion_inverse``)."""
        k = _padded(k)
        if np.any(k[12:]):
            x_d = _untilted(x_d, k[12], k[13])
        if np.any(k[_NOT_RADIAL]):
            return invert_map(lambda x: self._before_tilt(x, k), x_d, _pole(k))
        r_d = np.hypot(x_d[:, 0], x_d[:, 1])
        r = invert_radial(lambda r: _radial(r, k), r_d, radial_limit(k))
        with np.errstate(invalid="ignore"):
            return x_d * np.where(r_d > 0, r / np.where(r_d > 0, r_d, 1.0), 1.0)[:, None]

    def undistort_compiled(self, x_d: Float, k: Float) -> Float:
        """Return the same as `undistort`, from a kernel."""
        from stereocal.camera.distortion_inverse_kernels import invert_map_kernel

        k = _padded(k)
        terms = k[:12]
        if np.any(k[12:]):
            x_d = _untilted(x_d, k[12], k[13])
            terms = np.concatenate([terms, _tilt_matrix(k[12], k[13])[0][2]])
        if not np.any(k[_NOT_RADIAL]):
            return invert_radial_compiled(x_d, np.array([k[0], k[1], k[4]]), k[5:8], radial_limit(k))
        x = np.empty_like(x_d, order="C")
        invert_map_kernel(np.ascontiguousarray(x_d), terms, _pole(k), x)
        return x

    def _before_tilt(self, x: Float, k: Float) -> tuple[Float, Float]:
        """The map without its tilt, and its derivative; NaN where the tilted sensor sees nothing of it."""
        x_d, J, _ = self.jacobians(x, k[:12])
        if np.any(k[12:]):
            row = _tilt_matrix(k[12], k[13])[0][2]
            unseen = ~(x_d @ row[:2] + row[2] > 0)
            x_d[unseen], J[unseen] = np.nan, np.nan
        return x_d, J

    def jacobians(self, x: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return x_d, ∂x_d/∂x and ∂x_d/∂k."""
        n = len(k)
        k = _padded(k)
        u, v = x[:, 0], x[:, 1]
        s = u * u + v * v
        s2, s3, xy = s * s, s * s * s, u * v
        c, q = 1 + k[0] * s + k[1] * s2 + k[4] * s3, 1 + k[5] * s + k[6] * s2 + k[7] * s3
        f = c / q
        f_s = ((k[0] + 2 * k[1] * s + 3 * k[4] * s2) - f * (k[5] + 2 * k[6] * s + 3 * k[7] * s2)) / q

        x_d = np.empty_like(x)
        x_d[:, 0] = u * f + 2 * k[2] * xy + k[3] * (s + 2 * u * u) + k[8] * s + k[9] * s2
        x_d[:, 1] = v * f + k[2] * (s + 2 * v * v) + 2 * k[3] * xy + k[10] * s + k[11] * s2

        J = np.empty((len(x), 2, 2))
        prism_u, prism_v = k[8] + 2 * k[9] * s, k[10] + 2 * k[11] * s
        J[:, 0, 0] = f + 2 * u * u * f_s + 2 * k[2] * v + 6 * k[3] * u + 2 * u * prism_u
        J[:, 0, 1] = 2 * xy * f_s + 2 * k[2] * u + 2 * k[3] * v + 2 * v * prism_u
        J[:, 1, 0] = 2 * xy * f_s + 2 * k[2] * u + 2 * k[3] * v + 2 * u * prism_v
        J[:, 1, 1] = f + 2 * v * v * f_s + 6 * k[2] * v + 2 * k[3] * u + 2 * v * prism_v

        J_k = np.zeros((len(x), 2, 14))
        radial = np.stack([s, s2, s3], axis=1) / q[:, None]
        J_k[:, :, [0, 1, 4]] = x[:, :, None] * radial[:, None, :]
        J_k[:, :, [5, 6, 7]] = -J_k[:, :, [0, 1, 4]] * f[:, None, None]
        J_k[:, 0, 2], J_k[:, 1, 2] = 2 * xy, s + 2 * v * v
        J_k[:, 0, 3], J_k[:, 1, 3] = s + 2 * u * u, 2 * xy
        J_k[:, 0, 8], J_k[:, 0, 9], J_k[:, 1, 10], J_k[:, 1, 11] = s, s2, s, s2
        if n > 12:
            x_d, H, J_tilt = _tilt_jacobians(x_d, k[12], k[13])
            J, J_k = H @ J, H @ J_k
            J_k[:, :, 12:] = J_tilt
        return x_d, J, J_k[:, :, :n]


class Rational(Brown):
    """Rational radial: k1, k2, p1, p2, k3, k4, k5, k6 (``cv2.CALIB_RATIONAL_MODEL``)."""

    name = "rational"
    parameter_names = NAMES[:8]


class ThinPrism(Brown):
    """With thin prism: k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 (``cv2.CALIB_THIN_PRISM_MODEL``)."""

    name = "thin_prism"
    parameter_names = NAMES[:12]


class Tilted(Brown):
    """With tilted sensor: the twelve of thin_prism, then τx, τy, radians (``cv2.CALIB_TILTED_MODEL``)."""

    name = "tilted"
    parameter_names = NAMES


def radial_limit(k: Float) -> float:
    """Return r_max, where r f(r²) stops to rise, or infinity if it never does.

    Parameters
    ----------
    k : ndarray of up to 14 numbers
        In OpenCV's order; only the six radial ones count.

    Returns
    -------
    float

    Notes
    -----
    d/dr (r c/q) = ((c + 2s c′) q − 2s c q′) / q², s = r²: the first positive root of a polynomial in s,
    or the pole of q.
    """
    k = _padded(np.asarray(k, dtype=np.float64))
    c, q = np.array([1, k[0], k[1], k[4]]), np.array([1, k[5], k[6], k[7]])
    double_degree = 2 * np.arange(4)
    rise = np.convolve(c * (1 + double_degree), q) - np.convolve(c, q * double_degree)
    return min(float(np.sqrt(first_turning_point(rise))), _pole(k))


def _pole(k: Float) -> float:
    """The radius where the denominator 1 + k4 s + k5 s² + k6 s³ vanishes first, or infinity."""
    return float(np.sqrt(first_turning_point(np.array([1, k[5], k[6], k[7]])))) if np.any(k[5:8]) else np.inf


def _padded(k: Float) -> Float:
    return k if len(k) == 14 else np.concatenate([k, np.zeros(14 - len(k))])


def _polynomial(s: Float, a: float, b: float, c: float) -> Float:
    return 1 + s * (a + s * (b + s * c))


def _radial(r: Float, k: Float) -> tuple[Float, Float]:
    """r f(r²) and its derivative."""
    s = r * r
    q = _polynomial(s, k[5], k[6], k[7])
    f = _polynomial(s, k[0], k[1], k[4]) / q
    f_s = ((k[0] + s * (2 * k[1] + 3 * k[4] * s)) - f * (k[5] + s * (2 * k[6] + 3 * k[7] * s))) / q
    return r * f, f + 2 * s * f_s


def _tilt_matrix(tau_x: float, tau_y: float) -> tuple[Float, Float, Float]:
    """The homography of the tilted sensor and its derivatives by τx and τy."""
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    Rx = np.array([[1.0, 0, 0], [0, cx, sx], [0, -sx, cx]])
    Ry = np.array([[cy, 0, -sy], [0, 1.0, 0], [sy, 0, cy]])
    dRx = np.array([[0.0, 0, 0], [0, -sx, cx], [0, -cx, -sx]])
    dRy = np.array([[-sy, 0, -cy], [0, 0.0, 0], [cy, 0, -sy]])
    R, by_x, by_y = Ry @ Rx, Ry @ dRx, dRy @ Rx

    def lift(A: Float, corner: float) -> Float:
        return np.array([[A[2, 2], 0, -A[0, 2]], [0, A[2, 2], -A[1, 2]], [0, 0, corner]])

    P = lift(R, 1.0)
    return P @ R, lift(by_x, 0.0) @ R + P @ by_x, lift(by_y, 0.0) @ R + P @ by_y


def _tilted(x_d: Float, tau_x: float, tau_y: float) -> Float:
    M, _, _ = _tilt_matrix(tau_x, tau_y)
    h = x_d @ M[:, :2].T + M[:, 2]
    return h[:, :2] / h[:, 2:]


def _untilted(x_d: Float, tau_x: float, tau_y: float) -> Float:
    """Before the tilt, a homography M: M⁻¹ (x_d, 1); NaN beyond the line that the tilted sensor sees at infinity."""
    M, _, _ = _tilt_matrix(tau_x, tau_y)
    with np.errstate(invalid="ignore"):
        h = np.column_stack([x_d, np.ones(len(x_d))]) @ np.linalg.inv(M).T
        return np.where(h[:, 2:] > 0, h[:, :2] / h[:, 2:], np.nan)


def _tilt_jacobians(x_d: Float, tau_x: float, tau_y: float) -> tuple[Float, Float, Float]:
    """Through the tilt: the point, its derivative by the point before, and by (τx, τy)."""
    M, by_x, by_y = _tilt_matrix(tau_x, tau_y)
    before = np.column_stack([x_d, np.ones(len(x_d))])
    h = before @ M.T
    w = h[:, 2]
    p = h[:, :2] / w[:, None]

    def differential(dh: Float) -> Float:
        return (dh[:, :2] - p * dh[:, 2:]) / w[:, None]

    H = (M[:2, :2][None] - p[:, :, None] * M[2, :2][None, None]) / w[:, None, None]
    by_tilt = np.stack([differential(before @ by_x.T), differential(before @ by_y.T)], axis=2)
    return p, H, by_tilt
