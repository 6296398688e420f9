"""The Tsukishima drive: conversions on hand-made files, conventions measured on the real ones."""

from __future__ import annotations

import gzip
import shutil

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from certnav.datasets.formats.tumsat import (
    METRES_PER_SECOND_PER_COUNT,
    WHEEL_DELAY,
    is_tumsat,
    read_tumsat,
)
from certnav.datasets.gpstime import from_week_sow
from certnav.datasets.loading import load, recognise
from certnav.filters.earth import C_en_at, C_en_of, lla_to_ecef
from certnav.filters.errors import ConfigError, DataError
from certnav.velocity.range_rate import line_of_sight, predicted_range_rate

WEEK, START, LEAP = 2130, 364600.0, 18.0
LAT, LON = np.radians(35.67), np.radians(139.79)
#: Two GPS satellites and one of QZSS, in ECEF at reception.
RADII = np.array([26.6e6, 26.5e6, 42.1e6])


def circle(sow):
    """Position and velocity of a car that drives clockwise on a radius of 40 m, 7 … 13 m/s."""
    t = np.asarray(sow) - START
    origin, C_en = lla_to_ecef(LAT, LON, 40.0), C_en_at(LAT, LON)
    psi, speed = (10.0 * t + 10.0 * (1.0 - np.cos(0.3 * t))) / 40.0, 10.0 + 3.0 * np.sin(0.3 * t)
    pos_n = 40.0 * np.stack([np.sin(psi), 1.0 - np.cos(psi), 0.0 * psi], axis=-1)
    vel_n = speed[..., None] * np.stack([np.cos(psi), np.sin(psi), 0.0 * psi], axis=-1)
    return origin + pos_n @ C_en.T, vel_n @ C_en.T


