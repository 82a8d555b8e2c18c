"""Data sets: found where they lie, fetched with their hashes, never trusted."""

from __future__ import annotations

import functools
import hashlib
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from stereocal.base.errors import DataFileError, InputError
from stereocal.store.datasets import DESCRIPTIONS, fetch_dataset, load_dataset
from stereocal.store.images import read_image, write_image


@pytest.mark.parametrize("name", list(DESCRIPTIONS))
def test_every_set_opens_and_its_images_read(data, name):
    found = load_dataset(name, data)
    assert found.left
    image = read_image(found.left[0])
    if found.right:
        assert read_image(found.right[0]).shape == image.shape
        assert len(found.left) == len(found.right)
    if DESCRIPTIONS[name].disparity:
        disparity = found.true_disparity()
        assert disparity.shape == image.shape[:2]
        assert np.nanmin(disparity) > 0
        assert 0.01 < np.isnan(disparity).mean() < 0.3
    else:
        with pytest.raises(InputError, match="no true disparity"):
            found.true_disparity()


def test_the_hashes_are_those_of_the_files(data):
    import json
    from importlib import resources

    lists = json.loads(resources.files("stereocal.store").joinpath("dataset_files.json").read_text())
    for name, files in lists.items():
        for relative, source in files.items():
            assert hashlib.sha256((data / name / relative).read_bytes()).hexdigest() == source["sha256"]


def test_a_missing_set_says_where_it_was_looked_for(tmp_path, monkeypatch):
    monkeypatch.setenv("STEREOCAL_DATA", str(tmp_path))
    with pytest.raises(DataFileError, match="stereocal fetch uvc_paper"):
        load_dataset("uvc_paper")
    with pytest.raises(InputError, match="must be one of"):
        load_dataset("nothing")
    (tmp_path / "uvc_paper").mkdir()
    with pytest.raises(DataFileError, match="incomplete"):
        load_dataset("uvc_paper")


@pytest.fixture
def server(tmp_path):
    """A folder served over HTTP on this machine."""
    pytest.importorskip("pooch")

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *arguments: object) -> None:
            pass

    folder = tmp_path / "served"
    folder.mkdir()
    service = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder)))
    threading.Thread(target=service.serve_forever, daemon=True).start()
    yield folder, f"http://127.0.0.1:{service.server_address[1]}/"
    service.shutdown()
    service.server_close()


def _files(folder: Path, address: str) -> dict[str, dict[str, str]]:
    files = {}
    for side in ("left", "right"):
        for k in range(2):
            path = write_image(folder / f"{side}{k}.jpg", np.full((8, 8), 40 * k, np.uint8))
            digest = hashlib.sha256(path.read_bytes()).hexdigest()
            files[f"{side}/{k}.jpg"] = {"url": address + path.name, "sha256": digest}
    return files


def test_fetching_checks_every_file_and_keeps_what_is_right(server, tmp_path):
    folder, address = server
    files = _files(folder, address)
    seen = []
    found = fetch_dataset(
        "opencv_sample", tmp_path / "cache", files=files, progress=lambda done, all_: seen.append((done, all_))
    )
    assert [path.name for path in found.left + found.right] == ["0.jpg", "1.jpg", "0.jpg", "1.jpg"]
    assert seen[-1] == (4, 4)
    for path in folder.iterdir():  # a second time nothing is asked of the server
        path.unlink()
    assert fetch_dataset("opencv_sample", tmp_path / "cache", files=files) == found


def test_a_file_that_is_not_what_it_should_be_is_refused(server, tmp_path):
    folder, address = server
    files = _files(folder, address)
    write_image(folder / "left1.jpg", np.full((8, 8), 99, np.uint8))
    with pytest.raises(DataFileError, match=r"left/1\.jpg: could not be fetched"):
        fetch_dataset("opencv_sample", tmp_path / "cache", files=files)
    assert not (tmp_path / "cache" / "opencv_sample" / "left" / "1.jpg").exists()
    files["left/1.jpg"]["url"] = address + "absent.jpg"
    with pytest.raises(DataFileError, match="could not be fetched"):
        fetch_dataset("opencv_sample", tmp_path / "cache", files=files)


@pytest.mark.parametrize("relative", ["../outside.jpg", "/tmp/outside.jpg", "left/../../outside.jpg"])
def test_a_name_that_leads_out_of_the_folder_is_refused(server, tmp_path, relative):
    folder, address = server
    source = next(iter(_files(folder, address).values()))
    with pytest.raises(InputError, match="leads out"):
        fetch_dataset("opencv_sample", tmp_path / "cache", files={relative: source})


def test_sets_that_cannot_be_fetched_say_so(tmp_path):
    with pytest.raises(InputError, match="must be one of"):
        fetch_dataset("teddy", tmp_path)
