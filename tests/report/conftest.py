"""Calibrations made once for the room."""

from __future__ import annotations

import pytest
from report_cases import Case, make_case


@pytest.fixture(scope="session")
def healthy() -> Case:
    """Sixteen tilted views, a flat board, 0.1 px of noise."""
    return make_case()


@pytest.fixture(scope="session")
def bent() -> Case:
    """The same with a board that bows by 0.15 of a square."""
    return make_case(bow=0.15 * 25.0)
