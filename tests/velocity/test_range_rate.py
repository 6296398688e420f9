"""Range rates against the derivative of a pseudorange that is computed without the model."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.observations import GnssObservations
from certnav.filters.earth import EARTH_RATE, SPEED_OF_LIGHT, C_en_of, lla_to_ecef
from certnav.filters.errors import ConfigError
from certnav.velocity.least_squares import doppler_velocities
from certnav.velocity.range_rate import (
    DopplerNoise,
    doppler_rows,
    elevation_azimuth,
    line_of_sight,
    predicted_range_rate,
    with_elevation,
)

ANTENNA = lla_to_ecef(np.radians(30.53), np.radians(114.36), 35.0)


def turned(vector, angle):
    """Return `vector` after the axes have turned by `angle` about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] + s * vector[1], c * vector[1] - s * vector[0], vector[2]])


class Satellite:
    """Circular inertial orbit with a linear clock; everything in closed form."""

    def __init__(self, node, phase, clock, drift):
        self.node, self.phase, self.clock, self.drift = node, phase, clock, drift
        self.radius, self.inclination = 26.56e6, np.radians(55.0)
        self.rate = np.sqrt(3.986004418e14 / self.radius**3)

    def pos_e(self, t):
        u, c, s = self.phase + self.rate * t, np.cos(self.inclination), np.sin(self.inclination)
        plane = self.radius * np.array([np.cos(u), c * np.sin(u), s * np.sin(u)])
        return turned(turned(plane, -self.node), EARTH_RATE * t)

    def vel_e(self, t):
        u, c, s = self.phase + self.rate * t, np.cos(self.inclination), np.sin(self.inclination)
        plane = self.radius * self.rate * np.array([-np.sin(u), c * np.cos(u), s * np.cos(u)])
        moving = turned(turned(plane, -self.node), EARTH_RATE * t)
        return moving - np.cross([0.0, 0.0, EARTH_RATE], self.pos_e(t))

    def pseudorange(self, label, receiver):
        """Return c·(reception label − transmission label) [m] and the transmission time."""
        t = (label - receiver.clock) / (1.0 + receiver.drift)
        flight = 0.075
        for _ in range(12):
            seen = turned(self.pos_e(t - flight), EARTH_RATE * flight)
            flight = np.linalg.norm(seen - receiver.pos_e(t)) / SPEED_OF_LIGHT
        sent = t - flight
        sent_label = sent + self.clock + self.drift * sent
        return SPEED_OF_LIGHT * (label - sent_label), sent

    def counted_rate(self, receiver, h=0.25):
        """Return d(pseudorange)/d(receiver time) at label 0, five-point difference."""
        p = [self.pseudorange(k * h, receiver)[0] for k in (-2, -1, 1, 2)]
        return (p[0] - 8.0 * p[1] + 8.0 * p[2] - p[3]) / (12.0 * h)


class Receiver:
    def __init__(self, vel_e, drift=0.0, clock=3e-4):
        self.vel_e, self.drift, self.clock = np.asarray(vel_e, dtype=float), drift, clock

    def pos_e(self, t):
        return ANTENNA + self.vel_e * t


@pytest.fixture(scope="module")
def satellites():
    rng = np.random.default_rng(7)
    up = ANTENNA / np.linalg.norm(ANTENNA)
    found = []
    while len(found) < 9:
        drift = rng.uniform(-2e-11, 2e-11)
        sat = Satellite(*rng.uniform(0.0, 2.0 * np.pi, 2), rng.uniform(-5e-4, 5e-4), drift)
        sight = sat.pos_e(0.0) - ANTENNA
        if sight @ up > np.sin(np.radians(15.0)) * np.linalg.norm(sight):
            found.append(sat)
    return found


def observed(satellites, receiver):
    """Return one epoch whose range rates are finite differences, and the antenna position."""
    n = len(satellites)
    t = -receiver.clock / (1.0 + receiver.drift)
    sent = [s.pseudorange(0.0, receiver)[1] for s in satellites]
    nan = np.full(n, np.nan)
    observations = GnssObservations(
        time=np.zeros(n),
        sat=np.array([f"G{k + 1:02d}" for k in range(n)]),
        signal=np.full(n, "1C"),
        wavelength=np.full(n, SPEED_OF_LIGHT / 1575.42e6),
        pseudorange=[s.pseudorange(0.0, receiver)[0] for s in satellites],
        carrier=nan,
        range_rate=[s.counted_rate(receiver) for s in satellites],
        cn0=np.full(n, 45.0),
        loss_of_lock=np.zeros(n, dtype=int),
        sat_pos_e=[s.pos_e(ts) for s, ts in zip(satellites, sent, strict=True)],
        sat_vel_e=[s.vel_e(ts) for s, ts in zip(satellites, sent, strict=True)],
        sat_clock=[SPEED_OF_LIGHT * (s.clock + s.drift * 0.0) for s in satellites],
        sat_clock_drift=[SPEED_OF_LIGHT * s.drift for s in satellites],
        elevation=nan,
        azimuth=nan,
        rejected=np.full(n, ""),
    )
    return observations, receiver.pos_e(t)


