"""Views that do not determine a camera, recognised and named.

An optimum always exists on paper; whether it means anything depends on the photographs. Asked after the fit:

**Are all boards parallel?** A board's plane with normal n = (n_x, n_y, n_z) gives two equations for K (see ``zhang``),
and parallel boards give the same two: four unknowns fx, fy, cx, cy are left open, whatever the number of views and
however well they fit. Noise makes parallel boards look tilted against each other, and an overestimated focal length
magnifies it (6° of tilt at 13 times the focal length is 30 minutes of arc). So the slopes s = (n_x, n_y) / n_z are
compared with their own uncertainty C_i, which grows by the same factor: with intrinsics held, the poses of different
views are independent, Cov(ω_i) = σ² V_i⁻¹, and

    χ² = Σ (s_i − s̄)ᵀ C_i⁻¹ (s_i − s̄),        s̄ = (Σ C_i⁻¹)⁻¹ Σ C_i⁻¹ s_i,

has 2(V − 1) degrees of freedom if the boards are parallel, and as many more as there are intrinsics, which were chosen
to fit the very noise that is judged here. Below the value that parallel boards exceed once in a thousand times, or
where no two differ by a degree, they are taken to be parallel. A lens with strong distortion does tell the focal length
from parallel boards, in principle: far too weakly to be trusted, and the views are refused all the same.

A C_i taken at the optimum is the slope's uncertainty only as far as that is a place like others. A focal length that
ran away went to where noise looks most like tilt: there perspective, linear in the tilt, is weak, and foreshortening,
which is quadratic, decides. Parallel boards, however, fit with any focal length. Where f is unsure to a tenth, the same
χ² is asked again with fy held at the image's width.

In a rig all cameras share the boards. What parallel boards leave open is one map of space that keeps planes of their
direction as they are and takes the normal anywhere, three numbers for all cameras together; each number of a K that is
known (skew, to begin with) settles one. So one camera of four unknowns leaves two open, and two such cameras one. What
is known of a second camera settles something new only if it is turned against the first, by 20° or more here; how well
three or more of those do together, the covariance tells.

A lens may also run away from its camera: coefficients that grow without end draw at a scale of their own, and fy
follows no measurement. The boards are then judged by the scale that is drawn.

**Is the focal length sure to within a half?** Otherwise it is refused too. If the boards are well tilted and it would
be sure with the lens's coefficients held, tilts are not what is missing: the model has coefficients that these views
cannot tell apart (a rational model on a mild lens: numerator and denominator grow together without end), and a simpler
model is the answer. As long as the lens draws its corners at about the scale of its focal length, though, it is the
coefficients alone that are open, and the camera is good for every pixel: it is returned, with a warning
(``lens_doubts``).

**Has the principal point left?** With coefficients that can do the work of a turn of the camera, it may run until the
first corner is 90° off the axis, where the normalised plane ends and with it the model. That is no optimum either.

**Or is it the lens?** A model that cannot draw the lens at all (a pinhole, for a wide angle) leaves residuals so large
that tilts vanish among them. Before one camera of fewer coefficients than Brown's is refused, Brown's is fitted; where
it leaves a third of the RMS or less, that is said, and the views are not blamed.

Corners that fit exactly (synthetic ones) prove nothing: both questions are put for errors of at least 0.01 px.

Source: Zhang (2000), section 2.4 and appendix D, for the degeneracy of parallel boards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from stereocal.base.checks import Float
from stereocal.base.errors import ConvergenceError, DegenerateGeometryError
from stereocal.base.rotations import rotation_matrices
from stereocal.camera.bundle import Bundle, BundleState, NormalEquations
from stereocal.camera.bundle_solver import schur_complement, solve_bundle
from stereocal.camera.covariance import BundleCovariance
from stereocal.camera.distortion import distortion_model
from stereocal.camera.lens_doubts import (
    MANY_COEFFICIENTS,
    UNDETERMINED,
    drawn_scale,
    draws_at_its_focal_length,
    squared_radii,
)
from stereocal.camera.parameters import intrinsic_names

ADVICE = "photograph the board tilted by 30 to 45 degrees, to a different side each time"

_LEAST_NOISE = 0.01
# How often parallel boards are taken for tilted ones.
_SIGNIFICANCE = 1e-3
# Slopes that differ by more than this, brought to a focal length of one image width, are no noise.
_CLEARLY_TILTED = 0.35
# Boards within a degree are parallel, whatever the noise.
_PARALLEL = np.radians(1.0)
# Tilts against each other that suffice for a focal length.
_ENOUGH = np.radians(20.0)
# A focal length of more widths than this is that of no camera: it ran away.
_LONGEST = 100.0
# Relative standard deviation of the focal length from which on parallel boards are looked for at another one.
_UNSURE = 0.1
_STEPS_ELSEWHERE = 100
# A lens that leaves this part of the RMS is the better one.
_FAR_BETTER = 3.0
# Corners at more than this r on the normalised plane are at its edge: within 0.06 degrees of 90.
_EDGE = 1e3
# Cameras turned against each other by less than this see parallel boards alike.
_TURNED = np.radians(20.0)


def refuse_degenerate(
    bundle: Bundle,
    state: BundleState,
    equations: NormalEquations,
    joint: BundleCovariance,
    width: int | Sequence[int],
    names: Sequence[str] = ("",),
) -> None:
    """Raise DegenerateGeometryError if the views do not determine the cameras of a bundle.

    Parameters
    ----------
    bundle : Bundle
        Of one camera, or of a rig.
    state : BundleState
        Its optimum.
    equations : NormalEquations
        There.
    joint : BundleCovariance
        There.
    width : int, or one a camera
        Of the image, pixels.
    names : sequence of str
        What the cameras of a rig are called.

    Raises
    ------
    DegenerateGeometryError
        Says which views, why, and what to photograph.
    """
    widths = [width] if isinstance(width, int) else list(width)
    try:
        _refuse(bundle, state, equations, joint, widths, names)
    except DegenerateGeometryError:
        if len(names) == 1 and (wrong := _wrong_lens(bundle, state, equations, widths[0])):
            raise DegenerateGeometryError(wrong) from None
        raise


def _refuse(
    bundle: Bundle, state: BundleState, equations: NormalEquations, joint: BundleCovariance, widths: list[int],
    names: Sequence[str],
) -> None:  # fmt: skip
    doubts = [_doubt(bundle, equations, joint, camera) for camera in range(len(names))]
    if _left_open_by_parallel_boards(bundle, state, joint, widths):
        unsure = any(doubt > _UNSURE * theta[1] for doubt, theta in zip(doubts, state.intrinsics, strict=True))
        # a lens that ran away takes the focal length along; where that is sure, all corners need not be asked
        ran_away = unsure and not draws_at_its_focal_length(bundle, state, 0)
        drawn = drawn_scale(bundle, state, 0) if ran_away else 1.0
        ran_away = ran_away and bool(np.isfinite(drawn))
        _refuse_parallel(bundle, state, equations, joint, widths[0] / (drawn if ran_away else 1.0))
        elsewhere = _at_plausible_focal_length(bundle, state, widths[0]) if unsure and not ran_away else None
        if elsewhere is not None:
            _refuse_parallel(bundle, *elsewhere, joint, widths[0])
    for camera, (doubt, name) in enumerate(zip(doubts, names, strict=True)):
        _refuse_at_the_edge(bundle, state, camera, f" of the {name} camera" if name else "")
        fy = float(state.intrinsics[camera][1])
        is_free = np.any(bundle.G[bundle.intrinsic_slices[camera]][:2]) and joint.degrees_of_freedom > 0
        if is_free and not (doubt < UNDETERMINED * fy and fy < _LONGEST * widths[camera]):
            _refuse_open_focal_length(bundle, state, equations, joint, camera, f" of the {name} camera" if name else "")


def _wrong_lens(bundle: Bundle, state: BundleState, equations: NormalEquations, width: int) -> str:
    """In words: that Brown's lens fits far better than the one that was asked for; empty where it does not."""
    from stereocal.camera.initialisation import solve_from_starts

    lens, brown = bundle.G[5 : bundle.intrinsic_slices[0].stop].any(axis=0), distortion_model("brown")
    of_K = bundle.G[:5, bundle.G[:5].any(axis=0)]
    if np.count_nonzero(lens) >= brown.parameter_count or not of_K.shape[1] or bundle.shape_basis is not None:
        return ""
    G = np.ascontiguousarray(block_diag(of_K, np.eye(brown.parameter_count)), dtype=np.float64)
    with_brown = replace(bundle, models=[brown], G=G, prior_weights=None, prior_means=None)
    held = {name for name, row in zip(intrinsic_names(brown), G, strict=True) if not row.any()}
    fx, fy = state.intrinsics[0][:2]
    tied = fx / fy if np.any(bundle.G[0] * bundle.G[1]) else None
    size = (width, int(bundle.measured[:, 1].max()) + 1)
    try:
        found = solve_from_starts(
            with_brown, brown, held, size, aspect_ratio=tied, max_iterations=_STEPS_ELSEWHERE, backend="numba"
        )
    except ConvergenceError:
        return ""
    rms, rms_of_brown = (np.sqrt(np.mean(np.sum(e.residuals**2, axis=1))) for e in (equations, found.equations))
    if not rms > _FAR_BETTER * max(rms_of_brown, _LEAST_NOISE):
        return ""
    return (
        f"the lens of model {bundle.models[0].name!r} does not fit: it leaves an RMS of {rms:.2g} pixels, with which "
        f"{_views(state)} cannot determine the focal length, where model 'brown' leaves {rms_of_brown:.2g}; choose "
        "that, or another with more coefficients"
    )


