"""What the packages offer: names that are there, said in one way, at no cost before they are asked.

A name is written down four times (docstring, type checker, table, `__all__`); here they are held
together.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

PACKAGES = [
    "alignment", "alignment.levelling", "datasets", "filters", "velocity", "velocity.study", "nav",
    "nav.check", "nav.compare", "nav.report", "nav.results", "nav.spells", "nav.tune",
    "nav.windows",
]  # fmt: skip


def packages():
    return pytest.mark.parametrize("package", PACKAGES)


def for_type_checkers(source: str) -> dict[str, str]:
    """Return the module of every name imported under ``if TYPE_CHECKING``."""
    (block,) = (
        node for node in ast.parse(source).body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    )  # fmt: skip
    return {name.name: found.module for found in block.body for name in found.names}


@packages()
def test_public_names_are_there_and_no_module_hides_them(package):
    module = import_module(f"certnav.{package}")
    folder = Path(module.__file__).parent
    for name in module.__all__:
        assert not isinstance(getattr(module, name), ModuleType)
        # A module of that name would take its place once it is imported.
        assert not (folder / f"{name}.py").exists() and not (folder / name).exists()
    assert set(module.__all__) <= set(dir(module))
    with pytest.raises(AttributeError, match="'nothing'"):
        _ = module.nothing


@packages()
def test_type_checkers_see_the_names_that_users_get(package):
    module = import_module(f"certnav.{package}")
    seen = for_type_checkers(Path(module.__file__).read_text(encoding="utf-8"))
    assert sorted(seen) == sorted(module.__all__)
    for name, where in seen.items():
        home = import_module(f"certnav.{package}.{where}")
        assert getattr(module, name) is getattr(home, name)
        assert getattr(getattr(home, name), "__module__", home.__name__) == home.__name__


@packages()
def test_the_docstring_says_where_everything_is(package):
    module = import_module(f"certnav.{package}")
    folder = Path(module.__file__).parent
    said = module.__doc__.replace(",", " ").split()
    modules = [f.stem for f in folder.glob("*.py") if not f.name.startswith("_")]
    rooms = [f"{f.parent.name}/" for f in folder.glob("*/__init__.py")]
    assert set(modules + rooms) <= set(said)


def test_importing_the_packages_costs_nothing():
    names = ", ".join(f"certnav.{package}" for package in PACKAGES)
    code = f"import sys, {names}; print({{'numpy', 'scipy', 'numba'}} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_name_asked_for_twice_is_the_same():
    from certnav import datasets, velocity
    from certnav.datasets.loading import load
    from certnav.velocity import mounting

    assert datasets.load is load is datasets.load
    assert velocity.calibrate_mounting is mounting.calibrate_mounting
