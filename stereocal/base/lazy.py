"""Names that import their module when first used (PEP 562).

``import stereocal`` must cost a reader nothing: numpy alone takes 80 ms to import and numba 300 ms.
So the package's ``__init__`` only holds a map from module to names, and :func:`attach` turns that map
into the module-level ``__getattr__`` and ``__dir__`` that Python calls for a name it does not find.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any


def attach(
    package: str, names_of_module: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Build ``__getattr__``, ``__dir__`` and ``__all__`` of a lazy package.

    Parameters
    ----------
    package : str
        The package's ``__name__``.
    names_of_module : mapping of str to sequence of str
        The public names by the full name of the module that defines them.

    Returns
    -------
    tuple
        ``(__getattr__, __dir__, __all__)``, to be bound in the package.
    """
    module_of_name = {name: module for module, names in names_of_module.items() for name in names}

    def __getattr__(name: str) -> Any:  # noqa: N807
        if name not in module_of_name:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(module_of_name[name]), name)
        setattr(sys.modules[package], name, value)  # found at once from now on
        return value

    def __dir__() -> list[str]:  # noqa: N807
        return sorted(module_of_name)

    return __getattr__, __dir__, sorted(module_of_name)
