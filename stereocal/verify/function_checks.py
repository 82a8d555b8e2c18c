"""Is my function right? A function in, a report out.

A student has written a Harris response, an engineer a faster remap. :func:`check_function` calls it on inputs that are
drawn for the purpose, compares what it returns with this library's reference and with OpenCV, and, where they part,
tries the mistakes that people usually make: a constant factor, a transposed result, swapped columns, a shift by one
pixel, wrong values at the border only, the paper's misprints. A mistake that explains the whole difference is named.

    >>> report = check_function("rotation_matrix", lambda rvec: np.eye(3))
    >>> report.agrees
    False

Kernels: see :data:`stereocal.verify.function_cases.CASES`. The pytest plugin (:mod:`stereocal.verify.pytest_plugin`)
hands the same function to a test-suite as the fixture ``stereocal_check``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import require_choice, require_integer
from stereocal.verify.function_cases import CASES, FunctionCase

Array = NDArray[Any]


@dataclass(frozen=True)
class FunctionReport:
    """What :func:`check_function` found.

    Attributes
    ----------
    kernel : str
        What the function claims to be.
    agrees : bool
        Whether every case lies within the tolerance.
    difference : float
        The largest difference over all cases, in `unit`; infinite if a result had the wrong shape or was not finite
        where the reference is.
    tolerance : float
        The largest difference that counts as equal, in `unit`.
    unit : str
        Of difference and tolerance.
    cases : int
        How many inputs were tried.
    worst_input : tuple
        The arguments of the case that differed most, to be called again in a debugger.
    explanation : str
        One or two sentences: the agreement, or what seems wrong.
    """

    kernel: str
    agrees: bool
    difference: float
    tolerance: float
    unit: str
    cases: int
    worst_input: tuple[Any, ...]
    explanation: str

    def __str__(self) -> str:
        verdict = "agrees" if self.agrees else "DIFFERS"
        measured = f"largest difference {self.difference:.3g} {self.unit}, tolerance {self.tolerance:.3g}"
        return f"{self.kernel}: {verdict} ({measured}, {self.cases} cases). {self.explanation}"


def check_function(
    kernel: str, function: Callable[..., Any], *, against: str = "stereocal", cases: int = 12, seed: int = 0
) -> FunctionReport:
    """Compare a function with the reference on drawn inputs, and name the mistake where they part.

    Parameters
    ----------
    kernel : str
        What the function claims to be: a key of :data:`~stereocal.verify.function_cases.CASES`. Its entry there tells
        the arguments that the function is called with.
    function : callable
        The function under test.
    against : {"stereocal", "opencv"}
        Whose answer counts as right.
    cases : int
        How many inputs are drawn.
    seed : int
        Of the inputs.

    Returns
    -------
    FunctionReport

    Raises
    ------
    InputError
        If there is no such kernel.

    Examples
    --------
    >>> import stereocal as sc
    >>> print(check_function("rotation_matrix", sc.rotation_matrix, against="opencv").agrees)
    True
    """
    case = CASES[require_choice(kernel, tuple(CASES), "kernel")]
    require_choice(against, ("stereocal", "opencv"), "against")
    tolerance = case.tolerance if against == "stereocal" or case.opencv_tolerance is None else case.opencv_tolerance
    count = require_integer(cases, "cases", minimum=1)
    oracle = case.stereocal if against == "stereocal" else case.opencv
    rng = np.random.default_rng(seed)
    worst, worst_input, worst_pair = -1.0, (), None
    for _ in range(count):
        arguments = case.draw(rng)
        expected = np.asarray(oracle(*arguments))
        try:
            found = np.asarray(function(*[np.copy(a) if isinstance(a, np.ndarray) else a for a in arguments]))
        except Exception as error:  # the function under test is a stranger's: its error is the finding
            message = f"It raised {type(error).__name__}: {error}. It is called as {kernel}({case.arguments})."
            return FunctionReport(kernel, False, np.inf, tolerance, case.unit, count, arguments, message)
        difference = _difference(found, expected, case)
        if difference > worst:
            worst, worst_input, worst_pair = difference, arguments, (found, expected)
    agrees = worst <= tolerance
    assert worst_pair is not None
    name = "this library's reference" if against == "stereocal" else "OpenCV"
    explanation = f"Equal to {name}." if agrees else _explain(*worst_pair, worst_input, case)
    return FunctionReport(kernel, agrees, worst, tolerance, case.unit, count, worst_input, explanation)


def _difference(found: Array, expected: Array, case: FunctionCase) -> float:
    """Largest difference in the case's unit; infinite for a wrong shape or for NaN where there should be none."""
    if found.shape != expected.shape or found.dtype.kind not in "biuf":
        return np.inf
    if found.size == 0:
        return 0.0
    return float(case.measure(found.astype(np.float64), expected.astype(np.float64)))


