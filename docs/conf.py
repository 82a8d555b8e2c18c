"""Sphinx configuration: pages in Markdown, notebooks executed as they are built, API and concordance generated."""

from __future__ import annotations

import os
import sys
import types
import typing
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE))

import generate  # noqa: E402  (docs/generate.py)

from stereocal import __version__  # noqa: E402

project = "stereocal"
author = "The stereocal developers"
copyright = "2026, The stereocal developers"
version = release = __version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx-mathjax-offline",  # formulas are set without a network too
    "sphinx.ext.viewcode",
    "numpydoc",
]
source_suffix = {".md": "myst-nb", ".ipynb": "myst-nb"}
exclude_patterns = ["_build", "performance_table.md"]
nitpicky = False
suppress_warnings: list[str] = []

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist", "attrs_inline"]
myst_heading_anchors = 3

# The notebooks are committed without output and run when the book is built: what it shows is what the code does now.
nb_execution_mode = os.environ.get("STEREOCAL_DOCS_NOTEBOOKS", "cache")
nb_execution_timeout = 120
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # numpydoc's Parameters say shape, unit and frame as well
numpydoc_show_class_members = False
numpydoc_class_members_toctree = False

html_theme = "furo"
html_title = "stereocal"
html_static_path = ["_static"]
html_css_files = ["book.css"]
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": []}


def tidy_docstring(app: object, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """Let essays be plain text: formulas stand indented, and |x| is a length, not a reStructuredText substitution."""
    if what == "module":
        lines[:] = generate.formulas_as_literals(lines)
    lines[:] = [line if line.lstrip().startswith((">>>", "...")) else line.replace("|", "∣") for line in lines]


def skip_type_aliases(app: object, what: str, name: str, obj: object, skip: bool, options: object) -> bool | None:
    """Leave out aliases such as ``Float = NDArray[np.float64]``: they have no documentation of their own."""
    return True if isinstance(obj, types.GenericAlias) or typing.get_origin(obj) is not None else None


def setup(app: object) -> None:
    """Connect the two hooks."""
    app.connect("autodoc-process-docstring", tidy_docstring)  # type: ignore[attr-defined]
    app.connect("autodoc-skip-member", skip_type_aliases)  # type: ignore[attr-defined]


generate.write_all(HERE)
