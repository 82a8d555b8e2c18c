"""The printed board is true to scale, in every format."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import stereocal as sc
from stereocal.board.printing import PAPERS_MM, lay_out_board, write_board


@given(
    size=st.tuples(st.integers(2, 12), st.integers(2, 12)),
    square=st.floats(2, 80),
    paper=st.sampled_from(sorted(PAPERS_MM)),
)
def test_what_fits_stays_on_the_page_and_what_does_not_is_told_what_would(size, square, paper):
    try:
        sheet = lay_out_board(size, square, paper)
    except sc.InputError as error:
        largest = float(re.search(r"is ([\d.]+) mm$", str(error)).group(1))
        assert largest < square
        if largest > 0:
            lay_out_board(size, largest, paper)
        return
    corners = np.array(sheet.dark_squares)
    assert corners.min() >= 5
    assert np.all(corners.max(axis=0) + square <= np.array(sheet.page) - 5)
    assert len(corners) == ((size[0] + 1) * (size[1] + 1) + 1) // 2
    assert tuple(sheet.dark_squares[0]) == sheet.origin, "the first square is dark"


def test_svg_and_pdf_hold_the_squares_in_millimetres(tmp_path):
    sheet = write_board(tmp_path / "b.svg", (7, 6), 25.0)
    rects = re.findall(
        r'<rect x="([\d.]+)" y="([\d.]+)" width="25.0000" height="25.0000"/>', (tmp_path / "b.svg").read_text()
    )
    np.testing.assert_allclose(np.array(rects, float), sheet.dark_squares, atol=1e-4)
    assert 'width="297mm" height="210mm"' in (tmp_path / "b.svg").read_text()
    write_board(tmp_path / "b.pdf", (7, 6), 25.0)
    text = (tmp_path / "b.pdf").read_bytes().decode("latin-1")
    rects = np.array(re.findall(r"([\d.]+) ([\d.]+) 25.0000 25.0000 re", text), float)
    np.testing.assert_allclose(np.column_stack([rects[:, 0], 210 - rects[:, 1] - 25]), sheet.dark_squares, atol=1e-4)
    assert "/MediaBox [0 0 841.8898 595.2756]" in text
    start = int(re.search(r"startxref\n(\d+)", text).group(1))
    assert text[start:].startswith("xref"), "readers find the table of objects"
    for number, offset in enumerate(re.findall(r"(\d{10}) 00000 n", text), start=1):
        assert text[int(offset) :].startswith(f"{number} 0 obj")


def test_png_is_found_by_the_detector_at_its_true_size(tmp_path):
    sheet = write_board(tmp_path / "b.png", sc.Chessboard((7, 6)), 25.0, dpi=100)
    image = Image.open(io.BytesIO((tmp_path / "b.png").read_bytes()))
    assert image.info["dpi"] == pytest.approx((100, 100), abs=0.1)
    corners = sc.detect_chessboard(np.asarray(image), (7, 6))
    j, i = np.divmod(np.arange(42), 7)
    expected = (np.array(sheet.origin) + 25.0 * np.column_stack([i + 1, j + 1])) * 100 / 25.4 - 0.5
    np.testing.assert_allclose(corners, expected, atol=0.6)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ((("7x6"), 25, "A4"), "inner_corners"),
        (((7, 6), 0, "A4"), "square_mm"),
        (((7, 6), 25, "A9"), "paper"),
        (((7, 6), 60, "A4"), "25.6 mm"),
    ],
)
def test_errors_say_what_to_do(arguments, word):
    with pytest.raises(sc.InputError, match=word):
        lay_out_board(*arguments)


def test_unknown_ending(tmp_path):
    with pytest.raises(sc.InputError, match=r"\.pdf, \.svg or \.png"):
        write_board(tmp_path / "board.tif", (7, 6), 25)
