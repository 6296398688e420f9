"""Directories appear whole: at every step of placing one, a reader finds the old or the new."""

import os
import subprocess
import sys

import pytest

from certnav.nav.results import placing
from certnav.nav.results.placing import (
    SEAL,
    broken_seals,
    clean,
    current,
    exchange,
    new_draft,
    place,
    seal,
)


def filled(out, text):
    draft = new_draft(out)
    (draft / "a.csv").write_text(f"{text}\n" * 100)
    (draft / "b.json").write_text(text)
    return draft


def content(path):
    return (current(path) / "b.json").read_text()


@pytest.fixture
def dead():
    """Number of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@pytest.mark.parametrize("can_exchange", [True, False])
def test_the_new_replaces_the_old_and_nothing_is_left(tmp_path, monkeypatch, can_exchange):
    if not can_exchange:
        monkeypatch.setattr(placing, "exchange", lambda a, b: False)
    out = tmp_path / "run"
    for text in ("one", "two", "three"):
        place(filled(out, text), out)
        assert content(out) == text and broken_seals(out) == []
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_exchange_is_both_ways(tmp_path):
    a, b = filled(tmp_path / "a", "a"), filled(tmp_path / "b", "b")
    if not exchange(a, b):
        pytest.skip("not on this system")
    assert (a / "b.json").read_text() == "b" and (b / "b.json").read_text() == "a"
    with pytest.raises(OSError, match="No such file"):
        exchange(a, tmp_path / "nothing")


@pytest.mark.parametrize("step", ["rename", "exchange", "rmtree"])
def test_dying_at_any_step_leaves_the_old_or_the_new(tmp_path, monkeypatch, step):
    """Each system call of the move is the last: what is there reads as old or new, whole."""
    out = tmp_path / "run"
    place(filled(out, "old"), out)

    class Died(BaseException):
        pass

    seen = []

    def dies(*arguments, **_):
        seen.append(content(out))
        raise Died

    if step == "rename":  # the second of the two
        monkeypatch.setattr(placing, "exchange", lambda a, b: False)
        calls = []
        rename = type(out).rename

        def second(self, target):
            calls.append(self)
            return dies() if len(calls) == 2 else rename(self, target)

        monkeypatch.setattr(type(out), "rename", second)
    else:
        monkeypatch.setattr(*((placing, "exchange") if step == "exchange" else
                              (placing.shutil, "rmtree")), dies)  # fmt: skip
    with pytest.raises(Died):
        place(filled(out, "new"), out)
    monkeypatch.undo()
    assert seen == [content(out)] == ["new" if step == "rmtree" else "old"]
    assert broken_seals(current(out)) == []


def test_the_next_run_cleans_up_after_dead_ones(tmp_path, dead):
    out = tmp_path / "run"
    place(filled(out, "old"), out)
    mine, his = new_draft(out), filled(out, "half").rename(tmp_path / f".run.{dead}-x.new")
    other = tmp_path / f".running.{dead}-x.new"
    other.mkdir()
    clean(out)
    assert not his.exists() and mine.exists() and other.exists()
    assert content(out) == "old"


def test_what_a_dead_run_moved_aside_is_found_and_put_back(tmp_path, dead):
    out = tmp_path / "run"
    place(filled(out, "old"), out)
    out.rename(tmp_path / f".run.{dead}-x.old")
    assert content(out) == "old"
    clean(out)
    assert out.is_dir() and [p.name for p in tmp_path.iterdir()] == ["run"]


def test_seals_tell_what_changed(tmp_path):
    draft = filled(tmp_path / "x", "text")
    assert broken_seals(draft) == [SEAL]
    seal(draft)
    assert broken_seals(draft) == []
    (draft / "a.csv").write_text("shorter")
    (draft / "c").touch()
    (draft / "b.json").unlink()
    assert broken_seals(draft) == ["a.csv", "b.json", "c"]


def test_seals_are_those_of_sha256sum(tmp_path):
    draft = filled(tmp_path / "x", "text")
    seal(draft)
    try:
        said = subprocess.run(
            ["sha256sum", "--check", SEAL], cwd=draft, capture_output=True, text=True, check=False
        )
    except FileNotFoundError:
        pytest.skip("no sha256sum here")
    assert said.returncode == 0 and said.stdout.splitlines() == ["a.csv: OK", "b.json: OK"]


def test_permissions_are_those_of_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        assert new_draft(tmp_path / "x").stat().st_mode & 0o777 == 0o750
    finally:
        os.umask(before)
