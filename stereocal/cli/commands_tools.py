"""The commands beside the pipeline: convert, fetch, bench."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from stereocal.cli.app import Output, answer, app
from stereocal.cli.terminal import Terminal


@app.command(sort_key=8)
def convert(
    source: Path,
    target: Path,
    /,
    *,
    to: str | None = None,
    unit: Literal["m", "cm", "mm", "in"] | None = None,
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
    """
    from stereocal.cli.summaries import summarize_conversion
    from stereocal.workflow.conversions import run_conversion

    run = run_conversion(source, target, to=to, unit=unit)
    answer(output, run.as_dict, summarize_conversion(run))


@app.command(sort_key=9)
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


@app.command(sort_key=10)
def bench(kernels: list[str] | None = None, /, *, markdown: Path | None = None, output: Output | None = None) -> None:
    """Time kernels beside OpenCV on this machine: ratio and agreement.

    Example: `stereocal bench match_bm filter_speckles`

    Parameters
    ----------
    kernels : list of str
        Names of functions; by default all that are compared.
    markdown : Path
        Write the table into this file.
    """
    from stereocal.cli.summaries import summarize_bench
    from stereocal.workflow.benchmarks import run_bench

    run = run_bench(kernels or (), markdown=markdown, progress=Terminal())
    answer(output, run.as_list, summarize_bench(run))
