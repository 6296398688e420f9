"""GREAT folders, hand-made: both layouts, and every trap their files are known for."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from certnav.datasets import gpstime
from certnav.datasets.great.files import first_observation, is_great, rinex_kind
from certnav.datasets.great.options import GreatOptions
from certnav.datasets.great.reader import read_great
from certnav.datasets.observations import GnssFixes, GnssObservations
from certnav.filters.earth import C_en_at, ecef_to_lla, lla_to_ecef
from certnav.filters.errors import ConfigError, DataError

LAT, LON = np.radians(30.53), np.radians(114.36)
NAMES = (
    "%Week GPSTime X-ECEF Y-ECEF Z-ECEF Latitude Longitude H-Ell VX-ECEF VY-ECEF VZ-ECEF "
    "Cx11 Cx22 Cx33 Vel-Cx11 Vel-Cx22 Vel-Cx33 Heading Pitch Roll AmbStatus"
)
UNITS = (
    "%(weeks) (sec) (m) (m) (m) (+/-D M S) (+/-D M S) (m) (m/s) (m/s) (m/s) (m^2) (m^2) (m^2) "
    "(m^2/s^2) (m^2/s^2) (m^2/s^2) (deg) (deg) (deg) ()"
)


def dms(angle: float) -> str:
    degree, rest = divmod(abs(np.degrees(angle)), 1.0)
    minute, rest = divmod(rest * 60.0, 1.0)
    return f"{'-' if angle < 0 else ''}{degree:.0f} {minute:.0f} {rest * 60.0:.6f}"


def motion(rate: float):
    """Return time from the start, heading, yaw rate, velocity and position (NED) at 50 Hz."""
    t = np.arange(0.0, 60.0, 0.02)
    heading = rate * 3.0 * np.sin(t / 3.0)
    vel_n = 10.0 * np.column_stack([np.cos(heading), np.sin(heading), 0.0 * t])
    return t, heading, rate * np.cos(t / 3.0), vel_n, np.cumsum(vel_n, axis=0) * 0.02


def write_drive(
    folder: Path,
    *,
    week: int = 2129,
    sow: float = 180590.0,
    gyro_unit: str = "deg/s",
    rate: float = 0.4,
    imu_name: str = "IMU/MEMS_imu_data.txt",
    truth_name: str = "Groundtruth/groundtruth.txt",
    rover_name: str = "GNSS/Rover/SEPT3010.20O",
    nav_name: str = "GNSS/Product/BRDM00DLR_S.rnx",
) -> Path:
    """Write a minute at 10 m/s through bends with a yaw rate of up to `rate` [rad/s]."""
    t, heading, yaw_rate, vel_n, pos_n = motion(rate)
    scale = {"deg/s": 180.0 / np.pi, "rad/s": 1.0}[gyro_unit]
    imu = np.zeros((t.size, 7))  # sow, gyro and specific force in right-forward-up
    imu[:, 0] = sow + t
    imu[:, 3] = -yaw_rate * scale
    imu[:, 4] = 10.0 * yaw_rate
    imu[:, 6] = 9.79
    path = folder / imu_name
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, imu, fmt=["%.5f", *6 * ["%.10f"]])

    if truth_name:
        path = folder / truth_name
        path.parent.mkdir(parents=True, exist_ok=True)
        C_en = C_en_at(LAT, LON)
        lines = [NAMES, UNITS]
        for k in range(0, t.size, 5):
            pos_e = lla_to_ecef(LAT, LON, 25.0) + C_en @ pos_n[k]
            vel_e = C_en @ vel_n[k]
            lat, lon, height = ecef_to_lla(pos_e)
            numbers = " ".join(f"{v:.4f}" for v in pos_e)
            velocity = " ".join(f"{v:.5f}" for v in vel_e)
            lines.append(
                f"{week} {sow + t[k]:.2f} {numbers} {dms(lat)} {dms(lon)} {height:.4f} {velocity} "
                f"0 0 0 0 0 0 {np.degrees(heading[k]) % 360:.6f} 0.0 0.0 Fixed"
            )
        path.write_text("\n".join(lines) + "\n")
    if rover_name:
        write_rinex(folder / rover_name, "O", gpstime.from_week_sow(week, sow - 30.0))
    if nav_name:
        write_rinex(folder / nav_name, "N")
    return folder


def write_rinex(path: Path, kind: str, first: float | None = None) -> Path:
    """Write a RINEX header as the 2020 rover files have it: no APPROX POSITION."""
    title = {"O": "OBSERVATION DATA", "N": "NAVIGATION DATA"}[kind]
    lines = [f"{'3.02':>9}{'':11}{title:<20}{'M':<20}RINEX VERSION / TYPE"]
    if first is not None:
        t = gpstime.to_calendar(float(first))
        stamp = f"{t.year:6d}{t.month:6d}{t.day:6d}{t.hour:6d}{t.minute:6d}{t.second:13.7f}"
        lines.append(f"{stamp}     GPS         TIME OF FIRST OBS")
    lines.append(f"{'':60}END OF HEADER")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture(autouse=True)
def observations(monkeypatch):
    """Stand in for RTKLIB: one row a second in the IMU's span; records what it is asked for."""
    asked: list[tuple] = []

    def read(path, navigation, **options):
        asked.append((Path(path), tuple(navigation), options))
        time = first_observation(Path(path)) + 30.0 + np.arange(60.0)
        n = time.size
        one, three = np.zeros(n), np.zeros((n, 3))
        return GnssObservations(
            time, np.full(n, "G01"), np.full(n, "1C"), one + 0.19, one, one, one, one,
            np.zeros(n, int), three, three, one, one, one, one, np.full(n, ""),
        )  # fmt: skip

    def single_point(observed, navigation, **options):
        t, _, _, _, pos_n = motion(0.4)
        at = np.unique(observed.time)
        here = np.column_stack([np.interp(at - at[0], t, pos_n[:, k]) for k in range(3)])
        pos_e = lla_to_ecef(LAT, LON, 25.0) + here @ C_en_at(LAT, LON).T
        nothing = np.full((at.size, 3), np.nan)
        cov = np.tile(np.eye(3), (at.size, 1, 1))
        fixes = GnssFixes(
            at, pos_e, cov, nothing, np.nan * cov, np.full(at.size, 8), np.full(at.size, "single")
        )
        return SimpleNamespace(fixes=fixes)

    monkeypatch.setattr("certnav.datasets.rtklib.read_observations", read)
    monkeypatch.setattr("certnav.datasets.rtklib.single_point", single_point)
    return asked


