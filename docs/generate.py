"""Write the pages that are made from the code: API by room, the paper's concordance, the copies of the notebooks.

One source each: the essays are the module docstrings, the concordance is ``stereocal.base.equations``, the notebooks
live in ``notebooks/``. Run by ``conf.py`` at every build; all of it goes to ``docs/_generated``, which git ignores.
"""

from __future__ import annotations

import ast
import importlib
import importlib.util
import json
import pkgutil
import re
import shutil
from pathlib import Path

import layers

import stereocal
from stereocal.base.equations import EQUATIONS
from stereocal.store.calibrations import FORMATS

ROOMS = {
    "base": "What everything stands on",
    "board": "The target and how it is found",
    "camera": "One camera",
    "pair": "Two cameras",
    "reconstruction": "Dense reconstruction",
    "report": "Is it any good?",
    "store": "Everything that touches a disk",
    "sweep": "The paper's sweeps",
    "synthetic": "Rigs with known truth",
    "verify": "The oracle",
}


def write_all(docs: Path) -> None:
    """Write every generated page under ``docs/_generated``."""
    target = docs / "_generated"
    shutil.rmtree(target, ignore_errors=True)
    (target / "api").mkdir(parents=True)
    (target / "notebooks").mkdir()
    for room, title in ROOMS.items():
        (target / "api" / f"{room}.md").write_text(_api_page(room, title))
    (target / "api" / "index.md").write_text(_api_index())
    _write_formats(target / "formats")
    layers.draw_layers(docs.parent / "pyproject.toml", target / "layers.svg")
    notebooks = sorted((docs.parent / "notebooks").glob("[0-9]*.ipynb"))
    for notebook in notebooks:
        shutil.copy(notebook, target / "notebooks")
    (target / "notebooks" / "index.md").write_text(_notebook_index(notebooks))
    (target / "concordance.md").write_text(_concordance(docs.parent, notebooks))


def _docstring(module: str) -> str:
    spec = importlib.util.find_spec(module)
    assert spec is not None
    assert spec.origin is not None
    return ast.get_docstring(ast.parse(Path(spec.origin).read_text())) or ""


def formulas_as_literals(lines: list[str]) -> list[str]:
    """Turn indented paragraphs of an essay into literal blocks, so that formulas keep their lines and columns."""
    out: list[str] = []
    for line in lines:
        begins = line.startswith("    ") and (not out or not out[-1].strip())
        if begins:
            before = next((text for text in reversed(out) if text.strip()), "")
            continues = before.startswith((" ", "- ", "* ", ".. ", "=")) or re.match(r"\d+\. ", before)
            if not continues and not before.endswith("::"):
                out += ["::", ""]
        out.append(line)
    return out


def _api_page(room: str, title: str) -> str:
    package = f"stereocal.{room}"
    folder = Path(stereocal.__path__[0]) / room
    lines = [f"# {room}: {title[0].lower()}{title[1:]}", "", "```{eval-rst}", _docstring(package), "```", ""]
    for module in sorted(m.name for m in pkgutil.iter_modules([str(folder)])):
        full = f"{package}.{module}"
        if module == "capture":  # needs OpenCV; its essay is shown without importing it
            lines += [f"## {module}", "", "```{eval-rst}", _docstring(full), "```", ""]
            continue
        members = "" if module.endswith(("_kernels", "_primitives")) else "   :members:\n"
        lines += [f"## {module}", "", "```{eval-rst}", f".. automodule:: {full}", members, "```", ""]
    return "\n".join(lines)


def _api_index() -> str:
    lines = [
        "# API by step of the pipeline",
        "",
        "The folders in alphabetical order are the pipeline and the import order. Each page opens with a map of the",
        "room; each module opens with the idea it implements, then its functions with shapes, units and frames.",
        "",
        "| name | from |",
        "|---|---|",
    ]
    for module, names in stereocal.NAMES_OF_MODULE.items():
        room = module.split(".")[1]
        called = ", ".join(f"`sc.{name}`" for name in names)
        lines.append(f"| {called} | [{module.removeprefix('stereocal.')}]({room}.md) |")
    return "\n".join([*lines, "", "```{toctree}", ":hidden:", *ROOMS, "```", ""])


_RIGS = {"colmap": "refused", "kitti": "one file, rectified", "middlebury": "one file, rectified"}
"""What is particular about rigs in some formats."""


