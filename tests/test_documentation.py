"""The API pages name every public name, and nothing that is none."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("", "nav", "alignment", "velocity", "datasets", "filters")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_has_its_place(package):
    name = f"certnav.{package}".rstrip(".")
    page = ROOT / "docs" / "api" / f"{package or 'certnav'}.md"
    said = re.findall(r"(?m)^::: ([\w.]+)$", page.read_text(encoding="utf-8"))
    assert said == [f"{name}.{public}" for public in sorted(import_module(name).__all__)]


def test_every_page_is_in_the_navigation():
    """A page that nothing leads to is not read."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    named = set(re.findall(r": ([\w/]+\.md)$", text, re.MULTILINE))
    there = {str(p.relative_to(ROOT / "docs")) for p in (ROOT / "docs").rglob("*.md")}
    assert named == there