def _refuse_open_focal_length(
    bundle: Bundle, state: BundleState, equations: NormalEquations, joint: BundleCovariance, camera: int, of_camera: str
) -> None:
    fy, doubt = float(state.intrinsics[camera][1]), _doubt(bundle, equations, joint, camera)
    model = bundle.models[camera]
    if _widest_tilt(state) > _ENOUGH and _doubt(bundle, equations, joint, camera, lens_held=True) < 0.05 * fy:
        if draws_at_its_focal_length(bundle, state, camera):
            return  # coefficients alone are open, which ``lens_doubts`` says
        raise DegenerateGeometryError(
            f"{_views(state)} do not determine the {model.parameter_count} coefficients of model {model.name!r}"
            f"{of_camera}: they grow without end and take the focal length along (fy = {fy:.3g} ± {doubt:.2g} pixels); "
            "choose a model with fewer, such as 'brown', hold some of them by fix=, or photograph the board in every "
            "corner of the image"
        )
    raise DegenerateGeometryError(
        f"{_views(state)} {'does' if len(state.R_views) == 1 else 'do'} not determine the focal length{of_camera} "
        f"(fy = {fy:.3g} ± {doubt:.2g} pixels): {_tilts(state)}; {ADVICE}"
    )


def _refuse_at_the_edge(bundle: Bundle, state: BundleState, camera: int, of_camera: str) -> None:
    model = bundle.models[camera]
    if model.parameter_count < MANY_COEFFICIENTS or not bundle.G[bundle.intrinsic_slices[camera]][2:4].any():
        return
    s = squared_radii(bundle, state, camera)
    if not s.max() > _EDGE**2:
        return
    at = bundle.rows_of_camera(camera)[0].start + int(np.argmax(s))
    view = bundle.view_of_block[np.searchsorted(bundle.offsets, at, side="right") - 1]
    cx, cy = state.intrinsics[camera][2:4]
    raise DegenerateGeometryError(
        f"{_views(state)} do not determine the principal point{of_camera} along with the {model.parameter_count} "
        f"coefficients of model {model.name!r}: it ran to ({cx:.0f}, {cy:.0f}), until a corner of view "
        f"{view} is 90 degrees off the axis, where the model ends; hold it by "
        "fix='principal_point', or choose a model with fewer coefficients, such as 'brown'"
    )


