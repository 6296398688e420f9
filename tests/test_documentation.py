"""The API pages name every public name, and nothing that is none; every name has an example."""

from __future__ import annotations

import doctest
import enum
import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("", "nav", "alignment", "velocity", "datasets", "filters")


def with_examples() -> list:
    """Return the functions and classes that need an example: not constants, not enumerations."""
    found = {}
    for package in PACKAGES:
        home = import_module(f"certnav.{package}".rstrip("."))
        for name in home.__all__:
            public = getattr(home, name)
            plain = inspect.isclass(public) and issubclass(public, enum.Enum)
            if callable(public) and not plain:
                found[f"{public.__module__}.{public.__qualname__}"] = public
    return list(found.items())


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_has_its_place(package):
    name = f"certnav.{package}".rstrip(".")
    page = ROOT / "docs" / "api" / f"{package or 'certnav'}.md"
    said = re.findall(r"(?m)^::: ([\w.]+)$", page.read_text(encoding="utf-8"))
    assert said == [f"{name}.{public}" for public in sorted(import_module(name).__all__)]


@pytest.mark.parametrize(
    ("name", "public"), with_examples(), ids=lambda v: v if isinstance(v, str) else ""
)
def test_every_public_name_has_an_example_that_runs(name, public, tmp_path, monkeypatch):
    """Each by itself, with nothing imported but what it imports; its output to the letter."""
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(public) or ""
    assert "\nExamples\n--------\n" in text, f"{name}: no section 'Examples'"
    example = doctest.DocTestParser().get_doctest(text, {}, name, None, None)
    assert example.examples, f"{name}: no example"
    said: list[str] = []
    result = doctest.DocTestRunner(verbose=False).run(example, out=said.append)
    assert not result.failed, "".join(said)


def test_every_page_is_in_the_navigation():
    """A page that nothing leads to is not read."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r": ([\w/]+\.md)$", text, re.MULTILINE))
    there = {str(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md")}
    assert named == there
