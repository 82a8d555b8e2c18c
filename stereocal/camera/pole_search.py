"""Where the poles of a rational lens may lie: a search by linear algebra.

The radial curve of the rational model and its larger kin, f(s) = c(s) / q(s) with c and q of degree three in s = r²,
is a sum of partial fractions. Let the corners cover s = 0 … 1 and call u the inverse of a pole, 0 for one at infinity:

    q = (1 − u₁s)(1 − u₂s)(1 − u₃s),        f = 1 + e₁ φ₁ + e₂ φ₂ + e₃ φ₃,        φ = s / (1 − us),

where a u that comes m times has φ, φ², … φᵐ (so u = 0 three times is the polynomial s, s², s³). Given the poles, f is
**linear** in e. So the poles are all that an iteration can get wrong, and it does: a pole is drawn between two corners'
radii, past which it cannot go (F is infinite where a pole meets a corner), or towards s = 0, where f is no longer 1 at
the centre, the focal length makes up for that, and the coefficients grow without end. A mild lens needs no pole, every
place for one is about as good, and which of the many minima an iteration ends in is an accident.

Here it is left to none. Let r₀ be the residuals for e = 0, everything else as in a fit at hand, g_j the change that
term j makes to the pixels, and P the projection on what no other unknown (poses, K, tangential terms) can undo. To
first order

    min F = r₀ᵀ P r₀ − ρᵀ Γ⁻¹ ρ,        Γ_ij = g_iᵀ P g_j,        ρ_j = −g_jᵀ P r₀,

for any three terms. Γ and ρ are computed once, for a grid of poles and the poles that the fit at hand has, and all
triples are tried: some ten thousand systems of three equations, solved at once. The best ones that differ go on to the
iteration, which moves the poles to where they belong; its lowest optimum is the fit at hand of another such round.

A pole among the corners' radii makes a kink (``lens_doubts``) and is nothing that a lens has. So ``initialisation``
asks for this search only where the other starts have led to a kink or to coefficients without end: where the views say
nothing about poles, and the lowest F is all there is to go by.

Source: Golub and Pereyra, *The differentiation of pseudo-inverses and nonlinear least squares problems whose variables
separate* (1973), for the elimination of the unknowns that are linear; the search over the others is ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np
from numpy.polynomial import polynomial

from stereocal.base.checks import Float
from stereocal.camera.bundle import Bundle, BundleState, camera_jacobian, points_in_camera
from stereocal.camera.lens_doubts import squared_radii
from stereocal.camera.losses import loss_and_weight
from stereocal.camera.parameters import intrinsic_names

# Rows of θ: numerator and denominator, by rising powers of s.
RADIAL = ("k1", "k2", "k3", "k4", "k5", "k6")
# Poles tried: behind the centre, beyond the corners, and among them, evenly by radius and by its square. A pole farther
# than 4 draws as one at infinity does.
_BEHIND, _BEYOND = -np.geomspace(1e-3, 4, 12), 1 + np.geomspace(0.01, 4, 8)
_AMONG = np.union1d(np.linspace(0.04, 0.99, 18) ** 2, np.linspace(0.02, 0.97, 18))
# In this order neighbours draw alike, infinity between the far ones of both sides.
_INVERSES = np.sort(np.concatenate([1 / _BEHIND, [0.0], 1 / _BEYOND, 1 / _AMONG]))
# Triples each of whose poles is at most so many places from the other's lead to the same minimum.
_NEIGHBOURS = 2
# Views that the search looks at; more tell it nothing.
_ENOUGH_VIEWS = 40
# Poles with a smaller imaginary part are taken to be real.
_REAL = 1e-6
# What Γ, of unit diagonal, is taken to be known to.
_ROUNDING = 1e-11


def pole_starts(bundle: Bundle, state: BundleState, count: int) -> list[BundleState]:
    """Return the states whose poles promise the lowest F.

    Parameters
    ----------
    bundle : Bundle
        Of one camera, whose lens has k1 … k6, all free.
    state : BundleState
        The fit at hand.
    count : int
        How many starts at most.

    Returns
    -------
    list of BundleState
        `state` with other k1 … k6, the most promising first.
    """
    names = intrinsic_names(bundle.models[0])
    rows = [names.index(name) for name in RADIAL]
    s_max = float(squared_radii(bundle, state, 0).max())
    own = np.roots([1.0, *state.intrinsics[0][rows[3:]]]) * s_max  # of q(1/w) w³: inverse poles
    u = np.union1d(_INVERSES, own.real[np.abs(own.imag) < _REAL * np.abs(own)])
    gram, rho, norms = _normal_equations_of_terms(bundle, state, rows, u / s_max)
    states = []
    for poles in best_triples(gram, rho, count):
        terms = _terms(poles[None], len(u))
        e = _solve(gram, rho, terms)[0] / norms[terms]
        theta = state.intrinsics[0].copy()
        theta[rows] = rational_coefficients(u[poles] / s_max, e[0])
        states.append(replace(state, intrinsics=[theta]))
    return states


def rational_coefficients(u: Float, e: Float) -> Float:
    """Return k1, k2, k3, k4, k5, k6 of the curve f = 1 + Σ e_j φ_j.

    Parameters
    ----------
    u : ndarray of shape (3,)
        Inverse poles, equal ones side by side; the m-th of its kind stands for φᵐ.
    e : ndarray of shape (3,)
        Factors.

    Returns
    -------
    ndarray of shape (6,)
    """
    factors = [np.array([1.0, -of_pole]) for of_pole in u]
    q = polynomial.polymul(polynomial.polymul(factors[0], factors[1]), factors[2])
    c = q
    for j in range(3):
        power = 1 + sum(u[i] == u[j] for i in range(j))
        same = [i for i in range(3) if u[i] == u[j]][:power]
        numerator = np.zeros(power + 1)
        numerator[power] = e[j]
        for i in range(3):
            numerator = numerator if i in same else polynomial.polymul(numerator, factors[i])
        c = polynomial.polyadd(c, numerator)
    k = np.zeros((2, 4))
    k[0, : len(c)], k[1, : len(q)] = c, q
    return k[:, 1:].ravel()


def best_triples(gram: Float, rho: Float, count: int) -> list[np.ndarray]:
    """Return the triples of poles whose terms promise most, ρᵀ Γ⁻¹ ρ.

    Parameters
    ----------
    gram : ndarray of shape (3n, 3n)
        Γ of φ for each of n poles, then of φ², then of φ³; of unit diagonal.
    rho : ndarray of shape (3n,)
        ρ.
    count : int
        How many at most, no two of them neighbours.

    Returns
    -------
    list of ndarray of three integers
        Which poles, in order; the most promising triple first.
    """
    n = len(rho) // 3
    triples = np.array(list(combinations_with_replacement(range(n), 3)))
    promise = _solve(gram, rho, _terms(triples, n))[1]
    chosen: list[np.ndarray] = []
    for i in np.argsort(-promise):
        if len(chosen) == count:
            break
        if all(np.abs(triples[i] - other).max() > _NEIGHBOURS for other in chosen):
            chosen.append(triples[i])
    return chosen


def _terms(triples: np.ndarray, n: int) -> np.ndarray:
    """Which terms (m, 3) belong to triples of n poles (m, 3) in order: a pole that comes again has its next power."""
    again, thrice = triples[:, 1] == triples[:, 0], triples[:, 2] == triples[:, 1]
    powers = np.stack([np.zeros_like(again), again, np.where(thrice, again + 1, 0)], axis=1)
    return triples + n * powers


def _solve(gram: Float, rho: Float, terms: np.ndarray) -> tuple[Float, Float]:
    """Γ⁻¹ ρ (m, 3) and ρᵀ Γ⁻¹ ρ (m,) of three terms each (m, 3)."""
    A = gram[terms[:, :, None], terms[:, None, :]] + _ROUNDING * np.eye(3)
    e = np.linalg.solve(A, rho[terms][:, :, None])[:, :, 0]
    return np.asarray(e), np.asarray(np.einsum("ni,ni->n", e, rho[terms]))


def _normal_equations_of_terms(
    bundle: Bundle, state: BundleState, rows: Sequence[int], u: Float
) -> tuple[Float, Float, Float]:
    """Γ and ρ of φ, φ², φ³ of all inverse poles u, each term scaled to Γ_jj = 1, and what it was divided by."""
    bundle, state = _some_views(bundle, state)
    theta = state.intrinsics[0]
    r, J, J_pose = camera_jacobian(replace(bundle, G=bundle.G[:, ~bundle.G[list(rows)].any(axis=0)]), state, 0)
    X_c = points_in_camera(bundle, state, 0)[2]
    x = X_c[:, :2] / X_c[:, 2:]
    s = np.sum(x * x, axis=1, keepdims=True)
    below = 1 - s * u
    phi = s / np.where(below == 0, np.finfo(float).eps, below)
    x = x @ np.array([[theta[0], theta[4]], [0, theta[1]]]).T
    c, q = (1 + s * (a + s * (b + s * c)) for a, b, c in theta[np.reshape(rows, (2, 3))])
    r_0 = r - x * (c / q - 1)
    g = x[:, :, None] * np.hstack([phi, phi**2, phi**3])[:, None, :]
    columns = np.concatenate([J, g, r_0[:, :, None]], axis=2)
    if bundle.whitening is not None:
        r = np.einsum("nij,nj->ni", bundle.whitening, r)
        columns, J_pose = bundle.whitening @ columns, bundle.whitening @ J_pose
    weight = np.sqrt(loss_and_weight(np.sum(r**2, axis=1), bundle.loss, bundle.loss_scale)[1])[:, None, None]
    columns, J_pose = columns * weight, J_pose * weight
    projected = []
    for a, b in zip(bundle.offsets[:-1], bundle.offsets[1:], strict=True):
        of_view, Q = columns[a:b].reshape(-1, columns.shape[2]), np.linalg.qr(J_pose[a:b].reshape(-1, 6))[0]
        projected.append(of_view - Q @ (Q.T @ of_view))
    columns, others = np.concatenate(projected), J.shape[2]
    Q = np.linalg.qr(columns[:, :others])[0]
    columns = columns[:, others:] - Q @ (Q.T @ columns[:, others:])
    norms = np.linalg.norm(columns[:, :-1], axis=0)
    g = columns[:, :-1] / norms
    return g.T @ g, -g.T @ columns[:, -1], norms


def _some_views(bundle: Bundle, state: BundleState) -> tuple[Bundle, BundleState]:
    """Of many views some, spread over all, with their poses."""
    every = -(-bundle.view_count // _ENOUGH_VIEWS)
    if every == 1:
        return bundle, state
    counts, chosen = np.diff(bundle.offsets), bundle.view_of_block % every == 0
    rows, views = np.repeat(chosen, counts), bundle.view_of_block[chosen]
    part = replace(
        bundle, points=bundle.points[rows], measured=bundle.measured[rows],
        offsets=np.concatenate([[0], counts[chosen].cumsum()]), camera_of_block=bundle.camera_of_block[chosen],
        view_of_block=np.arange(len(views)), view_count=len(views),
        whitening=None if bundle.whitening is None else bundle.whitening[rows],
    )  # fmt: skip
    return part, replace(state, R_views=state.R_views[views], t_views=state.t_views[views])
