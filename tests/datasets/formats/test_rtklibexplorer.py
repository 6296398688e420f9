"""The RTK drive: time tag, axes, mounting and timing against the RTK velocity."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from certnav.datasets import gpstime
from certnav.datasets.formats.rtklib_pos import read_pos
from certnav.datasets.formats.rtklibexplorer import (
    IMU_LAG,
    is_rtklibexplorer,
    read_rtklibexplorer,
    read_tag_start,
)
from certnav.filters.earth import C_en_of
from certnav.filters.errors import ConfigError, DataError


@pytest.fixture(scope="module")
def drive(data_dir):
    return read_rtklibexplorer(data_dir / "rtklibexplorer-drive")


def test_tag_start(tmp_path):
    file = tmp_path / "imu.csv.tag"
    whole = 1752003261  # 2025-07-08 19:34:21, counted from 1970 as RTKLIB counts GPS time
    file.write_bytes(
        b"TIMETAG RTKLIB demo5".ljust(60, b"\0") + struct.pack("<IId", 7, whole, 0.854)
    )
    expected = gpstime.from_calendar(2025, 7, 8, 19, 34, 21.854)
    assert read_tag_start(file) == pytest.approx(expected, abs=1e-6)
    file.write_bytes(b"TIMETAG RTK")
    with pytest.raises(DataError, match="RTKLIB time tag"):
        read_tag_start(file)
    with pytest.raises(DataError, match="time tag not found"):
        read_tag_start(tmp_path / "nowhere.tag")


def test_mounting_levels_the_car_at_rest(drive):
    """In vehicle axes gravity is down to the slope of the road, which residential is below 2°."""
    speed = np.linalg.norm(drive.fixes.vel_e, axis=1)
    rest = np.interp(drive.imu.time, drive.fixes.time, speed) < 0.03
    assert rest.sum() > 3000
    mean_v = drive.imu.accel_b[rest].mean(axis=0) @ drive.calibration.C_bv
    assert np.degrees(np.arccos(-mean_v[2] / np.linalg.norm(mean_v))) < 2.0
    assert np.linalg.norm(mean_v) == pytest.approx(9.80, abs=0.15)


def test_specific_force_is_acceleration_turn_and_climb_in_vehicle_axes(drive):
    """Regress forward and right force on change of speed, v·ψ̇ and climb angle.

    Mounting, signs and units are right when forward answers to the first with 1, to the last with
    g, and right to the second with 1, without crosstalk. Squat and roll on the springs lean
    gravity into both: 3° per g is 5 %.
    """
    fixes, C_bv, imu = drive.fixes, drive.calibration.C_bv, drive.imu
    vel_n = fixes.vel_e @ C_en_of(fixes.pos_e[0])
    speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
    inside = (fixes.time > imu.time[0] + 1.0) & (fixes.time < imu.time[-1] - 1.0)
    k = np.flatnonzero((speed > 3.0) & inside)

    def window_mean(values):  # over the half second between the neighbouring fixes
        total = np.concatenate([[0.0], np.cumsum(values[1:] * np.diff(imu.time))])
        at = np.interp(np.stack([fixes.time[k - 1], fixes.time[k + 1]]), imu.time, total)
        return (at[1] - at[0]) / 0.5

    course = np.arctan2(vel_n[:, 1], vel_n[:, 0])
    course_rate = np.angle(np.exp(1j * (course[k + 1] - course[k - 1]))) / 0.5
    speed_rate = (speed[k + 1] - speed[k - 1]) / 0.5
    climb = -vel_n[k, 2] / speed[k]
    assert np.corrcoef(window_mean((imu.gyro_b @ C_bv)[:, 2]), course_rate)[0, 1] > 0.995

    design = np.column_stack([speed_rate, speed[k] * course_rate, climb, np.ones(k.size)])
    force_v = imu.accel_b @ C_bv
    forward, right = (
        np.linalg.lstsq(design, window_mean(force_v[:, axis]), rcond=None)[0] for axis in (0, 1)
    )
    np.testing.assert_allclose(forward[:3], [1.05, 0.0, 9.8], atol=0.08, rtol=0.02)
    np.testing.assert_allclose(right[:2], [0.0, 1.05], atol=0.08)


def velocity_misfit(drive, lag: float) -> float:
    """RMS misfit [m/s] of RTK velocity to the IMU propagated over 8 s in the flat second half.

    Horizontal, as complex numbers: v = v0 + e^{iψ0}(∫e^{iψ}f + b∫e^{iψ}) + tilt·t, linear in its
    five unknowns, with ψ the integrated yaw rate.
    """
    imu, fixes, C_bv = drive.imu, drive.fixes, drive.calibration.C_bv
    dt = np.diff(imu.time, prepend=imu.time[0])
    turn = np.exp(1j * np.cumsum((imu.gyro_b @ C_bv)[:, 2] * dt))
    force = imu.accel_b @ C_bv
    reached = np.cumsum(turn * (force[:, 0] + 1j * force[:, 1]) * dt)
    biased = np.cumsum(turn * dt)
    vel_n = fixes.vel_e @ C_en_of(fixes.pos_e[0])
    v = vel_n[:, 0] + 1j * vel_n[:, 1]
    squares, count = 0.0, 0
    for start in np.arange(imu.time[0] + 330.0, imu.time[0] + 430.0, 8.0):
        inside = (fixes.time >= start) & (fixes.time < start + 8.0)
        k = np.flatnonzero(inside & np.isfinite(v))
        t = fixes.time[k] + lag
        columns = [np.ones(k.size), t - t[0]]
        columns += [np.interp(t, imu.time, x) for x in (reached, biased)]
        design = np.column_stack(columns)
        fit = np.linalg.lstsq(design, v[k], rcond=None)[0]
        squares += float(np.sum(np.abs(v[k] - design @ fit) ** 2))
        count += k.size
    return float(np.sqrt(squares / count))


def test_imu_and_rtk_share_their_time(drive):
    lags = np.arange(-0.2, 0.201, 0.02)
    misfit = np.array([velocity_misfit(drive, lag) for lag in lags])
    assert abs(lags[np.argmin(misfit)]) < 0.05
    # Without the reader's shift of the IMU the fit would be visibly worse.
    assert velocity_misfit(drive, IMU_LAG) > 1.1 * misfit.min()


def test_velocities_belong_to_their_epochs(drive, data_dir):
    """As printed they are means over the epoch before; handed on, central differences."""
    fixes = drive.fixes
    printed = read_pos(data_dir / "rtklibexplorer-drive" / "gnss_1934_sf.pos").vel_e
    step = np.diff(fixes.pos_e, axis=0) / np.diff(fixes.time)[:, None]
    central = 0.5 * (step[1:] + step[:-1])

    def misfit(a, b):
        return float(np.nanstd(a - b))

    assert misfit(printed[1:], step) < 0.6 * misfit(printed[1:-1], central)
    assert misfit(fixes.vel_e[1:-1], central) < 0.6 * misfit(printed[1:-1], central)
    assert np.isnan(fixes.vel_e[-1]).all()


def test_reference_is_the_fixed_epochs_and_says_so(drive):
    reference = drive.reference
    assert "NOT independent" in reference.source
    assert reference.point == "antenna"
    assert np.isnan(reference.rpy).all()
    assert len(reference) == int((drive.fixes.quality == "fixed").sum())
    np.testing.assert_allclose(np.linalg.norm(reference.lever_b), 0.05)


def test_imu_lag_moves_the_stamps_back(drive, data_dir):
    as_stamped = read_rtklibexplorer(data_dir / "rtklibexplorer-drive", imu_lag=0.0)
    np.testing.assert_allclose(as_stamped.imu.time - drive.imu.time, IMU_LAG, atol=1e-6)


def test_recognition_and_missing_files(tmp_path):
    assert not is_rtklibexplorer(tmp_path)
    with pytest.raises(DataError, match=r"no imu_\*\.csv"):
        read_rtklibexplorer(tmp_path)
    for name in ("imu_1.csv", "imu_2.csv", "gnss_1.pos"):
        (tmp_path / name).write_text("")
    assert is_rtklibexplorer(tmp_path)
    with pytest.raises(ConfigError, match="several recordings"):
        read_rtklibexplorer(tmp_path)


@pytest.mark.parametrize("every", [2, 4])
def test_a_neighbour_at_another_rate_keeps_its_velocities(data_dir, tmp_path, every):
    source = data_dir / "rtklibexplorer-drive"
    for name in ("imu_1934.csv", "imu_1934.csv.tag"):
        (tmp_path / name).symlink_to(source / name)
    lines = (source / "gnss_1934_sf.pos").read_text().splitlines()
    head = [line for line in lines if line.startswith("%")]
    rows = [line for line in lines if not line.startswith("%")][::every]
    (tmp_path / "gnss_1934_sf.pos").write_text("\n".join([*head, *rows]) + "\n")
    fixes = read_rtklibexplorer(tmp_path).fixes
    assert len(fixes) == len(rows)
    assert fixes.has_velocity.mean() > 0.95
