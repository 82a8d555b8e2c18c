"""A stereo rig, its photographs of boards and of a room, and the truth about all of it.

The default rig is what two UVC web cameras on a bar are: 640x480, wide lenses (f = 430 px) with a strong barrel
distortion (k1 = −0.38, k2 = 0.15), 60 mm apart, not quite parallel, no two parts of them alike. Boards are held into
the corners of the image and tilted (``poses``) in front of a furnished room (``scene``), which is also photographed by
itself for the disparity map.

**Faults** can be ordered one by one, to see what a calibration and its report make of them:

==================  ==================================================================
argument            fault
==================  ==================================================================
``pairs=3``         too few views
``tilt=0``          every view parallel to the image: Zhang's method is degenerate
``blur=3``          out of focus
``noise=15``        a dark room
``bow=5``           a board that is bent by that much
``desync=4``        the board moves between the left and the right exposure
``mispaired=2``     the right photographs of the last two pairs are exchanged
==================  ==================================================================
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float, require_integer
from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_matrix
from stereocal.board.chessboard import Chessboard
from stereocal.camera.model import Camera
from stereocal.pair.rectification import rectify
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import camera_matrix
from stereocal.store.images import write_image
from stereocal.synthetic.board_view import paint_board, true_corners
from stereocal.synthetic.exposure import aperture_kernel, blur_pad, develop, gather, vignette
from stereocal.synthetic.poses import Pose, hold_board
from stereocal.synthetic.rays import ray_table
from stereocal.synthetic.scene import RectifiedTruth, Scene, furnished_room

if TYPE_CHECKING:
    from stereocal.pair.rectification import Rectification

Image = NDArray[np.uint8]

SQUARE = 25.0
"""Square of the default board, millimetres; another square_size scales rig and room with it."""

_LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)
_DIMMED = 0.6
"""Light of the room behind a board, against its light in its own photograph."""


@dataclass(frozen=True)
class SyntheticRig:
    """A rendered stereo rig with its truth.

    Attributes
    ----------
    rig : StereoRig
        The true cameras; lengths in units of the board's square_size.
    board : Chessboard
        The true board.
    left_images, right_images : list of ndarray of shape (H, W), uint8
        Photographs of the board, one a pair.
    left_corners, right_corners : list of ndarray of shape (N, 2), float64
        The true corners in each of them, pixels.
    poses : list of (R, t)
        Board to left camera at the left exposure.
    scene : Scene
        The room, in the left camera's frame.
    scene_left, scene_right : ndarray of shape (H, W, 3), uint8, or None
        Photographs of the room; None if they were not ordered.
    """

    rig: StereoRig
    board: Chessboard
    left_images: list[Image]
    right_images: list[Image]
    left_corners: list[Float]
    right_corners: list[Float]
    poses: list[Pose]
    scene: Scene
    scene_left: Image | None
    scene_right: Image | None

    @cached_property
    def scene_depth(self) -> NDArray[np.float32]:
        """True depth Z of the left photograph of the room, (H, W), in the rig's unit; NaN = nothing."""
        return self.scene.depth(self.rig.left, np.eye(3), np.zeros(3))

    @cached_property
    def scene_truth(self) -> RectifiedTruth:
        """True disparity, visibility and depth of the room in ``rectify(rig)``'s left picture."""
        return self.rectified_truth(rectify(self.rig))

    @property
    def scene_disparity(self) -> NDArray[np.float32]:
        """True disparity in ``rectify(rig)``'s left picture, (H, W); NaN = nothing there, or hidden from the right."""
        truth = self.scene_truth
        return np.where(truth.visible, truth.disparity, np.float32(np.nan))

    def rectified_truth(self, rectification: Rectification) -> RectifiedTruth:
        """Return the truth about the room for another rectification OF THE TRUE RIG; see ``scene``."""
        return self.scene.rectified_truth(rectification)

    def save_images(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write left/NN.png, right/NN.png and, if there, scene/left.png, scene/right.png; return the files."""
        root = Path(folder)
        files = []
        for side, images in (("left", self.left_images), ("right", self.right_images)):
            files += [write_image(root / side / f"{k:02d}.png", image) for k, image in enumerate(images, start=1)]
        for side, picture in (("left", self.scene_left), ("right", self.scene_right)):
            if picture is not None:
                files.append(write_image(root / "scene" / f"{side}.png", picture))
        return files


def default_rig(image_size: tuple[int, int] = (640, 480), *, unit: float = 1.0) -> StereoRig:
    """Return the UVC-like rig: two unlike wide cameras 60 mm apart.

    Parameters
    ----------
    image_size : (int, int)
        Width, height; the lens keeps its angle of view.
    unit : float
        Units a millimetre.
    """
    s = image_size[0] / 640
    rise = (image_size[1] - 480 * s) / 2
    left = Camera(
        camera_matrix(430.4 * s, 430.9 * s, 318.6 * s, 243.2 * s + rise),
        [-0.380, 0.150, 0.0004, -0.0003, -0.020],
        image_size,
    )
    right = Camera(
        camera_matrix(432.1 * s, 432.7 * s, 325.3 * s, 236.9 * s + rise),
        [-0.377, 0.147, -0.0002, 0.0005, -0.019],
        image_size,
    )
    return StereoRig(left, right, rotation_matrix([0.004, 0.021, -0.006]), np.array([-60.0, 0.35, 0.9]) * unit)


def render_rig(
    *,
    seed: int = 0,
    pairs: int = 15,
    image_size: tuple[int, int] = (640, 480),
    board: Chessboard | None = None,
    rig: StereoRig | None = None,
    blur: float = 0.8,
    noise: float = 2.0,
    contrast: float = 1.0,
    vignetting: float = 0.2,
    supersampling: int = 4,
    tilt: float = 35.0,
    bow: float = 0.0,
    desync: float = 0.0,
    mispaired: int = 0,
    scene: bool = True,
    workers: int | None = None,
    progress: Callable[[], object] | None = None,
) -> SyntheticRig:
    """Photograph boards and a room with a stereo rig whose truth is known.

    Parameters
    ----------
    seed : int
        Of poses, textures and noise: the same seed gives the same bytes, whatever the number of workers.
    pairs : int
        Views of the board.
    image_size : (int, int)
        Width, height; of the default rig.
    board : Chessboard, optional
        By default 9x6 inner corners, 25 mm squares.
    rig : StereoRig, optional
        By default :func:`default_rig`, scaled with the board's square_size.
    blur, noise, contrast, vignetting, supersampling
        The optics; see :func:`~stereocal.synthetic.board_view.render_board`.
    tilt : float
        Largest tilt of the board, degrees.
    bow : float
        The board's bend, in the rig's unit.
    desync : float
        How far the board moves between the two exposures, in the rig's unit, each time another way.
    mispaired : int
        How many of the last pairs have their right photographs passed on in a circle; 0 or at least 2.
    scene : bool
        Whether the room is photographed too.
    workers : int, optional
        Threads; by default as many as processors.
    progress : callable, optional
        Called once for each photograph that is done.

    Returns
    -------
    SyntheticRig

    Raises
    ------
    InputError
        If an argument is out of range, or no pose shows the board to both cameras.

    Examples
    --------
    >>> import stereocal as sc
    >>> synthetic = sc.render_rig(seed=1, pairs=1, image_size=(80, 60), board=sc.Chessboard((4, 3), 40.0), scene=False)
    >>> synthetic.left_images[0].shape, synthetic.left_corners[0].shape
    ((60, 80), (12, 2))
    """
    require_integer(pairs, "pairs", minimum=0)
    require_integer(supersampling, "supersampling", minimum=4, maximum=16)
    if mispaired == 1 or not 0 <= mispaired <= pairs:
        raise InputError(f"mispaired must be 0 or from 2 to {pairs}, but is {mispaired}")
    target = board or Chessboard((9, 6), SQUARE)
    unit = target.square_size / SQUARE
    truth = rig or default_rig(image_size, unit=unit)
    room = furnished_room(unit, seed=seed)
    poses = hold_board(truth, target, pairs, tilt=tilt, seed=seed) if pairs else []
    late = [_moved(pose, desync, np.random.default_rng((seed, 2, k))) for k, pose in enumerate(poses)]
    optics = _Optics(blur, noise, contrast, vignetting, supersampling)
    sides = (truth.left, np.eye(3), np.zeros(3), poses), (truth.right, truth.R, truth.T, late)
    with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        lights = list(pool.map(lambda side: optics.room_light(side[0], room, side[1], side[2]), sides))
        behind = [np.tensordot(_DIMMED * _LUMA, light, axes=1) for light in lights]
        boards = [
            pool.submit(optics.photograph_board, camera, behind[s], (R @ R_b, R @ t_b + T), target, bow, (seed, s, k))
            for s, (camera, R, T, held) in enumerate(sides)
            for k, (R_b, t_b) in enumerate(held)
        ]
        ordered = enumerate(zip(sides, lights, strict=True)) if scene else ()
        rooms = [pool.submit(optics.expose, side[0], light, (seed, s, 1 << 20)) for s, (side, light) in ordered]
        photographs = [_result(job, progress) for job in boards]
        pictures: list[Image | None] = [_result(job, progress) for job in rooms] or [None, None]
    left, right = photographs[:pairs], photographs[pairs:]
    if mispaired:
        right[-mispaired:] = [*right[-mispaired + 1 :], right[-mispaired]]
    return SyntheticRig(
        rig=truth,
        board=target,
        left_images=[image for image, _ in left],
        right_images=[image for image, _ in right],
        left_corners=[corners for _, corners in left],
        right_corners=[corners for _, corners in right],
        poses=poses,
        scene=room,
        scene_left=pictures[0],
        scene_right=pictures[1],
    )


def _result(job: Future[Any], progress: Callable[[], object] | None) -> Any:
    value = job.result()
    if progress is not None:
        progress()
    return value


@dataclass(frozen=True)
class _Optics:
    """Lens and sensor of both cameras."""

    blur: float
    noise: float
    contrast: float
    vignetting: float
    supersampling: int

    def room_light(self, camera: Camera, room: Scene, R: Float, T: Float) -> NDArray[np.float32]:
        table = ray_table(camera, supersampling=self.supersampling, pad=blur_pad(self.blur))
        return room.radiance(table, R, T)

    def photograph_board(
        self, camera: Camera, behind: NDArray[np.float32], pose: Pose, board: Chessboard, bow: float, seed: Any
    ) -> tuple[Image, Float]:
        table = ray_table(camera, supersampling=self.supersampling, pad=blur_pad(self.blur))
        light = behind.copy()
        paint_board(table, *pose, board, light, contrast=self.contrast, bow=bow)
        return self.expose(camera, light, seed), true_corners(camera, *pose, board, bow=bow)

    def expose(self, camera: Camera, light: NDArray[np.float32], seed: Any) -> Image:
        kernel = aperture_kernel(self.blur, self.supersampling, blur_pad(self.blur))
        channels = light if light.ndim == 3 else light[None]
        image = np.stack([gather(channel, kernel, self.supersampling) for channel in channels], axis=-1)
        image = image[..., 0] if light.ndim == 2 else image
        random = np.random.default_rng(seed)
        return develop(image, noise=self.noise, random=random, shading=vignette(camera, self.vignetting))


def _moved(pose: Pose, distance: float, random: np.random.Generator) -> Pose:
    """The pose a moment later: shifted by `distance` in a random direction."""
    if distance == 0:
        return pose
    step = random.standard_normal(3)
    return pose[0], pose[1] + distance * step / np.linalg.norm(step)
