"""Each room's ``__init__`` is a map of its modules, complete, and nothing else."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import stereocal

ROOMS = sorted(path.parent for path in Path(stereocal.__path__[0]).glob("*/__init__.py"))


@pytest.mark.parametrize("room", ROOMS, ids=lambda room: room.name)
def test_the_map_names_every_module_and_holds_no_code(room: Path) -> None:
    tree = ast.parse((room / "__init__.py").read_text())
    text = ast.get_docstring(tree) or ""
    assert len(tree.body) == 1, "a map of names, no code"
    for module in sorted(path.stem for path in room.glob("*.py") if path.stem != "__init__"):
        # families share one line: the kernels beside their modules, the bench cases of each room
        family = next((f for f in ("_kernels", "bench_", "format_", "figures_") if f in module), "")
        named = f"``{module}``" in text or (family and family in text)
        assert named, f"{room.name}/__init__.py does not say what {module} is for"