@pytest.mark.parametrize("drift", [0.0, 1e-6, -3e-6])
@pytest.mark.parametrize("vel_e", [(0.0, 0.0, 0.0), (-25.0, 8.0, 3.0)])
def test_prediction_is_the_derivative_of_the_pseudorange(satellites, vel_e, drift):
    receiver = Receiver(vel_e, drift)
    obs, pos_e = observed(satellites, receiver)
    predicted = predicted_range_rate(
        pos_e,
        receiver.vel_e,
        SPEED_OF_LIGHT * drift,
        obs.sat_pos_e,
        obs.sat_vel_e,
        obs.sat_clock_drift,
    )
    np.testing.assert_allclose(obs.range_rate, predicted, atol=2e-6)


@pytest.mark.parametrize("drift", [0.0, 1e-6, -3e-6])
def test_rows_hold_exactly_for_differenced_pseudoranges(satellites, drift):
    receiver = Receiver((-25.0, 8.0, 3.0), drift)
    obs, pos_e = observed(satellites, receiver)
    rows = doppler_rows(obs, pos_e)
    np.testing.assert_allclose(
        rows.z, rows.e_e @ receiver.vel_e - SPEED_OF_LIGHT * drift, atol=2e-6
    )
    np.testing.assert_allclose(np.linalg.norm(rows.e_e, axis=1), 1.0, atol=1e-5)


def test_jacobian_is_line_of_sight_and_minus_one(satellites):
    """Central differences of the counted rate, no model: −λD falls along e, grows with drift."""
    obs, pos_e = observed(satellites, Receiver(np.zeros(3)))
    e_e = line_of_sight(pos_e, obs.sat_pos_e, obs.sat_vel_e).e_e
    step = 20.0
    for axis in np.eye(3):
        high, low = Receiver(step * axis), Receiver(-step * axis)
        slope = [(s.counted_rate(high) - s.counted_rate(low)) / (2.0 * step) for s in satellites]
        np.testing.assert_allclose(slope, -e_e @ axis, atol=2e-5)
    high, low = Receiver(np.zeros(3), 1e-7), Receiver(np.zeros(3), -1e-7)
    change = [s.counted_rate(high) - s.counted_rate(low) for s in satellites]
    np.testing.assert_allclose(np.array(change) / (2e-7 * SPEED_OF_LIGHT), 1.0, atol=1e-5)


def test_velocity_comes_back_from_differenced_pseudoranges(satellites):
    receiver = Receiver((-25.0, 8.0, 3.0), 4e-7)
    obs, pos_e = observed(satellites, receiver)
    (found,) = doppler_velocities(obs, pos_e)
    assert found.ok and found.dof == 5
    np.testing.assert_allclose(found.vel_e, receiver.vel_e, atol=1e-5)
    assert found.clock_drift == pytest.approx(SPEED_OF_LIGHT * 4e-7, abs=1e-5)


def test_velocity_comes_back_from_predictions_to_rounding(satellites):
    vel_e, drift = np.array([-25.0, 8.0, 3.0]), 300.0
    obs, pos_e = observed(satellites, Receiver(vel_e))
    states = (obs.sat_pos_e, obs.sat_vel_e, obs.sat_clock_drift)
    obs = obs.with_columns(range_rate=predicted_range_rate(pos_e, vel_e, drift, *states))
    (found,) = doppler_velocities(obs, pos_e)
    np.testing.assert_allclose(found.vel_e, vel_e, atol=1e-9)
    assert found.clock_drift == pytest.approx(drift, abs=1e-9)


