"""Simulated data against independent models: RTKLIB, the strapdown integration, closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets import rtklib
from certnav.datasets.simulation.canyon import City
from certnav.datasets.simulation.constellation import write_navigation
from certnav.datasets.simulation.signals import ReceiverClock, open_sky_cn0, range_rate_sigma
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import EARTH_RATE, OMEGA_IE_E, SPEED_OF_LIGHT, C_en_of
from certnav.filters.errors import ConfigError
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream, NavState, integrate


@pytest.fixture(scope="module")
def exact():
    """Ten minutes without any error but those physics demands."""
    return simulate(SimulationConfig(duration=600.0, density="open", noise=False, seed=3))


@pytest.fixture(scope="module")
def urban():
    return simulate(SimulationConfig(duration=900.0, seed=0))


def antenna(simulation, time):
    """Antenna motion at epochs of the receiver's clock."""
    lever_b = simulation.config.lever_antenna_b
    return simulation.trajectory.kinematics(time, lever_b, -simulation.clock.bias(time))


def geometry(simulation):
    """Line of sight, inertial satellite and receiver velocity in reception axes, per row."""
    o = simulation.observations
    epoch, row = np.unique(o.time, return_inverse=True)
    k = antenna(simulation, epoch)
    pos_e, vel_e = k.pos_e[row], k.vel_e[row]
    flight = np.full(len(o), 0.075)
    for _ in range(4):
        c, s = np.cos(EARTH_RATE * flight), np.sin(EARTH_RATE * flight)

        def turn(v, c=c, s=s):
            return np.stack([c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0], v[:, 2]], -1)

        sight = turn(o.sat_pos_e) - pos_e
        flight = np.linalg.norm(sight, axis=1) / SPEED_OF_LIGHT
    line = sight / np.linalg.norm(sight, axis=1)[:, None]
    satellite = turn(o.sat_vel_e) + np.cross(OMEGA_IE_E, turn(o.sat_pos_e))
    return line, satellite, vel_e + np.cross(OMEGA_IE_E, pos_e), vel_e


def range_rates(simulation):
    """The textbook range rate with first-order light-time factor, for comparison."""
    o = simulation.observations
    line, satellite, receiver, _ = geometry(simulation)
    closing = (line * (satellite - receiver)).sum(1)
    rate = closing / (1.0 + (line * satellite).sum(1) / SPEED_OF_LIGHT)
    drift = SPEED_OF_LIGHT * simulation.clock.drift(o.time)
    return rate + drift - o.sat_clock_drift


def strapdown_errors(simulation):
    """Largest position [m], velocity [m/s] and attitude [deg] error of unaided integration."""
    imu = simulation.imu
    k = simulation.trajectory.kinematics(imu.time[:1])
    start = NavState(imu.time[0], k.pos_e[0], k.vel_e[0], k.C_eb[0])
    rows = integrate(InertialStream(imu.time, imu.gyro_b, imu.accel_b), start)
    assert rows[-1, 0] - rows[0, 0] > simulation.config.duration - 0.1
    truth = simulation.trajectory.kinematics(rows[:, 0])
    turn = np.swapaxes(truth.C_eb, 1, 2) @ rows[:, 7:16].reshape(-1, 3, 3)
    angle = np.linalg.norm(turn - np.eye(3), axis=(1, 2)) / np.sqrt(2.0)
    return (
        np.linalg.norm(rows[:, 1:4] - truth.pos_e, axis=1).max(),
        np.linalg.norm(rows[:, 4:7] - truth.vel_e, axis=1).max(),
        np.degrees(angle.max()),
    )


def test_strapdown_alone_reproduces_ten_minutes(exact):
    position, velocity, attitude = strapdown_errors(exact)
    assert position < 0.015 and velocity < 1e-4 and attitude < 1e-4


def test_what_is_left_is_the_integration_not_the_data(exact):
    """The strapdown algorithm's own error falls with the square of the interval."""
    config = dataclasses.replace(exact.config, duration=200.0)
    slow, fast = (
        strapdown_errors(simulate(dataclasses.replace(config, imu_rate=rate)))[0]
        for rate in (100.0, 400.0)
    )
    assert fast < 5e-4 and slow / fast > 8.0


def test_single_point_positions_are_exact(exact, tmp_path):
    """Light time, Sagnac, relativity, clocks, group delay and atmosphere all cancel in RTKLIB."""
    time = exact.observations.time
    nav = tmp_path / "nav.rnx"
    write_navigation(nav, exact.ephemerides, time[0], time[-1])
    few = exact.observations.take(time % 10 == 0)
    point = rtklib.single_point(few, [nav])
    assert len(point.fixes) == 61 and not point.failed
    truth = antenna(exact, point.fixes.time).pos_e
    assert np.linalg.norm(point.fixes.pos_e - truth, axis=1).max() < 0.003
    bias = SPEED_OF_LIGHT * exact.clock.bias(point.fixes.time)
    np.testing.assert_allclose(point.clock, bias, atol=0.003)
    assert np.abs(bias).max() > 100.0


