"""The first run on a machine: what is compiled while photographs are searched for boards.

Finding boards and calibrating need kernels of their own, about as long to compile as each other. So while this process
comes to the first, another compiles the second (``base.compile_ahead``), by calibrating a small rig and rectifying an
image with it.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.compile_ahead import compile_ahead
from stereocal.board.chessboard import Chessboard
from stereocal.camera.calibration import calibrate_camera
from stereocal.camera.model import Camera
from stereocal.pair.rectification import rectify
from stereocal.pair.rig import StereoRig


def compile_calibration_ahead(model: str) -> None:
    """Start compiling what a calibration with a lens model needs once boards are found, unless that has been done."""
    from stereocal.camera.bundle_kernels import normal_equations_kernel
    from stereocal.camera.bundle_step_kernels import step_kernel
    from stereocal.camera.homography_kernels import homographies_kernel

    call = f"{__name__}:compile_calibration({model!r})"
    compile_ahead(call, homographies_kernel, normal_equations_kernel, step_kernel)


def compile_calibration(model: str) -> None:
    """Calibrate a camera from a few views, undo its lens, and rectify an image: for what it compiles."""
    size = (64, 48)
    camera = Camera(np.array([[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1]]), [-0.1, 0.02, 0, 0, 0], size)
    board = Chessboard((5, 4))
    tilts = ((0.5, 0, 0), (-0.5, 0, 0.1), (0, 0.5, 0), (0, -0.5, 0.1), (0.3, 0.3, 0), (-0.3, 0.4, 0.2))
    corners = [camera.project(board.object_points, tilt, [-2, -1.5, 7]) for tilt in tilts]
    found = calibrate_camera(board.object_points, corners, size, model=model).camera
    found.undistort_points(corners[0])
    image = np.zeros(size[::-1], dtype=np.uint8)
    rectify(StereoRig(found, found, np.eye(3), [-1.0, 0.0, 0.0])).apply(image, image)
