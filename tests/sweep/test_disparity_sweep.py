from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

from stereocal.base.errors import DataFileError, InputError
from stereocal.sweep import disparity_sweep
from stereocal.sweep.blocks import SweepSettings, computable_region, sweep_block
from stereocal.sweep.disparity_sweep import sweep_disparity
from stereocal.sweep.executors import open_executor
from stereocal.sweep.table import SweepTable

BLOCKS, SPECKLES = (5, 9, 15, 31), (0, 50, 200)


def textured_pair(shift: int = 7, shape: tuple[int, int] = (96, 160)) -> tuple[np.ndarray, np.ndarray]:
    """A random texture seen twice, `shift` apart, with noise in a band where nothing matches."""
    random = np.random.default_rng(5)
    wide = cv2.GaussianBlur(random.integers(0, 256, (shape[0], shape[1] + 64)).astype(np.uint8), (0, 0), 1.0)
    left, right = wide[:, : shape[1]].copy(), wide[:, shift : shift + shape[1]].copy()
    right[40:60] = random.integers(0, 256, (20, shape[1]))
    return left, right


@pytest.fixture(scope="module")
def pair() -> tuple[np.ndarray, np.ndarray]:
    return textured_pair()


@pytest.fixture(scope="module")
def table(pair) -> SweepTable:
    return sweep_disparity(*pair, block_sizes=BLOCKS, speckle_sizes=SPECKLES)


def test_counts_are_those_of_opencv(pair, table: SweepTable) -> None:
    """The paper's own procedure, with the paper's own library, cell by cell.

    Counted inside the region that a search can reach: with minDisparity 1 OpenCV now and then leaves a disparity of 1
    in column 0, where there is nothing to compare with (here at blocks 9 and 15; the same in every call).
    """
    for row in table.rows:
        matcher = cv2.StereoBM_create(numDisparities=32, blockSize=row.block_size)
        matcher.setMinDisparity(1)
        matcher.setSpeckleWindowSize(row.speckle_size)
        matcher.setSpeckleRange(1)
        disparity = matcher.compute(*pair)
        assert np.count_nonzero(disparity[:, 1:32] > 0) == 0
        assert row.count == np.count_nonzero(disparity[:, 32:] > 0), row


def test_the_ceiling_is_what_the_window_leaves() -> None:
    settings = SweepSettings()
    for block in (5, 31, 91):
        expected = (160 - 32 - block + 1) * (96 - block + 1)  # columns 32 + r … W − r, rows r … H − r
        columns, rows = computable_region((96, 160), block, settings)
        assert len(columns) * len(rows) == max(expected, 0)


def test_a_perfect_pair_fills_what_is_computable_whatever_the_window() -> None:
    """So the falling count says nothing about the pair: fill does not fall."""
    random = np.random.default_rng(1)
    wide = random.integers(0, 256, (96, 240)).astype(np.uint8)
    rows = [
        sweep_block(wide[:, :160].copy(), wide[:, 7:167].copy(), b, [0], SweepSettings(uniqueness_ratio=0))[0]
        for b in (5, 15, 31)
    ]
    counts = [row.count for row in rows]
    assert counts == sorted(counts, reverse=True)
    assert counts[2] < 0.7 * counts[0]
    assert min(row.fill for row in rows) > 0.97
    assert min(row.consistency for row in rows) > 0.95


def test_truth_tells_wrong_pixels(pair) -> None:
    truth = np.full(pair[0].shape, 7.0, np.float32)
    good = sweep_disparity(*pair, block_sizes=[15], speckle_sizes=[200], truth=truth)
    wrong = sweep_disparity(*pair, block_sizes=[15], speckle_sizes=[200], truth=truth + 5)
    assert good.rows[0].bad < 0.05
    assert wrong.rows[0].bad > 0.95


def test_shared_work_is_done_once(pair, monkeypatch) -> None:
    seen = []
    original = disparity_sweep.sweep_block

    def spy(left, right, block, speckles, *rest):
        seen.append(block)
        return original(left, right, block, speckles, *rest)

    monkeypatch.setattr(disparity_sweep, "sweep_block", spy)
    sweep_disparity(*pair, block_sizes=BLOCKS, speckle_sizes=range(0, 200, 10))
    assert sorted(seen) == sorted(BLOCKS)


class Backwards(ThreadPoolExecutor):
    """An executor that finishes late what it got first."""

    def submit(self, call, /, *args, **options) -> Future:
        def later():
            time.sleep(0.02 * (40 - args[2]) / 40)
            return call(*args, **options)

        return super().submit(later)


def test_the_table_does_not_depend_on_the_executor(pair, table: SweepTable, tmp_path) -> None:
    for name in ("local:1", "local:3", "processes:2"):
        with open_executor(name) as executor:
            other = sweep_disparity(
                *pair, block_sizes=BLOCKS, speckle_sizes=SPECKLES, executor=executor, csv=tmp_path / f"{name[:6]}.csv"
            )
        assert other.to_csv() == table.to_csv()
    with Backwards(4) as executor:
        path = tmp_path / "backwards.csv"
        other = sweep_disparity(*pair, block_sizes=BLOCKS, speckle_sizes=SPECKLES, executor=executor, csv=path)
    assert other.to_csv() == table.to_csv() == path.read_text()


def test_dask_gives_the_same_table(pair, table: SweepTable) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None, host="127.0.0.1", protocol="tcp"
        ) as cluster,
        open_executor(f"dask:{cluster.scheduler_address}") as executor,
    ):
        other = sweep_disparity(*pair, block_sizes=BLOCKS, speckle_sizes=SPECKLES, executor=executor)
    assert other.to_csv() == table.to_csv()


