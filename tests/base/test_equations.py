"""The registry and the docstrings say the same."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterator

import pytest

import stereocal
from stereocal.base.equations import EQUATIONS

CITATION = re.compile(r"\[(eq [^\]]+|alg-[a-z]+|sec-\d)\]")


def _expand(citation: str) -> list[str]:
    """[eq 2a-10] names every equation from 2a to 10; [eq 13, 14] names two."""
    ids = [e.id for e in EQUATIONS]
    found = []
    for part in re.split(r",\s*", citation):
        part = part if part.startswith(("eq", "alg", "sec")) else f"eq {part}"
        if "–" in part or re.match(r"^eq \w+-\w+$", part):
            first, last = re.split(r"[–-]", part.removeprefix("eq "))
            found += ids[ids.index(f"eq {first}") : ids.index(f"eq {last}") + 1]
        else:
            found.append(part)
    return found


def _modules() -> Iterator[str]:
    for module in pkgutil.walk_packages(stereocal.__path__, "stereocal."):
        if not module.name.endswith("__main__") and module.name != "stereocal.store.capture":
            yield module.name


@pytest.mark.parametrize("name", sorted(_modules()))
def test_every_citation_is_of_an_equation_that_exists(name: str) -> None:
    source = inspect.getsource(importlib.import_module(name))
    known = {equation.id for equation in EQUATIONS}
    cited = {id for citation in CITATION.findall(source) for id in _expand(citation)}
    assert cited <= known


@pytest.mark.parametrize("equation", EQUATIONS, ids=lambda e: e.id)
def test_every_equation_has_its_implementer_and_is_cited_there(equation) -> None:
    assert equation.implemented_by
    for full_name in equation.implemented_by:
        module, name = full_name.rsplit(".", 1)
        doc = inspect.getdoc(getattr(importlib.import_module(module), name)) or ""
        cited = {id for citation in CITATION.findall(doc) for id in _expand(citation)}
        assert equation.id in cited, f"{full_name} does not cite [{equation.id}] in its docstring"


def test_ids_are_unique_and_errata_are_told() -> None:
    assert len({e.id for e in EQUATIONS}) == len(EQUATIONS)
    for equation in EQUATIONS:
        assert bool(equation.erratum) == (equation.printed != equation.corrected)
