"""Kernels compiled by another process: found by this one, and not missed where that cannot be."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from stereocal.base import compile_ahead as ahead

FIRST_CALIBRATION = """
import numpy as np, stereocal as sc
from stereocal.camera.bundle_kernels import normal_equations_kernel
board = sc.Chessboard((5, 4))
camera = sc.Camera([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]], [-0.1, 0, 0, 0, 0], (640, 480))
tilts = ((0.5, 0, 0), (-0.5, 0, 0.1), (0, 0.5, 0), (0, -0.5, 0.1), (0.3, 0.3, 0))
corners = [camera.project(board.object_points, tilt, [-2, -1.5, 7]) for tilt in tilts]
found = sc.calibrate_camera(board.object_points, corners, (640, 480))
print(found.rms < 1e-6, sum(normal_equations_kernel.stats.cache_hits.values()))
"""


def kernel(name: str, folder: Path | None, *, compiled: bool = False) -> SimpleNamespace:
    """What ``compile_ahead`` asks of a kernel."""

    def function() -> None: ...

    function.__qualname__ = name
    stats = SimpleNamespace(cache_path=None if folder is None else str(folder))
    return SimpleNamespace(signatures=[()] if compiled else [], stats=stats, py_func=function)


@pytest.fixture(autouse=True)
def _afresh(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, "_asked", set())
    monkeypatch.setattr(ahead, "_processes", [])
    monkeypatch.setattr(ahead, "_processors", lambda: 2)
    monkeypatch.delenv(ahead.VARIABLE, raising=False)


@pytest.mark.slow
@pytest.mark.skipif(ahead._processors() < 2, reason="on one processor nothing is compiled ahead")
def test_a_first_calibration_finds_what_another_process_compiled(tmp_path: Path) -> None:
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    environment.pop(ahead.VARIABLE, None)
    run = subprocess.run(
        [sys.executable, "-c", FIRST_CALIBRATION], env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout.split() == ["True", "1"]  # one variant, and it came from the disk


def test_a_process_is_started_once_and_waited_for(tmp_path: Path) -> None:
    wanted, done = kernel("wanted", tmp_path), tmp_path / "done"
    call = f"pathlib:Path({str(done)!r}).touch()"
    assert ahead.compile_ahead(call, wanted)
    assert not ahead.compile_ahead(call, wanted)
    ahead.wait_for(wanted)
    assert done.exists()
    assert not ahead.is_under_way(wanted)


def test_no_second_process_for_a_kernel_that_one_is_at(tmp_path: Path) -> None:
    wanted = kernel("wanted", tmp_path)
    assert ahead.compile_ahead("time:sleep(2)", wanted)
    assert ahead.is_under_way(wanted)
    assert not ahead.compile_ahead("time:sleep(3)", wanted)
    ahead.wait_for(wanted)


def test_nothing_is_started_for_kernels_that_are_compiled_or_cannot_be_kept(tmp_path: Path) -> None:
    on_disk = kernel("on_disk", tmp_path)
    (tmp_path / f"room.on_disk-{on_disk.py_func.__code__.co_firstlineno}.py311.nbi").touch()
    kernels = (kernel("called", tmp_path, compiled=True), on_disk, kernel("lost", None))
    assert all(map(ahead.has_compiled, kernels))
    assert not ahead.compile_ahead("time:sleep(0)", *kernels)
    assert not ahead.has_compiled(kernel("other", tmp_path))


@pytest.mark.parametrize("obstacle", ["turned off", "one processor", "no Python"])
def test_where_it_cannot_be_the_kernels_are_left_alone(
    obstacle: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if obstacle == "turned off":
        monkeypatch.setenv(ahead.VARIABLE, "0")
    elif obstacle == "one processor":
        monkeypatch.setattr(ahead, "_processors", lambda: 1)
    else:
        monkeypatch.setattr(sys, "executable", str(tmp_path / "nothing"))
    wanted = kernel("wanted", tmp_path)
    assert not ahead.compile_ahead("time:sleep(0)", wanted)
    ahead.wait_for(wanted)  # which there is no reason to


def test_a_process_that_fails_is_not_missed(tmp_path: Path) -> None:
    wanted = kernel("wanted", tmp_path)
    assert ahead.compile_ahead("time:no_such_function()", wanted)
    ahead.wait_for(wanted)
    assert not ahead.is_under_way(wanted)


def test_one_that_hangs_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ahead, "_PATIENCE", 0.2)
    wanted = kernel("wanted", tmp_path)
    assert ahead.compile_ahead("time:sleep(60)", wanted)
    ahead.wait_for(wanted)
    assert not ahead.is_under_way(wanted)
