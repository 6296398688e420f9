"""Importing downloads: by content whatever the names, everything or nothing, nothing outside."""

from __future__ import annotations

import gzip
import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from certnav.datasets.great.files import find_files
from certnav.datasets.great.importing import import_archives, still_missing
from certnav.datasets.great.inspection import inspect
from certnav.filters.errors import DataError

DAY2 = 2 * 86400.0  # 2020-10-27
CAMPUS_01, URBAN_01, CAMPUS_NIGHT = 180590.0, 190000.0, 4 * 86400.0 + 40000.0
OBS = (
    f"{'     3.02           OBSERVATION DATA    M':<60}RINEX VERSION / TYPE\n"
    f"{'  2020    10    27     2     0    0.0000000     GPS':<60}TIME OF FIRST OBS\n"
    f"{'':<60}END OF HEADER\n> 2020 10 27 02 00 00.0000000  0  0\n"
)
NAV = (
    f"{'     3.04           N: GNSS NAV DATA    M':<60}RINEX VERSION / TYPE\n"
    f"{'':<60}END OF HEADER\n"
    "G01 2020 10 27 00 00 00 1.0D-04 0.0D+00 0.0D+00\n"
)


def imu(start, duration=606.85, hz=100.0, header=""):
    """A little of an IMU text: the rows at the start and at the end decide."""
    times = np.concatenate([start + np.arange(200) / hz, [start + duration]])
    rows = [f"{t:.5f} 0.1 0.2 0.3 0.0 0.1 9.79" for t in times]
    return header + "\n".join(rows) + "\n"


def reference(start, duration=606.85, week=2129):
    head = "Week GPSTime X-ECEF Y-ECEF Z-ECEF …\n(weeks) (sec) (m) (m) (m)\n"
    rows = [
        f"{week} {t:.3f} -2267776.0 5009357.4 3220982.1 " + "1 " * 19 + "Fixed 1.2 1 15"
        for t in (start, start + 1.0, start + duration)
    ]
    return head + "\n".join(rows) + "\n"


def archive(path: Path, **members: str | bytes) -> Path:
    with zipfile.ZipFile(path, "w") as z:
        for name, content in members.items():
            z.writestr(name, content)
    return path


def zipped(folder: Path, name: str, members: dict[str, str | bytes]) -> Path:
    return archive(folder / name, **members)


def tree(home: Path) -> list[str]:
    return sorted(str(f.relative_to(home)) for f in home.rglob("*") if f.is_file())


@pytest.fixture
def here(tmp_path):
    (tmp_path / "in").mkdir()
    return tmp_path / "in", tmp_path / "great"


COMPLETE = [
    "Dataset_campus-01/Groundtruth/groundtruth.txt",
    "Dataset_campus-01/IMU/MEMS_imu_data.txt",
    "Dataset_campus-01/IMU/Tactical_imu_data.txt",
    "GNSS_RAW_DATA/brdm3010.20p",
    "GNSS_RAW_DATA/day/SEPT3010.20O",
]


def test_a_whole_sequence_by_content_alone(here):
    """Archives called IMU.zip, inner names of no help, RINEX gzipped, folders in odd case."""
    source, home = here
    archives = [
        zipped(source, "IMU.zip", {
            "imu/a.TXT": imu(CAMPUS_01), "imu/b.txt": imu(CAMPUS_01, hz=200.0, header="Time g a\n"),
            "Image/Img0/Data/1.jpg": b"\xff\xd8", "Image/Img0/timestamps.txt": "1,1.jpg\n",
        }),
        zipped(source, "GNSS_RAW_DATA.zip", {
            "GNSS_RAW_DATA/day/SEPT3010.20O.gz": gzip.compress(OBS.encode()),
            "GNSS_RAW_DATA/brdm3010.20p": NAV,
        }),
    ]  # fmt: skip
    bare = source / "truth.txt"
    bare.write_text(reference(CAMPUS_01))
    report = import_archives([*archives, bare], home)
    assert tree(home) == COMPLETE
    assert report.missing == {"campus-01": ()}
    assert "campus-01: complete" in report.text()
    assert "images" in report.text()
    assert bare.exists()  # the user's files stay
    folder = home / "Dataset_campus-01"
    found = find_files(folder, imu="mems", reference_point="mems", named={})
    assert found.imu.name == "MEMS_imu_data.txt"
    assert found.reference.name == "groundtruth.txt"
    assert [f.name for f in found.observations] == ["SEPT3010.20O"]
    assert [f.name for f in found.navigation] == ["brdm3010.20p"]


