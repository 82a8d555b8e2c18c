from __future__ import annotations

import os
from pathlib import Path
from typing import BinaryIO

import pytest

from stereocal.base.atomic_files import write_whole
from stereocal.base.errors import DataFileError


def test_writes_text_bytes_and_streams_and_makes_the_folder(tmp_path: Path) -> None:
    assert write_whole(tmp_path / "a" / "b" / "text.txt", "σ").read_text("utf-8") == "σ"
    assert write_whole(tmp_path / "bytes", b"\0\1").read_bytes() == b"\0\1"
    assert write_whole(tmp_path / "stream", lambda stream: stream.write(b"x" * 9)).read_bytes() == b"x" * 9


def test_a_failure_leaves_what_was_there_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "calibration.json"
    target.write_text("before")

    def half(stream: BinaryIO) -> None:
        stream.write(b"half")
        raise OSError(28, "No space left on device")

    with pytest.raises(DataFileError, match=r"calibration\.json: cannot be written \(No space left on device\)"):
        write_whole(target, half)
    assert target.read_text() == "before"
    assert os.listdir(tmp_path) == ["calibration.json"]


def test_an_interrupt_leaves_what_was_there_and_nothing_else(tmp_path: Path) -> None:
    def interrupted(stream: BinaryIO) -> None:
        stream.write(b"half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "report.html", interrupted)
    assert os.listdir(tmp_path) == []


def test_a_file_where_the_folder_should_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(DataFileError, match="out"):
        write_whole(tmp_path / "out" / "report.html", "x")


def test_new_files_have_the_usual_permissions(tmp_path: Path) -> None:
    plain = tmp_path / "plain"
    plain.write_text("x")
    assert write_whole(tmp_path / "whole", "x").stat().st_mode == plain.stat().st_mode
