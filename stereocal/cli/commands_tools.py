"""The commands beside the pipeline: crosscheck, convert, fetch, bench."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from stereocal.cli.app import Output, answer, app, usage
from stereocal.cli.terminal import Terminal
from stereocal.workflow.quantities import parse_inner_corners, parse_length


@app.command(sort_key=8)
def crosscheck(
    calibration: Path,
    /,
    *,
    left: str | None = None,
    right: str | None = None,
    inner_corners: str | None = None,
    square: str | None = None,
    against: Literal["opencv"] = "opencv",
    output: Output | None = None,
) -> None:
    """Recompute every step of a calibration with stereocal and OpenCV: where do they part, and who is right?

    Example: `stereocal crosscheck out --left left --right right`

    Parameters
    ----------
    calibration : Path
        A calibration of two cameras in any known format, or the folder that `calibrate` wrote.
    left : str
        Photographs of the board, a folder or a glob; with them corners and optimum are judged too.
    right : str
        The same of the right camera; without it the left ones hold both images side by side.
    inner_corners : str
        Inner corners of the board, columns x rows; by default what calibration.json says.
    square : str
        Side of a square: 25, 25mm, 2.5cm, 1in; by default what calibration.json says.
    against : str
        The other opinion.
    """
    from stereocal.cli.summaries import summarize_crosscheck
    from stereocal.workflow.crosschecks import run_crosscheck

    with usage():
        corners = None if inner_corners is None else parse_inner_corners(inner_corners)
        length = None if square is None else parse_length(square)
    del length  # parsed here only so that a wrong one counts as wrong usage
    run = run_crosscheck(calibration, left=left, right=right, inner_corners=corners, square=square, progress=Terminal())
    answer(output, run.as_dict, summarize_crosscheck(run))


@app.command(sort_key=9)
def convert(
    source: Path,
    target: Path,
    /,
    *,
    to: str | None = None,
    unit: Literal["m", "cm", "mm", "in"] | None = None,
    refit: Annotated[bool, Parameter(negative="")] = False,
    camera_pair: Literal["0-1", "2-3"] | None = None,
    output: Output | None = None,
) -> None:
    """Convert a calibration between formats, and say what changes its meaning on the way.

    Example: `stereocal convert out/calibration.json camchain.yaml --to kalibr`

    Parameters
    ----------
    source : Path
        A calibration in any known format (found out by its content), or the folder that holds it.
    target : Path
        Where to; a folder for formats of one file a camera.
    to : str
        stereocal, opencv, ros, kalibr, boofcv, matlab, colmap, kitti, middlebury, mrcal or paper; by default from the
        target's ending.
    unit : str
        The unit of the source's lengths, where its file does not say.
    refit : bool
        Fit a lens that the target can hold where it cannot hold the given one (Kalibr has no k3), and say how far off
        it is; without this such a lens is refused.
    camera_pair : str
        Of KITTI's four cameras: 0-1 grey (the default), 2-3 in colour.
    """
    from stereocal.cli.summaries import summarize_conversion
    from stereocal.workflow.conversions import run_conversion

    run = run_conversion(source, target, to=to, unit=unit, refit=refit, camera_pair=camera_pair)
    answer(output, run.as_dict, summarize_conversion(run))


@app.command(sort_key=10)
def fetch(name: str, /, *, out: Path | None = None, output: Output | None = None) -> None:
    """Download a public data set, checked against its SHA-256.

    The environment variable STEREOCAL_DATA names a folder that holds data sets already.

    Example: `stereocal fetch opencv_sample`

    Parameters
    ----------
    name : str
        The data set's name; a wrong one lists those there are.
    out : Path
        Folder for it; by default the user's cache.
    """
    from stereocal.cli.summaries import summarize_fetch
    from stereocal.workflow.datasets import run_fetch

    run = run_fetch(name, out=out, progress=Terminal())
    answer(output, run.as_dict, summarize_fetch(run))


@app.command(sort_key=11)
def bench(
    kernels: list[str] | None = None,
    /,
    *,
    left: Path | None = None,
    right: Path | None = None,
    register: list[str] | None = None,
    with_: Annotated[list[str] | None, Parameter(name="--with")] = None,
    markdown: Path | None = None,
    figure: Path | None = None,
    output: Output | None = None,
) -> None:
    """Time kernels beside OpenCV on this machine: ratio, spread, agreement, memory.

    Example: `stereocal bench match_bm filter_speckles --figure bench.png`

    Parameters
    ----------
    kernels : list of str
        Names of functions; by default all that are compared.
    left : Path
        A photograph of your own to run the kernels of images on.
    right : Path
        Its rectified partner, for the matchers.
    register : list of str
        A function of your own as a third column, match_bm=module:function; the module may be a .py file.
    with_ : list of str
        The Python of another environment, whose OpenCV is compared in the same turns; may be repeated.
    markdown : Path
        Write the table into this file.
    figure : Path
        Write a picture into this file: .png, .svg or .pdf.
    """
    from stereocal.cli.summaries import summarize_bench
    from stereocal.workflow.benchmarks import run_bench

    run = run_bench(
        kernels or (),
        left=left,
        right=right,
        register_functions=register or (),
        other_pythons=with_ or (),
        markdown=markdown,
        figure=figure,
        progress=Terminal(),
    )
    answer(output, run.as_list, summarize_bench(run))
