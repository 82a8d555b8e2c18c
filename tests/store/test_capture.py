"""Capture with stand-ins for devices: order of grabs, colours, refusals, release."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereocal.base.errors import DataFileError, InputError
from stereocal.store.capture import StereoCamera, open_stereo_camera, split_side_by_side


class FakeDevice:
    """Delivers frames from a list and writes down what is asked of it."""

    def __init__(self, name, frames, log, opened=True):
        self.name, self.frames, self.log, self.opened = name, list(frames), log, opened

    def isOpened(self):
        return self.opened

    def set(self, prop, value):
        self.log.append((self.name, "set", prop, value))
        return True

    def grab(self):
        self.log.append((self.name, "grab"))
        return bool(self.frames)

    def retrieve(self):
        self.log.append((self.name, "retrieve"))
        return True, self.frames.pop(0)

    def release(self):
        self.log.append((self.name, "release"))


def _frame(value, shape=(4, 6, 3)):
    frame = np.zeros(shape, np.uint8)
    frame[..., 0] = value  # blue in OpenCV's order
    return frame


def test_both_are_grabbed_before_either_is_decoded_and_colours_are_rgb():
    log = []
    camera = StereoCamera([FakeDevice("L", [_frame(7)], log), FakeDevice("R", [_frame(9)], log)], ["L", "R"])
    pair = camera.read()
    assert log == [("L", "grab"), ("R", "grab"), ("L", "retrieve"), ("R", "retrieve")]
    assert (pair.left[..., 2] == 7).all()
    assert (pair.right[..., 2] == 9).all()
    assert pair.delay >= 0
    with pytest.raises(DataFileError, match="no frame"):
        camera.read()


def test_side_by_side_is_split_in_the_middle():
    frame = np.hstack([_frame(1), _frame(2)])
    pair = StereoCamera([FakeDevice("S", [frame], [])], ["S"]).read()
    assert pair.left.shape == pair.right.shape == (4, 6, 3)
    assert (pair.left[..., 2] == 1).all()
    assert (pair.right[..., 2] == 2).all()
    assert pair.delay == 0
    with pytest.raises(DataFileError, match="odd width"):
        split_side_by_side(np.zeros((2, 5), np.uint8))


def test_unequal_sizes_and_undecodable_frames_are_refused():
    camera = StereoCamera([FakeDevice("L", [_frame(1)], []), FakeDevice("R", [_frame(1, (4, 8, 3))], [])], ["L", "R"])
    with pytest.raises(DataFileError, match="another image size"):
        camera.read()
    with pytest.raises(DataFileError, match="decoded"):
        StereoCamera([FakeDevice("S", [np.zeros((2, 2), np.uint8)], [])], ["S"]).read()
    with pytest.raises(InputError):
        StereoCamera([], [])


def test_devices_are_warmed_up_and_always_released(monkeypatch):
    log = []
    monkeypatch.setattr(cv2, "VideoCapture", lambda source: FakeDevice(source, [_frame(k) for k in range(4)], log))
    with open_stereo_camera(0, 1, image_size=(6, 4), warm_up=3) as camera:
        assert (camera.read().left[..., 2] == 3).all()
    assert log[-2:] == [(0, "release"), (1, "release")]
    assert (0, "set", cv2.CAP_PROP_FRAME_WIDTH, 6) in log
    monkeypatch.setattr(cv2, "VideoCapture", lambda source: FakeDevice(source, [], log, opened=False))
    with pytest.raises(DataFileError, match="cannot be opened"), open_stereo_camera(5):
        pass
    assert log[-1] == (5, "release")
