"""Verdicts, and the blocks of the report that hold them.

A figure alone does not answer "is it good?". A :class:`Verdict` is a figure with all that a reader needs to judge it:
what it measures, the threshold, whose threshold that is, and, when it is not good, the likely cause and what to do
next. A :class:`Block` is one section of the report: its verdicts, tables of plain figures, and pictures that are
drawn only when somebody looks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from stereocal.report.thresholds import THRESHOLDS, Threshold

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Grade = Literal["good", "usable", "bad"]

_ORDER = {"good": 0, "usable": 1, "bad": 2}


@dataclass(frozen=True)
class Verdict:
    """One figure, judged.

    Attributes
    ----------
    block : str
        The section of the report: ``data``, ``fit``, ``parameters``, ``generalisation``, ``epipolar``, ``metric``,
        ``depth`` or ``disparity``.
    name : str
        What is judged, in a few words.
    value : float
        The figure.
    unit : str
        Its unit, ``""`` for a ratio.
    verdict : {"good", "usable", "bad"}
    threshold : str
        The limits, spelt out.
    source : str
        Whose limits they are.
    meaning : str
        What the figure measures, in one sentence.
    cause, action : str
        Likely cause and next action in plain words; empty when the verdict is good.
    decides : bool
        Whether the verdict on the whole calibration follows it. Advice about photographs does not: a calibration from
        a lopsided set of views that nevertheless determines every parameter is a good calibration.
    """

    block: str
    name: str
    value: float
    unit: str
    verdict: Grade
    threshold: str
    source: str
    meaning: str
    cause: str = ""
    action: str = ""
    decides: bool = True

    @property
    def spelt_value(self) -> str:
        """The figure with its unit, to three or four significant digits."""
        return spell(self.value, self.unit)


def spell(value: float, unit: str = "") -> str:
    """A number as a reader wants it: ``0.392 px``, ``12 views``, ``85 %``."""
    if value is None or not math.isfinite(value):
        return "unknown"
    if float(value).is_integer() and abs(value) < 1e6:
        text = f"{int(value)}"
    else:
        digits = max(0, 3 - (math.floor(math.log10(abs(value))) + 1)) if value else 0
        text = f"{value:.{min(digits, 6)}f}"
    return f"{text} {unit}".strip()


def judge(
    block: str,
    key: str,
    value: float,
    meaning: str,
    *,
    name: str = "",
    cause: str = "",
    action: str = "",
    at_worst: Grade = "bad",
    decides: bool = True,
) -> Verdict:
    """Judge a figure by the threshold of `key`.

    Parameters
    ----------
    block : str
        The report's section.
    key : str
        A key of :data:`~stereocal.report.thresholds.THRESHOLDS`.
    value : float
        The figure; NaN is bad, for what could not be measured has not been shown.
    meaning : str
        What it measures.
    name : str
        Instead of the threshold's own name.
    cause, action : str
        Kept only if the verdict is not good.
    at_worst : {"good", "usable", "bad"}
        The hardest verdict that this figure may give alone.
    decides : bool
        Whether the verdict on the whole follows it.

    Returns
    -------
    Verdict
    """
    threshold: Threshold = THRESHOLDS[key]
    grade = min(threshold.grade(value), at_worst, key=_ORDER.__getitem__)
    fine = grade == "good"
    return Verdict(
        block, name or threshold.name, float(value), threshold.unit, grade, threshold.spelt, threshold.source, meaning,
        "" if fine else cause, "" if fine else action, decides,
    )  # fmt: skip


def worst(grades: Sequence[Grade]) -> Grade:
    """The worst of some grades; good if there are none."""
    return max(grades, key=_ORDER.__getitem__, default="good")


@dataclass(frozen=True)
class Picture:
    """A picture that is drawn when somebody looks.

    Attributes
    ----------
    name : str
        File name without its ending.
    caption : str
        One or two sentences: what is seen, and what to look for.
    draw : callable
        Returns the figure.
    wide : bool
        Whether it takes the whole width of the page.
    """

    name: str
    caption: str
    draw: Callable[[], Figure]
    wide: bool = False


@dataclass(frozen=True)
class Table:
    """A table of figures: header cells, and rows of cells, already spelt."""

    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    folded: bool = False


@dataclass(frozen=True)
class Block:
    """One section of the report.

    Attributes
    ----------
    key : str
        The name that verdicts carry.
    title : str
        The heading.
    lead : str
        The section's finding in one or two sentences.
    verdicts : tuple of Verdict
    facts : mapping
        Every figure of the section by name, as it goes to ``report.json``.
    tables : tuple of Table
    pictures : tuple of Picture
    thumbnails : tuple
        Small photographs with corners, made by the data block.
    """

    key: str
    title: str
    lead: str
    verdicts: tuple[Verdict, ...] = ()
    facts: Mapping[str, Any] = field(default_factory=dict)
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()
    thumbnails: tuple[Any, ...] = ()

    @property
    def verdict(self) -> Grade:
        """The worst verdict of the section."""
        return worst([v.verdict for v in self.verdicts])
