"""The paper's equations: as printed, as they must read, and where they are implemented.

The paper numbers three equations "(2)", so the project has its own ids. A docstring names an equation as ``[eq 8]``
or ``[alg-speckle]``; a test reads every docstring of the library and this registry together, so that every id that is
named exists, and every equation has the implementer that the registry claims.

Source: *Modern UVC stereovision camera's calibration and disparity maps generation: mathematical basis, algorithms and
implementations*, the paper that the library implements.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Equation:
    """One equation or algorithm of the paper.

    Attributes
    ----------
    id : str
        The project's id, ``"eq 8"`` or ``"alg-speckle"``.
    topic : str
        What it is.
    printed : str
        As the paper prints it.
    corrected : str
        As it must read; the same text where the paper is right.
    erratum : str
        What is wrong with the printed form and why; empty where the paper is right.
    implemented_by : tuple of str
        Full names of the functions or classes whose docstrings cite it.
    """

    id: str
    topic: str
    printed: str
    corrected: str
    erratum: str
    implemented_by: tuple[str, ...]


def _right(id: str, topic: str, formula: str, *implemented_by: str) -> Equation:
    return Equation(id, topic, formula, formula, "", implemented_by)


EQUATIONS: tuple[Equation, ...] = (
    _right("eq 2a", "image gradient", "I_x = ∂I/∂x, I_y = ∂I/∂y", "stereocal.board.harris.image_gradient"),
    _right("eq 2b", "structure tensor, entry A", "A = I_x²", "stereocal.board.harris.structure_tensor"),
    _right("eq 2c", "structure tensor, entry B", "B = I_y²", "stereocal.board.harris.structure_tensor"),
    Equation(
        "eq 4",
        "structure tensor, entry C",
        "C = I_x² · I_x²",
        "C = I_x · I_y",
        "C is the off-diagonal entry of the outer product of the gradient with itself. The printed I_x⁴ has not even "
        "the unit of A and B, and does not change sign with the direction of the edge.",
        ("stereocal.board.harris.structure_tensor",),
    ),
    _right("eq 5", "smoothed tensor", "M = [[A∗H, C∗H], [C∗H, B∗H]]", "stereocal.board.harris.structure_tensor"),
    _right("eq 6", "diagonal form", "M̄ = diag(λ₁, λ₂)", "stereocal.board.harris.tensor_eigenvalues"),
    Equation(
        "eq 7",
        "eigenvalues",
        "λ = ½(Ā + B̄ ± √(Ā² + 2ĀB̄ + B̄ + 4C̄²))",
        "λ = ½(Ā + B̄ ± √(Ā² − 2ĀB̄ + B̄² + 4C̄²))",
        "trace² − 4 det = (Ā + B̄)² − 4(ĀB̄ − C̄²) = (Ā − B̄)² + 4C̄²: the sign of 2ĀB̄ is wrong and the square of the "
        "last B̄ is lost.",
        ("stereocal.board.harris.tensor_eigenvalues",),
    ),
    Equation(
        "eq 8",
        "corner response",
        "Q = (bar(AB) − bar(C)²) − a·bar(A + B)²",
        "Q = (Ā·B̄ − C̄²) − a(Ā + B̄)²",
        "The bar in print spans the product; the smoothing is of A and B one by one, because det M is formed from the "
        "smoothed tensor.",
        ("stereocal.board.harris.harris_response",),
    ),
    _right("eq 9", "threshold", "Q(u, v) > t_H", "stereocal.board.harris.harris_corners"),
    Equation(
        "eq 10",
        "corner list",
        "Corners = [c₁, …, cₙ], cᵢ = (uᵢ, vᵢ, qᵢ), sorted by q descending",
        "Corners = [c₁, …, cₙ], cᵢ = (uᵢ, vᵢ, qᵢ), local maxima of Q, sorted by q descending",
        "Non-maximum suppression is not named, but without it each corner is listed once for every pixel above the "
        "threshold.",
        ("stereocal.board.harris.harris_corners",),
    ),
    Equation(
        "eq 11",
        "projection",
        "ŝ p̂ = W [R∣T] P̂, p̂ = [X, Y, Z, 1]ᵀ",
        "ŝ p̂ = W [R∣T] P̂, P̂ = [X, Y, Z, 1]ᵀ",
        "The text prints p̂ for both homogeneous vectors.",
        ("stereocal.camera.projection.project_points",),
    ),
    _right(
        "eq 12",
        "intrinsics, rotation, translation",
        "W = [[f_x, 0, s_x], [0, f_y, s_y], [0, 0, 1]], R numbered by columns, T = [T_x, T_y, T_z]ᵀ",
        "stereocal.camera.model.Camera",
    ),
    _right("eq 13", "pinhole, u", "u = f_x x/z + s_x", "stereocal.camera.projection.project_points"),
    _right("eq 14", "pinhole, v", "v = f_y y/z + s_y", "stereocal.camera.projection.project_points"),
    _right(
        "eq 15",
        "field-of-view distortion",
        "(x_u, y_u) = tan(r_d ω) / (2 r_d tan(ω/2)) (x_d, y_d)",
        "stereocal.camera.distortion_fov.FieldOfView",
    ),
    _right(
        "eq 16",
        "division distortion",
        "(x_u, y_u) = 1/(1 + k r_d²) (x_d, y_d)",
        "stereocal.camera.distortion_division.Division",
    ),
    Equation(
        "eq 17",
        "rational function distortion",
        "(x_u, y_u) = (W₁ᵀχ / W₃ᵀχ, W₂ᵀχ / W₄ᵀχ), χ = [x², xy, y², x, y, 1]ᵀ",
        "(x_u, y_u) = (W₁ᵀχ / W₃ᵀχ, W₂ᵀχ / W₃ᵀχ), χ = [x², xy, y², x, y, 1]ᵀ",
        "The model is one 3×6 matrix that takes χ to a homogeneous point: both components share its third row as "
        "denominator. There is no fourth row.",
        ("stereocal.camera.distortion_rational_function.RationalFunction",),
    ),
    Equation(
        "eq 18",
        "polynomial distortion",
        "(x_u, y_u) = (x_d, y_d)(1 + k₁ r_d² + k₂ r_d⁴)",
        "(x_d, y_d) = (x_u, y_u)(1 + k₁ r_u² + k₂ r_u⁴)",
        "Printed from distorted to undistorted; Zhang and OpenCV apply the same polynomial from undistorted to "
        "distorted, which is the direction that the paper's code calibrates. Both directions are offered.",
        ("stereocal.camera.distortion_polynomial.Polynomial",),
    ),
    _right(
        "eq 19",
        "maximum likelihood",
        "Σᵢ Σⱼ ‖p_ij − p̃(W, k₁, k₂, Rᵢ, Tᵢ, P_j)‖² → min, by Levenberg–Marquardt",
        "stereocal.camera.calibration.calibrate_camera",
    ),
    Equation(
        "eq 20",
        "epipolar constraint",
        "pᵀ F p′ = 0",
        "x_rightᵀ F x_left = 0",
        "Transposed against the usual order (Hartley and Zisserman, OpenCV), in which F takes a point of the left "
        "image to its line in the right one.",
        ("stereocal.pair.fundamental.fit_fundamental",),
    ),
    Equation(
        "eq 21",
        "essential matrix",
        "[R∣T]_Rᵀ E [R∣T]_L = 0",
        "x̂_rightᵀ E x̂_left = 0, x̂ = K⁻¹p̂, E = [T]ₓ R, F = K_right⁻ᵀ E K_left⁻¹",
        "Ill-formed: a 4×3 by 3×3 by 3×4 product of poses is a 4×4 matrix. E relates rays, not poses.",
        ("stereocal.pair.essential.fit_essential",),
    ),
    Equation(
        "eq 22",
        "block cost",
        "SAD(x, y) = Σᵢ Σⱼ ∣I_L(x, y) − I_R(x + i, y + j)∣",
        "SAD(x, y, d) = Σᵢ Σⱼ ∣I_L(x + i, y + j) − I_R(x + i − d, y + j)∣",
        "The window's index is missing on I_L, and the disparity altogether: the printed sum compares one pixel of the "
        "left image with a whole window at the same place in the right one.",
        ("stereocal.reconstruction.sad.match_sad",),
    ),
    Equation(
        "alg-speckle",
        "speckle filter",
        "pseudo-code: visit each pixel, join neighbours that differ by at most minDiff, set small values to nVal",
        "components of 4-connected pixels whose neighbours differ by at most max_difference; a component of at most "
        "max_size pixels becomes 'no disparity'",
        "nVal is the value for 'no disparity', not a threshold; the size that the text sweeps from 50 to 200 is an "
        "area in pixels of a component (OpenCV's speckleWindowSize), not the side of a window; the pseudo-code never "
        "counts a component.",
        ("stereocal.reconstruction.speckles.filter_speckles",),
    ),
    Equation(
        "sec-3",
        "evaluation by sweep",
        "windows 5…255 step 2, speckle 50…200 step 10, counting disparities > 0",
        "the same counts, beside the fill of the computable region and the left-right consistency",
        "The falling branch of figure 7 is mostly geometry: a window that does not fit in the image gives no "
        "disparity, whatever is in the image; and a count rewards wrong matches.",
        ("stereocal.sweep.disparity_sweep.sweep_disparity",),
    ),
)
"""Every numbered equation of the paper, its speckle algorithm and its evaluation, in the paper's order."""
