"""Spirent set: range-rate model against a hardware simulator, and the IMU made from its truth."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.formats.instinct import is_spirent, read_spirent, smooth_trajectory
from certnav.datasets.rtklib import single_point
from certnav.filters.earth import OMEGA_IE_E, OMEGA_IE_SKEW, C_en_of, gravity_e
from certnav.filters.errors import ConfigError, DataError
from certnav.filters.rotation import matrix_from_rotvec, wrap_angle
from certnav.velocity.least_squares import doppler_velocities
from certnav.velocity.range_rate import line_of_sight, predicted_range_rate


@pytest.fixture(scope="module")
def vacuum(data_dir):
    return read_spirent(data_dir / "instinct" / "spirent_dynamic", atmosphere=False, seed=None)


def truth_at(reference, time):
    k = np.searchsorted(reference.time, time - 1e-3)
    assert np.abs(reference.time[k] - time).max() < 1e-6
    return reference.pos_e[k], reference.vel_e[k]


def without_epoch_median(residual, time):
    out = np.empty_like(residual)
    for t in np.unique(time):
        out[time == t] = residual[time == t] - np.median(residual[time == t])
    return out


@pytest.mark.parametrize(("system", "limit"), [("G", 0.40e-3), ("E", 0.30e-3)])
def test_range_rates_agree_with_the_simulator(vacuum, system, limit):
    """RMS 0.33 mm/s GPS, 0.21 mm/s Galileo; 0.48 and more without the light-time factor."""
    obs = vacuum.observations
    obs = obs.take(np.char.startswith(obs.sat, system) & obs.has_range_rate)
    pos_e, vel_e = truth_at(vacuum.reference, obs.time)
    states = (obs.sat_pos_e, obs.sat_vel_e, obs.sat_clock_drift)
    residual = obs.range_rate - predicted_range_rate(pos_e, vel_e, 0.0, *states)
    residual = without_epoch_median(residual, obs.time)
    assert len(obs) > 3000
    assert np.sqrt(np.mean(residual**2)) <= limit


def test_pseudoranges_agree_up_to_group_delay(vacuum):
    obs = vacuum.observations
    obs = obs.take(obs.usable)
    pos_e, _ = truth_at(vacuum.reference, obs.time)
    distance = line_of_sight(pos_e, obs.sat_pos_e, obs.sat_vel_e).range
    residual = obs.pseudorange - distance + obs.sat_clock
    for sat in np.unique(obs.sat):
        of_sat = residual[obs.sat == sat]
        assert of_sat.std() < 2e-3 and abs(of_sat.mean()) < 10.0


def test_single_point_is_exact_in_vacuum(vacuum):
    """RTKLIB applies the group delays: GPS positions are right to the millimetre."""
    spp = single_point(vacuum.observations, vacuum.navigation, ionosphere="off", troposphere="off")
    pos_e, _ = truth_at(vacuum.reference, spp.fixes.time)
    assert len(spp.fixes) == 601 and np.abs(spp.fixes.pos_e - pos_e).max() < 2e-3


def test_doppler_velocity_agrees_with_the_truth(vacuum):
    pos_e, _ = truth_at(vacuum.reference, vacuum.observations.time)
    found = doppler_velocities(vacuum.observations, pos_e)
    assert all(v.ok and not v.rejected for v in found)
    _, vel_e = truth_at(vacuum.reference, np.array([v.time for v in found]))
    assert np.sqrt(np.mean((np.array([v.vel_e for v in found]) - vel_e) ** 2)) < 0.5e-3


def test_imu_integrates_back_to_the_truth(vacuum):
    """Strapdown in ECEF over 60 s, written here: position to 0.01 mm, velocity to 1 µm/s."""
    imu, trajectory = vacuum.imu, smooth_trajectory(vacuum.reference)
    dt, steps = 0.01, 6000
    start = trajectory.kinematics(vacuum.reference.time[:1])
    C, v, p = start.C_eb[0], start.vel_e[0], start.pos_e[0]
    turn, half = matrix_from_rotvec(imu.gyro_b * dt), matrix_from_rotvec(imu.gyro_b * dt / 2)
    earth, earth_half = (matrix_from_rotvec(-OMEGA_IE_E * s) for s in (dt, dt / 2))
    for k in range(steps):
        f_e = earth_half @ C @ half[k] @ imu.accel_b[k]
        a = f_e + gravity_e(p + v * dt / 2) - 2.0 * OMEGA_IE_SKEW @ v
        a = a - 2.0 * OMEGA_IE_SKEW @ (a * dt / 2)
        p, v, C = p + v * dt + a * dt**2 / 2, v + a * dt, earth @ C @ turn[k]
    end = trajectory.kinematics(imu.time[steps - 1 : steps])
    np.testing.assert_allclose(p, end.pos_e[0], atol=1e-5)
    np.testing.assert_allclose(v, end.vel_e[0], atol=1e-6)
    np.testing.assert_allclose(C, end.C_eb[0], atol=2e-6)


def test_smooth_motion_stays_within_the_digits_of_the_file(vacuum):
    reference, trajectory = vacuum.reference, smooth_trajectory(vacuum.reference)
    k = trajectory.kinematics(reference.time)
    # uniform rounding to 0.1 mm has σ = 0.029 mm
    np.testing.assert_allclose((k.pos_e - reference.pos_e).std(0), 2.9e-5, rtol=0.1)
    assert (k.vel_e - reference.vel_e).std() < 1e-3
    assert np.degrees(wrap_angle(trajectory.rpy(reference.time) - reference.rpy)).std() < 0.02


def test_heading_is_the_course_clockwise_from_north(vacuum):
    reference = vacuum.reference
    vel_n = np.einsum("nji,nj->ni", C_en_of(reference.pos_e), reference.vel_e)
    course = np.arctan2(vel_n[:, 1], vel_n[:, 0])
    assert np.ptp(np.unwrap(course)) > 2.0 * np.pi
    assert np.abs(np.degrees(wrap_angle(course - reference.rpy[:, 2]))).max() < 0.01


def test_turning_right_is_positive_about_down_and_pushes_right(vacuum):
    """Signs of the made IMU: z down reads −g, and in a turn f_right = v·ω_down."""
    imu, reference = vacuum.imu, vacuum.reference
    assert imu.accel_b[:, 2].mean() == pytest.approx(-9.81, abs=0.02)
    speed = np.interp(imu.time, reference.time, np.linalg.norm(reference.vel_e, axis=1))
    np.testing.assert_allclose(imu.accel_b[:, 1], speed * imu.gyro_b[:, 2], atol=5e-3)


def test_errors_are_seeded(data_dir):
    folder = data_dir / "instinct" / "spirent_dynamic"
    one, same, other = (read_spirent(folder, seed=s, rate=50.0, systems="G") for s in (1, 1, 2))
    np.testing.assert_array_equal(one.imu.gyro_b, same.imu.gyro_b)
    assert np.abs(one.imu.gyro_b - other.imu.gyro_b).max() > 0.0
    assert one.imu.interval == pytest.approx(0.02)
    assert one.name != read_spirent(folder, atmosphere=False, seed=1, systems="G").name


def test_atmosphere_slows_the_code(data_dir, vacuum):
    air = read_spirent(data_dir / "instinct" / "spirent_dynamic", seed=None).observations
    pos_e, _ = truth_at(vacuum.reference, air.time)
    distance = line_of_sight(pos_e, air.sat_pos_e, air.sat_vel_e).range
    delay = (air.pseudorange - distance + air.sat_clock)[air.usable]
    assert 5.0 < np.median(delay) < 60.0


def test_detection_and_refusals(data_dir, tmp_path):
    folder = data_dir / "instinct" / "spirent_dynamic"
    assert is_spirent(folder) and not is_spirent(tmp_path)
    with pytest.raises(DataError, match="name the folder spirent_dynamic"):
        read_spirent(tmp_path)
    with pytest.raises(ConfigError, match="IMU preset"):
        read_spirent(folder, imu="adis1647")
    with pytest.raises(ConfigError, match="> 0 Hz"):
        read_spirent(folder, rate=0.0)
    (tmp_path / "Rover-dynamic_motion_Spirent.csv").write_text("1,2\nTime_ms,Pos_X\n0,1\n")
    with pytest.raises(DataError, match="expected a Spirent motion file") as caught:
        read_spirent(tmp_path)
    assert "\n" not in str(caught.value)