DECLARED = {"lever": "figure", "reference_point": "imu"}


def test_dataset_layout_is_read_into_forward_right_down_si_and_gps_time(tmp_path, observations):
    drive = read_great(write_drive(tmp_path / "Dataset_campus-01"), GreatOptions(**DECLARED))
    assert drive.name == "Dataset_campus-01"
    assert drive.imu.time[0] == 2129 * 604800.0 + 180590.0
    yaw_rate = 0.4 * np.cos((drive.imu.time - drive.imu.time[0]) / 3.0)
    np.testing.assert_allclose(drive.imu.gyro_b[:, 2], yaw_rate, atol=1e-7)
    np.testing.assert_array_equal(drive.imu.gyro_b[:, :2], 0.0)
    np.testing.assert_allclose(drive.imu.accel_b[:, 1], 10.0 * yaw_rate, atol=1e-6)
    np.testing.assert_allclose(drive.imu.accel_b[:, 2], -9.79)
    np.testing.assert_allclose(drive.calibration.lever_antenna_b, [-0.65, -0.05, -0.15])
    assert drive.calibration.imu.name == "adis16470"
    assert drive.reference.point == "imu"
    assert any("gyro unit deg/s" in note and "1.00" in note for note in drive.notes)
    path, navigation, _ = observations[0]
    assert (path.name, [n.name for n in navigation]) == ("SEPT3010.20O", ["BRDM00DLR_S.rnx"])


@pytest.mark.parametrize("truth", ["groundtruth", "groudtruth", "ref", "GROUNDTRUTH"])
@pytest.mark.parametrize("rover", ["gnss/rover/campus-day.20o", "GNSS/Rover/SEPT.obs"])
def test_msf_sample_layout_in_any_case_and_the_base_is_no_rover(
    tmp_path, observations, truth, rover
):
    folder = write_drive(
        tmp_path / "MSF_20201027",
        imu_name="imu/campus-01-MEMS.TXT",
        truth_name=f"{truth}/campus01-groundtruth.txt",
        rover_name=rover,
        nav_name="GNSS/product/brdm3010.20P",
    )
    write_rinex(folder / "GNSS/Base/R2933010.20o", "O", 2129 * 604800.0 + 180000.0)
    (folder / "xml").mkdir()
    assert is_great(folder)
    read_great(folder, GreatOptions(lever="msf_xml", reference_point="imu"))
    assert observations[0][0] == folder / rover


