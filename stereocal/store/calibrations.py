"""Calibrations of any tool: found out by their content, read, written, converted.

Each format is a module of its own, ``format_*.py``, with a ``read(path)`` and a ``write(record, path)`` between its
files and a :class:`~stereocal.store.calibration_record.CalibrationRecord`; the module's docstring is the page of that
format's conventions. Here stand the registry and the functions that users call. To add a format: write such a module,
enter it in :data:`FORMATS`, and teach :func:`recognize_format` its mark.
"""

from __future__ import annotations

import importlib
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from stereocal.base.checks import require_choice
from stereocal.base.errors import DataFileError, InputError
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import OPENCV_MODELS, CalibrationRecord, parameters_needed, require_unit
from stereocal.store.lens_refit import refit_lens
from stereocal.store.structured_text import read_bytes


@dataclass(frozen=True)
class CalibrationFormat:
    """One file format.

    Attributes
    ----------
    name : str
        As the user types it.
    module : str
        The module that reads and writes it.
    title : str
        As a sentence names it.
    suffixes : tuple of str
        File name endings that mean this format when writing; empty if it must be named.
    writes_folder : bool
        Whether a stereo pair is a folder of files.
    """

    name: str
    module: str
    title: str
    suffixes: tuple[str, ...] = ()
    writes_folder: bool = False


FORMATS: dict[str, CalibrationFormat] = {
    each.name: each
    for each in (
        CalibrationFormat("stereocal", "format_stereocal", "stereocal's own JSON", (".json",)),
        CalibrationFormat("opencv", "format_opencv", "OpenCV FileStorage", (".yml", ".yaml", ".xml")),
        CalibrationFormat("ros", "format_ros", "ROS camera_info", (), writes_folder=True),
        CalibrationFormat("kalibr", "format_kalibr", "Kalibr's camchain"),
        CalibrationFormat("boofcv", "format_boofcv", "BoofCV's YAML"),
        CalibrationFormat("matlab", "format_matlab", "MATLAB's struct", (".mat",)),
        CalibrationFormat("colmap", "format_colmap", "COLMAP's cameras.txt"),
        CalibrationFormat("kitti", "format_kitti", "KITTI's calib.txt"),
        CalibrationFormat("middlebury", "format_middlebury", "Middlebury's calib.txt"),
        CalibrationFormat("mrcal", "format_mrcal", "mrcal's cameramodel", (".cameramodel",), writes_folder=True),
        CalibrationFormat("paper", "format_paper", "the paper's npz", (".npz",)),
    )
}
"""Every format by its name."""


def load_calibration(
    path: str | os.PathLike[str], *, format: str | None = None, camera_pair: str | None = None
) -> StereoRig | Camera:
    """Load a calibration that any of the known tools wrote.

    Parameters
    ----------
    path : str or os.PathLike
        The file, or the folder that holds it.
    format : str, optional
        A name of :data:`FORMATS`; by default the content tells.
    camera_pair : {"0-1", "2-3"}, optional
        Of KITTI's four cameras: the grey ones (default) or those in colour.

    Returns
    -------
    StereoRig or Camera
        In the library's conventions. T is in the file's own unit.

    Raises
    ------
    DataFileError
        If the file is missing, cut short, hostile, or not a calibration.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import stereocal as sc
    >>> camera = sc.Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], None, (640, 480))
    >>> rig = sc.StereoRig(camera, camera, np.eye(3), [-60.0, 0, 0])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = sc.save_calibration(rig, Path(folder) / "rig.json")
    ...     again = sc.load_calibration(Path(folder) / "rig.json")
    >>> again.T
    array([-60.,   0.,   0.])
    """
    return load_record(path, format=format, camera_pair=camera_pair).calibration