@pytest.fixture
def folder(tmp_path):
    """Write a minute on the circle in the set's own columns, axes and time scales."""
    pos_e, vel_e = circle(sow := START + 0.2 * np.arange(301))
    up = C_en_at(LAT, LON) @ [0.0, 0.0, -1.0]
    north = C_en_at(LAT, LON) @ [1.0, 0.0, 0.0]
    directions = np.stack([up, up + 0.8 * north, up - 0.8 * north])
    sats = RADII[:, None] * directions / np.linalg.norm(directions, axis=1)[:, None]
    rows = []
    for k in range(301):
        for prn, sat in zip((12, 24, 2), sats, strict=True):
            distance = np.linalg.norm(sat - pos_e[k])
            rows.append([k + 1, WEEK, sow[k], prn, distance, *sat, 50.0, 1e-12,
                         100.0, 200.0, 300.0, 60.0, 45.0, 330.0])  # fmt: skip
        if k % 100 == 99:
            rows.append([0.0] * 16)
    savemat(tmp_path / "GNSSTCData_GQ.mat", {"GNSSTCData": np.array(rows)})
    utc = START - LEAP + 0.02 * np.arange(3000)
    one, driven = np.ones(utc.size), 0.3 * (utc + LEAP - START)
    speed = 10.0 + 3.0 * np.sin(driven)
    # sensor axes right, forward, up; a turn to the right is an acceleration to the right
    accel = np.column_stack([speed**2 / 40.0, 0.9 * np.cos(driven), 9.8 * one])
    gyro = np.column_stack([0.0 * one, 0.0 * one, -speed / 40.0])
    savemat(tmp_path / "IMUData1105.mat", {"IMUData": np.column_stack([utc, accel, gyro])})
    count = np.where(utc < START - LEAP + 30.0, 51.0, 40.0)
    other = np.column_stack([utc, accel / 9.798, np.degrees(gyro), 30.0 * one, count, 1e3 * one])
    savemat(tmp_path / "IMUData_CarSpeed.mat", {"IMUCarSpeed": other})
    quality = np.where(np.arange(301) % 50 == 49, 2, 1)
    sd = np.tile([0.01, 0.02, 0.03, -0.004, 0.005, -0.006], (301, 1))
    sd[4, 2] = -0.03  # as the set itself has some
    n = len(sow)
    write(tmp_path / "RTK1105.csv.gz", sow, pos_e, quality, np.full(n, 12), sd, 0.5 * np.ones(n),
          9.0 * np.ones(n))  # fmt: skip
    vel_n = vel_e @ C_en_at(LAT, LON)
    enu = vel_n[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    dop = np.tile([0.7, 1.1], (n, 1))
    table = (sow + 1e-4, np.full(n, 9), enu, vel_e, np.full(n, 330.0), dop)
    write(tmp_path / "GNSSvel1105.csv.gz", *(part[:250] for part in table))
    write(tmp_path / "ubox1105.csv.gz", sow, pos_e + 0.3 * up)
    return tmp_path


def write(file, *parts):
    table = np.column_stack(parts)
    with gzip.open(file, "wt") as stream:
        np.savetxt(stream, table, fmt="%.6f", delimiter=",")


def rewrite(file, change):
    """Change the matrix in a file."""
    held = {k: v for k, v in loadmat(file).items() if not k.startswith("_")}
    ((name, table),) = held.items()
    savemat(file, {name: change(table.copy())})


def test_imu_is_turned_and_moved_from_utc_to_gps_time(folder):
    drive = load(folder)
    assert drive.imu.time[0] == pytest.approx(from_week_sow(WEEK, START), abs=1e-6)
    np.testing.assert_allclose(drive.imu.accel_b[0], [0.9, 2.5, -9.8], atol=1e-12)
    np.testing.assert_allclose(drive.imu.gyro_b[0], [0.0, 0.0, 0.25], atol=1e-12)
    late = read_tumsat(folder, imu_lag=0.1)
    np.testing.assert_allclose(drive.imu.time - late.imu.time, 0.1, atol=1e-6)
    assert any("back by 0.1 s" in note for note in late.notes)


def test_wheel_counts_are_speed_at_the_time_it_was_driven(folder):
    odometer = read_tumsat(folder).odometer
    slower = np.flatnonzero(np.diff(odometer.speed))
    assert slower.size == 1
    assert odometer.speed[0] == pytest.approx(51 * METRES_PER_SECOND_PER_COUNT)
    changed = odometer.time[slower[0] + 1]
    assert changed == pytest.approx(from_week_sow(WEEK, START + 30.0) - WHEEL_DELAY, abs=0.021)
    (folder / "IMUData_CarSpeed.mat").unlink()
    without = read_tumsat(folder)
    assert without.odometer is None
    assert any("no odometer" in note for note in without.notes)


def test_satellites_are_at_transmission_and_padding_is_counted(folder):
    drive = read_tumsat(folder)
    observations = drive.observations
    assert len(observations) == 903
    assert set(observations.sat) == {"G12", "G24", "J02"}
    assert any("3 rows of PRN 0" in note for note in drive.notes)
    pos_e = circle(observations.time - from_week_sow(WEEK, 0.0))[0]
    sight = line_of_sight(pos_e, observations.sat_pos_e, observations.sat_vel_e)
    np.testing.assert_allclose(sight.range, observations.pseudorange, atol=0.01)
    assert np.isfinite(observations.range_rate).all()
    assert observations.has_range_rate.all()


def test_rtk_judges_or_is_navigated_with_and_says_which(folder):
    judged = read_tumsat(folder)
    assert set(judged.fixes.quality) == {"receiver"}
    assert "independent of the Doppler" in judged.reference.source
    assert np.linalg.norm(judged.fixes.pos_e[0] - circle(START)[0]) == pytest.approx(0.3, abs=1e-4)
    used = read_tumsat(folder, rtk="fixes")
    assert "NOT independent" in used.reference.source
    assert (used.fixes.quality == "float").sum() == 6
    assert len(used.reference) == 295 == len(judged.reference)
    with pytest.raises(ConfigError, match="expected 'reference' or 'fixes'"):
        read_tumsat(folder, rtk="both")


def test_reference_velocity_is_of_its_own_displacements(folder):
    """Not beside a float epoch, and not the Doppler's."""
    rewrite_velocity = folder / "GNSSvel1105.csv.gz"
    with gzip.open(rewrite_velocity, "rt") as stream:
        table = np.loadtxt(stream, delimiter=",")
    table[:, 5:8] += 1.0
    write(rewrite_velocity, table)
    drive = read_tumsat(folder)
    sow = drive.reference.time - from_week_sow(WEEK, 0.0)
    truth = circle(sow)[1]
    known = np.isfinite(drive.reference.vel_e).all(axis=1)
    np.testing.assert_allclose(drive.reference.vel_e[known], truth[known], atol=0.02)
    beside = (np.round((sow - START) / 0.2).astype(int) % 50)[~known]
    assert set(beside) == {0, 48}  # the ends of the drive are among them
    off = drive.fixes.vel_e[:250] - circle(START + 0.2 * np.arange(250))[1]
    np.testing.assert_allclose(off, 1.0, atol=1e-5)
    assert not drive.fixes.has_velocity[250:].any()


def test_covariances(folder):
    fixes = read_tumsat(folder, rtk="fixes").fixes
    expected = [[1e-4, -1.6e-5, -3.6e-5], [-1.6e-5, 4e-4, 2.5e-5], [-3.6e-5, 2.5e-5, 9e-4]]
    np.testing.assert_allclose(fixes.pos_cov_e[0], expected, rtol=1e-9)
    assert np.flatnonzero(~fixes.usable).tolist() == [4]
    assert "covariance" in fixes.rejected[4]
    C_en = C_en_of(fixes.pos_e[0])
    sigma = np.sqrt(np.diag(C_en.T @ fixes.vel_cov_e[0] @ C_en))
    assert sigma[2] / sigma[0] == pytest.approx(1.1 / 0.7)
    own = read_tumsat(folder, fix_sigma_m=(2.0, 5.0)).fixes
    sigma = np.sqrt(np.diag(C_en.T @ own.pos_cov_e[0] @ C_en))
    np.testing.assert_allclose(sigma, [2.0, 2.0, 5.0], rtol=1e-4)


def _back(table):
    table[5, 0] = table[3, 0]
    return table


def _endless(table):
    table[4, 5] = np.nan
    return table


def _next_week(table):
    table[4, 1] += 1
    return table


@pytest.mark.parametrize(
    ("name", "change", "problem"),
    [
        ("IMUData1105.mat", _back, r":6: time: expected increasing"),
        ("IMUData_CarSpeed.mat", _back, r":6: time: expected increasing"),
        ("IMUData1105.mat", _endless, r":5: IMUData: expected a finite number in column 6"),
        ("IMUData1105.mat", lambda t: t[:, :6], "IMUData: expected numbers in 7 columns"),
        ("GNSSTCData_GQ.mat", _next_week, "one GPS week, found weeks 2130 … 2131"),
        ("GNSSTCData_GQ.mat", lambda t: 0.0 * t, "one GPS week, found no row"),
        ("IMUData1105.mat", lambda t: t * [1, 1, 1, 1, 1, 1, -1], "contradicts the course"),
        ("IMUData1105.mat", lambda t: t * [1, 1, 1, -1, 1, 1, 1], "expected up = −z"),
    ],
)
def test_what_contradicts_is_refused(folder, name, change, problem):
    rewrite(folder / name, change)
    with pytest.raises(DataError, match=problem):
        read_tumsat(folder)


def test_missing_damaged_and_doubled_files(folder, tmp_path):
    assert recognise(folder) == "tumsat"
    shutil.copy(folder / "RTK1105.csv.gz", folder / "RTK1106.csv.gz")
    with pytest.raises(ConfigError, match="several recordings"):
        read_tumsat(folder)
    for name in ("RTK1105.csv.gz", "RTK1106.csv.gz"):
        (folder / name).unlink()
    with pytest.raises(DataError, match=r"no RTK\*\.csv\* found"):
        read_tumsat(folder)
    savemat(folder / "IMUData1105.mat", {"Other": np.eye(3)})
    with pytest.raises(DataError, match="expected a matrix IMUData, found none"):
        read_tumsat(folder)
    (folder / "GNSSTCData_GQ.mat").write_bytes(b"no matrix")
    with pytest.raises(DataError, match="not readable as MATLAB 5"):
        read_tumsat(folder)
    assert not is_tumsat(tmp_path / "nowhere")


# --- the real drive --------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drive(data_dir):
    return load(data_dir / "tumsat-tsukishima")


def test_it_is_the_drive_its_page_describes(drive):
    assert len(drive.observations) == 52353 - 1937
    assert set("".join(drive.observations.sat.astype("U1"))) == {"G", "J"}
    moved = float(np.sum(drive.odometer.speed) * 0.02)
    assert moved == pytest.approx(10600.0, rel=0.02)
    assert len(drive.reference) == 7233


def test_pseudoranges_put_the_satellites_at_transmission(drive):
    """Turned by the Earth during 70 ms or not is 130 m in a satellite's place."""
    part = drive.observations.take(drive.observations.cn0 >= 45.0)
    part = part.take(slice(0, 8000))
    at = np.column_stack([np.interp(part.time, drive.fixes.time, x) for x in drive.fixes.pos_e.T])
    off = part.pseudorange - line_of_sight(at, part.sat_pos_e, part.sat_vel_e).range
    epoch = np.unique(part.time, return_inverse=True)[1]
    clock = np.array([np.median(off[epoch == k]) for k in range(epoch.max() + 1)])
    assert np.median(np.abs(off - clock[epoch])) < 2.0


def test_range_rates_fit_the_velocity_of_rtk(drive):
    observations, reference = drive.observations, drive.reference
    known = np.isfinite(reference.vel_e).all(axis=1)
    time, pos_e, vel_e = (x[known] for x in (reference.time, reference.pos_e, reference.vel_e))
    k = np.clip(np.searchsorted(time, observations.time - 0.01), 0, time.size - 1)
    rows = (np.abs(time[k] - observations.time) < 0.01) & (observations.cn0 >= 45.0)
    o, k = observations.take(rows), k[rows]
    drift = np.zeros(len(o))
    rate = predicted_range_rate(
        pos_e[k], vel_e[k], drift, o.sat_pos_e, o.sat_vel_e, o.sat_clock_drift
    )
    off = o.range_rate - rate
    epoch = np.unique(o.time, return_inverse=True)[1]
    clock = np.array([np.median(off[epoch == j]) for j in range(epoch.max() + 1)])
    assert np.median(np.abs(off - clock[epoch])) < 0.03


def track(drive):
    """Times and horizontal velocity, north and east, where three RTK fixes agree with Doppler."""
    fixes, reference = drive.fixes, drive.reference
    at = np.clip(np.searchsorted(fixes.time, reference.time - 0.01), 0, len(fixes) - 1)
    near = np.linalg.norm(fixes.vel_e[at] - reference.vel_e, axis=1) < 0.5
    vel_n = np.einsum("nji,nj->ni", C_en_of(fixes.pos_e[at]), fixes.vel_e[at])
    return reference.time[near], vel_n[near, :2]


def changes(drive):
    """Start, end, change of speed and of course over 1 s."""
    time, vel = track(drive)
    begin = np.searchsorted(time, time - 1.01)
    whole = np.abs(time[begin] - time + 1.0) < 0.01
    a, b = vel[begin[whole]], vel[whole]
    speed = np.hypot(*b.T) - np.hypot(*a.T)
    turn = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1))
    fast = np.minimum(np.hypot(*a.T), np.hypot(*b.T)) > 3.0
    return time[begin[whole]], time[whole], speed, np.where(fast & (abs(turn) < 1), turn, np.nan)


