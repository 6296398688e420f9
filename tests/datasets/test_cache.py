"""Kept arrays: the same again, never a damaged one, never those of other files or other code."""

import numpy as np
import pytest

from certnav.datasets import cache
from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load
from certnav.datasets.simulation.simulator import SimulationConfig


class Maker:
    """Counts how often it is asked."""

    def __init__(self):
        self.times = 0

    def __call__(self):
        self.times += 1
        return {"time": np.arange(5.0), "sat": np.array(["G01", "E12"]), "n": np.array(3)}


@pytest.fixture
def source(tmp_path):
    """A file that is read, and the code that reads it."""
    file, code = tmp_path / "rover.obs", tmp_path / "reader.py"
    file.write_text("content")
    code.write_text("read()")
    return file, code


def ask(maker, source, folder, arguments="G"):
    with cache.kept_in(folder):
        return cache.kept(maker, [source[0]], arguments, [source[1]])


def test_the_second_time_it_comes_from_the_folder(tmp_path, source):
    maker, folder = Maker(), tmp_path / "kept"
    first, second = (ask(maker, source, folder) for _ in range(2))
    assert maker.times == 1
    for name, array in first.items():
        np.testing.assert_array_equal(second[name], array)
        assert second[name].dtype == array.dtype
    assert [f.suffix for f in folder.iterdir()] == [".certnav"]


def test_content_counts_and_names_do_not(tmp_path, source):
    maker, folder = Maker(), tmp_path / "kept"
    ask(maker, source, folder)
    renamed = source[0].rename(tmp_path / "other.obs")
    ask(maker, (renamed, source[1]), folder)
    assert maker.times == 1
    renamed.write_text("contenT")
    ask(maker, (renamed, source[1]), folder)
    assert maker.times == 2


def test_other_arguments_and_other_code_make_it_anew(tmp_path, source):
    maker, folder = Maker(), tmp_path / "kept"
    ask(maker, source, folder)
    ask(maker, source, folder, arguments="GE")
    source[1].write_text("read_better()")
    ask(maker, source, folder)
    assert maker.times == 3


@pytest.mark.parametrize("damage", ["cut", "byte", "empty", "longer", "folder"])
def test_a_damaged_entry_is_made_again(tmp_path, source, damage):
    maker, folder = Maker(), tmp_path / "kept"
    good = ask(maker, source, folder)
    (entry,) = folder.iterdir()
    content = bytearray(entry.read_bytes())
    if damage == "byte":
        content[len(content) // 2] ^= 1
    if damage == "folder":
        entry.unlink()
        entry.mkdir()
    else:
        size = {"cut": -40, "empty": 0}.get(damage)
        entry.write_bytes(bytes(content[:size]) + (b"x" if damage == "longer" else b""))
    again = ask(maker, source, folder)
    assert maker.times == 2
    np.testing.assert_array_equal(again["time"], good["time"])
    ask(maker, source, folder)
    assert maker.times == (3 if damage == "folder" else 2)  # a good entry took its place


def test_a_folder_that_cannot_be_written_costs_time_only(tmp_path, source):
    maker = Maker()
    (tmp_path / "kept").write_text("a file")
    for _ in range(2):
        assert ask(maker, source, tmp_path / "kept")["n"] == 3
    assert maker.times == 2


def test_what_ends_in_an_error_leaves_nothing_behind(tmp_path, source):
    with pytest.raises(ValueError, match="later"), cache.kept_in(tmp_path / "kept"):
        cache.kept(Maker(), [source[0]], "G", [source[1]])
        raise ValueError("later")
    assert not (tmp_path / "kept").exists()


def test_nothing_is_kept_unless_asked(tmp_path, source):
    maker = Maker()
    for _ in range(2):
        cache.kept(maker, [source[0]], "G", [source[1]])
    assert maker.times == 2
    missing = (tmp_path / "missing.obs", source[1])
    ask(maker, missing, tmp_path / "kept")  # whose reader says what is missing
    assert maker.times == 3 and not (tmp_path / "kept").exists()


def test_rinex_is_read_once(tmp_path, monkeypatch):
    from certnav.datasets.rtklib import observations

    drive = tmp_path / "drive"
    simulate_folder(SimulationConfig(name="d", seed=3, duration=60.0, density="open"), drive)
    plain = load(drive)
    with cache.kept_in(tmp_path / "kept"):
        load(drive)

    def never(*args, **options):
        raise AssertionError("RINEX was read again")

    monkeypatch.setattr(observations, "_observation_records", never)
    with cache.kept_in(tmp_path / "kept"):
        kept = load(drive)
    for name in plain.observations.__dataclass_fields__:
        ours, theirs = getattr(kept.observations, name), getattr(plain.observations, name)
        np.testing.assert_array_equal(ours, theirs)
        assert ours.dtype == theirs.dtype
