"""Own data by declaration: complete or refused, and the same answer as a reader written for it."""

from __future__ import annotations

import dataclasses
import gzip
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from certnav.datasets import gpstime
from certnav.datasets.displacement import check_velocity
from certnav.datasets.formats.oakville import read_oakville
from certnav.datasets.loading import load, recognise
from certnav.datasets.own.reader import read_declared
from certnav.datasets.text.imu import rates_from_increments
from certnav.filters.earth import C_en_at, ecef_to_lla
from certnav.filters.errors import ConfigError, DataError, NavError
from certnav.filters.rotation import matrix_from_rpy, rpy_from_matrix
from oracles.bends import bends
from oracles.declarations import PLAIN, changed

SOW, WEEK, HZ = 180000.0, 2129, 50.0

RFU = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # its own inverse


@pytest.fixture
def drive(tmp_path):
    """A folder with a sound declaration, and the motion behind it."""
    m = bends(SOW, HZ, 60.0)
    imu = np.column_stack([m.time, np.degrees(m.gyro_b @ RFU), m.accel_b @ RFU])
    write(tmp_path / "imu.csv", "t gx gy gz ax ay az", imu)
    k = slice(None, None, int(HZ))
    lla = ecef_to_lla(m.pos_e[k])
    n = len(lla)
    sigma = np.tile([1.0, 2.0, 3.0], (n, 1))
    gnss = np.column_stack([m.time[k], np.degrees(lla[:, :2]), lla[:, 2], m.vel_n[k], sigma])
    write(tmp_path / "gnss.csv", "t lat lon h vn ve vd sn se su", gnss)
    angles = np.column_stack([np.zeros((n, 2)), np.degrees(m.heading[k])])
    write(tmp_path / "ref.csv", "t x y z roll pitch yaw", np.column_stack(
        [m.time[k], m.pos_e[k], angles]))  # fmt: skip
    (tmp_path / "sequence.toml").write_text(PLAIN)
    return tmp_path, m


def write(file: Path, names: str, table: np.ndarray) -> None:
    pd.DataFrame(table, columns=names.split()).to_csv(file, index=False)


def change(folder: Path, *pairs: tuple[str, str]) -> Path:
    file = folder / "sequence.toml"
    file.write_text(changed(file.read_text(), *pairs))
    return folder


def test_a_sound_declaration_becomes_the_motion(drive):
    folder, m = drive
    s = load(folder)
    assert s.name == "drive"
    assert s.imu is not None and s.fixes is not None and s.reference is not None
    np.testing.assert_allclose(s.imu.time, WEEK * 604800.0 + m.time, rtol=0, atol=1e-6)
    np.testing.assert_allclose(s.imu.gyro_b, m.gyro_b, atol=1e-12)
    np.testing.assert_allclose(s.imu.accel_b, m.accel_b, atol=1e-12)
    k = slice(None, None, int(HZ))
    np.testing.assert_allclose(s.fixes.pos_e, m.pos_e[k], atol=1e-5)
    C_en = C_en_at(*ecef_to_lla(m.pos_e[0])[:2])
    np.testing.assert_allclose(
        C_en.T @ s.fixes.pos_cov_e[0] @ C_en, np.diag([1.0, 4.0, 9.0]), atol=1e-9
    )
    np.testing.assert_allclose(s.fixes.vel_cov_e[5], 0.01 * np.eye(3), atol=1e-12)
    np.testing.assert_allclose(s.reference.rpy[:, 2], m.heading[k], atol=1e-12)
    np.testing.assert_array_equal(s.reference.lever_b, [0.1, 0.2, -1.0])
    np.testing.assert_array_equal(s.calibration.lever_antenna_b, [0.1, 0.2, -1.0])
    assert s.calibration.imu.name == "consumer"
    assert sum("verified" in note for note in s.notes) == 2


def test_a_declaration_wins_and_can_be_named_itself(drive):
    folder, _ = drive
    (folder / "RXM-RAWX.csv").write_text("")
    assert recognise(folder) == "declared"
    file = (folder / "sequence.toml").rename(folder / "other.toml")
    assert load(file).name == "drive"


NEEDED = [
    line.split(" =")[0]
    for line in PLAIN.splitlines()
    if " = " in line and not line.startswith(("name", "attitude =", "velocity ="))
]


