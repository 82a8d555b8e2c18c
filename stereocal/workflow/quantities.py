"""What people type for sizes, lengths and ranges, as numbers.

``7x6`` is a board of 7 inner corners a row and 6 rows; ``25``, ``25mm``, ``2.5cm``, ``1in`` are lengths; ``5:255:2``
is the range of the paper's sweep, both ends included. A length with a unit becomes millimetres, and the results say
so; a length without one stays what it is: everything that is calibrated then comes out in the same unspoken unit.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from stereocal.base.checks import require_positive
from stereocal.base.errors import InputError

MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "inch": 25.4, '"': 25.4}
"""How many millimetres each unit holds."""


@dataclass(frozen=True)
class Length:
    """A length above zero.

    Attributes
    ----------
    value : float
        In millimetres if a unit was named, else in the unit that was not.
    unit : str
        ``"mm"``, or ``""`` if none was named.
    """

    value: float
    unit: str

    def __str__(self) -> str:
        return f"{self.value:g} {self.unit}".strip()


def parse_inner_corners(text: str | tuple[int, int]) -> tuple[int, int]:
    """Return (columns, rows) of ``"7x6"``.

    Raises
    ------
    InputError
        If the text is not two whole numbers with an x between, each at least 2.
    """
    if not isinstance(text, str):
        text = "x".join(str(side) for side in text)
    match = re.fullmatch(r"\s*(\d+)\s*[x×X*,]\s*(\d+)\s*", text)
    if match is None:
        raise InputError(
            f"--inner-corners must be COLUMNSxROWS such as 7x6, not {text!r}; count where four squares meet"
        )
    columns, rows = int(match[1]), int(match[2])
    if min(columns, rows) < 2 or max(columns, rows) > 200:
        raise InputError(f"--inner-corners must be from 2x2 to 200x200, but is {columns}x{rows}")
    return columns, rows


def parse_length(text: str | float, name: str = "--square") -> Length:
    """Return the length that ``"25"``, ``"25mm"``, ``"2.5cm"`` or ``"1in"`` stands for.

    Raises
    ------
    InputError
        If it is no number, has an unknown unit, or is not above zero.
    """
    if not isinstance(text, str):
        return Length(require_positive(text, name), "")
    match = re.fullmatch(r'\s*([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*([a-zA-Z"]*)\s*', text)
    unit = match[2].lower() if match else ""
    try:
        number = float(match[1]) if match else float(text)
    except ValueError as error:
        raise InputError(f"{name} must be a length such as 25, 25mm, 2.5cm or 1in, not {text!r}") from error
    if unit and unit not in MILLIMETRES:
        raise InputError(f"{name} has the unknown unit {unit!r}; use one of mm, cm, m, in")
    number = require_positive(number, name)
    return Length(number * MILLIMETRES[unit], "mm") if unit else Length(number, "")


def parse_range(text: str, name: str) -> tuple[int, ...]:
    """Return the whole numbers of ``"5:255:2"`` (both ends included), ``"5:9"``, ``"21"`` or ``"5,9,21"``.

    Raises
    ------
    InputError
        If the text is none of these, or the range is empty.
    """
    try:
        if ":" in text:
            first, last, *step = (int(part) for part in text.split(":"))
            if len(step) > 1:
                raise ValueError(text)
            numbers = tuple(range(first, last + 1, *step))
        else:
            numbers = tuple(int(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(
            f"{name} must be FIRST:LAST:STEP such as 5:255:2, or numbers such as 5,9,21, not {text!r}"
        ) from error
    if not numbers:
        raise InputError(f"{name} is an empty range: {text!r}")
    return numbers
