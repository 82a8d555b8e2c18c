"""``import stereocal`` is fast, lazy, and a true map of what the library offers."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

import stereocal as sc


def test_import_loads_neither_numpy_nor_numba_nor_cv2() -> None:
    code = "import sys, stereocal; print(*sorted({'numpy', 'numba', 'cv2', 'scipy', 'PIL'} & set(sys.modules)))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert loaded == []


@pytest.mark.parametrize(
    ("module", "name"), [(module, name) for module, names in sc.NAMES_OF_MODULE.items() for name in names]
)
def test_every_public_name_exists_where_the_map_says(module: str, name: str) -> None:
    value = getattr(sc, name)
    assert value is getattr(importlib.import_module(module), name)
    assert value.__module__ == module
    assert value.__doc__, f"{name} has no docstring"


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'calibrate'"):
        _ = sc.calibrate


def test_no_module_bears_the_name_of_a_public_function() -> None:
    modules = {module.rsplit(".", 1)[1] for module in sc.NAMES_OF_MODULE}
    assert modules.isdisjoint(sc.__all__)
