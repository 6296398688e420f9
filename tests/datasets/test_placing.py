"""What is placed appears whole: at every step a reader finds the old or the new."""

import os
import subprocess
import sys

import pytest

from certnav.datasets import placing
from certnav.datasets.placing import (
    SEAL,
    broken_seals,
    clean,
    current,
    exchange,
    new_draft,
    place,
    seal,
    write_file,
    written_whole,
)


def filled(out, text):
    draft = new_draft(out)
    (draft / "a.csv").write_text(f"{text}\n" * 100)
    (draft / "b.json").write_text(text)
    return draft


def sealed(out, text):
    draft = filled(out, text)
    seal(draft)
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
        place(sealed(out, text), out)
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
    place(sealed(out, "old"), out)

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
        place(sealed(out, "new"), out)
    monkeypatch.undo()
    assert seen == [content(out)] == ["new" if step == "rmtree" else "old"]
    assert broken_seals(current(out)) == []


def test_the_next_run_cleans_up_after_dead_ones(tmp_path, dead):
    out = tmp_path / "run"
    place(sealed(out, "old"), out)
    mine, his = new_draft(out), sealed(out, "half").rename(tmp_path / f".run.{dead}-x.new")
    other = tmp_path / f".running.{dead}-x.new"
    other.mkdir()
    clean(out)
    assert not his.exists() and mine.exists() and other.exists()
    assert content(out) == "old"


def test_what_a_dead_run_moved_aside_is_found_and_put_back(tmp_path, dead):
    out = tmp_path / "run"
    place(sealed(out, "old"), out)
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
        write_file(tmp_path / "page", b"")
        assert (tmp_path / "page").stat().st_mode & 0o777 == 0o640
    finally:
        os.umask(before)


def test_what_is_written_whole_may_have_folders_and_replaces_what_a_link_points_to(tmp_path):
    (tmp_path / "disk").mkdir()
    link = tmp_path / "run"
    link.symlink_to(tmp_path / "disk" / "run")
    for text in ("one", "two"):
        with written_whole(link) as draft:
            (draft / "deep" / "er").mkdir(parents=True)
            (draft / "deep" / "er" / "b.json").write_text(text)
        assert link.is_symlink() and (link / "deep" / "er" / "b.json").read_text() == text
    assert [p.name for p in (tmp_path / "disk").iterdir()] == ["run"]


def test_a_failure_while_writing_leaves_the_old_whole(tmp_path):
    out = tmp_path / "run"
    place(sealed(out, "old"), out)
    with pytest.raises(KeyboardInterrupt), written_whole(out) as draft:
        (draft / "b.json").write_text("new")
        raise KeyboardInterrupt
    assert content(out) == "old" and broken_seals(out) == []
    assert [p.name for p in tmp_path.iterdir()] == ["run"]


def test_a_file_is_replaced_whole_or_not_at_all(tmp_path, monkeypatch):
    page = tmp_path / "page.html"
    write_file(page, b"one ", memoryview(b"page"))
    assert page.read_bytes() == b"one page"

    def full(*_):
        raise OSError("disk full")

    with monkeypatch.context() as patch, pytest.raises(OSError, match="disk full"):
        patch.setattr(placing, "_open_to_others", full)
        write_file(page, b"another")
    assert page.read_bytes() == b"one page"
    assert [p.name for p in tmp_path.iterdir()] == ["page.html"]
