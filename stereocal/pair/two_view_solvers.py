"""Fundamental and essential matrices from the least points: eight, seven or five.

A match gives one linear equation in the nine entries f of F (row by row): x'ᵀ F x = aᵀ f = 0 with a = x' ⊗ x. Nine
entries up to scale are eight unknowns, det F = 0 leaves seven, and an essential matrix, which is a rotation and a
direction, five. So there are three solvers:

**Eight points** (Hartley, 1997): f is the right singular vector of the smallest singular value of A; then the nearest
matrix of rank 2 is taken. It is linear, takes any number N ≥ 8 of points, and lives by *normalisation*: without moving
the centroid to 0 and the mean distance to √2 the columns of A differ by a factor 10⁵ and the answer by pixels.

**Seven points**: A has a two-dimensional null space, F = z F₁ + (1 − z) F₂, and det F = 0 is a cubic in z: one or three
real solutions, each exactly of rank 2. The fewest points mean the fewest outliers in a sample.

**Five points** (Nistér, 2004; Stewénius, Engels, Nistér, 2006): rays, not pixels. A has a four-dimensional null space,
E = x E₁ + y E₂ + z E₃ + E₄, and an essential matrix satisfies

    det E = 0,      2 E Eᵀ E − trace(E Eᵀ) E = 0,

ten cubic equations in x, y, z. Ordered by the twenty monomials of degree ≤ 3, elimination expresses the ten of degree 3
by the ten lower ones; then multiplying by x is a 10 × 10 matrix on the lower monomials, whose eigenvectors are their
values at the solutions (at most ten). Unlike the others it needs no scene depth: a plane will do.

All three take *stacks* of samples and work on them at once, because a robust fit asks for hundreds;
:func:`minimal_models` takes the compiled twins of the last two, which reach the same solutions by other ways.

Sources: R. Hartley, *In defense of the eight-point algorithm*, PAMI 19 (1997); Hartley and Zisserman (2004), chapter
11; D. Nistér, *An efficient solution to the five-point relative pose problem*, PAMI 26 (2004); H. Stewénius, C. Engels,
D. Nistér, *Recent developments on direct relative orientation*, ISPRS 60 (2006).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError

Indices = NDArray[np.int64]


def normalizing_transform(points: Float) -> Float:
    """Return the similarity that moves the points' centroid to 0 and their mean distance from it to √2.

    Parameters
    ----------
    points : ndarray of shape (N, 2)

    Returns
    -------
    ndarray of shape (3, 3)

    Raises
    ------
    DegenerateGeometryError
        If all points are one point.
    """
    centre = points.mean(axis=0)
    distance = float(np.mean(np.linalg.norm(points - centre, axis=1)))
    if distance <= 1e-12 * (1 + np.abs(centre).max()):
        raise DegenerateGeometryError("all points are at the same place; matches must be spread over the picture")
    s = np.sqrt(2) / distance
    return np.array([[s, 0, -s * centre[0]], [0, s, -s * centre[1]], [0, 0, 1]])


def epipolar_equations(x: Float, xp: Float) -> Float:
    """Return the rows a = x' ⊗ x of the linear system a·f = 0.

    Parameters
    ----------
    x, xp : ndarray of shape (..., N, 3)
        Homogeneous points of the left and of the right picture.

    Returns
    -------
    ndarray of shape (..., N, 9)
    """
    return np.asarray((xp[..., :, None] * x[..., None, :]).reshape(*x.shape[:-1], 9))


def minimal_models(x: Float, xp: Float, samples: Indices, *, backend: str = "numba") -> Float:
    """Return all models through each sample of matches: F through seven, E through five.

    Parameters
    ----------
    x, xp : ndarray of shape (N, 3)
        Homogeneous points of the left and of the right picture: normalised for seven, rays for five.
    samples : ndarray of shape (B, s), int
        Indices of the matches of each sample, s = 5 or 7.
    backend : {"numba", "numpy"}
        The compiled kernels, or :func:`seven_point` and :func:`five_point`.

    Returns
    -------
    ndarray of shape (M, 9)
        Row by row, of norm 1.
    """
    draws, size = samples.shape
    if backend == "numpy":
        models, _ = (five_point if size == 5 else seven_point)(x[samples], xp[samples])
        return models.reshape(-1, 9)
    from stereocal.pair.two_view_solvers_kernels import five_points, seven_points

    room = np.empty(((10 if size == 5 else 3) * draws, 9))
    return room[: (five_points if size == 5 else seven_points)(x, xp, samples, room)]


def eight_point(x: Float, xp: Float, weights: Float | None = None) -> Float:
    """Return the rank-2 matrix nearest to the least-squares solution of x'ᵀ F x = 0, ‖F‖ = 1.

    Parameters
    ----------
    x, xp : ndarray of shape (..., N, 3)
        Homogeneous points, already normalised; N ≥ 8.
    weights : ndarray of shape (..., N), optional
        Of each equation.

    Returns
    -------
    ndarray of shape (..., 3, 3)
    """
    A = epipolar_equations(x, xp)
    if weights is not None:
        A = A * weights[..., None]
    f = np.linalg.svd(A, full_matrices=True)[2][..., 8, :]
    U, s, Vt = np.linalg.svd(f.reshape(*f.shape[:-1], 3, 3))
    s[..., 2] = 0
    return np.asarray((U * s[..., None, :]) @ Vt)


def seven_point(x: Float, xp: Float) -> tuple[Float, Indices]:
    """Return all F of rank 2 through seven pairs: roots z of det(z F₁ + (1 − z) F₂) = 0.

    Parameters
    ----------
    x, xp : ndarray of shape (B, 7, 3)
        Homogeneous points, normalised.

    Returns
    -------
    F : ndarray of shape (M, 3, 3)
        Between one and three a sample.
    sample : ndarray of shape (M,), int
        Which sample each belongs to.
    """
    null = np.linalg.svd(epipolar_equations(x, xp), full_matrices=True)[2][:, 7:, :]
    F1, F2 = null[:, 0].reshape(-1, 3, 3), null[:, 1].reshape(-1, 3, 3)
    # a cubic is known by four values; these give its coefficients
    d0, d1 = np.linalg.det(F2), np.linalg.det(F1)
    dm, d2 = np.linalg.det(2 * F2 - F1), np.linalg.det(2 * F1 - F2)
    c0, even = d0, (d1 + dm) / 2 - d0
    c3 = (d2 - d0 - 4 * even - (d1 - dm)) / 6
    c1 = (d1 - dm) / 2 - c3
    sample, z = real_cubic_roots(np.stack([c3, even, c1, c0], axis=1))
    F = z[:, None, None] * F1[sample] + (1 - z)[:, None, None] * F2[sample]
    return np.asarray(F / np.linalg.norm(F, axis=(1, 2), keepdims=True)), sample


def real_cubic_roots(coefficients: Float) -> tuple[Indices, Float]:
    """Return the real roots of cubics c₃z³ + c₂z² + c₁z + c₀, by the eigenvalues of their companion matrices.

    Parameters
    ----------
    coefficients : ndarray of shape (B, 4)
        Highest first.

    Returns
    -------
    which : ndarray of shape (M,), int
        The polynomial that each root belongs to.
    roots : ndarray of shape (M,)
    """
    leading = coefficients[:, :1]
    floor = 1e-14 * np.abs(coefficients).max(axis=1, keepdims=True) + 1e-300
    monic = coefficients[:, 1:] / np.where(np.abs(leading) < floor, floor, leading)
    companion = np.zeros((len(monic), 3, 3))
    companion[:, 0] = -monic
    companion[:, 1, 0] = companion[:, 2, 1] = 1
    roots = np.linalg.eigvals(companion)
    which, column = np.nonzero(np.abs(roots.imag) <= 1e-9 * (1 + np.abs(roots.real)))
    return which, np.asarray(roots.real[which, column])


# The twenty monomials of degree ≤ 3 in (x, y, z), as exponents: ten of degree 3 first, then the ten lower ones.
_MONOMIALS = [
    (3, 0, 0), (2, 1, 0), (2, 0, 1), (1, 2, 0), (1, 1, 1), (1, 0, 2), (0, 3, 0), (0, 2, 1), (0, 1, 2), (0, 0, 3),
    (2, 0, 0), (1, 1, 0), (1, 0, 1), (0, 2, 0), (0, 1, 1), (0, 0, 2), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0),
]  # fmt: skip
_INDEX = {monomial: i for i, monomial in enumerate(_MONOMIALS)}
_UNITS = [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0)]


def _product_table() -> Float:
    """Return the (4, 4, 4, 20) table that takes a product of three linear forms in (x, y, z, 1) to its monomials."""
    table = np.zeros((4, 4, 4, 20))
    for i in range(4):
        for j in range(4):
            for k in range(4):
                a, b, c = np.sum([_UNITS[i], _UNITS[j], _UNITS[k]], axis=0).tolist()
                table[i, j, k, _INDEX[a, b, c]] = 1
    return table


_PRODUCTS = _product_table().reshape(64, 20)
_LEVI_CIVITA = np.zeros((3, 3, 3))
for _i, _j, _k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
    _LEVI_CIVITA[_i, _j, _k], _LEVI_CIVITA[_i, _k, _j] = 1.0, -1.0


def five_point(x: Float, xp: Float) -> tuple[Float, Indices]:
    """Return all essential matrices through five pairs of rays.

    Parameters
    ----------
    x, xp : ndarray of shape (B, 5, 3)
        Rays of the left and of the right camera, z = 1.

    Returns
    -------
    E : ndarray of shape (M, 3, 3)
        Up to ten a sample, ‖E‖ = 1.
    sample : ndarray of shape (M,), int
        Which sample each belongs to.
    """
    null = np.linalg.svd(epipolar_equations(x, xp), full_matrices=True)[2][:, 5:, :]
    basis = null.reshape(-1, 4, 3, 3)
    equations = _essential_constraints(basis)
    head, tail = equations[:, :, :10], equations[:, :, 10:]
    solvable = np.linalg.cond(head) < 1e14
    reduced = np.linalg.solve(np.where(solvable[:, None, None], head, np.eye(10)), tail)
    # multiplication by x on (x², xy, xz, y², yz, z², x, y, z, 1): products of degree 3 are replaced by the reduced ones
    action = np.zeros((len(basis), 10, 10))
    for row, monomial in enumerate(_MONOMIALS[10:]):
        target = _INDEX[(monomial[0] + 1, monomial[1], monomial[2])]
        if target < 10:
            action[:, row] = -reduced[:, target]
        else:
            action[:, row, target - 10] = 1
    values, vectors = np.linalg.eig(action)
    one = vectors[:, 9, :]
    real = (np.abs(values.imag) <= 1e-8 * (1 + np.abs(values.real))) & (np.abs(one) > 1e-12) & solvable[:, None]
    sample, column = np.nonzero(real)
    xyz = (vectors[sample, 6:9, column] / one[sample, column][:, None]).real
    E = np.einsum("mk,mkij->mij", np.column_stack([xyz, np.ones(len(xyz))]), basis[sample])
    return np.asarray(E / np.linalg.norm(E, axis=(1, 2), keepdims=True)), sample


def _essential_constraints(basis: Float) -> Float:
    """Return the ten cubic constraints on E = x E₁ + y E₂ + z E₃ + E₄ as rows over the twenty monomials.

    Parameters
    ----------
    basis : ndarray of shape (B, 4, 3, 3)

    Returns
    -------
    ndarray of shape (B, 10, 20)
    """
    count = len(basis)
    gram = np.einsum("bpim,bqjm->bpqij", basis, basis)
    cubic = 2 * np.einsum("bpqim,brmj->bpqrij", gram, basis)
    cubic -= np.einsum("bpqmm,brij->bpqrij", gram, basis)
    trace = np.einsum("bsij,st->bijt", cubic.reshape(count, 64, 3, 3), _PRODUCTS).reshape(count, 9, 20)
    cross = np.einsum("abc,npb,nqc->npqa", _LEVI_CIVITA, basis[:, :, 1], basis[:, :, 2])
    volume = np.einsum("nra,npqa->nrpq", basis[:, :, 0], cross).reshape(count, 64)
    return np.concatenate([trace, (volume @ _PRODUCTS)[:, None, :]], axis=1)
