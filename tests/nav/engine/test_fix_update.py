"""Positions and velocities: taken, weighted down, refused, or forced upon the filter."""

import dataclasses

import numpy as np
import pytest

from certnav.filters.earth import OMEGA_IE_E
from certnav.filters.error_model import POS, VEL
from certnav.filters.levers import AntennaPrior
from certnav.nav.config import FilterConfig
from certnav.nav.engine.events import GnssEvent
from certnav.nav.engine.fix_update import ENLARGED, FixUpdates, logged
from oracles import rigs

#: χ² of three components that chance exceeds once in ten thousand.
LIMIT = 21.1075
CONFIG = FilterConfig()
LEVER = np.array([-1.2, 0.4, -1.1])


def north(metres):
    return metres * rigs.C_EN[:, 0]


def position(metres, variance=1.0, satellites=(), shared=False):
    """A position so far north of where the filter has it."""
    return GnssEvent(
        0.0, "position", rigs.PLACE + north(metres), variance * np.eye(3), satellites,
        shared=shared,
    )  # fmt: skip


@pytest.fixture
def kalman():
    """It knows its position to a metre: with a position as good, S is 2 m²."""
    return rigs.filter_at_rest()


def updates(kalman, lever=(0.0, 0.0, 0.0), config=CONFIG):
    return FixUpdates(kalman, rigs.calibration(lever), config)


def moved(kalman):
    return float(rigs.C_EN[:, 0] @ (kalman.pos_e - rigs.PLACE))


def test_a_position_within_the_gate_is_averaged(kalman):
    update = updates(kalman).offer(position(6.0), insist=False)
    assert (update.accepted, update.reason) == (True, "")
    assert update.nis == pytest.approx(18.0)
    assert np.linalg.norm(update.whitened) == pytest.approx(np.sqrt(18.0))
    assert moved(kalman) == pytest.approx(3.0)
    assert kalman.P[0, 0] == pytest.approx(0.5)


def test_one_a_little_beyond_is_weighted_down_to_the_gate(kalman):
    """NIS 50. R grows by 1.2 until 100 / (1 + R) is 21.1 or less: 1.2⁸ = 4.2998."""
    update = updates(kalman).offer(position(10.0), insist=False)
    assert update.accepted and update.reason == "weighted down to the gate (NIS > 21.1)"
    assert update.nis == pytest.approx(50.0)  # the log keeps what it was
    assert moved(kalman) == pytest.approx(10.0 / (1.0 + 1.2**8))
    assert kalman.P[0, 0] == pytest.approx(1.2**8 / (1.0 + 1.2**8))


@pytest.mark.parametrize(("width", "edge"), [(2.0, 4.0), (1.0, 1.0), (3.0, 9.0)])
def test_twice_the_gate_is_too_much(width, edge):
    """`gate_width` is a factor on the innovation; NIS is its square."""
    config = FilterConfig(gate_width=width)
    for factor, accepted in ((0.999, True), (1.001, False)):
        kalman = rigs.filter_at_rest()
        metres = np.sqrt(2.0 * factor * edge * LIMIT)
        update = updates(kalman, config=config).offer(position(metres), insist=False)
        assert update.accepted == accepted
    assert update.reason == "innovation test (NIS > 21.1)"
    assert moved(kalman) == 0.0 and kalman.P[0, 0] == 1.0


def test_insisting_enlarges_the_covariance_until_it_fits(kalman):
    """NIS 86; with P tenfold it is 172 / 11 = 15.6."""
    metres = np.sqrt(171.6)
    update = updates(kalman).offer(position(metres), insist=True)
    assert update.accepted and update.reason == ENLARGED
    assert update.nis == pytest.approx(85.8)
    assert moved(kalman) == pytest.approx(metres * 10.0 / 11.0)
    assert kalman.P[0, 0] == pytest.approx(10.0 / 11.0)


def test_tenfold_at_most(kalman):
    update = updates(kalman).offer(position(20.0), insist=True)  # 400 / 11 = 36
    assert not update.accepted and update.reason == "innovation test (NIS > 21.1)"
    assert moved(kalman) == 0.0 and kalman.P[0, 0] == pytest.approx(10.0)


@pytest.mark.parametrize("metres", [1.0, 10.0])
def test_what_passes_anyway_enlarges_nothing(metres):
    asked, insisted = rigs.filter_at_rest(), rigs.filter_at_rest()
    updates(asked).offer(position(metres), insist=False)
    update = updates(insisted).offer(position(metres), insist=True)
    assert update.accepted and update.reason != ENLARGED
    np.testing.assert_array_equal(asked.P, insisted.P)


def test_a_position_that_is_no_number_is_refused(kalman):
    update = updates(kalman).offer(position(np.nan), insist=False)
    assert not update.accepted and update.reason.startswith("innovation test")
    assert np.isfinite(kalman.pos_e).all()


def test_the_lever_arm_is_as_well_known_as_it_is():
    """σ 3 m adds 9 m² on every axis, and the antenna is where the lever puts it."""
    kalman = rigs.filter_at_rest(gnss_antenna=AntennaPrior(sigma_lever=3.0))
    made, before = updates(kalman, LEVER), kalman.P.copy()
    antenna = kalman.pos_e + kalman.C_eb @ LEVER
    before[6:9, 6:9] = 0.0
    for axis in range(3):
        kalman.P, kalman.pos_e[:], kalman.antenna.lever_b = before.copy(), rigs.PLACE, np.zeros(3)
        event = GnssEvent(0.0, "position", antenna + 3.0 * np.eye(3)[axis], np.eye(3))
        assert made.offer(event, False).nis == pytest.approx(9.0 / 11.0)
        # Nine parts of eleven are the lever's.
        correction = kalman.C_eb @ kalman.antenna.lever_b
        np.testing.assert_allclose(correction, 27.0 / 11.0 * np.eye(3)[axis], atol=1e-3)


