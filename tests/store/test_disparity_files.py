"""Disparity maps: each encoding by its definition, by OpenCV, and back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.errors import DataFileError, InputError
from stereocal.store.disparity_files import (
    from_opencv_disparity,
    read_disparity,
    read_pfm,
    to_opencv_disparity,
    write_disparity,
    write_pfm,
)


def _map(seed: int, low: float = 0.0, high: float = 60.0, shape: tuple[int, int] = (9, 13)) -> np.ndarray:
    random = np.random.default_rng(seed)
    values = random.uniform(low, high, shape).astype(np.float32)
    values[random.random(shape) < 0.2] = np.nan
    return values


@settings(max_examples=20)
@given(seeds, st.integers(1, 12), st.integers(1, 12))
def test_lossless_encodings_return_the_same_bits(tmp_path_factory, seed, height, width):
    values = _map(seed, -200, 200, (height, width))
    folder = tmp_path_factory.mktemp("d")
    for name in ("a.pfm", "a.npy"):
        np.testing.assert_array_equal(read_disparity(write_disparity(folder / name, values)), values)


@settings(max_examples=20)
@given(seeds)
def test_quantised_encodings_are_within_half_a_step(tmp_path_factory, seed):
    folder = tmp_path_factory.mktemp("d")
    values = _map(seed, 0.5)
    for name, options, step in (
        ("k.png", {"encoding": "kitti"}, 1 / 256),
        ("m.png", {"encoding": "middlebury", "scale": 4}, 1 / 4),
        ("m.pgm", {"encoding": "middlebury", "scale": 3}, 1 / 3),
        ("o.npy", {"encoding": "opencv", "min_disparity": -16}, 1 / 16),
    ):
        back = read_disparity(write_disparity(folder / name, values, **options), **options)
        np.testing.assert_array_equal(np.isnan(back), np.isnan(values))
        assert np.nanmax(np.abs(back - values), initial=0) <= step / 2 + 1e-6


def test_pfm_is_what_opencv_reads_and_writes(tmp_path):
    values = np.random.default_rng(0).random((5, 7)).astype(np.float32)
    path = write_pfm(tmp_path / "a.pfm", values)
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), values)
    cv2.imwrite(str(tmp_path / "b.pfm"), values)
    np.testing.assert_array_equal(read_pfm(tmp_path / "b.pfm"), values)


def test_pfm_by_its_bytes(tmp_path):
    path = tmp_path / "a.pfm"
    path.write_bytes(b"Pf\n2 1\n1.0\n" + np.array([1.5, -2.0], ">f4").tobytes())
    np.testing.assert_array_equal(read_pfm(path), [[1.5, -2.0]])
    # the first pixel's bytes look like white space (0x20202020 in either order)
    path.write_bytes(b"Pf 1 2 -1\n" + b"\x20\x20\x20\x20" + np.float32(3).tobytes())
    assert read_pfm(path)[0, 0] == 3
    assert read_pfm(path)[1, 0] == np.frombuffer(b"    ", "<f4")[0]


def test_kitti_png_by_its_definition(tmp_path):
    values = np.array([[0.0, 1.0, np.nan, 255.99]], np.float32)
    path = write_disparity(tmp_path / "a.png", values)
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), [[1, 256, 0, 65533]])


@settings(max_examples=30)
@given(seeds, st.integers(-32, 16))
def test_opencv_fixed_point_there_and_back(seed, min_disparity):
    fixed = np.random.default_rng(seed).integers((min_disparity - 1) * 16, 64 * 16, (6, 6)).astype(np.int16)
    values = from_opencv_disparity(fixed, min_disparity=min_disparity)
    np.testing.assert_array_equal(to_opencv_disparity(values, min_disparity=min_disparity), fixed)


def test_stereo_bm_output_reads_as_disparity():
    left = np.random.default_rng(0).integers(0, 255, (60, 120)).astype(np.uint8)
    right = np.roll(left, -5, axis=1)
    found = cv2.StereoBM.create(16, 11).compute(left, right)
    values = from_opencv_disparity(found)
    assert np.nanmedian(values) == 5
    assert (np.isnan(values) == (found == -16)).all()


def test_what_an_encoding_cannot_hold_is_refused(tmp_path):
    for encoding, value in (
        ("kitti", -1.0),
        ("kitti", 256.0),
        ("middlebury", 64.0),
        ("opencv", 2048.0),
        ("opencv", -1.0),
    ):
        with pytest.raises(InputError):
            write_disparity(tmp_path / "a.png", np.full((2, 2), value), encoding=encoding)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("a.pfm", b"", "is empty"),
        ("a.pfm", b"P5\n2 2\n255\nabcd", "is not a PFM"),
        ("a.pfm", b"Pf\n-2 2\n-1\n", "makes no sense"),
        ("a.pfm", b"Pf\n2 2\nnan\n", "makes no sense"),
        ("a.pfm", b"Pf\n2 2\n-1\n1234", "is cut short"),
        ("a.pfm", b"Pf\n99999 99999\n-1\n", "more than"),
        ("a.npy", b"\x93NUMPY\x01\x00", "is not a NumPy file"),
        ("a.npy", b"hello", "is not a NumPy file"),
    ],
)
def test_damaged_files_are_refused(tmp_path, name, content, sentence):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(DataFileError, match=sentence):
        read_disparity(tmp_path / name)


def test_a_pickle_in_an_npy_is_never_opened(tmp_path):
    np.save(tmp_path / "a.npy", np.array([object()]), allow_pickle=True)
    with pytest.raises(DataFileError, match="Python objects"):
        read_disparity(tmp_path / "a.npy")
