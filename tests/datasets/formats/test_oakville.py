"""Oakville drives: axes, mounting and reference conventions, tested against motion and gravity."""

from __future__ import annotations

import itertools

import numpy as np
import pandas as pd
import pytest

from certnav.datasets.formats.oakville import is_oakville, read_oakville
from certnav.filters.earth import C_en_at, C_en_of, ecef_to_lla
from certnav.filters.errors import DataError
from certnav.filters.rotation import matrix_from_rpy, rpy_from_matrix, wrap_angle

DRIVES = (
    "parking-lot-figure8-nominal-001",
    "urban-long-turn-loop-nominal-001",
    "urban-medium-turn-loop-nominal-001",
)
URBAN = DRIVES[1:]


@pytest.fixture(scope="module")
def drives(data_dir):
    return {name: read_oakville(data_dir / "oakville-drives" / name) for name in DRIVES}


def vel_n(record):
    return np.einsum("nji,nj->ni", C_en_of(record.pos_e), record.vel_e)


def window_mean(time, values, at, width):
    total = np.zeros((time.size, values.shape[1]))
    total[1:] = np.cumsum(values[1:] * np.diff(time)[:, None], axis=0)
    ends = [
        np.column_stack([np.interp(at + s * width / 2, time, column) for column in total.T])
        for s in (-1, 1)
    ]
    return (ends[1] - ends[0]) / width


def fixes_motion(drive):
    """Return time, forward and right acceleration and course rate at moving GNSS epochs."""
    v, t = vel_n(drive.fixes), drive.fixes.time
    speed = np.hypot(v[:, 0], v[:, 1])
    course = np.unwrap(np.arctan2(v[:, 1], v[:, 0]))
    rate = np.gradient(course, t)
    moving = (speed > 3.0) & (t > t[0] + 30.0) & (t < t[-1] - 5.0)
    return t[moving], np.gradient(speed, t)[moving], (speed * rate)[moving], rate[moving]


@pytest.mark.parametrize("name", URBAN)
def test_vehicle_axes_feel_acceleration_forward_and_turns_to_the_right(drives, name):
    drive = drives[name]
    t, forward, right, rate = fixes_motion(drive)
    C_bv = drive.calibration.C_bv
    force = window_mean(drive.imu.time, drive.imu.accel_b @ C_bv, t, 1.0)
    turn = window_mean(drive.imu.time, drive.imu.gyro_b @ C_bv, t + 0.3, 1.0)  # antenna leads
    assert np.corrcoef(force[:, 0], forward)[0, 1] > 0.97
    assert np.corrcoef(force[:, 1], right)[0, 1] > 0.95
    assert np.corrcoef(turn[:, 2], rate)[0, 1] > 0.99
    assert force[:, 2].mean() == pytest.approx(-9.9, abs=0.1)


def test_mounting_of_the_turned_sensor(drives):
    """At 265° forward and right change places: the wrong sense of the angle would swap signs."""
    drive = drives[DRIVES[0]]
    t, forward, right, _ = fixes_motion(drive)
    C_bv = drive.calibration.C_bv
    force = window_mean(drive.imu.time, drive.imu.accel_b @ C_bv, t, 1.0)
    untouched = window_mean(drive.imu.time, drive.imu.accel_b, t, 1.0)
    assert np.corrcoef(force[:, 1], right)[0, 1] > 0.7
    assert np.corrcoef(force[:, 0], forward)[0, 1] > 0.6
    assert abs(np.corrcoef(untouched[:, 1], right)[0, 1]) < 0.4
    assert np.degrees(np.arctan2(C_bv[1, 0], C_bv[0, 0])) == pytest.approx(-95.3, abs=0.5)


