"""``convert``: between calibration formats, naming what changes its meaning on the way."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereocal.store.calibrations import convert_calibration, recognize_format


@dataclass(frozen=True)
class ConversionRun:
    """What ``convert`` did.

    Attributes
    ----------
    source, target : Path
        From and to.
    format : str
        What the source was found to be.
    remarks : tuple of str
        Units, half pixels, signs; what the target does not hold.
    """

    source: Path
    target: Path
    format: str
    remarks: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return what ``convert --json`` prints."""
        return {
            "source": str(self.source),
            "target": str(self.target),
            "format": self.format,
            "remarks": list(self.remarks),
        }


def run_conversion(
    source: str | os.PathLike[str],
    target: str | os.PathLike[str],
    *,
    to: str | None = None,
    unit: str | None = None,
    refit: bool = False,
    camera_pair: str | None = None,
) -> ConversionRun:
    """Convert a calibration file.

    Parameters
    ----------
    source : path
        A calibration in any known format, or the folder that holds it.
    target : path
        Where to.
    to : str, optional
        The format's name; by default from the target's ending.
    unit : {"m", "cm", "mm", "in"}, optional
        The unit of the source's lengths, where its file does not say.
    refit : bool
        Whether a lens that the target cannot hold is fitted by one that it can.
    camera_pair : {"0-1", "2-3"}, optional
        Of KITTI's four cameras.

    Raises
    ------
    InputError
        If the target format cannot hold this calibration: nothing is dropped silently.
    DataFileError
        If the source cannot be read, or the target cannot be written.
    """
    found = recognize_format(source)
    remarks = convert_calibration(source, target, to=to, unit=unit, refit=refit, camera_pair=camera_pair)
    return ConversionRun(Path(source), Path(target), found, tuple(remarks))
