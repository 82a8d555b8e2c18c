"""``bench``: kernels beside OpenCV on this machine, on other OpenCVs, and beside a user's own functions."""

from __future__ import annotations

import importlib
import importlib.util
import os
import platform
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereocal.base.atomic_files import write_whole
from stereocal.base.errors import InputError
from stereocal.store.images import read_image
from stereocal.verify.bench import (
    BenchResult,
    chosen,
    markdown_summary,
    markdown_table,
    register,
    registered,
    run_case,
)
from stereocal.verify.benchmark_worker import OtherEnvironment
from stereocal.workflow.progress import Progress, Silent

Where = str | os.PathLike[str]


@dataclass(frozen=True)
class OtherResults:
    """The same cases in another environment.

    Attributes
    ----------
    python : str
        Its interpreter.
    opencv_version : str
        Of its OpenCV.
    results : tuple of BenchResult or None
        One a case, in the same order; None where it has no such case.
    """

    python: str
    opencv_version: str
    results: tuple[BenchResult | None, ...]


@dataclass(frozen=True)
class BenchRun:
    """What ``bench`` measured.

    Attributes
    ----------
    results : tuple of BenchResult
        One a case.
    machine : str
        Processor, threads, Python and the versions of what was compared.
    files : tuple of Path
        Those written.
    opencv_version : str
        Of this environment.
    others : tuple of OtherResults
        Other environments, in the order they were named.
    """

    results: tuple[BenchResult, ...]
    machine: str
    files: tuple[Path, ...]
    opencv_version: str = ""
    others: tuple[OtherResults, ...] = ()

    def as_list(self) -> list[dict[str, Any]]:
        """Return what ``bench --json`` prints: one entry a case, other environments' under ``environments``."""
        entries = []
        for index, result in enumerate(self.results):
            entry = result.as_dict() | {"opencv_version": self.opencv_version, "machine": self.machine}
            beside = [(other, other.results[index]) for other in self.others]
            entry["environments"] = [
                {"python": other.python, "opencv_version": other.opencv_version, **there.as_dict()}
                for other, there in beside
                if there is not None
            ]
            entries.append(entry)
        return entries

    def as_markdown(self) -> str:
        """Return a line on the machine, a row a kernel, and the table; a table each for the other environments."""
        columns = {self.opencv_version: self.results} | {other.opencv_version: other.results for other in self.others}
        parts = [self.machine, markdown_summary(columns), "Case by case:", markdown_table(self.results)]
        for other in self.others:
            parts += [f"The same with OpenCV {other.opencv_version}:", markdown_table(filter(None, other.results))]
        return "\n\n".join(parts) + "\n"


def run_bench(
    kernels: Sequence[str] = (),
    *,
    left: Where | None = None,
    right: Where | None = None,
    register_functions: Sequence[str] = (),
    other_pythons: Sequence[str] = (),
    markdown: Where | None = None,
    figure: Where | None = None,
    seconds: float = 0.7,
    progress: Progress | None = None,
) -> BenchRun:
    """Time kernels and OpenCV's, in turns, on one thread.

    Parameters
    ----------
    kernels : sequence of str
        Public names such as ``match_bm``; by default all, or those that functions are registered for.
    left, right : path, optional
        Photographs to run the kernels of images on; the pair rectified.
    register_functions : sequence of str
        Functions of the user's own: ``kernel=module:function``, or ``module`` for one whose functions are decorated
        with :func:`stereocal.verify.bench.register`; a module is a name or a path of a ``.py`` file.
    other_pythons : sequence of str
        Interpreters of other environments, whose OpenCV is compared in the same turns.
    markdown, figure : path, optional
        Write the table, the picture there.
    seconds : float
        About how long to measure each case.
    progress : Progress, optional
        Who watches.

    Raises
    ------
    InputError
        If a kernel is not known, a function or an environment cannot be loaded, or OpenCV is not installed.
    DataFileError
        If a photograph cannot be read.
    """
    if importlib.util.find_spec("cv2") is None:
        raise InputError('bench compares with OpenCV, which is not installed: pip install "stereocal[opencv]"')
    import cv2

    if figure is not None and Path(figure).suffix.lower() not in (".png", ".svg", ".pdf"):
        raise InputError(f"{figure}: the figure is written as .png, .svg or .pdf")
    if other_pythons and (left is not None or right is not None):
        raise InputError("--with runs the built-in cases only: leave out --left and --right")
    before = set(registered())
    for words in register_functions:
        load_function(words)
    added = sorted(set(registered()) - before)
    images = [None if where is None else read_image(where, gray=True) for where in (left, right)]
    cases = chosen(list(kernels) or added, *images)
    functions = registered()
    results: list[BenchResult] = []
    there: list[list[BenchResult | None]] = [[] for _ in other_pythons]
    with ExitStack() as stack:
        names = sorted({case.kernel for case in cases})
        others = [stack.enter_context(OtherEnvironment(python, names, seconds)) for python in other_pythons]
        with (progress or Silent()).stage("Measuring", len(cases)) as step:
            for case in cases:
                results.append(run_case(case, seconds=seconds, extra=functions.get(case.kernel)))
                for other, column in zip(others, there, strict=True):
                    column.append(other.run(case))
                step()
    beside = [OtherResults(o.python, o.opencv_version, tuple(c)) for o, c in zip(others, there, strict=True)]
    run = BenchRun(tuple(results), _machine(), (), cv2.__version__, tuple(beside))
    return BenchRun(run.results, run.machine, tuple(_written(run, markdown, figure)), run.opencv_version, run.others)


