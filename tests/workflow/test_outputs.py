"""Files written whole or not at all."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from stereocal.base.errors import DataFileError
from stereocal.workflow.outputs import StagedFolder, staged_folder


def write_and(staged: StagedFolder, error: BaseException) -> None:
    staged.path("two.txt").write_text("new")
    raise error


def everything(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_files_stand_only_when_the_block_is_done(tmp_path: Path) -> None:
    with staged_folder(tmp_path / "a" / "b") as staged:
        staged.path("figures/one.txt").write_text("1")
        staged.path("two.txt").write_text("2")
        assert not (tmp_path / "a" / "b" / "two.txt").exists()
        assert [path.relative_to(tmp_path).as_posix() for path in staged.published()] == [
            "a/b/figures/one.txt",
            "a/b/two.txt",
        ]
    assert everything(tmp_path) == {"a/b/figures/one.txt": b"1", "a/b/two.txt": b"2"}


def test_a_failure_leaves_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "two.txt").write_text("old")
    with pytest.raises(RuntimeError), staged_folder(tmp_path) as staged:
        write_and(staged, RuntimeError())
    assert everything(tmp_path) == {"two.txt": b"old"}
    assert os.listdir(tmp_path) == ["two.txt"]


def test_a_failure_removes_the_folders_it_made(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), staged_folder(tmp_path / "a" / "b" / "c") as staged:
        write_and(staged, KeyboardInterrupt())
    assert os.listdir(tmp_path) == []


def test_success_replaces_what_has_the_same_name_and_leaves_the_rest(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    (tmp_path / "two.txt").write_text("old")
    with staged_folder(tmp_path) as staged:
        staged.path("two.txt").write_text("new")
    assert everything(tmp_path) == {"mine.txt": b"mine", "two.txt": b"new"}


def test_a_file_where_the_folder_should_be(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    for folder in (tmp_path / "out", tmp_path / "out" / "deeper"):
        with pytest.raises(DataFileError, match="is a file, not a folder"), staged_folder(folder):
            pass
    assert (tmp_path / "out").read_text() == "a file"


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(DataFileError, match="cannot be written"), staged_folder(tmp_path / "out"):
        pass


def test_a_folder_that_no_one_can_make() -> None:
    with pytest.raises(DataFileError, match=r"/proc/.*cannot be written"), staged_folder("/proc/stereocal/out"):
        pass


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_write_that_finds_the_disk_full_names_the_folder(tmp_path: Path) -> None:
    def fill_up() -> None:
        with staged_folder(tmp_path / "out") as staged:
            staged.path("report.html").symlink_to("/dev/full")
            staged.path("report.html").write_text("x" * 100_000)

    with pytest.raises(DataFileError, match=r"out: cannot be written \(No space left on device\)"):
        fill_up()
    assert os.listdir(tmp_path) == []


def test_a_full_disk_names_the_folder_and_the_reason(tmp_path: Path) -> None:
    def fill_up() -> None:
        with staged_folder(tmp_path / "out") as staged:
            write_and(staged, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(staged.path("cloud.ply"))))

    with pytest.raises(DataFileError, match=r"out: cannot be written \(No space left on device\)"):
        fill_up()
    assert os.listdir(tmp_path) == []
