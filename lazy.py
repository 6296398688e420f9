"""Public names of a package that are imported when they are first asked for.

Importing a package then costs nothing, and tab completion still knows its names. `__all__` and the
imports under `TYPE_CHECKING` stay written out in each package, for static tools and for readers.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def names(
    package: str, homes: Mapping[str, tuple[str, ...]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package.

    Parameters
    ----------
    package : str
        Its ``__name__``.
    homes : mapping
        Module below the package → the names that are imported from it.
    """
    home = {name: module for module, found in homes.items() for name in found}

    def get(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{home[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    def listed() -> list[str]:
        hidden = [name for name in vars(sys.modules[package]) if name.startswith("__")]
        return sorted({*hidden, *home})

    return get, listed
