"""What a distortion model is: a map of the normalised image plane, with its parameters, inverse and derivatives.

A point X in camera coordinates falls on the plane z = 1 at x = (X/Z, Y/Z), where an ideal lens would draw it. A real
lens draws it at x_d; a distortion model is the map x → x_d(x; k), and pixels follow from p = K (x_d, 1).

The literature writes the map in two directions:

- **forward** models give x_d explicitly (Brown, Kannala–Brandt, …): projecting is a formula, undistorting an iteration;
- **backward** models give the ideal point x_u of a distorted one explicitly (division, field of view, …, all of the
  paper's [eq 15-18] as printed): undistorting is a formula.

Both bear one face here, :class:`DistortionModel`. For backward models u = g(x_d; k) the derivatives of the inverse
follow from g(x_d(x; k); k) = x by the implicit function theorem: with G = ∂g/∂x_d,

    ∂x_d/∂x = G⁻¹,        ∂x_d/∂k = −G⁻¹ ∂g/∂k.

Neither kind is asked to know where it folds. The domain, the star-shaped region about the centre in which the map
keeps its orientation (``distortion_inverse``), is enforced here, for both: outside, undistorting is NaN, never a point.

**To add a model**: subclass :class:`ForwardModel` (give `distort` and `jacobians`) or :class:`BackwardModel` (give
`undistort_jacobians`), state the order of the parameters in its docstring and `parameter_names`, and put one instance
into ``distortion.MODELS``. The tests pick it up from there: derivatives against central differences, the round trip,
the domain, and calibration of synthetic views.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from stereocal.base.checks import Float


class DistortionModel(ABC):
    """A map x → x_d(x; k) of the normalised image plane.

    Attributes
    ----------
    name : str
        As the user types it.
    parameter_names : tuple of str
        Names of k, in order.
    fixed_by_default : tuple of str
        Parameters that a calibration holds unless told otherwise, because others already do their work.
    """

    name: str = ""
    parameter_names: tuple[str, ...] = ()
    fixed_by_default: tuple[str, ...] = ()

    @property
    def parameter_count(self) -> int:
        """Length of k."""
        return len(self.parameter_names)

    def neutral(self) -> Float:
        """Return the k of a lens without distortion."""
        return np.zeros(self.parameter_count)

    def start(self) -> Float:
        """Return the k that a calibration begins with; differs from neutral where ∂x_d/∂k vanishes there."""
        return self.neutral()

    def stuck(self, k: Float) -> tuple[str, ...]:
        """Return the parameters that do not change the map to first order near k: a bound no step leads away from.

        The bound is their neutral value.
        """
        return ()

    @abstractmethod
    def distort(self, x: Float, k: Float) -> Float:
        """Return x_d (N, 2) of ideal points x (N, 2); NaN where the model has no answer."""

    @abstractmethod
    def undistort(self, x_d: Float, k: Float) -> Float:
        """Return the ideal points x (N, 2) of distorted ones; NaN where the model has no answer."""

    def distort_compiled(self, x: Float, k: Float) -> Float:
        """Return the same as `distort`, from a kernel where the model has one (``distortion_inverse_kernels``)."""
        return self.distort(x, k)

    def undistort_compiled(self, x_d: Float, k: Float) -> Float:
        """Return the same as `undistort`, from a kernel where the model has one (``distortion_inverse_kernels``)."""
        return self.undistort(x_d, k)

    @abstractmethod
    def jacobians(self, x: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return x_d (N, 2), ∂x_d/∂x (N, 2, 2) and ∂x_d/∂k (N, 2, n)."""

    def jacobians_compiled(self, x: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return the same as `jacobians`, from a kernel where the model has one."""
        return self.jacobians(x, k)


class ForwardModel(DistortionModel):
    """A model that gives x_d explicitly; the inverse is found by damped Newton iteration inside its domain."""

    def undistort(self, x_d: Float, k: Float) -> Float:
        """Return x with distort(x, k) = x_d, to 1e-12; NaN outside the region where the model can be undone."""
        from stereocal.camera.distortion_inverse import invert_map

        return invert_map(lambda x: self.jacobians(x, k)[:2], x_d)


class BackwardModel(DistortionModel):
    """A model that gives the ideal point x_u = g(x_d; k) explicitly, as a formula that need not know where it folds."""

    def undistort(self, x_d: Float, k: Float) -> Float:
        """Return x_u = g(x_d; k); NaN outside the region where the model can be undone.

        A model overrides it where it knows that region in closed form.
        """
        from stereocal.camera.distortion_inverse import inside_domain

        with np.errstate(all="ignore"):
            x_u = self.undistort_slope(x_d, k)[0]
            inside = inside_domain(lambda x: self.undistort_slope(x, k), x_d, np.asarray(np.isfinite(x_u).all(axis=1)))
        return np.where(inside[:, None], x_u, np.nan)

    @abstractmethod
    def undistort_jacobians(self, x_d: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return x_u (N, 2), ∂x_u/∂x_d (N, 2, 2) and ∂x_u/∂k (N, 2, n)."""

    def undistort_slope(self, x_d: Float, k: Float) -> tuple[Float, Float]:
        """Return x_u and ∂x_u/∂x_d alone, which is what the inversion asks for, many times."""
        return self.undistort_jacobians(x_d, k)[:2]

    def distort(self, x: Float, k: Float) -> Float:
        """Return x_d with undistort(x_d, k) = x, to 1e-12; NaN outside the region where the model can be undone."""
        from stereocal.camera.distortion_inverse import invert_map

        return invert_map(lambda x_d: self.undistort_slope(x_d, k), x)

    def jacobians(self, x: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return x_d, ∂x_d/∂x = G⁻¹ and ∂x_d/∂k = −G⁻¹ ∂g/∂k."""
        x_d = self.distort_compiled(x, k)
        _, G, g_k = self.undistort_jacobians(x_d, k)
        a, b, c, d = G[:, 0, 0], G[:, 0, 1], G[:, 1, 0], G[:, 1, 1]
        with np.errstate(all="ignore"):
            inverse = np.stack([np.stack([d, -b], -1), np.stack([-c, a], -1)], -2) / (a * d - b * c)[:, None, None]
            return x_d, inverse, -inverse @ g_k
