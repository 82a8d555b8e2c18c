"""Files made to harm: each is refused by one sentence that names it, quickly, and nothing in it runs."""

from __future__ import annotations

import io
import pickle
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from stereocal.base.errors import DataFileError
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.store.calibrations import FORMATS, load_calibration, save_calibration
from stereocal.store.rectified_pairs import rectified_rig

LENS = [-0.3, 0.1, 1e-3, -2e-5, 0.0]
CAMERA = Camera([[500.0, 0, 320], [0, 501, 240], [0, 0, 1]], LENS, (640, 480))
RIG = StereoRig(CAMERA, CAMERA, np.eye(3), [-60.0, 0.1, 0.2])
RECTIFIED = rectified_rig((500.0, 500.0), (320.0, 330.0), 240.0, 60.0, (640, 480))


def _refused(path: Path, **options: str) -> str:
    start = time.perf_counter()
    with pytest.raises(DataFileError) as caught:
        load_calibration(path, **options)
    assert time.perf_counter() - start < 20
    sentence = str(caught.value)
    assert str(path.parent) in sentence
    assert "\n" not in sentence
    assert len(sentence) < 600
    return sentence


@pytest.mark.parametrize("name", ["opencv", "ros", "kalibr", "boofcv"])
@pytest.mark.parametrize(
    "attack",
    [
        "!!python/object/apply:os.system ['touch {marker}']",
        "!!python/object/new:subprocess.Popen [['touch', '{marker}']]",
        "!!python/name:os.system",
        "!unknown {{a: 1}}",
    ],
)
def test_yaml_tags_build_nothing(tmp_path, name, attack):
    marker = tmp_path / "marker"
    path = tmp_path / "c.yaml"
    path.write_text(f"model: stereo_camera\ncam0: {attack.format(marker=marker)}\n")
    _refused(path, format=name)
    assert not marker.exists()


def test_yaml_aliases_are_no_bomb(tmp_path):
    lines = ["a: &a [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"{chr(98 + k)}: &{chr(98 + k)} [{', '.join(['*' + chr(97 + k)] * 10)}]" for k in range(12)]
    path = tmp_path / "camchain.yaml"
    path.write_text("\n".join(lines) + "\ncam0: {camera_model: *m}\n")
    assert "alias" in _refused(path, format="kalibr")


def test_xml_entities_are_no_bomb_and_read_no_file(tmp_path):
    path = tmp_path / "c.xml"
    secret = tmp_path / "secret"
    secret.write_text("12345")
    bomb = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 12))
    for prolog in (
        f'<!DOCTYPE x [<!ENTITY e0 "aaaaaaaaaa">{bomb}]>',
        f'<!DOCTYPE x [<!ENTITY e11 SYSTEM "file://{secret}">]>',
    ):
        path.write_text(f'<?xml version="1.0"?>\n{prolog}<opencv_storage><M1>&e11;</M1></opencv_storage>')
        sentence = _refused(path)
        assert "entities" in sentence
        assert "12345" not in sentence


@pytest.mark.parametrize(
    ("name", "content"), [("c.json", "[" * 100_000), ("c.json", '{"a":' * 100_000), ("c.yaml", "[" * 20_000)]
)
def test_deep_nesting_does_not_overflow(tmp_path, name, content):
    (tmp_path / name).write_text(
        '"stereocal calibration opencv-matrix"' + content if name.endswith("yaml") else content
    )
    _refused(tmp_path / name, format="stereocal" if name.endswith("json") else "opencv")


def test_huge_numbers_nan_and_duplicates_are_refused(tmp_path):
    path = tmp_path / "c.json"
    save_calibration(RIG, path)
    good = path.read_text()
    for bad in (
        good.replace("501.0", "NaN", 1),
        good.replace("501.0", "1e999", 1),
        good.replace("501.0", "9" * 5000, 1),
        good.replace("501.0", '"five hundred"', 1),
        good.replace("501.0", "true", 1),
        good.replace("501.0", "[501.0]", 1),
        good.replace("501.0", "-501.0", 1),
        good.replace('"T": [', '"T": [1.0], "T": [', 1),
        good.replace("640", "64e300", 1),
        good.replace("640", "0", 1),
        good.replace('"brown"', '"brwon"', 1),
        good.replace('"version": 1', '"version": 99', 1),
        good.replace('"R": [', '"R": [[2.0, 0.0, 0.0],', 1),
    ):
        assert bad != good
        path.write_text(bad)
        _refused(path)


