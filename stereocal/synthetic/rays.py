"""The ray behind every sample of a picture: the lens undone, to convergence.

A renderer that draws a scene forwards and then warps it through a lens resamples twice and smears its own truth. Here
every sample of every pixel asks instead: which ray of the world came to me? Pixel position p belongs to the distorted
normalised point x_d = K⁻¹ p, and the ray is (x, y, 1) with (x, y) the point that the lens moves to x_d: the inverse of
the distortion model, iterated to 1e-12.

An image of W x H pixels at s x s samples a pixel has s² W H samples. Their rays differ so smoothly (a lens bends over
hundreds of pixels) that the iteration is run at the pixels' centres, the *nodes*, and the samples between are
interpolated by the quartic through five nodes each way. With h = 1 px between nodes, its error is of the order
|x⁽⁵⁾| h⁵/32: for the strong barrel of the default rig below 1e-8 px (a test measures it).

The raster of samples is wider than the image by a border of `pad` pixels, because blur brings in light from beyond the
edge. Where the lens model has no inverse there is no ray: NaN.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.distortion import undistort_normalized
from stereocal.camera.model import Camera

REACH = 2
"""Nodes on each side that the interpolation asks for."""


@dataclass(frozen=True)
class RayTable:
    """The rays of a camera's samples.

    Attributes
    ----------
    nodes : ndarray of shape (H + 2 pad + 4, W + 2 pad + 4, 2), float64
        (x, y) of the ray (x, y, 1) through pixel centre (column − pad − 2, row − pad − 2), camera frame; NaN = none.
    weights : ndarray of shape (s, 5), float64
        Interpolation weights of the five nodes around a sample, for each of the s positions within a pixel.
    image_size : (int, int)
        W, H.
    pad : int
        Border around the image, pixels.
    """

    nodes: Float
    weights: Float
    image_size: tuple[int, int]
    pad: int

    @property
    def supersampling(self) -> int:
        """Return s, the samples a pixel in each direction."""
        return len(self.weights)

    @property
    def raster_shape(self) -> tuple[int, int]:
        """(rows, columns) of the raster of samples, border included."""
        s, p = self.supersampling, 2 * self.pad
        return s * (self.image_size[1] + p), s * (self.image_size[0] + p)

    def rays(self) -> Float:
        """Return (x, y) of every sample's ray, (rows, columns, 2): what the kernels compute row by row."""
        by_row = _interpolate_rows(self.nodes, self.weights)
        return _interpolate_rows(by_row.swapaxes(0, 1), self.weights).swapaxes(0, 1)


def ray_table(camera: Camera, *, supersampling: int, pad: int) -> RayTable:
    """Undo a camera's lens at every pixel centre of the image and its border.

    Parameters
    ----------
    camera : Camera
        Whose rays.
    supersampling : int
        s, the samples a pixel in each direction.
    pad : int
        Border around the image, pixels.

    Returns
    -------
    RayTable
    """
    key = (camera.K.tobytes(), camera.dist.tobytes(), camera.image_size, camera.model)
    return _ray_table(key, supersampling, pad)


@lru_cache(maxsize=8)
def _ray_table(key: tuple[bytes, bytes, tuple[int, int], str], supersampling: int, pad: int) -> RayTable:
    """Remembers the last few cameras: one camera takes many photographs."""
    K, dist = np.frombuffer(key[0]).reshape(3, 3), np.frombuffer(key[1])
    width, height = key[2]
    margin = pad + REACH
    u, v = np.meshgrid(np.arange(-margin, width + margin, dtype=np.float64), np.arange(-margin, height + margin))
    y = (v - K[1, 2]) / K[1, 1]
    x = (u - K[0, 2] - K[0, 1] * y) / K[0, 0]
    distorted = np.stack([x.ravel(), y.ravel()], axis=1)
    nodes = undistort_normalized(distorted, dist, key[3]).reshape(*u.shape, 2)
    nodes.flags.writeable = False
    return RayTable(nodes, sample_weights(supersampling), key[2], pad)


def sample_offsets(supersampling: int) -> Float:
    """Return the positions of s samples within a pixel, relative to its centre: (k + 1/2)/s − 1/2."""
    return (np.arange(supersampling) + 0.5) / supersampling - 0.5


def sample_weights(supersampling: int) -> Float:
    """Return the Lagrange weights of the nodes −2 … 2 at each sample's offset, (s, 5)."""
    nodes = np.arange(-REACH, REACH + 1, dtype=np.float64)
    offsets = sample_offsets(supersampling)
    weights = np.ones((supersampling, len(nodes)))
    for i, node in enumerate(nodes):
        for other in np.delete(nodes, i):
            weights[:, i] *= (offsets - other) / (node - other)
    return weights


def _interpolate_rows(nodes: Float, weights: Float) -> Float:
    """(n + 4, m, 2) nodes → (s n, m, 2): row i s + k is Σ_t weights[k, t] nodes[i + t]."""
    count = len(nodes) - 2 * REACH
    taps = np.stack([nodes[t : t + count] for t in range(2 * REACH + 1)])
    rows = np.einsum("kt,tnmc->nkmc", weights, taps)
    return np.asarray(rows.reshape(len(weights) * count, *nodes.shape[1:]))