def test_satellite_states_are_those_rtklib_computes(exact, tmp_path):
    o = exact.observations.take(slice(0, 200))
    nav = tmp_path / "nav.rnx"
    write_navigation(nav, exact.ephemerides, o.time[0], o.time[-1])
    sent = o.time - (o.pseudorange + o.sat_clock) / SPEED_OF_LIGHT
    states = rtklib.satellite_states([nav], o.sat, sent)
    np.testing.assert_allclose(o.sat_pos_e, states.pos_e, atol=2e-3)
    np.testing.assert_allclose(o.sat_vel_e, states.vel_e, atol=1e-5)
    np.testing.assert_allclose(o.sat_clock, states.clock, atol=1e-6)
    np.testing.assert_allclose(o.sat_clock_drift, states.clock_drift, atol=1e-9)


def test_doppler_is_the_range_rate_without_atmosphere():
    bare = simulate(
        SimulationConfig(duration=300.0, density="open", noise=False, atmosphere=False, seed=2)
    )
    error = bare.observations.range_rate - range_rates(bare)
    assert np.abs(error).max() < 3e-4  # second order: clock rate 1e-8 times 800 m/s, v²/c
    assert np.ptp(bare.observations.range_rate) > 500.0


def test_carrier_phase_is_the_integral_of_the_doppler(exact):
    o = exact.observations
    for sat in np.unique(o.sat)[:4]:
        rows = o.sat == sat
        phase = o.carrier[rows] * o.wavelength[rows]
        rate = o.range_rate[rows]
        arc = ~(o.loss_of_lock[rows][1:] > 0)
        trapezoid = 0.5 * (rate[1:] + rate[:-1])
        # the trapezoid's own error is jerk/12: a car's 3 m/s³ makes 0.25 m
        assert np.abs(np.diff(phase) - trapezoid)[arc].max() < 0.3
        assert abs((np.diff(phase) - trapezoid)[arc].mean()) < 0.005


def test_atmosphere_delays_code_and_advances_phase(exact):
    bare = simulate(dataclasses.replace(exact.config, atmosphere=False))
    code = exact.observations.pseudorange - bare.observations.pseudorange
    phase = (exact.observations.carrier - bare.observations.carrier) * bare.observations.wavelength
    ionosphere, troposphere = 0.5 * (code - phase), 0.5 * (code + phase)
    assert ionosphere.min() > 1.4 and 2.2 < troposphere.min() < 2.8
    low = exact.observations.elevation < np.radians(10.0)
    assert troposphere[low].min() > 12.0


def test_doppler_noise_is_as_documented(urban):
    o = urban.observations
    direct = urban.signals.path == "direct"
    z = ((o.range_rate - range_rates(urban)) / range_rate_sigma(o.cn0))[direct]
    assert z.size > 2000
    assert z.std() == pytest.approx(1.0, abs=0.05) and abs(z.mean()) < 0.15
    assert np.corrcoef(np.abs(z), o.cn0[direct])[0, 1] == pytest.approx(0.0, abs=0.05)


def test_reflections_carry_the_doppler_of_their_mirror():
    """Extra path 2d(e·n), extra rate v·(e − e') with e' = e − 2(e·n)n the arriving direction."""
    s = simulate(SimulationConfig(duration=400.0, density="canyon", seed=1, nlos_probability=0.8))
    rows = s.signals.path == "reflected"
    assert not s.signals.extra_range[~rows].any()
    extra, rate = s.signals.extra_range[rows], s.signals.extra_rate[rows]
    o = s.observations.take(rows)
    line, _, _, vel_e = (v[rows] for v in geometry(s))

    trajectory, satellites = s.trajectory, len(s.ephemerides.sat)
    pos_t = (antenna(s, o.time).pos_e - trajectory.origin_e) @ trajectory.C_et
    angles = [np.tile(v[:, None], (1, satellites)) for v in (o.azimuth, o.elevation)]
    index = s.drive.block_at(o.time - s.config.start_time)
    sight = City("canyon", 1, 0.8).sight(s.drive.blocks, index, pos_t, *angles)
    pick = (np.arange(len(o)), np.array([int(name[1:]) - 1 for name in o.sat]))
    normal_e = sight.wall_normal[pick] @ trajectory.C_et.T
    depth = ((pos_t - sight.wall_point[pick]) * sight.wall_normal[pick]).sum(1)
    mirrored = line - 2.0 * (line * normal_e).sum(1)[:, None] * normal_e

    assert len(o) > 300
    np.testing.assert_allclose(extra, 2.0 * depth * (line * normal_e).sum(1), atol=1e-3)
    # the satellite's own motion turns e by 1e-4 rad/s: up to 1 cm/s on a path of 90 m
    np.testing.assert_allclose(rate, (vel_e * (line - mirrored)).sum(1), atol=0.01)
    assert extra.min() > 0.3 and extra.max() < 90.0
    assert np.abs(rate).max() > 8.0 and np.median(np.abs(rate)) < 0.1


