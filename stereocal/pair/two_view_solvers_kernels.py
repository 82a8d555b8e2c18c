# mypy: allow-untyped-defs
"""Minimal solvers, compiled: F from seven points and E from five, for stacks of samples.

The equations are those of ``two_view_solvers``, the twin; the numerical methods are others, each chosen for its cost on
problems as small as these:

- **Null space** by Gauss–Jordan elimination with complete pivoting instead of the singular value decomposition: with
  the pivot columns reduced to the identity, [I | C] f = 0, the free entries of f are chosen one at a time. The basis is
  another one of the same space, which changes the unknowns x, y, z and no solution.
- **Seven points**: det(F₂ + z G), G = F₁ − F₂, is the cubic det F₂ + z tr(adj(F₂) G) + z² tr(adj(G) F₂) + z³ det G.
- **Five points** (Nistér, 2004): instead of the eigenvectors of the 10 × 10 action matrix, x and y are eliminated. With
  the monomials in the order of `CUBIC`, reduction of the ten equations leaves rows that begin with x²z, x², y²z, y²,
  xyz, xy. The first less z times the second, and so on, cancels what they begin with, so that three equations

      B(z) (x, y, 1)ᵀ = 0

  are left, with polynomials of z of degree 3, 3 and 4 in each row. det B(z) = 0 has degree ten; a real root z gives x
  and y by the null vector of B(z).
- **Real roots** between −1 and 1: the roots of the derivative, found first and in the same way, part the interval into
  pieces in which p is monotonic and has a root if its sign changes, which Newton's method finds, kept in the bracket by
  bisection. Roots beyond are reciprocals of those of the reversed polynomial.

Kernels take arrays and write into arrays; nothing is checked here.

Sources: D. Nistér, *An efficient solution to the five-point relative pose problem*, PAMI 26 (2004).
"""

from __future__ import annotations

import numpy as np
from numba import njit

INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}