def _written(run: BenchRun, markdown: Where | None, figure: Where | None) -> Iterator[Path]:
    if markdown is not None:
        yield write_whole(markdown, run.as_markdown())
    if figure is not None:
        from stereocal.report.figures_benchmarks import BenchColumn, draw_benchmarks, write_figure

        columns = [BenchColumn(f"OpenCV {run.opencv_version}", tuple(result.as_dict() for result in run.results))]
        for other in run.others:
            rows = tuple({} if result is None else result.as_dict() for result in other.results)
            columns.append(BenchColumn(f"OpenCV {other.opencv_version}", rows))
        yield write_figure(figure, draw_benchmarks(columns, run.machine))


def load_function(words: str) -> None:
    """Register ``kernel=module:function``, ``module:function`` or ``module``; a module may be a path.

    Raises
    ------
    InputError
        If the module cannot be imported, has no such function, or registers nothing.
    """
    kernel, equals, place = words.partition("=")
    if not equals:
        kernel, place = "", words
    name, colon, attribute = place.rpartition(":")
    if not colon:
        name, attribute = place, ""
    before = registered()
    module = _imported(name)
    if not attribute:
        if registered() == before:
            raise InputError(
                f"{name} registers nothing: decorate a function with stereocal.verify.bench.register(kernel)"
            )
        return
    function = getattr(module, attribute, None)
    if not callable(function):
        raise InputError(f"{name} has no function {attribute}")
    if kernel:
        register(kernel)(function)
    elif function not in registered().values():
        raise InputError(f"say which kernel {attribute} stands beside: --register match_bm={place}")


def _imported(name: str) -> Any:
    """A module by its name, found from the working directory too, or by its path."""
    try:
        if name.endswith(".py"):
            spec = importlib.util.spec_from_file_location(Path(name).stem, name)
            if spec is None or spec.loader is None:
                raise InputError(f"{name} is no Python file")
            module = importlib.util.module_from_spec(spec)
            with _importing_from(Path(name).resolve().parent):
                spec.loader.exec_module(module)
            return module
        with _importing_from(Path.cwd()):
            return importlib.import_module(name)
    except InputError:
        raise
    except Exception as error:  # a user's module may fail in any way when it is imported
        raise InputError(f"{name} cannot be imported: {type(error).__name__}: {error}") from error


@contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


def _machine() -> str:
    import cv2
    import numba
    import numpy as np

    return (
        f"{_processor()}, {os.cpu_count()} cores, one thread each; {platform.system()}, Python "
        f"{platform.python_version()}, NumPy {np.__version__}, Numba {numba.__version__}, OpenCV {cv2.__version__}"
    )


def _processor() -> str:
    """Return the processor's name where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
