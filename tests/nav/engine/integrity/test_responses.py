"""What a fault does to the filter, against filters that are run again and that know of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.filters.measurements import Biases, Measurement
from certnav.nav.config_files import from_tables
from certnav.nav.engine.events import GnssEvent
from certnav.nav.engine.integrity import responses
from certnav.nav.engine.integrity.responses import NOW, Responses
from certnav.nav.engine.loop import FilterLoop
from certnav.nav.engine.vehicle import VehicleConstraints
from oracles import rigs

GAIN_N = np.array([[0.5, -0.2], [0.1, 0.6], [-0.9, 0.4]])
RANGES = Biases(
    ("pseudorange of G01", "pseudorange of G02"), rigs.C_EN @ GAIN_N, 300.0, np.zeros(2),
    np.full(2, 5.0), np.full(2, 1.0),
)  # fmt: skip


def drive(metres=0.0, mps=0.0, duration=25.0):
    """Run a filter at rest whose G01 is wrong all the time; return it, and its responses."""
    kalman = rigs.filter_at_rest(duration, fix_correlation=10.0, clock_walk=0.1)
    kalman.pos_e += RANGES.dz[:, 0] * metres
    found = Responses(kalman.time, kalman.model.size)
    found.begin(RANGES)
    kalman.follow(found)
    config = from_tables({"vehicle": {"nhc": "on", "zupt": False, "zaru": False},
                          "filter": {"gate_probability": 0.0}})  # fmt: skip
    calibration = rigs.calibration()
    loop = FilterLoop(kalman, calibration, VehicleConstraints(calibration, config.vehicle), config)
    nothing, names = np.full(3, np.nan), rigs.NAMES[:6]
    for second in np.arange(1.0, duration - 1.0):
        value = rigs.PLACE + RANGES.dz[:, 0] * metres
        fix = GnssEvent(second, "position", value, np.eye(3), names, shared=True, ranges=RANGES)
        assert loop.offer(fix).accepted
        rows = rigs.sky(names, time=second + 0.25, bias={"G01": mps})
        doppler = GnssEvent(second + 0.25, "velocity", nothing, np.full((3, 3), np.nan), names,
                            observations=rows)  # fmt: skip
        assert loop.offer(doppler).accepted
    loop.advance(duration - 0.5)
    return kalman, found


@pytest.mark.parametrize(
    ("fault", "bias"), [("pseudorange of G01", {"metres": 0.1}), ("Doppler of G01", {"mps": 1e-3})]
)
def test_the_response_is_what_a_filter_with_the_fault_shows(fault, bias, monkeypatch):
    """Two whole runs, one with a wrong satellite: what is between them, per metre or m/s."""
    monkeypatch.setattr(responses, "BLOCK", 1e9)
    sound, found = drive()
    wrong, _ = drive(**bias)
    # A velocity's row is minus the range rate.
    size = bias.get("metres", 0.0) - bias.get("mps", 0.0)
    v = found.columns[NOW][:, found.names.index(fault)]
    moved = np.concatenate([wrong.pos_e - sound.pos_e, wrong.vel_e - sound.vel_e]) / size
    assert np.linalg.norm(moved[:3]) > 0.3
    # Positions are millions of metres in double precision: 1e-9 m over a bias of 1e-3 m/s.
    np.testing.assert_allclose(v[:6], moved, rtol=2e-3, atol=2e-3 * np.abs(moved).max())
    np.testing.assert_allclose(
        v[sound.model.fix_bias], (wrong.gnss.fix_bias - sound.gnss.fix_bias) / size,
        atol=1e-3 * np.abs(moved).max(),
    )  # fmt: skip


def steps(rng, count, states=4):
    """Draw a small linear system: transitions and measurements with one thing wrong in each."""
    for _ in range(count):
        phi = np.eye(states) + 0.1 * rng.standard_normal((states, states))
        H, R = rng.standard_normal((2, states)), np.diag(rng.uniform(0.5, 2.0, 2))
        biases = Biases(("it",), rng.standard_normal((2, 1)), 7.0)
        yield phi, Measurement(rng.standard_normal(2) * 3.0, H, R, biases)


class Knowing:
    """A filter with states for every block's bias and for what lasts, as textbooks have it."""

    def __init__(self, P, blocks, largest):
        n = len(P)
        self.n, self.x = n, np.zeros(n + blocks + 1)
        self.P = np.diag(np.r_[np.zeros(n), np.full(blocks, largest**2), 1.0])
        self.P[:n, :n] = P

    def predict(self, phi, noise):
        whole = np.eye(len(self.x))
        whole[: self.n, : self.n] = phi
        self.x, self.P = whole @ self.x, whole @ self.P @ whole.T
        self.P[: self.n, : self.n] += noise

    def correct(self, z, H, R):
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
        self.x = self.x + K @ (z - H @ self.x)
        self.P = self.P - K @ H @ self.P