def test_gnss_raw_data_beside_the_sequence_is_searched_and_the_day_chosen(tmp_path, observations):
    folder = write_drive(tmp_path / "Dataset_campus-01", rover_name="", nav_name="")
    archive = tmp_path / "GNSS_RAW_DATA"
    right = write_rinex(archive / "rover/1027.20O", "O", 2129 * 604800.0 + 180560.0)
    write_rinex(archive / "rover/1029.20O", "O", 2129 * 604800.0 + 367000.0)
    write_rinex(archive / "nav/brdc3010.20n", "N")
    read_great(folder, GreatOptions(**DECLARED))
    assert observations[0][0] == right
    write_rinex(archive / "rover/1027b.20O", "O", 2129 * 604800.0 + 180500.0)
    with pytest.raises(ConfigError, match=r"several rover files .*1027\.20O, 1027b\.20O.*rinex="):
        read_great(folder, GreatOptions(**DECLARED))
    read_great(folder, GreatOptions(**DECLARED, rinex=right))
    assert observations[-1][0] == right


def test_rinex_is_told_by_content_not_by_name(tmp_path):
    assert rinex_kind(write_rinex(tmp_path / "brdm2860.21p", "N")) == "N"
    assert rinex_kind(write_rinex(tmp_path / "x.rnx", "O")) == "O"
    (tmp_path / "rover.20O").write_text("1.0                 COMPACT RINEX FORMAT\n")
    assert rinex_kind(tmp_path / "rover.20O") == ""
    (tmp_path / "junk.20O").write_bytes(b"\x00\xff\n")
    assert rinex_kind(tmp_path / "junk.20O") == ""


# ---- week -------------------------------------------------------------------------------------


def test_urban_02_is_week_2233_from_reference_and_rinex(tmp_path):
    folder = write_drive(tmp_path / "Dataset_urban-02", week=2233, sow=20000.0)
    drive = read_great(folder, GreatOptions(lever=(-1.0, 0.0, -0.5), reference_point="imu"))
    assert drive.imu.time[0] == 2233 * 604800.0 + 20000.0


def test_the_hard_coded_week_2129_is_refused_for_urban_02(tmp_path):
    folder = write_drive(tmp_path / "Dataset_urban-02", week=2233, sow=20000.0)
    with pytest.raises(
        DataError, match=r"GPS week 2129 \(declared\) and 2233 \(.*groundtruth"
    ) as e:
        read_great(folder, GreatOptions(lever=(-1.0, 0.0, -0.5), reference_point="imu", week=2129))
    assert "\n" not in str(e.value)


def test_reference_and_rinex_of_different_weeks_are_refused(tmp_path):
    folder = write_drive(tmp_path / "d", week=2233)
    write_rinex(folder / "GNSS/Rover/SEPT3010.20O", "O", 2129 * 604800.0 + 180560.0)
    with pytest.raises(DataError, match=r"week 2233 .*groundtruth\.txt:3.* and 2129 .*SEPT3010"):
        read_great(folder, GreatOptions(lever=(0, 0, 0), reference_point="imu"))


def test_rover_file_that_begins_before_the_week_does(tmp_path):
    folder = write_drive(tmp_path / "d", week=2233, sow=10.0)  # RINEX begins at −20 s
    drive = read_great(folder, GreatOptions(lever=(0, 0, 0), reference_point="imu"))
    assert drive.imu.time[0] == 2233 * 604800.0 + 10.0


def test_week_from_rinex_alone(tmp_path):
    folder = write_drive(tmp_path / "d", truth_name="")
    drive = read_great(folder, GreatOptions(lever="figure"))
    assert drive.reference is None
    assert any("gyro unit deg/s" in note for note in drive.notes)  # course of single points
    assert drive.imu.time[0] == 2129 * 604800.0 + 180590.0
    assert any("no reference" in note for note in drive.notes)


# ---- units ------------------------------------------------------------------------------------


