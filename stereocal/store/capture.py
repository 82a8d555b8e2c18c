"""Photographs from a stereo camera that is plugged in: two devices, or one that delivers both images side by side.

OpenCV's ``VideoCapture`` is the driver; this is the only module of the room that imports cv2, and it imports it for the
device, not for an algorithm.

**Synchronisation.** Two USB cameras run on their own clocks. ``grab`` only latches a frame, ``retrieve`` decodes it; so
both are grabbed first and decoded afterwards, which keeps the moments of exposure within a frame's time (33 ms at 30
Hz) and not within two decoding times. The time between the two grabs is returned with each pair, for a board that moves
0.5 m/s covers 5 mm in 10 ms. A camera that delivers both images in one frame has no such trouble.

**Stale frames.** Drivers queue a few frames; the first ones after a pause are old. `warm_up` frames are thrown away.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import require_integer
from stereocal.base.errors import DataFileError, InputError

Image = NDArray[np.uint8]


class Device(Protocol):
    """What is asked of a camera: cv2.VideoCapture, or a stand-in for it."""

    def isOpened(self) -> bool: ...

    def grab(self) -> bool: ...

    def retrieve(self) -> tuple[bool, Any]: ...

    def set(self, property: int, value: float) -> bool: ...

    def release(self) -> None: ...


@dataclass(frozen=True)
class StereoFrame:
    """One pair.

    Attributes
    ----------
    left, right : ndarray of shape (H, W, 3), uint8
        R, G, B.
    delay : float
        Seconds between the two grabs; 0 for side-by-side frames.
    """

    left: Image
    right: Image
    delay: float


@contextmanager
def open_stereo_camera(
    left: int | str, right: int | str | None = None, *, image_size: tuple[int, int] | None = None, warm_up: int = 5
) -> Iterator[StereoCamera]:
    """Open two cameras, or one that delivers both images side by side, and release them at the end.

    Parameters
    ----------
    left, right : int or str
        Device numbers, device files or stream addresses; no `right` for side-by-side frames.
    image_size : (int, int), optional
        Width and height to ask of each device (of the whole frame for side-by-side ones).
    warm_up : int
        Frames thrown away first.

    Yields
    ------
    StereoCamera

    Raises
    ------
    DataFileError
        If a device cannot be opened.
    InputError
        If OpenCV is not installed.
    """
    devices = [_open(source, image_size) for source in (left, right) if source is not None]
    camera = StereoCamera(devices, [str(source) for source in (left, right) if source is not None])
    try:
        for _ in range(require_integer(warm_up, "warm_up", minimum=0)):
            camera.read()
        yield camera
    finally:
        for device in devices:
            device.release()


class StereoCamera:
    """One or two devices that deliver pairs.

    Parameters
    ----------
    devices : list of Device
        Two, left first, or one with frames side by side.
    names : list of str
        Their names, for messages.
    """

    def __init__(self, devices: list[Device], names: list[str]) -> None:
        if len(devices) not in (1, 2) or len(names) != len(devices):
            raise InputError(f"a stereo camera is one device or two, not {len(devices)}")
        self._devices, self._names = devices, names

    def read(self) -> StereoFrame:
        """Return the next pair.

        Raises
        ------
        DataFileError
            If a device delivers no frame, or frames that make no pair.
        """
        moments = []
        for device, name in zip(self._devices, self._names, strict=True):
            if not device.grab():
                raise DataFileError(name, "delivers no frame; is the camera plugged in and free?")
            moments.append(time.perf_counter())
        frames = [self._retrieve(device, name) for device, name in zip(self._devices, self._names, strict=True)]
        if len(frames) == 2:
            if frames[0].shape != frames[1].shape:
                raise DataFileError(self._names[1], "delivers another image size than the left camera; set image_size")
            return StereoFrame(frames[0], frames[1], moments[1] - moments[0])
        left, right = split_side_by_side(frames[0], self._names[0])
        return StereoFrame(left, right, 0.0)

    @staticmethod
    def _retrieve(device: Device, name: str) -> Image:
        good, frame = device.retrieve()
        if not good or frame is None or frame.ndim != 3 or frame.shape[2] != 3 or frame.dtype != np.uint8:
            raise DataFileError(name, "delivers a frame that cannot be decoded to 8-bit colour")
        return np.ascontiguousarray(frame[..., ::-1])  # OpenCV's B, G, R to R, G, B


def split_side_by_side(frame: Image, name: str = "frame") -> tuple[Image, Image]:
    """Return the left and the right half of a frame, (H, 2W) or (H, 2W, 3)."""
    width = frame.shape[1]
    if width % 2:
        raise DataFileError(name, f"has an odd width of {width}, so it is no two images side by side")
    return np.ascontiguousarray(frame[:, : width // 2]), np.ascontiguousarray(frame[:, width // 2 :])


def _open(source: int | str, image_size: tuple[int, int] | None) -> Any:
    try:
        import cv2
    except ImportError as error:
        raise InputError("capturing needs OpenCV: pip install 'stereocal[opencv]'") from error
    device = cv2.VideoCapture(source)
    if image_size is not None:
        device.set(cv2.CAP_PROP_FRAME_WIDTH, image_size[0])
        device.set(cv2.CAP_PROP_FRAME_HEIGHT, image_size[1])
    if not device.isOpened():
        device.release()
        raise DataFileError(str(source), "cannot be opened as a camera; is it plugged in and free?")
    return device