def load_record(
    path: str | os.PathLike[str], *, format: str | None = None, camera_pair: str | None = None
) -> CalibrationRecord:
    """Load a calibration with its unit, the file's further fields, and remarks on what changed meaning.

    Parameters
    ----------
    path : str or os.PathLike
        The file, or the folder that holds it.
    format : str, optional
        A name of :data:`FORMATS`; by default the content tells.
    camera_pair : {"0-1", "2-3"}, optional
        Of KITTI's four cameras: the grey ones (default) or those in colour.

    Returns
    -------
    CalibrationRecord

    Raises
    ------
    DataFileError
        If the file is missing, cut short, hostile, or not a calibration.
    """
    source = Path(path)
    name = recognize_format(source) if format is None else require_choice(format, tuple(FORMATS), "format")
    if name == "stereocal" and source.is_dir():
        source = source / "calibration.json"
    if camera_pair is None:
        record: CalibrationRecord = _module(name).read(source)
        return record
    if not hasattr(_module(name), "CAMERA_PAIRS"):
        raise InputError(f"{FORMATS[name].title} holds one pair of cameras; camera_pair is for KITTI's files")
    of_pair: CalibrationRecord = _module(name).read(source, camera_pair)
    return of_pair


def save_calibration(
    calibration: StereoRig | Camera,
    path: str | os.PathLike[str],
    *,
    format: str | None = None,
    unit: str | None = None,
    extra: dict[str, Any] | None = None,
    refit: bool = False,
) -> list[Path]:
    """Save a calibration in the format of any of the known tools.

    Parameters
    ----------
    calibration : StereoRig or Camera
        What to save.
    path : str or os.PathLike
        Where to; a folder for formats of one file a camera.
    format : str, optional
        A name of :data:`FORMATS`; by default from the file's ending.
    unit : {"m", "cm", "mm", "in"}, optional
        The unit of T, for formats that fix one.
    extra : dict, optional
        Further fields (rms, pairs, square_size, covariance …) for formats that can hold them: all of them in our own
        JSON, ``rms`` in OpenCV's.
    refit : bool
        Whether a lens that the format cannot hold is fitted by one that it can (:mod:`~stereocal.store.lens_refit`);
        by default it is refused.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    InputError
        If the format cannot hold this calibration: nothing is dropped.
    DataFileError
        If a file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import stereocal as sc
    >>> camera = sc.Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], None, (640, 480))
    >>> rig = sc.StereoRig(camera, camera, np.eye(3), [-60.0, 0, 0])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = sc.save_calibration(rig, Path(folder) / "rig.json", unit="mm")
    >>> [path.name for path in written]
    ['rig.json']
    """
    target = Path(path)
    name = _format_for_writing(target, format)
    record = CalibrationRecord(calibration, require_unit(unit), dict(extra or {}))
    if refit:
        record, _ = _refitted(record, _module(name))
    files: list[Path] = _module(name).write(record, target)
    return files


def convert_calibration(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    to: str | None = None,
    unit: str | None = None,
    refit: bool = False,
    camera_pair: str | None = None,
) -> list[str]:
    """Convert a calibration file, and name what changes meaning on the way.

    Parameters
    ----------
    source : str or os.PathLike
        A calibration of any known format, or the folder that holds it.
    target : str or os.PathLike
        Where to; a folder for formats of one file a camera.
    to : str, optional
        A name of :data:`FORMATS`; by default from the target's ending.
    unit : {"m", "cm", "mm", "in"}, optional
        The unit of the source's lengths, where its file does not say.
    refit : bool
        Whether a lens that the target cannot hold is fitted by one that it can; by default it is refused.
    camera_pair : {"0-1", "2-3"}, optional
        Of KITTI's four cameras: the grey ones (default) or those in colour.

    Returns
    -------
    list of str
        Sentences: units, half pixels, signs, what the target does not hold and what is derived; of a lens fitted anew,
        how far it is off.

    Raises
    ------
    InputError
        If the target format cannot hold this calibration.
    DataFileError
        If the source cannot be read or the target cannot be written.
    """
    record = load_record(source, camera_pair=camera_pair)
    if unit is not None:
        if record.unit is not None and record.unit != require_unit(unit):
            raise InputError(f"{source} says that its lengths are in {record.unit}, not {unit}")
        record = replace(record, unit=require_unit(unit))
    name = _format_for_writing(Path(target), to)
    module = _module(name)
    refits: list[str] = []
    if refit:
        record, refits = _refitted(record, module)
    sentences = [*record.remarks, *refits, *module.remarks_on_writing(record)]
    if record.extra and name != "stereocal":
        left_out = sorted(set(record.extra) - set(module.EXTRA))
        if left_out:
            words = [f"{key} (beyond K and dist)" if key in ("left", "right", "camera") else key for key in left_out]
            title = FORMATS[name].title
            sentences.append(f"{title[0].upper()}{title[1:]} has no place for: {', '.join(words)}.")
    module.write(record, Path(target))
    return sentences


