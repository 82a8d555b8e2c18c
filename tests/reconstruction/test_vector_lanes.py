"""Each operation on lanes against NumPy, for vectors of every make-up of chunks."""

from __future__ import annotations

import numpy as np
import pytest
from numba import config, njit

from stereocal.reconstruction.vector_lanes import (
    add_saturated,
    bits_in_both,
    count_differing_bits,
    from_above,
    from_below,
    high_product,
    mean_rounded_down,
    mean_rounded_up,
    minimum,
    narrow,
    subtract_saturated,
)
from stereocal.reconstruction.vector_primitives import (
    absolute_difference,
    absolute_difference_of_halves,
    copy_four,
    lanes_of,
    load,
    maximum,
    store,
)

pytestmark = pytest.mark.skipif(config.DISABLE_JIT, reason="vectors exist in compiled code alone")


@njit
def _apply(a, b, lanes, out):
    p, q = load(a, 0, lanes), load(b, 0, lanes)
    n = len(a)
    store(minimum(p, q), out, 0)
    store(maximum(p, q), out, n)
    store(add_saturated(p, q), out, 2 * n)
    store(subtract_saturated(p, q), out, 3 * n)
    store(bits_in_both(p, q), out, 4 * n)
    store(count_differing_bits(p, q), out, 5 * n)
    store(high_product(p, q), out, 6 * n)
    store(mean_rounded_down(p, q), out, 7 * n)
    store(mean_rounded_up(p, q), out, 8 * n)
    store(from_below(p, q), out, 9 * n)
    store(from_above(p, q), out, 10 * n)


@njit
def _narrow(a, lanes, out):
    store(narrow(load(a, 0, lanes), load(out, 0, lanes)), out, 0)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
@pytest.mark.parametrize("count", [16, 32, 48, 64, 112])
def test_operations_are_numpys(kind, count) -> None:
    rng = np.random.default_rng(count)
    most = np.iinfo(kind).max
    a, b = rng.integers(0, most + 1, (2, count)).astype(kind)
    out = np.zeros(11 * count, kind)
    _apply(a, b, lanes_of(count), out)
    p, q = a.astype(np.int64), b.astype(np.int64)
    expected = [
        np.minimum(p, q),
        np.maximum(p, q),
        np.minimum(p + q, most),
        np.maximum(p - q, 0),
        p & q,
        np.bitwise_count(a ^ b),
        (p * q) >> np.iinfo(kind).bits,
        (p + q) // 2,
        (p + q + 1) // 2,
        np.concatenate([q[:1], p[:-1]]),
        np.concatenate([p[1:], q[:1]]),
    ]
    np.testing.assert_array_equal(out.reshape(11, count), expected)


def test_narrow_keeps_the_low_bits() -> None:
    a = np.random.default_rng(0).integers(0, 65536, 48).astype(np.uint16)
    out = np.zeros(48, np.uint8)
    _narrow(a, lanes_of(48), out)
    np.testing.assert_array_equal(out, a & 255)


@njit
def _differences(a, b, lanes, out):
    p, q = load(a, 0, lanes), load(b, 0, lanes)
    store(absolute_difference(p, q), out, 0)
    store(absolute_difference_of_halves(p, q), out, len(a))


def test_differences_of_small_numbers_may_be_had_the_short_way() -> None:
    a, b = np.random.default_rng(0).integers(0, 128, (2, 48)).astype(np.uint8)
    a[:2], b[:2] = (0, 127), (127, 0)
    out = np.zeros(96, np.uint8)
    _differences(a, b, lanes_of(48), out)
    expected = np.abs(a.astype(int) - b)
    np.testing.assert_array_equal(out.reshape(2, 48), [expected, expected])


@njit
def _copy(source, target):
    copy_four(source, 3, target, 1)


@pytest.mark.parametrize("kind", [np.uint16, np.uint32])
def test_four_are_copied_and_no_more(kind) -> None:
    source, target = np.arange(10, 20).astype(kind), np.zeros(6, kind)
    _copy(source, target)
    assert target.tolist() == [0, 13, 14, 15, 16, 0]
