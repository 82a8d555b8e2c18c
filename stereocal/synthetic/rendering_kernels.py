"""Kernels of the renderer: rays, boards, rooms, blur; each names the module that holds its definition."""

# mypy: disable-error-code="no-untyped-def,no-untyped-call,misc"
from __future__ import annotations

import math

import numpy as np
from numba import njit

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True)
def gather_kernel(radiance, weights, s, out):
    """Blur and take once a pixel; twin in ``exposure.gather``."""
    rows, columns = out.shape
    taps = weights.size
    along_rows = np.empty((radiance.shape[0], columns), dtype=np.float32)
    for i in range(radiance.shape[0]):
        for j in range(columns):
            total = np.float32(0)
            for t in range(taps):
                total += weights[t] * radiance[i, j * s + t]
            along_rows[i, j] = total
    for i in range(rows):
        for j in range(columns):
            out[i, j] = 0
        for t in range(taps):
            weight = weights[t]
            for j in range(columns):
                out[i, j] += weight * along_rows[i * s + t, j]


@njit(cache=True, nogil=True, **INNER)
def _ray_row(nodes, weights, i, across, rays):
    """Rays of raster row i; twin in ``rays.RayTable.rays``."""
    s = weights.shape[0]
    top, k = i // s, i % s
    for m in range(nodes.shape[1]):
        for c in range(2):
            total = 0.0
            for t in range(5):
                total += weights[k, t] * nodes[top + t, m, c]
            across[m, c] = total
    for j in range(nodes.shape[1] - 4):
        for k in range(s):
            for c in range(2):
                total = 0.0
                for t in range(5):
                    total += weights[k, t] * across[j + t, c]
                rays[j * s + k, c] = total


@njit(cache=True, nogil=True, **INNER)
def _square_wave_integral(x):
    """∫₀ˣ of the wave that is +1 on [0, 1), −1 on [1, 2), …: a triangle wave."""
    y = x - 2 * math.floor(x / 2)
    return y if y < 1 else 2 - y


@njit(cache=True, nogil=True, **INNER)
def _inside(x, w, low, high):
    """Part of [x − w/2, x + w/2] that lies within [low, high]."""
    part = (min(x + w / 2, high) - max(x - w / 2, low)) / w
    return max(part, 0.0)


@njit(cache=True, nogil=True, **INNER)
def _mean_wave(x, w, low, high):
    """∫ of the square wave over [x − w/2, x + w/2] ∩ [low, high], divided by w."""
    upper = _square_wave_integral(min(max(x + w / 2, low), high))
    lower = _square_wave_integral(min(max(x - w / 2, low), high))
    return (upper - lower) / w


@njit(cache=True, nogil=True, **INNER)
def _board_row(rays, rotation, origin, bow, centre, length, out):
    """Where the rays of a row meet the board, in squares; twin in ``board_view.meet_board``."""
    for j in range(rays.shape[0]):
        x, y = rays[j, 0], rays[j, 1]
        dx = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0]
        dy = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1]
        dz = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2]
        q = 4 * bow / (length * length)
        ox = origin[0] - centre
        a = q * dx * dx
        b = dz + 2 * q * ox * dx
        c = origin[2] - bow + q * ox * ox
        d = b * b - 4 * a * c
        if not d >= 0:
            out[j, 0] = out[j, 1] = math.nan
            continue
        root = b + math.copysign(math.sqrt(d), b)
        t = -2 * c / root if root != 0 else math.nan
        if t > 0:
            out[j, 0] = origin[0] + t * dx
            out[j, 1] = origin[1] + t * dy
        else:
            out[j, 0] = out[j, 1] = math.nan


