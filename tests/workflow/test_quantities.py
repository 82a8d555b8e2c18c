"""What people type for sizes, lengths and ranges."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stereocal.base.errors import InputError
from stereocal.workflow.quantities import Length, parse_inner_corners, parse_length, parse_range


@given(st.integers(2, 200), st.integers(2, 200), st.sampled_from("x×X*,"))
def test_inner_corners_are_columns_and_rows(columns: int, rows: int, cross: str) -> None:
    assert parse_inner_corners(f"{columns}{cross}{rows}") == (columns, rows)
    assert parse_inner_corners((columns, rows)) == (columns, rows)


@pytest.mark.parametrize("text", ["7", "7x", "x6", "7x6x5", "seven by six", "-7x6", "1x6", "7x201", "7.5x6", ""])
def test_other_words_are_no_inner_corners(text: str) -> None:
    with pytest.raises(InputError, match="--inner-corners must be"):
        parse_inner_corners(text)


@pytest.mark.parametrize(
    ("text", "value", "unit"),
    [
        ("25", 25.0, ""),
        ("25mm", 25.0, "mm"),
        ("2.5cm", 25.0, "mm"),
        (" 0.025 m ", 25.0, "mm"),
        ("1in", 25.4, "mm"),
        ("1e-3", 1e-3, ""),
        (2.5, 2.5, ""),
    ],
)
def test_a_length_with_a_unit_is_in_millimetres(text: str | float, value: float, unit: str) -> None:
    length = parse_length(text)
    assert length.unit == unit
    assert length.value == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("text", ["0", "-25mm", "25 parsec", "mm", "", "nan", "inf", "1.2.3", "25mm2", 0.0, -1.0])
def test_other_words_are_no_length(text: str | float) -> None:
    with pytest.raises(InputError, match="--square"):
        parse_length(text)


def test_a_length_reads_as_it_is_spoken() -> None:
    assert str(Length(25.0, "mm")) == "25 mm"
    assert str(Length(1.0, "")) == "1"


@given(st.integers(-50, 50), st.integers(0, 50), st.integers(1, 9))
def test_a_range_holds_both_ends(first: int, length: int, step: int) -> None:
    numbers = parse_range(f"{first}:{first + length * step}:{step}", "--blocks")
    assert numbers[0] == first
    assert numbers[-1] == first + length * step
    assert len(numbers) == length + 1


def test_the_papers_ranges() -> None:
    assert len(parse_range("5:255:2", "--blocks")) == 126
    assert len(parse_range("50:200:10", "--speckles")) == 16
    assert parse_range("5,9,21", "--blocks") == (5, 9, 21)


@pytest.mark.parametrize("text", ["", "5:", "9:5", "a:b", "1:2:3:4", "5:9:0", "1.5"])
def test_other_words_are_no_range(text: str) -> None:
    with pytest.raises(InputError, match="--blocks"):
        parse_range(text, "--blocks")
