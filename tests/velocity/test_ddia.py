"""DDIA-VE against exact range rates, closed-form covariances and finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.observations import GnssObservations
from certnav.filters.earth import C_en_of, lla_to_ecef
from certnav.filters.errors import ConfigError
from certnav.filters.rotation import matrix_from_rotvec, matrix_from_rpy
from certnav.velocity.ddia import (
    ddia_pair,
    ddia_velocities,
    ddia_velocity,
    drift_free,
    ndia_velocity,
)
from certnav.velocity.range_rate import DopplerNoise, doppler_rows, predicted_range_rate
from certnav.velocity.vehicle_motion import forward_motion

ANTENNA = lla_to_ecef(np.radians(30.53), np.radians(114.36), 35.0)
C_EN = C_en_of(ANTENNA)
LEVER_A, LEVER_V = np.array([-0.65, -0.05, -0.15]), np.array([-1.2, 0.1, 0.9])
EXACT = DopplerNoise(0.0, 0.05)


def sky(rng, n):
    """Satellite positions, velocities and drifts of n satellites above 10° elevation."""
    azimuth, elevation = rng.uniform(0, 2 * np.pi, n), rng.uniform(np.radians(10), np.pi / 2, n)
    cos = np.cos(elevation)
    e_n = np.stack([cos * np.cos(azimuth), cos * np.sin(azimuth), -np.sin(elevation)], -1)
    pos = ANTENNA + rng.uniform(2.0e7, 2.5e7, n)[:, None] * (e_n @ C_EN.T)
    sideways = np.cross(pos, rng.standard_normal((n, 3)))
    vel = 2700.0 * sideways / np.linalg.norm(sideways, axis=1)[:, None]
    return pos, vel, rng.uniform(-1e-2, 1e-2, n)


class Car:
    """A car with a tilted IMU, turning, with lever arms to antenna and rear axle."""

    def __init__(self, rng, speed=None):
        self.C_eb = C_EN @ matrix_from_rpy([*np.radians(rng.normal(0, 3, 2)), rng.uniform(-3, 3)])
        self.C_bv = matrix_from_rpy(np.radians(rng.normal(0, 1.5, 3)))
        self.omega_b = np.radians(rng.normal(0, 20, 3))
        self.speed = rng.uniform(-20, 25) if speed is None else speed
        axle_b = self.C_bv[:, 0] * self.speed
        self.vel_e = self.C_eb @ (axle_b + np.cross(self.omega_b, LEVER_A - LEVER_V))
        self.drift = rng.uniform(-300, 300)

    def motion(self, C_eb=None, **options):
        return forward_motion(
            self.C_eb if C_eb is None else C_eb, self.omega_b, LEVER_A,
            C_bv=self.C_bv, lever_vehicle_b=LEVER_V, **options,
        )  # fmt: skip

    def observe(self, rng, n, noise=0.0, cn0=None):
        pos, vel, drift = sky(rng, n)
        rate = predicted_range_rate(ANTENNA, self.vel_e, self.drift, pos, vel, drift)
        nan = np.full(n, np.nan)
        return GnssObservations(
            time=np.zeros(n), sat=[f"G{i + 1:02d}" for i in range(n)], signal=np.full(n, "1C"),
            wavelength=np.full(n, 0.19), pseudorange=nan, carrier=nan,
            range_rate=rate + noise * rng.standard_normal(n),
            cn0=np.full(n, 45.0) if cn0 is None else cn0, loss_of_lock=np.zeros(n),
            sat_pos_e=pos, sat_vel_e=vel, sat_clock=nan, sat_clock_drift=drift,
            elevation=nan, azimuth=nan, rejected=np.full(n, ""),
        )  # fmt: skip

    def rows(self, rng, n, noise=0.0):
        return doppler_rows(self.observe(rng, n, noise), ANTENNA, EXACT)


def test_equation_20_recovers_velocity_to_a_nanometre_per_second():
    rng = np.random.default_rng(1)
    worst, solved = 0.0, 0
    for _ in range(500):
        car = Car(rng)
        found = ddia_pair(car.rows(rng, 2), car.motion(), 0.0)
        if found.ok:
            solved += 1
            worst = max(worst, np.abs(found.vel_e - car.vel_e).max(), abs(found.speed - car.speed))
    assert solved > 400
    assert worst < 1e-9


def test_drift_is_recovered_with_the_speed():
    rng = np.random.default_rng(2)
    for _ in range(50):
        car = Car(rng)
        found = ddia_velocity(car.rows(rng, 5), car.motion(), 0.0)
        assert found.ok
        assert abs(found.clock_drift - car.drift) < 1e-9 * 3e2 + 1e-6
        assert abs(found.speed - car.speed) < 1e-9
        assert found.dof == 3
        assert found.chi2 < 1e-12


@pytest.mark.parametrize("speed", [0.0, -4.0])
def test_standing_and_reversing_are_nothing_special(speed):
    rng = np.random.default_rng(3)
    car = Car(rng, speed)
    found = ddia_velocity(car.rows(rng, 4), car.motion(), 0.0)
    assert found.ok
    assert found.speed == pytest.approx(speed, abs=1e-9)


def test_two_satellites_give_the_pair_and_order_does_not_matter():
    rng = np.random.default_rng(4)
    for _ in range(50):
        car = Car(rng)
        cn0 = rng.uniform(30, 50, 2)
        rows = doppler_rows(car.observe(rng, 2, 0.1, cn0), ANTENNA)
        motion = car.motion(att_cov_e=np.eye(3) * 1e-5, sigma_cross=0.1)
        pair = ddia_pair(rows, motion, 0.0)
        if not pair.ok:
            continue
        swapped = ddia_pair(rows.take(np.array([1, 0])), motion, 0.0)
        joint = ddia_velocity(rows, motion, 0.0)
        for other in (swapped, joint):
            assert other.speed == pytest.approx(pair.speed, abs=1e-9)
            assert other.clock_drift == pytest.approx(pair.clock_drift, abs=1e-8)
            assert other.sigma_clock_drift == pytest.approx(pair.sigma_clock_drift, rel=1e-9)
            assert other.k == pytest.approx(pair.k, rel=1e-9)
            np.testing.assert_allclose(other.cov_e, pair.cov_e, atol=1e-9, rtol=1e-7)


def test_sigma_of_a_pair_is_sqrt2_sigma_over_k():
    rng = np.random.default_rng(5)
    car = Car(rng)
    found = ddia_pair(car.rows(rng, 2), car.motion(), 0.0)
    assert found.sigma_doppler == pytest.approx(np.sqrt(2.0) * 0.05 / found.k, rel=1e-12)


def test_least_squares_is_the_k_squared_weighted_mean_of_all_pairs():
    rng = np.random.default_rng(6)
    car = Car(rng)
    rows, motion = car.rows(rng, 6, 0.05), car.motion()
    joint = ddia_velocity(rows, motion, 0.0, significance=1e-12)
    pairs = [
        ddia_pair(rows.take(np.array([i, j])), motion, 0.0, min_k=0.0)
        for i in range(6) for j in range(i)
    ]  # fmt: skip
    weight = np.array([p.k**2 for p in pairs])
    assert joint.speed == pytest.approx(weight @ [p.speed for p in pairs] / weight.sum(), abs=1e-9)


@pytest.mark.parametrize("n", [5, 8])
def test_least_squares_beats_the_mean_of_pairs_by_a_fifth(n):
    rng = np.random.default_rng(7)
    joint, mean = [], []
    for _ in range(400):
        car = Car(rng)
        rows, motion = car.rows(rng, n, 0.05), car.motion()
        found = ddia_velocity(rows, motion, 0.0, significance=1e-9)
        h = rows.e_e @ motion.u_e
        y = rows.z - rows.e_e @ motion.swing_e
        a, b = np.triu_indices(n, 1)
        k = h[a] - h[b]
        regular = np.abs(k) > 0.05
        joint.append(found.speed - car.speed)
        mean.append(np.mean((y[a] - y[b])[regular] / k[regular]) - car.speed)
    assert np.std(joint) < 0.8 * np.std(mean)


def test_covariance_is_what_noise_does():
    rng = np.random.default_rng(8)
    car = Car(rng, 15.0)
    clean = car.rows(rng, 4)
    motion = car.motion()
    found = []
    for _ in range(4000):
        noisy = clean.z + 0.05 * rng.standard_normal(4)
        rows = type(clean)(clean.row, clean.sat, clean.e_e, noisy, clean.sigma)
        one = ddia_velocity(rows, motion, 0.0, significance=1e-12)
        found.append([one.speed, one.clock_drift])
    exact = ddia_velocity(clean, motion, 0.0)
    spread = np.std(found, axis=0)
    assert spread[0] == pytest.approx(exact.sigma_doppler, rel=0.05)
    assert spread[1] == pytest.approx(exact.sigma_clock_drift, rel=0.05)


@pytest.mark.parametrize("n", [1, 2, 5])
def test_attitude_share_is_the_derivative_with_respect_to_attitude(n):
    rng = np.random.default_rng(9)
    car = Car(rng, 18.0)
    rows = car.rows(rng, n)

    def solve(C_eb, **options):
        motion = car.motion(C_eb, **options)
        if n == 1:
            return ndia_velocity(rows, motion, 0.0, car.drift, 0.0, min_k=0.0)
        return ddia_velocity(rows, motion, 0.0, min_k=0.0, significance=1e-300)

    cov = np.diag(np.radians([0.3, 0.2, 0.6]) ** 2)
    exact = solve(car.C_eb, att_cov_e=cov)
    h = 1e-6
    by_differences = np.column_stack(
        [
            (solve(matrix_from_rotvec(h * axis) @ car.C_eb).vel_e
             - solve(matrix_from_rotvec(-h * axis) @ car.C_eb).vel_e) / (2 * h)
            for axis in np.eye(3)
        ]
    )  # fmt: skip
    np.testing.assert_allclose(
        exact.attitude_e, by_differences, atol=2e-5 * abs(exact.speed) / exact.k
    )
    np.testing.assert_allclose(
        exact.cov_e - exact.noise_cov_e,
        by_differences @ cov @ by_differences.T,
        rtol=1e-3,
        atol=1e-7,
    )
    along = exact.attitude_e.T @ car.motion().u_e
    # Turning u_e changes no length: along u_e only the speed's error shows (swing adds ω × l).
    assert exact.sigma_attitude == pytest.approx(np.sqrt(along @ cov @ along), rel=0.1)


def test_sideways_velocity_is_what_sigma_cross_expects():
    rng = np.random.default_rng(10)
    car = Car(rng, 12.0)
    rows, motion = car.rows(rng, 3), car.motion(sigma_cross=0.2)
    exact = ddia_velocity(rows, motion, 0.0)
    drawn = []
    across = np.linalg.svd(motion.u_e[None])[2][1:]
    for _ in range(3000):
        slip_e = 0.2 * rng.standard_normal(2) @ across
        z = rows.z + rows.e_e @ slip_e
        rows_slip = type(rows)(rows.row, rows.sat, rows.e_e, z, rows.sigma)
        found = ddia_velocity(rows_slip, motion, 0.0, significance=1e-300)
        drawn.append(found.vel_e - car.vel_e - slip_e)
    noise_free = exact.noise_cov_e - exact.sigma_doppler**2 * np.outer(motion.u_e, motion.u_e)
    scale = np.trace(noise_free)
    np.testing.assert_allclose(np.cov(np.array(drawn).T), noise_free, atol=0.08 * scale)


def test_drift_free_rows_do_not_know_the_clock_and_lose_nothing_else():
    rng = np.random.default_rng(11)
    car = Car(rng)
    rows = car.rows(rng, 5, 0.05)
    free = drift_free(rows)
    assert free.e_e.shape == (4, 3)
    # Generalised least squares of the differences equals least squares with the drift as unknown.
    motion = car.motion()
    h = free.e_e @ motion.u_e
    y = free.z - free.e_e @ motion.swing_e
    weight = np.linalg.inv(free.cov)
    speed = (h @ weight @ y) / (h @ weight @ h)
    found = ddia_velocity(rows, motion, 0.0, significance=1e-300)
    assert speed == pytest.approx(found.speed, abs=1e-9)
    assert (h @ weight @ h) ** -0.5 == pytest.approx(
        found.sigma_doppler / np.sqrt(found.variance_factor)
    )
    with pytest.raises(ConfigError, match="≥ 2 rows, found 1"):
        drift_free(rows.take(slice(0, 1)))


def test_one_satellite_with_known_drift():
    rng = np.random.default_rng(12)
    for _ in range(50):
        car = Car(rng)
        rows = car.rows(rng, 1)
        found = ndia_velocity(rows, car.motion(), 0.0, car.drift, 0.3)
        if not found.ok:
            continue
        assert found.speed == pytest.approx(car.speed, abs=1e-9)
        assert found.sigma_doppler == pytest.approx(np.hypot(0.05, 0.3) / found.k)


def test_geometry_without_information_is_refused():
    rng = np.random.default_rng(13)
    car = Car(rng)
    rows = car.rows(rng, 2)
    same = rows.take(np.array([0, 0]))
    assert ddia_pair(same, car.motion(), 0.0).status == "singular geometry"
    assert ddia_velocity(same, car.motion(), 0.0).status == "singular geometry"
    assert ddia_velocity(rows.take(slice(0, 1)), car.motion(), 0.0).status == "too few satellites"
    k = ddia_pair(rows, car.motion(), 0.0, min_k=0.0).k
    assert ddia_pair(rows, car.motion(), 0.0, min_k=k * 1.001).status == "singular geometry"
    assert ddia_pair(rows, car.motion(), 0.0, min_k=k * 0.999).ok


def test_no_velocity_is_nan_of_the_shape_it_would_have():
    """Results of epochs are stacked: one without a velocity must not change what comes out."""
    rng = np.random.default_rng(17)
    car = Car(rng)
    rows = car.rows(rng, 4)
    found, nothing = (ddia_velocity(r, car.motion(), 3.0) for r in (rows, rows.take(slice(0, 1))))
    assert found.ok and not nothing.ok and nothing.time == 3.0
    for name in ("vel_e", "cov_e", "noise_cov_e", "attitude_e"):
        assert getattr(nothing, name).shape == getattr(found, name).shape
        assert np.isnan(getattr(nothing, name)).all()
    for name in ("speed", "sigma_doppler", "sigma_attitude", "clock_drift", "k", "chi2"):
        assert np.isnan(getattr(nothing, name))
    assert np.isnan(nothing.sigma_clock_drift) and np.isnan(nothing.variance_factor)
    assert nothing.satellites == nothing.rejected == () and nothing.dof == 0
    assert nothing.row.dtype == found.row.dtype
    assert nothing.row.size == nothing.residuals.size == 0


def test_a_reflected_signal_is_found_and_named():
    rng = np.random.default_rng(14)
    car = Car(rng)
    rows = car.rows(rng, 6)
    z = rows.z.copy()
    z[2] += 4.0
    faulty = type(rows)(rows.row, rows.sat, rows.e_e, z, rows.sigma)
    found = ddia_velocity(faulty, car.motion(), 0.0)
    assert found.rejected == (2,)
    assert found.speed == pytest.approx(car.speed, abs=1e-8)
    three = ddia_velocity(faulty.take(slice(0, 3)), car.motion(), 0.0)
    assert three.status == "inconsistent"


def test_all_epochs_at_once_are_the_epochs_one_by_one():
    rng = np.random.default_rng(15)
    car, other = Car(rng), Car(rng)
    first, second = car.observe(rng, 3), other.observe(rng, 4)
    values = {
        name: np.concatenate([getattr(first, name), getattr(second, name)])
        for name in first.__dataclass_fields__
    }
    values["time"] = np.r_[np.zeros(3), np.ones(4)]
    both = GnssObservations(**values).mark(np.arange(7) == 6, "weak signal")
    a, b = car.motion(), other.motion()
    motion = type(a)(np.array([a.u_e, b.u_e]), np.array([a.swing_e, b.swing_e]), a.att_cov_e)
    found = ddia_velocities(both, ANTENNA, motion)
    assert [f.time for f in found] == [0.0, 1.0]
    assert list(found[1].row) == [3, 4, 5]
    np.testing.assert_allclose([f.speed for f in found], [car.speed, other.speed], atol=1e-8)


@pytest.mark.parametrize("solver, n", [(ddia_pair, 3), (ndia_velocity, 2)])
def test_wrong_number_of_satellites_is_refused(solver, n):
    rng = np.random.default_rng(16)
    car = Car(rng)
    extra = (0.0, 0.0) if solver is ndia_velocity else ()
    with pytest.raises(ConfigError, match=f"found {n}"):
        solver(car.rows(rng, n), car.motion(), 0.0, *extra)
