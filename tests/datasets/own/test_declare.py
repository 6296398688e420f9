"""Drafts: what numbers show is filled in, what they cannot is a blank that is refused."""

from __future__ import annotations

import re
import tomllib

import numpy as np
import pandas as pd
import pytest

from certnav.datasets.own.blanks import BLANK
from certnav.datasets.own.declare import draft_declaration
from certnav.datasets.own.reader import read_declared
from certnav.filters.errors import ConfigError, DataError, NavError


def write(file, names, columns, header=True):
    pd.DataFrame(np.column_stack(columns), columns=names.split()).to_csv(
        file, index=False, header=header
    )
    return file


def imu_columns(start=180000.0, hz=50.0, accel=1.0, gyro=1.0, n=500):
    t = start + np.arange(n) / hz
    zero = np.zeros(n)
    return [t, zero, zero, gyro * 0.4 * np.sin(t), zero, zero, accel * (zero + 9.79)]


IMU = "t gx gy gz ax ay az"


def drafted(*files):
    return tomllib.loads(draft_declaration(files))


def test_oakville_files_are_drafted_from_their_columns(data_dir):
    folder = data_dir / "oakville-drives/urban-medium-turn-loop-nominal-001"
    text = draft_declaration([folder / "imu.csv.gz", folder / "gnss.csv.gz"])
    draft = tomllib.loads(text)
    assert draft["imu"]["gyro"] == ["gx_radps", "gy_radps", "gz_radps"]
    assert draft["imu"]["gyro_unit"] == "rad/s"  # says the header
    assert draft["imu"]["accel_unit"] == "m/s2"  # says gravity
    assert draft["imu"]["axes"] == BLANK
    assert "z of the file points up" in text
    assert draft["gnss"]["position"] == ["lat_deg", "lon_deg", "height_m"]
    assert draft["gnss"]["velocity_frame"] == "ned"
    assert draft["gnss"]["velocity_sigma"] == [f"vel_std_{k}_mps" for k in "ned"]
    assert draft["gnss"]["height"] == BLANK
    for section, key in (("antenna", "lever_frd_m"), ("vehicle", "mounting_rpy_deg")):
        assert draft[section][key] == BLANK


def test_every_blank_is_refused_with_its_line_until_the_drive_loads(data_dir, tmp_path):
    """Answer the blanks one by one, as a user would, by what each error asks for."""
    for name in ("imu", "gnss"):
        source = data_dir / f"oakville-drives/urban-medium-turn-loop-nominal-001/{name}.csv.gz"
        (tmp_path / f"{name}.csv.gz").symlink_to(source)
    file = tmp_path / "sequence.toml"
    file.write_text(draft_declaration([tmp_path / "imu.csv.gz", tmp_path / "gnss.csv.gz"]))
    # symbolic links resolve elsewhere: the names are what the user gave, beside the declaration
    file.write_text(re.sub(r'file = ".*/(\w+\.csv\.gz)"', r'file = "\1"', file.read_text()))
    answers = {
        "time_scale": '"relative"', "axes": '"FLU"', "preset": '"consumer"',
        "lever_frd_m": "[0.0, 0.0, 0.0]", "mounting_rpy_deg": "[0.0, 0.0, 0.0]",
        "height": '"ellipsoid"',
    }  # fmt: skip
    asked = []
    for _ in range(20):
        try:
            sequence = read_declared(tmp_path)
            break
        except ConfigError as error:
            found = re.match(r".*sequence\.toml:(\d+): \[\S+\] (\w+) is still '\?'", str(error))
            assert found, error
            asked.append(found[2])
            lines = file.read_text().splitlines()
            k = int(found[1]) - 1
            assert lines[k].startswith(found[2])
            lines[k] = f"{found[2]} = {answers[found[2]]}"
            file.write_text("\n".join(lines))
    assert set(asked) == set(answers)
    assert asked.count("time_scale") == 2
    assert len(sequence.inertial) > 30000


@pytest.mark.parametrize(
    ("accel", "unit"), [(1.0, "m/s2"), (1 / 9.80665, "g"), (1e3 / 9.80665, "mg"), (0.02, "m/s")]
)
def test_gravity_tells_the_unit_of_the_accelerometer(tmp_path, accel, unit):
    file = write(tmp_path / "imu.csv", IMU, imu_columns(accel=accel))
    assert drafted(file)["imu"]["accel_unit"] == unit


def test_a_gyro_too_fast_for_radians_is_in_degrees_and_else_it_is_asked(tmp_path):
    fast = write(tmp_path / "a.csv", IMU, imu_columns(gyro=57.3))
    slow = write(tmp_path / "b.csv", IMU, imu_columns())
    assert drafted(fast)["imu"]["gyro_unit"] == "deg/s"
    assert drafted(slow)["imu"]["gyro_unit"] == BLANK
    assert "largest is 0.4" in draft_declaration([slow])


