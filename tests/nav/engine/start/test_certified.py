"""From a window that passed to a start: where in it, how sure, and what else it takes."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from certnav.alignment.in_motion.rows import DopplerEpoch
from certnav.alignment.in_motion.waiting import Attempt
from certnav.alignment.levelling import InitialAttitude
from certnav.filters.rotation import matrix_from_rpy
from certnav.nav.config import AlignmentConfig
from certnav.nav.engine.events import GnssEvent
from certnav.nav.engine.start.certified import CertifiedStart
from certnav.nav.engine.start.fixes import Fixes
from certnav.nav.vehicles import VEHICLES
from certnav.velocity.range_rate import doppler_rows
from oracles import rigs

NORTH, EAST, DOWN = rigs.C_EN.T
STREAM = rigs.stream_at_rest(rigs.C_EN, 40.0)
LEVER = np.array([0.0, 0.0, -3.0])
ROWS = doppler_rows(rigs.sky(), rigs.PLACE)
DEG = np.pi / 180.0


def spread(*sigma):
    """A covariance with correlations and the given σ."""
    A = np.random.default_rng(len(sigma)).normal(size=(len(sigma),) * 2)
    cov = A @ A.T + np.eye(len(sigma))
    scale = np.asarray(sigma) / np.sqrt(np.diag(cov))
    return scale[:, None] * cov * scale


class Window:
    """Epochs 10 … 15 s; the heading at epoch k is good to `sigma[k]` degrees."""

    def __init__(self, sigma=(3.0, 2.0, 1.4, 1.0, 0.5, 0.4)):
        self.sigma, self.time, self.pos_e = np.asarray(sigma) * DEG, 15.0, rigs.PLACE
        self.track = SimpleNamespace(time=np.arange(10.0, 16.0))
        self.vel_e, self.accel_bias = 12.0 * NORTH, np.array([0.01, 0.02, 0.03])
        self.cov = spread(*[0.01] * 3, *[0.3] * 3, *[1e-4] * 3, *[1e-2] * 3)
        self.C_end = rigs.C_EN @ matrix_from_rpy([0.0, 0.0, 1.5])
        self.asked = []

    def C_at(self, k):
        return rigs.C_EN @ matrix_from_rpy([0.0, 0.0, 0.1 * k])

    def carried_to(self, k, weight=1.0):
        self.asked.append((k, weight))
        cov = spread(*[1e-3] * 3, *[1e-4] * 3, *[1e-2] * 3)
        cov[:3, :3] = 1e-6 * np.eye(3) + self.sigma[k] ** 2 * np.outer(DOWN, DOWN)
        return self.C_at(k), cov / weight

    def initial_attitude(self):
        return InitialAttitude(
            self.time, self.C_end, 1e-4 * np.eye(3), 0.4 * DEG, np.array([1e-3, 0.0, 0.0]), 1e-4,
            "certified", "certified in motion",
        )  # fmt: skip


def position(time, metres=0.0):
    return GnssEvent(time, "position", rigs.PLACE + metres * NORTH, 4.0 * np.eye(3))


def velocity(time):
    return GnssEvent(time, "velocity", 10.0 * NORTH, 0.04 * np.eye(3))


def doppler(time):
    nothing = np.full(3, np.nan)
    return GnssEvent(
        time, "doppler", nothing, np.full((3, 3), np.nan), rigs.NAMES,
        epoch=DopplerEpoch(time, rigs.PLACE, ROWS),
    )  # fmt: skip


class Aligner:
    """Passes when told; remembers what it was given."""

    def __init__(self, window, passes_at, first=0.0):
        self.window, self.passes_at, self.given, self.first = window, passes_at, [], first

    def add(self, epoch):
        self.given.append(epoch.time)
        if epoch.time < self.first:
            return None
        passed = epoch.time >= self.passes_at
        message = "certified in motion" if passed else "not aligned: needs a turn"
        return Attempt(0.0, epoch.time, passed, message, self.window)


@pytest.fixture
def made(monkeypatch):
    def make(window=None, passes_at=15.0, first=0.0, **config):
        said = []
        fixes = Fixes(STREAM, rigs.calibration(LEVER), VEHICLES["car"])
        start = CertifiedStart(fixes, AlignmentConfig(**config), rigs.IMU, said.append)
        aligner = Aligner(window or Window(), passes_at, first)
        monkeypatch.setattr(start, "_new_aligner", lambda: aligner)
        return SimpleNamespace(start=start, fixes=fixes, said=said, aligner=aligner)

    return make


def test_it_starts_where_the_heading_is_first_good_enough(made):
    """1.5° from epoch 2 on; there is a velocity with a position at each."""
    window = Window()
    it = made(window)
    for t in np.arange(10.0, 16.0):
        it.fixes.add(position(t, 10.0 * (t - 10.0)))
        it.fixes.add(velocity(t))
    start = it.start.offer(doppler(15.0))
    assert start.state.time == start.attitude.time == 12.0
    np.testing.assert_array_equal(start.state.C_eb, window.C_at(2))
    assert window.asked == [(0, 1.0), (1, 1.0), (2, 1.0), (2, 1.0 / 9.0)]
    expected = rigs.PLACE + 20.0 * NORTH - window.C_at(2) @ LEVER
    np.testing.assert_allclose(start.state.pos_e, expected, atol=1e-6)
    np.testing.assert_array_equal(start.accel_bias, window.accel_bias)
    assert start.certified is window and start.attempts == ((15.0, "certified in motion"),)
    assert start.attitude.message == "certified in motion; started 3 s before its end, at 3σ"


def test_its_covariance_is_three_sigma_in_body_axes(made):
    """Attitude and biases ninefold, with their correlations; velocity is that of GNSS."""
    window = Window()
    it = made(window)
    it.fixes.add(position(14.0))
    it.fixes.add(velocity(14.0))
    start = it.start.offer(doppler(15.0))
    cov = window.carried_to(4)[1] * 9.0
    C_be = window.C_at(4).T
    joint = start.joint_cov
    np.testing.assert_allclose(joint[:3, :3], C_be @ cov[:3, :3] @ C_be.T, atol=1e-15)
    np.testing.assert_allclose(joint[:3, 6:], C_be @ cov[:3, 3:], atol=1e-15)
    np.testing.assert_allclose(joint[6:, 6:], cov[3:, 3:], atol=1e-15)
    np.testing.assert_array_equal(joint[3:6, 3:6], 0.04 * np.eye(3))
    assert not joint[3:6, :3].any() and not joint[3:6, 6:].any()
    np.testing.assert_allclose(joint, joint.T, atol=1e-18)
    np.testing.assert_allclose(start.attitude.cov_e, cov[:3, :3])
    expected = 3.0 * np.hypot(window.sigma[4], 1e-3)
    assert start.attitude.sigma_heading == pytest.approx(expected)


def test_the_limit_itself_is_good_enough(made):
    window = Window()
    window.sigma[:] = np.sqrt((1.5 * DEG) ** 2 - 1e-6) + np.array([1e-6, -1e-9, 0, 0, 0, 0])
    it = made(window)
    for t in (10.0, 11.0):
        it.fixes.add(position(t))
        it.fixes.add(velocity(t))
    it.fixes.add(position(15.0))
    assert it.start.offer(doppler(15.0)).state.time == 11.0


@pytest.mark.parametrize("epochs", [[], [10.0, 11.0], [9.5]])
def test_without_a_velocity_at_such_an_epoch_it_starts_at_the_end(made, epochs):
    """Position carried on with the window's velocity; σ grows by that and by 3 m/s²."""
    window = Window()
    it = made(window)
    for t in epochs:
        it.fixes.add(position(t))
        it.fixes.add(velocity(t))
    it.fixes.add(position(13.0))
    start = it.start.offer(doppler(15.0))
    assert start.state.time == 15.0
    expected = rigs.PLACE + 24.0 * NORTH - window.C_end @ LEVER
    swing = it.fixes.lever_velocity(start.attitude)
    np.testing.assert_allclose(start.state.pos_e, expected + 2.0 * swing, atol=1e-6)
    np.testing.assert_array_equal(start.state.vel_e, window.vel_e)
    np.testing.assert_array_equal(start.vel_cov_e, window.cov[3:6, 3:6])
    grown = 4.0 * np.eye(3) + 4.0 * window.cov[3:6, 3:6] + 36.0 * np.eye(3)
    np.testing.assert_allclose(start.pos_cov_e, grown)
    T = np.eye(12)
    T[:3, :3] = window.C_end.T
    np.testing.assert_allclose(start.joint_cov, T @ window.cov @ T.T, atol=1e-15)


