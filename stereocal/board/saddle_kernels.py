# mypy: allow-untyped-defs
"""Kernels of :mod:`stereocal.board.saddle`: smoothing, the saddle measure, its maxima, the ring test."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def halve(image, out):
    """Means of 2x2 pixels, float32; an odd last row or column is dropped."""
    for y in range(out.shape[0]):
        upper, lower, row = image[2 * y], image[2 * y + 1], out[y]
        for x in range(row.size):
            row[x] = (
                (np.float32(upper[2 * x]) + np.float32(upper[2 * x + 1]))
                + (np.float32(lower[2 * x]) + np.float32(lower[2 * x + 1]))
            ) * np.float32(0.25)


@njit(cache=True, nogil=True, error_model="numpy")
def smooth_binomial(image, out):
    """Binomial smoothing (1 4 6 4 1)/16 along both axes, borders replicated, float32."""
    height, width = image.shape
    column = np.empty(width + 4, np.float32)
    six, four, norm = np.float32(6), np.float32(4), np.float32(1 / 256)
    inner = column[2 : width + 2]
    for y in range(height):
        r0, r1, r2 = image[max(y - 2, 0)], image[max(y - 1, 0)], image[y]
        r3, r4 = image[min(y + 1, height - 1)], image[min(y + 2, height - 1)]
        for x in range(width):
            inner[x] = (
                (np.float32(r0[x]) + np.float32(r4[x]))
                + four * (np.float32(r1[x]) + np.float32(r3[x]))
                + six * np.float32(r2[x])
            )
        column[0] = column[1] = column[2]
        column[width + 2] = column[width + 3] = column[width + 1]
        row = out[y]
        for x in range(width):
            row[x] = ((column[x] + column[x + 4]) + four * (column[x + 1] + column[x + 3]) + six * column[x + 2]) * norm


@njit(cache=True, nogil=True, error_model="numpy")
def saddle_measure(G, out):
    """S = Gxy^2 - Gxx Gyy by differences over two pixels; 0 within two pixels of the border."""
    height, width = G.shape
    zero, two, quarter = np.float32(0), np.float32(2), np.float32(0.25)
    out[:2] = zero
    out[height - 2 :] = zero
    for y in range(2, height - 2):
        up, mid, down, row = G[y - 2], G[y], G[y + 2], out[y]
        row[0] = row[1] = row[width - 2] = row[width - 1] = zero
        inner = row[2:]
        for x in range(width - 4):
            xx = mid[x + 4] - two * mid[x + 2] + mid[x]
            yy = down[x + 2] - two * mid[x + 2] + up[x + 2]
            xy = (down[x + 4] - down[x] - up[x + 4] + up[x]) * quarter
            inner[x] = xy * xy - xx * yy


@njit(cache=True, nogil=True, error_model="numpy")
def double(image, out):
    """Twice as many pixels a side, linear: a new pixel's centre lies a quarter of an old pixel beside an old centre."""
    height, width = image.shape
    near, far = np.float32(0.75), np.float32(0.25)
    mixed = np.empty(width, np.float32)
    for y in range(2 * height):
        row = image[y // 2]
        other = image[min(max(y // 2 + (1 if y % 2 else -1), 0), height - 1)]
        for x in range(width):
            mixed[x] = near * np.float32(row[x]) + far * np.float32(other[x])
        target = out[y]
        target[0], target[2 * width - 1] = mixed[0], mixed[width - 1]
        for x in range(width - 1):
            target[2 * x + 1] = near * mixed[x] + far * mixed[x + 1]
            target[2 * x + 2] = far * mixed[x] + near * mixed[x + 1]


@njit(cache=True, nogil=True, error_model="numpy")
def spread_darkest(image, sign, out):
    """Least of sign * image over 3x3 pixels, borders replicated, times sign: dark (+1) or light (-1) grows by one."""
    height, width = image.shape
    column = np.empty(width + 2, np.float32)
    tone = np.float32(sign)
    inner = column[1 : width + 1]
    for y in range(height):
        upper, middle, lower = image[max(y - 1, 0)], image[y], image[min(y + 1, height - 1)]
        for x in range(width):
            a, b, c = tone * np.float32(upper[x]), tone * np.float32(middle[x]), tone * np.float32(lower[x])
            a = a if a < b else b
            inner[x] = a if a < c else c
        column[0], column[width + 1] = column[1], column[width]
        row = out[y]
        for x in range(width):
            a = column[x] if column[x] < column[x + 1] else column[x + 1]
            row[x] = tone * (a if a < column[x + 2] else column[x + 2])


@njit(cache=True, nogil=True, error_model="numpy")
def _column_maxima(upper, middle, lower, out):
    for x in range(out.size):
        a = upper[x] if upper[x] > middle[x] else middle[x]
        out[x] = a if a > lower[x] else lower[x]


@njit(cache=True, nogil=True, error_model="numpy")
def saddle_maxima(S, threshold, out):
    """Pixels whose S exceeds the threshold and the S of the 5x5 pixels around; returns how many there are.

    A maximum of 5x5 pixels is the largest of the 3x3 block it lies in, so only the largest of each block is compared
    with its surroundings (Neubeck and Van Gool, 2006). Of equal values the first in reading order wins. `out`
    (capacity, 2) gets x, y of the first `capacity` of them.
    """
    height, width = S.shape
    count = 0
    columns = np.empty(width, np.float32)
    for y0 in range(3, height - 5, 3):
        _column_maxima(S[y0], S[y0 + 1], S[y0 + 2], columns)
        for x0 in range(3, width - 5, 3):
            q = max(max(columns[x0], columns[x0 + 1]), columns[x0 + 2])
            if q <= threshold:
                continue
            x = x0 if columns[x0] == q else (x0 + 1 if columns[x0 + 1] == q else x0 + 2)
            y = y0 if S[y0, x] == q else (y0 + 1 if S[y0 + 1, x] == q else y0 + 2)
            largest = True
            for dy in range(-2, 3):
                other = S[y + dy]
                for dx in range(-2, 3):
                    value = other[x + dx]
                    if value > q or (value == q and (dy < 0 or (dy == 0 and dx < 0))):
                        largest = False
                        break
                if not largest:
                    break
            if largest:
                if count < out.shape[0]:
                    out[count, 0] = x
                    out[count, 1] = y
                count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def _bilinear(G, x, y):
    height, width = G.shape
    x = min(max(x, 0.0), width - 1.001)
    y = min(max(y, 0.0), height - 1.001)
    ix, iy = int(x), int(y)
    fx, fy = x - ix, y - iy
    return (G[iy, ix] * (1 - fx) + G[iy, ix + 1] * fx) * (1 - fy) + (
        G[iy + 1, ix] * (1 - fx) + G[iy + 1, ix + 1] * fx
    ) * fy


@njit(cache=True, nogil=True, error_model="numpy")
def _looks_alike(G, x, y, least_amplitude):
    """A cheap look before the ring test: eight pixels around, opposite ones more alike than not."""
    height, width = G.shape
    if x < 4 or y < 4 or x >= width - 4 or y >= height - 4:
        return True
    up, down, mid, upper, lower = G[y - 4], G[y + 4], G[y], G[y - 3], G[y + 3]
    a0, a1, b0, b1 = mid[x - 4], mid[x + 4], up[x], down[x]
    c0, c1, d0, d1 = upper[x - 3], lower[x + 3], upper[x + 3], lower[x - 3]
    low = min(min(min(a0, a1), min(b0, b1)), min(min(c0, c1), min(d0, d1)))
    high = max(max(max(a0, a1), max(b0, b1)), max(max(c0, c1), max(d0, d1)))
    if high - low < 1.4 * least_amplitude:
        return False
    middle = low + high
    odd = (a0 - a1) ** 2 + (b0 - b1) ** 2 + (c0 - c1) ** 2 + (d0 - d1) ** 2
    even = (a0 + a1 - middle) ** 2 + (b0 + b1 - middle) ** 2 + (c0 + c1 - middle) ** 2 + (d0 + d1 - middle) ** 2
    return odd < even


@njit(cache=True, nogil=True, error_model="numpy")
def ring_test(G, pixels, cosine, sine, radius, least_amplitude, out):
    """Keep the saddles around which a ring shows dark, light, dark, light, alike on opposite sides.

    For each pixel (x, y): Newton's step to the saddle point of the local quadratic, samples of G on a ring, crossings
    of the middle grey. `out` (n, 7) gets x, y, the four directions of the edges (the first one leads, with growing
    angle, from light into dark) and the amplitude; returns how many pass.
    """
    steps = cosine.size
    v, crossing = np.empty(steps), np.empty(4)
    kept = 0
    for n in range(pixels.shape[0]):
        px, py = pixels[n, 0], pixels[n, 1]
        if not _looks_alike(G, px, py, least_amplitude):
            continue
        gx = (G[py, px + 2] - G[py, px - 2]) * 0.25
        gy = (G[py + 2, px] - G[py - 2, px]) * 0.25
        xx = (G[py, px + 2] - 2 * G[py, px] + G[py, px - 2]) * 0.25
        yy = (G[py + 2, px] - 2 * G[py, px] + G[py - 2, px]) * 0.25
        xy = (G[py + 2, px + 2] - G[py + 2, px - 2] - G[py - 2, px + 2] + G[py - 2, px - 2]) * 0.0625
        det = xx * yy - xy * xy
        dx, dy = (xy * gy - yy * gx) / det, (xy * gx - xx * gy) / det
        if not (dx * dx + dy * dy < 4.0):
            continue
        cx, cy = px + dx, py + dy
        low, high = 1e30, -1e30
        for i in range(steps):
            v[i] = _bilinear(G, cx + radius * cosine[i], cy + radius * sine[i])
            low, high = min(low, v[i]), max(high, v[i])
        amplitude = (high - low) / 2
        if amplitude < least_amplitude:
            continue
        middle = (high + low) / 2
        crossings, first_falls = 0, False
        for i in range(steps):
            here, following = v[i] - middle, v[(i + 1) % steps] - middle
            if (here > 0) != (following > 0):
                if crossings < 4:
                    if crossings == 0:
                        first_falls = here > 0
                    crossing[crossings] = (i + here / (here - following)) * (2 * np.pi / steps)
                crossings += 1
        if crossings != 4:
            continue
        straight = True
        for i in range(2):
            if abs(crossing[i + 2] - crossing[i] - np.pi) > 0.45:
                straight = False
        opening = crossing[1] - crossing[0]
        second = crossing[2] - crossing[1]
        if not straight or min(opening, second) < 0.3:
            continue
        odd, even = 0.0, 0.0
        for i in range(steps // 2):
            a, b = v[i] - middle, v[i + steps // 2] - middle
            odd += (a - b) * (a - b)
            even += (a + b) * (a + b)
        if odd > 0.35 * even:
            continue
        shift = 0 if first_falls else 1
        out[kept, 0], out[kept, 1], out[kept, 6] = cx, cy, amplitude
        for i in range(4):
            out[kept, 2 + i] = crossing[(i + shift) % 4]
        kept += 1
    return kept