@pytest.mark.parametrize("number", range(len(NEEDED)))
def test_every_needed_line_is_asked_for_by_the_line_to_add(drive, number):
    """Delete one line: the error prints one with that key, and adding it heals this error."""
    folder, _ = drive
    lines = PLAIN.splitlines()
    places = [
        k for k, line in enumerate(lines)
        if " = " in line and not line.startswith(("name", "attitude =", "velocity ="))
    ]  # fmt: skip
    removed = lines.pop(places[number])
    key = removed.split(" =")[0]
    (folder / "sequence.toml").write_text("\n".join(lines))
    with pytest.raises(ConfigError) as caught:
        read_declared(folder)
    message = str(caught.value)
    assert "\n" not in message
    found = re.search(r"add under \[([a-z.]+)\]: (\S+) = (.*)$", message)
    assert found, message
    if not key.startswith(("position_sigma", "velocity_sigma", "preset")):
        assert found[2] == key
    section = lines.index(f"[{found[1]}]")
    lines.insert(section + 1, f"{found[2]} = {found[3].replace('…', '1.0')}")
    (folder / "sequence.toml").write_text("\n".join(lines))
    try:
        read_declared(folder)
    except NavError as error:
        assert f"{key} is not declared" not in str(error)


@pytest.mark.parametrize("section", ["imu.noise", "antenna", "vehicle"])
def test_a_missing_section_is_named(drive, section):
    folder, _ = drive
    text = re.sub(rf"\[{section}\]\n(.+\n)+", "", PLAIN)
    (folder / "sequence.toml").write_text(text)
    with pytest.raises(ConfigError, match=rf"\[{section}\] is not declared — add: \[{section}\]"):
        read_declared(folder)


def test_no_gnss_at_all(drive):
    folder, _ = drive
    (folder / "sequence.toml").write_text(re.sub(r"\[gnss\]\n(.+\n)+", "", PLAIN))
    with pytest.raises(ConfigError, match=r"add \[gnss\].*or \[rinex\]"):
        read_declared(folder)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "gyro_unit",
            "gyro_units",
            r"\[imu\]: unknown key 'gyro_units' — did you mean 'gyro_unit'",
        ),
        ("[antenna]", "[antena]", r"unknown key 'antena' — did you mean 'antenna'"),
        ('preset = "consumer"', 'preset = "consumr"', "did you mean 'consumer'"),
        ('preset = "consumer"', "gyro_awr = 1", r"\[imu.noise\]: unknown key 'gyro_awr'"),
        ('"deg/s"', '"dps"', r'gyro_unit: expected one of "rad/s", "deg/s", "deg/h"'),
        ('"gps-sow"', '"gps-time"', r'\[time\] scale: expected one of "gps"'),
        ("[0.1, 0.2, -1.0]", "[100, 200, -1000]", "metres on a road vehicle"),
        ("[0.1, 0.2, -1.0]", "[0.1, 0.2]", r"lever_frd_m: expected 3 number"),
        ('"RFU"', '"RFD"', "left-handed"),
        ('["gx", "gy", "gz"]', '["gx", "gy", "wz"]', r"no column 'wz' — did you mean 'gz'"),
        ('["gx", "gy", "gz"]', '["gx", "gy"]', "expected 3 column name"),
        ('"imu.csv"', '"IMU_1.csv"', "file not found"),
        ("week = 2129", "week = 2129.5", "a GPS week number"),
        ('point = "antenna"', 'point = "camera"', r"add under \[reference\]: lever_frd_m"),
        ('point = "antenna"', 'point = "vehicle"', r"add under \[vehicle\]: wheels_frd_m"),
        ('height = "ellipsoid"', 'height = "geoid"', r"add under \[gnss\]: geoid_m"),
        ('"deg/s"', '"?"', r"sequence\.toml:12: \[imu\] gyro_unit is still '\?'"),
        ('time = "t"', 'time = ["t", "?"]', r"sequence\.toml:9: \[imu\] time is still '\?'"),
        ("[time]", "time = 3\n[tim]", "unknown key 'tim'|expected a table"),
        ("scale =", "scale", "not readable as TOML"),
    ],
)
def test_mistakes_in_the_declaration_are_one_line(drive, old, new, message):
    folder, _ = drive
    change(folder, (old, new))
    with pytest.raises(NavError, match=message) as caught:
        read_declared(folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"RFU"', '"FRD"', r"imu\.csv: accelerometer declared m/s2, FRD: expected up = −z"),
        ('"RFU"', '"DFR"', r"expected up = −z"),
        ('"deg/s"', '"rad/s"', r"declare gyro_unit='deg/s'"),
        ('"m/s2"', '"g"', "expected a mean of 9.8 m/s², found 96"),
        ('velocity_frame = "ned"', 'velocity_frame = "enu"', r"gnss\.csv: velocity declared enu"),
        ('["vn", "ve", "vd"]', '["ve", "vn", "vd"]', "east before north"),
        ('velocity_unit = "m/s"', 'velocity_unit = "km/h"', 'is in m/s: velocity_unit = "m/s"'),
        ('["vn", "ve", "vd"]', '["ve", "vd", "vn"]', "check columns, velocity_frame"),
        ('["lat", "lon", "h"]', '["lon", "lat", "h"]', r"gnss\.csv:2: latitude, longitude"),
        ('"ecef"', '"lla"\nangle_unit = "deg"\nheight="ellipsoid"', r"ref\.csv:2: latitude"),
        ('position_frame = "lla"', 'position_frame = "ecef"', r"gnss\.csv:2: ECEF position"),
    ],
)  # fmt: skip
def test_physics_contradicts_a_wrong_declaration(drive, old, new, message):
    folder, _ = drive
    change(folder, (old, new))
    with pytest.raises(DataError, match=message) as caught:
        read_declared(folder)
    assert "\n" not in str(caught.value)


