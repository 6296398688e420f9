"""Tests of what all tests share: what is skipped fails in CI, and the checkout has any name."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = """
import pytest

def test_of_a_recording(data_dir): ...
def test_of_a_package(): pytest.importorskip("no_such_package")
@pytest.mark.skipif(True, reason="no such tool")
def test_of_a_tool(): ...
@pytest.mark.xfail(reason="known", strict=True)
def test_known_to_fail(): assert False
def test_of_nothing_else(): ...
"""


@pytest.fixture
def run(tmp_path):
    """Return a function: the closing line and all output of the tests above, under a CI.

    They run in a checkout whose name is no identifier, and whose root is a package.
    """
    root = tmp_path / "certnav-main"
    (root / "tests").mkdir(parents=True)
    shutil.copyfile(Path(__file__).with_name("conftest.py"), root / "tests" / "conftest.py")
    (root / "tests" / "test_some.py").write_text(TESTS)
    (root / "lazy.py").write_text("names = ()\n")
    (root / "__init__.py").write_text("from .lazy import names\n")
    shutil.copyfile(Path(__file__).parents[1] / "pyproject.toml", root / "pyproject.toml")

    def pytest_with(ci: str) -> tuple[str, str]:
        env = {**os.environ, "CI": ci, "CERTNAV_DATA": str(tmp_path / "nowhere")}
        command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider"]
        out = subprocess.run(command, cwd=root, env=env, capture_output=True, text=True).stdout
        return out.splitlines()[-1], out

    return pytest_with


def test_at_a_desk_they_are_skipped(run):
    assert "1 passed, 3 skipped, 1 xfailed" in run("")[0]


def test_in_ci_they_fail_and_say_what_is_missing(run, tmp_path):
    closing, out = run("true")
    assert "1 failed, 1 passed, 1 xfailed, 2 errors" in closing
    assert f"nothing is skipped in CI: no recordings at {tmp_path / 'nowhere'}: set" in out
    assert "nothing is skipped in CI: could not import 'no_such_package'" in out
    assert "nothing is skipped in CI: no such tool" in out