def test_a_velocity_is_the_antennas(kalman):
    kalman.omega_b = np.array([0.1, -0.2, 0.5])
    swing_e = kalman.C_eb @ np.cross(kalman.omega_b - kalman.C_eb.T @ OMEGA_IE_E, LEVER)
    made = updates(kalman, LEVER)
    event = GnssEvent(0.0, "velocity", swing_e, 0.01 * np.eye(3), ("G01",))
    update = made.offer(event, False)
    assert update.accepted and update.nis < 1e-20 and update.kind == "velocity"
    assert update.satellites == ("G01",)
    assert kalman.P[VEL, VEL][0, 0] < 0.05**2
    off = GnssEvent(0.0, "velocity", swing_e + north(100.0), 0.01 * np.eye(3))
    assert not made.offer(off, False).accepted


# The error that successive positions share.


def test_the_share_of_satellites_in_common(kalman):
    made = updates(kalman)
    assert made.overlap(("A", "B", "C")) == 1.0  # nothing before it to differ from
    assert made.overlap(("B", "C", "D")) == pytest.approx(2.0 / 4.0)
    assert made.overlap(("B", "C", "D")) == 1.0
    assert made.overlap(("E", "F")) == 0.0
    assert made.overlap(("E", "F", "G", "H")) == pytest.approx(2.0 / 4.0)


def test_a_shared_position_is_measured_with_its_shared_error():
    """What is wrong with the first position is wrong with the next: S = 1 − 1.8 + 0.9 + 0.1.

    So said with the lever's own doubt, which is not shared: 0.2 + σ².
    """
    for sigma, variance in ((0.0, 0.2), (3.0, 9.2)):
        kalman = rigs.filter_at_rest(fix_correlation=10.0, gnss_antenna=AntennaPrior(sigma))
        update = updates(kalman).offer(position(0.5, shared=True), False)
        assert update.nis == pytest.approx(0.25 / variance)


def repeated(shared, satellites, fix_correlation=10.0):
    """σ of the position after fifty positions at once, each of 2 m, from a poor start."""
    kalman = rigs.filter_at_rest(sigma=(100.0, 0.05, 1e-3), fix_correlation=fix_correlation)
    kalman.P[:15, 15:] = kalman.P[15:, :15] = 0.0  # the start came from elsewhere
    made = updates(kalman)
    for k in range(50):
        made.offer(position(0.0, 4.0, satellites(k), shared), False)
    return np.sqrt(kalman.P[POS, POS][0, 0])


def test_repetition_of_a_shared_error_teaches_nothing():
    same = repeated(True, lambda k: ("A", "B", "C", "D"))
    assert 0.9 * np.sqrt(0.9 * 4.0) < same
    # Positions of their own average: 2 m / √50.
    own = 2.0 / np.sqrt(50.0)
    assert repeated(False, lambda k: ("A", "B")) == pytest.approx(own, rel=0.02)
    assert repeated(True, lambda k: ("A", "B"), 0.0) == pytest.approx(own, rel=0.02)
    # So do those of other satellites each time, and half of it makes half a difference.
    others = repeated(True, lambda k: ("ABCD", "EFGH")[k % 2])
    assert others == pytest.approx(own, rel=0.2)
    half = repeated(True, lambda k: ("ABCD", "CDEF")[k % 2])
    assert 1.15 * others < half < 0.5 * same


def test_what_the_log_says(kalman):
    accepted = kalman.test(updates(kalman)._position(position(1.0)), 1e-4)
    refused = kalman.test(updates(kalman)._position(position(100.0)), 1e-4)
    assert logged(1.0, "nhc", ("A",), accepted).reason == ""
    assert logged(1.0, "nhc", (), refused).reason == "innovation test (NIS > 21.1)"
    assert logged(1.0, "nhc", (), refused, "because").reason == "because"
    update = logged(1.0, "nhc", ("A",), accepted, "so")
    assert (update.time, update.kind, update.satellites) == (1.0, "nhc", ("A",))
    assert (update.nis, update.accepted, update.reason) == (accepted.nis, True, "so")
    assert update.whitened == tuple(accepted.whitened)


def test_live_a_fix_that_stays_while_the_vehicle_moves_is_not_used():
    """The first of them is; a fix that repeats where the filter stands is no repetition."""
    kalman = rigs.filter_at_rest()
    updates = FixUpdates(kalman, rigs.calibration(), FilterConfig())
    fix = GnssEvent(0.0, "position", kalman.pos_e.copy(), 0.01 * np.eye(3))
    assert not updates.repeated(fix)
    assert not updates.repeated(dataclasses.replace(fix, time=1.0))
    kalman.pos_e[:] += [0.9, 0.0, 0.0]
    assert not updates.repeated(dataclasses.replace(fix, time=2.0))
    kalman.pos_e[:] += [0.2, 0.0, 0.0]
    held = dataclasses.replace(fix, time=3.0)
    assert updates.repeated(held)
    velocity = GnssEvent(3.0, "velocity", np.zeros(3), np.eye(3))
    assert updates.repeated(velocity)
    assert not updates.repeated(dataclasses.replace(velocity, time=3.5))
    fresh = dataclasses.replace(fix, time=4.0, value_e=kalman.pos_e.copy())
    assert not updates.repeated(fresh)
    vague = FixUpdates(kalman, rigs.calibration(), FilterConfig())
    wide = dataclasses.replace(fix, cov_e=25.0 * np.eye(3))
    vague.repeated(wide)
    kalman.pos_e[:] += [15.0, 0.0, 0.0]
    assert not vague.repeated(wide)  # 5 m, 1σ: 15 m say nothing yet