def _left_open_by_parallel_boards(
    bundle: Bundle, state: BundleState, joint: BundleCovariance, widths: Sequence[int]
) -> bool:
    """Whether fewer than three numbers of all K are known; a prior far tighter than the image's width knows one."""
    turned: list[tuple[Float, int]] = []  # cameras turned against each other, and how much each of them knows
    for part, width, R in zip(bundle.intrinsic_slices, widths, state.R_rig, strict=True):
        rows = np.arange(part.start, part.start + 5)
        if bundle.prior_weights is not None:
            rows = rows[bundle.prior_weights[rows] * UNDETERMINED * width <= np.sqrt(joint.variance)]
        known = 5 - int(np.count_nonzero(bundle.G[rows].any(axis=0)))
        # 2 cos + 1 is the trace of the turn between two cameras
        like = [i for i, (other, _) in enumerate(turned) if np.sum(R * other) > 2 * np.cos(_TURNED) + 1]
        if like:
            turned[like[0]] = turned[like[0]][0], max(known, turned[like[0]][1])
        else:
            turned.append((R, known))
    return sum(known for _, known in turned) < 3


def _refuse_parallel(
    bundle: Bundle, state: BundleState, equations: NormalEquations, joint: BundleCovariance, width: float
) -> None:
    count = len(state.R_views)
    if count < 2:
        raise DegenerateGeometryError(
            f"the one view leaves the focal length open: one board plane gives two equations a camera; {ADVICE}"
        )
    n = state.R_views[:, :, 2]
    slopes = n[:, :2] / n[:, 2:]
    scale = width / max(abs(float(state.intrinsics[0][0])), 1e-300)
    spread = float(np.max(np.ptp(slopes, axis=0))) * min(scale, 1.0)
    if spread > _CLEARLY_TILTED:
        return
    variance = max(joint.variance, _LEAST_NOISE**2) if np.isfinite(joint.variance) else _LEAST_NOISE**2
    try:
        chi2 = slopes_chi2(n, np.asarray(variance * equations.V_inverse[:, :3, :3]))
    except np.linalg.LinAlgError as error:
        raise DegenerateGeometryError(
            f"{_views(state)} do not determine the camera: at the best fit there is one whose corners leave its pose "
            "open; check the order of corners and board points in each view"
        ) from error
    from scipy.special import chdtri

    # a focal length that ran away says nothing about angles; their ratio to their uncertainty still does
    flat = spread <= _PARALLEL and 1 / scale < _LONGEST
    if not flat and chi2 > chdtri(2 * (count - 1) + bundle.G.shape[1], _SIGNIFICANCE):
        return
    raise DegenerateGeometryError(
        f"the boards of all {count} views are parallel as far as their corners can tell, which leaves the focal length "
        f"open{_same_views(bundle)}; {ADVICE}"
    )