def _explain(found: Array, expected: Array, arguments: tuple[Any, ...], case: FunctionCase) -> str:
    """Name the mistake that explains the whole difference, or say where the difference is."""
    if found.shape != expected.shape:
        hint = " It looks transposed." if found.shape == expected.shape[::-1] else ""
        return f"It returned shape {found.shape}, but {expected.shape} is needed.{hint}"
    a, b = found.astype(np.float64), expected.astype(np.float64)
    for sentence, mistaken in case.mistakes:
        if _difference(np.asarray(mistaken(*arguments)), found, case) <= 10 * case.tolerance:
            return sentence
    for sentence, repaired in _usual_mistakes(a, b):
        if _difference(repaired, b, case) <= 10 * case.tolerance:
            return sentence
    if a.ndim == 2 and min(a.shape) > 12 and _difference(a[5:-5, 5:-5], b[5:-5, 5:-5], case) <= case.tolerance:
        return (
            "It differs within 5 pixels of the border only: another border rule (OpenCV reflects about the edge pixel)."
        )
    with np.errstate(all="ignore"):
        apart = np.nan_to_num(np.abs(a - b), nan=np.inf)
    where = np.unravel_index(int(np.argmax(apart)), apart.shape)
    share = float(np.mean(apart > case.tolerance * max(1.0, float(np.nanmax(np.abs(b))))))
    place = ", ".join(map(str, where))
    return f"{share:.0%} of the values differ; the worst is [{place}]: {a[where]:.6g} instead of {b[where]:.6g}."


def _usual_mistakes(a: Array, b: Array) -> list[tuple[str, Array]]:
    """Pairs of a sentence and what was found with that mistake undone."""
    tried: list[tuple[str, Array]] = []
    finite = np.isfinite(a) & np.isfinite(b)
    power = float(np.sum(a[finite] ** 2))
    if power > 0:
        factor = float(np.sum(a[finite] * b[finite])) / power
        tried.append((f"It is right up to a constant factor: multiply by {factor:.6g}.", a * factor))
    tried.append(("The sign is reversed.", -a))
    if a.ndim == 2 and a.shape[0] == a.shape[1]:
        tried.append(("It is transposed.", a.T))
    if a.ndim == 2 and a.shape[1] == 2:
        tried.append(("The columns x and y are swapped.", a[:, ::-1]))
        offset = np.mean((b - a)[finite.all(axis=1)], axis=0) if finite.all(axis=1).any() else np.zeros(2)
        tried.append((f"It is shifted by ({offset[0]:.4g}, {offset[1]:.4g}) everywhere: which pixel is 0?", a + offset))
    if a.ndim == 2 and min(a.shape) > 12:
        for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (-1, -1)):
            inside = np.array(b)
            inside[5:-5, 5:-5] = np.roll(a, (dy, dx), (0, 1))[5:-5, 5:-5]
            tried.append((f"It is shifted by {-dx} pixels in x and {-dy} in y.", inside))
    return tried
