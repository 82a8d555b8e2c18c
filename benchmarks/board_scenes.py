"""Renders of chessboards with known truth, for the studies of the board room.

Every pixel is the mean of the board's pattern over its area: the rays through the pixel's corners are found by
inverting the lens exactly, interpolated inside the pixel (to 1e-7 of a ray), met with the board's plane, and looked
up in the pattern. A pixel whose sub-samples could see two colours gets 16 x 16 samples, all others one. Then blur,
light, noise, rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy import ndimage

SUBSAMPLES = 16


@dataclass
class Lens:
    """fx = fy = f, a principal point, and Brown's k1 k2 p1 p2 k3 or Kannala-Brandt's k1..k4 (`fisheye`)."""

    f: float
    center: tuple[float, float]
    dist: tuple[float, ...] = (0, 0, 0, 0, 0)
    fisheye: bool = False

    def project(self, X):
        """Camera coordinates (N, 3) to pixels (N, 2)."""
        if self.fisheye:
            r = np.hypot(X[:, 0], X[:, 1])
            theta = np.arctan2(r, X[:, 2])
            t2 = theta * theta
            k = self.dist
            td = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3]))))
            scale = np.where(r > 1e-12, td / np.maximum(r, 1e-12), 1 / X[:, 2])
            return self.f * scale[:, None] * X[:, :2] + self.center
        x, y = (X[:, :2] / X[:, 2:]).T
        return self.f * self._brown(x, y) + self.center

    def _brown(self, x, y):
        k1, k2, p1, p2, k3 = self.dist
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.stack(
            [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y],
            -1,
        )

    def rays(self, points):
        """Directions (..., 3) that project to the pixels (..., 2), unit z (or unit length for a fisheye)."""
        d = (points - np.array(self.center)) / self.f
        if self.fisheye:
            td = np.linalg.norm(d, axis=-1)
            theta = td.copy()
            for _ in range(30):
                t2, k = theta * theta, self.dist
                value = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) - td
                slope = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
                theta -= value / slope
            unit = d / np.maximum(td, 1e-12)[..., None]
            return np.concatenate([unit * np.sin(theta)[..., None], np.cos(theta)[..., None]], -1)
        x = d.copy()
        for _ in range(60):
            x = x - (self._brown(x[..., 0], x[..., 1]) - d)
        return np.concatenate([x, np.ones((*x.shape[:-1], 1))], -1)


@njit(cache=True)
def _pattern(X, Y, columns, rows, margin, crop):
    """1 light, 0 dark, -1 off the board; square (0, 0) lies between the board's origin and (-1, -1)."""
    if -1 - margin > X or -1 - margin > Y or columns + margin < X or rows + margin < Y:
        return -1.0
    if -crop > X or Y < -1 or columns - 1 + crop < X or rows < Y:
        return 1.0
    return 0.0 if (int(np.floor(X)) + int(np.floor(Y))) % 2 == 0 else 1.0


@njit(cache=True)
def _render(rays, R, t, columns, rows, margin, crop, samples, background, out):
    n = R[:, 2]
    distance = n[0] * t[0] + n[1] * t[1] + n[2] * t[2]
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            least, largest = 9.0, -9.0
            for pass_ in range(2):
                k = 4 if pass_ == 0 else samples
                if pass_ == 1 and least == largest:
                    break
                light, board = 0.0, 0.0
                for i in range(k):
                    fy = i / (k - 1) if pass_ == 0 else (i + 0.5) / k
                    for j in range(k):
                        fx = j / (k - 1) if pass_ == 0 else (j + 0.5) / k
                        d = np.empty(3)
                        for c in range(3):
                            d[c] = (rays[y, x, c] * (1 - fx) + rays[y, x + 1, c] * fx) * (1 - fy) + (
                                rays[y + 1, x, c] * (1 - fx) + rays[y + 1, x + 1, c] * fx
                            ) * fy
                        depth = distance / (n[0] * d[0] + n[1] * d[1] + n[2] * d[2])
                        value = -1.0
                        if depth > 0:
                            a, b, c2 = depth * d[0] - t[0], depth * d[1] - t[1], depth * d[2] - t[2]
                            X = R[0, 0] * a + R[1, 0] * b + R[2, 0] * c2
                            Y = R[0, 1] * a + R[1, 1] * b + R[2, 1] * c2
                            value = _pattern(X, Y, columns, rows, margin, crop)
                        least, largest = min(least, value), max(largest, value)
                        if value >= 0:
                            light += value
                            board += 1
                light /= k * k
                board /= k * k
            out[y, x, 0] = light
            out[y, x, 1] = board