def test_what_is_missing_is_said_and_a_second_import_completes_it(here):
    source, home = here
    first = zipped(source, "campus01_IMU.zip", {"x.txt": imu(CAMPUS_01)})
    report = import_archives([first], home)
    lacking = report.missing["campus-01"]
    assert any("reference" in item for item in lacking)
    assert any("rover observations" in item for item in lacking)
    assert any("ephemerides" in item for item in lacking)
    assert "still missing" in report.text()
    second = zipped(source, "raw.zip", {"a.20O": OBS, "b.20N": NAV, "t.txt": reference(CAMPUS_01)})
    report = import_archives([first, second], home)  # the first again: same content, no conflict
    assert [item for item in report.missing["campus-01"] if "optional" not in item] == []
    assert still_missing(home) == report.missing


def test_nested_archives(here):
    source, home = here
    inner = io.BytesIO()
    with zipfile.ZipFile(inner, "w") as z:
        z.writestr("MEMS.txt", imu(CAMPUS_NIGHT, 545.7))
    outer = zipped(source, "all.zip", {"campus-night/IMU.zip": inner.getvalue()})
    import_archives([outer], home)
    assert tree(home) == ["Dataset_campus-night/IMU/MEMS_imu_data.txt"]


def test_a_longer_imu_file_follows_the_reference_it_overlaps(here):
    """Neither name nor duration tell the IMU file, but it covers the reference's time."""
    source, home = here
    archives = [
        zipped(source, "IMU.zip", {"x.txt": imu(URBAN_01 - 100.0, 1000.0)}),
        zipped(source, "urban-01.zip", {"x.txt": reference(URBAN_01, 767.3)}),
    ]
    import_archives(archives, home)
    assert "Dataset_urban-01/IMU/MEMS_imu_data.txt" in tree(home)


def test_urban_02_is_alone_on_its_day(here):
    source, home = here
    import_archives([zipped(source, "IMU.zip", {"x.txt": imu(30000.0, 1622.0)})], home)
    assert tree(home) == ["Dataset_urban-02/IMU/MEMS_imu_data.txt"]


@pytest.mark.parametrize(
    ("name", "members", "message"),
    [
        ("IMU.zip", {"x.txt": imu(CAMPUS_01, 950.0)}, r"fits campus-01, .*put the sequence's name"),
        ("campus-01.zip", {"x.txt": imu(CAMPUS_NIGHT)}, "named campus-01 .2020-10-27."),
        ("campus-01.zip", {"x.txt": reference(CAMPUS_01, week=2131)}, "week 2131"),
        ("x.zip", {"../../evil.txt": imu(CAMPUS_01)}, "leads outside"),
        ("x.zip", {"/etc/evil.txt": imu(CAMPUS_01)}, "leads outside"),
        ("x.zip", {"C:\\evil.txt": imu(CAMPUS_01)}, "leads outside"),
        ("x.zip", {"a\\..\\..\\evil.txt": imu(CAMPUS_01)}, "leads outside"),
        ("x.zip", {"readme.txt": "hello"}, "nothing of a GREAT sequence"),
        ("x.zip", {"o.20O.gz": gzip.compress(OBS.encode())[:40]}, "damaged gzip"),
        (
            "campus-01.zip",
            {"a.txt": imu(CAMPUS_01), "b.txt": imu(CAMPUS_01, 607.0)},
            "are different files for",
        ),
    ],
)
def test_refusals_leave_nothing_behind(here, name, members, message):
    source, home = here
    good = zipped(source, "campus-02.zip", {"x.txt": imu(CAMPUS_01 + 900.0, 806.9)})
    with pytest.raises(DataError, match=message) as caught:
        if "nothing" in message:
            import_archives([zipped(source, name, members)], home)
        else:
            import_archives([good, zipped(source, name, members)], home)
    assert "\n" not in str(caught.value)
    assert not home.exists()
    assert not list(source.parent.rglob("*evil*"))


