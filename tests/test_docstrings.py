"""Every public name explains itself: a numpydoc docstring, type hints, an example that runs; and the stub agrees."""

from __future__ import annotations

import ast
import doctest
import importlib
import inspect
import re
from pathlib import Path
from typing import Any

import pytest

import stereocal as sc

# A result is made by the function that returns it, never by a caller: its fields are documented under Attributes, and
# the function's example shows it. An error is raised, not built; `DataFileError`'s parameters are documented.
RESULTS = {
    "CameraCalibration", "Detection", "QualityReport", "Rectification", "RigCalibration", "StereoCalibration",
    "SyntheticRig",
}  # fmt: skip
ERRORS = {"ConvergenceError", "DataFileError", "DegenerateGeometryError", "InputError", "StereocalError"}

PUBLIC = [name for names in sc.NAMES_OF_MODULE.values() for name in names]


def _sections(text: str) -> dict[str, str]:
    """Split a numpydoc docstring at its underlined titles."""
    parts = re.split(r"^(\w[\w ]*)\n-{3,}$", text, flags=re.MULTILINE)
    assert len(parts[1::2]) == len(set(parts[1::2])), "a section stands twice"
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def _documented(section: str) -> set[str]:
    """Names of a Parameters or Attributes section; ``left, right : Camera`` stands for two."""
    heads = [line.split(" : ")[0] for line in section.splitlines() if line and not line[0].isspace()]
    return {name.strip(" *") for head in heads for name in head.split(",")}


def _parameters(value: Any) -> dict[str, inspect.Parameter]:
    """What a caller passes: of a class, to its constructor; nothing for an exception without one of its own."""
    if inspect.isclass(value) and issubclass(value, Exception) and "__init__" not in vars(value):
        return {}
    return dict(inspect.signature(value).parameters)


def test_exemptions_are_public_names() -> None:
    assert set(PUBLIC) >= RESULTS | ERRORS
    assert all(issubclass(getattr(sc, name), sc.StereocalError) for name in ERRORS)
    assert all(inspect.isclass(getattr(sc, name)) for name in RESULTS)


@pytest.mark.parametrize("name", PUBLIC)
def test_docstring_has_numpydocs_form(name: str) -> None:
    value = getattr(sc, name)
    text = inspect.getdoc(value)
    assert text
    lines = text.split("\n")
    assert lines[0].strip(), "the docstring opens with its summary"
    assert lines[0].endswith("."), "the summary is one sentence"
    assert len(lines) == 1 or not lines[1].strip(), "the summary is one line"
    sections = _sections(text)
    section = "Attributes" if name in RESULTS else "Parameters"
    assert _documented(sections.get(section, "")) >= set(_parameters(value)), f"{section} misses a name"
    if section == "Parameters":
        assert _documented(sections.get("Parameters", "")) <= set(_parameters(value)), (
            "Parameters names what is not there"
        )
    if inspect.isfunction(value):
        assert sections.get("Returns", "").strip(), "what comes back is not said"


@pytest.mark.parametrize("name", PUBLIC)
def test_every_parameter_and_return_is_annotated(name: str) -> None:
    value = getattr(sc, name)
    parameters = _parameters(value)
    bare = [parameter for parameter, about in parameters.items() if about.annotation is inspect.Parameter.empty]
    assert bare == []
    if inspect.isfunction(value):
        assert inspect.signature(value).return_annotation is not inspect.Signature.empty


@pytest.mark.parametrize("name", [name for name in PUBLIC if name not in RESULTS | ERRORS])
def test_an_example_shows_the_use(name: str) -> None:
    text = inspect.getdoc(getattr(sc, name)) or ""
    examples = doctest.DocTestParser().get_examples(_sections(text).get("Examples", ""))
    assert examples, "no Examples section with >>>"
    assert any(name in example.source for example in examples), "the example does not use the name"
    assert any(example.want for example in examples), "the example shows no result"
    assert not any(doctest.SKIP in example.options for example in examples), "an example that is skipped proves nothing"


@pytest.mark.parametrize("module", sc.NAMES_OF_MODULE)
def test_examples_give_what_they_show(module: str) -> None:
    assert doctest.testmod(importlib.import_module(module)).failed == 0


def test_stub_imports_each_public_name_from_its_module() -> None:
    stub = Path(sc.__file__).with_suffix(".pyi")
    imported: dict[str, list[str]] = {}
    declared: set[str] = set()
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            assert all(alias.asname == alias.name for alias in node.names), "a stub exports `name as name` only"
            imported.setdefault(str(node.module), []).extend(alias.name for alias in node.names)
        elif isinstance(node, ast.AnnAssign):
            declared.add(ast.unparse(node.target))
    assert {module: tuple(names) for module, names in imported.items()} == sc.NAMES_OF_MODULE
    assert {"__version__", "NAMES_OF_MODULE"} <= declared