def test_radians_are_found_by_physics_and_said(tmp_path):
    drive = read_great(write_drive(tmp_path / "d", gyro_unit="rad/s"), GreatOptions(**DECLARED))
    yaw_rate = 0.4 * np.cos((drive.imu.time - drive.imu.time[0]) / 3.0)
    np.testing.assert_allclose(drive.imu.gyro_b[:, 2], yaw_rate, atol=1e-7)
    assert any("gyro unit rad/s: integrated yaw rate" in note for note in drive.notes)


def test_a_straight_drive_cannot_tell_and_asks(tmp_path):
    folder = write_drive(tmp_path / "d", rate=0.0)
    with pytest.raises(DataError, match=r"gyro unit cannot be told.*declare gyro_unit="):
        read_great(folder, GreatOptions(**DECLARED))
    drive = read_great(folder, GreatOptions(**DECLARED, gyro_unit="deg/s"))
    assert any("taken as declared" in note for note in drive.notes)


@pytest.mark.parametrize(("true", "declared"), [("deg/s", "rad/s"), ("rad/s", "deg/s")])
def test_a_declared_unit_that_contradicts_the_course_is_refused(tmp_path, true, declared):
    folder = write_drive(tmp_path / "d", gyro_unit=true)
    with pytest.raises(DataError, match=rf"MEMS_imu_data\.txt: .*the file is in {true}"):
        read_great(folder, GreatOptions(**DECLARED, gyro_unit=declared))


def test_a_file_in_other_axes_is_refused(tmp_path):
    folder = write_drive(tmp_path / "d")
    file = folder / "IMU/MEMS_imu_data.txt"
    frd = np.loadtxt(file)[:, [0, 2, 1, 3, 5, 4, 6]] * [1, 1, 1, -1, 1, 1, -1]
    np.savetxt(file, frd)
    with pytest.raises(DataError, match="wrong sign"):
        read_great(folder, GreatOptions(**DECLARED))
    with pytest.raises(DataError, match=r"found \+z"):
        read_great(folder, GreatOptions(**DECLARED, gyro_unit="deg/s"))


# ---- lever arm and reference point ------------------------------------------------------------


def test_no_lever_arm_no_default(tmp_path):
    with pytest.raises(ConfigError, match=r"'figure'.*'msf_xml'.*no default.*0\.24 m"):
        read_great(write_drive(tmp_path / "d"), GreatOptions(reference_point="imu"))


@pytest.mark.parametrize(
    ("imu", "lever", "expected"),
    [
        ("mems", "figure", (-0.65, -0.05, -0.15)),
        ("tactical", "figure", (-0.33, -0.05, -0.16)),
        ("mems", "msf_xml", (-0.41, -0.05, -0.15)),
        ("mems", (1.0, 2.0, -3.0), (1.0, 2.0, -3.0)),
    ],
)
def test_lever_presets_are_the_published_right_forward_up_vectors_turned(
    tmp_path, imu, lever, expected
):
    name = {"mems": "MEMS_imu_data.txt", "tactical": "Tactical_imu_data.txt"}[imu]
    folder = write_drive(tmp_path / "d", imu_name=f"IMU/{name}")
    drive = read_great(folder, GreatOptions(imu=imu, lever=lever, reference_point="antenna"))
    np.testing.assert_allclose(drive.calibration.lever_antenna_b, expected)
    np.testing.assert_allclose(drive.reference.lever_b, expected)  # the reference is the antenna


@pytest.mark.parametrize("week", [2233, 2179])
@pytest.mark.parametrize("preset", ["figure", "msf_xml"])
def test_presets_hold_for_the_2020_days_only(tmp_path, week, preset):
    folder = write_drive(tmp_path / "d", week=week)
    with pytest.raises(ConfigError, match=rf"2020-10-27/29 .*week {week}.*give lever="):
        read_great(folder, GreatOptions(lever=preset, reference_point="imu"))


def test_preset_without_a_value_for_the_tactical_imu(tmp_path):
    folder = write_drive(tmp_path / "d", imu_name="IMU/Tactical_imu_data.txt")
    with pytest.raises(ConfigError, match="tactical"):
        read_great(folder, GreatOptions(imu="tactical", lever="msf_xml", reference_point="imu"))