def in_minutes_and_seconds(folder, wrong=""):
    """Write gnss.csv anew with its angles in degrees, minutes and seconds, and declare it so."""
    table = pd.read_csv(folder / "gnss.csv")
    for name in ("lat", "lon"):
        angle = table[name].abs()
        degree = np.floor(angle)
        minute = np.floor((angle - degree) * 60.0)
        table[f"{name}_s"] = ((angle - degree) * 60.0 - minute) * 60.0
        table[f"{name}_m"] = minute
        table[f"{name}_d"] = [
            f"{'-' * bool(v < 0)}{d:.0f}" for v, d in zip(table[name], degree, strict=True)
        ]
    if wrong:
        table.loc[3, wrong] = 61.0
    table.to_csv(folder / "gnss.csv", index=False)
    parts = [f"{name}_{part}" for name in ("lat", "lon") for part in "dms"]
    change(
        folder, ('["lat", "lon", "h"]', repr([*parts, "h"])),
        ('angle_unit = "deg"', 'angle_unit = "dms"'),
    )  # fmt: skip


def test_degrees_minutes_and_seconds(drive):
    folder, _ = drive
    before = read_declared(folder).fixes.pos_e
    in_minutes_and_seconds(folder)
    np.testing.assert_allclose(read_declared(folder).fixes.pos_e, before, atol=1e-6)


def test_minutes_beyond_sixty_are_refused(drive):
    folder, _ = drive
    in_minutes_and_seconds(folder, wrong="lon_m")
    with pytest.raises(DataError, match=r"gnss\.csv:5: minutes and seconds: expected 0 … 60"):
        read_declared(folder)


def test_degrees_alone_have_three_columns(drive):
    folder, _ = drive
    change(folder, ('angle_unit = "deg"', 'angle_unit = "dms"'))
    with pytest.raises(ConfigError, match="with 3 columns of position: expected seven"):
        read_declared(folder)


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6)])
def test_stamps_in_another_unit_are_named_by_the_speed(drive, unit, factor):
    """From no date on, their size does not tell: only displacements against velocities do."""
    folder, _ = drive
    fixes = read_declared(folder).fixes
    with pytest.raises(DataError, match=f'time_unit = "{unit}"'):
        check_velocity(
            factor * (fixes.time - fixes.time[0]), fixes.pos_e, fixes.vel_e,
            file=folder / "gnss.csv", declared="ned",
        )  # fmt: skip


def test_a_position_that_stands_still_is_not_taken_for_a_unit_of_time(drive):
    folder, _ = drive
    fixes = read_declared(folder).fixes
    with pytest.raises(DataError, match="check columns, velocity_frame"):
        check_velocity(
            fixes.time, np.tile(fixes.pos_e[0], (len(fixes), 1)), fixes.vel_e,
            file=folder / "gnss.csv", declared="ned",
        )  # fmt: skip