@pytest.mark.parametrize("said", [False, True])
@pytest.mark.parametrize("blocks", [1, 3])
def test_the_solution_without_a_sensor_is_that_of_a_filter_that_estimates_its_bias(blocks, said):
    """Estimate less `moved`, and P plus its covariance, against one with the biases as states.

    `said`: once a block the other satellites say how large it is, with an error that lasts.
    """
    rng = np.random.default_rng(3)
    P = np.diag([4.0, 3.0, 2.0, 5.0])
    noise = 0.05 * np.eye(4)
    knowing = Knowing(P, blocks, 7.0)
    found, x, dt = Responses(0.0, 4), np.zeros(4), responses.BLOCK / 6.0
    for k, (phi, m) in enumerate(steps(rng, 6 * blocks)):
        x, P = phi @ x, phi @ P @ phi.T + noise
        found.predict(k * dt, phi, P)
        knowing.predict(phi, noise)
        # Innovation of either: the same measurement, each with its own prediction.
        measured = m.z + m.H @ x
        if said and k % 6 == 2:
            value, sigma, lasting = rng.standard_normal(), 1.5, 2.0
            row = np.zeros((1, len(knowing.x)))
            row[0, 4 + k // 6], row[0, -1] = 1.0, lasting
            knowing.correct(np.array([value]), row, np.array([[sigma**2]]))
            told = dataclasses.replace(
                m.biases, estimate=np.array([value]), noise=np.array([sigma]),
                lasting=np.array([lasting]),
            )  # fmt: skip
            m = dataclasses.replace(m, biases=told)
        found.correct(P, m)
        K = P @ m.H.T @ np.linalg.inv(m.H @ P @ m.H.T + m.R)
        x, P = x + K @ m.z, P - K @ m.H @ P
        H = np.hstack([m.H, np.zeros((2, blocks + 1))])
        H[:, 4 + k // 6] = m.biases.dz[:, 0]
        knowing.correct(measured, H, m.R)
    (moved,), (W,), (cov,) = found.moved()
    np.testing.assert_allclose(x - moved, knowing.x[:4], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(P + W.T @ cov @ W, knowing.P[:4, :4], rtol=1e-6, atol=1e-8)


def test_what_the_measurements_say_among_themselves_counts_once_a_block():
    """Ten fixes of a block, 3 m too long by the others' word: no surer than one of them."""
    one = Biases(("it",), np.ones((1, 1)), 1e3, np.array([3.0]), np.array([2.0]), np.array([0.5]))
    blind = Measurement(np.zeros(1), np.zeros((1, 4)), np.eye(1) * 1e12, one)
    found = Responses(0.0, 4)
    for _ in range(10):
        found.correct(np.eye(4), blind)
    theta, cov = found._known.solved()
    assert theta[0, 0] == pytest.approx(3.0, rel=1e-4)
    assert np.sqrt(cov[0, 0, 0]) == pytest.approx(np.hypot(2.0, 0.5), rel=1e-4)


def test_what_lasts_is_the_same_error_in_every_block():
    """Of ten blocks the noise averages away; what the other satellites are off by does not."""
    noise, lasting, blocks = 2.0, 0.5, 10
    say = Biases(("it",), np.ones((1, 1)), 1e3, np.zeros(1), np.array([noise]), np.array([lasting]))
    found = Responses(0.0, 4)
    for block in range(blocks):
        found.correct(np.eye(4), Measurement(np.zeros(1), np.zeros((1, 4)), np.eye(1) * 1e12, say))
        found.columns[NOW, 0, 0] = 1.0 / blocks  # the position moves by a tenth of each
        if block < blocks - 1:
            found.predict((block + 1) * responses.BLOCK, np.eye(4), np.eye(4))
    _, (W,), (cov,) = found.moved(slice(1))
    assert np.sqrt(W[:, 0] @ cov @ W[:, 0]) == pytest.approx(
        np.hypot(noise / blocks**0.5, lasting), rel=0.02
    )


def test_a_fault_that_is_over_and_done_with_is_forgotten():
    found = Responses(0.0, 4)
    m = Measurement(np.zeros(1), np.eye(4)[:1], np.eye(1), Biases(("it",), np.ones((1, 1)), 3.0))
    found.correct(np.eye(4), m)
    decay, other = 0.5 * np.eye(4), dataclasses.replace(m, H=np.zeros((1, 4)), biases=None)
    for block in range(1, 40):
        found.predict(block * responses.BLOCK, decay, np.eye(4))
        found.correct(np.eye(4), other)
        if not found.names:
            break
    assert 2 < block < 20
    found.correct(np.eye(4), dataclasses.replace(m, biases=None))
    found.correct(np.eye(4), m)
    assert found.names == ["it"]
