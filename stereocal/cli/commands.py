"""The commands' names, options and help.

Each command parses what was typed, calls one function of :mod:`stereocal.workflow`, and hands the result to
:mod:`~stereocal.cli.summaries`, or prints it as JSON. Imports stand inside the commands: ``stereocal --help`` must not
wait for Numba.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Parameter
from rich.console import RenderableType

from stereocal import __version__
from stereocal.base.errors import InputError
from stereocal.cli.terminal import Terminal, print_json, results
from stereocal.workflow.quantities import parse_inner_corners, parse_length, parse_range

app = App(
    name="stereocal",
    version=__version__,
    help_format="markdown",
    suppress_keyboard_interrupt=False,
    help="Stereo camera calibration and disparity maps, every algorithm its own, each checked against OpenCV.\n\n"
    "Start with `stereocal demo`. With your own photographs: `stereocal board` prints a target, `stereocal calibrate` "
    "turns two folders of photographs into a calibrated rig and a report, `stereocal disparity` makes depth of a pair.",
)

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


class UsageError(Exception):
    """What was typed does not make sense: exit code 2."""


@contextmanager
def _usage() -> Iterator[None]:
    """Take an InputError for what it is while words are parsed: wrong usage."""
    try:
        yield
    except InputError as error:
        raise UsageError(str(error)) from error


def _answer(output: Output | None, document: Callable[[], object], summary: Iterable[RenderableType]) -> None:
    """Print the result: one JSON document, or lines for a person."""
    if output is not None and output.json:
        print_json(document())
        return
    console = results()
    for line in list(summary):  # all of it first: a summary is not cut off half way
        console.print(line)


@Parameter(name="*", group="Output")
@dataclass(frozen=True)
class Output:
    """How a command answers."""

    json: Annotated[bool, Parameter(negative="")] = False
    """Print the result as one JSON document on standard output, and nothing else."""
    debug: Annotated[bool, Parameter(negative="")] = False
    """Show the traceback of an error."""


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
    _answer(output, run.as_dict, summarize_demo(run))
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
    with _usage():
        corners, length = parse_inner_corners(inner_corners), parse_length(square)
    from stereocal.cli.summaries import summarize_target
    from stereocal.workflow.targets import make_target

    with _usage():
        run = make_target(corners, length, paper=paper, out=out)
    _answer(output, run.as_dict, summarize_target(run))


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
    with _usage():
        corners = parse_inner_corners(inner_corners)
    from stereocal.cli.summaries import summarize_detection
    from stereocal.workflow.boards import detect_boards

    run = detect_boards(images, corners, out=out, draw=draw, progress=Terminal())
    _answer(output, run.as_list, summarize_detection(run))


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
    """
    with _usage():
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
        progress=Terminal(),
    )
    _answer(output, run.as_dict, summarize_calibration(run))


@app.command(sort_key=5)
def rectify(
    calibration: Path,
    left: str,
    right: str,
    /,
    *,
    out: Path = Path("out/rectified"),
    alpha: float | None = None,
    output: Output | None = None,
) -> None:
    """Rectify pairs of photographs: same row, same point.

    Example: `stereocal rectify out/calibration.json scene/left.jpg scene/right.jpg --out out/rectified`

    Parameters
    ----------
    calibration : Path
        What `stereocal calibrate` wrote, or a calibration in another tool's format.
    left : str
        Photograph of the left camera; a folder or glob for many.
    right : str
        Photograph of the right camera.
    out : Path
        Folder for the rectified images and the picture with epipolar lines.
    alpha : float
        OpenCV's zoom: 0 leaves no black pixel, 1 loses none; by default all that both cameras see is shown.
    """
    with _usage():
        if alpha is not None and not 0 <= alpha <= 1:
            raise InputError(f"--alpha must be from 0 (no black pixels) to 1 (no pixel lost), but is {alpha:g}")
    from stereocal.cli.summaries import summarize_rectification
    from stereocal.workflow.rectified_pairs import rectify_pairs

    run = rectify_pairs(calibration, left, right, out=out, alpha=alpha, progress=Terminal())
    _answer(output, run.as_dict, summarize_rectification(run))


