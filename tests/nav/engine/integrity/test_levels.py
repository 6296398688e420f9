"""Levels: what Gaussian errors exceed at the risk, and no less for any one fault."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.filters.measurements import Biases
from certnav.nav.config_files import from_tables
from certnav.nav.engine.events import GnssEvent, missing
from certnav.nav.engine.integrity import placed
from certnav.nav.engine.integrity.levels import Levels, factors, semi_major
from certnav.nav.engine.integrity.responses import BLOCK
from certnav.nav.engine.vehicle import VehicleConstraints
from certnav.nav.solution import Trajectory
from oracles import rigs


@pytest.mark.parametrize("ratio", [1.0, 0.3])
def test_gaussian_errors_exceed_the_factors_at_the_risk(ratio):
    """At 1 %: with equal horizontal axes so often, with unequal ones less; vertically so often."""
    k_h, k_v = factors(0.01)
    e = np.random.default_rng(1).standard_normal((400_000, 3)) * [1.0, ratio, 1.0]
    beyond = np.mean(np.hypot(e[:, 0], e[:, 1]) > k_h)
    assert beyond == pytest.approx(0.01, rel=0.05) if ratio == 1.0 else 0.001 < beyond < 0.01
    assert np.mean(np.abs(e[:, 2]) > k_v) == pytest.approx(0.01, rel=0.05)


def test_the_semi_major_axis_is_the_root_of_the_largest_eigenvalue():
    a = np.random.default_rng(2).standard_normal((20, 2, 2))
    cov = a @ np.swapaxes(a, 1, 2)
    np.testing.assert_allclose(semi_major(cov) ** 2, np.linalg.eigvalsh(cov)[:, -1])


def levels_after(excess, noise, gain_n, risk=1e-4):
    """Return the levels of a filter that starts with one fix, one of its ranges `excess` off."""
    kalman = rigs.filter_at_rest(sigma=(0.5, 0.05, 1e-3))
    made = Levels(kalman, risk)
    dz = (rigs.C_EN @ np.asarray(gain_n, dtype=float))[:, None]
    made.begin(Biases(("it",), dz, 1e6, np.array([excess]), np.array([noise]), np.zeros(1)))
    return made.level(kalman.P)


def test_a_level_is_how_far_a_fault_has_moved_the_solution_and_k_sigma_without_the_sensor():
    k_h, k_v = factors(1e-4)
    # 3-4-5 horizontally: 10 m too long ± 2 m moves 5 m ± 1 m; σ of the filter 0.5 m.
    horizontal, vertical = levels_after(10.0, 2.0, [0.3, 0.4, 0.0])
    assert horizontal == pytest.approx(5.0 + k_h * np.hypot(0.5, 1.0), rel=1e-3)
    assert vertical == pytest.approx(k_v * 0.5, rel=1e-3)
    horizontal, vertical = levels_after(-10.0, 2.0, [0.0, 0.0, 0.5])
    assert horizontal == pytest.approx(k_h * 0.5, rel=1e-3)
    assert vertical == pytest.approx(5.0 + k_v * np.hypot(0.5, 1.0), rel=1e-3)


def test_a_range_that_nothing_is_known_of_leaves_no_level():
    """Its bias may be anything up to its largest, and the level says so."""
    unknown = Biases(("it",), rigs.C_EN[:, :1], 300.0, np.zeros(1), np.full(1, np.inf), np.ones(1))
    kalman = rigs.filter_at_rest()
    made = Levels(kalman, 1e-4)
    made.begin(unknown)
    assert made.level(kalman.P)[0] == pytest.approx(factors(1e-4)[0] * 300.0, rel=0.01)


def trajectory(times, sigma):
    n, zero = len(times), np.zeros((len(times), 3))
    cov = np.tile(np.diag([sigma**2, 0.5 * sigma**2, 4.0 * sigma**2]), (n, 1, 1))
    return Trajectory(
        np.array(times), np.tile(rigs.PLACE, (n, 1)), zero, np.tile(np.eye(3), (n, 1, 1)), zero,
        zero, cov, cov, cov, zero, zero,
    )  # fmt: skip


def test_levels_are_at_least_k_sigma_and_widened_by_what_sigma_lacked():
    k = np.array(factors(1e-4))
    levels = np.array([[0.0, 10.0, 20.0], [2.0, 20.0, 20.0]])
    found = placed.with_protection(
        trajectory([1.0, 5.0], 1.0), levels, 1e-4, trajectory([0.0], 1.0)
    )
    np.testing.assert_allclose(found.protection, [[15.0, 20.0], [20.0, 20.0]])
    found = placed.with_protection(trajectory([1.0], 8.0), levels, 1e-4, trajectory([1.0], 8.0))
    np.testing.assert_allclose(found.protection, [k * [8.0, 16.0]])
    found = placed.with_protection(trajectory([1.0], 3.0), levels, 1e-4, trajectory([1.0], 1.0))
    np.testing.assert_allclose(found.protection, [[15.0, 20.0] + k * [2.0, 4.0]])
    none = placed.with_protection(trajectory([1.0], 3.0), levels[:0], 1e-4, trajectory([1.0], 1.0))
    assert np.isnan(none.protection).all()


def test_of_a_smoothed_solution_the_largest_until_a_block_later():
    levels = np.array([[0.0, 1.0, 5.0], [BLOCK, 7.0, 2.0], [BLOCK + 1.0, 3.0, 9.0]])
    expected = [[0.0, 7.0, 5.0], [BLOCK, 7.0, 9.0], [BLOCK + 1.0, 3.0, 9.0]]
    np.testing.assert_allclose(placed.of_smoothed(levels), expected)


def meaning_of(*events, **tables):
    config = from_tables(tables)
    return placed.meaning(events, VehicleConstraints(rigs.calibration(), config.vehicle), config)


def test_what_is_not_known_of_positions_is_not_covered():
    ranges = Biases(("it",), np.ones((3, 1)), 1.0)
    known = GnssEvent(0.0, "position", rigs.PLACE, np.eye(3), ranges=ranges)
    carried = dataclasses.replace(known, ranges=None)
    unusable = missing(0.0, "position", "no fix")
    on = {"nhc": "on"}
    found = meaning_of(known, unusable, vehicle=on)
    assert (found.covers, found.lacks) == (("one satellite's pseudorange", "sideslip or heave"), ())
    found = meaning_of(carried, vehicle={"nhc": "off"})
    assert found.covers == ()
    assert "positions" in found.lacks[0]
    assert "positions" in meaning_of(known, carried).lacks[0]
    assert meaning_of(known, filter={"protection_risk": 0.0}) is None


def test_doppler_is_covered_as_rows_and_not_as_a_velocity():
    epoch = rigs.sky(rigs.NAMES[:3])
    rows = missing(0.0, "doppler", "", rigs.NAMES[:3], epoch)
    assert "one satellite's Doppler" in meaning_of(rows).covers
    assert "Doppler" in meaning_of(rows, gnss={"below_four": "ddia"}).lacks[0]
    ready = GnssEvent(0.0, "velocity", np.zeros(3), np.eye(3))
    assert "velocities" in meaning_of(ready).lacks[0]
