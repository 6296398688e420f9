"""What the packages offer: names that are there, and no cost before they are asked for."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

PACKAGES = ["", ".in_motion", ".proofs", ".reference", ".solver"]


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_is_there_and_no_module_hides_it(package):
    module = import_module(f"certnav.alignment{package}")
    folder = Path(module.__file__).parent
    for name in module.__all__:
        assert not isinstance(getattr(module, name), ModuleType)
        # A module of that name would take its place once imported.
        assert not (folder / f"{name}.py").exists()
    assert set(module.__all__) <= set(dir(module))
    with pytest.raises(AttributeError, match="'nothing'"):
        _ = module.nothing


@pytest.mark.parametrize("package", PACKAGES)
def test_the_docstring_says_where_everything_is(package):
    module = import_module(f"certnav.alignment{package}")
    folder, said = Path(module.__file__).parent, module.__doc__.replace(",", " ").split()
    assert {f.stem for f in folder.glob("*.py")} - {"__init__"} <= set(said)
    assert {f"{f.parent.name}/" for f in folder.glob("*/__init__.py")} <= set(said)


def test_importing_the_packages_costs_nothing():
    names = ", ".join(f"certnav.alignment{package}" for package in PACKAGES)
    code = f"import sys, {names}; sys.exit(any(m in sys.modules for m in ('numpy', 'scipy')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_aligning_needs_no_semidefinite_solver():
    code = (
        "import sys; from certnav.alignment import align, align_robust;"
        "from certnav.alignment.in_motion import wait_for_alignment;"
        "sys.exit('clarabel' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