@app.command(sort_key=6)
def disparity(
    calibration: Path,
    left: Path,
    right: Path,
    /,
    *,
    method: Literal["sad", "bm", "census", "sgm"] = "sgm",
    block_size: int | None = None,
    num_disparities: int = 64,
    min_disparity: int = 0,
    speckle_size: int = 100,
    out: Path = Path("out/disparity"),
    output: Output | None = None,
) -> None:
    """Make a disparity map, depth and a coloured point cloud of one pair.

    Example: `stereocal disparity out/calibration.json scene/left.jpg scene/right.jpg --out out/disparity`

    Parameters
    ----------
    calibration : Path
        What `stereocal calibrate` wrote, or a calibration in another tool's format.
    left : Path
        Photograph of the left camera.
    right : Path
        Photograph of the right camera.
    method : str
        sad is the paper's, bm is OpenCV's block matching, census stands bad light, sgm is the most complete.
    block_size : int
        Side of the matching window; by default 21 for sad and bm, 9 for census, 3 for sgm.
    num_disparities : int
        How many disparities are searched, from the smallest up: nearer things need more.
    min_disparity : int
        The smallest disparity that is searched.
    speckle_size : int
        Patches of at most this many pixels are dropped; 0 keeps them.
    out : Path
        Folder for disparity.pfm, disparity.png, disparity_color.png, depth, cloud.ply.
    """
    from stereocal.cli.summaries import summarize_depth_map
    from stereocal.workflow.depth_maps import compute_disparity, matcher_settings

    with _usage():
        matcher_settings(
            method,
            block_size=block_size,
            num_disparities=num_disparities,
            min_disparity=min_disparity,
            speckle_size=speckle_size,
        )
    run = compute_disparity(
        calibration,
        left,
        right,
        method=method,
        block_size=block_size,
        num_disparities=num_disparities,
        min_disparity=min_disparity,
        speckle_size=speckle_size,
        out=out,
        progress=Terminal(),
    )
    _answer(output, run.as_dict, summarize_depth_map(run))


@app.command(sort_key=7)
def sweep(
    calibration: Path,
    left: Path,
    right: Path,
    /,
    *,
    blocks: str = "5:255:2",
    speckles: str = "50:200:10",
    executor: str = "local",
    out: Path = Path("out/sweep"),
    output: Output | None = None,
) -> None:
    """Count disparities over window and speckle sizes: the paper's section 3, figures 7 and 8.

    A sweep that is cut off goes on where it stopped when the same command is given again.

    Example: `stereocal sweep out/calibration.json scene/left.jpg scene/right.jpg --out out/sweep`

    Parameters
    ----------
    calibration : Path
        What `stereocal calibrate` wrote, or a calibration in another tool's format.
    left : Path
        Photograph of the left camera.
    right : Path
        Photograph of the right camera.
    blocks : str
        Window sizes, FIRST:LAST:STEP.
    speckles : str
        Speckle sizes (areas in pixels), FIRST:LAST:STEP.
    executor : str
        local, local:N (threads), processes:N, or dask:ADDRESS of a scheduler.
    out : Path
        Folder for sweep.csv, figure7.png and figure8.png.
    """
    with _usage():
        block_sizes, speckle_sizes = parse_range(blocks, "--blocks"), parse_range(speckles, "--speckles")
    from stereocal.cli.summaries import summarize_sweep
    from stereocal.workflow.sweeps import run_sweep

    run = run_sweep(
        calibration,
        left,
        right,
        blocks=block_sizes,
        speckles=speckle_sizes,
        executor=executor,
        out=out,
        progress=Terminal(),
    )
    _answer(output, run.as_dict, summarize_sweep(run))