@njit(cache=True, nogil=True)
def board_kernel(nodes, weights, rotation, origin, shape, levels, radiance):
    """Paint a board over the background that `radiance` holds; twin in ``board_view._paint``.

    shape: columns, rows, margin, bow, centre, length, in squares; levels: dark, bright.
    """
    rows, count = radiance.shape
    columns, lines, margin, bow, centre, length = shape
    dark, bright = levels
    across = np.empty((nodes.shape[1], 2))
    rays = np.empty((count, 2))
    places = np.empty((3, count, 2))
    for i in range(-1, rows):
        # three rows of places are kept: above, here, below; at the ends the row itself
        if i + 1 < rows:
            _ray_row(nodes, weights, i + 1, across, rays)
            _board_row(rays, rotation, origin, bow, centre, length, places[(i + 1) % 3])
        if i < 0:
            continue
        here = places[i % 3]
        above = places[(i - 1) % 3] if i > 0 else here
        below = places[(i + 1) % 3] if i + 1 < rows else here
        step_v = 0.5 if i > 0 and i + 1 < rows else 1.0
        for j in range(count):
            x, y = here[j, 0], here[j, 1]
            # not (…) also catches NaN
            if not (-3 - margin < x < columns + 2 + margin and -3 - margin < y < lines + 2 + margin):
                continue
            left, right = max(j - 1, 0), min(j + 1, count - 1)
            step_u = 1.0 / (right - left)
            wx = abs(here[right, 0] - here[left, 0]) * step_u + abs(below[j, 0] - above[j, 0]) * step_v
            wy = abs(here[right, 1] - here[left, 1]) * step_u + abs(below[j, 1] - above[j, 1]) * step_v
            if not (wx < 4 and wy < 4):
                continue
            wx, wy = max(wx, 1e-12), max(wy, 1e-12)
            paper = _inside(x, wx, -1 - margin, columns + margin) * _inside(y, wy, -1 - margin, lines + margin)
            if paper <= 0:
                continue
            printed = _inside(x, wx, -1.0, columns) * _inside(y, wy, -1.0, lines)
            waves = _mean_wave(x, wx, -1.0, columns) * _mean_wave(y, wy, -1.0, lines)
            shade = bright - (bright - dark) * 0.5 * (printed + waves)
            radiance[i, j] = (1 - paper) * radiance[i, j] + paper * shade


@njit(cache=True, nogil=True, **INNER)
def _first_surface(surfaces, ox, oy, oz, dx, dy, dz):
    """τ and index of the first surface that a ray meets; twin in ``surfaces.trace``."""
    nearest, index = math.inf, -1
    for i in range(surfaces.shape[0]):
        s = surfaces[i]
        px, py, pz = s[1] - ox, s[2] - oy, s[3] - oz
        if s[0] == 0:
            nx = s[5] * s[9] - s[6] * s[8]
            ny = s[6] * s[7] - s[4] * s[9]
            nz = s[4] * s[8] - s[5] * s[7]
            slope = dx * nx + dy * ny + dz * nz
            if slope == 0:
                continue
            tau = (nx * px + ny * py + nz * pz) / slope
            if not 1e-6 < tau < nearest:
                continue
            x, y, z = tau * dx - px, tau * dy - py, tau * dz - pz
            if abs(x * s[4] + y * s[5] + z * s[6]) <= s[10] and abs(x * s[7] + y * s[8] + z * s[9]) <= s[11]:
                nearest, index = tau, i
        else:
            a = dx * dx + dy * dy + dz * dz
            b = dx * px + dy * py + dz * pz
            root = b * b - a * (px * px + py * py + pz * pz - s[10] * s[10])
            if root >= 0:
                tau = (b - math.sqrt(root)) / a
                if 1e-6 < tau < nearest:
                    nearest, index = tau, i
    return nearest, index


@njit(cache=True, nogil=True)
def trace_kernel(surfaces, origin, directions, tau, index):
    """First surface of every ray; twin in ``surfaces.trace``."""
    for k in range(directions.shape[0]):
        d = directions[k]
        met, i = _first_surface(surfaces, origin[0], origin[1], origin[2], d[0], d[1], d[2])
        tau[k] = met if i >= 0 else math.nan
        index[k] = i