def _write_formats(folder: Path) -> None:
    """A page of conventions for each calibration format, and one for disparity maps: the modules' own essays."""
    folder.mkdir()
    rows = []
    for each in FORMATS.values():
        module = importlib.import_module(f"stereocal.store.{each.module}")
        title = f"{each.title[0].upper()}{each.title[1:]}"
        most = getattr(module, "LENS_PARAMETERS", None)
        lenses = "every lens" if each.name == "stereocal" else "no distortion" if most is None else f"up to {most}"
        if getattr(module, "FISHEYE", False):
            lenses += ", fisheye"
        endings = ", ".join(f"`{suffix}`" for suffix in each.suffixes) or "named by `--to`"
        kind = _RIGS.get(each.name, "a folder" if each.writes_folder else "one file")
        rows.append(f"| [{title}]({each.name}.md) | `{each.name}` | {endings} | {kind} | {lenses} |")
        name = f"`stereocal convert IN OUT --to {each.name}`"
        page = [f"# {title}", "", f"{name}; lens parameters: {lenses}.", "", *_essay(f"stereocal.store.{each.module}")]
        (folder / f"{each.name}.md").write_text("\n".join(page))
    disparity = ["# Disparity maps", "", *_essay("stereocal.store.disparity_files")]
    (folder / "disparity.md").write_text("\n".join(disparity))
    lines = [
        "# File formats",
        "",
        "What each tool means by its numbers: frames, units, where the first pixel is, the order of parameters, and",
        "what the format cannot hold. That is refused with a sentence, never dropped; `--refit` (`refit=True`) fits a",
        "lens of fewer parameters instead and says how far off it is. Files are recognised by their content when read.",
        "",
        "| format | name | ending | a rig is | lens parameters |",
        "|---|---|---|---|---|",
        *rows,
        "",
        "Inside the library X_right = R X_left + T, pixel (0, 0) is the centre of the first pixel, and lengths are in",
        "the unit of the board's squares ([conventions](../../conventions.md)). Disparities have [files of their",
        "own](disparity.md). `stereocal convert` names what changes its meaning on the way.",
    ]
    toctree = ["", "```{toctree}", ":hidden:", *FORMATS, "disparity", "```", ""]
    (folder / "index.md").write_text("\n".join([*lines, *toctree]))


def _essay(module: str) -> list[str]:
    """A module's docstring as a page: its first line a sentence, its formulas literal."""
    lines = formulas_as_literals(_docstring(module).splitlines())
    return ["```{eval-rst}", *(line.replace("|", "∣") for line in lines), "```", ""]


def _cells(notebook: Path) -> str:
    return "\n".join("".join(cell["source"]) for cell in json.loads(notebook.read_text())["cells"])


def _title(notebook: Path) -> str:
    found = re.search(r"^# (.+)$", _cells(notebook), re.MULTILINE)
    return found.group(1) if found else notebook.stem


def _notebook_index(notebooks: list[Path]) -> str:
    lines = [
        "# The paper, step by step",
        "",
        "Each notebook opens with a question, shows the idea in pictures, builds it in a few cells, checks it against",
        "OpenCV, breaks it on purpose, and ends with exercises. All of them run on the embedded synthetic rig.",
        "",
        *(f"1. [{_title(notebook)}]({notebook.name})" for notebook in notebooks),
    ]
    return "\n".join([*lines, "", "```{toctree}", ":hidden:", *(n.stem for n in notebooks), "```", ""])


def _concordance(root: Path, notebooks: list[Path]) -> str:
    texts = {notebook: _cells(notebook) for notebook in notebooks}
    shown = re.findall(r"^def (test_(eq|sec)_\w+)", (root / "tests" / "test_errata.py").read_text(), re.MULTILINE)
    lines = [
        "# The paper's equations",
        "",
        "What the paper prints, what it must read, and where it is coded. The paper numbers three equations (2), so",
        "the project uses its own ids. A test shows every erratum: the printed form fails, the corrected one holds.",
        "",
    ]
    for equation in EQUATIONS:
        lines += [f"## {equation.id}: {equation.topic}", "", f"Printed\n: {equation.printed}", ""]
        if equation.erratum:
            lines += [f"Corrected\n: {equation.corrected}", "", f"Why\n: {equation.erratum}", ""]
            key = "test_" + re.sub(r"\W", "_", equation.id) + "_"
            tests = [name for name, _ in shown if name.startswith(key)]
            where = "tests/test_errata.py" if tests else "tests/reconstruction/test_speckles.py"
            lines += [f"Shown by\n: `{where}`" + "".join(f", `{name}`" for name in tests), ""]
        code = ", ".join(_link(name) for name in equation.implemented_by)
        lines += [f"Code\n: {code}", ""]
        cited = [n for n, text in texts.items() if f"[{equation.id}]" in text]
        if cited:
            links = ", ".join(f"[{_title(n)}](notebooks/{n.name})" for n in cited)
            lines += [f"Notebook\n: {links}", ""]
    return "\n".join(lines)


def _link(full_name: str) -> str:
    return f"{{py:obj}}`{full_name.removeprefix('stereocal.')} <{full_name}>`"