def test_reference_point_is_asked_for(tmp_path):
    with pytest.raises(ConfigError, match=r"reference_point not given.*does not say"):
        read_great(write_drive(tmp_path / "d"), GreatOptions(lever="figure"))


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ("imu", (0, 0, 0)),
        ("mems", (0, 0, 0)),
        ("tactical", (-0.32, 0, 0.01)),
        ((1, 0, 0), (1, 0, 0)),
    ],
)
def test_reference_points(tmp_path, point, expected):
    drive = read_great(
        write_drive(tmp_path / "d"), GreatOptions(lever="figure", reference_point=point)
    )
    np.testing.assert_allclose(drive.reference.lever_b, expected)


def test_levers_close_the_triangle_mems_tactical_antenna():
    """MEMS → antenna = MEMS → tactical + tactical → antenna, by the figure, to its 1 cm digits."""
    from certnav.datasets.great.installation import LEVERS, MEMS_TO_TACTICAL, WEEK_2020

    around = np.array(MEMS_TO_TACTICAL[WEEK_2020]) + LEVERS["figure", "tactical"][0]
    np.testing.assert_allclose(around, LEVERS["figure", "mems"][0], atol=1e-12)


def test_attitude_of_the_tactical_imu_is_not_that_of_the_mems(tmp_path):
    folder = write_drive(tmp_path / "d")
    drive = read_great(folder, GreatOptions(**DECLARED))
    assert drive.reference.attitude_frame == "v"
    assert any("misalignment" in note for note in drive.notes)
    assert (
        read_great(folder, GreatOptions(**DECLARED, reference_body="imu")).reference.attitude_frame
        == "b"
    )


def test_two_references_gnss_and_adis_are_chosen_by_the_point(tmp_path):
    folder = write_drive(tmp_path / "d", truth_name="groundtruth/groundtruth_211013_GNSS.txt")
    gnss = folder / "groundtruth/groundtruth_211013_GNSS.txt"
    adis = folder / "groundtruth/groundtruth_211013_ADIS.txt"
    adis.write_text(gnss.read_text())
    for point, name in (("antenna", gnss.name), ("imu", adis.name)):
        drive = read_great(folder, GreatOptions(lever="figure", reference_point=point))
        assert any(name in note for note in drive.notes)


def test_two_references_that_names_do_not_tell_apart(tmp_path):
    folder = write_drive(tmp_path / "e", truth_name="ref/a.txt")
    (folder / "ref/b.txt").write_text((folder / "ref/a.txt").read_text())
    with pytest.raises(ConfigError, match=r"a\.txt, b\.txt.*reference_file="):
        read_great(folder, GreatOptions(**DECLARED))
    read_great(folder, GreatOptions(**DECLARED, reference_file=folder / "ref/b.txt"))


# ---- sidecar ----------------------------------------------------------------------------------


def test_sidecar_declares_and_the_call_overrides(tmp_path):
    folder = write_drive(tmp_path / "d")
    (folder / "great.toml").write_text(
        'lever_antenna_frd_m = [0.1, 0.2, -0.3]\nreference_point = "imu"\n'
        'imu_preset = "consumer"\nweek = 2129\nreference_body = "imu"\ngyro_unit = "deg/s"\n'
    )
    drive = read_great(folder)
    np.testing.assert_array_equal(drive.calibration.lever_antenna_b, [0.1, 0.2, -0.3])
    assert drive.calibration.imu.name == "consumer"
    assert drive.reference.attitude_frame == "b"
    assert "great.toml" in drive.calibration.lever_antenna_source
    drive = read_great(folder, GreatOptions(lever="figure"))
    np.testing.assert_array_equal(drive.calibration.lever_antenna_b, [-0.65, -0.05, -0.15])


def test_sidecar_says_how_well_its_values_are_known(tmp_path):
    folder = write_drive(tmp_path / "d")
    (folder / "great.toml").write_text(
        "lever_antenna_frd_m = [0.1, 0.2, -0.3]\nlever_antenna_sigma_m = 0.2\n"
        'reference_point = "imu"\nmounting_rpy_deg = [0.0, 1.0, 2.0]\nmounting_sigma_deg = 3\n'
        "lever_vehicle_frd_m = [-1.0, 0.0, 0.5]\nlever_vehicle_sigma_m = 0.4\n"
    )
    found = read_great(folder).calibration
    assert (found.lever_antenna_sigma, found.lever_vehicle_sigma) == (0.2, 0.4)
    assert found.mounting_sigma == pytest.approx(np.radians(3.0))
    # Of another arm, named in the call, the file's σ says nothing.
    assert read_great(folder, GreatOptions(lever="figure")).calibration.lever_antenna_sigma == 0.0


