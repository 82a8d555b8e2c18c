"""The commands that use a calibrated rig: rectify, disparity, sweep."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from stereocal.base.errors import InputError
from stereocal.cli.app import Output, answer, app, usage
from stereocal.cli.terminal import Terminal
from stereocal.workflow.quantities import parse_range


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
    with usage():
        if alpha is not None and not 0 <= alpha <= 1:
            raise InputError(f"--alpha must be from 0 (no black pixels) to 1 (no pixel lost), but is {alpha:g}")
    from stereocal.cli.summaries import summarize_rectification
    from stereocal.workflow.rectified_pairs import rectify_pairs

    run = rectify_pairs(calibration, left, right, out=out, alpha=alpha, progress=Terminal())
    answer(output, run.as_dict, summarize_rectification(run))


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

    with usage():
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
    answer(output, run.as_dict, summarize_depth_map(run))


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
    with usage():
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
    answer(output, run.as_dict, summarize_sweep(run))
