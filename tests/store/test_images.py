"""Every pixel format comes in deliberately, and no damaged or hostile file comes through."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from strategies import seeds

from stereocal.base.errors import DataFileError, InputError
from stereocal.base.gray import to_gray
from stereocal.store.images import read_image, read_image_size, write_image


def _random(seed: int, shape: tuple[int, ...], dtype: type = np.uint8) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, np.iinfo(dtype).max + 1, shape).astype(dtype)


@settings(max_examples=25)
@given(seeds, st.integers(1, 40), st.integers(1, 40), st.sampled_from([".png", ".tif", ".bmp"]), st.booleans())
def test_what_is_written_reads_back(tmp_path_factory, seed, height, width, suffix, colour):
    image = _random(seed, (height, width, 3) if colour else (height, width))
    path = write_image(tmp_path_factory.mktemp("io") / f"a{suffix}", image)
    np.testing.assert_array_equal(read_image(path), image)
    assert read_image_size(path) == (width, height)
    seen = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
    np.testing.assert_array_equal(seen[..., ::-1] if colour else seen, image)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm"])
def test_sixteen_bit_grey_keeps_every_bit(tmp_path, suffix):
    image = _random(1, (7, 9), np.uint16)
    path = write_image(tmp_path / f"a{suffix}", image)
    read = read_image(path)
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, image)
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), image)


@pytest.mark.parametrize(
    ("suffix", "options", "channels"),
    [
        (".png", [], 3),
        (".png", [], 4),
        (".tif", [cv2.IMWRITE_TIFF_COMPRESSION, 1], 3),
        (".tif", [cv2.IMWRITE_TIFF_COMPRESSION, 5], 3),
        (".tif", [cv2.IMWRITE_TIFF_COMPRESSION, 5], 4),
        (".ppm", [], 3),
    ],
)
def test_sixteen_bit_colour_keeps_every_bit(tmp_path, suffix, options, channels):
    image = _random(2, (37, 53, channels), np.uint16)
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), image, options)
    read = read_image(path)
    assert read.dtype == np.uint16
    np.testing.assert_array_equal(read, image[..., 2::-1])
    np.testing.assert_array_equal(read_image(path, gray=True), cv2.cvtColor(image[..., :3], cv2.COLOR_BGR2GRAY))


def test_sixteen_bit_colour_is_written_as_opencv_reads_it(tmp_path):
    image = _random(3, (9, 11, 3), np.uint16)
    path = write_image(tmp_path / "a.png", image)
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1], image)
    np.testing.assert_array_equal(read_image(path), image)


def test_sixteen_bit_colour_is_turned_as_its_exif_says(tmp_path):
    image = _random(4, (5, 8, 3), np.uint16)
    whole = write_image(tmp_path / "a.png", image).read_bytes()
    exif = Image.Exif()
    exif[0x0112] = 6  # seen after a quarter turn clockwise
    body = b"eXIf" + exif.tobytes().removeprefix(b"Exif\0\0")
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    (tmp_path / "b.png").write_bytes(whole[:33] + chunk + whole[33:])
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), np.rot90(image, -1))
    np.testing.assert_array_equal(read_image(tmp_path / "b.png", orientation="sensor"), image)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".ppm"])
def test_sixteen_bit_colour_cut_short_is_refused(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), _random(5, (40, 50, 3), np.uint16))
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    with pytest.raises(DataFileError, match="not an image" if suffix == ".tif" else "cut short"):
        read_image(path)  # a TIFF has its directory at its end


def test_sixteen_bit_colour_of_jpeg_2000_is_refused_not_squeezed(tmp_path):
    path = tmp_path / "a.jp2"
    cv2.imwrite(str(path), _random(6, (32, 32, 3), np.uint16))
    with pytest.raises(DataFileError, match="more than 8 bits a colour channel"):
        read_image(path)


def test_ppm_of_twelve_bits_fills_the_range(tmp_path):
    values = np.array([[[0, 4095, 2048], [1, 2, 4094]]], ">u2")
    (tmp_path / "a.ppm").write_bytes(b"P6\n2 1\n4095\n" + values.tobytes())
    expected = np.rint(values * (65535 / 4095)).astype(np.uint16)
    np.testing.assert_array_equal(read_image(tmp_path / "a.ppm"), expected)


def test_palette_gives_its_colours_and_a_grey_palette_grey(tmp_path):
    indices = _random(3, (8, 8)) % 4
    picture = Image.fromarray(indices)
    for name, palette in (
        ("colour", [10, 20, 30, 40, 50, 60, 70, 80, 90, 1, 2, 3]),
        ("grey", [5] * 3 + [90] * 3 + [7] * 6),
    ):
        picture.putpalette(palette + [0] * (768 - len(palette)))
        picture.save(tmp_path / f"{name}.png")
    colours = np.array([10, 20, 30, 40, 50, 60, 70, 80, 90, 1, 2, 3]).reshape(4, 3)
    np.testing.assert_array_equal(read_image(tmp_path / "colour.png"), colours[indices])
    np.testing.assert_array_equal(read_image(tmp_path / "grey.png"), np.array([5, 90, 7, 7])[indices])


def test_alpha_is_dropped_and_bilevel_is_black_and_white(tmp_path):
    rgba = _random(4, (5, 6, 4))
    Image.fromarray(rgba, "RGBA").save(tmp_path / "a.png")
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), rgba[..., :3])
    la = _random(4, (5, 6, 2))
    Image.fromarray(la, "LA").save(tmp_path / "la.png")
    np.testing.assert_array_equal(read_image(tmp_path / "la.png"), la[..., 0])
    bits = _random(5, (9, 13)) > 127
    Image.fromarray(bits).save(tmp_path / "b.png")
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), bits * np.uint8(255))


def test_float_tiff_as_it_is_but_no_nan(tmp_path):
    values = np.random.default_rng(0).random((4, 5)).astype(np.float32)
    Image.fromarray(values).save(tmp_path / "f.tif")
    np.testing.assert_array_equal(read_image(tmp_path / "f.tif"), values)
    values[1, 2] = np.nan
    Image.fromarray(values).save(tmp_path / "f.tif")
    with pytest.raises(DataFileError, match="NaN"):
        read_image(tmp_path / "f.tif")


@pytest.mark.parametrize("tag", range(1, 9))
def test_exif_orientation_as_opencv_applies_it(tmp_path, tag):
    image = np.repeat(np.repeat(_random(6, (3, 5)), 16, 0), 16, 1)
    exif = Image.Exif()
    exif[0x0112] = tag
    path = tmp_path / "a.jpg"
    Image.fromarray(image).save(path, quality=100, exif=exif)
    np.testing.assert_array_equal(read_image(path), cv2.imread(str(path), cv2.IMREAD_GRAYSCALE))
    assert read_image_size(path) == read_image(path).shape[::-1]
    assert read_image(path, orientation="sensor").shape == image.shape


def test_gray_is_the_luma_of_colour(tmp_path):
    image = _random(7, (6, 6, 3))
    path = write_image(tmp_path / "a.png", image)
    np.testing.assert_array_equal(read_image(path, gray=True), to_gray(image))


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp", ".pgm"])
def test_cut_anywhere_a_file_is_refused_or_still_whole(tmp_path, suffix):
    image = np.kron(_random(8, (6, 8)), np.ones((8, 8), np.uint8))
    whole = write_image(tmp_path / f"whole{suffix}", image)
    content, expected = whole.read_bytes(), read_image(whole)
    cut = tmp_path / f"cut{suffix}"
    refused = 0
    for length in np.unique(np.linspace(0, len(content) - 1, 60).astype(int)):
        cut.write_bytes(content[:length])
        try:
            np.testing.assert_array_equal(read_image(cut), expected)  # e.g. only a trailing end marker is gone
        except DataFileError:
            refused += 1
    assert refused > 50


def test_each_bad_file_has_its_own_sentence(tmp_path):
    (tmp_path / "empty.png").touch()
    (tmp_path / "text.png").write_text("hello")
    (tmp_path / "script.eps").write_text("%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\nshowpage\n")
    for name, sentence in (
        ("missing.png", "cannot be read"),
        (".", "is a folder"),
        ("empty.png", "is empty"),
        ("text.png", "is not an image"),
        ("script.eps", "is not an image"),
        ("a\0b", "is not a file name"),
    ):
        with pytest.raises(DataFileError, match=sentence):
            read_image(tmp_path / name)


def _png_that_claims(width: int, height: int) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    body = zlib.compress(b"\0" * 1000)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", body) + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(15_000, 15_000), (100_000, 100_000), (2**31 - 1, 2**31 - 1)])
def test_a_decompression_bomb_is_refused_before_it_is_unpacked(tmp_path, size):
    path = tmp_path / "bomb.png"
    path.write_bytes(_png_that_claims(*size))
    with pytest.raises(DataFileError, match=r"pixels|damaged"):
        read_image(path)


@settings(max_examples=60)
@given(seeds)
def test_no_mangled_file_escapes_as_anything_but_a_data_file_error(tmp_path_factory, seed):
    random = np.random.default_rng(seed)
    folder = tmp_path_factory.mktemp("fuzz")
    suffix = random.choice([".png", ".jpg", ".tif", ".bmp", ".pgm", ".webp"])
    path = write_image(
        folder / f"a{suffix}", _random(seed, (12, 12, 3)) if suffix != ".pgm" else _random(seed, (12, 12))
    )
    content = bytearray(path.read_bytes())
    for place in random.integers(0, len(content), 8):
        content[place] = random.integers(256)
    path.write_bytes(bytes(content))
    try:
        read_image(path)
    except DataFileError as error:  # any other exception fails the test
        sentence = str(error)
    else:
        return
    assert str(path) in sentence
    assert "\n" not in sentence


def test_writing_refuses_what_would_lose_range_and_leaves_the_old_file(tmp_path):
    path = write_image(tmp_path / "a.png", np.zeros((2, 2), np.uint8))
    for bad in (np.zeros((2, 2)), np.zeros((2, 2, 3), np.int32)):
        with pytest.raises(InputError):
            write_image(path, bad)
    with pytest.raises(InputError, match=r"not \.xyz"):
        write_image(tmp_path / "a.xyz", np.zeros((2, 2), np.uint8))
    assert read_image(path).shape == (2, 2)
    assert [each.name for each in Path(tmp_path).iterdir()] == ["a.png"]


def test_real_photographs_equal_opencvs(data):
    for path in [*sorted((data / "uvc_paper" / "left").glob("*.jpg"))[:3], data / "teddy" / "im2.png"]:
        np.testing.assert_array_equal(read_image(path), cv2.imread(str(path))[..., ::-1])