def test_sidecar_vectors_are_the_mems_imus_not_the_tactical_ones(tmp_path):
    folder = write_drive(tmp_path / "d", imu_name="IMU/Tactical_imu_data.txt")
    (folder / "great.toml").write_text(
        'lever_antenna_frd_m = [0.1, 0.2, -0.3]\nreference_point = "imu"\nimu_preset = "consumer"\n'
    )
    with pytest.raises(ConfigError, match="lever arm of the tactical IMU not given"):
        read_great(folder, GreatOptions(imu="tactical"))
    drive = read_great(folder, GreatOptions(imu="tactical", lever="figure"))
    assert drive.calibration.imu.name == "tactical"
    np.testing.assert_allclose(drive.reference.lever_b, [0.32, 0.0, -0.01])  # tactical → MEMS


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("levr = 'figure'", r"unknown key 'levr' — did you mean 'lever'\?"),
        ("lever = 'figur'", "did you mean 'figure'"),
        ("lever = [1, 2]", "three numbers"),
        ("lever = 'figure'\nlever_antenna_frd_m = [1, 2, 3]", "not both"),
        ("lever = ", "not readable as TOML"),
        ("lever = 'figure'\nmounting_sigma_deg = 2", "without mounting_rpy_deg"),
        (
            "lever_antenna_frd_m = [1, 2, 3]\nlever_antenna_sigma_m = -1",
            "lever_antenna_sigma_m: expected a number of 0 or more",
        ),
        ("lever = 'figure'\nweek = 'x'", "week"),
        ("lever = 'figure'\nreference_point = 'antena'", "did you mean 'antenna'"),
        ("lever = 'figure'\nreference_body = 'car'", "reference_body"),
        ("lever = 'figure'\ngyro_unit = 'deg'", "gyro_unit"),
        ("lever = 'figure'\nreference_point = 'imu'\nimu_preset = 'adis'", "IMU preset"),
    ],
)
def test_sidecar_mistakes_are_one_line(tmp_path, text, message):
    folder = write_drive(tmp_path / "d")
    (folder / "great.toml").write_text(text + "\n")
    with pytest.raises(ConfigError, match=message) as caught:
        read_great(folder)
    assert "\n" not in str(caught.value)


# ---- missing and ambiguous files --------------------------------------------------------------


def test_missing_files_say_what_to_name(tmp_path):
    with pytest.raises(DataError, match="no such folder"):
        read_great(tmp_path / "nowhere", GreatOptions(**DECLARED))
    with pytest.raises(DataError, match=r"no IMU text found.*imu_file="):
        (tmp_path / "empty").mkdir()
        read_great(tmp_path / "empty", GreatOptions(**DECLARED))
    with pytest.raises(DataError, match=r"no RINEX observations.*rinex="):
        read_great(write_drive(tmp_path / "a", rover_name=""), GreatOptions(**DECLARED))
    with pytest.raises(DataError, match=r"no RINEX navigation.*navigation="):
        read_great(write_drive(tmp_path / "b", nav_name=""), GreatOptions(**DECLARED))
    with pytest.raises(ConfigError, match=r"no file of the tactical IMU.*MEMS_imu_data"):
        read_great(write_drive(tmp_path / "c"), GreatOptions(imu="tactical", **DECLARED))


def test_two_mems_files_ask_for_one(tmp_path):
    folder = write_drive(tmp_path / "d", imu_name="IMU/campus-01-MEMS.txt")
    second = write_drive(folder, imu_name="IMU/campus-02-MEMS.txt") / "IMU/campus-02-MEMS.txt"
    with pytest.raises(ConfigError, match=r"campus-01-MEMS\.txt, campus-02-MEMS\.txt.*imu_file="):
        read_great(folder, GreatOptions(**DECLARED))
    assert any(
        second.name in note
        for note in read_great(folder, GreatOptions(**DECLARED, imu_file=second)).notes
    )


def test_options_reach_the_rinex_reader(tmp_path, observations):
    read_great(write_drive(tmp_path / "d"), GreatOptions(**DECLARED, systems="GE", signals="all"))
    assert observations[0][2] == {"systems": "GE", "signals": "all"}