def test_axes_and_mounting_together_turn_the_imu(drive):
    """RFU in line with the car is FLU turned by 90°: same specific force in vehicle axes."""
    folder, m = drive
    change(folder, ('"RFU"', '"FLU"'), ("[0.0, 0.0, 0.0]", "[0.0, 0.0, 90.0]"))
    s = read_declared(folder)
    C_bv = s.calibration.C_bv
    np.testing.assert_allclose(s.inertial.accel_b @ C_bv, m.accel_b, atol=1e-12)
    np.testing.assert_allclose(C_bv.T, matrix_from_rpy([0.0, 0.0, np.pi / 2]), atol=1e-15)


def test_one_time_scale_per_file(drive):
    """IMU in Unix milliseconds, GNSS in UTC dates, reference in seconds of week."""
    folder, _ = drive
    plain = read_declared(folder)
    shift = WEEK * 604800.0 + 315964800.0 - 18.0
    imu = pd.read_csv(folder / "imu.csv")
    imu["t"] = np.round((imu["t"] + shift) * 1e3).astype(np.int64)
    imu.to_csv(folder / "imu.csv", index=False)
    gnss = pd.read_csv(folder / "gnss.csv")
    stamps = pd.to_datetime(gnss["t"] + shift, unit="s")
    gnss["t"] = stamps.dt.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    gnss.to_csv(folder / "gnss.csv.gz", index=False)
    change(
        folder,
        ('file = "imu.csv"', 'file = "imu.csv"\ntime_scale = "unix"\ntime_unit = "ms"'),
        ('file = "gnss.csv"', 'file = "gnss.csv.gz"\ntime_scale = "utc"'),
    )
    s = read_declared(folder)
    np.testing.assert_allclose(s.inertial.time, plain.inertial.time, rtol=0, atol=1e-6)
    np.testing.assert_allclose(s.fixes.time, plain.fixes.time, rtol=0, atol=1e-6)


def test_relative_time_beside_dates_is_refused(drive):
    folder, _ = drive
    change(folder, ('file = "imu.csv"', 'file = "imu.csv"\ntime_scale = "relative"'))
    with pytest.raises(ConfigError, match=r"time of \[imu\] is relative, that of \[gnss\]"):
        read_declared(folder)


def test_a_fixed_offset_is_added(drive):
    folder, _ = drive
    plain = read_declared(folder)
    change(folder, ('file = "gnss.csv"', 'file = "gnss.csv"\ntime_offset_s = -0.25'))
    np.testing.assert_allclose(read_declared(folder).fixes.time - plain.fixes.time, -0.25)


@pytest.mark.parametrize("kind", ["deg", "rad"])
def test_increments_are_the_rates_times_the_interval(drive, kind):
    folder, m = drive
    step = 1.0 / HZ
    scale = np.degrees(1.0) if kind == "deg" else 1.0
    table = np.column_stack(
        [m.time, m.gyro_b @ RFU * step * scale, m.accel_b @ RFU * step]
    )  # fmt: skip
    write(folder / "imu.csv", "t gx gy gz ax ay az", table)
    change(folder, ('"deg/s"', f'"{kind}"'), ('"m/s2"', '"m/s"'))
    s = read_declared(folder)
    # GPS time resolves 0.24 µs: the rate carries that, rate times interval is the increment
    interval = np.diff(s.inertial.time)[:, None]
    np.testing.assert_allclose(s.inertial.gyro_b[1:] * interval, m.gyro_b[1:] * step, atol=1e-15)
    np.testing.assert_allclose(s.inertial.accel_b[1:] * interval, m.accel_b[1:] * step, atol=1e-14)
    np.testing.assert_allclose(s.inertial.accel_b, m.accel_b, atol=2e-4)


def test_lost_increments_are_lost_and_not_stretched():
    """Three rows are missing: the row after the gap holds its own interval only."""
    time = np.array([0.0, 0.1, 0.2, 0.6, 0.7, 0.8])
    rate = rates_from_increments(time, np.full((6, 3), 0.1))
    np.testing.assert_allclose(rate, 1.0)


def test_instantaneous_samples_become_means(drive):
    folder, m = drive
    change(folder, ('axes = "RFU"', 'axes = "RFU"\nsamples = "instant"'))
    s = read_declared(folder)
    np.testing.assert_allclose(
        s.inertial.gyro_b[1:], 0.5 * (m.gyro_b[1:] + m.gyro_b[:-1]), atol=1e-12
    )


