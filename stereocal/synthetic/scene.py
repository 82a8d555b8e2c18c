"""A room in front of the rig: its pictures, its depth, its disparity, and what only one camera sees.

The room is a table of textured surfaces (``surfaces``) in the left camera's frame. A picture is made sample by sample
from the rays of the distorted camera (``rays``), so that lens distortion is in it from the beginning.

The truth is computed from the same surfaces by one ray a pixel, through the pixel's centre:

- **depth** Z of a picture of a real camera: the ray is (x, y, 1), so the ray's parameter is Z itself;
- **disparity** in a rectified pair. The ray of the left rectified pixel (u, v) is R₁ᵀ ((u − cx₁)/f, (v − cy)/f, 1)ᵀ.
  Where it meets the room at depth Z stands a point X; the right rectified picture shows it at P₂X, and
  d = u − u₂ = f B/Z + cx₁ − cx₂;
- **visibility**: a pixel has a true match only if the right camera sees the same point: the ray from the right camera's
  centre to X must meet nothing before X, and X must fall inside the right camera's photograph.

At the silhouette of a thing the pixel's centre decides, though its grey value mixes both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.camera.model import Camera
from stereocal.synthetic.rays import RayTable, ray_table
from stereocal.synthetic.surfaces import LIGHT, box, rectangle, shade, sphere, trace

if TYPE_CHECKING:
    from stereocal.pair.rectification import Rectification

_SAME_POINT = 1e-6
"""A ray that meets something this part of the way before its target is taken to meet the target itself."""


@dataclass(frozen=True)
class RectifiedTruth:
    """What a stereo matcher should find on a rectified pair.

    Attributes
    ----------
    disparity : ndarray of shape (H, W), float32
        Of the left picture, pixels; NaN where the left camera sees nothing.
    visible : ndarray of shape (H, W), bool
        Whether the right camera sees the same point.
    depth : ndarray of shape (H, W), float32
        Z in the rectified left frame.
    """

    disparity: NDArray[np.float32]
    visible: NDArray[np.bool_]
    depth: NDArray[np.float32]


@dataclass(frozen=True)
class Scene:
    """Textured surfaces in the left camera's frame.

    Attributes
    ----------
    surfaces : ndarray of shape (P, 19), float64
        See ``surfaces``.
    """

    surfaces: Float

    def radiance(self, table: RayTable, R: Float, T: Float, *, backend: str = "numba") -> NDArray[np.float32]:
        """Return the light at every sample of a camera with X_camera = R X + T, (3, rows, columns) float32."""
        origin = -R.T @ T
        out = np.empty((3, *table.raster_shape), dtype=np.float32)
        if backend == "numba":
            from stereocal.synthetic.rendering_kernels import scene_kernel

            scene_kernel(table.nodes, table.weights, self.surfaces, LIGHT, np.ascontiguousarray(R.T), origin, out)
            return out
        rays = table.rays().reshape(-1, 2)
        directions = np.column_stack([rays, np.ones(len(rays))]) @ R
        tau, index = trace(self.surfaces, origin, directions, backend="numpy")
        points = origin + np.where(np.isnan(tau), 0, tau)[:, None] * np.nan_to_num(directions)
        out[:] = shade(self.surfaces, points, index).T.reshape(out.shape)
        return out

    def depth(self, camera: Camera, R: Float, T: Float) -> NDArray[np.float32]:
        """Return Z at every pixel's centre of a camera with X_camera = R X + T, (H, W); NaN where there is nothing."""
        table = ray_table(camera, supersampling=1, pad=0)
        rays = table.rays().reshape(-1, 2)
        directions = np.column_stack([rays, np.ones(len(rays))]) @ R
        tau, _ = trace(self.surfaces, -R.T @ T, directions)
        width, height = camera.image_size
        return tau.reshape(height, width).astype(np.float32)

    def rectified_truth(self, rectification: Rectification) -> RectifiedTruth:
        """Return disparity, visibility and depth of the left picture of a rectified pair.

        Parameters
        ----------
        rectification : Rectification
            Of the rig whose left camera's frame the scene stands in; its own rig's lenses say what the photographs
            show.
        """
        rig, P1, P2 = rectification.rig, rectification.P1, rectification.P2
        width, height = rectification.image_size
        u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
        rays = np.stack([(u - P1[0, 2]) / P1[0, 0], (v - P1[1, 2]) / P1[1, 1], np.ones_like(u)], axis=-1).reshape(-1, 3)
        directions = rays @ rectification.R1  # = R1ᵀ r for each row
        depth, _ = trace(self.surfaces, np.zeros(3), directions)
        depth = np.where(_in_photograph(rig.left, directions), depth, np.nan)
        rectified = np.nan_to_num(depth)[:, None] * rays
        with np.errstate(divide="ignore", invalid="ignore"):
            right = np.column_stack([rectified, np.ones(len(rectified))]) @ P2.T
            axis = rectification.axis
            disparity = (u if axis == 0 else v).ravel() - right[:, axis] / right[:, 2]
        points = np.nan_to_num(depth)[:, None] * directions
        centre = -rig.R.T @ rig.T
        reach, _ = trace(self.surfaces, centre, points - centre)
        visible = (reach > 1 - _SAME_POINT) & _in_photograph(rig.right, points @ rig.R.T + rig.T) & ~np.isnan(depth)
        shape = (height, width)
        return RectifiedTruth(
            np.where(np.isnan(depth), np.nan, disparity).reshape(shape).astype(np.float32),
            visible.reshape(shape),
            depth.reshape(shape).astype(np.float32),
        )