@pytest.mark.parametrize(
    ("start", "scale"),
    [(1.75e9, "unix"), (1.45e9, BLANK), (180000.0, BLANK), (0.0, BLANK)],
)
def test_the_time_scale_only_where_its_size_leaves_one(tmp_path, start, scale):
    file = write(tmp_path / "imu.csv", IMU, imu_columns(start=start))
    assert drafted(file)["imu"]["time_scale"] == scale


def test_week_column_milliseconds_and_dates(tmp_path):
    columns = imu_columns()
    week = [np.full(500, 2129.0)]
    file = write(tmp_path / "a.csv", "week sow gx gy gz ax ay az", week + columns)
    assert drafted(file)["imu"]["time"] == ["week", "sow"]
    assert drafted(file)["imu"]["time_scale"] == "gps-week-sow"
    file = write(tmp_path / "b.csv", IMU, [(columns[0] + 1.75e9) * 1e3, *columns[1:]])
    assert drafted(file)["imu"]["time_unit"] == "ms"
    table = pd.DataFrame(np.column_stack(columns), columns=IMU.split())
    table["t"] = pd.to_datetime(table["t"], unit="s").dt.strftime("%Y-%m-%d %H:%M:%S.%f")
    table.to_csv(tmp_path / "c.csv", index=False)
    draft = drafted(tmp_path / "c.csv")["imu"]
    assert (draft["time"], draft["time_scale"]) == ("t", BLANK)


def test_without_a_header_columns_are_numbered_and_gravity_finds_the_accelerometer(tmp_path):
    columns = imu_columns()
    gyro_first = write(tmp_path / "a.csv", IMU, columns, header=False)
    draft = drafted(gyro_first)["imu"]
    assert (draft["time"], draft["gyro"], draft["accel"]) == (1, [2, 3, 4], [5, 6, 7])
    accel_first = [*columns[4:], *columns[1:4], columns[0]]
    draft = drafted(write(tmp_path / "b.csv", "a b c d e f g", accel_first, header=False))["imu"]
    assert (draft["time"], draft["gyro"], draft["accel"]) == (7, [4, 5, 6], [1, 2, 3])


def test_other_kinds_of_files(data_dir, tmp_path):
    static = data_dir / "instinct/tckf_static"
    draft = drafted(
        static / "vn310-imu.csv",
        static / "reach-m2-01_raw_202306291111.23O",
        static / "reach-m2-01_raw_202306291111.nav",
    )
    assert draft["imu"]["time"] == ["Time::GpsWeek", "GpsTow [s]"]
    assert draft["imu"]["gyro"][0] == "IMU::UncompGyro::X [rad/s]"  # not the magnetometer
    assert draft["rinex"]["observations"].endswith(".23O")
    assert draft["rinex"]["navigation"] == ["reach-m2-01_raw_202306291111.nav"]
    draft = drafted(data_dir / "rtklibexplorer-drive/gnss_1934_sf.pos")
    assert draft["gnss"]["format"] == "rtklib"
    assert draft["imu"]["file"] == BLANK
    pva = data_dir / "instinct/spirent_dynamic/Rover-dynamic_PVA_Spirent.csv"
    draft = drafted(pva)["reference"]
    assert draft["position_frame"] == "ecef"
    assert draft["attitude"] == ["Roll [deg]", "Pitch [deg]", "Yaw [deg]"]
    assert draft["point"] == draft["attitude_of"] == draft["attitude_convention"] == BLANK
    t = np.arange(100.0)
    odometer = write(tmp_path / "odo.csv", "time speed_kmh", [t, t / 10.0])
    assert drafted(odometer)["odometer"] == {
        "file": "odo.csv", "time": "time", "time_scale": BLANK, "speed": "speed_kmh",
        "speed_unit": "km/h",
    }  # fmt: skip


def test_names_of_everyday_loggers(tmp_path):
    """Rates about axes, speeds by direction, milliseconds in the header."""
    t, *rest = imu_columns(start=0.0, gyro=57.3)
    names = "elapsed_ms roll_rate pitch_rate yaw_rate fwd_acc left_acc up_acc"
    imu = write(tmp_path / "imu.csv", names, [1e3 * t, *rest])
    k = np.arange(100.0)
    place = [1e3 * k, 43.0 + 1e-5 * k, 11.0 + 0 * k, 100.0 + 0 * k]
    names = "elapsed_ms Latitude Longitude Altitude north_speed east_speed down_speed"
    gnss = write(tmp_path / "gnss.csv", names, [*place, 1.1 + 0 * k, 0 * k, 0 * k])
    draft = drafted(imu, gnss)
    assert draft["imu"]["gyro"] == ["roll_rate", "pitch_rate", "yaw_rate"]
    assert draft["imu"]["accel"] == ["fwd_acc", "left_acc", "up_acc"]
    assert draft["imu"]["time_unit"] == draft["gnss"]["time_unit"] == "ms"
    assert draft["gnss"]["velocity"] == ["north_speed", "east_speed", "down_speed"]
    assert (draft["gnss"]["velocity_frame"], draft["gnss"]["velocity_unit"]) == ("ned", BLANK)


