"""The commands that lead to a calibrated rig: demo, board, detect, calibrate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from stereocal.base.errors import InputError
from stereocal.cli.app import Output, answer, app, usage
from stereocal.cli.terminal import Terminal
from stereocal.workflow.quantities import parse_inner_corners, parse_length

Model = Literal[
    "pinhole",
    "polynomial",
    "brown",
    "rational",
    "thin_prism",
    "tilted",
    "fisheye",
    "fov",
    "division",
    "rational_function",
]


@app.command(sort_key=1)
def demo(*, out: Path = Path("out/demo"), pairs: int = 12, seed: int = 0, output: Output | None = None) -> int:
    """Calibrate a rendered rig whose truth is known, and compare.

    Renders photographs of a chessboard and of a scene by two distorted cameras, runs the whole pipeline on them, and
    says for each bound whether the result keeps it. Exit code 1 if one does not.

    Example: `stereocal demo --out out/demo`

    Parameters
    ----------
    out : Path
        Folder for the photographs and all results.
    pairs : int
        How many pairs of photographs are rendered.
    seed : int
        Another seed renders another rig.
    """
    from stereocal.cli.summaries import summarize_demo
    from stereocal.workflow.demonstration import run_demo

    run = run_demo(out, pairs=pairs, seed=seed, progress=Terminal())
    answer(output, run.as_dict, summarize_demo(run))
    return 0 if run.holds else 1


@app.command(sort_key=2)
def board(
    *,
    inner_corners: str = "7x6",
    square: Annotated[str, Parameter(allow_leading_hyphen=True)] = "25mm",
    paper: str = "A4",
    out: Path = Path("board.pdf"),
    output: Output | None = None,
) -> None:
    """Make a target to print, true to scale.

    Example: `stereocal board --inner-corners 9x6 --square 25mm --paper A4 --out board.pdf`

    Parameters
    ----------
    inner_corners : str
        COLUMNSxROWS of points where four squares meet. One odd and one even number make the board unambiguous.
    square : str
        Side of a square: 25mm, 2.5cm, 1in.
    paper : str
        A0 to A6, letter, legal or tabloid.
    out : Path
        The file; its ending says the format: .pdf, .svg or .png.
    """
    with usage():
        corners, length = parse_inner_corners(inner_corners), parse_length(square)
    from stereocal.cli.summaries import summarize_target
    from stereocal.workflow.targets import make_target

    with usage():
        run = make_target(corners, length, paper=paper, out=out)
    answer(output, run.as_dict, summarize_target(run))


@app.command(sort_key=3)
def detect(
    images: list[str],
    /,
    *,
    inner_corners: str,
    out: Path | None = None,
    draw: Path | None = None,
    output: Output | None = None,
) -> None:
    """Find the chessboard in photographs; one line an image.

    Example: `stereocal detect photos/left --inner-corners 7x6 --out corners.csv --draw stages`

    Parameters
    ----------
    images : list of str
        Files, folders or globs.
    inner_corners : str
        COLUMNSxROWS of points where four squares meet, such as 7x6.
    out : Path
        Write all corners into this CSV file.
    draw : Path
        Draw the stages of each detection into this folder.
    """
    with usage():
        corners = parse_inner_corners(inner_corners)
    from stereocal.cli.summaries import summarize_detection
    from stereocal.workflow.boards import detect_boards

    run = detect_boards(images, corners, out=out, draw=draw, progress=Terminal())
    answer(output, run.as_list, summarize_detection(run))


@app.command(sort_key=4)
def calibrate(
    left: str,
    right: str | None = None,
    /,
    *,
    inner_corners: str,
    square: Annotated[str, Parameter(allow_leading_hyphen=True)] = "1",
    model: Model = "brown",
    out: Path = Path("out"),
    side_by_side: Annotated[bool, Parameter(negative="")] = False,
    skip_bad: Annotated[bool, Parameter(negative="")] = False,
    max_tilt: float = 60.0,
    board_warp: Literal["flat", "bow", "released", "auto"] = "flat",
    scene: tuple[Path, Path] | None = None,
    swap: Annotated[bool, Parameter(negative="")] = False,
    output: Output | None = None,
) -> None:
    """Calibrate a stereo rig from photographs of a chessboard.

    Example: `stereocal calibrate photos/left photos/right --inner-corners 7x6 --square 25mm --out out`

    Parameters
    ----------
    left : str
        The left camera's photographs: a folder, or a glob in quotes.
    right : str
        The right camera's. Paired by name or, if no name agrees, by order.
    inner_corners : str
        COLUMNSxROWS of points where four squares meet, such as 7x6.
    square : str
        Side of a square: 25, 25mm, 2.5cm, 1in. It sets the unit of every length that comes out.
    model : str
        Lens distortion; brown is OpenCV's k1 k2 p1 p2 k3.
    out : Path
        Folder for calibration.json, calibration.yml, report.html, report.json and figures.
    side_by_side : bool
        LEFT holds frames with both images side by side.
    skip_bad : bool
        Go on without photographs that cannot be read, have another size, or have no partner.
    max_tilt : float
        Leave out views that see the board more from the side than this (degrees), if ten others remain.
    board_warp : str
        The board's shape as unknown: flat (no), bow, released, or auto (decided by the error on views held out).
    scene : tuple of Path
        LEFT RIGHT photographs of an ordinary scene: the report then judges the depth that the rig makes of it.
    swap : bool
        Exchange left and right: the photographs called left are the right camera's.
    """
    with usage():
        corners, length = parse_inner_corners(inner_corners), parse_length(square)
        if (right is None) != side_by_side:
            raise InputError("give LEFT and RIGHT, or one folder and --side-by-side")
    from stereocal.cli.summaries import summarize_calibration
    from stereocal.workflow.calibrations import calibrate_rig

    run = calibrate_rig(
        left,
        right,
        corners,
        square=length,
        model=model,
        out=out,
        skip_bad=skip_bad,
        max_tilt=max_tilt,
        board_warp=board_warp,
        swap=swap,
        scene=scene,
        progress=Terminal(),
    )
    answer(output, run.as_dict, summarize_calibration(run))
