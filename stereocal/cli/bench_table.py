"""The table of ``bench`` for a terminal of any width: what matters least goes first where there is little room.

Of several environments the milliseconds of the others go first, then memory, then the spread, then the milliseconds of
a user's function; ratios always stay. How far results agree stands in a kernel's heading if it is the same for all its
cases, and under the case if not.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table
from rich.text import Text

from stereocal.verify.bench import BenchResult
from stereocal.workflow.benchmarks import BenchRun

LEAST_CASE = 30


@dataclass(frozen=True)
class _Column:
    """A column: heading, width, what it says of the k-th case, and how soon it goes (0: never)."""

    title: str
    width: int
    cell: Callable[[int], Text | str]
    expendable: int = 0


class BenchTable:
    """A run as a table, laid out when the width is known.

    Parameters
    ----------
    run : BenchRun
    """

    def __init__(self, run: BenchRun) -> None:
        self.run = run

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield the table for the console's width."""
        columns = self._columns(spread=True)
        room = options.max_width - LEAST_CASE
        if _width(columns) > room:
            columns = self._columns(spread=False)
        for rank in (1, 2, 3):
            if _width(columns) > room:
                columns = [column for column in columns if column.expendable != rank]
        yield self._table(columns, max(LEAST_CASE, options.max_width - _width(columns)))

    def _columns(self, spread: bool) -> list[_Column]:
        run, results = self.run, self.run.results
        wide = 9 if spread else 5

        def ratio(rows: tuple[BenchResult | None, ...]) -> Callable[[int], Text | str]:
            return lambda k: _ratio(rows[k], spread)

        first = f"{run.opencv_version} ms" if run.others else "OpenCV ms"
        columns = [
            _Column("ours ms", 8, lambda k: f"{results[k].ours_ms:.3g}"),
            _Column(first, 9, lambda k: f"{results[k].opencv_ms:.3g}"),
            _Column("ratio", wide, ratio(results)),
        ]
        for other in run.others:
            columns.append(_Column(f"{other.opencv_version} ms", 9, _milliseconds(other.results), 1))
            columns.append(_Column("ratio" if spread else other.opencv_version, max(wide, 6), ratio(other.results)))
        if any(result.extra for result in results):
            columns.append(_Column("yours ms", 8, lambda k: _number(results[k].extra_ms, "{:.3g}"), 3))
            columns.append(_Column("yours", 5, lambda k: _number(results[k].extra_ratio, "{:.2f}")))
        if any(result.ours_mb is not None for result in results):
            columns.append(_Column("ours/OpenCV MB", 11, lambda k: _megabytes(results[k]), 2))
        return columns

    def _table(self, columns: list[_Column], room: int) -> Table:
        table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2, 0, 0))
        table.add_column("case", width=room - 2)
        for column in columns:
            table.add_column(column.title, justify="right", width=column.width)
        results = self.run.results
        said = ""
        for k, result in enumerate(results):
            if k == 0 or result.kernel != results[k - 1].kernel:
                words = {_agreement(other) for other in results if other.kernel == result.kernel}
                said = words.pop() if len(words) == 1 else ""
                table.add_row(Text(result.kernel, "bold").append(_under(said, room), "not bold dim"))
            case = Text("\n".join(textwrap.wrap(result.case, room - 4, initial_indent="  ", subsequent_indent="  ")))
            case.append("" if said else _under(_agreement(result), room), "dim")
            table.add_row(case, *(column.cell(k) for column in columns))
        return table


def _width(columns: list[_Column]) -> int:
    return sum(column.width + 2 for column in columns)


def _under(words: str, room: int) -> str:
    """Words on lines of their own below a heading, indented."""
    lines = textwrap.wrap(words, room - 6, initial_indent="    ", subsequent_indent="    ")
    return "".join("\n" + line for line in lines)


def _agreement(result: BenchResult) -> str:
    """How far the results agree: OpenCV's with ours, and a user's with ours."""
    return result.agreement if result.extra is None else f"{result.agreement}; yours: {result.extra_agreement}"


def _ratio(result: BenchResult | None, spread: bool) -> Text | str:
    """The ratio, green where ours is the faster, and half the distance of its quartiles."""
    if result is None:
        return "-"
    digits = 2 if result.ratio < 10 else 0
    text = Text(f"{result.ratio:.{digits}f}", "green" if result.ratio <= 1 else "")
    if spread:
        text.append(f"±{(result.ratio_high - result.ratio_low) / 2:.{digits}f}", "dim")
    return text


def _milliseconds(rows: tuple[BenchResult | None, ...]) -> Callable[[int], str]:
    def cell(k: int) -> str:
        row = rows[k]
        return "-" if row is None else f"{row.opencv_ms:.3g}"

    return cell


def _number(value: float | None, form: str) -> str:
    return "" if value is None else form.format(value)


def _megabytes(result: BenchResult) -> str:
    both = result.ours_mb is not None and result.opencv_mb is not None
    return f"{result.ours_mb:.0f}/{result.opencv_mb:.0f}" if both else ""