@pytest.mark.parametrize("name", URBAN)
def test_reference_attitude_is_roll_right_pitch_up_heading_clockwise(drives, name):
    """Specific force in vehicle axes minus motion is gravity: (g sin pitch, −g sin roll, …)."""
    drive = drives[name]
    reference = drive.reference
    assert reference.attitude_frame == "v"
    v, t = vel_n(reference), reference.time
    speed = np.hypot(v[:, 0], v[:, 1])
    heading_error = wrap_angle(np.arctan2(v[:, 1], v[:, 0]) - reference.rpy[:, 2])
    fast = (speed > 5.0) & (t < t[-1] - 5.0)
    assert np.degrees(np.median(np.abs(heading_error[fast]))) < 0.1

    climb = np.arctan2(-v[fast, 2], speed[fast])
    assert np.polyfit(climb, reference.rpy[fast, 1], 1)[0] == pytest.approx(1.0, abs=0.02)
    C_bv = drive.calibration.C_bv
    force = window_mean(drive.imu.time, drive.imu.accel_b @ C_bv, t[fast], 0.5)
    turn = window_mean(drive.imu.time, drive.imu.gyro_b @ C_bv, t[fast], 0.5)
    smooth = pd.Series(speed).rolling(15, center=True, min_periods=1).mean().to_numpy()
    along = force[:, 0] - np.gradient(smooth, t)[fast]
    across = force[:, 1] - speed[fast] * turn[:, 2]
    assert np.polyfit(reference.rpy[fast, 1], along, 1)[0] == pytest.approx(9.8, rel=0.2)
    assert -13.0 < np.polyfit(reference.rpy[fast, 0], across, 1)[0] < -5.0


@pytest.mark.parametrize("name", URBAN)
def test_reference_position_follows_the_antenna(drives, name):
    drive = drives[name]
    fixes, reference = drive.fixes, drive.reference
    late = (fixes.time > 100.0) & (fixes.time < reference.time[-1])
    at = fixes.time[late]
    pos_e = np.column_stack([np.interp(at, reference.time, p) for p in reference.pos_e.T])
    apart = (pos_e - fixes.pos_e[late]) @ C_en_of(fixes.pos_e[0])
    horizontal = np.hypot(apart[:, 0], apart[:, 1])
    assert np.median(horizontal) < 0.8
    assert "NOT independent" in reference.source


@pytest.mark.parametrize("name", DRIVES)
def test_reference_begins_when_the_receiver_has_initialised(drives, name, data_dir):
    attitude = pd.read_csv(data_dir / "oakville-drives" / name / "reference_attitude.csv.gz")
    flat = attitude["t_s"][attitude["roll_deg"] == 0.0]
    assert drives[name].reference.time[0] > flat.max()
    assert drives[name].reference.time[0] < flat.max() + 0.1


def test_fix_covariances_are_the_files_deviations_in_ecef(drives, data_dir):
    drive = drives[DRIVES[1]]
    table = pd.read_csv(data_dir / "oakville-drives" / DRIVES[1] / "gnss.csv.gz")
    C_en = C_en_of(drive.fixes.pos_e[5])
    stds = table[[f"pos_std_{k}_m" for k in "ned"]].to_numpy()[5]
    np.testing.assert_allclose(
        C_en.T @ drive.fixes.pos_cov_e[5] @ C_en, np.diag(stds**2), atol=1e-9
    )
    lla = ecef_to_lla(drive.fixes.pos_e)
    np.testing.assert_allclose(np.degrees(lla[:, 0]), table["lat_deg"], atol=1e-9)
    np.testing.assert_allclose(lla[:, 2], table["height_m"], atol=1e-4)
    assert drive.time_scale == "relative"


# ---- hand-made folders ------------------------------------------------------------------------


def write(folder, *, mount=None, attitude=None, imu=None):
    """Write ten seconds of straight driving north at 5 m/s; 10 Hz IMU, 2 Hz GNSS."""
    folder.mkdir(exist_ok=True)
    t = np.arange(0.0, 10.05, 0.1)
    level = pd.DataFrame({"t_s": t, **dict.fromkeys(["gx_radps", "gy_radps", "gz_radps"], 0.0)})
    level = level.assign(ax_mps2=0.0, ay_mps2=0.0, az_mps2=9.8)
    (imu(level) if imu else level).to_csv(folder / "imu.csv", index=False)
    gnss = pd.DataFrame({"t_s": t[::5]})
    gnss = gnss.assign(lat_deg=43.0 + t[::5] * 5.0 / 111111.0, lon_deg=-79.0, height_m=100.0)
    gnss = gnss.assign(vn_mps=5.0, ve_mps=0.0, vd_mps=0.0)
    gnss = gnss.assign(**{f"pos_std_{k}_m": 1.0 for k in "ned"})
    gnss = gnss.assign(**{f"vel_std_{k}_mps": 0.1 for k in "ned"}, heading_rad=np.nan)
    gnss.to_csv(folder / "gnss.csv", index=False)
    if mount is not None:
        angles = dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), np.transpose(mount), strict=True))
        pd.DataFrame({"t_s": np.arange(len(mount)), **angles}).to_csv(
            folder / "reference_mount.csv", index=False
        )
    if attitude is not None:
        position = pd.DataFrame({"t_s": t}).assign(lat_deg=43.0 + t * 5.0 / 111111.0, lon_deg=-79.0)
        position = position.assign(height_m=100.0, vn_mps=5.0, ve_mps=0.0, vd_mps=0.0)
        attitude(position).to_csv(folder / "reference_position.csv", index=False)
        roll = np.where(t < 3.95, 0.0, 1.0)
        roll[:2] = 2.0  # left over from the receiver's last run
        pd.DataFrame({"t_s": t, "roll_deg": roll, "pitch_deg": 0.5, "yaw_deg": 0.0}).to_csv(
            folder / "reference_attitude.csv", index=False
        )
    return folder


