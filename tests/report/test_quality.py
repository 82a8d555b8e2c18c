from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from matplotlib.figure import Figure
from report_cases import SIZE, Case, make_case

from stereocal.base.errors import DataFileError, InputError
from stereocal.report.quality import QualityReport, evaluate_calibration


@pytest.fixture(scope="module")
def report(healthy: Case) -> QualityReport:
    images = [(np.full((480, 640), 90, np.uint8), np.full((480, 640, 3), 120, np.uint8)) for _ in range(17)]
    pairs = [{"left": f"L{i}.png", "right": f"R{i}.png", "used": True, "reason": None} for i in range(16)]
    pairs.append({"left": "<b>.png", "right": "x.png", "used": False, "reason": "no board found in the left image"})
    return evaluate_calibration(
        healthy.calibration, healthy.board, healthy.left, healthy.right, SIZE, pairs=pairs, images=images, unit="mm"
    )


def test_a_healthy_calibration_is_good(report: QualityReport) -> None:
    assert report.overall == "good", [v for v in report.verdicts if v.decides and v.verdict != "good"]


def test_a_bent_board_is_called_bad_and_named(bent: Case) -> None:
    report = evaluate_calibration(bent.calibration, bent.board, bent.left, bent.right)
    assert report.overall == "bad"
    assert any("board is not flat" in v.cause for v in report.verdicts if v.verdict == "bad")


def test_few_views_are_not_good_and_do_not_crash() -> None:
    case = make_case(views=3, noise=0.15)
    report = evaluate_calibration(case.calibration, case.board, case.left, case.right)
    assert report.overall == "bad"
    assert any("too few pairs" in v.cause.lower() for v in report.verdicts)


def test_every_verdict_is_whole(report: QualityReport) -> None:
    for verdict in report.verdicts:
        assert verdict.source
        assert verdict.threshold
        assert verdict.meaning
        assert bool(verdict.action) == bool(verdict.cause) == (verdict.verdict != "good")
    keys = {block.key for block in report.blocks}
    assert keys >= {"data", "fit", "parameters", "generalisation", "epipolar", "metric", "depth"}


class Links(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self.images_without_text = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.found += [v for k, v in values.items() if k in ("src", "href") and v]
        if tag == "script":
            self.found.append("script")
        if tag == "img" and not values.get("alt"):
            self.images_without_text += 1


def test_the_page_stands_alone(report: QualityReport, tmp_path) -> None:
    page = report.save_html(tmp_path / "report.html").read_text(encoding="utf-8")
    links = Links()
    links.feed(page)
    assert all(link.startswith(("data:", "#")) for link in links.found)
    assert links.images_without_text == 0
    assert 'name="viewport"' in page
    assert "@media print" in page
    assert "url(" not in page
    assert "&lt;b&gt;.png" in page, "names of files are text, not markup"
    assert "<b>.png" not in page
    for verdict in report.verdicts:
        assert re.search(re.escape(verdict.spelt_value), page)


def test_page_and_json_say_the_same(report: QualityReport, tmp_path) -> None:
    document = json.loads(report.save_json(tmp_path / "report.json").read_text(encoding="utf-8"))
    assert document["verdict"] == report.overall
    assert [v["name"] for v in document["verdicts"]] == [v.name for v in report.verdicts]
    assert document["blocks"]["data"]["rejected"][0]["reason"] == "no board found in the left image"
    page = report.save_html(tmp_path / "r.html").read_text(encoding="utf-8")
    assert f"{document['blocks']['generalisation']['held_out_rms']:.3f} px" in page


def test_figures_are_drawn_once_and_saved(report: QualityReport, tmp_path) -> None:
    assert all(isinstance(figure, Figure) for figure in report.figures.values())
    assert report.figures is report.figures
    files = report.save_figures(tmp_path / "figures")
    assert {f.stem for f in files} == set(report.figures)
    assert all(f.read_bytes().startswith(b"\x89PNG") for f in files)


def test_no_global_plotting_state_is_touched(report: QualityReport) -> None:
    import sys

    import matplotlib

    before = dict(matplotlib.rcParams)
    report.png  # noqa: B018
    assert dict(matplotlib.rcParams) == before
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or not pyplot.get_fignums()


def test_the_same_input_gives_the_same_report(healthy: Case) -> None:
    one, two = (
        evaluate_calibration(healthy.calibration, healthy.board, healthy.left, healthy.right).as_dict()
        for _ in range(2)
    )
    assert one == two


def test_bad_input_is_refused_in_a_sentence(healthy: Case, tmp_path) -> None:
    case = healthy
    with pytest.raises(InputError, match="16 views"):
        evaluate_calibration(case.calibration, case.board, case.left[:5], case.right[:5])
    with pytest.raises(InputError, match="47 corners"):
        evaluate_calibration(case.calibration, case.board, [c[:47] for c in case.left], case.right)
    with pytest.raises(InputError, match="marked as used"):
        evaluate_calibration(case.calibration, case.board, case.left, case.right, pairs=[{"left": "a", "used": True}])
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    report = evaluate_calibration(case.calibration, case.board, case.left, case.right)
    with pytest.raises(DataFileError):
        report.save_json(blocked / "report.json")
    assert blocked.read_text() == "in the way"


def test_a_known_distance_tells_the_wrong_scale(healthy: Case) -> None:
    """Squares used in the fit cannot: they come out right whatever their true size."""
    wrong = replace(healthy.board, square_size=26.0)
    from stereocal.pair.stereo_calibration import calibrate_stereo

    calibration = calibrate_stereo(wrong.object_points, healthy.left, healthy.right, SIZE)
    ends = [np.array([[-100.0, 0, 800]]), np.array([[100.0, 20, 820]])]
    rig = healthy.truth
    seen = [(*rig.left.project(X)[0], *rig.right.project(X @ rig.R.T + rig.T)[0]) for X in ends]
    length = float(np.linalg.norm(ends[1] - ends[0]))
    report = evaluate_calibration(
        calibration, wrong, healthy.left, healthy.right, known_distances=[(seen[0], seen[1], length)]
    )
    by_name = {v.name: v for v in report.verdicts}
    assert by_name["scale of the triangulated boards"].verdict == "good"
    assert by_name["known distance"].verdict == "bad"
    assert by_name["known distance"].value == pytest.approx(4, abs=0.5)
