"""Folders and globs to photographs; left and right to pairs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from stereocal.base.errors import DataFileError, InputError
from stereocal.workflow.photographs import Pair, Photograph, list_photographs, pair_photographs


def touch(folder: Path, *names: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"")
    return folder


def names(pairs: list[Pair]) -> list[tuple[str, str]]:
    return [(pair.left.path.name, pair.right.path.name) for pair in pairs]


def test_a_folder_gives_its_images_in_natural_order(tmp_path: Path) -> None:
    touch(tmp_path, "img10.png", "img2.JPG", "notes.txt", ".hidden.png", "img1.tiff")
    assert [path.name for path in list_photographs(tmp_path)] == ["img1.tiff", "img2.JPG", "img10.png"]


def test_globs_and_files_and_folders_together_name_each_photograph_once(tmp_path: Path) -> None:
    touch(tmp_path, "a1.png", "a2.png", "b1.png")
    found = list_photographs([str(tmp_path / "b1.png"), str(tmp_path / "a*.png"), str(tmp_path)])
    assert [path.name for path in found] == ["b1.png", "a1.png", "a2.png"]


def test_nothing_found_names_what_was_looked_for(tmp_path: Path) -> None:
    with pytest.raises(DataFileError, match="holds no photographs"):
        list_photographs(tmp_path)
    with pytest.raises(DataFileError, match=r"\*\.png: matches no file"):
        list_photographs(str(tmp_path / "*.png"))
    with pytest.raises(DataFileError, match=r"missing\.png: does not exist"):
        list_photographs(tmp_path / "missing.png")


@pytest.mark.parametrize(
    ("left", "right"),
    [
        (["000700.jpg", "000798.jpg"], ["000700.jpg", "000798.jpg"]),
        (["left01.jpg", "left02.jpg"], ["right01.jpg", "right02.jpg"]),
        (["L000700.jpg", "L000701.jpg"], ["R000700.jpg", "R000701.jpg"]),
        (["chess_l_3.png", "chess_l_5.png"], ["chess_r_3.png", "chess_r_5.png"]),
        (["cam0_5.png", "cam0_10.png"], ["cam1_5.png", "cam1_10.png"]),
        (["5-left.png", "6-left.png"], ["5-right.jpg", "6-right.jpg"]),
    ],
)
def test_names_pair_without_the_word_for_the_side(tmp_path: Path, left: list[str], right: list[str]) -> None:
    # the right folder lists them the other way round: only the names can get it right
    pairs, alone = pair_photographs(touch(tmp_path / "l", *left), touch(tmp_path / "r", *reversed(right)))
    assert names(pairs) == list(zip(left, right, strict=True))
    assert alone == []


def test_the_rule_that_pairs_more_names_wins(tmp_path: Path) -> None:
    left = touch(tmp_path / "l", "01.jpg", "left02.jpg", "left03.jpg")
    right = touch(tmp_path / "r", "01.jpg", "right02.jpg", "right03.jpg")
    pairs, alone = pair_photographs(left, right)
    assert names(pairs) == [("01.jpg", "01.jpg"), ("left02.jpg", "right02.jpg"), ("left03.jpg", "right03.jpg")]
    assert alone == []


def test_a_photograph_without_a_partner_is_reported_and_shifts_nothing(tmp_path: Path) -> None:
    left = touch(tmp_path / "l", "left1.png", "left2.png", "left3.png")
    right = touch(tmp_path / "r", "right1.png", "right3.png", "right4.png")
    pairs, alone = pair_photographs(left, right)
    assert names(pairs) == [("left1.png", "right1.png"), ("left3.png", "right3.png")]
    assert [photograph.path.name for photograph in alone] == ["left2.png", "right4.png"]


def test_names_that_never_agree_pair_by_order_if_the_counts_do(tmp_path: Path) -> None:
    left = touch(tmp_path / "l", "a2.png", "a10.png")
    right = touch(tmp_path / "r", "IMG_7.png", "IMG_9.png")
    assert names(pair_photographs(left, right)[0]) == [("a2.png", "IMG_7.png"), ("a10.png", "IMG_9.png")]
    touch(tmp_path / "r", "IMG_11.png")
    with pytest.raises(InputError, match="2 photographs left and 3 right"):
        pair_photographs(left, right)


def test_one_folder_with_globs_and_the_same_folder_twice(tmp_path: Path) -> None:
    touch(tmp_path, "left1.png", "left2.png", "right1.png", "right2.png")
    pairs, _ = pair_photographs(str(tmp_path / "left*.png"), str(tmp_path / "right*.png"))
    assert names(pairs) == [("left1.png", "right1.png"), ("left2.png", "right2.png")]
    with pytest.raises(InputError, match="--side-by-side"):
        pair_photographs(tmp_path, tmp_path)


def test_side_by_side_frames_are_halved(tmp_path: Path) -> None:
    frame = np.random.default_rng(1).integers(0, 256, (12, 20, 3), dtype=np.uint8)
    Image.fromarray(frame).save(tmp_path / "1.png")
    ((pair,), alone) = pair_photographs(tmp_path, None)
    assert alone == []
    np.testing.assert_array_equal(pair.left.read(), frame[:, :10])
    np.testing.assert_array_equal(pair.right.read(), frame[:, 10:])
    assert str(pair.right).endswith("1.png (right half)")
    Image.fromarray(frame[:, :19]).save(tmp_path / "odd.png")
    with pytest.raises(DataFileError, match="19 pixels wide"):
        Photograph(tmp_path / "odd.png", "left half").read()
