"""A chessboard on paper, true to scale, with the means to check that it is.

A printer that "fits to page" shrinks a board by a few per cent, and every length measured with it is wrong by as
much, with no trace in the residuals. So the sheet bears its size in words and a scale bar to lay a ruler on.

The geometry is computed once, in millimetres from the page's upper left corner, y down; three writers put it on a
page: SVG and PDF as rectangles, exact to 1e-4 mm, PNG as pixels, edges rounded to the nearest one (0.02 mm at 600
dpi). Around the squares stays a *quiet zone* of white, without which the outer squares merge with what the sheet lies
on.

The first square, at the upper left, is dark: the corner beside it is the board's first
(:mod:`stereocal.board.chessboard`).
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import require_positive
from stereocal.base.errors import InputError
from stereocal.board.chessboard import Chessboard, as_inner_corners

PAPERS_MM = {
    "A0": (841.0, 1189.0),
    "A1": (594.0, 841.0),
    "A2": (420.0, 594.0),
    "A3": (297.0, 420.0),
    "A4": (210.0, 297.0),
    "A5": (148.0, 210.0),
    "A6": (105.0, 148.0),
    "LETTER": (215.9, 279.4),
    "LEGAL": (215.9, 355.6),
    "TABLOID": (279.4, 431.8),
}
"""Width and height of papers in portrait, mm (ISO 216; ANSI)."""

_UNPRINTABLE = 5.0  # mm at the page's edge that printers leave white
_CAPTION = 8.0  # mm for the scale bar and the text under the quiet zone
_QUIET_SHARE, _QUIET_LEAST = 0.25, 5.0  # quiet zone: this share of a square, and at least so many mm


@dataclass(frozen=True)
class BoardSheet:
    """A board laid out on a page; all lengths in mm from the page's upper left corner.

    Attributes
    ----------
    board : Chessboard
        Square size in mm.
    page : tuple of float
        (width, height).
    origin : tuple of float
        Upper left corner of the first square.
    scale_bar : tuple of float
        (x, y, length) of the bar's left end.
    caption : str
        Size and number of squares, in words.
    """

    board: Chessboard
    page: tuple[float, float]
    origin: tuple[float, float]
    scale_bar: tuple[float, float, float]
    caption: str

    @property
    def dark_squares(self) -> list[tuple[float, float]]:
        """Upper left corners of the dark squares, row by row."""
        side = self.board.square_size
        return [
            (self.origin[0] + p * side, self.origin[1] + q * side)
            for q in range(self.board.rows + 1)
            for p in range(self.board.columns + 1)
            if (p + q) % 2 == 0
        ]


def lay_out_board(board: Chessboard | tuple[int, int], square_mm: float, paper: str = "A4") -> BoardSheet:
    """Place a board in the middle of a page, upright or turned, whichever fits.

    Parameters
    ----------
    board : Chessboard or (columns, rows)
        Only its inner corners are used.
    square_mm : float
        Side of a square.
    paper : str
        A0 to A6, letter, legal, tabloid.

    Returns
    -------
    BoardSheet

    Raises
    ------
    InputError
        If the paper is not known, or the board does not fit; the message names the largest square that does.
    """
    inner = board.inner_corners if isinstance(board, Chessboard) else as_inner_corners(board)
    square = require_positive(square_mm, "square_mm")
    portrait = PAPERS_MM.get(str(paper).upper())
    if portrait is None:
        raise InputError(f"paper must be one of {', '.join(PAPERS_MM)}, not {paper!r}")
    pages = (portrait, portrait[::-1])
    fitting = max(pages, key=lambda page: _largest_square(inner, page))
    # a page in portrait is what a printer expects: turn it only if the board needs it
    page = portrait if _largest_square(inner, portrait) >= square else fitting
    largest = _largest_square(inner, page)
    if square > largest + 1e-9:
        raise InputError(
            f"a board of {inner[0] + 1}x{inner[1] + 1} squares of {square:g} mm does not fit on {paper}; "
            f"the largest square that does is {math.floor(10 * largest) / 10:g} mm"
        )
    across, down = (inner[0] + 1) * square, (inner[1] + 1) * square
    origin = ((page[0] - across) / 2, (page[1] - _CAPTION - down) / 2)
    bar = 100.0 if across >= 100 else 50.0 if across >= 50 else 10.0
    baseline = page[1] - _UNPRINTABLE - 2.0
    caption = f"{inner[0]}x{inner[1]} inner corners, squares of {square:g} mm. The bar is {bar:g} mm: measure it."
    return BoardSheet(Chessboard(inner, square), page, origin, (origin[0], baseline, bar), caption)


def _largest_square(inner: tuple[int, int], page: tuple[float, float]) -> float:
    """Largest square in mm: (n + 1) squares and two quiet zones fill the printable part of the page."""
    sides = []
    for corners, length in zip(inner, (page[0] - 2 * _UNPRINTABLE, page[1] - 2 * _UNPRINTABLE - _CAPTION), strict=True):
        by_share = length / (corners + 1 + 2 * _QUIET_SHARE)
        by_least = (length - 2 * _QUIET_LEAST) / (corners + 1)
        sides.append(min(by_share, by_least))
    return min(sides)


def write_board(
    path: str | os.PathLike[str],
    board: Chessboard | tuple[int, int],
    square_mm: float,
    paper: str = "A4",
    *,
    dpi: int = 600,
) -> BoardSheet:
    """Write a printable board, true to scale.

    Parameters
    ----------
    path : str or os.PathLike
        Ends in .pdf, .svg or .png.
    board : Chessboard or (columns, rows)
        Only its inner corners are used.
    square_mm : float
        Side of a square.
    paper : str
        A0 to A6, letter, legal, tabloid.
    dpi : int
        Pixels per inch of a PNG.

    Returns
    -------
    BoardSheet
        What was written.

    Raises
    ------
    InputError
        If the board does not fit the paper (the message names the largest square that does), or the ending is unknown.
    DataFileError
        If the file cannot be written.
    """
    sheet = lay_out_board(board, square_mm, paper)
    writers = {".svg": _as_svg, ".pdf": _as_pdf, ".png": lambda s: _as_png(s, dpi)}
    ending = Path(path).suffix.lower()
    if ending not in writers:
        raise InputError(f"the file's name must end in .pdf, .svg or .png, not {ending or 'nothing'!r}")
    write_whole(path, writers[ending](sheet))
    return sheet


def _as_svg(sheet: BoardSheet) -> bytes:
    width, height = sheet.page
    side = sheet.board.square_size
    x, y, bar = sheet.scale_bar
    squares = "\n".join(
        f'<rect x="{a:.4f}" y="{b:.4f}" width="{side:.4f}" height="{side:.4f}"/>' for a, b in sheet.dark_squares
    )
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">\n<rect width="{width:g}" height="{height:g}" fill="white"/>\n'
        f'<g fill="black" shape-rendering="crispEdges">\n{squares}\n</g>\n'
        f'<path d="M{x:.4f} {y - 2:.4f}v2h{bar:g}v-2" fill="none" stroke="black" stroke-width="0.2"/>\n'
        f'<text x="{x + bar + 3:.4f}" y="{y:.4f}" font-family="Helvetica, Arial, sans-serif" font-size="3">'
        f"{sheet.caption}</text>\n</svg>\n"
    )
    return text.encode()


def _as_pdf(sheet: BoardSheet) -> bytes:
    """A PDF of one page, written by hand: five objects, y upwards, 72 points an inch."""
    point = 72 / 25.4
    width, height = sheet.page
    side = sheet.board.square_size
    x, y, bar = sheet.scale_bar
    marks = [f"{point:.8f} 0 0 {point:.8f} 0 0 cm", "0 g"]
    marks += [f"{a:.4f} {height - b - side:.4f} {side:.4f} {side:.4f} re" for a, b in sheet.dark_squares]
    marks += ["f", f"0.2 w {x:.4f} {height - y + 2:.4f} m {x:.4f} {height - y:.4f} l"]
    marks += [f"{x + bar:.4f} {height - y:.4f} l {x + bar:.4f} {height - y + 2:.4f} l S"]
    marks += [f"BT /F1 3 Tf {x + bar + 3:.4f} {height - y:.4f} Td ({sheet.caption}) Tj ET"]
    content = "\n".join(marks)
    bodies = [
        "<< /Type /Catalog /Pages 2 0 R >>",
        "<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width * point:.4f} {height * point:.4f}] "
        "/Resources << /Font << /F1 5 0 R >> >> /Contents 4 0 R >>",
        f"<< /Length {len(content)} >>\nstream\n{content}\nendstream",
        "<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ]
    document, offsets = b"%PDF-1.4\n", []
    for number, body in enumerate(bodies, start=1):
        offsets.append(len(document))
        document += f"{number} 0 obj\n{body}\nendobj\n".encode()
    table = "".join(f"{offset:010d} 00000 n \n" for offset in offsets)
    trailer = f"trailer\n<< /Size {len(bodies) + 1} /Root 1 0 R >>\nstartxref\n{len(document)}\n%%EOF\n"
    return document + f"xref\n0 {len(bodies) + 1}\n0000000000 65535 f \n{table}{trailer}".encode()


def _as_png(sheet: BoardSheet, dpi: int) -> bytes:
    from PIL import Image, ImageDraw, ImageFont

    pixel = dpi / 25.4
    page = Image.new("L", (round(sheet.page[0] * pixel), round(sheet.page[1] * pixel)), 255)
    draw = ImageDraw.Draw(page)
    side = sheet.board.square_size
    for a, b in sheet.dark_squares:
        # Pillow includes the last pixel
        box = [round(a * pixel), round(b * pixel), round((a + side) * pixel) - 1, round((b + side) * pixel) - 1]
        draw.rectangle(box, fill=0)
    x, y, bar = sheet.scale_bar
    left, right, line, top = (round(v * pixel) for v in (x, x + bar, y, y - 2))
    draw.line([(left, top), (left, line), (right, line), (right, top)], fill=0, width=max(1, round(0.2 * pixel)))
    font = ImageFont.load_default(size=3 * pixel)
    draw.text(((x + bar + 3) * pixel, y * pixel), sheet.caption, fill=0, font=font, anchor="ls")
    stream = BytesIO()
    page.save(stream, "PNG", dpi=(dpi, dpi))
    return stream.getvalue()
