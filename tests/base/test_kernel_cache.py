"""Compiled kernels find a place on machines where Numba finds none."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from stereocal.base import kernel_cache

posix = pytest.mark.skipif(os.name != "posix", reason="modes and owners of files are POSIX")


@pytest.fixture
def nowhere(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A machine where only the temporary folder, which is returned, can be written."""
    monkeypatch.delenv(kernel_cache.VARIABLE, raising=False)
    monkeypatch.setattr(kernel_cache, "_can_write", lambda folder: False)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_numba_is_left_alone_where_it_can_write(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(kernel_cache.VARIABLE, raising=False)
    monkeypatch.setattr(kernel_cache, "_user_cache", lambda: str(tmp_path / "not" / "there" / "yet"))
    assert kernel_cache.provide_kernel_cache() is None
    assert kernel_cache.VARIABLE not in os.environ


def test_the_users_choice_goes_first(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(kernel_cache.VARIABLE, "/chosen")
    assert kernel_cache.provide_kernel_cache() is None
    assert os.environ[kernel_cache.VARIABLE] == "/chosen"


def test_a_temporary_folder_serves_where_nothing_else_can(nowhere: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import numba

    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    folder = kernel_cache.provide_kernel_cache()
    assert folder is not None
    assert Path(folder).is_dir()
    assert Path(folder).parent == nowhere
    assert os.environ[kernel_cache.VARIABLE] == numba.config.CACHE_DIR == folder
    monkeypatch.delenv(kernel_cache.VARIABLE)
    assert kernel_cache.provide_kernel_cache() == folder  # the next process finds what this one compiled


@posix
@pytest.mark.parametrize("trap", ["link", "file", "open to others"])
def test_a_folder_that_others_could_fill_is_not_trusted(
    nowhere: Path, monkeypatch: pytest.MonkeyPatch, trap: str
) -> None:
    import numba

    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    place = nowhere / f"stereocal-kernels-{os.getuid()}"
    if trap == "link":
        (nowhere / "elsewhere").mkdir()
        place.symlink_to(nowhere / "elsewhere")
    elif trap == "file":
        place.write_text("")
    else:
        place.mkdir()
        place.chmod(0o777)
    folder = kernel_cache.provide_kernel_cache()
    assert folder is not None
    assert folder != str(place)
    assert Path(folder).stat().st_mode & 0o077 == 0


def test_what_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert kernel_cache._can_write(str(tmp_path / "a" / "b"))
    assert not kernel_cache._can_write(str(tmp_path / "file"))
    assert not kernel_cache._can_write(str(tmp_path / "file" / "below"))


def test_a_kernel_runs_without_a_home_and_beside_a_package_that_cannot_be_written(tmp_path: Path) -> None:
    program = (
        "import os; real = os.access\n"
        "os.access = lambda place, mode: str(place).startswith(os.environ['TMPDIR']) and real(place, mode)\n"
        "import numpy as np, stereocal as sc\n"
        "image = np.zeros((20, 40), np.uint8)\n"
        "print(sc.filter_speckles(image.astype(np.float32), max_size=2, max_difference=1).shape)\n"
        "print(os.environ['NUMBA_CACHE_DIR'])\n"
    )
    variables = {k: v for k, v in os.environ.items() if k != kernel_cache.VARIABLE}
    variables |= {"HOME": "/proc/nobody", "TMPDIR": str(tmp_path), "TMP": str(tmp_path), "TEMP": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], env=variables, capture_output=True, text=True, check=True)
    shape, folder = done.stdout.split("\n")[:2]
    assert shape == "(20, 40)"
    assert Path(folder).parent == tmp_path
    assert any(Path(folder).rglob("*.nbi"))
