# mypy: allow-untyped-defs
"""Kernels of ``resampling``: one output row at a time, in passes that the machine's vector units can follow.

A pixel of the output reads the image at a place of its own, and such scattered reads do not vectorise. All the rest
does. So a bilinear row is made in four passes:

1. *where*: floor the coordinates, keep the fractions a, b, and the offset of the pixel to the upper left, or −1 if the
   four neighbours are not all within the image. Vectorised.
2. *fetch*: copy each pixel together with its right neighbour in one go, from the upper and from the lower row. The
   only scattered reads, two a pixel.
3. *blend*: interpolate the copies. Vectorised.
4. *border*: the few pixels marked −1, one by one, with the border's value outside.

The blend is t = p₀₀ + a (p₀₁ − p₀₀) for the upper pair, u likewise for the lower one, then t + b (u − t), each step
rounded once (a fused multiply-add) to float32: the arithmetic of OpenCV 5.0 where the processor has that instruction.

**Fetching ahead.** A row of the output follows a slanted line through the image, so that the lines of memory it needs
lie on many pages, and the processor's own guess of what comes next fails. Once the image has outgrown the nearest
caches, most of the time would go in waiting. But the map says what comes next: before a row is made, the places that
the NEXT row points to are asked for (:func:`_prefetch_row`), and have arrived when their turn comes. On a picture of
1920 x 1080 that halves the time. Images of less than half a megabyte stay in the caches anyway, and are left alone.

`magic` rounds to the nearest integer, ties to even: above 1.5 · 2²³ neighbouring float32 numbers are 1 apart, so adding
that number and taking it off again leaves an integer. It is 0 for images of float32, and then does nothing.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic


@intrinsic
def _fma(typingctx, a, b, c):
    """a * b + c, rounded once."""

    def codegen(context, builder, signature, args):
        return builder.fma(*args)

    return a(a, a, a), codegen


@intrinsic(prefer_literal=True)
def _copy(typingctx, pixels, channels, target, to, source, at):
    """Copy `pixels` (a literal) neighbouring pixels from source[at] to target[to], as one unaligned vector.

    `channels` is a tuple with an entry for each channel, so that the vector's length is known when this is compiled.
    """
    if not isinstance(pixels, types.IntegerLiteral):
        return None
    count = pixels.literal_value * len(channels)

    def codegen(context, builder, signature, args):
        words = ir.VectorType(context.get_data_type(signature.args[2].dtype), count)

        def pointer(position):
            array = context.make_array(signature.args[position])(context, builder, args[position])
            return builder.bitcast(builder.gep(array.data, [args[position + 1]]), words.as_pointer())

        value = builder.load(pointer(4))
        value.align = 1
        builder.store(value, pointer(2)).align = 1
        return context.get_dummy_value()

    return types.void(pixels, channels, target, to, source, at), codegen


@intrinsic
def _prefetch(typingctx, source, at):
    """Ask for the line of memory that holds source[at]; a wish without effect on any result."""

    def codegen(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        pointer = builder.bitcast(builder.gep(data, [args[1]]), ir.IntType(8).as_pointer())
        number = ir.IntType(32)
        function = builder.module.declare_intrinsic(
            "llvm.prefetch.p0", fnty=ir.FunctionType(ir.VoidType(), [pointer.type, number, number, number])
        )
        read, keep_near, data_cache = number(0), number(3), number(1)
        builder.call(function, [pointer, read, keep_near, data_cache])
        return context.get_dummy_value()

    return types.void(source, types.intp), codegen


# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _prefetch_row(samples, line_x, line_y, width, height, channels, reach):
    """Ask for what a row of the output will read: a pixel's own line of 64 bytes and the one `reach` rows below."""
    zero, last_x, last_y = np.float32(0), np.float32(width - 1), np.float32(height - 1)
    step = min(16, 64 // (samples.itemsize * channels))
    for j in range(0, len(line_x), step):
        x, y = line_x[j], line_y[j]
        within = (x >= zero) & (y >= zero) & (x <= last_x) & (y <= last_y)
        at = (int(y if within else zero) * width + int(x if within else zero)) * channels
        _prefetch(samples, at)
        if reach > 0:
            _prefetch(samples, at + reach * width * channels)


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _locate_row(map_x, map_y, width, height, channels, a, b, offset):
    """Pass 1: fractions and offsets of one row."""
    zero, last_x, last_y = np.float32(0), np.float32(width - 1), np.float32(height - 1)
    row_step, pixel_step = np.int32(width * channels), np.int32(channels)
    for j in range(len(map_x)):
        x, y = map_x[j], map_y[j]
        x0, y0 = np.floor(x), np.floor(y)
        a[j] = x - x0
        b[j] = y - y0
        within = (x0 >= zero) & (y0 >= zero) & (x0 < last_x) & (y0 < last_y)
        place = np.int32(y0 if within else zero) * row_step + np.int32(x0 if within else zero) * pixel_step
        offset[j] = place if within else np.int32(-1)


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _tap(image, i, j, c, border_value):
    """One sample, or the border's value outside of the image."""
    if 0 <= i < image.shape[0] and 0 <= j < image.shape[1]:
        return np.float32(image[i, j, c])
    return border_value


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _blend_at_border(image, x, y, c, border_value):
    """Pass 4: a pixel whose four neighbours are not all within the image."""
    x0, y0 = np.floor(x), np.floor(y)
    if not (x0 >= -1 and y0 >= -1 and x0 < image.shape[1] and y0 < image.shape[0]):
        return border_value
    a, b = x - x0, y - y0
    i, j = int(y0), int(x0)
    p, q = _tap(image, i, j, c, border_value), _tap(image, i + 1, j, c, border_value)
    t = _fma(a, _tap(image, i, j + 1, c, border_value) - p, p)
    u = _fma(a, _tap(image, i + 1, j + 1, c, border_value) - q, q)
    return _fma(b, u - t, t)


@njit(cache=True, nogil=True, error_model="numpy")
def remap_bilinear(image, map_x, map_y, border_value, magic, channels, out):
    """Bilinear resampling of an (H, W, C) image into (h, w, C); `channels` is a tuple of length C."""
    height, width, size = image.shape[0], image.shape[1], len(channels)
    columns = out.shape[1]
    samples = image.reshape(-1)
    ahead = samples.nbytes > 2**19  # more than the second cache has room for beside the maps
    a, b = np.empty(columns, np.float32), np.empty(columns, np.float32)
    offset, outside = np.empty(columns, np.int32), np.empty(columns, np.int64)
    upper, lower = np.empty(2 * size * columns, image.dtype), np.empty(2 * size * columns, image.dtype)
    for i in range(out.shape[0]):
        _locate_row(map_x[i], map_y[i], width, height, size, a, b, offset)
        if ahead and i + 1 < out.shape[0]:
            _prefetch_row(samples, map_x[i + 1], map_y[i + 1], width, height, size, 1)
        count = 0
        for j in range(columns):
            at = offset[j]
            if at >= 0:
                _copy(2, channels, upper, 2 * size * j, samples, at)
                _copy(2, channels, lower, 2 * size * j, samples, at + width * size)
            else:
                outside[count] = j
                count += 1
        row = out[i].reshape(-1)
        for j in range(columns):
            for c in range(size):
                here = 2 * size * j + c
                p, q = np.float32(upper[here]), np.float32(lower[here])
                t = _fma(a[j], np.float32(upper[here + size]) - p, p)
                u = _fma(a[j], np.float32(lower[here + size]) - q, q)
                row[size * j + c] = (_fma(b[j], u - t, t) + magic) - magic
        for n in range(count):
            j = outside[n]
            for c in range(size):
                value = _blend_at_border(image, map_x[i, j], map_y[i, j], c, border_value[c])
                row[size * j + c] = (value + magic) - magic


@njit(cache=True, nogil=True, error_model="numpy")
def remap_nearest(image, map_x, map_y, border_value, channels, out):
    """The sample at the rounded place (ties to even); `channels` is a tuple of length C."""
    height, width, size = image.shape[0], image.shape[1], len(channels)
    columns = out.shape[1]
    samples = image.reshape(-1)
    ahead = samples.nbytes > 2**19  # more than the second cache has room for beside the maps
    offset = np.empty(columns, np.int32)
    magic, zero = np.float32(1.5 * 2**23), np.float32(0)
    last_x, last_y = np.float32(width - 1), np.float32(height - 1)
    row_step, pixel_step = np.int32(width * size), np.int32(size)
    for i in range(out.shape[0]):
        line_x, line_y = map_x[i], map_y[i]
        for j in range(columns):
            x, y = (line_x[j] + magic) - magic, (line_y[j] + magic) - magic
            within = (x >= zero) & (y >= zero) & (x <= last_x) & (y <= last_y)
            place = np.int32(y if within else zero) * row_step + np.int32(x if within else zero) * pixel_step
            offset[j] = place if within else np.int32(-1)
        if ahead and i + 1 < out.shape[0]:
            _prefetch_row(samples, map_x[i + 1], map_y[i + 1], width, height, size, 0)
        row = out[i].reshape(-1)
        for j in range(columns):
            at = offset[j]
            if at >= 0:
                _copy(1, channels, row, size * j, samples, at)
            else:
                for c in range(size):
                    row[size * j + c] = border_value[c]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _keys_row(fraction, sharpness, weights):
    """Keys' four weights of a row of fractions, one array a tap."""
    one, two, three = np.float32(1), np.float32(2), np.float32(3)
    four, five, eight = np.float32(4), np.float32(5), np.float32(8)
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    for j in range(len(fraction)):
        t = fraction[j]
        far, near = t + one, one - t
        w0[j] = ((sharpness * far - five * sharpness) * far + eight * sharpness) * far - four * sharpness
        w1[j] = ((sharpness + two) * t - (sharpness + three)) * t * t + one
        w2[j] = ((sharpness + two) * near - (sharpness + three)) * near * near + one
    for j in range(len(fraction)):
        w3[j] = one - w0[j] - w1[j] - w2[j]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _cubic_at_border(image, x, y, wx, wy, border_value):
    """A pixel whose sixteen neighbours are not all within the image."""
    if not (x >= -3 and y >= -3 and x <= image.shape[1] + 1 and y <= image.shape[0] + 1):
        return border_value
    left, top = int(np.floor(x)) - 1, int(np.floor(y)) - 1
    total = np.float32(0)
    for m in range(4):
        line = np.float32(0)
        for n in range(4):
            line += wx[n] * _tap(image, top + m, left + n, 0, border_value)
        total += wy[m] * line
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def remap_bicubic_grey(image, map_x, map_y, sharpness, border_value, lowest, highest, magic, out):
    """Keys' cubic convolution of an (H, W, 1) image over 4 x 4 samples, clipped to [lowest, highest]."""
    height, width = image.shape[0], image.shape[1]
    columns = out.shape[1]
    samples = image.reshape(-1)
    ahead = samples.nbytes > 2**19  # more than the second cache has room for beside the maps
    a, b = np.empty(columns, np.float32), np.empty(columns, np.float32)
    wx, wy = np.empty((4, columns), np.float32), np.empty((4, columns), np.float32)
    offset, outside = np.empty(columns, np.int32), np.empty(columns, np.int64)
    taps = np.empty((4, 4 * columns), image.dtype)
    total = np.empty(columns, np.float32)
    zero, one = np.float32(0), np.float32(1)
    last_x, last_y = np.float32(width - 3), np.float32(height - 3)
    for i in range(out.shape[0]):
        line_x, line_y = map_x[i], map_y[i]
        for j in range(columns):
            x0, y0 = np.floor(line_x[j]), np.floor(line_y[j])
            a[j] = line_x[j] - x0
            b[j] = line_y[j] - y0
            within = (x0 >= one) & (y0 >= one) & (x0 <= last_x) & (y0 <= last_y)
            place = np.int32(y0 - one if within else zero) * np.int32(width) + np.int32(x0 - one if within else zero)
            offset[j] = place if within else np.int32(-1)
        if ahead and i + 1 < out.shape[0]:
            _prefetch_row(samples, map_x[i + 1], map_y[i + 1], width, height, 1, 2)
        _keys_row(a, sharpness, wx)
        _keys_row(b, sharpness, wy)
        count = 0
        for j in range(columns):
            at = offset[j]
            if at >= 0:
                for m in range(4):
                    _copy(4, (0,), taps[m], 4 * j, samples, at + m * width)
            else:
                outside[count] = j
                count += 1
        total[:] = zero
        for m in range(4):
            line, weight = taps[m], wy[m]
            w0, w1, w2, w3 = wx[0], wx[1], wx[2], wx[3]
            for j in range(columns):
                p = w0[j] * np.float32(line[4 * j]) + w1[j] * np.float32(line[4 * j + 1])
                p += w2[j] * np.float32(line[4 * j + 2]) + w3[j] * np.float32(line[4 * j + 3])
                total[j] += weight[j] * p
        row = out[i].reshape(-1)
        for j in range(columns):
            row[j] = (min(max(total[j], lowest), highest) + magic) - magic
        for n in range(count):
            j = outside[n]
            value = _cubic_at_border(image, line_x[j], line_y[j], wx[:, j], wy[:, j], border_value[0])
            row[j] = (min(max(value, lowest), highest) + magic) - magic
