"""Bands of rows: all of them, once each, errors seen, and a pool that a forked process does not inherit."""

from __future__ import annotations

import multiprocessing

import numpy as np
import pytest

from stereocal.reconstruction.row_bands import run_bands


@pytest.mark.parametrize("threads", [1, 2, 3, 7, None])
@pytest.mark.parametrize("rows", [range(0), range(3, 4), range(5, 105)])
def test_every_row_is_done_once(threads: int | None, rows: range) -> None:
    count = np.zeros(120, int)

    def work(band: range) -> None:
        count[band.start : band.stop] += 1

    run_bands(work, rows, threads, least_rows=2)
    expected = np.zeros(120, int)
    expected[rows.start : rows.stop] = 1
    np.testing.assert_array_equal(count, expected)


@pytest.mark.parametrize("bad", [0, 99])
def test_an_error_is_raised_when_no_band_runs_any_more(bad: int) -> None:
    done = []

    def work(band: range) -> None:
        if bad in band:
            raise ZeroDivisionError
        done.append(band)

    with pytest.raises(ZeroDivisionError):
        run_bands(work, range(100), 4)
    assert len(done) == 3


def _bands_of_two() -> None:
    run_bands(lambda band: None, range(10), 2)


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="this system does not fork")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_makes_threads_of_its_own() -> None:
    _bands_of_two()
    child = multiprocessing.get_context("fork").Process(target=_bands_of_two)
    child.start()
    child.join(20)
    assert child.exitcode == 0
