"""Colour of 16 bits a channel, which Pillow knows to decode but not to hold.

Cameras for measuring save 12 to 16 bits a channel as PNG, TIFF or PPM. Pillow has no picture of that kind: it decodes
such a file and keeps the upper byte of each channel, without a word. But which byte it keeps is named by the decoder's
raw mode: ``RGB;16B`` says that the file's numbers are big-endian, so that the upper byte comes first, ``RGB;16L`` that
they are little-endian. Decoded twice, once told the truth and once the opposite, the file gives the upper bytes and
then the lower ones,

    v = 256 · upper + lower,

with filters, compression and interlacing left to the decoder that is tested for them. PPM, whose numbers stand bare in
the file, is read as it is. JPEG 2000 is refused: its decoder rounds to 8 bits inside.

Written is PNG only: a header, the rows big-endian and compressed as they are, an end; each part with its CRC-32.

Source: W3C, *Portable Network Graphics Specification*, 2003; Netpbm's *ppm*.
"""

from __future__ import annotations

import os
import struct
import sys
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageFile, ImageOps

from stereocal.base.atomic_files import write_whole
from stereocal.base.errors import DataFileError

_GREY_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I", "F")
_OTHER_ORDER = {"B": "L", "L": "B", "N": "B" if sys.byteorder == "little" else "L"}


def is_sixteen_bit_colour(picture: ImageFile.ImageFile) -> bool:
    """Whether Pillow's decoder is about to keep only the upper byte of each channel of an opened picture."""
    if picture.mode in _GREY_MODES:
        return False
    for tile in picture.tile:
        if tile[0] == "ppm" and picture.mode == "RGB" and _arguments(tile)[1] > 255:
            return True
        if any(isinstance(argument, str) and ";16" in argument for argument in _arguments(tile)):
            return True
        if tile[0] == "jpeg2k" and _bits_of_jpeg2000(picture) > 8:
            return True
    return False


def read_sixteen_bit_colour(picture: ImageFile.ImageFile, source: Path, orientation: str) -> NDArray[np.uint16]:
    """Return an opened picture of 16 bits a channel as (H, W, 3) uint16; alpha is dropped.

    Raises
    ------
    DataFileError
        If it is a JPEG 2000, whose lower bits cannot be had, or cut short.
    """
    kinds = {tile[0] for tile in picture.tile}
    if "jpeg2k" in kinds:
        raise DataFileError(source, "is a JPEG 2000 with more than 8 bits a colour channel; save it as PNG or TIFF")
    if "ppm" in kinds:
        return _read_ppm(picture, source)
    with Image.open(source, formats=[picture.format or "PNG"]) as again:
        again.tile = [_in_the_other_order(tile) for tile in again.tile]
        upper, lower = (_bytes_of(each, orientation) for each in (picture, again))
    return np.asarray((upper.astype(np.uint16) << 8) | lower, dtype=np.uint16)


def write_sixteen_bit_colour(path: str | os.PathLike[str], image: NDArray[np.uint16]) -> Path:
    """Write (H, W, 3) uint16 as PNG, whole or not at all."""
    height, width, _ = image.shape
    rows = image.astype(">u2").reshape(height, -1).view(np.uint8)
    unfiltered = np.zeros((height, 1), np.uint8)  # the filter of each row: none
    header = struct.pack(">IIBBBBB", width, height, 16, 2, 0, 0, 0)
    data = zlib.compress(np.hstack([unfiltered, rows]).tobytes(), 6)
    parts = b"".join(_chunk(*part) for part in ((b"IHDR", header), (b"IDAT", data), (b"IEND", b"")))
    return write_whole(path, b"\x89PNG\r\n\x1a\n" + parts)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _arguments(tile: Any) -> tuple[Any, ...]:
    return tile[3] if isinstance(tile[3], tuple) else (tile[3],)


def _in_the_other_order(tile: Any) -> Any:
    """The decoder's orders, with the byte order of the raw mode turned round."""
    first, *rest = _arguments(tile)
    mode = first[:-1] + _OTHER_ORDER[first[-1]]
    order = (*tile[:3], (mode, *rest) if isinstance(tile[3], tuple) else mode)
    return type(tile)(*order) if hasattr(tile, "_fields") else order


def _bytes_of(picture: Image.Image, orientation: str) -> NDArray[np.uint8]:
    picture.load()
    if orientation == "exif":
        picture = ImageOps.exif_transpose(picture)
    return np.asarray(picture)[..., :3]


def _read_ppm(picture: ImageFile.ImageFile, source: Path) -> NDArray[np.uint16]:
    """The bare numbers behind the header, big-endian; a maximum below 65535 is scaled up to it, as Pillow does grey."""
    tile = picture.tile[0]
    width, height = picture.size
    content = source.read_bytes()
    count = 3 * width * height
    if len(content) - tile[2] < 2 * count:
        raise DataFileError(source, "is damaged or cut short (PPM without all its pixels); copy it again")
    values = np.frombuffer(content, ">u2", count, tile[2]).reshape(height, width, 3)
    largest = int(_arguments(tile)[1])
    if largest == 65535:
        return values.astype(np.uint16)
    return np.minimum(np.rint(values * (65535 / largest)), 65535).astype(np.uint16)


def _bits_of_jpeg2000(picture: ImageFile.ImageFile) -> int:
    """The bits a channel, from the SIZ marker of the code stream."""
    stream = picture.fp
    if stream is None:
        return 8
    place = stream.tell()
    stream.seek(0)
    head = stream.read(65536)
    stream.seek(place)
    start = head.find(b"\xff\x4f\xff\x51")
    depth = head[start + 42 : start + 43]  # SOC, SIZ, length, capabilities, 8 sizes of 4 bytes, count of channels
    return (depth[0] & 0x7F) + 1 if start >= 0 and depth else 8
