"""Rectification without calibration."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from strategies import seeds
from two_view_scenes import K, two_views

from stereocal.base.errors import DegenerateGeometryError
from stereocal.base.homogeneous import cross_matrix, from_homogeneous, to_homogeneous
from stereocal.pair.uncalibrated import rectify_uncalibrated


def rows(H: np.ndarray, points: np.ndarray) -> np.ndarray:
    return from_homogeneous(to_homogeneous(points) @ H.T)


@given(seed=seeds)
@settings(max_examples=30)
def test_rows_match_as_well_as_opencvs_and_disparities_are_as_small(seed) -> None:
    view = two_views(seed, noise=0.2)
    F = np.linalg.inv(K).T @ cross_matrix(view.T) @ view.R @ np.linalg.inv(K)
    H1, H2 = rectify_uncalibrated(view.left, view.right, F, (640, 480))
    found, G1, G2 = cv2.stereoRectifyUncalibrated(view.left, view.right, F, (640, 480), threshold=0)
    assume(found)
    ours = rows(H1, view.left) - rows(H2, view.right)
    theirs = rows(G1, view.left) - rows(G2, view.right)
    assert np.abs(ours[:, 1]).mean() <= 1.02 * np.abs(theirs[:, 1]).mean() + 1e-9
    assert np.abs(ours[:, 1]).mean() < 1
    assert np.std(ours[:, 0]) <= 1.05 * np.std(theirs[:, 0])
    np.testing.assert_allclose(rows(H2, np.array([[319.5, 239.5]])), [[319.5, 239.5]], atol=1e-9)


def test_an_epipole_in_the_picture_is_refused() -> None:
    T = np.array([0.1, 0.05, 1.0])
    F = np.linalg.inv(K).T @ cross_matrix(T) @ np.linalg.inv(K)
    with pytest.raises(DegenerateGeometryError, match="epipole is within the picture"):
        rectify_uncalibrated(np.eye(3, 2) * 100, np.eye(3, 2) * 90, F, (640, 480))