def test_left_over_attitude_and_held_rows_are_left_out(tmp_path):
    def hold(position):
        position.loc[60:63, "lat_deg"] = position.loc[60, "lat_deg"]
        return position

    drive = read_oakville(write(tmp_path / "d", attitude=hold))
    assert drive.reference.time[0] == pytest.approx(4.0)
    missing = set(np.round(np.arange(4.0, 10.05, 0.1), 1)) - set(np.round(drive.reference.time, 1))
    assert missing == {6.1, 6.2, 6.3}
    assert any("3 held rows" in note for note in drive.notes)


@pytest.mark.parametrize(
    ("angles", "yaw"),
    [([[0, 0, 359.0], [0, 0, 1.0], [0, 0, 0.5], [0, 0, 359.9]], 0.2), ([[0, 0, 265.0]] * 4, 265.0)],
)
def test_mount_median_survives_the_wrap_at_360(tmp_path, angles, yaw):
    drive = read_oakville(write(tmp_path / "d", mount=[[0, 0, 90.0]] * 4 + angles))
    flip = np.diag([1.0, -1.0, -1.0])
    C_vb = flip @ matrix_from_rpy(np.radians([0, 0, yaw])) @ flip
    np.testing.assert_allclose(drive.calibration.C_bv, C_vb.T, atol=1e-9)


def test_without_mount_and_reference(tmp_path):
    drive = read_oakville(write(tmp_path / "d"))
    np.testing.assert_array_equal(drive.calibration.C_bv, np.eye(3))
    assert drive.reference is None
    np.testing.assert_allclose(drive.imu.accel_b[0], [0.0, 0.0, -9.8])
    C_en = C_en_at(np.radians(43.0), np.radians(-79.0))
    np.testing.assert_allclose(drive.fixes.vel_e[0], 5.0 * C_en[:, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda t: t.assign(az_mps2=-9.8), r"found \+z"),
        (lambda t: t.assign(az_mps2=1.0), "in g"),
        (lambda t: t.assign(gx_radps=t["gx_radps"].where(t.index != 7)), r"imu\.csv:9: gx_radps"),
        (lambda t: t.rename(columns={"ax_mps2": "a"}), r"missing columns ax_mps2"),
        (lambda t: t.rename(columns={"t_s": "t"}), r"column t_s"),
        (lambda t: t.assign(gx_radps="x"), "not readable as numbers"),
        (lambda t: t.iloc[::-1], r"imu\.csv:3: t_s: expected increasing"),
    ],
)
def test_contradictions_are_refused(tmp_path, edit, message):
    with pytest.raises(DataError, match=message) as caught:
        read_oakville(write(tmp_path / "d", imu=edit))
    assert "\n" not in str(caught.value)


def test_recognition(tmp_path):
    assert not is_oakville(tmp_path)
    assert is_oakville(write(tmp_path / "d"))
    with pytest.raises(DataError, match=r"imu\.csv\.gz: file not found"):
        read_oakville(tmp_path)


# ---- neighbours of the shared drives ----------------------------------------------------------


def permutations():
    """All 24 ways in which a sensor's axes can lie along forward, left and up."""
    turns = [
        np.eye(3)[list(order)] * np.array(signs)
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1.0, -1.0), repeat=3)
    ]
    return [turn for turn in turns if np.linalg.det(turn) > 0.0]