@njit(cache=True, nogil=True, **INNER)
def _hash(i, j, seed):
    """A number in [−1, 1) for a lattice point; twin in ``surfaces._hash``."""
    mask = 0xFFFFFFFF
    h = ((i & mask) * 374761393 & mask) + ((j & mask) * 668265263 & mask) + (seed * 1103515245 & mask)
    h = (h ^ (h >> 13)) & mask
    h = (h * 1274126177) & mask
    h ^= h >> 16
    return h / 2147483648.0 - 1.0


@njit(cache=True, nogil=True, **INNER)
def _value_noise(p, q, seed):
    """Twin in ``surfaces._value_noise``."""
    i, j = math.floor(p), math.floor(q)
    a, b = p - i, q - j
    a = a * a * a * (a * (6 * a - 15) + 10)
    b = b * b * b * (b * (6 * b - 15) + 10)
    m, n = int(i), int(j)
    upper = (1 - a) * _hash(m, n, seed) + a * _hash(m + 1, n, seed)
    lower = (1 - a) * _hash(m, n + 1, seed) + a * _hash(m + 1, n + 1, seed)
    return (1 - b) * upper + b * lower


@njit(cache=True, nogil=True, **INNER)
def _texture(p, q, seed, pattern):
    """Twin in ``surfaces.texture``."""
    stretch = 0.35 if pattern == 1 else 1.0
    value = 0.5 * _value_noise(stretch * p, q, seed)
    value += 0.3 * _value_noise(2 * stretch * p, 2 * q, seed + 101)
    value += 0.2 * _value_noise(4 * stretch * p, 4 * q, seed + 202)
    if pattern == 1:
        gap = q - np.rint(q)
        value -= 0.6 * math.exp(-((gap / 0.06) ** 2))
    return min(max(1.4 * value, -1.0), 1.0)


@njit(cache=True, nogil=True)
def scene_kernel(nodes, weights, surfaces, light, rotation, origin, radiance):
    """Radiance (3, rows, columns) of a scene; `rotation` takes the camera's frame to the scene's.

    The definition: ``surfaces.trace`` and ``surfaces.shade`` on ``rays.RayTable.rays``.
    """
    _, rows, count = radiance.shape
    across = np.empty((nodes.shape[1], 2))
    rays = np.empty((count, 2))
    for i in range(rows):
        _ray_row(nodes, weights, i, across, rays)
        for j in range(count):
            x, y = rays[j, 0], rays[j, 1]
            dx = rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2]
            dy = rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2]
            dz = rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2]
            tau, k = _first_surface(surfaces, origin[0], origin[1], origin[2], dx, dy, dz)
            if k < 0:
                radiance[0, i, j] = radiance[1, i, j] = radiance[2, i, j] = 0
                continue
            s = surfaces[k]
            px, py, pz = origin[0] + tau * dx - s[1], origin[1] + tau * dy - s[2], origin[2] + tau * dz - s[3]
            if s[0] == 0:
                nx = s[5] * s[9] - s[6] * s[8]
                ny = s[6] * s[7] - s[4] * s[9]
                nz = s[4] * s[8] - s[5] * s[7]
                p = px * s[4] + py * s[5] + pz * s[6]
                q = px * s[7] + py * s[8] + pz * s[9]
            else:
                nx, ny, nz = px / s[10], py / s[10], pz / s[10]
                p = s[10] * math.atan2(px, -pz)
                q = s[10] * math.asin(min(max(py / s[10], -1.0), 1.0))
            value = 0.5 + 0.5 * abs(nx * light[0] + ny * light[1] + nz * light[2])
            value *= 1 + s[16] * _texture(p / s[15], q / s[15], int(s[17]), int(s[18]))
            for c in range(3):
                radiance[c, i, j] = s[12 + c] * value