def test_height_above_the_geoid_is_raised_by_a_column_or_a_number(drive):
    folder, _ = drive
    plain = read_declared(folder)
    gnss = pd.read_csv(folder / "gnss.csv")
    gnss["h"] -= 12.5
    gnss["N"] = 12.5
    gnss.to_csv(folder / "gnss.csv", index=False)
    for declared in ("12.5", '"N"'):
        text = PLAIN.replace('height = "ellipsoid"', f'height = "geoid"\ngeoid_m = {declared}')
        (folder / "sequence.toml").write_text(text)
        np.testing.assert_allclose(read_declared(folder).fixes.pos_e, plain.fixes.pos_e, atol=1e-6)


def test_velocity_in_other_frames_and_units_is_the_same_velocity(drive):
    folder, _ = drive
    plain = read_declared(folder)
    gnss = pd.read_csv(folder / "gnss.csv")
    gnss["vu"] = -gnss["vd"]
    for name, value in zip(("kx", "ky", "kz"), plain.fixes.vel_e.T * 3.6, strict=True):
        gnss[name] = value
    gnss.to_csv(folder / "gnss.csv", index=False)
    for columns, frame, unit in (
        ('["ve", "vn", "vu"]', "enu", "m/s"),
        ('["kx", "ky", "kz"]', "ecef", "km/h"),
    ):
        text = PLAIN.replace('["vn", "ve", "vd"]', columns).replace('"ned"', f'"{frame}"', 1)
        text = text.replace('velocity_unit = "m/s"', f'velocity_unit = "{unit}"')
        (folder / "sequence.toml").write_text(text)
        np.testing.assert_allclose(read_declared(folder).fixes.vel_e, plain.fixes.vel_e, atol=1e-9)


def test_variances_and_missing_velocities(drive):
    folder, _ = drive
    gnss = pd.read_csv(folder / "gnss.csv")
    gnss[["sn", "se", "su"]] **= 2
    gnss.loc[3, ["vn", "ve", "vd"]] = np.nan
    gnss.to_csv(folder / "gnss.csv", index=False)
    plain = read_declared(change(folder, ("position_sigma =", "position_variance =")))
    assert np.trace(plain.fixes.pos_cov_e[0]) == pytest.approx(14.0)
    assert not plain.fixes.has_velocity[3]
    assert plain.fixes.has_velocity.sum() == len(plain.fixes) - 1
    gnss.loc[4, "sn"] = 0.0
    gnss.to_csv(folder / "gnss.csv", index=False)
    with pytest.raises(DataError, match=r"gnss\.csv:6: position deviation: expected > 0"):
        read_declared(folder)


def test_noise_from_the_datasheet_in_either_unit(drive):
    """0.01 deg/s/√Hz is 0.6 deg/√h; 100 µg/√Hz is 0.0588 m/s/√h."""
    folder, _ = drive
    rest = (
        "gyro_bias_instability_degph = 8\ngyro_bias_turn_on_degph = 500\n"
        "accel_bias_instability_mg = 0.1\naccel_bias_turn_on_mg = 10\n"
    )
    white = "gyro_noise_degps_sqrthz = 0.01\naccel_noise_ug_sqrthz = 100\n"
    change(folder, ('preset = "consumer"\n', rest + white))
    spec = read_declared(folder).calibration.imu
    assert spec.gyro_noise_density == pytest.approx(np.radians(0.01))
    assert spec.accel_noise_density == pytest.approx(100e-6 * 9.80665)
    change(folder, ("gyro_bias_turn_on_degph = 500\n", ""))
    with pytest.raises(ConfigError, match=r"add under \[imu.noise\]: gyro_bias_turn_on_degph"):
        read_declared(folder)
    change(folder, (white, white + 'preset = "tactical"\n'))
    spec = read_declared(folder).calibration.imu
    assert (spec.name, spec.gyro_bias_turn_on_degph) == ("tactical", 1.0)
    assert spec.gyro_arw_deg_sqrth == pytest.approx(0.6)


def test_odometer_in_kmh_with_left_positive_yaw(drive):
    folder, m = drive
    table = np.column_stack([m.time, np.full(m.time.size, 36.0), -np.degrees(m.gyro_b[:, 2])])
    write(folder / "odo.csv", "t v w", table)
    text = '\n[odometer]\nfile = "odo.csv"\ntime = "t"\nspeed = "v"\nspeed_unit = "km/h"\n'
    text += 'yaw_rate = "w"\nyaw_rate_unit = "deg/s"\nyaw_rate_axis = "up"\n'
    (folder / "sequence.toml").write_text(PLAIN + text)
    odometer = read_declared(folder).odometer
    np.testing.assert_allclose(odometer.speed, 10.0)
    np.testing.assert_allclose(odometer.yaw_rate, m.gyro_b[:, 2], atol=1e-12)


