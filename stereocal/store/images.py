"""Photographs in, photographs out.

A calibration is a statement about the pixels of one sensor, so what happens to a pixel between the file and the array
has to be known. Each choice here is deliberate:

==================  ==================================================================================================
in the file         in the array
==================  ==================================================================================================
grey, 8 bit         (H, W) uint8, as it is; 1-bit images become 0 and 255
grey, 16 bit        (H, W) uint16, as it is, whatever the byte order; never squeezed into 8 bits
colour, 8 bit       (H, W, 3) uint8 in the order R, G, B (OpenCV's is B, G, R)
colour, 16 bit      refused: Pillow would keep the upper byte only, without a word
palette             the colours that the palette names; a grey palette gives a grey image
alpha               dropped: the colours are taken as stored, as :func:`~stereocal.base.gray.to_gray` does
CMYK, YCbCr, Lab    converted to R, G, B
floating point      (H, W) float32, as it is
EXIF orientation    applied, as every viewer and ``cv2.imread`` do, so that both see the same pixels;
                    ``orientation="sensor"`` leaves the pixels in the order in which the sensor read them
several frames      the first
==================  ==================================================================================================

A file is hostile until proven harmless: only formats that photographs come in are decoded (not PostScript, which
would start an interpreter), and the header's size is checked before a byte of pixels is unpacked, because a PNG of a
few kilobytes can claim a picture of a hundred gigabytes (a "decompression bomb").
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageFile, ImageOps, UnidentifiedImageError

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import as_image, require_choice
from stereocal.base.errors import DataFileError, InputError
from stereocal.base.gray import to_gray
from stereocal.store.sixteen_bits import is_sixteen_bit_colour, read_sixteen_bit_colour, write_sixteen_bit_colour

MAX_PIXELS = 178_956_970
"""The largest picture that is unpacked: half a gigabyte of RGB, Pillow's own limit."""

FORMATS_READ = ("PNG", "JPEG", "TIFF", "BMP", "PPM", "WEBP", "GIF", "JPEG2000")
"""Pillow's names of the formats that are decoded."""

IMAGE_SUFFIXES = frozenset(
    (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".ppm", ".pgm", ".pbm", ".pnm", ".webp", ".gif", ".jp2")
)
"""File name endings, in lower case, by which images are found in a folder."""

_GREY_MODES = ("1", "L", "LA", "La")
_SIXTEEN_BIT_MODES = ("I;16", "I;16B", "I;16L", "I;16N")
_FORMAT_OF_SUFFIX = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    ".bmp": "BMP",
    ".ppm": "PPM",
    ".pgm": "PPM",
    ".webp": "WEBP",
}


