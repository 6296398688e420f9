"""The wheel holds `certnav` and nothing else, and works where others own the folders' names."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
#: Folders at the root that are no packages.
BESIDE = {"tests", "scripts", "examples", "benchmarks", "docs"}
#: Folders at the root that are packages, under names that others use too.
FOLDERS = ("nav", "alignment", "velocity", "filters", "datasets")

IMPORT_ALL = """
import importlib, pkgutil
import certnav, certnav.nav.commands.cli
import datasets
names = [m.name for m in pkgutil.walk_packages(certnav.__path__, "certnav.")]
for name in names:
    importlib.import_module(name)
print(certnav.__file__, datasets.OWNER, len(names), sep="\\n")
"""


def run(*command: str | Path, cwd: Path, **env: str) -> str:
    """Return what the command printed; its own words where it fails."""
    done = subprocess.run(
        command, cwd=cwd, env={**os.environ, **env}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def tracked() -> list[Path]:
    """The files under version control, relative to the root."""
    if not (ROOT / ".git").exists():
        pytest.skip("no checkout: which files belong to it is not known")
    names = run("git", "ls-files", "-z", cwd=ROOT).split("\0")
    return [Path(name) for name in names if name and (ROOT / name).is_file()]


@pytest.fixture(scope="module")
def wheel(tracked, tmp_path_factory) -> Path:
    """The wheel of a checkout that is called otherwise and holds tracked files only."""
    folder = tmp_path_factory.mktemp("wheel")
    for name in tracked:
        (folder / "checkout" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, folder / "checkout" / name)
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--no-deps")
    run(*pip, "--no-build-isolation", "--wheel-dir", folder, folder / "checkout", cwd=folder)
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def site(wheel, tmp_path_factory) -> Path:
    """A folder to import from: the wheel, and strangers called like our folders."""
    folder = tmp_path_factory.mktemp("site")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--no-deps")
    run(*pip, "--no-compile", "--target", folder, wheel, cwd=folder)
    assert not {path.name for path in folder.iterdir()} & set(FOLDERS)
    for name in FOLDERS:
        (folder / name).mkdir()
        (folder / name / "__init__.py").write_text("OWNER = 'somebody else'\n")
    return folder


def test_it_holds_one_package_with_every_module(wheel, tracked):
    names = {Path(name) for name in zipfile.ZipFile(wheel).namelist()}
    tops = {name.parts[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"certnav"}
    sources = {name for name in tracked if name.suffix == ".py" and name.parts[0] not in BESIDE}
    installed = {name for name in names if name.parts[0] == "certnav"}
    data = {Path("certnav/py.typed"), Path("certnav/nav/page/page.js")}
    assert installed == {"certnav" / name for name in sources} | data
    for folder in {name.parent for name in sources}:
        assert folder / "__init__.py" in sources
    assert {name.parts[0] for name in sources} == {"__init__.py", "lazy.py", *FOLDERS}


def test_its_top_level_and_command_are_certnav(wheel):
    with zipfile.ZipFile(wheel) as archive:
        info = {Path(name).name: name for name in archive.namelist() if ".dist-info/" in name}
        assert archive.read(info["top_level.txt"]).split() == [b"certnav"]
        assert b"certnav = certnav.nav.commands.cli:main" in archive.read(info["entry_points.txt"])


def test_every_module_is_imported_beside_strangers(site, tmp_path):
    said = run(sys.executable, "-c", IMPORT_ALL, cwd=tmp_path, PYTHONPATH=str(site))
    where, owner, modules = said.splitlines()[-3:]
    assert Path(where).parent == site / "certnav"
    assert owner == "somebody else"
    assert int(modules) == len(list((site / "certnav").rglob("*.py"))) - 1


def test_the_command_runs_outside_the_checkout(site, tmp_path):
    command = (sys.executable, "-m", "certnav.nav.commands.cli", "--help")
    said = run(*command, cwd=tmp_path, PYTHONPATH=str(site))
    assert "usage: certnav" in said
