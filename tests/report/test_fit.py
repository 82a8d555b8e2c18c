from __future__ import annotations

import numpy as np
import pytest
from report_cases import SIZE, make_case

from stereocal.report.fit import outlying_views, pattern_over_image, radial_trend, rms_conventions


def test_conventions_of_gaussian_noise() -> None:
    d = np.random.default_rng(0).normal(0, 0.1, (200_000, 2))
    c = rms_conventions(d)
    assert c["opencv"] == pytest.approx(0.1 * np.sqrt(2), rel=0.01)
    assert c["per_axis"] == pytest.approx(0.1, rel=0.01)
    assert c["mean_distance"] == pytest.approx(0.1 * np.sqrt(np.pi / 2), rel=0.01)
    assert c["opencv"] == pytest.approx(c["per_axis"] * np.sqrt(2))


def test_noise_has_no_pattern_and_a_pattern_is_measured() -> None:
    random = np.random.default_rng(1)
    points = random.uniform((0, 0), SIZE, (3000, 2))
    noise = random.normal(0, 0.1, (3000, 2))
    assert pattern_over_image(points, noise, SIZE) < 0.15
    wave = 0.1 * np.stack([np.sin(points[:, 0] / 90), np.cos(points[:, 1] / 90)], axis=1)
    whole = pattern_over_image(points, noise + wave, SIZE)
    # σ of noise and wave together; the wave's own RMS an axis is 0.1/√2
    expected = (0.1 / np.sqrt(2)) / np.sqrt(0.1**2 + 0.1**2 / 2)
    assert whole == pytest.approx(expected, rel=0.15)


def test_a_radial_trend_is_measured() -> None:
    random = np.random.default_rng(2)
    radius = random.uniform(0, 300, 2000)
    radial = random.normal(0, 0.1, 2000)
    assert radial_trend(radius, radial) < 0.15
    assert radial_trend(radius, radial + 0.1 * np.sign(radius - 150)) > 0.5


def test_one_bad_view_is_named() -> None:
    rms = np.array([0.10, 0.11, 0.12, 0.10, 0.11, 0.5, 0.12])
    assert outlying_views(rms) == [5]
    assert outlying_views(np.full(8, 0.1)) == []


def test_the_noise_estimate_is_honest() -> None:
    estimates = [make_case(seed=s, views=10, noise=0.1).evidence.noise for s in range(5)]
    assert np.mean(estimates) == pytest.approx(0.1, rel=0.02)