def test_what_no_name_tells_is_asked_with_the_columns_that_are_left(tmp_path):
    k = np.arange(100.0)
    columns = [500.0 * k, 43.0 + 1e-5 * k, 11.0 + 0 * k, 100.0 + 0 * k, 4.0 + 0 * k, 0 * k]
    text = draft_declaration([write(tmp_path / "g.csv", "Zeit lat lon alt Tempo Kurs", columns)])
    draft = tomllib.loads(text)["gnss"]
    assert draft["velocity"] == draft["velocity_sigma_mps"] == BLANK
    assert draft["time_unit"] == "ms"  # 500 s between positions are none, and 500 µs neither
    assert "stamps step by 500" in text and "north = speed cos(course)" in text
    t, _, _, w, *accel = imu_columns()
    apart = [t, accel[0], accel[1], accel[2], t * 0 + 20.0, w, w, w]
    names = "t acc_x acc_y acc_z temp spin1 spin2 spin3"
    text = draft_declaration([write(tmp_path / "i.csv", names, apart)])
    assert tomllib.loads(text)["imu"]["gyro"] == BLANK
    assert "spin1, spin2, spin3" in text and "nan" not in text


def test_what_cannot_be_drafted(tmp_path):
    with pytest.raises(DataError, match="expected files, found a folder"):
        draft_declaration([tmp_path])
    with pytest.raises(DataError, match="no files named"):
        draft_declaration([])
    with pytest.raises(DataError, match="file not found"):
        draft_declaration([tmp_path / "none.csv"])
    t = np.arange(100.0)
    file = write(tmp_path / "x.csv", "t temperature", [t, t * 0 + 20])
    with pytest.raises(DataError, match="neither inertial data"):
        draft_declaration([file])


def test_two_files_of_one_kind_say_which_is_drafted(tmp_path):
    a, b = (write(tmp_path / f"{n}.csv", IMU, imu_columns()) for n in "ab")
    text = draft_declaration([a, b])
    assert tomllib.loads(text)["imu"]["file"] == "a.csv"
    assert "# b.csv looks like [imu] too" in text


def test_a_draft_is_never_taken_as_it_is(tmp_path):
    write(tmp_path / "imu.csv", IMU, imu_columns())
    (tmp_path / "sequence.toml").write_text(draft_declaration([tmp_path / "imu.csv"]))
    with pytest.raises(NavError, match=r"sequence\.toml:\d+: .* is still '\?'"):
        read_declared(tmp_path)


def test_links_are_named_as_they_lie(tmp_path):
    """The draft goes beside the links, wherever what they point to lies, and under its name."""
    store, home = tmp_path / "store", tmp_path / "drive"
    store.mkdir()
    home.mkdir()
    (store / "raw_0815.csv").write_text("t,speed\n0,1\n1,2\n2,3\n")
    (home / "wheels.csv").symlink_to(store / "raw_0815.csv")
    linked = tmp_path / "linked"
    linked.symlink_to(home)
    for folder in (home, linked):
        assert 'file = "wheels.csv"' in draft_declaration([folder / "wheels.csv"])


@pytest.mark.parametrize(
    ("content", "format_"),
    [
        (b"\xef\xbb\xbf$GPGGA,120000,,,,,0,,,,,,,,\r\n", "nmea"),
        (b"[12:00] boot\n $GNRMC,120000,V,,,,,,,,,,N\r\n", "nmea"),
        (b"\xb5b\x01\x07\x5c\x00" + bytes(92), "ubx"),
    ],
)
def test_receiver_logs_are_told_by_their_messages(tmp_path, content, format_):
    (tmp_path / "log").write_bytes(content)
    assert f'format = "{format_}"' in draft_declaration([tmp_path / "log"])


def test_a_pressure_in_microbar_is_no_ubx(tmp_path):
    (tmp_path / "a.csv").write_bytes("t,speed,p [µbar]\n0,1,2\n1,2,3\n2,3,4\n".encode())
    assert 'speed = "speed"' in draft_declaration([tmp_path / "a.csv"])
