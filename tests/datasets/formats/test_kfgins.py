"""KF-GINS text: increments, lever arm and noise from its options, truth of the IMU."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.formats.kfgins import is_kfgins, kind_of, read_gnss, read_kfgins, read_nav
from certnav.datasets.loading import load
from certnav.filters.earth import C_en_at, C_en_of, ecef_to_lla, lla_to_ecef
from certnav.filters.errors import ConfigError, DataError

SOW, HZ, WEEK = 456300.0, 100.0, 2017
LAT, LON = np.radians([30.44, 114.47])
OPTIONS = """\
imunoise:
  arw: [0.003, 0.004, 0.003]          # [deg/sqrt(hr)]
  vrw: [0.03, 0.03, 0.03]
  gbstd: [0.027, 0.027, 0.027]
  abstd: [15.0, 15.0, 15.0]     # [mGal]
  gsstd: [300.0, 300.0, 300.0]
  asstd: [300.0, 300.0, 300.0]
  corrtime: 4.0                    # [hr]

# antenna lever [m]
antlever:  [ 0.136, -0.301, -0.184 ]
"""


def write(file, table, form="%.12f"):
    np.savetxt(file, table, fmt=form)


@pytest.fixture
def folder(tmp_path):
    t = SOW + np.arange(0.0, 60.0, 1.0 / HZ)
    heading = 1.2 * np.sin((t - SOW) / 3.0)
    rate = 0.4 * np.cos((t - SOW) / 3.0)
    zero = np.zeros(t.size)
    increments = np.column_stack([zero, zero, rate, zero, 10.0 * rate, zero - 9.79]) / HZ
    write(tmp_path / "ADIS.txt", np.column_stack([t, increments]))
    vel_n = 10.0 * np.column_stack([np.cos(heading), np.sin(heading), zero])
    path = np.vstack([np.zeros(3), np.cumsum(0.5 * (vel_n[1:] + vel_n[:-1]) / HZ, axis=0)])
    pos_e = lla_to_ecef(LAT, LON, 20.0) + path @ C_en_at(LAT, LON).T
    lla = ecef_to_lla(pos_e) * [np.degrees(1.0), np.degrees(1.0), 1.0]
    k = slice(None, None, int(HZ))
    n = t[k].size
    write(tmp_path / "GNSS-RTK.txt", np.column_stack(
        [t[k], lla[k], np.tile([0.01, 0.02, 0.03], (n, 1))]))  # fmt: skip
    attitude = np.column_stack([zero, zero, np.degrees(heading)])
    nav = np.column_stack([np.full(n, WEEK), t[k], lla[k], vel_n[k], attitude[k]])
    write(tmp_path / "truth.nav", nav)
    (tmp_path / "kf-gins.yaml").write_text(OPTIONS)
    return tmp_path


def test_kinds_are_told_by_content(folder):
    kinds = {f.name: kind_of(f) for f in folder.iterdir()}
    assert kinds == {"ADIS.txt": "imu", "GNSS-RTK.txt": "gnss", "truth.nav": "nav",
                     "kf-gins.yaml": ""}  # fmt: skip
    assert is_kfgins(folder)
    (folder / "GNSS-RTK.txt").unlink()
    assert not is_kfgins(folder)


def test_the_drive(folder):
    s = load(folder)
    assert s.notes[0].startswith("read as kf-gins")
    t = s.inertial.time - WEEK * 604800.0 - SOW
    np.testing.assert_allclose(s.inertial.gyro_b[:, 2], 0.4 * np.cos(t / 3.0), atol=2e-5)
    np.testing.assert_allclose(s.inertial.accel_b[:, 2], -9.79, atol=3e-4)
    np.testing.assert_array_equal(s.calibration.lever_antenna_b, [0.136, -0.301, -0.184])
    spec = s.calibration.imu
    assert spec.gyro_arw_deg_sqrth == 0.004
    assert spec.accel_bias_instability_mg == pytest.approx(15e-5 / 9.80665e-3)
    assert spec.bias_correlation_time_s == 4.0 * 3600.0
    assert s.reference.point == "imu"
    np.testing.assert_array_equal(s.reference.lever_b, 0.0)
    assert s.time_scale == "gps"
    vel_n = np.einsum("nji,nj->ni", C_en_of(s.reference.pos_e), s.reference.vel_e)
    course = np.arctan2(vel_n[:, 1], vel_n[:, 0])
    np.testing.assert_allclose(course, s.reference.rpy[:, 2], atol=1e-9)


def test_without_truth_the_time_is_relative_unless_a_week_is_given(folder):
    (folder / "truth.nav").unlink()
    assert read_kfgins(folder).time_scale == "relative"
    s = read_kfgins(folder, week=WEEK)
    assert s.time_scale == "gps"
    assert s.inertial.time[0] == WEEK * 604800.0 + SOW


def test_lever_and_noise_have_to_come_from_somewhere(folder):
    (folder / "kf-gins.yaml").unlink()
    with pytest.raises(ConfigError, match=r"--set data\.lever="):
        read_kfgins(folder)
    with pytest.raises(ConfigError, match=r"--set data\.imu_preset="):
        read_kfgins(folder, lever=(0, 0, 0))
    s = read_kfgins(folder, lever=(0, 0, -1), imu_preset="tactical")
    assert s.calibration.imu.name == "tactical"


def test_velocity_columns_are_read_and_tested(folder):
    table = np.loadtxt(folder / "GNSS-RTK.txt")
    truth = np.loadtxt(folder / "truth.nav")
    std = np.full((len(table), 3), 0.05)
    write(folder / "GNSS-RTK.txt", np.column_stack([table, truth[:, 5:8], std]))
    fixes = read_gnss(folder / "GNSS-RTK.txt", week=WEEK)
    np.testing.assert_allclose(fixes.vel_cov_e[0], 0.0025 * np.eye(3), atol=1e-15)
    assert np.linalg.norm(fixes.vel_e, axis=1) == pytest.approx(10.0)
    write(folder / "GNSS-RTK.txt", np.column_stack([table, truth[:, [6, 5, 7]], std]))
    with pytest.raises(DataError, match="east before north"):
        read_gnss(folder / "GNSS-RTK.txt", week=WEEK)


def test_rates_instead_of_increments_are_refused(folder):
    table = np.loadtxt(folder / "ADIS.txt")
    table[:, 1:] *= HZ
    write(folder / "ADIS.txt", table)
    assert not is_kfgins(folder)
    with pytest.raises(DataError, match=r"no imu text .* rates and others go by sequence\.toml"):
        read_kfgins(folder)


def test_axes_that_are_not_forward_right_down_are_refused(folder):
    table = np.loadtxt(folder / "ADIS.txt")
    table[:, [3, 6]] *= -1.0  # z up
    write(folder / "ADIS.txt", table)
    with pytest.raises(DataError, match="expected up = −z"):
        read_kfgins(folder)


def test_week_and_zero_deviations(folder):
    nav = np.loadtxt(folder / "truth.nav")
    with pytest.raises(DataError, match="GPS week: expected 2100 as declared, found 2017"):
        read_nav(folder / "truth.nav", week=2100)
    nav[:, 0] = 0
    write(folder / "truth.nav", nav)
    assert read_nav(folder / "truth.nav", week=2100).week == 2100
    table = np.loadtxt(folder / "GNSS-RTK.txt")
    table[4, 5] = 0.0
    write(folder / "GNSS-RTK.txt", table)
    with pytest.raises(DataError, match=r"GNSS-RTK\.txt:5: standard deviations"):
        read_gnss(folder / "GNSS-RTK.txt", week=WEEK)


def test_two_imus_in_one_folder_ask_for_one(folder):
    (folder / "other.txt").write_text((folder / "ADIS.txt").read_text())
    with pytest.raises(ConfigError, match="several imu files"):
        read_kfgins(folder)


def test_what_this_program_writes_is_read_back(tmp_path):
    """`nav.results.formats.write_nav` writes a KF-GINS result."""
    from certnav.nav.results.formats import write_nav
    from certnav.nav.solution import Epochs, Trajectory

    n, rng = 20, np.random.default_rng(3)
    time = WEEK * 604800.0 + SOW + np.arange(n)
    pos_e = lla_to_ecef(LAT, LON, 20.0) + np.outer(np.arange(n), [1.0, 2.0, 0.5])
    angles = rng.uniform(-0.3, 0.3, (n, 3))
    from certnav.filters.rotation import matrix_from_rpy

    zero = np.zeros((n, 3))
    trajectory = Trajectory(
        time=time, pos_e=pos_e, vel_e=np.tile([1.0, 2.0, 0.5], (n, 1)),
        C_eb=C_en_of(pos_e) @ matrix_from_rpy(angles), gyro_bias=zero, accel_bias=zero,
        cov_pos_n=np.tile(np.eye(3), (n, 1, 1)), cov_vel_n=np.tile(np.eye(3), (n, 1, 1)),
        cov_att_n=np.tile(np.eye(3), (n, 1, 1)), std_gyro_bias=zero, std_accel_bias=zero,
    )  # fmt: skip
    write_nav(tmp_path / "r.nav", trajectory, Epochs(time, np.ones(n, int), np.ones(n, int)))
    found = read_nav(tmp_path / "r.nav")
    np.testing.assert_allclose(found.pos_e, pos_e, atol=1e-3)
    np.testing.assert_allclose(found.vel_e, trajectory.vel_e, atol=1e-4)
    difference = (found.rpy - angles + np.pi) % (2.0 * np.pi) - np.pi
    np.testing.assert_allclose(difference, 0.0, atol=1e-6)


@pytest.mark.parametrize("rate", [4, 10, 20, 50, 200])
def test_kinds_are_told_at_any_rate(tmp_path, rate):
    """By what the columns hold: increments of gravity, or a place with its deviations."""
    time = 180000.0 + np.arange(30) / rate
    imu = np.column_stack([time, np.full((30, 5), 1e-4), np.full(30, -9.8 / rate)])
    gnss = np.column_stack([time, np.tile([30.5, 114.3, 25.0, 0.1, 0.1, 0.2], (30, 1))])
    np.savetxt(tmp_path / "imu.txt", imu, fmt="%.9f")
    np.savetxt(tmp_path / "gnss.pos", gnss, fmt="%.9f")
    assert kind_of(tmp_path / "gnss.pos") == "gnss"
    assert kind_of(tmp_path / "imu.txt") == ("imu" if rate > 4 else "")
