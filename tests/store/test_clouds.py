"""PLY: the bytes by definition, invalid points dropped."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.errors import DataFileError, InputError
from stereocal.store.clouds import read_ply, write_ply


def test_the_bytes(tmp_path):
    points = np.array([[1.0, 2.0, 3.0], [np.nan, 0, 0], [4, 5, np.inf], [6, 7, 8]])
    colors = np.array([[1, 2, 3], [0, 0, 0], [0, 0, 0], [250, 251, 252]], np.uint8)
    assert write_ply(tmp_path / "a.ply", points, colors) == 2
    head, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    assert head.splitlines()[:2] == [b"ply", b"format binary_little_endian 1.0"]
    assert b"element vertex 2\n" in head
    expected = np.array([1, 2, 3], "<f4").tobytes() + bytes([1, 2, 3])
    expected += np.array([6, 7, 8], "<f4").tobytes() + bytes([250, 251, 252])
    assert body == expected


@settings(max_examples=20)
@given(seeds, st.integers(0, 30), st.sampled_from(["rgb", "grey", None]))
def test_round_trip(tmp_path_factory, seed, count, kind):
    random = np.random.default_rng(seed)
    points = random.normal(0, 1000, (count, 3)).astype(np.float32)
    colors = None if kind is None else random.integers(0, 256, (count, 3) if kind == "rgb" else count).astype(np.uint8)
    path = tmp_path_factory.mktemp("c") / "a.ply"
    assert write_ply(path, points, colors) == count
    back, shades = read_ply(path)
    np.testing.assert_array_equal(back, points)
    if kind is None:
        assert shades is None
    else:
        np.testing.assert_array_equal(shades, colors if kind == "rgb" else np.repeat(colors[:, None], 3, 1))


def test_maps_of_points_and_bad_shapes(tmp_path):
    assert write_ply(tmp_path / "a.ply", np.ones((4, 5, 3)), np.ones((4, 5), np.uint8)) == 20
    for points, colors in (
        (np.ones((4, 2)), None),
        (np.ones((4, 3)), np.ones((5, 3), np.uint8)),
        (np.ones((4, 3)), np.ones((4, 3))),
        (np.ones((4, 5, 3)), np.ones((5, 4, 3), np.uint8)),  # as many, but each another pixel's
        ([[1, 2, 3], [4, 5]], None),
    ):
        with pytest.raises(InputError):
            write_ply(tmp_path / "a.ply", points, colors)


def test_a_cloud_of_several_portions(tmp_path, monkeypatch):
    monkeypatch.setattr("stereocal.store.clouds.POINTS_AT_A_TIME", 7)
    points = np.arange(60.0).reshape(4, 5, 3)
    points[1, 2, 0], points[3, 4, 1] = np.nan, 1e300  # the second is finite, but not in the file's float32
    colors = np.arange(60, dtype=np.uint8).reshape(4, 5, 3)
    valid = np.abs(points).max(axis=2) < 1e30
    assert write_ply(tmp_path / "a.ply", points, colors) == 18
    back, shades = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(back, points[valid])
    np.testing.assert_array_equal(shades, colors[valid])


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"ply\nformat ascii 1.0\nend_header\n",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n"
        b"property float x\nproperty float y\nproperty float z\n"
        b"end_header\n12",
        b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n",
        b"ply\nformat binary_little_endian 1.0\nelement face 1\nend_header\n",
    ],
)
def test_other_or_damaged_files_are_refused(tmp_path, content):
    (tmp_path / "a.ply").write_bytes(content)
    with pytest.raises(DataFileError):
        read_ply(tmp_path / "a.ply")
