"""Round trips through every format, exact where the format allows, and refusals where it does not."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from calibration_strategies import cameras, mapped_alike, ordinary_rigs, rigs
from hypothesis import given, settings
from hypothesis import strategies as st

from stereocal.base.errors import DataFileError, InputError
from stereocal.camera.model import Camera
from stereocal.pair.rectification import rectify
from stereocal.pair.rig import StereoRig
from stereocal.store.calibrations import (
    FORMATS,
    convert_calibration,
    load_calibration,
    load_record,
    recognize_format,
    save_calibration,
)
from stereocal.store.rectified_pairs import rectified_rig

K = [[500.0, 0, 320], [0, 501, 240], [0, 0, 1]]
LENS = [-0.3, 0.1, 1e-3, -2e-5, 0.0]
RIG = StereoRig(Camera(K, LENS, (640, 480)), Camera(K, LENS, (640, 480)), np.eye(3), [-60.0, 0.1, 0.2])


def _through(
    folder: Path, calibration: StereoRig | Camera, name: str, file: str, **options: object
) -> StereoRig | Camera:
    """Save, recognise by content, load, and take metres back to millimetres."""
    path = folder / file
    save_calibration(calibration, path, format=name, **options)
    assert recognize_format(path) == name
    record = load_record(path)
    back = record.calibration
    if isinstance(back, StereoRig) and record.unit == "m":
        back = StereoRig(back.left, back.right, back.R, back.T * 1000)
    return back


def _assert_same(back: StereoRig | Camera, given_: StereoRig | Camera, tolerance: float = 0.0) -> None:
    pairs = [(back, given_)] if isinstance(given_, Camera) else [(back.left, given_.left), (back.right, given_.right)]
    assert all(mapped_alike(first, second) for first, second in pairs)
    if isinstance(given_, StereoRig):
        np.testing.assert_allclose(back.R, given_.R, rtol=0, atol=tolerance)
        np.testing.assert_allclose(back.T, given_.T, rtol=0, atol=tolerance * given_.baseline)


ANY_MODEL = ("pinhole", "polynomial", "brown", "rational", "thin_prism", "tilted", "fisheye")


@settings(max_examples=25)
@given(rigs(ANY_MODEL, skew=True) | cameras(ANY_MODEL, skew=True))
def test_our_json_is_lossless(tmp_path_factory, calibration):
    path = tmp_path_factory.mktemp("c") / "calibration.json"
    save_calibration(calibration, path)
    assert load_calibration(path) == calibration


@settings(max_examples=25)
@given(cameras(ANY_MODEL, skew=True), st.sampled_from([".yml", ".xml", ".json"]))
def test_opencv_single_camera(tmp_path_factory, camera, suffix):
    back = _through(tmp_path_factory.mktemp("c"), camera, "opencv", f"a{suffix}")
    _assert_same(back, camera)


@settings(max_examples=10)
@given(ordinary_rigs(), st.sampled_from([".yml", ".xml", ".json"]))
def test_opencv_stereo_reads_in_opencv_and_back(tmp_path_factory, rig, suffix):
    folder = tmp_path_factory.mktemp("c")
    _assert_same(_through(folder, rig, "opencv", f"a{suffix}"), rig)
    storage = cv2.FileStorage(str(folder / f"a{suffix}"), cv2.FILE_STORAGE_READ)
    view = rectify(rig)
    for name, matrix in {
        "M1": rig.left.K,
        "D1": rig.left.dist[None],
        "M2": rig.right.K,
        "D2": rig.right.dist[None],
        "R": rig.R,
        "T": rig.T[:, None],
        "E": rig.E,
        "F": rig.F,
        "R1": view.R1,
        "R2": view.R2,
        "P1": view.P1,
        "P2": view.P2,
        "Q": view.Q,
    }.items():
        np.testing.assert_array_equal(storage.getNode(name).mat(), matrix, err_msg=name)
    assert (storage.getNode("image_width").real(), storage.getNode("image_height").real()) == rig.left.image_size
    storage.release()


@settings(max_examples=15)
@given(ordinary_rigs())
def test_ros_pair(tmp_path_factory, rig):
    folder = tmp_path_factory.mktemp("c")
    _assert_same(_through(folder, rig, "ros", "rig", unit="mm"), rig, 1e-11)
    # an independent reader finds numbers, the true count of them, and −f·B in metres
    document = yaml.safe_load((folder / "rig" / "right.yaml").read_text())
    coefficients = document["distortion_coefficients"]
    assert coefficients["rows"] * coefficients["cols"] == len(coefficients["data"]) == 5
    assert all(isinstance(number, float) for number in coefficients["data"])
    P = np.array(document["projection_matrix"]["data"]).reshape(3, 4)
    np.testing.assert_allclose(-P[0, 3] / P[0, 0], rig.baseline / 1000, rtol=1e-12)


@settings(max_examples=15)
@given(cameras(("pinhole", "brown", "rational", "fisheye")))
def test_ros_camera(tmp_path_factory, camera):
    _assert_same(_through(tmp_path_factory.mktemp("c"), camera, "ros", "camera.yaml"), camera)


@settings(max_examples=20)
@given(rigs(("pinhole", "polynomial", "brown", "fisheye"), zero_from=4))
def test_kalibr(tmp_path_factory, rig):
    folder = tmp_path_factory.mktemp("c")
    _assert_same(_through(folder, rig, "kalibr", "camchain.yaml", unit="mm"), rig, 1e-13)
    document = yaml.safe_load((folder / "camchain.yaml").read_text())
    pose = np.array(document["cam1"]["T_cn_cnm1"])
    assert pose[0, 3] < 0
    np.testing.assert_allclose(pose[:3, 3] * 1000, rig.T, rtol=1e-14, atol=1e-12)
    assert document["cam0"]["resolution"] == list(rig.left.image_size)


@settings(max_examples=20)
@given(rigs(("pinhole", "polynomial", "brown"), skew=True) | cameras(("brown",), skew=True))
def test_boofcv(tmp_path_factory, calibration):
    _assert_same(_through(tmp_path_factory.mktemp("c"), calibration, "boofcv", "stereo.yaml"), calibration, 1e-12)


@settings(max_examples=20)
@given(rigs(("polynomial", "brown"), skew=True) | cameras(("brown",), skew=True), st.sampled_from([".mat", ".json"]))
def test_matlab(tmp_path_factory, calibration, suffix):
    back = _through(tmp_path_factory.mktemp("c"), calibration, "matlab", f"a{suffix}", unit="mm")
    # cx + 1 − 1 rounds in the last bit
    first, second = (each if isinstance(each, Camera) else each.right for each in (back, calibration))
    np.testing.assert_allclose(first.K, second.K, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(first.dist[: len(second.dist)], second.dist)
    if isinstance(calibration, StereoRig):
        np.testing.assert_array_equal(back.R, calibration.R)
        np.testing.assert_array_equal(back.T, calibration.T)


@settings(max_examples=20)
@given(rigs(("pinhole", "polynomial", "brown", "rational", "thin_prism")) | cameras(("pinhole", "brown", "thin_prism")))
def test_mrcal(tmp_path_factory, calibration):
    file = "rig" if isinstance(calibration, StereoRig) else "a.cameramodel"
    _assert_same(_through(tmp_path_factory.mktemp("c"), calibration, "mrcal", file), calibration, 1e-12)


@settings(max_examples=20)
@given(cameras(("pinhole", "polynomial", "brown", "rational", "fisheye")))
def test_colmap(tmp_path_factory, camera):
    back = _through(tmp_path_factory.mktemp("c"), camera, "colmap", "cameras.txt")
    np.testing.assert_allclose(back.K, camera.K, rtol=0, atol=1e-12)  # + 0.5 − 0.5 rounds
    _assert_same(Camera(camera.K, back.dist, back.image_size, model=back.model), camera)


@settings(max_examples=15)
@given(st.floats(50, 5000), st.floats(50, 5000), st.floats(100, 900), st.floats(100, 900), st.floats(20, 400))
def test_kitti_and_middlebury(tmp_path_factory, fx, fy, cx0, cx1, baseline):
    folder = tmp_path_factory.mktemp("c")
    rig = rectified_rig((fx, fy), (cx0, cx1), 240.0, baseline, (640, 481))
    _assert_same(_through(folder, rig, "middlebury", "calib.txt", unit="mm"), rig, 1e-12)
    back = _through(folder, rig, "kitti", "calib_kitti.txt", unit="mm")
    np.testing.assert_array_equal(back.left.K, rig.left.K)
    np.testing.assert_array_equal(back.right.K, rig.right.K)
    np.testing.assert_allclose(back.T, rig.T, rtol=1e-13)


@settings(max_examples=3)
@given(ordinary_rigs())
def test_the_papers_npz_gives_back_the_rig_from_its_maps(tmp_path_factory, rig):
    back = _through(tmp_path_factory.mktemp("c"), rig, "paper", "a.npz")
    np.testing.assert_array_equal(back.left.K, rig.left.K)
    np.testing.assert_allclose(back.R, rig.R, rtol=0, atol=1e-6)
    np.testing.assert_allclose(back.T, rig.T, rtol=0, atol=1e-6 * rig.baseline)
    points = np.random.default_rng(0).uniform((0, 0), np.array(rig.left.image_size) - 1, (100, 2))
    for first, second in ((back.left, rig.left), (back.right, rig.right)):
        inside = second.distort_points(points)
        kept = (inside > 0).all(1) & (inside < np.array(rig.left.image_size) - 1).all(1)
        np.testing.assert_allclose(first.distort_points(points)[kept], inside[kept], atol=1e-3)


def test_extra_fields_are_merged_and_read_back(tmp_path):
    extra = {
        "rms": 0.25,
        "left": {"rms": np.float64(0.2)},
        "pairs": [{"left": "a.png", "used": True}],
        "covariance": np.eye(2),
        "inner_corners": (9, 6),
        "broken": float("nan"),
    }
    save_calibration(RIG, tmp_path / "c.json", unit="mm", extra=extra)
    document = json.loads((tmp_path / "c.json").read_text())
    assert document["left"]["rms"] == 0.2
    assert document["left"]["K"] == K
    assert document["baseline"] == RIG.baseline
    assert document["broken"] is None
    record = load_record(tmp_path / "c.json")
    assert record.unit == "mm"
    assert record.extra["covariance"] == [[1, 0], [0, 1]]
    assert record.extra["left"] == {"rms": 0.2}
    assert load_calibration(tmp_path / "c.json") == RIG


@pytest.mark.parametrize("extra", [{"T": [1, 2, 3]}, {"left": {"K": np.eye(3)}}, {"format": "other"}, {"x": object()}])
def test_extra_fields_never_replace_the_calibration(tmp_path, extra):
    with pytest.raises(InputError, match="extra"):
        save_calibration(RIG, tmp_path / "c.json", extra=extra)
    assert not list(tmp_path.iterdir())


def _camera(model: str, dist: list[float], skew: float = 0.0) -> Camera:
    return Camera([[500, skew, 320], [0, 500, 240], [0, 0, 1]], dist, (640, 480), model=model)


@pytest.mark.parametrize(
    ("name", "camera"),
    [
        ("opencv", _camera("division", [-0.2])),
        ("opencv", _camera("fov", [0.8])),
        ("ros", _camera("thin_prism", [0.1] * 12)),
        ("ros", _camera("brown", [0.1] * 5, skew=0.5)),
        ("kalibr", _camera("brown", [-0.3, 0.1, 0, 0, 0.02])),
        ("kalibr", _camera("brown", [-0.3, 0.1], skew=0.5)),
        ("boofcv", _camera("rational", [0.1] * 8)),
        ("boofcv", _camera("fisheye", [0.1] * 4)),
        ("matlab", _camera("tilted", [0.1] * 14)),
        ("mrcal", _camera("tilted", [0.1] * 14)),
        ("mrcal", _camera("fisheye", [0.1] * 4)),
        ("colmap", _camera("thin_prism", [0.1] * 12)),
        ("colmap", _camera("brown", [0.1], skew=0.1)),
        ("kitti", _camera("pinhole", [])),
        ("middlebury", _camera("pinhole", [])),
        ("paper", _camera("brown", [0.1])),
    ],
)
def test_what_a_format_cannot_hold_is_refused(tmp_path, name, camera):
    with pytest.raises(InputError):
        save_calibration(camera, tmp_path / "out", format=name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["colmap", "kitti", "middlebury"])
def test_a_rig_that_is_not_rectified_or_needs_a_pose_is_refused(tmp_path, name):
    with pytest.raises(InputError):
        save_calibration(RIG, tmp_path / "out", format=name, unit="mm")


@pytest.mark.parametrize(("baseline", "unit"), [(60.0, "mm"), (0.12, "m")])
def test_an_unknown_unit_is_told_from_the_baseline_and_said(tmp_path, baseline, unit):
    rig = StereoRig(RIG.left, RIG.right, np.eye(3), [-baseline, 0, 0])
    save_calibration(rig, tmp_path / "c.json")
    sentences = convert_calibration(tmp_path / "c.json", tmp_path / "k.yaml", to="kalibr")
    assert any("no unit is stored" in sentence for sentence in sentences)
    expected = baseline * {"mm": 1e-3, "m": 1.0}[unit]
    np.testing.assert_allclose(-load_calibration(tmp_path / "k.yaml").T[0], expected)


def test_an_ambiguous_unit_is_refused_until_named(tmp_path):
    rig = StereoRig(RIG.left, RIG.right, np.eye(3), [-2.84, 0, 0])
    save_calibration(rig, tmp_path / "c.json")
    with pytest.raises(InputError, match="unit"):
        convert_calibration(tmp_path / "c.json", tmp_path / "k.yaml", to="kalibr")
    assert not (tmp_path / "k.yaml").exists()
    convert_calibration(tmp_path / "c.json", tmp_path / "k.yaml", to="kalibr", unit="in")
    np.testing.assert_allclose(load_calibration(tmp_path / "k.yaml").T[0], -2.84 * 0.0254)
    with pytest.raises(InputError, match="says that its lengths are in m"):
        convert_calibration(tmp_path / "k.yaml", tmp_path / "c2.json", unit="mm")


def test_conversion_names_what_changes_meaning(tmp_path):
    save_calibration(RIG, tmp_path / "c.json", unit="mm", extra={"pairs": [], "rms": 0.1})
    for name, words in {
        "opencv": ("unit", "no place for: pairs"),
        "ros": ("0.06", "minus focal length times baseline", "no place for"),
        "matlab": ("1 px", "transposed"),
        "boofcv": ("inverse",),
        "paper": ("float32",),
    }.items():
        sentences = " ".join(convert_calibration(tmp_path / "c.json", tmp_path / f"out_{name}", to=name))
        assert all(word in sentences for word in words), (name, sentences)
    save_calibration(RIG.left, tmp_path / "one.json")
    sentences = convert_calibration(tmp_path / "one.json", tmp_path / "cameras.txt", to="colmap")
    assert any("0.5" in sentence for sentence in sentences)


ON_READING = {
    "stereocal": (),
    "opencv": (),
    "ros": ("R and T are recovered", "metres"),
    "kalibr": (),
    "boofcv": ("right to left",),
    "matlab": ("1 px is taken off", "IntrinsicMatrix is transposed", "RotationOfCamera2 is transposed"),
    "mrcal": (),
    "paper": ("fitted to the rectification maps",),
    "kitti": ("image size",),
    "middlebury": (),
}
ON_WRITING = {
    "stereocal": (),
    "opencv": ("do not say the unit",),
    "ros": ("is written as", "minus focal length times baseline, in metres"),
    "kalibr": ("is written as",),
    "boofcv": ("inverse of R and T",),
    "matlab": ("1 px is added", "IntrinsicMatrix is K transposed", "RotationOfCamera2 is R transposed"),
    "mrcal": ("rotation vector", "habit is metres"),
    "paper": ("in the rectification maps", "does not say the unit"),
    "kitti": ("is written as", "no place for the image size"),
    "middlebury": ("is written as", "doffs must be added"),
}


@pytest.mark.parametrize("source", list(ON_READING))
def test_every_pair_of_formats_says_what_changes_and_nothing_else(tmp_path, source):
    """The sentences of a conversion are those of reading the one and of writing the other."""
    rig = rectified_rig((500.0, 501.0), (320.0, 330.0), 240.0, 60.0, (641, 481))
    save_calibration(rig, tmp_path / "in", format=source, unit="mm")
    knows_unit = load_record(tmp_path / "in", format=source).unit is not None
    for target in ON_WRITING:
        if source == "paper" and target in ("kitti", "middlebury", "kalibr"):
            continue  # what is found again from float32 maps is rectified, and without k3, to 1e-6 only
        sentences = convert_calibration(
            tmp_path / "in", tmp_path / f"to_{target}", to=target, unit=None if knows_unit else "mm"
        )
        expected = (*ON_READING[source], *ON_WRITING[target])
        said = " ".join(sentences)
        assert all(words in said for words in expected), (target, said)
        unexpected = [s for s in sentences if not any(words in s for words in (*expected, "has no place for"))]
        assert not unexpected, (target, unexpected)


def test_chain_of_conversions_returns_to_the_start(tmp_path):
    save_calibration(RIG, tmp_path / "0.json", unit="mm")
    steps = ["opencv", "kalibr", "boofcv", "mrcal", "matlab", "ros", "stereocal"]
    source = tmp_path / "0.json"
    for k, name in enumerate(steps):
        target = tmp_path / f"{k}_{name}"
        # OpenCV's, BoofCV's and mrcal's files forget the unit: millimetres before Kalibr, metres after
        forgotten = load_record(source).unit is None
        convert_calibration(source, target, to=name, unit=("mm" if k < 2 else "m") if forgotten else None)
        source = target
    record = load_record(source)
    assert record.unit == "m"
    _assert_same(StereoRig(*record.cameras, record.calibration.R, record.calibration.T * 1000), RIG, 1e-12)


def test_the_sample_pair_of_files_is_read_by_either_name_and_by_folder(tmp_path):
    for file, names in (("intrinsics.yml", ("M1", "D1", "M2", "D2")), ("extrinsics.yml", ("R", "T"))):
        storage = cv2.FileStorage(str(tmp_path / file), cv2.FILE_STORAGE_WRITE)
        content = {"M1": RIG.left.K, "D1": RIG.left.dist[None], "M2": RIG.right.K, "D2": RIG.right.dist[None]}
        content |= {"R": RIG.R, "T": RIG.T[:, None]}
        for name in names:
            storage.write(name, content[name])
        storage.release()
    for source in (tmp_path, tmp_path / "intrinsics.yml", tmp_path / "extrinsics.yml"):
        record = load_record(source)
        np.testing.assert_array_equal(record.calibration.T, RIG.T)
        np.testing.assert_array_equal(record.calibration.left.dist, RIG.left.dist)
        assert any("image size" in remark for remark in record.remarks)
    (tmp_path / "extrinsics.yml").unlink()
    with pytest.raises(DataFileError, match="extrinsics"):
        load_calibration(tmp_path / "intrinsics.yml")


def test_every_format_is_documented_and_complete():
    import importlib

    for each in FORMATS.values():
        module = importlib.import_module(f"stereocal.store.{each.module}")
        assert len(module.__doc__) > 400, each.name
        assert all(hasattr(module, name) for name in ("read", "write", "remarks_on_writing", "TITLE", "EXTRA"))


def test_the_ending_decides_or_the_format_must_be_named(tmp_path):
    with pytest.raises(InputError, match="name one of"):
        save_calibration(RIG, tmp_path / "rig.abc")
    with pytest.raises(InputError, match="format must be one of"):
        save_calibration(RIG, tmp_path / "rig.json", format="abc")