def recognize_format(path: str | os.PathLike[str]) -> str:
    """Return the name of the format that a file or folder is in, by its content.

    Raises
    ------
    DataFileError
        If it is none that is known.
    """
    source = Path(path)
    if source.is_dir():
        return _recognize_folder(source)
    head = read_bytes(source)[:65536]
    if head[:4] == b"PK\x03\x04":
        return "paper"
    if head[:10] == b"MATLAB 5.0":
        return "matlab"
    text = head.decode("utf-8-sig", "replace").lstrip()
    for mark, name in _MARKS:
        if all(word in text for word in mark):
            return name
    raise DataFileError(source, f"is no calibration that is known; known are {', '.join(FORMATS)}")


_MARKS: tuple[tuple[tuple[str, ...], str], ...] = (
    (("stereocal calibration",), "stereocal"),
    (("opencv_storage",), "opencv"),
    (("opencv-matrix",), "opencv"),
    (("lensmodel", "imagersize"), "mrcal"),
    (("lens_model", "imagersize"), "mrcal"),
    (("distortion_model", "imagersize"), "mrcal"),
    (("cam0:", "camera_model"), "kalibr"),
    (("stereo_camera",), "boofcv"),
    (("pinhole_radial_tangential",), "boofcv"),
    (("distortion_model", "camera_matrix"), "ros"),
    (("rectification_matrix", "projection_matrix"), "ros"),
    (("cam0=", "cam1="), "middlebury"),
    (("RadialDistortion",), "matlab"),
    (("P0:", "P1:"), "kitti"),
    (("P2:", "P3:"), "kitti"),
    (("P_rect_0",), "kitti"),
    (("PINHOLE",), "colmap"),
    (("OPENCV",), "colmap"),
    (("RADIAL",), "colmap"),
)
"""Words that only files of one format hold, the most telling first."""


def _recognize_folder(folder: Path) -> str:
    for file, name in (
        ("calibration.json", "stereocal"),
        ("left.yaml", "ros"),
        ("left.cameramodel", "mrcal"),
        ("intrinsics.yml", "opencv"),
        ("intrinsics.xml", "opencv"),
        ("calibration.yml", "opencv"),
    ):
        if (folder / file).is_file():
            return name
    raise DataFileError(folder, "holds no calibration.json, left.yaml or intrinsics.yml; name the file itself")


def _format_for_writing(target: Path, name: str | None) -> str:
    if name is not None:
        return require_choice(name, tuple(FORMATS), "format")
    for each in FORMATS.values():
        if target.suffix.lower() in each.suffixes:
            return each.name
    raise InputError(f"{target}: the ending does not tell the format; name one of {', '.join(FORMATS)}")


def _refitted(record: CalibrationRecord, module: Any) -> tuple[CalibrationRecord, list[str]]:
    """Replace each lens that the format of `module` cannot hold by the nearest that it can, and say how near."""
    most = getattr(module, "LENS_PARAMETERS", None)
    if most is None:  # our own JSON holds every lens, rectified pairs hold none
        return record, []
    cameras, sentences = [], []
    sides = ("left camera", "right camera") if record.is_stereo else ("camera",)
    for side, camera in zip(sides, record.cameras, strict=True):
        held = module.FISHEYE if camera.model == "fisheye" else camera.model in (*OPENCV_MODELS, "polynomial")
        if held and (camera.model == "fisheye" or parameters_needed(camera) <= most):
            cameras.append(camera)
            continue
        found = refit_lens(camera, most)
        cameras.append(found.camera)
        sentences.append(found.sentence(side, camera))
    if isinstance(record.calibration, StereoRig):
        rig = StereoRig(cameras[0], cameras[1], record.calibration.R, record.calibration.T)
        return replace(record, calibration=rig), sentences
    return replace(record, calibration=cameras[0]), sentences


def _module(name: str) -> Any:
    return importlib.import_module(f"stereocal.store.{FORMATS[name].module}")
