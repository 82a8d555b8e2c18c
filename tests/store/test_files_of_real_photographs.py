"""The calibration of OpenCV's sample photographs, written for OpenCV, ROS and Kalibr and read by readers not ours."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

import stereocal as sc

SIZE = (640, 480)


@pytest.fixture(scope="module")
def corners(data: Path) -> tuple[sc.Chessboard, list[np.ndarray], list[np.ndarray]]:
    """The board, and the corners of the 13 pairs."""
    board = sc.Chessboard((9, 6), 30.0)
    sides = []
    for side in ("left", "right"):
        images = [sc.read_image(path, gray=True) for path in sorted((data / "opencv_sample" / side).glob("*.jpg"))]
        sides.append([sc.detect_chessboard(image, board) for image in images])
    return board, sides[0], sides[1]


@pytest.fixture(scope="module")
def rig(corners) -> sc.StereoRig:
    """The rig of the photographs, with k3."""
    board, left, right = corners
    return sc.calibrate_stereo(board.object_points, left, right, SIZE).rig


@pytest.mark.parametrize("suffix", [".yml", ".xml", ".json"])
def test_opencv_reads_the_same_numbers_and_rectifies_to_our_Q(tmp_path, rig, suffix):
    path = tmp_path / f"calibration{suffix}"
    sc.save_calibration(rig, path, format="opencv", unit="mm")
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    read = {
        name: storage.getNode(name).mat() for name in ["M1", "D1", "M2", "D2", "R", "T", "R1", "R2", "P1", "P2", "Q"]
    }
    size = tuple(int(storage.getNode(name).real()) for name in ("image_width", "image_height"))
    storage.release()
    assert size == SIZE
    given = {"M1": rig.left.K, "D1": rig.left.dist[None], "M2": rig.right.K, "D2": rig.right.dist[None]}
    for name, matrix in (given | {"R": rig.R, "T": rig.T[:, None]}).items():
        np.testing.assert_array_equal(read[name], matrix, err_msg=name)
    cameras = [read[name] for name in ("M1", "D1", "M2", "D2")]
    found = cv2.stereoRectify(*cameras, size, read["R"], read["T"], flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1)
    for name, matrix in zip(("R1", "R2", "P1", "P2", "Q"), found, strict=False):
        np.testing.assert_allclose(read[name], matrix, rtol=1e-9, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(read["Q"], sc.rectify(rig).Q, rtol=0, atol=0)


def test_ros_files_parse_to_the_same_numbers(tmp_path, rig):
    sc.save_calibration(rig, tmp_path / "rig", format="ros", unit="mm")
    left, right = (yaml.safe_load((tmp_path / "rig" / f"{side}.yaml").read_text()) for side in ("left", "right"))

    def matrix(document, name):
        entry = document[name]
        return np.array(entry["data"]).reshape(entry["rows"], entry["cols"])

    for document, camera in ((left, rig.left), (right, rig.right)):
        assert (document["image_width"], document["image_height"]) == SIZE
        assert document["distortion_model"] == "plumb_bob"
        np.testing.assert_array_equal(matrix(document, "camera_matrix"), camera.K)
        np.testing.assert_array_equal(matrix(document, "distortion_coefficients")[0], camera.dist)
    # points in metres, seen by both cameras: the file's own rectification puts them on one row, f B / d apart
    X = np.array([[-0.2, 0.1, 0.9], [0.15, -0.08, 1.5], [0.01, 0.02, 0.7]])
    R1, R2 = matrix(left, "rectification_matrix"), matrix(right, "rectification_matrix")
    P1, P2 = matrix(left, "projection_matrix"), matrix(right, "projection_matrix")
    turned = X @ R1.T
    first, second = turned @ P1[:, :3].T, turned @ P2[:, :3].T + P2[:, 3]
    first, second = first / first[:, 2:], second / second[:, 2:]
    np.testing.assert_allclose(first[:, 1], second[:, 1], atol=1e-9)
    np.testing.assert_allclose(-P2[0, 3] / (first[:, 0] - second[:, 0]), turned[:, 2], rtol=1e-10)
    # and OpenCV, given R and T as they follow from it, draws them where ours does
    R, T = R2.T @ R1, R2.T @ [P2[0, 3] / P2[0, 0], 0, 0]
    K, dist = matrix(right, "camera_matrix"), matrix(right, "distortion_coefficients")
    drawn, _ = cv2.projectPoints(X, cv2.Rodrigues(R)[0], T, K, dist)
    np.testing.assert_allclose(drawn[:, 0], rig.right.project(1000 * X @ rig.R.T + rig.T), atol=1e-8)
    assert -P2[0, 3] / P2[0, 0] == pytest.approx(rig.baseline / 1000, rel=1e-12)


def test_kalibr_file_parses_to_the_same_numbers(tmp_path, corners):
    board, left, right = corners
    rig = sc.calibrate_stereo(board.object_points, left, right, SIZE, fix="k3").rig  # radtan has no k3
    sc.save_calibration(rig, tmp_path / "camchain.yaml", format="kalibr", unit="mm")
    document = yaml.safe_load((tmp_path / "camchain.yaml").read_text())
    for name, camera in (("cam0", rig.left), ("cam1", rig.right)):
        entry = document[name]
        assert (entry["camera_model"], entry["distortion_model"]) == ("pinhole", "radtan")
        assert tuple(entry["resolution"]) == SIZE
        assert entry["intrinsics"] == [camera.fx, camera.fy, camera.cx, camera.cy]
        assert entry["distortion_coeffs"] == camera.dist[:4].tolist()
    pose = np.array(document["cam1"]["T_cn_cnm1"])
    np.testing.assert_array_equal(pose[:3, :3], rig.R)
    np.testing.assert_allclose(1000 * pose[:3, 3], rig.T, rtol=1e-15)
    # OpenCV, given these numbers, draws the board's corners where ours does
    fu, fv, pu, pv = document["cam1"]["intrinsics"]
    X = board.object_points + np.array([-100.0, -60, 500])
    drawn, _ = cv2.projectPoints(
        X, cv2.Rodrigues(pose[:3, :3])[0], 1000 * pose[:3, 3], np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1.0]]),
        np.array(document["cam1"]["distortion_coeffs"]),
    )  # fmt: skip
    np.testing.assert_allclose(drawn[:, 0], rig.right.project(X @ rig.R.T + rig.T), atol=1e-9)
