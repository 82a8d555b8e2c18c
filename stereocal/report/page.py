"""The page: one HTML file that opens offline, reads on a phone and prints; and the same figures as JSON.

Everything is inside the file: style, photographs (JPEG) and figures (PNG), as data URIs. There is no
script and no link to a server, so that it can be mailed, archived, and opened in ten years.
"""

from __future__ import annotations

import base64
import json
import math
import os
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.report.style import VERDICT_COLOURS
from stereocal.report.verdicts import Verdict

if TYPE_CHECKING:
    from stereocal.report.quality import QualityReport

_SENTENCES = {
    "good": "This calibration is good: every figure that decides is within its limit.",
    "usable": "This calibration is usable, with reservations; they stand below.",
    "bad": "Do not use this calibration yet: what is wrong stands below, with what to do about it.",
}


def report_document(report: QualityReport) -> dict[str, Any]:
    """The report as plain data: what is unknown or infinite is None."""
    from stereocal import __version__

    document = {
        "stereocal": __version__,
        "title": report.title,
        "verdict": report.overall,
        "unit": report.unit,
        "verdicts": [_verdict_document(v) for v in report.verdicts],
        "blocks": {block.key: dict(block.facts) for block in report.blocks},
    }
    return dict(_plain(document))


def _verdict_document(verdict: Verdict) -> dict[str, Any]:
    return {name: getattr(verdict, name) for name in Verdict.__dataclass_fields__}


def _plain(value: Any) -> Any:
    """Numbers and containers that JSON has: NaN and infinity become None."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def write_document(report: QualityReport, path: str | os.PathLike[str]) -> Path:
    """Write the report as JSON, whole or not at all."""
    return write_whole(path, json.dumps(report_document(report), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def write_page(report: QualityReport, path: str | os.PathLike[str]) -> Path:
    """Write the report as one self-contained HTML file, whole or not at all."""
    return write_whole(path, render_page(report))


def render_page(report: QualityReport) -> str:
    """Render the report as HTML.

    Parameters
    ----------
    report : QualityReport

    Returns
    -------
    str
    """
    import jinja2

    from stereocal import __version__

    templates = resources.files("stereocal.report") / "templates"
    environment = jinja2.Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    template = environment.from_string((templates / "report.html").read_text(encoding="utf-8"))
    embed = {name: _data_uri("image/png", data) for name, data in report.png.items()}
    return template.render(
        report=report,
        sentence=_SENTENCES[report.overall],
        style=(templates / "report.css").read_text(encoding="utf-8"),
        colours=VERDICT_COLOURS,
        embed=embed,
        jpeg=lambda data: _data_uri("image/jpeg", data),
        version=__version__,
    )


def _data_uri(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
