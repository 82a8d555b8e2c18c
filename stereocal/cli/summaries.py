"""What a person reads when a command is done: what was done, what was found, and what comes next.

Each function yields lines (or tables) for the terminal. A figure is never printed without its definition or its unit,
and the last lines are the exact command that comes next.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rich.console import RenderableType
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from stereocal.cli.bench_table import BenchTable
from stereocal.report.verdicts import Verdict, worst
from stereocal.workflow.benchmarks import BenchRun
from stereocal.workflow.boards import DetectionRun
from stereocal.workflow.calibrations import CalibrationRun
from stereocal.workflow.conversions import ConversionRun
from stereocal.workflow.crosschecks import CrosscheckRun
from stereocal.workflow.datasets import FetchRun
from stereocal.workflow.demonstration import DemoRun
from stereocal.workflow.depth_maps import DepthMapRun
from stereocal.workflow.rectified_pairs import RectificationRun
from stereocal.workflow.sweeps import SweepRun
from stereocal.workflow.targets import TargetRun


def summarize_demo(run: DemoRun) -> Iterator[RenderableType]:
    """Every bound and whether it holds."""
    used, pairs = len(run.calibration.used), len(run.calibration.pairs)
    yield (
        f"Rendered {pairs} pairs of a chessboard and a room; calibrated from {used} of them, RMS "
        f"{run.calibration.fit.calibration.rms:.4f} px; matched the room with {run.depth_map.method}.\n"
    )
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("compared with the truth")
    table.add_column("measured", justify="right")
    table.add_column("bound", justify="right")
    table.add_column("")
    for check in run.checks:
        bound = check.bound
        sign = "≥" if bound.at_least else "≤"
        verdict = "[green]holds[/]" if check.holds else "[red]BROKEN[/]"
        table.add_row(bound.name, f"{check.value:.3g} {bound.unit}", f"{sign} {bound.limit:g} {bound.unit}", verdict)
    yield table
    broken = sum(not check.holds for check in run.checks)
    yield "\n[bold green]All bounds hold.[/]" if run.holds else f"\n[bold red]{broken} bounds are broken.[/]"
    yield f"{run.seconds:.0f} s. {len(run.files)} files in {run.folder}"
    yield from _next(
        f"open {run.folder / 'report.html'} in a browser, look at {run.folder / 'demo.png'}",
        "then your own cameras: stereocal board --inner-corners 9x6 --square 25mm --paper A4 --out board.pdf",
    )


def summarize_detection(run: DetectionRun) -> Iterator[RenderableType]:
    """One line an image, then the count."""
    width = max(len(str(found.photograph)) for found in run.boards)
    for found in run.boards:
        detection = found.detection
        if detection.found:
            line = f"{found.photograph!s:<{width}}  found      edges {detection.edge_width:.1f} px wide"
            line += f"  {detection.message}" if detection.message else ""
        else:
            line = f"{found.photograph!s:<{width}}  not found  {detection.message}"
        yield Text(line.rstrip())
    yield f"\n[bold]{run.found} of {len(run.boards)}[/] photographs show the {run.board} board."
    yield from _files(run.files)
    sizes = {found.detection.other_size for found in run.boards if found.detection.other_size}
    if not run.found and sizes:
        columns, rows = sorted(sizes)[0]
        yield f"Some show a board of another size: try [bold]--inner-corners {columns}x{rows}[/]."


def summarize_calibration(run: CalibrationRun) -> Iterator[RenderableType]:
    """What was used, how well it fits, what came out, and the next command."""
    calibration, rig = run.fit.calibration, run.fit.calibration.rig
    width, height = rig.left.image_size
    unit = run.square.unit or "x the unit of --square"
    yield (
        f"[bold]{len(run.used)} of {len(run.pairs)} pairs used[/], {width}x{height} px, board {run.board}, "
        f"square {run.square}"
    )
    for record in run.pairs:
        names = f"{record.pair.left.path.name} / {record.pair.right.path.name}"
        if not record.used:
            yield Text(f"  left out  {names}: {record.reason}")
        elif record.flipped:
            yield Text(f"  repaired  {names}: corners came from opposite ends of the board; put into one order")
    if run.board.is_symmetric and not any(record.flipped for record in run.pairs):
        yield "  checked   the board looks the same after half a turn, but left and right agree in every pair"
    for sentence in run.skipped:
        yield Text(f"  skipped   {sentence}")
    yield ""
    alone = [camera.rms for camera in (calibration.left, calibration.right) if camera is not None]
    yield (
        f"[bold]RMS {calibration.rms:.3f} px[/]  left {calibration.left_rms:.3f}, right {calibration.right_rms:.3f}; "
        f"each camera alone {', '.join(f'{rms:.3f}' for rms in alone)}"
    )
    yield "  [dim]root mean square distance between found and predicted corners, as OpenCV counts it[/]"
    yield f"[bold]baseline {rig.baseline:.4f}[/] {unit}"
    yield _camera_table(run)
    if calibration.board.kind != "flat":
        yield f"board       its shape was an unknown too: {calibration.board.kind}"
    for sentence in run.warnings:
        yield Text(f"warning: {sentence}", style="yellow")
    yield from _verdicts(run)
    yield ""
    yield from _files(run.files, run.folder)
    yield from _next(
        f"open {run.folder / 'report.html'} in a browser: is it good, and what would make it better",
        _command("stereocal", "disparity", run.folder / "calibration.json", "LEFT.jpg", "RIGHT.jpg"),
    )


def _camera_table(run: CalibrationRun) -> Table:
    """K and dist of both cameras."""
    table = Table(box=None, pad_edge=False, show_header=True, header_style="bold")
    for title in ("", "fx", "fy", "cx", "cy"):
        table.add_column(title, justify="left" if not title else "right")
    table.add_column(f"distortion ({run.model})")
    rig = run.fit.calibration.rig
    for name, camera in (("left", rig.left), ("right", rig.right)):
        K = camera.K
        figures = [f"{value:.2f}" for value in (K[0, 0], K[1, 1], K[0, 2], K[1, 2])]
        table.add_row(name, *figures, " ".join(f"{value:.4f}" for value in np.ravel(camera.dist)))
    return table


def _verdicts(run: CalibrationRun) -> Iterator[RenderableType]:
    """The verdict on the whole, and whatever is not good with what to do about it."""
    if run.report is None:
        return
    colours = {"good": "green", "usable": "yellow", "bad": "red"}
    overall = run.report.overall
    yield f"\n[bold]verdict: [{colours[overall]}]{overall}[/][/]"
    by_action: dict[str, list[Verdict]] = {}
    for verdict in run.report.actions:
        by_action.setdefault(verdict.action, []).append(verdict)
    for action, verdicts in by_action.items():
        grade = worst([verdict.verdict for verdict in verdicts])
        figures = ", ".join(f"{verdict.name} {verdict.spelt_value}" for verdict in verdicts)
        yield f"  [{colours[grade]}]{grade:<6}[/]  {escape(figures)}\n          {escape(action)}"


def summarize_rectification(run: RectificationRun) -> Iterator[RenderableType]:
    """What was rectified and where it is."""
    width, height = run.rectification.image_size
    what = "1 pair" if run.pairs == 1 else f"{run.pairs} pairs"
    yield f"[bold]{what} rectified[/] to {width}x{height} px, focal length {run.rectification.P1[0, 0]:.1f} px"
    for sentence in run.rectification.warnings:
        yield Text(f"  note: {sentence}")
    yield from _files(run.files, run.folder)
    yield from _next("look at the epipolar_*.png: each line must meet the same things on both sides")


def summarize_depth_map(run: DepthMapRun) -> Iterator[RenderableType]:
    """How dense, how far, how long, and where it is."""
    settings = run.settings
    yield (
        f"[bold]{run.method}[/] with block size {settings['block_size']}, {settings['num_disparities']} disparities "
        f"from {settings['min_disparity']}, speckles up to {settings['speckle_size']} px dropped"
    )
    yield f"[bold]{run.density:.1%}[/] of the pixels have a disparity; matched in {run.matching_seconds:.2f} s"
    depth = run.depth[np.isfinite(run.depth)]
    if depth.size:
        low, middle, high = np.percentile(depth, (5, 50, 95))
        yield f"depth {low:.4g} to {high:.4g} (5 to 95 %), median {middle:.4g}, in the unit of the calibration"
    for sentence in run.warnings:
        yield Text(f"  note: {sentence}")
    top = settings["min_disparity"] + settings["num_disparities"] - 1.5
    if np.mean(np.abs(run.disparity) >= top) > 0.005:
        yield "  note: the largest disparity that was searched is reached: nearer things need --num-disparities "
        yield f"        {2 * settings['num_disparities']} or more"
    yield from _files(run.files, run.folder)
    yield from _next(f"look at {run.folder / 'disparity_figure.png'}, or open {run.folder / 'cloud.ply'} in MeshLab")


def summarize_target(run: TargetRun) -> Iterator[RenderableType]:
    """What to print, and what to check after printing."""
    board = run.sheet.board
    square = f"{board.square_size:g}mm"
    yield f"[bold]{run.path}[/]: {board} inner corners, squares of {square}, on {run.paper}"
    for sentence in run.advice:
        yield Text(f"  {sentence}")
    yield from _next(
        "print it at 100 % (not 'fit to page'), measure the bar with a ruler, glue the sheet onto something flat",
        _command("stereocal", "calibrate", "LEFT", "RIGHT", "--inner-corners", str(board), "--square", square),
    )


def summarize_sweep(run: SweepRun) -> Iterator[RenderableType]:
    """How large the grid is, and where the count is highest."""
    table = run.table
    yield f"[bold]{len(table)} cells[/]: {len(table.block_sizes)} windows x {len(table.speckle_sizes)} speckle sizes"
    if run.resumed:
        yield f"  {run.resumed} windows were there already; the sweep went on from them"
    least = table.speckle_sizes[0]
    yield f"most disparities above 0 with a window of [bold]{table.best_block()}[/] (speckle size {least})"
    yield "  [dim]a count alone ranks nothing: figure7.png shows its ceiling and what the right image confirms[/]"
    yield from _files(run.files, run.folder)


def summarize_crosscheck(run: CrosscheckRun) -> Iterator[RenderableType]:
    """A table of the steps, a sentence for each that parts and on the given calibration, and the sum of it."""
    photographs = f"{run.pairs} pairs of photographs" if run.pairs else "no photographs"
    yield Text(f"{run.calibration}, {photographs}, OpenCV {run.report.opencv_version}\n")
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("step")
    table.add_column("apart", justify="right")
    table.add_column("tolerance", justify="right")
    table.add_column("nearer the truth")
    for step in run.report.steps:
        if not step.compared:
            table.add_row(escape(step.step), "-", "", "[dim]not compared[/]")
            continue
        colour = "green" if step.agrees else "yellow"
        who = "both" if step.agrees else {"opencv": "OpenCV", "unknown": "?"}.get(step.nearer, step.nearer)
        apart = f"[{colour}]{step.difference:.2g} {escape(step.unit)}[/]"
        table.add_row(escape(step.step), apart, f"{step.tolerance:.2g}", who)
    yield table
    yield ""
    for step in run.report.steps:
        if not step.agrees or step.step in ("each its own corners", "the given calibration"):
            yield Text.assemble((f"{step.step}: ", "bold"), step.finding)
    yield Text(run.report.summary(), style="bold")
    if not run.pairs:
        yield from _next(_command("stereocal", "crosscheck", run.calibration, "--left", "LEFT", "--right", "RIGHT"))


def summarize_conversion(run: ConversionRun) -> Iterator[RenderableType]:
    """From what to what, and what changed its meaning."""
    yield Text(f"{run.source} ({run.format}) is now {run.target}")
    for remark in run.remarks:
        yield Text(f"  {remark}")


def summarize_fetch(run: FetchRun) -> Iterator[RenderableType]:
    """What it is, under which terms, and where."""
    data = run.dataset
    yield Text(f"{data.name}: {data.title}; {data.terms}")
    yield Text(f"{'downloaded to' if run.downloaded else 'is in'} {data.folder}")
    if data.right and data.inner_corners is not None:
        columns, rows = data.inner_corners
        square = f"{data.square_size or 1:g}{data.unit or ''}"
        words = ("--inner-corners", f"{columns}x{rows}", "--square", square)
        yield from _next(_command("stereocal", "calibrate", data.left[0].parent, data.right[0].parent, *words))


def summarize_bench(run: BenchRun) -> Iterator[RenderableType]:
    """The machine, a table with a heading a kernel, and what was written."""
    yield Text(run.machine, style="dim")
    yield BenchTable(run)
    yield Text("ratio = ours / OpenCV's processor time, median over turns ± half its quartiles' distance", style="dim")
    if any(result.ours_mb is not None for result in run.results):
        yield Text("MB = the most that a call takes beyond its input, to about 5 MB", style="dim")
    yield from _files(run.files)


def _files(files: tuple[Path, ...], folder: Path | None = None) -> Iterator[RenderableType]:
    """Name what was written, pictures of a kind by their number."""
    if not files:
        return
    if folder is None or len(files) == 1:
        yield Text("written: " + ", ".join(str(path) for path in files))
        return
    top = [path.name for path in files if path.parent == folder]
    below: dict[str, int] = {}
    for path in files:
        if path.parent != folder:
            name = path.relative_to(folder).parts[0]
            below[name] = below.get(name, 0) + 1
    if len(top) > 12:
        top = [*top[:9], f"… {len(top) - 9} more"]
    groups = [f"{name}/ ({count} files)" for name, count in below.items()]
    yield Text(f"written to {folder}: " + ", ".join(top + groups))


def _next(*steps: str) -> Iterator[RenderableType]:
    for index, step in enumerate(steps):
        yield Text(f"{'next: ' if index == 0 else '      '}{step}")


def _command(*words: object) -> str:
    return shlex.join(str(word) for word in words)