def neighbour(source, folder, *, turn=None, drop=None):
    """Write a shared drive with the sensor's axes turned, or rows of a file dropped."""
    folder.mkdir()
    for file in source.glob("*.csv.gz"):
        table, name = pd.read_csv(file), file.name.removesuffix(".csv.gz")
        if turn is not None and name == "imu":
            for triad in (["gx_radps", "gy_radps", "gz_radps"], ["ax_mps2", "ay_mps2", "az_mps2"]):
                table[triad] = table[triad].to_numpy() @ turn.T
        if turn is not None and name == "reference_mount":
            angles = ["roll_deg", "pitch_deg", "yaw_deg"]
            C_vs = [matrix_from_rpy(a) @ turn.T for a in np.radians(table[angles].to_numpy())]
            table[angles] = np.degrees(rpy_from_matrix(np.array(C_vs))) % 360.0
        if drop is not None and name in drop:
            table = table[drop[name](np.arange(len(table)))]
        table.to_csv(folder / f"{name}.csv", index=False)
    return folder


@pytest.mark.parametrize("k", range(24))
def test_the_axes_of_the_sensor_are_the_mounts_business(data_dir, drives, tmp_path, k):
    """Vehicle-frame data are the same however the sensor lay in the car."""
    name = DRIVES[2]
    turn = permutations()[k]
    drive, expected = (
        read_oakville(neighbour(data_dir / "oakville-drives" / name, tmp_path / "d", turn=turn)),
        drives[name],
    )
    for field in ("gyro_b", "accel_b"):
        a, b = (getattr(d.imu, field) @ d.calibration.C_bv for d in (drive, expected))
        np.testing.assert_allclose(a, b, rtol=0, atol=2e-3 if turn[2, 2] > 0.5 else 1e-9)


@pytest.mark.parametrize("k", [1, 8, 14, 21])
def test_a_run_does_not_depend_on_the_axes_of_the_sensor(data_dir, drives, tmp_path, k):
    from certnav.nav.config import Config
    from certnav.nav.pipeline import navigate

    name, turn = DRIVES[2], permutations()[k]
    assert turn[2, 2] < 0.5  # not upright
    drive = read_oakville(neighbour(data_dir / "oakville-drives" / name, tmp_path / "d", turn=turn))
    a, b = (navigate(d, Config()).trajectory for d in (drive, drives[name]))
    np.testing.assert_allclose(a.pos_e, b.pos_e, rtol=0, atol=1e-6)


def test_reference_files_of_other_lengths_are_joined_by_time(data_dir, drives, tmp_path):
    """Every row that is left is the row that was there; dropped attitudes are interpolated."""
    source, expected = data_dir / "oakville-drives" / DRIVES[2], drives[DRIVES[2]].reference
    drop = {
        "reference_position": lambda k: (k % 7 != 0) & (k > 20),
        "reference_attitude": lambda k: (k % 5 != 0) & (k < k.size - 90),
        "reference_motion": lambda k: k % 2 == 0,
        "reference_mount": lambda k: k % 3 != 1,
    }
    drive = read_oakville(neighbour(source, tmp_path / "d", drop=drop))
    found = drive.reference
    row = np.searchsorted(expected.time, found.time)
    np.testing.assert_array_equal(expected.time[row], found.time)
    np.testing.assert_allclose(found.pos_e, expected.pos_e[row], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.vel_e, expected.vel_e[row], rtol=0, atol=1e-6)
    apart = np.degrees(np.abs(wrap_angle(found.rpy - expected.rpy[row])))
    assert (apart == 0.0).all(axis=1).mean() > 0.75
    assert apart.max() < 1.0  # the receiver's own solution steps by as much
    assert len(found.time) > 0.8 * len(expected.time)
    assert any("positions without attitude left out" in note for note in drive.notes)


def test_a_reference_without_common_times_is_left_out(tmp_path):
    folder = write(tmp_path / "d", attitude=lambda position: position)
    table = pd.read_csv(folder / "reference_attitude.csv")
    table["t_s"] += 500.0
    table.to_csv(folder / "reference_attitude.csv", index=False)
    drive = read_oakville(folder)
    assert drive.reference is None
    assert any("no time in common" in note for note in drive.notes)


def test_a_mount_that_does_not_turn_gravity_up_is_refused(tmp_path):
    def sideways(table):
        return table.assign(ax_mps2=9.8, az_mps2=0.0)

    with pytest.raises(DataError, match="turned by mount"):
        read_oakville(write(tmp_path / "a", imu=sideways))
    folder = write(tmp_path / "b", imu=sideways, mount=[[0.0, 270.0, 0.0]] * 8)
    read_oakville(folder)
