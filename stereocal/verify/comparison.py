"""What a crosscheck says of one step, and of all of them together.

Each step gives ONE number, in the unit that matters to a user (pixels, millimetres, grey levels), the tolerance below
which the two libraries count as agreeing, and where that tolerance comes from. Where they part, the step says who is
nearer the truth if there is a way to know it without trusting either (a lower cost of the same sum, a point that maps
back to where it came from), and why.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np


@dataclass(frozen=True)
class StepComparison:
    """One step of the pipeline, by stereocal and by OpenCV.

    Attributes
    ----------
    step : str
        What was computed.
    difference : float
        The largest difference between the two, in `unit`; NaN where the step could not be compared.
    unit : str
        Of difference and tolerance.
    tolerance : float
        The difference below which they agree.
    tolerance_source : str
        Why it is that.
    nearer : str
        Who is nearer the truth: ``"stereocal"``, ``"opencv"``, ``"equal"`` or ``"unknown"``.
    finding : str
        A sentence: what was seen, and why they part if they do.
    figures : mapping of str to float
        The numbers behind it.
    """

    step: str
    difference: float
    unit: str
    tolerance: float
    tolerance_source: str
    nearer: str
    finding: str
    figures: Mapping[str, float] = field(default_factory=dict)

    @property
    def agrees(self) -> bool:
        """Whether the difference is within the tolerance."""
        return bool(self.difference <= self.tolerance)

    @property
    def compared(self) -> bool:
        """Whether both libraries could do the step."""
        return bool(np.isfinite(self.difference))


@dataclass(frozen=True)
class CrosscheckReport:
    """What :func:`stereocal.verify.second_opinion.crosscheck` found.

    Attributes
    ----------
    opencv_version : str
        Of the oracle.
    steps : tuple of StepComparison
        In the order of the pipeline.
    """

    opencv_version: str
    steps: tuple[StepComparison, ...]

    @property
    def parted(self) -> tuple[StepComparison, ...]:
        """The steps where the two libraries differ by more than the tolerance."""
        return tuple(step for step in self.steps if step.compared and not step.agrees)

    def summary(self) -> str:
        """One sentence: how many steps agree, and who is nearer the truth where they do not."""
        compared = [step for step in self.steps if step.compared]
        agreeing = sum(step.agrees for step in compared)
        text = f"{agreeing} of {len(compared)} steps agree with OpenCV {self.opencv_version} within their tolerance"
        if not self.parted:
            return text + "."
        nearer = [sum(step.nearer == who for step in self.parted) for who in ("stereocal", "opencv")]
        unknown = len(self.parted) - sum(nearer)
        counted = zip((*nearer, unknown), ("stereocal", "OpenCV", "cannot be known here"), strict=True)
        return text + "; nearer the truth where they part: " + ", ".join(f"{who} {n}" for n, who in counted if n) + "."

    def to_document(self) -> dict[str, Any]:
        """Return plain data for JSON; a step that could not be compared has a difference of null."""
        steps = []
        for step in self.steps:
            entry = asdict(step) | {"agrees": step.agrees, "figures": dict(step.figures)}
            entry["difference"] = step.difference if step.compared else None
            steps.append(entry)
        return {"opencv_version": self.opencv_version, "summary": self.summary(), "steps": steps}


def not_compared(step: str, why: str) -> StepComparison:
    """Build the entry of a step that one of the two cannot do, with the reason."""
    return StepComparison(step, float("nan"), "", float("nan"), "", "unknown", why)