class _Harmful:
    """A pickle of this creates a file when it is loaded."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self):
        return open, (str(self.marker), "w")


def test_a_pickle_in_the_npz_is_never_opened(tmp_path):
    marker = tmp_path / "marker"
    harmful = np.empty(1, dtype=object)
    harmful[0] = _Harmful(marker)
    np.savez(tmp_path / "c.npz", imageSize=harmful)
    assert "nothing in it was run" in _refused(tmp_path / "c.npz")
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
        archive.writestr("imageSize.npy", pickle.dumps(_Harmful(marker)))
    assert not marker.exists()
    _refused(tmp_path / "c.npz")
    assert not marker.exists()


def test_an_npz_that_unpacks_to_gigabytes_is_refused(tmp_path):
    path = tmp_path / "c.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("imageSize.npy", "w") as stream:
        for _ in range(600):
            stream.write(bytes(2**20))
    assert path.stat().st_size < 2**20
    assert "unpacks to more" in _refused(path)


def test_a_mat_that_unpacks_to_much_is_refused(tmp_path):
    buffer = io.BytesIO()
    savemat(buffer, {"CameraParameters1": np.zeros((3000, 3000))}, do_compression=True)
    path = tmp_path / "c.mat"
    path.write_bytes(buffer.getvalue())
    assert "unpacks to more" in _refused(path)


def test_mrcal_text_is_never_run(tmp_path):
    path = tmp_path / "a.cameramodel"
    marker = tmp_path / "marker"
    path.write_text(f"{{'lensmodel': open({str(marker)!r}, 'w'), 'imagersize': [1, 1]}}")
    assert "nothing in it was run" in _refused(path)
    assert not marker.exists()
    path.write_text("{'lensmodel': " + "(" * 5000 + "'imagersize'")
    _refused(path)


def test_a_file_too_large_is_not_read(tmp_path):
    path = tmp_path / "c.json"
    with path.open("wb") as stream:
        stream.truncate(40 * 2**20)
    assert "too large" in _refused(path)


def test_missing_empty_binary_and_folders(tmp_path):
    (tmp_path / "empty.json").touch()
    (tmp_path / "noise.yml").write_bytes(bytes(range(256)) * 20)
    (tmp_path / "folder").mkdir()
    for name in ("missing.json", "empty.json", "noise.yml", "folder", "a\0b"):
        _refused(tmp_path / name)


def _all_formats(folder: Path) -> dict[str, list[Path]]:
    files = {}
    for name in FORMATS:
        calibration = CAMERA if name == "colmap" else RECTIFIED if name in ("kitti", "middlebury") else RIG
        files[name] = save_calibration(calibration, folder / name, format=name, unit="mm" if name != "colmap" else None)
    return files


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """One file or folder of every format."""
    folder = tmp_path_factory.mktemp("formats")
    return folder, _all_formats(folder)


@pytest.mark.parametrize("name", list(FORMATS))
def test_cut_short_anywhere_a_file_is_refused_or_says_the_same(saved, tmp_path, name):
    folder, files = saved
    whole = load_calibration(folder / name, format=name)
    victim = files[name][-1]
    content = victim.read_bytes()
    refused = 0
    lengths = np.unique(np.linspace(0, len(content) - 1, 40 if name != "paper" else 8).astype(int))
    for length in lengths:
        victim.write_bytes(content[:length])
        try:
            cut = load_calibration(folder / name, format=name)
        except DataFileError:
            refused += 1
        else:
            # only white space, a closing line, or entries that are derived may be missing; numbers never change
            assert _close(cut, whole), length
    victim.write_bytes(content)
    assert refused > 0.5 * len(lengths)


def _close(first: StereoRig | Camera, second: StereoRig | Camera) -> bool:
    if isinstance(first, Camera) or isinstance(second, Camera):
        return first == second
    return first.left == second.left and first.right == second.right and np.allclose(first.T, second.T, rtol=1e-12)


@settings(max_examples=80)
@given(st.sampled_from([name for name in FORMATS if name != "paper"]), st.integers(0, 2**32 - 1))
def test_mangled_files_raise_nothing_else(saved, name, seed):
    folder, files = saved
    random = np.random.default_rng(seed)
    victim = files[name][-1]
    content = victim.read_bytes()
    mangled = bytearray(content)
    for place in random.integers(0, len(mangled), 4):
        mangled[place] = random.choice(list(b'0123456789.-eE[]{}:,"\n !&*\x00\xff'))
    victim.write_bytes(bytes(mangled))
    try:
        load_calibration(folder / name, format=name)
    except DataFileError as error:  # any other exception fails the test
        sentence = str(error)
    else:
        sentence = ""
    finally:
        victim.write_bytes(content)
    assert "\n" not in sentence