def render(
    lens,
    image_size,
    R,
    t,
    inner_corners,
    *,
    blur=0.8,
    noise=1.0,
    light=200.0,
    dark=40.0,
    background=120.0,
    margin=1.0,
    crop=1.0,
    shade=None,
    seed=0,
    samples=SUBSAMPLES,
    occluder=None,
):
    """Return (image uint8, true corners (N, 2)); squares are 1 unit. `background` is a grey level or an image."""
    width, height = image_size
    gx, gy = np.meshgrid(np.arange(width + 1) - 0.5, np.arange(height + 1) - 0.5)
    rays = lens.rays(np.stack([gx, gy], -1))
    cover = np.empty((height, width, 2))
    columns, rows = inner_corners
    _render(rays, np.ascontiguousarray(R), np.asarray(t, float), columns, rows, margin, crop, samples, 0.0, cover)
    image = dark * cover[..., 1] + (light - dark) * cover[..., 0] + background * (1 - cover[..., 1])
    if shade is not None:
        image = image * shade
    if occluder is not None:
        image = occluder(image)
    image = ndimage.gaussian_filter(image, blur) if blur > 0 else image
    rng = np.random.default_rng(seed)
    image = image + noise * rng.standard_normal(image.shape) if noise > 0 else image
    j, i = np.divmod(np.arange(columns * rows), columns)
    X = np.stack([i, j, 0 * i], -1).astype(float) @ R.T + t
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), lens.project(X)


def rotation(rvec):
    """Rodrigues' formula."""
    theta = np.linalg.norm(rvec)
    if theta < 1e-12:
        return np.eye(3)
    x, y, z = rvec / theta
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(theta) * k + (1 - np.cos(theta)) * k @ k


def random_pose(rng, lens, image_size, inner_corners, *, tilt=40.0, fill=(0.35, 0.9), turn=180.0, border=8.0):
    """A pose at which all corners lie in the image: tilt up to `tilt` degrees, any turn, size `fill` of the image."""
    columns, rows = inner_corners
    width, height = image_size
    j, i = np.divmod(np.arange(columns * rows), columns)
    board = np.stack([i, j, 0 * i], -1) - [(columns - 1) / 2, (rows - 1) / 2, 0.0]
    for _ in range(2000):
        axis = rng.uniform(0, 2 * np.pi)
        R = rotation(np.deg2rad(rng.uniform(0, tilt)) * np.array([np.cos(axis), np.sin(axis), 0])) @ rotation(
            np.array([0, 0, np.deg2rad(rng.uniform(-turn, turn))])
        )
        size = rng.uniform(*fill)
        depth = lens.f * max(columns + 1, rows + 1) / (size * min(width, height) * 1.2)
        point = rng.uniform(0.15, 0.85, 2) * [width, height]
        ray = lens.rays(point[None])[0]
        center = ray / np.linalg.norm(ray) * depth
        X = board @ R.T + center
        normal = R[:, 2]
        if X[:, 2].min() < 0.05 * depth or normal @ center < 0.2 * depth * np.cos(np.deg2rad(tilt)):
            continue
        p = lens.project(X)
        if p.min() < border or (p[:, 0] > width - 1 - border).any() or (p[:, 1] > height - 1 - border).any():
            continue
        return R, center - R @ np.array([(columns - 1) / 2, (rows - 1) / 2, 0.0])
    raise RuntimeError("no pose found")