def test_a_different_file_in_place_is_not_replaced(here):
    source, home = here
    import_archives([zipped(source, "campus-01.zip", {"x.txt": imu(CAMPUS_01)})], home)
    before = (home / COMPLETE[1]).read_text()
    other = zipped(source, "2.zip", {"campus-01/x.txt": imu(CAMPUS_01, 606.0), "b.20O": OBS})
    with pytest.raises(DataError, match="would replace a different file"):
        import_archives([other], home)
    assert (home / COMPLETE[1]).read_text() == before
    assert tree(home) == [COMPLETE[1]]


def test_damaged_and_missing_archives(here):
    source, home = here
    with pytest.raises(DataError, match="no such file"):
        import_archives([source / "x.zip"], home)
    good = zipped(source, "campus-01.zip", {"x.txt": imu(CAMPUS_01)})
    raw = bytearray(good.read_bytes())
    raw[60:80] = b"\x00" * 20
    good.write_bytes(bytes(raw))
    with pytest.raises(DataError, match="damaged archive"):
        import_archives([good], home)


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (imu(CAMPUS_01), "mems"),
        (imu(CAMPUS_01, hz=200.0), "tactical"),
        (imu(CAMPUS_01, hz=10.0), ""),
        (reference(CAMPUS_01), "reference"),
        (OBS, "observations"),
        (NAV, "navigation"),
        ("1.0 2.0 3.0\n" * 5, ""),
        ("", ""),
    ],
)
def test_content_decides(tmp_path, content, kind):
    file = tmp_path / "x"
    file.write_text(content)
    assert inspect(file).kind == kind


def test_a_simulated_sequence_survives_being_zipped(tmp_path):
    """The writer's own folder, packed under names that say nothing, loads as it did."""
    from certnav.datasets.great.writer import simulate_folder
    from certnav.datasets.loading import load
    from certnav.datasets.simulation.simulator import SimulationConfig

    folder = simulate_folder(
        SimulationConfig(name="s", seed=1, duration=40.0, density="open"), tmp_path / "s"
    )
    files = sorted(f for f in folder.rglob("*") if f.is_file() and f.suffix != ".toml")
    members = {f"Campus_02/{k}.dat": f.read_bytes() for k, f in enumerate(files)}
    home = tmp_path / "great"
    report = import_archives([zipped(tmp_path, "download.zip", members)], home)
    assert not [item for item in report.missing["campus-02"] if "optional" not in item]
    imported = home / "Dataset_campus-02"
    (imported / "great.toml").write_text((folder / "great.toml").read_text())
    before, after = load(folder), load(imported)
    np.testing.assert_array_equal(after.inertial.accel_b, before.inertial.accel_b)
    np.testing.assert_array_equal(after.observations.range_rate, before.observations.range_rate)
    np.testing.assert_array_equal(after.reference.pos_e, before.reference.pos_e)


def test_a_folder_of_the_sequence_s_name_tells_archives_that_are_called_alike(here):
    source, home = here
    archives = []
    for name, start in (("campus-01", CAMPUS_01), ("Urban_01", URBAN_01)):
        (source / name).mkdir()
        archives.append(zipped(source / name, "IMU.zip", {"IMU/m.txt": imu(start, 200.0)}))
    report = import_archives(archives, home)
    assert tree(home) == [
        "Dataset_campus-01/IMU/MEMS_imu_data.txt", "Dataset_urban-01/IMU/MEMS_imu_data.txt",
    ]  # fmt: skip
    assert {s for s, _ in report.placed} == {
        "campus-01/IMU.zip:IMU/m.txt", "Urban_01/IMU.zip:IMU/m.txt",
    }  # fmt: skip