def _at_plausible_focal_length(
    bundle: Bundle, state: BundleState, width: int
) -> tuple[BundleState, NormalEquations] | None:
    """The optimum with every fy held, the first camera's at the width; None where there is none, or one is known."""
    rows = [part.start + 1 for part in bundle.intrinsic_slices]
    held = bundle.G[rows].any(axis=0)
    if not np.all(bundle.G[rows].any(axis=1)):
        return None
    part = replace(bundle, G=np.ascontiguousarray(bundle.G[:, ~held]))
    # What a change of f by a looks like from the front: depths and slopes change by a.
    a = width / float(state.intrinsics[0][1])
    intrinsics = []
    for theta, model, row in zip(state.intrinsics, bundle.models, rows, strict=True):
        tied = np.any(bundle.G[row - 1, held])
        fx = theta[0] if tied else theta[1]  # where it ran away, their ratio need not be that of a camera
        intrinsics.append(np.concatenate([[fx * a, theta[1] * a], theta[2:5], model.start()]))
    depth = np.array([1, 1, a])
    slopes = a * state.R_views[:, :2, 2] / state.R_views[:, 2:, 2]
    start = BundleState(
        intrinsics,
        state.R_rig,
        state.t_rig * depth,
        _turned(state.R_views, slopes),
        state.t_views * depth,
        state.shape,
    )
    found = solve_bundle(part, start, max_iterations=_STEPS_ELSEWHERE)
    return (found.state, found.equations) if np.isfinite(found.cost) else None


def _turned(R: Float, slopes: Float) -> Float:
    """Rotations R (V, 3, 3) after the smallest turns that give their boards the slopes (V, 2), the same side seen."""
    n = R[:, :, 2]
    there = np.column_stack([slopes, np.ones(len(n))]) * np.sign(n[:, 2:])
    there /= np.linalg.norm(there, axis=1)[:, None]
    axes = np.cross(n, there)
    sines = np.linalg.norm(axes, axis=1)
    angles = np.arctan2(sines, np.einsum("vi,vi->v", n, there))
    return np.asarray(rotation_matrices(axes * (angles / np.maximum(sines, 1e-300))[:, None]) @ R)