def read_image(
    path: str | os.PathLike[str], *, gray: bool = False, orientation: str = "exif", max_pixels: int = MAX_PIXELS
) -> NDArray[Any]:
    """Read a photograph.

    Parameters
    ----------
    path : str or os.PathLike
        The file: PNG, JPEG, TIFF, BMP, PPM/PGM, WebP, GIF or JPEG 2000.
    gray : bool
        Whether colour is reduced to luma, Y = 0.299 R + 0.587 G + 0.114 B.
    orientation : {"exif", "sensor"}
        Whether the camera's orientation tag is applied.
    max_pixels : int
        A larger picture is refused before it is unpacked.

    Returns
    -------
    ndarray of shape (H, W) or (H, W, 3), uint8, uint16 or float32
        Grey, or R, G, B.

    Raises
    ------
    DataFileError
        If the file is missing, empty, truncated, too large, or not an image that can be taken as it is.

    Notes
    -----
    Answers to ``cv2.imread(path, cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)`` (there B, G, R): identical on PNG, PGM
    and BMP; on JPEG within the ±2 grey levels by which decoders differ.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import stereocal as sc
    >>> from PIL import Image
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     Image.fromarray(np.full((4, 6), 90, np.uint8)).save(Path(folder) / "grey.png")
    ...     image = sc.read_image(Path(folder) / "grey.png")
    >>> image.shape, image.dtype, int(image[0, 0])
    ((4, 6), dtype('uint8'), 90)
    """
    require_choice(orientation, ("exif", "sensor"), "orientation")
    source = _require_file(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # damaged metadata, large sizes: judged below
            with Image.open(source, formats=FORMATS_READ) as picture:
                array = _decode(picture, source, orientation, max_pixels)
    except DataFileError:
        raise
    except UnidentifiedImageError as error:
        raise DataFileError(source, "is not an image (PNG, JPEG, TIFF, BMP, PPM, WebP, GIF are); remove it") from error
    except Image.DecompressionBombError as error:
        raise DataFileError(source, f"holds more than {max_pixels} pixels; scale it down") from error
    except MemoryError as error:
        raise DataFileError(source, "does not fit into memory; scale it down") from error
    except (OSError, ValueError, SyntaxError, EOFError, IndexError, KeyError, TypeError, ArithmeticError) as error:
        # Pillow's decoders answer damaged data with any of these.
        raise DataFileError(source, f"is damaged or cut short ({_one_line(error)}); copy it again") from error
    return to_gray(array) if gray else array


def read_image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Return (width, height) as :func:`read_image` would give it, from the header alone.

    Raises
    ------
    DataFileError
        If the file is missing, empty or not an image.
    """
    source = _require_file(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # damaged metadata, large sizes: judged below
            with Image.open(source, formats=FORMATS_READ) as picture:
                width, height = picture.size
                turned = picture.getexif().get(_ORIENTATION_TAG, 1) >= 5
    except (Exception, Image.DecompressionBombError) as error:
        raise DataFileError(source, f"is not an image that can be read ({_one_line(error)})") from error
    return (height, width) if turned else (width, height)


def write_image(path: str | os.PathLike[str], image: ArrayLike, *, quality: int = 95) -> Path:
    """Write a picture, whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        Where to; the ending says the format: .png, .jpg, .tif, .bmp, .ppm, .pgm, .webp.
    image : array_like of shape (H, W) or (H, W, 3), uint8 or uint16
        Grey, or R, G, B; uint16 goes into .png, grey also into .tif and .pgm.
    quality : int
        Of JPEG and WebP.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InputError
        If the format cannot hold the image without loss of range: nothing is squeezed silently.
    DataFileError
        If the file cannot be written.
    """
    array = as_image(image)
    suffix = Path(path).suffix.lower()
    if suffix not in _FORMAT_OF_SUFFIX:
        raise InputError(f"{path}: write images as {', '.join(_FORMAT_OF_SUFFIX)}, not {suffix or 'without an ending'}")
    if array.dtype == np.uint16:
        if suffix not in ((".png", ".tif", ".tiff", ".pgm") if array.ndim == 2 else (".png",)):
            raise InputError(f"{path}: 16-bit images are written as .png, grey also as .tif or .pgm; convert to uint8")
        if array.ndim == 3:
            return write_sixteen_bit_colour(path, array)
    elif array.dtype != np.uint8:
        raise InputError(f"{path}: images are written as uint8 or uint16, not {array.dtype}; scale and round first")
    picture = Image.fromarray(array)

    def save(stream: BinaryIO) -> None:
        options: dict[str, Any] = {"quality": quality} if suffix in (".jpg", ".jpeg", ".webp") else {}
        picture.save(stream, format=_FORMAT_OF_SUFFIX[suffix], **options)

    return write_whole(path, save)


_ORIENTATION_TAG = 0x0112


def _require_file(path: str | os.PathLike[str]) -> Path:
    source = Path(path)
    try:
        size = source.stat().st_size
    except OSError as error:
        raise DataFileError(source, f"cannot be read ({error.strerror}); check the name") from error
    except ValueError as error:  # a NUL byte in the name
        raise DataFileError(source, "is not a file name") from error
    if source.is_dir():
        raise DataFileError(source, "is a folder; name an image in it")
    if size == 0:
        raise DataFileError(source, "is empty (0 bytes); copy or take it again")
    return source


def _decode(picture: ImageFile.ImageFile, source: Path, orientation: str, max_pixels: int) -> NDArray[Any]:
    width, height = picture.size
    if width * height > max_pixels:
        raise DataFileError(
            source, f"claims {width}x{height} pixels, more than the {max_pixels} allowed; scale it down"
        )
    if is_sixteen_bit_colour(picture):
        return read_sixteen_bit_colour(picture, source, orientation)
    picture.load()
    upright: Image.Image = ImageOps.exif_transpose(picture) if orientation == "exif" else picture
    mode = upright.mode
    if mode in _SIXTEEN_BIT_MODES:
        return np.ascontiguousarray(np.asarray(upright).astype(np.uint16))
    if mode == "I":
        return _narrow(np.asarray(upright), source)
    if mode == "F":
        return _require_finite_pixels(np.array(upright, dtype=np.float32), source)
    if mode in _GREY_MODES:
        return np.array(upright.convert("L"))
    colour = np.array(upright.convert("RGB"))
    if mode in ("P", "PA") and np.ptp(colour, axis=2).max() == 0:
        return np.ascontiguousarray(colour[..., 0])
    return colour


def _narrow(pixels: NDArray[Any], source: Path) -> NDArray[Any]:
    if pixels.min() < 0 or pixels.max() > 65535:
        raise DataFileError(source, "holds 32-bit values outside 0..65535; save it with 8 or 16 bits")
    return pixels.astype(np.uint16)


def _require_finite_pixels(pixels: NDArray[Any], source: Path) -> NDArray[Any]:
    if not np.isfinite(pixels).all():
        raise DataFileError(source, "holds NaN or infinite pixels; an image has none")
    return pixels


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:120] or type(error).__name__