def test_the_antenna_of_a_turning_car_is_faster_than_its_imu(made):
    it = made(Window())
    it.fixes.lever_velocity = lambda attitude: 2.0 * EAST
    it.fixes.add(position(13.0))
    start = it.start.offer(doppler(15.0))
    assert EAST @ (start.state.pos_e - rigs.PLACE) == pytest.approx(4.0, abs=1e-6)


@pytest.mark.parametrize(("time", "starts"), [(12.5, True), (12.4, False), (17.5, True)])
def test_a_position_must_be_as_near_as_is_asked_for(made, time, starts):
    it = made()
    it.start.config = dataclasses.replace(it.start.config, position_age_s=2.5)
    it.fixes.add(position(time))
    assert (it.start.offer(doppler(15.0)) is not None) == starts
    far = "; but no GNSS position within 2.5 s to start from"
    assert it.said == ["certified in motion" + ("" if starts else far)]
    assert it.start.attempts == [(15.0, it.said[0])]


def test_without_any_position_there_is_no_start(made):
    it = made()
    assert it.start.offer(doppler(15.0)) is None
    assert it.said[0].endswith("to start from")


def test_what_is_missing_is_said_and_kept(made):
    it = made(passes_at=20.0, first=15.0)
    it.fixes.add(position(15.0))
    assert it.start.why_not().startswith("alignment.method 'certified' needs raw Doppler")
    assert it.start.offer(velocity(14.0)) is None and it.start.first_epoch is None
    assert it.start.offer(doppler(14.0)) is None
    assert it.start.first_epoch == 14.0 and it.said == []
    assert it.start.why_not() == "not certified: less than 5 s of Doppler within the IMU data"
    assert it.start.offer(doppler(15.0)) is None
    assert it.start.offer(doppler(16.0)) is None
    assert it.aligner.given == [14.0, 15.0, 16.0]
    assert it.said == ["not aligned: needs a turn"] * 2
    assert it.start.why_not() == (
        "not certified in 2 attempts, the last after 2 s: not aligned: needs a turn"
    )


def test_doppler_outside_the_imu_data_is_none(made):
    it = made(first=99.0)
    for time, taken in ((-0.1, False), (40.1, False), (0.0, True), (40.0, True)):
        it.start.offer(doppler(time))
        assert (time in it.aligner.given) == taken


def test_the_aligner_has_the_configured_limits():
    config = AlignmentConfig(sigma_clock_walk_mps=0.7, max_window_s=33.0, max_sigma_heading_deg=2.5)
    fixes = Fixes(STREAM, rigs.calibration(LEVER), VEHICLES["car"])
    aligner = CertifiedStart(fixes, config, rigs.IMU, print)._new_aligner()
    assert aligner.stream is STREAM and aligner.lever_b.tolist() == LEVER.tolist()
    options = aligner.options
    assert options.longest == 33.0
    assert options.sigma_heading == pytest.approx(2.5 * DEG)
    assert options.inertial.imu is rigs.IMU
    assert (options.inertial.clock.kind, options.inertial.clock.q) == ("random-walk", 0.7)
