"""Which photographs to add, in words that somebody with a board in hand can follow.

What limits a calibration is what no view showed. Three gaps are looked for, in this order: a direction of tilt that no
board had, a ninth of the image that no corner reached, and a distance that was left out. The tilt matters most: without
it focal length and distance trade off against each other, and no number of square-on views helps.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.report.evidence import Evidence

_STEEP = 15.0
"""Degrees from which a board counts as tilted."""

_PLACES = (
    ("the upper left", "the top", "the upper right"),
    ("the left", "the middle", "the right"),
    ("the lower left", "the bottom", "the lower right"),
)


def view_tilts(evidence: Evidence) -> Float:
    """Angle of each board's normal to the line of sight of its centre, degrees, (V,)."""
    normals = evidence.rotations[:, :, 2]
    sight = evidence.points_left.mean(axis=1)
    cosine = np.abs(np.sum(normals * sight, axis=1)) / np.linalg.norm(sight, axis=1)
    return np.degrees(np.arccos(np.clip(cosine, 0, 1)))


def tilt_directions(evidence: Evidence) -> Float:
    """Which way each board leans, (V, 2): the x and y parts of its normal, turned towards the camera.

    Positive x: the board faces the camera's right, so its right edge is farther away. Positive y: it faces down.
    """
    normals = evidence.rotations[:, :, 2]
    facing = np.where(normals[:, 2:] > 0, -normals, normals)
    sight = evidence.points_left.mean(axis=1)
    sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
    return np.asarray((facing + sight)[:, :2])


def photographs_to_add(evidence: Evidence, tilts: Float, *, at_most: int = 3) -> tuple[str, ...]:
    """Name the photographs that are missed most.

    Parameters
    ----------
    evidence : Evidence
    tilts : ndarray of shape (V,)
        Degrees, from :func:`view_tilts`.
    at_most : int
        How many to name.

    Returns
    -------
    tuple of str
        Such as ``"the board in the lower left, tilted 30° to the right"``.
    """
    lean = tilt_directions(evidence)
    steep = tilts > _STEEP
    ways = {
        "its left edge nearer": int(np.count_nonzero(steep & (lean[:, 0] > 0.2))),
        "its right edge nearer": int(np.count_nonzero(steep & (lean[:, 0] < -0.2))),
        "its upper edge nearer": int(np.count_nonzero(steep & (lean[:, 1] > 0.2))),
        "its lower edge nearer": int(np.count_nonzero(steep & (lean[:, 1] < -0.2))),
    }
    missing_ways = [way for way, count in sorted(ways.items(), key=lambda item: item[1]) if count < 2]
    counts = ninths(evidence)
    empty = [(counts[r, c], r, c) for r in range(3) for c in range(3) if counts[r, c] < 0.02]
    places = [_PLACES[r][c] for _, r, c in sorted(empty)]
    advice = []
    for index in range(min(at_most, max(len(missing_ways), len(places)))):
        place = f"the board in {places[index]}" if index < len(places) else "the board"
        way = missing_ways[index] if index < len(missing_ways) else ""
        advice.append(f"{place}, tilted by 30° with {way}" if way else f"{place} of the image")
    nearest = evidence.points_left[..., 2].mean(axis=1)
    if len(advice) < at_most and nearest.max() < 1.5 * nearest.min():
        advice.append("the board at half and at twice the distance")
    return tuple(advice[:at_most])


def ninths(evidence: Evidence) -> Float:
    """Share of the corners in each ninth of the image; the camera that saw less of it. (3, 3)."""
    width, height = evidence.image_size
    shares = []
    for corners in (evidence.left, evidence.right):
        points = corners.reshape(-1, 2)
        counts, _, _ = np.histogram2d(
            points[:, 1], points[:, 0], bins=3, range=((-0.5, height - 0.5), (-0.5, width - 0.5))
        )
        shares.append(counts / len(points))
    return np.minimum(*shares)