def test_reference_heading_alone_counter_clockwise_from_east(drive):
    folder, m = drive
    ref = pd.read_csv(folder / "ref.csv")
    ref["yaw"] = np.pi / 2 - np.radians(ref["yaw"])
    ref.to_csv(folder / "ref.csv", index=False)
    change(
        folder,
        ('["roll", "pitch", "yaw"]', '"yaw"'),
        ('attitude_unit = "deg"', 'attitude_unit = "rad"'),
        ("frd-ned", "flu-enu"),
    )
    rpy = read_declared(folder).reference.rpy
    assert np.isnan(rpy[:, :2]).all()
    np.testing.assert_allclose(rpy[:, 2], m.heading[:: int(HZ)], atol=1e-12)


def test_rtklib_solution_and_imu_in_g_with_back_right_up_axes(data_dir, tmp_path):
    """The RTK drive declared: the same samples and fixes as its own reader makes of it."""
    from certnav.datasets.formats.rtklibexplorer import read_rtklibexplorer, read_tag_start

    source = data_dir / "rtklibexplorer-drive"
    own = read_rtklibexplorer(source, imu_lag=0.0)
    start = read_tag_start(source / "imu_1934.csv.tag")
    clock = float((source / "imu_1934.csv").read_text().split("\n", 1)[0].split(",")[6]) * 1e-3
    mounting = np.degrees(rpy_from_matrix(own.calibration.C_bv.T)).tolist()
    (tmp_path / "sequence.toml").write_text(f"""
[imu]
file = "{source / "imu_1934.csv"}"
time = 7
time_scale = "gps"
time_unit = "ms"
time_offset_s = {start - clock!r}
gyro = [4, 5, 6]
accel = [1, 2, 3]
gyro_unit = "deg/s"
accel_unit = "g"
axes = "back-right-up"
noise = {{preset = "consumer"}}
[antenna]
lever_frd_m = {own.calibration.lever_antenna_b.tolist()}
[vehicle]
mounting_rpy_deg = {mounting}
[gnss]
file = "{source / "gnss_1934_sf.pos"}"
format = "rtklib"
""")
    s = read_declared(tmp_path)
    np.testing.assert_allclose(s.inertial.time, own.inertial.time, rtol=0, atol=1e-6)
    np.testing.assert_allclose(s.inertial.gyro_b, own.inertial.gyro_b, atol=1e-12)
    np.testing.assert_allclose(s.inertial.accel_b, own.inertial.accel_b, atol=1e-12)
    np.testing.assert_array_equal(s.fixes.pos_e, own.fixes.pos_e)
    assert s.time_scale == "gps"


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    from certnav.datasets.great.writer import simulate_folder
    from certnav.datasets.simulation.simulator import SimulationConfig

    home = tmp_path_factory.mktemp("simulated")
    return simulate_folder(SimulationConfig(name="s", seed=1, duration=90.0), home / "s")


def declare_simulated(folder: Path, to: Path) -> Path:
    """Write a declaration for the simulator's files, RINEX gzipped."""
    for name, file in (("o.gz", "GNSS/Rover/SEPT3010.20O"), ("n.gz", "")):
        source = folder / file if file else next((folder / "GNSS" / "Product").iterdir())
        (to / name).write_bytes(gzip.compress(source.read_bytes()))
    (to / "sequence.toml").write_text(f"""
[time]
scale = "gps-sow"
week = 2129
[imu]
file = "{folder / "IMU" / "MEMS_imu_data.txt"}"
time = 1
gyro = [2, 3, 4]
accel = [5, 6, 7]
gyro_unit = "deg/s"
accel_unit = "m/s2"
axes = "RFU"
[imu.noise]
preset = "adis16470"
[antenna]
lever_frd_m = [-0.65, -0.05, -0.15]
[vehicle]
mounting_rpy_deg = [0.0, 0.0, 0.0]
[rinex]
observations = "o.gz"
navigation = "n.gz"
[reference]
file = "{folder / "Groundtruth" / "groundtruth.txt"}"
format = "inertial-explorer"
point = "imu"
attitude_of = "vehicle"
source = "simulated"
""")
    return to