# Powers of (x, y, z) of the monomials of degree ≤ 3 in Nistér's order, of those of degree ≤ 2, and of x, y, z, 1.
CUBIC = (
    (3, 0, 0), (0, 3, 0), (2, 1, 0), (1, 2, 0), (2, 0, 1), (2, 0, 0), (0, 2, 1), (0, 2, 0), (1, 1, 1), (1, 1, 0),
    (1, 0, 2), (1, 0, 1), (1, 0, 0), (0, 1, 2), (0, 1, 1), (0, 1, 0), (0, 0, 3), (0, 0, 2), (0, 0, 1), (0, 0, 0),
)  # fmt: skip
QUADRATIC = tuple(powers for powers in CUBIC if sum(powers) <= 2)
LINEAR = ((1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 0))
# Which quadratic monomial is the product of two linear ones, and which cubic one that of a quadratic and a linear one.
SQUARE_OF = np.array([[QUADRATIC.index(tuple(np.add(a, b).tolist())) for b in LINEAR] for a in LINEAR])
CUBE_OF = np.array([[CUBIC.index(tuple(np.add(a, b).tolist())) for b in LINEAR] for a in QUADRATIC])


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def null_space(A, basis):
    """Fill `basis` (9 − m, 9) with orthonormal vectors A f = 0 of A (m, 9), which is overwritten."""
    m = A.shape[0]
    order = np.arange(9)
    largest = 0.0
    for k in range(m):
        row, column, pivot = k, k, 0.0
        for i in range(k, m):
            for j in range(k, 9):
                if abs(A[i, j]) > pivot:
                    row, column, pivot = i, j, abs(A[i, j])
        largest = max(largest, pivot)
        if pivot <= 1e-13 * largest:  # the equations left say nothing new (matches of a plane): the unknown is free
            for i in range(k, m):
                for j in range(9):
                    A[i, j] = 0.0
            A[k, k] = 1.0
            continue
        for j in range(9):
            A[k, j], A[row, j] = A[row, j], A[k, j]
        for i in range(m):
            A[i, k], A[i, column] = A[i, column], A[i, k]
        order[k], order[column] = order[column], order[k]
        scale = 1.0 / A[k, k]
        for j in range(k, 9):
            A[k, j] *= scale
        for i in range(m):
            if i != k:
                factor = A[i, k]
                for j in range(k, 9):
                    A[i, j] -= factor * A[k, j]
    for free in range(9 - m):
        for j in range(9):
            basis[free, j] = 0.0
        for i in range(m):
            basis[free, order[i]] = -A[i, m + free]
        basis[free, order[m + free]] = 1.0
        # orthonormal, so that no unknown is on another scale than the others (Gram and Schmidt)
        for other in range(free):
            along = 0.0
            for j in range(9):
                along += basis[free, j] * basis[other, j]
            for j in range(9):
                basis[free, j] -= along * basis[other, j]
        length = 0.0
        for j in range(9):
            length += basis[free, j] ** 2
        for j in range(9):
            basis[free, j] /= np.sqrt(length)


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def value_of(c, degree, z):
    """Σ cₖ zᵏ."""
    value = c[degree]
    for k in range(degree - 1, -1, -1):
        value = value * z + c[k]
    return value


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def roots_within_one(c, degree, table, roots, found):
    """Append the real roots −1 ≤ z ≤ 1 of Σ cₖ zᵏ to `roots`, of which `found` are there; return how many are.

    `table` is scratch, one row for each derivative and one each for two generations of roots.
    """
    for k in range(degree + 1):
        table[degree, k] = c[k]
    for d in range(degree - 1, 0, -1):
        for k in range(d + 1):
            table[d, k] = (k + 1) * table[d + 1, k + 1]
    parts, ends = table[degree + 1], table[degree + 2]
    inside = 0
    for d in range(1, degree + 1):
        p, fine = table[d], 1e-15 if d == degree else 1e-8
        new = 0
        low = -1.0
        at_low = value_of(p, d, low)
        for piece in range(inside + 1):
            high = parts[piece] if piece < inside else 1.0
            at_high = value_of(p, d, high)
            if (at_low < 0) != (at_high < 0):
                a, b, z = low, high, 0.5 * (low + high)
                for _ in range(80):
                    value, slope = p[d], 0.0
                    for k in range(d - 1, -1, -1):
                        slope = slope * z + value
                        value = value * z + p[k]
                    if (value < 0) == (at_low < 0):
                        a = z
                    else:
                        b = z
                    step = value / slope
                    near = z - step
                    if not a <= near <= b:
                        near = 0.5 * (a + b)
                    moved = abs(near - z)
                    z = near
                    if moved <= fine:
                        break
                ends[new] = z
                new += 1
            low, at_low = high, at_high
        for k in range(new):
            parts[k] = ends[k]
        inside = new
    for k in range(inside):
        roots[found + k] = parts[k]
    return found + inside


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def real_roots(c, degree, table, turned, roots):
    """Fill `roots` with the real roots of Σ cₖ zᵏ and return how many there are."""
    size = 0.0
    for k in range(degree + 1):
        size = max(size, abs(c[k]))
    if not 0 < size < np.inf:
        return 0
    found = roots_within_one(c, degree, table, roots, 0)
    for k in range(degree + 1):
        turned[k] = c[degree - k]
    total = roots_within_one(turned, degree, table, roots, found)
    for k in range(found, total):
        roots[k] = 1.0 / roots[k] if abs(roots[k]) > 1e-12 else np.inf
    return total


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def fill_equations(x, xp, sample, A):
    """Rows a = x' ⊗ x of a sample's matches."""
    for row in range(len(sample)):
        n = sample[row]
        for i in range(3):
            for j in range(3):
                A[row, 3 * i + j] = xp[n, i] * x[n, j]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def determinant(A):
    """Of a 3 × 3 matrix as nine numbers row by row."""
    return A[0] * (A[4] * A[8] - A[5] * A[7]) - A[1] * (A[3] * A[8] - A[5] * A[6]) + A[2] * (A[3] * A[7] - A[4] * A[6])


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def adjugate_trace(A, G):
    """tr(adj(A) G): what det(A + z G) gains with z, to first order."""
    return (
        (A[4] * A[8] - A[5] * A[7]) * G[0] + (A[5] * A[6] - A[3] * A[8]) * G[1] + (A[3] * A[7] - A[4] * A[6]) * G[2]
        + (A[2] * A[7] - A[1] * A[8]) * G[3] + (A[0] * A[8] - A[2] * A[6]) * G[4] + (A[1] * A[6] - A[0] * A[7]) * G[5]
        + (A[1] * A[5] - A[2] * A[4]) * G[6] + (A[2] * A[3] - A[0] * A[5]) * G[7] + (A[0] * A[4] - A[1] * A[3]) * G[8]
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def seven_points(x, xp, samples, models):
    """Write all F through each sample of seven into `models` (≥ 3 B, 9), ‖F‖ = 1, and return how many there are."""
    A, basis, G = np.empty((7, 9)), np.empty((2, 9)), np.empty(9)
    c, turned, roots, table = np.empty(4), np.empty(4), np.empty(6), np.empty((6, 4))
    count = 0
    for sample in samples:
        fill_equations(x, xp, sample, A)
        null_space(A, basis)
        for k in range(9):
            G[k] = basis[0, k] - basis[1, k]
        c[0], c[1] = determinant(basis[1]), adjugate_trace(basis[1], G)
        c[2], c[3] = adjugate_trace(G, basis[1]), determinant(G)
        for n in range(min(real_roots(c, 3, table, turned, roots), 3)):
            z, length = roots[n], 0.0
            for k in range(9):
                models[count, k] = basis[1, k] + z * G[k] if abs(z) < np.inf else G[k]
                length += models[count, k] ** 2
            for k in range(9):
                models[count, k] /= np.sqrt(length)
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def essential_constraints(basis, gram, quadratic, M):
    """Fill M (10, 20) with 2 E EᵀE − tr(E Eᵀ) E = 0 and det E = 0 of E = x E₁ + y E₂ + z E₃ + E₄."""
    M[:] = 0.0
    gram[:] = 0.0
    for i in range(3):  # E Eᵀ
        for j in range(3):
            for m in range(3):
                for p in range(4):
                    for q in range(4):
                        gram[i, j, SQUARE_OF[p, q]] += basis[p, 3 * i + m] * basis[q, 3 * j + m]
    for k in range(10):
        trace = 0.5 * (gram[0, 0, k] + gram[1, 1, k] + gram[2, 2, k])
        for i in range(3):
            gram[i, i, k] -= trace
    for i in range(3):
        for j in range(3):
            for m in range(3):
                for k in range(10):
                    for p in range(4):
                        M[3 * i + j, CUBE_OF[k, p]] += gram[i, m, k] * basis[p, 3 * m + j]
    for m in range(3):  # det E = Σ E₁ₘ (E₂ × E₃)ₘ
        quadratic[:] = 0.0
        a, b = (m + 1) % 3, (m + 2) % 3
        for p in range(4):
            for q in range(4):
                quadratic[SQUARE_OF[p, q]] += basis[p, 3 + a] * basis[q, 6 + b] - basis[p, 3 + b] * basis[q, 6 + a]
        for k in range(10):
            for p in range(4):
                M[9, CUBE_OF[k, p]] += quadratic[k] * basis[p, m]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def reduce_constraints(M):
    """Eliminate until rows 4 to 9 begin with the monomials 4 to 9, each alone among these; tell if that can be done."""
    for k in range(10):
        row = k
        for i in range(k + 1, 10):
            if abs(M[i, k]) > abs(M[row, k]):
                row = i
        if abs(M[row, k]) < 1e-14:
            return False
        for j in range(k, 20):
            M[k, j], M[row, j] = M[row, j], M[k, j]
        scale = 1.0 / M[k, k]
        for j in range(k, 20):
            M[k, j] *= scale
        for i in range(4 if k >= 4 else k + 1, 10):
            if i != k:
                factor = M[i, k]
                for j in range(k, 20):
                    M[i, j] -= factor * M[k, j]
    return True


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def fill_hidden(M, B):
    """Fill B (3, 3, 5), ascending powers of z: row 4 + 2 r less z times row 5 + 2 r of M, for r = 0, 1, 2."""
    B[:] = 0.0
    for r in range(3):
        upper, lower = M[4 + 2 * r], M[5 + 2 * r]
        for column in range(2):  # the factors of x, and of y: (z², z, 1) in the columns 10, 11, 12 and 13, 14, 15
            for k in range(3):
                B[r, column, 2 - k] += upper[10 + 3 * column + k]
                B[r, column, 3 - k] -= lower[10 + 3 * column + k]
        for k in range(4):
            B[r, 2, 3 - k] += upper[16 + k]
            B[r, 2, 4 - k] -= lower[16 + k]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def hidden_determinant(B, minor, c):
    """Fill c (11,) with det B(z), expanded by its last column."""
    c[:] = 0.0
    for r in range(3):
        a, b = (r + 1) % 3, (r + 2) % 3
        minor[:] = 0.0
        for i in range(4):
            for j in range(4):
                minor[i + j] += B[a, 0, i] * B[b, 1, j] - B[b, 0, i] * B[a, 1, j]
        for i in range(7):
            for j in range(5):
                c[i + j] += minor[i] * B[r, 2, j]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def hidden_null_vector(B, z, at, v):
    """Fill v with the null vector of B(z), the longest product of two rows; tell if (x, y) = v₁₂ / v₃ is finite."""
    for r in range(3):
        for k in range(3):
            at[r, k] = value_of(B[r, k], 4, z)
    longest = 0.0
    for r in range(3):
        a, b = at[(r + 1) % 3], at[(r + 2) % 3]
        v0, v1, v2 = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        length = v0 * v0 + v1 * v1 + v2 * v2
        if length > longest:
            longest = length
            v[0], v[1], v[2] = v0, v1, v2
    return longest > 0 and v[2] * v[2] > 1e-24 * longest


@njit(cache=True, nogil=True, error_model="numpy")
def five_points(x, xp, samples, models):
    """Write all E through each sample of five rays into `models` (≥ 10 B, 9), ‖E‖ = 1, and return how many."""
    A, basis, gram, quadratic = np.empty((5, 9)), np.empty((4, 9)), np.empty((3, 3, 10)), np.empty(10)
    M, B, minor, c, turned = np.empty((10, 20)), np.empty((3, 3, 5)), np.empty(7), np.empty(11), np.empty(11)
    roots, table, at, v = np.empty(20), np.empty((13, 11)), np.empty((3, 3)), np.empty(3)
    count = 0
    for sample in samples:
        fill_equations(x, xp, sample, A)
        null_space(A, basis)
        essential_constraints(basis, gram, quadratic, M)
        if not reduce_constraints(M):
            continue
        fill_hidden(M, B)
        hidden_determinant(B, minor, c)
        for n in range(min(real_roots(c, 10, table, turned, roots), 10)):
            z = roots[n]
            if abs(z) == np.inf or not hidden_null_vector(B, z, at, v):
                continue
            length = 0.0
            for k in range(9):
                models[count, k] = v[0] / v[2] * basis[0, k] + v[1] / v[2] * basis[1, k] + z * basis[2, k] + basis[3, k]
                length += models[count, k] ** 2
            for k in range(9):
                models[count, k] /= np.sqrt(length)
            count += 1
    return count
