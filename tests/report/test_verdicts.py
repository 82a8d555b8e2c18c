from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stereocal.report.thresholds import THRESHOLDS
from stereocal.report.verdicts import judge, spell, worst


@pytest.mark.parametrize("key", sorted(THRESHOLDS))
def test_every_threshold_is_ordered_and_names_its_source(key: str) -> None:
    t = THRESHOLDS[key]
    assert (t.good >= t.usable) if t.higher_is_better else (t.good <= t.usable)
    assert len(t.source) > 3
    assert t.grade(t.good) == "good"
    assert t.grade(t.usable) in ("good", "usable")
    beyond = t.usable - 1 if t.higher_is_better else t.usable + 1
    assert t.grade(beyond) == "bad"
    assert t.grade(math.nan) == "bad", "what could not be measured has not been shown"


def test_a_good_verdict_asks_for_nothing() -> None:
    good = judge("fit", "joint_mono", 1.0, "m", cause="c", action="a")
    assert (good.verdict, good.cause, good.action) == ("good", "", "")
    bad = judge("fit", "joint_mono", 9.0, "m", cause="c", action="a")
    assert (bad.verdict, bad.cause, bad.action) == ("bad", "c", "a")
    assert judge("fit", "joint_mono", 9.0, "m", at_worst="usable").verdict == "usable"


def test_worst() -> None:
    assert worst([]) == "good"
    assert worst(["good", "usable"]) == "usable"
    assert worst(["usable", "bad", "good"]) == "bad"


@given(st.floats(min_value=1e-6, max_value=1e9))
def test_a_spelt_number_is_the_number_to_three_digits(value: float) -> None:
    assert float(spell(value)) == pytest.approx(value, rel=5e-3, abs=5e-7)


def test_spelling() -> None:
    assert spell(12, "pairs") == "12 pairs"
    assert spell(0.39153, "px") == "0.392 px"
    assert spell(math.nan, "px") == "unknown"