def test_rinex_and_inertial_explorer_by_declaration(simulated, tmp_path):
    own = load(simulated)
    s = read_declared(declare_simulated(simulated, tmp_path))
    np.testing.assert_array_equal(s.observations.range_rate, own.observations.range_rate)
    np.testing.assert_array_equal(s.reference.pos_e, own.reference.pos_e)
    np.testing.assert_allclose(s.inertial.gyro_b, own.inertial.gyro_b, atol=1e-15)
    assert s.reference.attitude_frame == "v"
    assert s.fixes is None


def test_relative_time_cannot_go_with_rinex(simulated, tmp_path):
    change(declare_simulated(simulated, tmp_path), ('"gps-sow"\nweek = 2129', '"relative"'))
    with pytest.raises(ConfigError, match=r"\[imu\] is relative, that of .*\[rinex\] has a date"):
        read_declared(tmp_path)


def test_a_wrong_week_has_no_overlap(simulated, tmp_path):
    change(declare_simulated(simulated, tmp_path), ("week = 2129", "week = 2130"))
    with pytest.raises(DataError, match=r"no time overlap.*check GPS week"):
        read_declared(tmp_path)


# --- the same recording through its own reader and through a declaration -----------------------

ANONYMOUS = """\
[time]
scale = "unix"

[imu]
file = "a.csv"
time = 1
gyro = [2, 3, 4]
accel = [5, 6, 7]
gyro_unit = "deg/s"
accel_unit = "m/s2"
axes = "RFU"

[imu.noise]
preset = "consumer"

[antenna]
lever_frd_m = [0.0, 0.0, 0.0]
lever_sigma_m = 0.5

[vehicle]
mounting_rpy_deg = {mounting}

[gnss]
file = "b.csv.gz"
time = 1
position = [2, 3, 4]
position_frame = "lla"
angle_unit = "deg"
height = "ellipsoid"
velocity = [5, 6, 7]
velocity_frame = "ned"
velocity_unit = "m/s"
position_sigma = [8, 9, 10]
velocity_sigma = [11, 12, 13]
"""
START = 1_700_000_000  # Unix time of the drive's zero


def anonymous(source: Path, to: Path, mounting: list[float]) -> Path:
    """Write an Oakville drive as bare numbers: RFU axes, deg/s, Unix time."""

    def stamps(seconds: pd.Series) -> list[str]:
        return [repr(START + t) for t in seconds.to_list()]

    imu, gnss = (pd.read_csv(source / f"{n}.csv.gz") for n in ("imu", "gnss"))
    rfu_flu = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    gyro = np.degrees(imu[["gx_radps", "gy_radps", "gz_radps"]].to_numpy() @ rfu_flu.T)
    accel = imu[["ax_mps2", "ay_mps2", "az_mps2"]].to_numpy() @ rfu_flu.T
    rows = pd.DataFrame(np.column_stack([gyro, accel]))
    rows.insert(0, "t", stamps(imu["t_s"]))
    rows.to_csv(to / "a.csv", header=False, index=False)
    gnss["t_s"] = stamps(gnss["t_s"])
    gnss.drop(columns="heading_rad").to_csv(to / "b.csv.gz", header=False, index=False)
    (to / "sequence.toml").write_text(ANONYMOUS.format(mounting=mounting))
    return to


def dated(sequence, start: float):
    """The sequence with its relative times counted from `start`."""
    parts = {
        name: dataclasses.replace(record, time=record.time + start)
        for name in ("imu", "fixes", "reference")
        if (record := getattr(sequence, name)) is not None
    }
    return dataclasses.replace(sequence, time_scale="gps", **parts)


