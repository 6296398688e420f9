"""Folders are recognised by what is in them; mistakes are one line."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
from pathlib import Path

import pytest

from certnav.datasets.loading import formats, load, recognise
from certnav.datasets.text.tables import read_table
from certnav.filters.errors import ConfigError, DataError, NavError

REAL = {
    "comma2k19-example1": "comma2k19",
    "rtklibexplorer-drive": "rtklibexplorer",
    "oakville-drives/urban-medium-turn-loop-nominal-001": "oakville",
    "instinct/spirent_dynamic": "spirent",
    "tumsat-tsukishima": "tumsat",
}


@pytest.mark.parametrize(("folder", "name"), REAL.items())
def test_real_sets_are_recognised(data_dir, folder, name):
    assert recognise(data_dir / folder) == name


def touch(root: Path, *names: str) -> Path:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("")
    return root


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["IMU/MEMS_imu_data.txt", "Groundtruth/groundtruth.txt"], "great"),
        (["imu/ADIS.TXT", "gnss/rover/SEPT3030.20O"], "great"),
        (["great.toml"], "great"),
        (["processed_log/IMU/gyro/t", "global_pose/frame_times"], "comma2k19"),
        (["imu.csv.gz", "gnss.csv"], "oakville"),
        (["imu_1.csv", "gnss_1.pos"], "rtklibexplorer"),
        (["GNSSTCData_GQ.mat", "IMUData1105.mat"], "tumsat"),
    ],
)
def test_recognised_by_content(tmp_path, names, expected):
    assert recognise(touch(tmp_path, *names)) == expected


def test_unrecognised_lists_what_was_looked_for_in_one_line(tmp_path):
    with pytest.raises(DataError, match="not recognised") as caught:
        load(tmp_path)
    assert "\n" not in str(caught.value)
    for name in formats():
        assert f"{name}: " in str(caught.value)


def test_missing_path_and_file_instead_of_folder(tmp_path):
    with pytest.raises(DataError, match="no such file or folder"):
        load(tmp_path / "nowhere")
    with pytest.raises(DataError, match="neither RINEX observations nor a receiver's log"):
        load(touch(tmp_path, "a.txt") / "a.txt")


def test_two_formats_in_one_folder_ask_for_one(tmp_path):
    touch(tmp_path, "imu.csv", "gnss.csv", "imu_1.csv", "gnss_1.pos")
    with pytest.raises(DataError, match=r"oakville and rtklibexplorer.*format="):
        load(tmp_path)


def test_format_and_options_are_checked_before_anything_is_read(tmp_path):
    touch(tmp_path, "imu.csv", "gnss.csv")
    with pytest.raises(ConfigError, match="did you mean 'oakville'"):
        load(tmp_path, format="oakvile")
    with pytest.raises(ConfigError, match=r"options of oakville: .*did you mean 'preset'"):
        load(tmp_path, presets="consumer")
    with pytest.raises(ConfigError, match=r"options of great: .*did you mean 'lever'"):
        load(touch(tmp_path / "g", "great.toml"), levers="figure")


def test_the_notes_say_what_the_folder_was_taken_for(data_dir):
    folder = data_dir / "oakville-drives/parking-lot-figure8-nominal-001"
    assert load(folder).notes[0].startswith("read as oakville, recognised by")
    assert load(folder, format="oakville").notes[0] == "read as oakville, as told"


def test_every_reader_takes_a_path_and_options_by_name():
    """By keyword, or in a dataclass: nothing may hang on the order of options."""
    for kind in formats().values():
        module = importlib.import_module(f"certnav.datasets.{kind.module}")
        reader = getattr(module, f"read_{kind.name}")
        first, *rest = inspect.signature(reader).parameters.values()
        assert first.name == "path"
        if kind.takes:
            assert [p.name for p in rest] == ["options"]
            assert kind.options == tuple(
                f.name for f in dataclasses.fields(getattr(module, kind.takes))
            )
        else:
            assert all(p.kind is inspect.Parameter.KEYWORD_ONLY for p in rest)
            assert kind.options == tuple(p.name for p in rest)


@pytest.mark.parametrize("text", ["", "a b c\n", "1 2\n", "1 2 3 4\n", "1 x 3\n", "1 nan 3\n"])
def test_no_table_is_ever_half_read(tmp_path, text):
    file = tmp_path / "t.txt"
    file.write_text(text)
    with pytest.raises(NavError, match=r"t\.txt"):
        read_table(file, ("a", "b", "c"))


def test_a_folder_of_recordings_names_them(tmp_path):
    """Of GREAT sequences also as the catalogue calls them, which `--great` takes."""
    for name in ("Dataset_campus-01", "Dataset_campus-02"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "great.toml").write_text("")
    with pytest.raises(DataError, match=r"campus-01, Dataset_campus-02.*--great campus-01"):
        recognise(tmp_path)