def correlation(imu_time, rate, start, end, y):
    integral = np.concatenate([[0.0], np.cumsum(rate[1:] * np.diff(imu_time))])
    x = np.interp(end, imu_time, integral) - np.interp(start, imu_time, integral)
    known = np.isfinite(y)
    return float(np.corrcoef(x[known], y[known])[0, 1])


def test_the_imu_is_in_utc_and_right_forward_up(drive):
    start, end, speed, turn = changes(drive)
    imu = drive.imu
    shifts = np.array([-18.0, -1.0, -0.2, 0.0, 0.2, 1.0, 18.0])
    found = [correlation(imu.time + s, imu.accel_b[:, 0], start, end, speed) for s in shifts]
    assert shifts[np.argmax(found)] == 0.0
    assert max(found) > 0.9
    forward = [correlation(imu.time, imu.accel_b[:, k], start, end, speed) for k in range(3)]
    assert np.argmax(np.abs(forward)) == 0
    yaw = [correlation(imu.time, imu.gyro_b[:, k], start, end, turn) for k in range(3)]
    assert np.argmax(yaw) == 2
    assert yaw[2] > 0.95


def test_the_wheel_goes_with_the_track(drive):
    time, vel = track(drive)
    speed, odometer = np.hypot(*vel.T), drive.odometer

    def misfit(lag):
        wheel = np.interp(time + lag, odometer.time, odometer.speed)
        return float(np.sqrt(np.mean((wheel - speed) ** 2)))

    lags = np.arange(-0.6, 0.61, 0.1)
    assert abs(lags[np.argmin([misfit(lag) for lag in lags])]) < 0.05
    assert misfit(0.0) < 0.12
    wheel = np.interp(time, odometer.time, odometer.speed)
    assert float(wheel @ speed / (wheel @ wheel)) == pytest.approx(1.0, abs=0.003)
