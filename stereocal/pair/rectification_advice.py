"""What is odd about a rig, in words, and what to do about it.

A rectification of a strange rig is mathematically right and of no use: pictures that are black, turned or mirrored,
disparities that no matcher looks for. Users then see an empty depth map and no word why. Each check here looks at one
number of the geometry, and answers with a sentence that names the cause, the number and the remedy.

=======================  ===========================================================================  =============
what                     how it shows                                                                 limit (ours)
=======================  ===========================================================================  =============
one camera upside down   the rotation between the cameras turns about the optical axis                above 135°
one camera on its side   the same                                                                     above 45°
swapped cameras          the rectified baseline b is positive: the first camera is on the right       b > 0
vertical rig             the baseline lies along y                                                    |t_y| ≥ |t_x|
baseline along the view  the rotation w that lays the baseline on an axis is large                    above 40°
converging cameras       the angle between the optical axes                                           above 40°
hardly a common view     share of the rectified picture that both cameras fill                        below 20 %
ghosts                   share of a picture where the lens formula folds over and shows things twice  above 1 %
=======================  ===========================================================================  =============
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.rotations import rotation_vector

if TYPE_CHECKING:
    from stereocal.camera.model import Camera
    from stereocal.pair.rectification import Rectification
    from stereocal.pair.rectifying_rotations import RectifyingRotations
    from stereocal.pair.rig import StereoRig

_UPSIDE_DOWN, _ON_ITS_SIDE, _ALONG_VIEW, _CONVERGING = (float(np.radians(a)) for a in (135, 45, 40, 40))
_LEAST_COMMON, _MOST_GHOSTS = 0.2, 0.01
_GRID = 48


def rig_warnings(rig: StereoRig, turned: RectifyingRotations) -> list[str]:
    """Say what is odd about how the cameras stand.

    Parameters
    ----------
    rig : StereoRig
        The calibrated rig.
    turned : RectifyingRotations
        What rectifying it takes.

    Returns
    -------
    list of str
        A sentence or two each; empty for a healthy rig.
    """
    R, T = np.asarray(rig.R), np.ravel(rig.T)
    roll = abs(float(rotation_vector(R)[2]))
    if roll > _UPSIDE_DOWN:
        return [
            f"One camera is upside down against the other (turned by {np.degrees(roll):.0f}° about its optical axis). "
            "Turn its images by 180° (image[::-1, ::-1]) and calibrate again with the turned images."
        ]
    if roll > _ON_ITS_SIDE:
        return [
            f"One camera lies on its side against the other (turned by {np.degrees(roll):.0f}° about its optical "
            "axis). Turn its images by a quarter (numpy.rot90) and calibrate again with the turned images."
        ]
    said = []
    if turned.axis == 1:
        which = "below" if turned.baseline > 0 else "above"
        said.append(
            f"The baseline is vertical (T = {_spelt(T)}; the first camera is {which} the second): epipolar lines are "
            "columns, and a matcher that searches along rows finds nothing. Turn both cameras' images by a quarter "
            "(numpy.rot90) and calibrate again, or transpose the rectified pictures before matching."
        )
    elif turned.baseline > 0:
        said.append(
            f"The cameras are swapped: the one called left stands to the right of the other (T = {_spelt(T)}, "
            "T_x > 0). Depth is still right, but disparities are negative, and matchers that search from 0 up find "
            "nothing. Exchange the two: calibrate again with the folders exchanged (stereocal calibrate --swap)."
        )
    converging = float(np.arccos(np.clip(R[2, 2], -1, 1)))
    aside = float(np.arccos(np.clip(turned.R2[2, 2], -1, 1)))
    if converging > _CONVERGING:
        said.append(
            f"The optical axes differ by {np.degrees(converging):.0f}°: the rectified pictures are stretched and share "
            "little of the scene. Set the cameras more nearly parallel, or zoom out (alpha=1)."
        )
    elif aside > _ALONG_VIEW:
        said.append(
            f"The baseline points along the view rather than across it (rectifying turns the right camera by "
            f"{np.degrees(aside):.0f}°): near the epipole there is no depth, and the pictures are stretched. Set the "
            "cameras side by side."
        )
    return said


def view_warnings(result: Rectification) -> list[str]:
    """Say so if hardly any pixel is filled by both cameras, or if the lens formula folds over within the picture.

    Parameters
    ----------
    result : Rectification
        What to look at.

    Returns
    -------
    list of str
    """
    sides = ((result.rig.left, result.R1, result.P1), (result.rig.right, result.R2, result.P2))
    seen = [_filled(camera, R, P, result.image_size) for camera, R, P in sides]
    filled = [part for part, _ in seen]
    said = []
    ghosts = max(float(folded.mean()) for _, folded in seen)
    if ghosts > _MOST_GHOSTS:
        said.append(
            f"In {100 * ghosts:.0f} % of a rectified picture the lens formula folds over and shows things a second "
            "time, beyond the edge of what the camera saw. Blank these pixels (apply(..., only_valid=True), or "
            "valid_mask), zoom in (smaller alpha), or calibrate with corners nearer to the image's edge."
        )
    names = [n for n, part in zip(("left", "right"), filled, strict=True) if part.mean() < _LEAST_COMMON]
    both = float((filled[0] & filled[1]).mean())
    if both >= _LEAST_COMMON:
        return said
    which = f"the {' and the '.join(names)} picture" if names else "what both pictures show"
    return [
        *said,
        f"The rectified pictures are nearly empty: both cameras fill only {100 * both:.0f} % of them ({which}). Try "
        "view='common' or another alpha; if that does not help, the calibration does not fit these cameras: check its "
        "residuals, the pairing of the images and the board's size.",
    ]


def _filled(camera: Camera, R: Float, P: Float, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Tell on a coarse grid of a rectified picture which pixels the camera fills, and which show a ghost."""
    from stereocal.camera.distortion import distort_normalized, to_pixels
    from stereocal.camera.undistortion import inverse_of_new_camera

    u, v = np.meshgrid(np.linspace(0, size[0] - 1, _GRID), np.linspace(0, size[1] - 1, _GRID))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = np.column_stack([pixels, np.ones(len(pixels))]) @ inverse_of_new_camera(P[:, :3], R).T
    ahead = rays[:, 2] > 1e-9
    places = np.full((len(rays), 2), np.nan)
    normalised = rays[ahead, :2] / rays[ahead, 2:]
    places[ahead] = to_pixels(distort_normalized(normalised, camera.dist, camera.model), camera.K)
    width, height = camera.image_size
    with np.errstate(invalid="ignore"):
        inside = np.all((places >= 0) & (places <= (width - 1, height - 1)), axis=1)
    back = np.full_like(places, np.nan)
    if inside.any():
        back[inside] = camera.undistort_points(places[inside], R=R, P=P[:, :3])
    with np.errstate(invalid="ignore"):
        returns = np.linalg.norm(back - pixels, axis=1) < 1
    return inside & returns, inside & ~returns


def _spelt(T: Float) -> str:
    return "(" + ", ".join(f"{t:.4g}" for t in T) + ")"