def test_urban_satellites_come_and_go(urban):
    epochs = np.round(urban.observations.time - urban.config.start_time).astype(int)
    count = np.bincount(epochs, minlength=901)
    assert count.min() == 0 and count.max() >= 11
    assert np.isin([2, 3, 4, 5, 6, 7, 8, 9, 10], count).all()
    assert 0.05 < np.mean(count < 4) < 0.4
    weak = urban.signals.path != "direct"
    sky = open_sky_cn0(urban.observations.elevation)
    assert np.median((sky - urban.observations.cn0)[weak]) > 5.0
    assert abs(np.median((sky - urban.observations.cn0)[~weak])) < 1.0


def test_open_sky_has_eight_to_thirteen(exact):
    count = np.unique(exact.observations.time, return_counts=True)[1]
    assert count.size == 601 and count.min() >= 8 and count.max() <= 13


def test_receiver_clock_walks_smoothly():
    clock = ReceiverClock.draw(1e9, 3000.0, np.random.default_rng(4), noise=True)
    time = 1e9 + np.arange(0.0, 3000.0)
    h = 2.0**-6
    slope = (clock.bias(time, h) - clock.bias(time, -h)) / (2 * h)
    np.testing.assert_allclose(clock.drift(time), slope, atol=1e-13)
    assert np.diff(clock.drift(time)).std() == pytest.approx(1e-10, rel=0.5)
    assert np.abs(clock.bias(time)).max() < 1e-3


def test_true_biases_explain_the_measurements(urban):
    spec = imu_preset("adis16470")
    gyro, accel = urban.trajectory.imu_means(urban.imu.time[:20000])
    g = urban.imu.gyro_b[:20000] - gyro - urban.gyro_bias[:20000]
    a = urban.imu.accel_b[:20000] - accel - urban.accel_bias[:20000]
    assert np.abs(g.mean(0)).max() < 4 * spec.gyro_noise_density / np.sqrt(200.0)
    assert np.abs(a.mean(0)).max() < 4 * spec.accel_noise_density / np.sqrt(200.0)
    assert np.abs(urban.gyro_bias).max() > 1e-4


def test_parts_have_their_own_random_streams(exact):
    config = dataclasses.replace(exact.config, duration=60.0, noise=True)
    one, same = simulate(config), simulate(config)
    assert np.array_equal(one.imu.gyro_b, same.imu.gyro_b)
    assert np.array_equal(one.observations.pseudorange, same.observations.pseudorange)
    other = simulate(dataclasses.replace(config, imu="tactical"))
    assert np.array_equal(one.observations.range_rate, other.observations.range_rate)
    assert not np.array_equal(one.imu.gyro_b, other.imu.gyro_b)
    assert not np.array_equal(
        one.reference.pos_e, simulate(dataclasses.replace(config, seed=9)).reference.pos_e
    )


def test_mounting_and_vehicle_point_are_in_the_calibration(exact):
    config = dataclasses.replace(exact.config, duration=60.0, mounting_rpy_deg=(1.0, -2.0, 5.0))
    s = simulate(config)
    k = s.trajectory.kinematics(s.imu.time, s.calibration.lever_vehicle_b)
    vel_v = np.einsum("nji,nj->ni", k.C_eb @ s.calibration.C_bv, k.vel_e)
    assert np.abs(vel_v[:, 1:]).max() < 1e-4 and vel_v[:, 0].max() > 5.0
    sequence = s.sequence()
    assert sequence.reference.point == "imu" and len(sequence.observations) > 400
    down_n = C_en_of(k.pos_e[:1])[0].T @ k.C_eb[0] @ [0.0, 0.0, 1.0]
    assert 0.99 < down_n[2] < 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"duration": 1.0}, "at least 10 s"),
        ({"imu_rate": 0.0}, "imu_rate: expected a number > 0"),
        ({"density": "city"}, "unknown key 'city'"),
        ({"imu": "adis16477"}, "did you mean 'adis16470'"),
        ({"nlos_probability": 1.5}, "expected 0…1"),
    ],
)
def test_impossible_configurations_are_refused(change, message):
    with pytest.raises(ConfigError, match=message):
        SimulationConfig(**change)
