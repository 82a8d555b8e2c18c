"""The target: a flat chessboard, known to the printer's accuracy.

A board of (C + 1) x (R + 1) squares has C x R *inner corners*, the points where four squares meet. They are what is
measured: each is a saddle of the brightness, fixed by two crossing edges, and stays where it is when the picture is
blurred or the light changes, which the board's outer corners do not.

The board's own frame has its origin in the first inner corner, x along the rows, y along the columns, z = 0 on the
paper. Corner (i, j), i = 0..C-1, j = 0..R-1, stands at square_size * (i, j, 0) and has the number i + C*j: row by row,
x fastest, as OpenCV has it.

**Which corner is the first?** The convention of this library makes it a function of the board, not of its attitude:

- seen from its printed side the frame is right-handed with z into the board: going from x to y turns clockwise on the
  image (from the x axis to the y axis of the pixels);
- the square diagonally outside the first corner is dark.

Turning the board by 180 degrees takes square (p, q) to (C - p, R - q), and a square's colour is the parity of p + q. So
the turn changes the colours if C + R is odd: then the rule singles one corner out. If C + R is even, the board looks
the same after half a turn; no detector can tell one end from the other in one picture, and the pair has to decide
(:mod:`stereocal.pair.corner_order`). If besides C = R and both are even, the same holds for a quarter turn.

Source: the parity argument is folklore; Geiger et al., *Automatic camera and range sensor calibration using a single
shot*, ICRA 2012, use boards of odd and even side for this reason.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stereocal.base.checks import Float, require_integer, require_positive
from stereocal.base.errors import InputError


@dataclass(frozen=True)
class Chessboard:
    """A chessboard target: how many inner corners, and how large a square is.

    Parameters
    ----------
    inner_corners : tuple of int
        (columns, rows) of inner corners, each at least 2: a board of 8 x 7 squares has (7, 6).
    square_size : float
        Side of a square, in the unit that all lengths shall have (mm, m, squares).

    Raises
    ------
    InputError
        If a count is not a whole number of at least 2, or the square size is not above 0.

    Examples
    --------
    >>> Chessboard((7, 6), 25.0).object_points.shape
    (42, 3)
    """

    inner_corners: tuple[int, int] = (7, 6)
    square_size: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "inner_corners", as_inner_corners(self.inner_corners))
        object.__setattr__(self, "square_size", require_positive(self.square_size, "square_size"))

    @property
    def columns(self) -> int:
        """C, inner corners in a row."""
        return self.inner_corners[0]

    @property
    def rows(self) -> int:
        """R, rows of inner corners."""
        return self.inner_corners[1]

    @property
    def corner_count(self) -> int:
        """C * R."""
        return self.columns * self.rows

    @property
    def object_points(self) -> Float:
        """The corners in the board's frame, (C*R, 3): square_size * (i, j, 0), row by row, x fastest."""
        j, i = np.divmod(np.arange(self.corner_count), self.columns)
        return self.square_size * np.column_stack([i, j, np.zeros(self.corner_count)]).astype(np.float64)

    @property
    def is_symmetric(self) -> bool:
        """Whether the board looks the same after half a turn: C + R is even."""
        return (self.columns + self.rows) % 2 == 0

    def __str__(self) -> str:
        return f"{self.columns}x{self.rows}"


def as_inner_corners(value: Any) -> tuple[int, int]:
    """Return (columns, rows) as two ints of at least 2.

    Raises
    ------
    InputError
        If `value` is not such a pair.
    """
    try:
        columns, rows = value
    except (TypeError, ValueError) as error:
        raise InputError(f"inner_corners must be (columns, rows), such as (7, 6), not {value!r}") from error
    return (
        require_integer(columns, "inner_corners: columns", minimum=2),
        require_integer(rows, "inner_corners: rows", minimum=2),
    )