def test_a_larger_grid_continues_a_smaller_one(pair, table: SweepTable, tmp_path) -> None:
    path, done = tmp_path / "sweep.csv", []
    sweep_disparity(*pair, block_sizes=BLOCKS[:2], speckle_sizes=SPECKLES, csv=path)
    whole = sweep_disparity(
        *pair, block_sizes=BLOCKS, speckle_sizes=SPECKLES, csv=path, progress=lambda n, total: done.append((n, total))
    )
    assert done[0] == (2, 4)
    assert done[-1] == (4, 4)
    assert whole.to_csv() == table.to_csv() == path.read_text()


@pytest.mark.parametrize("torn", ["15,0,12", "15,0,1200,9000,0.1,0.9,\n15,50,1100,90", "15,xx,1,1,1,1,1\n", "\x00\x01"])
def test_a_torn_file_loses_only_what_was_unfinished(pair, table: SweepTable, tmp_path, torn: str) -> None:
    path = tmp_path / "sweep.csv"
    sweep_disparity(*pair, block_sizes=BLOCKS[:2], speckle_sizes=SPECKLES, csv=path)
    with path.open("a") as stream:
        stream.write(torn)
    whole = sweep_disparity(*pair, block_sizes=BLOCKS, speckle_sizes=SPECKLES, csv=path)
    assert whole.to_csv() == table.to_csv() == path.read_text()


CHILD = """
import sys, time
import numpy as np
from stereocal.sweep import disparity_sweep as d
pair = np.load(sys.argv[1])
original = d.sweep_block
def slow(*a):
    time.sleep(0.15)
    print(a[2], flush=True)
    return original(*a)
d.sweep_block = slow
from concurrent.futures import ThreadPoolExecutor
with ThreadPoolExecutor(1) as executor:
    sizes = dict(block_sizes=range(5, 46, 2), speckle_sizes=(0, 50, 200))
    d.sweep_disparity(pair["left"], pair["right"], csv=sys.argv[2], executor=executor, **sizes)
"""


def test_a_killed_sweep_goes_on_where_it_was(pair, tmp_path) -> None:
    """Killed with SIGKILL in the middle, the second run computes what is missing and nothing else."""
    np.savez(tmp_path / "pair.npz", left=pair[0], right=pair[1])
    script, path = tmp_path / "child.py", tmp_path / "sweep.csv"
    script.write_text(CHILD)
    child = subprocess.Popen([sys.executable, str(script), str(tmp_path / "pair.npz"), str(path)])
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and (not path.exists() or len(path.read_text().splitlines()) < 1 + 3 * 4):
        time.sleep(0.02)
    os.kill(child.pid, signal.SIGKILL)
    child.wait()
    before = _finished_blocks(path)
    assert 4 <= len(before) < 21
    second = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "pair.npz"), str(path)], capture_output=True, text=True, check=True
    )
    computed = [int(line) for line in second.stdout.split()]
    assert not set(computed) & before, "a finished row was computed again"
    assert set(computed) | before == set(range(5, 46, 2)), "a row was lost"
    assert len(computed) == len(set(computed))
    expected = sweep_disparity(*pair, block_sizes=range(5, 46, 2), speckle_sizes=SPECKLES)
    assert path.read_text() == expected.to_csv()


def _finished_blocks(path: Path) -> set[int]:
    with path.open() as stream:
        rows = [row for row in csv.reader(stream) if len(row) == 7][1:]
    blocks = [int(row[0]) for row in rows]
    return {b for b in blocks if blocks.count(b) == 3}


def test_a_table_of_something_else_is_left_alone(pair, tmp_path) -> None:
    path = tmp_path / "sweep.csv"
    sweep_disparity(*pair, block_sizes=[5], speckle_sizes=[0], csv=path)
    before = path.read_text()
    with pytest.raises(DataFileError, match="other images or settings"):
        sweep_disparity(pair[1], pair[0], block_sizes=[5], speckle_sizes=[0], csv=path)
    with pytest.raises(DataFileError, match="other images or settings"):
        sweep_disparity(*pair, block_sizes=[5], speckle_sizes=[0], csv=path, num_disparities=48)
    assert path.read_text() == before
    stranger = tmp_path / "mine.csv"
    stranger.write_text("my,own,figures\n")
    with pytest.raises(DataFileError, match="not known"):
        sweep_disparity(*pair, block_sizes=[5], speckle_sizes=[0], csv=stranger)
    assert stranger.read_text() == "my,own,figures\n"


def test_bad_input_is_refused_in_a_sentence(pair) -> None:
    with pytest.raises(InputError, match="must be odd"):
        sweep_disparity(*pair, block_sizes=[6])
    with pytest.raises(InputError, match="end the sweep sooner"):
        sweep_disparity(*pair, block_sizes=[5, 101])
    with pytest.raises(InputError, match="empty"):
        sweep_disparity(*pair, block_sizes=[5], speckle_sizes=[])
    with pytest.raises(InputError, match="executor must be"), open_executor("cloud"):
        pass
    with pytest.raises(InputError, match="truth"):
        sweep_disparity(*pair, block_sizes=[5], truth=np.zeros((3, 3)))


def test_the_paper_s_grid_takes_under_a_minute(pair) -> None:
    """126 windows by 16 speckle sizes on 640x480."""
    left, right = textured_pair(shape=(480, 640))
    start = time.perf_counter()
    table = sweep_disparity(left, right)
    assert time.perf_counter() - start < 60
    assert len(table) == 126 * 16
