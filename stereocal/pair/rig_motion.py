"""Properly paired views that see different rigs: a knocked camera, late shutters, single views gone wrong.

Let the rig be R, T. The board's pose R_l, t_l in the left camera predicts the pose R R_l, R t_l + T in the right one.
What is measured there differs from it by a small turn ω and a displacement d of the board's centre c (camera frame),
with the uncertainty Σ of (ω, d) that follows from both poses' covariances (``view_rigs``).

**A knock** turns the right camera by ω₀ and moves it by d₀, and shows as ω = ω₀, d = ω₀ × c + d₀, the same ω₀, d₀ in
all later views: six numbers and a moment explain everything. All moments are tried.

**A late shutter** shows as (ω, d) = δ · (the board's turn and way from view to view), one number δ if the delay is
constant. If the board's way is not known (it was moved at random between the views) late shutters still show as views
that disagree by far more than their uncertainty, each in its own way.

Both are linear least squares, and the F statistic compares them with the noise that is left. A single view that is
predicted far off, where the others are not, is an **outlier**, and is left out of the comparison.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.rotations import rotation_vector
from stereocal.pair.findings import Finding, listed_pairs
from stereocal.pair.view_rigs import (
    Rig,
    Turns,
    ViewPoses,
    common_motion,
    deviation,
    motion_design,
    predicted_errors,
    whiten,
)

# The least number of views that tell anything.
_MIN_VIEWS = 5
# A single view that is predicted this far off fits nothing.
_GROSS_PIXELS, _GROSS_FACTOR = 4.0, 6.0
# A knock: F statistic, share of the deviations that it explains, size against the noise, least views on each side.
_STEP_F, _STEP_SHARE, _STEP_NOISE, _LEAST_SIDE = 15.0, 0.5, 3.0, 3
# Late shutters: F statistic, share, least lag in intervals; or scatter without a known way.
_LAG_F, _LAG_SHARE, _LEAST_LAG = 25.0, 0.25, 0.02
_SCATTER_PIXELS, _SCATTER = 3.0, 6.0


def disagreement_findings(first: ViewPoses, second: ViewPoses, rig: Rig, noise: float, bent: bool) -> list[Finding]:
    """Name what makes properly paired views disagree: a knock, late shutters, or single views gone wrong.

    Parameters
    ----------
    first, second : ViewPoses
        Of the left and of the right camera, view by view.
    rig : (R, T)
        The rig that most views see.
    noise : float
        RMS of both cameras' calibrations, pixels.
    bent : bool
        Whether the board is known to be bent, which makes views disagree too.

    Returns
    -------
    list of Finding
    """
    here = np.arange(len(first.R))
    # single views that fit nothing must not be taken for a movement of the camera
    errors = predicted_errors(first, second, here, here, rig)
    middle = float(np.median(errors))
    stray = np.flatnonzero(errors > max(_GROSS_PIXELS, _GROSS_FACTOR * max(middle, noise)))
    keep = np.setdiff1d(here, stray)
    found: list[Finding] = []
    knock, left_by_knock = _knock(first, second, here, rig, noise)
    if knock is not None:
        late, left_by_lag = _late_shutter(first, second, here, rig, noise, bent)
        # a board that is moved slowly and steadily, seen late, looks like a step; one number instead of seven wins
        return [late if late is not None and left_by_lag <= left_by_knock else knock]
    if len(stray) > 0.3 * len(here) or len(keep) < _MIN_VIEWS:
        keep, stray = here, stray[:0]
    late, _ = _late_shutter(first, second, keep, rig, noise, bent)
    if len(stray):
        found.append(
            Finding(
                "outlier",
                tuple(int(i) for i in stray),
                f"{'One pair fits' if len(stray) == 1 else f'{len(stray)} pairs fit'} no common rig "
                f"({listed_pairs(stray)}): the "
                "left view predicts the right corners "
                f"{float(errors[stray].max()):.1f} px away. Look at the detected corners, or leave them out.",
                float(errors[stray].max()),
            )
        )
    return found + ([late] if late is not None else [])


def _knock(first: ViewPoses, second: ViewPoses, here: Turns, rig: Rig, noise: float) -> tuple[Finding | None, float]:
    """Compare one rig for all views with one before and another after each moment; return χ² left, too."""
    arms = first.centres @ rig[0].T
    xi, covariances = deviation(first, second, here, here, rig)
    _, whole = common_motion(xi, covariances, arms)
    splits = range(_LEAST_SIDE, len(here) - _LEAST_SIDE + 1)
    best, moment = np.inf, -1
    for s in splits:
        parts = [common_motion(xi[p], covariances[p], arms[p])[1] for p in (slice(0, s), slice(s, None))]
        if sum(parts) < best:
            best, moment = sum(parts), s
    if moment < 0:
        return None, best
    freedom = 6 * len(here) - 12
    strength = (whole - best) / 6 / max(best / freedom, 1.0)
    share = (whole - best) / max(whole, 1e-300)
    before = common_motion(xi[:moment], covariances[:moment], arms[:moment])[0]
    after = common_motion(xi[moment:], covariances[moment:], arms[moment:])[0]
    change = after - before
    f = float(second.camera.K[0, 0])
    depth = float(np.median(second.centres[:, 2]))
    pixels = f * float(np.hypot(np.linalg.norm(change[:3]), np.linalg.norm(change[3:]) / depth))
    if strength < _STEP_F or share < _STEP_SHARE or pixels < _STEP_NOISE * noise:
        return None, best
    finding = Finding(
        "knocked",
        tuple(range(moment, len(here))),
        f"A camera moved between pair {moment} and pair {moment + 1}: from there on the right camera stands turned "
        f"by {np.degrees(np.linalg.norm(change[:3])):.2f}° and shifted by {np.linalg.norm(change[3:]):.3g} against "
        f"before. "
        "Calibrate from the pairs after it (if the rig has not moved since), and fix the cameras to one another.",
        float(strength),
    )
    return finding, best


def _late_shutter(
    first: ViewPoses, second: ViewPoses, keep: Turns, rig: Rig, noise: float, bent: bool
) -> tuple[Finding | None, float]:
    """Compare the deviations with the board's way from view to view; return χ² left, too."""
    R = rig[0]
    xi, covariances = deviation(first, second, keep, keep, rig)
    arms = first.centres[keep] @ R.T
    design, b = whiten(motion_design(arms), xi, covariances)
    basis = np.linalg.qr(design.reshape(-1, 6))[0]
    way = _way(first, keep) @ np.kron(np.eye(2), R).T
    motion = whiten(np.zeros((len(keep), 6, 1)), way, covariances)[1].ravel()
    residual = b.ravel() - basis @ (basis.T @ b.ravel())
    motion = motion - basis @ (basis.T @ motion)
    before = float(residual @ residual)
    lag = float(motion @ residual) / max(float(motion @ motion), 1e-300)
    after = before - lag * float(motion @ residual)
    freedom = residual.size - 7
    strength = (before - after) / max(after / freedom, 1.0)
    if strength > _LAG_F and (before - after) / max(before, 1e-300) > _LAG_SHARE and abs(lag) > _LEAST_LAG:
        finding = Finding(
            "synchronisation",
            tuple(int(i) for i in keep),
            f"The two cameras did not expose at the same moment: the board is seen {abs(lag):.2f} of a picture's "
            f"interval {'further' if lag > 0 else 'back'} along its way in the right image. Trigger both cameras "
            f"together, or "
            "hold the board still for each pair.",
            float(strength),
        )
        return finding, after
    errors = predicted_errors(first, second, keep, keep, rig)
    scatter = before / freedom
    if not bent and float(np.median(errors)) > _SCATTER_PIXELS * noise and scatter > _SCATTER:
        finding = Finding(
            "synchronisation",
            tuple(int(i) for i in keep),
            f"The pairs disagree about the rig, each in its own way: the left views predict the right corners "
            f"{float(np.median(errors)):.1f} px off, where the cameras alone leave {noise:.2f} px. Cameras that do "
            "not expose at the same moment do this (or a mount that is not stiff). Trigger both together, or hold "
            "the board "
            "still for each pair.",
            float(scatter),
        )
        return finding, after
    return None, after


def _way(poses: ViewPoses, keep: Turns) -> Float:
    """Return the board's turn and way from view to view (half of that from the last to the next), per interval."""
    ways = np.zeros((len(keep), 6))
    last = len(poses.R) - 1
    for n, i in enumerate(keep):
        a, b = max(i - 1, 0), min(i + 1, last)
        turn = rotation_vector(poses.R[b] @ poses.R[a].T)
        ways[n] = np.concatenate([turn, poses.centres[b] - poses.centres[a]]) / (b - a)
    return ways