def test_range_is_light_time_times_c(satellites):
    receiver = Receiver(np.zeros(3))
    obs, pos_e = observed(satellites, receiver)
    sight = line_of_sight(pos_e, obs.sat_pos_e, obs.sat_vel_e)
    t = -receiver.clock
    flight = [t - s.pseudorange(0.0, receiver)[1] for s in satellites]
    np.testing.assert_allclose(sight.range, SPEED_OF_LIGHT * np.array(flight), atol=1e-6)


def test_a_position_error_costs_what_the_docstring_says(satellites):
    obs, pos_e = observed(satellites, Receiver(np.zeros(3)))
    moved = doppler_rows(obs, pos_e + np.array([10.0, 0.0, 0.0])).z - doppler_rows(obs, pos_e).z
    assert 1e-4 < np.abs(moved).max() < 3e-3


def test_rows_know_what_a_position_error_does_to_them(satellites):
    """Against differences over 200 m, which see light time and the clocks' scale as well."""
    obs, pos_e = observed(satellites, Receiver(np.zeros(3)))
    rows = doppler_rows(obs, pos_e)
    steps = 100.0 * np.eye(3)
    found = np.stack(
        [(doppler_rows(obs, pos_e + d).z - doppler_rows(obs, pos_e - d).z) / 200.0 for d in steps],
        axis=1,
    )
    np.testing.assert_allclose(rows.z_by_pos, found, atol=1e-4 * np.abs(found).max())
    np.testing.assert_array_equal(rows.take(slice(1, 3)).z_by_pos, rows.z_by_pos[1:3])


def test_one_position_per_row_equals_one_for_all(satellites):
    obs, pos_e = observed(satellites, Receiver(np.zeros(3)))
    obs = obs.mark(np.arange(len(obs)) == 2, "test")
    one, each = doppler_rows(obs, pos_e), doppler_rows(obs, np.tile(pos_e, (len(obs), 1)))
    np.testing.assert_array_equal(one.z, each.z)
    # Compiled for the one place, by arrays for many: the same arithmetic.
    np.testing.assert_allclose(one.e_e, each.e_e, rtol=0, atol=1e-15)
    np.testing.assert_allclose(one.z_by_pos, each.z_by_pos, rtol=1e-12)
    assert 2 not in one.row and len(one) == len(obs) - 1


def test_elevation_and_azimuth_of_known_directions():
    elevation, azimuth = np.radians([5.0, 45.0, 89.0, 30.0]), np.radians([0.0, 90.0, 200.0, 359.0])
    north, east = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    e_n = np.stack([north, east, -np.sin(elevation)], axis=1)
    found = elevation_azimuth(e_n @ C_en_of(ANTENNA).T, ANTENNA)
    np.testing.assert_allclose(found[0], elevation, atol=1e-12)
    np.testing.assert_allclose(found[1] % (2 * np.pi), azimuth, atol=1e-9)


def test_with_elevation_fills_both_columns(satellites):
    obs, pos_e = observed(satellites, Receiver(np.zeros(3)))
    filled = with_elevation(obs, pos_e)
    assert (filled.elevation > np.radians(14.0)).all()
    assert np.isfinite(filled.azimuth).all()


def test_noise_model_is_thermal_above_its_floor():
    noise = DopplerNoise(sigma_45=0.1, floor=1e-6)
    np.testing.assert_allclose(noise.sigma([45.0, 25.0, 65.0]), [0.1, 1.0, 0.01], rtol=1e-6)
    assert noise.sigma(np.nan) == noise.sigma(noise.unknown_cn0)
    assert DopplerNoise(0.1, 0.2).sigma(90.0) == pytest.approx(0.2, rel=1e-4)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        ({"floor": 0.0}, "floor > 0"),
        ({"floor": np.nan}, "floor > 0"),
        ({"sigma_45": -0.01}, "sigma_45 ≥ 0"),
        ({"decade_db": 0.0}, "decade_db > 0"),
        ({"decade_db": -20.0}, "decade_db > 0"),
        ({"decade_db": np.nan}, "decade_db > 0"),
    ],
)
def test_noise_that_no_receiver_has_is_refused(noise, message):
    with pytest.raises(ConfigError, match=message):
        DopplerNoise(**noise)


def test_noise_may_be_the_floor_alone_and_fall_faster_than_thermal_noise():
    np.testing.assert_array_equal(DopplerNoise(0.0, 0.05).sigma([20.0, np.nan]), 0.05)
    steep = DopplerNoise(0.1, 1e-6, decade_db=10.0)
    np.testing.assert_allclose(steep.sigma([45.0, 35.0, 25.0]), [0.1, 1.0, 10.0], rtol=1e-6)
