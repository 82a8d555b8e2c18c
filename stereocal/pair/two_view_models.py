"""F in seven numbers and a motion in five: the two families of matrices among which a refinement looks.

Nine entries are too many: a step in them leaves the matrices of rank 2 (F) or with singular values (1, 1, 0) (E). Both
families are written as a product that can be *turned*, and so stay what they are after any step:

**F**, Bartoli and Sturm (2004): F = T₂ᵀ U diag(1, s, 0) Vᵀ T₁ with rotations U, V; T₁, T₂ normalise the points;

    U ← exp([α]ₓ) U,    V ← exp([β]ₓ) V,    s ← s + σ        seven numbers (α, β, σ),

**a motion**: F = K'⁻ᵀ [t]ₓ R K⁻¹ with a rotation R and a direction t, b₁, b₂ orthogonal to it and one another;

    R ← exp([ω]ₓ) R,    t ← (t + τ₁ b₁ + τ₂ b₂) / ‖…‖        five numbers (ω, τ).

At step zero the derivatives are the products with [e]ₓ (of the rotations), diag(0, 1, 0) and [b]ₓ in place. Scale does
not matter to any distance; ‖F‖ is kept 1.

Sources: A. Bartoli, P. Sturm, *Nonlinear estimation of the fundamental matrix with minimal parameters*, PAMI 26 (2004).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.homogeneous import cross_matrix
from stereocal.base.rotations import rotation_matrix

_AXES = np.eye(3)
_QUARTER_TURN = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])


@dataclass(frozen=True, eq=False)
class TwoViewModel:
    """A member of one of the two families.

    Attributes
    ----------
    state : ndarray of shape (7, 3)
        Rows U, V and (1, s, 0) of an F; rows R, then t, b₁, b₂, then zeros of a motion.
    freedom : int
        Seven or five.
    to_right, to_left : ndarray of shape (3, 3)
        T₂ and T₁, or K'⁻¹ and K⁻¹: what stands right and left of the product, in pixels.
    """

    state: Float
    freedom: int
    to_right: Float
    to_left: Float

    @property
    def R(self) -> Float:
        """The rotation of a motion."""
        return self.state[:3]

    @property
    def t(self) -> Float:
        """The direction of a motion."""
        return self.state[3]

    @property
    def F(self) -> Float:
        """The matrix in pixels, ‖F‖ = 1."""
        F = self._in_pixels(self._product(self.state[:3], self.state[3:6]))
        return np.asarray(F / np.linalg.norm(F))

    @property
    def core(self) -> Float:
        """The matrix without T₂ and T₁, or K'⁻¹ and K⁻¹, of norm 1: the coordinates in which its entries compare."""
        core = self._product(self.state[:3], self.state[3:6])
        return np.asarray(core / np.linalg.norm(core))

    def _product(self, U: Float, V: Float) -> Float:
        """U diag(1, s, 0) Vᵀ, or [t]ₓ R."""
        return U @ np.diag(self.state[6]) @ V.T if self.freedom == 7 else cross_matrix(V[0]) @ U

    def _in_pixels(self, middle: Float) -> Float:
        return np.asarray(self.to_right.T @ middle @ self.to_left)

    def derivatives(self) -> Float:
        """Return ∂F/∂(the step) at step zero, at the scale of :attr:`F`.

        Returns
        -------
        ndarray of shape (freedom, 9)
        """
        U, V = self.state[:3], self.state[3:6]
        turns = [cross_matrix(e) for e in _AXES]
        if self.freedom == 7:
            moved = [self._product(turn @ U, V) for turn in turns] + [self._product(U, turn @ V) for turn in turns]
            moved.append(U @ np.diag([0.0, 1, 0]) @ V.T)
        else:
            moved = [self._product(turn @ U, V) for turn in turns] + [cross_matrix(b) @ U for b in V[1:]]
        scale = 1 / np.linalg.norm(self._in_pixels(self._product(U, V)))
        return np.array([scale * self._in_pixels(one).ravel() for one in moved])

    def advanced(self, step: Float) -> TwoViewModel:
        """Return the model after a step.

        Parameters
        ----------
        step : ndarray of shape (freedom,)

        Returns
        -------
        TwoViewModel
        """
        state = self.state.copy()
        state[:3] = rotation_matrix(step[:3]) @ state[:3]
        if self.freedom == 7:
            state[3:6] = rotation_matrix(step[3:6]) @ state[3:6]
            state[6, 1] += step[6]
        else:
            t = state[3] + step[3] * state[4] + step[4] * state[5]
            t = t / np.linalg.norm(t)
            b = state[4] - (state[4] @ t) * t
            b = b / np.linalg.norm(b)
            state[3:6] = t, b, np.cross(t, b)
        return replace(self, state=state)


def fundamental_model(core: Float, to_right: Float, to_left: Float) -> TwoViewModel:
    """Return the F = T₂ᵀ core T₁ of rank 2, or the one nearest to it, as a model of seven numbers.

    Parameters
    ----------
    core : ndarray of shape (3, 3)
        F between normalised points.
    to_right, to_left : ndarray of shape (3, 3)
        The similarities T₂ and T₁ that normalise the points.

    Returns
    -------
    TwoViewModel
    """
    U, s, V = _svd_of_rotations(core)
    state = np.zeros((7, 3))
    state[:3], state[3:6], state[6, 0], state[6, 1] = U, V, 1.0, s[1] / s[0]
    return TwoViewModel(state, 7, to_right, to_left)


def motion_model(R: Float, t: Float, inverse_right: Float, inverse_left: Float) -> TwoViewModel:
    """Return a motion as a model of five numbers.

    Parameters
    ----------
    R : ndarray of shape (3, 3)
    t : ndarray of shape (3,)
        Unit vector.
    inverse_right, inverse_left : ndarray of shape (3, 3)
        K'⁻¹ and K⁻¹.

    Returns
    -------
    TwoViewModel
    """
    turn = cross_matrix(t)
    first = turn[:, np.argmin(np.abs(t))]
    first = first / np.linalg.norm(first)
    state = np.zeros((7, 3))
    state[:3], state[3], state[4], state[5] = R, t, first, turn @ first
    return TwoViewModel(state, 5, inverse_right, inverse_left)


def essential_model(core: Float, inverse_right: Float, inverse_left: Float) -> TwoViewModel:
    """Return one of the four motions of the essential matrix nearest to `core`: they share one F = K'⁻ᵀ E K⁻¹.

    Parameters
    ----------
    core : ndarray of shape (3, 3)
        E, between rays.
    inverse_right, inverse_left : ndarray of shape (3, 3)
        K'⁻¹ and K⁻¹.

    Returns
    -------
    TwoViewModel
    """
    U, _, V = _svd_of_rotations(core)
    return motion_model(U @ _QUARTER_TURN @ V.T, U[:, 2], inverse_right, inverse_left)


def _svd_of_rotations(A: Float) -> tuple[Float, Float, Float]:
    """A ~ U diag(s) Vᵀ up to sign, U and V rotations."""
    U, s, Vt = np.linalg.svd(A)
    return U * np.linalg.det(U), s, Vt.T * np.linalg.det(Vt)