def slopes_chi2(n: Float, of_turns: Float) -> float:
    """Return χ² of the hypothesis that all boards are parallel.

    Parameters
    ----------
    n : ndarray of shape (V, 3)
        Normals.
    of_turns : ndarray of shape (V, 3, 3)
        Covariance of a small turn ω of each board, about the camera's axes.

    Returns
    -------
    float
    """
    slopes = n[:, :2] / n[:, 2:]
    # δn = ω × n = −[n]ₓ ω;  δs = (δn_xy − s δn_z) / n_z
    nx, ny, nz = n.T
    zero = np.zeros(len(n))
    turn = np.array([[zero, nz, -ny], [-nz, zero, nx], [ny, -nx, zero]]).transpose(2, 0, 1)
    J = (turn[:, :2] - slopes[:, :, None] * turn[:, 2:]) / n[:, 2, None, None]
    weights = np.linalg.inv(J @ of_turns @ J.transpose(0, 2, 1))
    mean = np.linalg.solve(weights.sum(axis=0), np.einsum("vij,vj->i", weights, slopes))
    d = slopes - mean
    return float(np.einsum("vi,vij,vj->", d, weights, d))


def _doubt(
    bundle: Bundle, equations: NormalEquations, joint: BundleCovariance, camera: int, *, lens_held: bool = False
) -> float:
    """Standard deviation of a camera's fy, or what it would be if all coefficients of the lenses were known."""
    row = bundle.intrinsic_slices[camera].start + 1
    # a singular system has no covariance, and yet it has noise
    variance = joint.variance if np.isfinite(joint.variance) else equations.cost / max(joint.degrees_of_freedom, 1)
    noise = max(variance, _LEAST_NOISE**2)
    if not lens_held:
        return float(np.sqrt(joint.shared[row, row] * (noise / max(variance, 1e-300))))
    of_lens = np.zeros(bundle.G.shape[1], dtype=bool)
    for part in bundle.intrinsic_slices:
        of_lens |= np.any(bundle.G[part.start + 5 : part.stop], axis=0)
    if not of_lens.any():
        return np.inf
    try:
        S = schur_complement(equations)[0][np.ix_(~of_lens, ~of_lens)]
        g = bundle.G[row, ~of_lens]
        of_fy = float(g @ np.linalg.solve(S, g)) * noise
    except np.linalg.LinAlgError:
        return np.inf
    return float(np.sqrt(of_fy)) if of_fy > 0 else np.inf


def _views(state: BundleState) -> str:
    count = len(state.R_views)
    return "the one view" if count == 1 else f"the {count} views"


def _widest_tilt(state: BundleState) -> float:
    """Largest angle between two boards' normals."""
    normals = state.R_views[:, :, 2]
    return float(np.arccos(np.clip(np.min(normals @ normals.T), -1, 1)))


def _tilts(state: BundleState) -> str:
    """In words: by how much the boards are tilted against each other."""
    if len(state.R_views) == 1:
        return "one board plane gives two equations, too few for what is free"
    widest = _widest_tilt(state)
    if widest > _ENOUGH:
        return "their boards' tilts are too uncertain (few corners, noise, or a long lens)"
    return f"their boards are tilted by no more than {np.degrees(widest):.1f} degrees against each other"


def _same_views(bundle: Bundle) -> str:
    """In words: which views hold the very same corners (of a rig, in its first camera)."""
    offsets, blocks = bundle.offsets, bundle.rows_of_camera(0)[1]
    corners = {int(bundle.view_of_block[i]): bundle.measured[offsets[i] : offsets[i + 1]] for i in blocks}
    groups: list[list[int]] = []
    for i, y in corners.items():
        for group in groups:
            if np.array_equal(corners[group[0]], y):
                group.append(i)
                break
        else:
            groups.append([i])
    same = [group for group in groups if len(group) > 1]
    return "".join(f"; views {', '.join(map(str, group))} hold the very same corners" for group in same)