def furnished_room(scale: float = 1.0, *, seed: int = 0) -> Scene:
    """Return a living room: walls, floor, sofa, table with a box, crate, globe on a pedestal, a slanted screen.

    Parameters
    ----------
    scale : float
        Units a millimetre: 1 for a rig in mm.
    seed : int
        Of the textures.
    """
    x, y, z = np.eye(3)
    turned = np.array([np.cos(0.7), 0.0, np.sin(0.7)])
    rows = [
        rectangle([0, -100, 3600], x, y, (2600, 1400), (150, 142, 120), wavelength=150, seed=1),
        rectangle([-1900, -100, 2000], z, y, (2200, 1400), (120, 140, 150), wavelength=150, seed=2),
        rectangle([2100, -100, 2000], z, y, (2200, 1400), (150, 128, 120), wavelength=150, seed=3),
        rectangle([0, 1000, 2000], x, z, (2600, 2200), (128, 100, 72), wavelength=130, seed=4, pattern=1),
        rectangle([0, -1200, 2000], x, z, (2600, 2200), (165, 165, 160), wavelength=160, contrast=0.5, seed=5),
        rectangle([950, -120, 2300], turned, y, (420, 620), (90, 130, 110), wavelength=70, contrast=0.95, seed=6),
        rectangle([-600, -450, 3560], x, y, (500, 320), (120, 80, 90), wavelength=90, contrast=1.0, seed=7),
        sphere([330, 60, 1250], 190, (165, 150, 60), wavelength=60, contrast=0.9, seed=8),
        *box([330, 625, 1250], (110, 375, 110), (130, 120, 140), yaw=25, wavelength=60, seed=10),
        *box([-500, 740, 2700], (800, 260, 420), (90, 105, 150), wavelength=90, contrast=0.95, seed=20),
        *box([-500, 360, 3020], (800, 330, 110), (80, 95, 140), wavelength=90, contrast=0.95, seed=30),
        *box([-690, 430, 1500], (230, 230, 230), (160, 115, 65), yaw=30, wavelength=80, seed=40, pattern=1),
        *box([-690, 830, 1500], (160, 170, 160), (90, 80, 70), yaw=30, wavelength=80, seed=45),
        *box([-180, 400, 900], (330, 18, 200), (140, 105, 80), yaw=-8, wavelength=50, seed=50, pattern=1),
        *box([-210, 290, 860], (75, 92, 60), (150, 70, 60), yaw=-25, wavelength=30, contrast=1.0, seed=60),
    ]
    surfaces = np.array(rows)
    surfaces[:, 17] += 1000 * (seed % 1000)
    surfaces[:, [1, 2, 3, 10, 11, 15]] *= scale
    surfaces[:, 15] *= 0.65
    return Scene(surfaces)


def _in_photograph(camera: Camera, directions: Float) -> NDArray[np.bool_]:
    """Whether the camera's photograph shows points in these directions of its own frame."""
    width, height = camera.image_size
    ahead = np.isfinite(directions).all(axis=1) & (directions[:, 2] > 0)
    seen = np.zeros(len(directions), dtype=bool)
    pixels = camera.project(directions[ahead])
    inside = (pixels >= -0.5).all(axis=1) & (pixels[:, 0] < width - 0.5) & (pixels[:, 1] < height - 0.5)
    # a lens model bends back far outside the image and would draw what no photograph shows
    back = camera.undistort_points(pixels[inside], P=np.eye(3))
    straight = directions[ahead][inside]
    inside[inside] = np.abs(back - straight[:, :2] / straight[:, 2:]).max(axis=1) < 1e-6
    seen[ahead] = inside
    return seen
