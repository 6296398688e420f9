"""The examples run, quickly, from any folder, and print something."""

import runpy
from pathlib import Path

import pytest

from certnav.nav.commands.declare import summary

EXAMPLES = sorted((Path(__file__).resolve().parents[1] / "examples").glob("*.py"))


def test_there_are_examples():
    assert {e.stem for e in EXAMPLES} >= {"first_run", "live", "alignment", "own_data"}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e.stem)
def test_example_runs(example, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))  # what it writes goes away
    runpy.run_path(str(example), run_name="__main__")
    assert len(capsys.readouterr().out.splitlines()) >= 3
    assert "# %%" in example.read_text(encoding="utf-8")


def test_own_data_is_drafted_as_its_page_says(tmp_path, monkeypatch):
    """What `certnav declare` prints of the files, and what the draft has of the antenna."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (example,) = (e for e in EXAMPLES if e.stem == "own_data")
    draft = runpy.run_path(str(example))["draft"]
    page = (example.parents[1] / "docs" / "own_data.md").read_text(encoding="utf-8")
    assert "\n".join(summary(draft, Path("drive/sequence.toml"))) in page
    (line,) = (line for line in draft.text().splitlines() if line.startswith("lever_frd_m"))
    assert line.partition("a tape tells it")[0] in page