@pytest.mark.parametrize(
    "name", ["urban-medium-turn-loop-nominal-001", "parking-lot-figure8-nominal-001"]
)
def test_an_oakville_drive_by_declaration_alone(data_dir, tmp_path, name):
    """Same solution to 1e-6 m as through its own reader, at the same date.

    The drive has no date; the declaration gives it one, and GPS seconds resolve 0.24 µs there.
    The undated run therefore differs by that times the speed, some µm, and no more.
    """
    from certnav.nav.config import Config, FilterConfig
    from certnav.nav.pipeline import navigate

    source = data_dir / "oakville-drives" / name
    own = read_oakville(source)
    mounting = np.degrees(rpy_from_matrix(own.calibration.C_bv.T)).tolist()
    declared = load(anonymous(source, tmp_path, mounting))
    assert declared.notes[0] == "read as declared, recognised by sequence.toml"
    start = float(gpstime.from_unix(START))
    own = dated(own, start)
    np.testing.assert_array_equal(declared.inertial.time, own.inertial.time)
    np.testing.assert_allclose(declared.inertial.gyro_b, own.inertial.gyro_b, atol=1e-15)

    config = Config(filter=FilterConfig(output_rate_hz=0.0))
    a, b = (navigate(s, config).trajectory for s in (own, declared))
    np.testing.assert_array_equal(a.time, b.time)
    assert np.linalg.norm(a.pos_e - b.pos_e, axis=1).max() < 1e-6
    assert np.abs(a.C_eb - b.C_eb).max() < 1e-9

    undated = navigate(read_oakville(source), config).trajectory
    shift = b.time - start - undated.time
    moved = undated.pos_e + undated.vel_e * shift[:, None]
    assert np.linalg.norm(moved - b.pos_e, axis=1).max() < 5e-5


def test_rounded_stamps_have_a_way_out(drive):
    folder, m = drive
    table = pd.read_csv(folder / "imu.csv")
    table["t"] = table["t"].round(1)
    table.to_csv(folder / "imu.csv", index=False)
    with pytest.raises(DataError, match=r"imu.csv:3: .*rounded by a spreadsheet\?.*rate_hz"):
        load(folder)
    change(folder, ('[imu]\nfile = "imu.csv"', '[imu]\nfile = "imu.csv"\nrate_hz = 50.0'))
    s = load(folder)
    np.testing.assert_allclose(s.imu.time, WEEK * 604800.0 + m.time, rtol=0, atol=0.021)
    assert any("imu.csv: rounded stamps replaced by 50 Hz, as declared" in n for n in s.notes)
    change(folder, ("rate_hz = 50.0", "rate_hz = -1"))
    with pytest.raises(ConfigError, match="rate_hz: expected rows a second, above zero"):
        load(folder)


def test_a_late_week_number_is_mended_and_said(drive):
    folder, m = drive
    shift = 604800.0 - SOW - 30.0  # the week ends after half a minute
    change(folder, ('[time]\nscale = "gps-sow"\nweek = 2129', '[time]\nscale = "gps-week-sow"'),
           ('time = "t"', 'time = ["week", "t"]'))  # fmt: skip
    for name in ("imu", "gnss", "ref"):
        table = pd.read_csv(folder / f"{name}.csv")
        time = table["t"] + shift
        late = 0.21 if name == "imu" else 0.0
        table["t"], table["week"] = time % 604800.0, WEEK + (time >= 604800.0 + late)
        table.to_csv(folder / f"{name}.csv", index=False)
    s = load(folder)
    np.testing.assert_allclose(s.imu.time, WEEK * 604800.0 + m.time + shift, rtol=0, atol=1e-6)
    assert any("imu.csv: the week number of 11 rows from line 15" in n for n in s.notes), s.notes


@pytest.mark.parametrize(("lines", "degrees", "metres"), [
    ("", 5.0, 2.0),
    ("wheels_frd_m = [-0.5, 0.0, 1.4]", 5.0, 0.1),
    ("wheels_frd_m = [-0.5, 0.0, 1.4]\nwheels_sigma_m = 0.0\nmounting_sigma_deg = 0", 0.0, 0.0),
    ("mounting_sigma_deg = 0.5\nwheels_sigma_m = 1.0", 0.5, 1.0),
])  # fmt: skip
def test_the_mounting_is_known_as_well_as_it_is_declared(drive, lines, degrees, metres):
    mounted = "mounting_rpy_deg = [0.0, 0.0, 0.0]\n"
    calibration = load(change(drive[0], (mounted, mounted + lines + "\n"))).calibration
    assert calibration.mounting_source == "declared in sequence.toml"
    assert calibration.mounting_sigma == pytest.approx(np.radians(degrees))
    assert calibration.lever_vehicle_sigma == metres


def test_a_negative_sigma_is_refused(drive):
    mounted = "mounting_rpy_deg = [0.0, 0.0, 0.0]\n"
    wrong = change(drive[0], (mounted, mounted + "mounting_sigma_deg = -1.0\n"))
    with pytest.raises(ConfigError, match="mounting_sigma_deg"):
        load(wrong)
