"""Positions against velocities: sound noisy ones pass, wrong axes, signs and units do not."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.displacement import agreement, check_velocity
from certnav.datasets.physics import collected_refusals
from certnav.filters.earth import C_en_at, lla_to_ecef
from certnav.filters.errors import DataError

LAT, LON = 0.8, 0.2
SWAP = np.array([[0.0, 1.0], [1.0, 0.0]])


def drive(seed=0, *, speed=10.0, rate=1.0, noise=3.0, correlated=0.0, fault=None, turns=True):
    """Return time, positions and velocities of a winding drive of two minutes."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 120.0, 1.0 / rate)
    course = rng.uniform(0, 6) + turns * np.cumsum(rng.normal(0.0, 0.15 / np.sqrt(rate), t.size))
    v = speed * np.column_stack([np.cos(course), np.sin(course), 0.0 * t])
    p = np.vstack([np.zeros(3), np.cumsum(0.5 * (v[1:] + v[:-1]) / rate, axis=0)])
    error = rng.normal(0.0, noise, p.shape)
    if correlated:
        keep = np.exp(-1.0 / rate / correlated)
        for k in range(1, len(error)):
            error[k] = keep * error[k - 1] + np.sqrt(1.0 - keep**2) * error[k]
    C_en = C_en_at(LAT, LON)
    v = v + rng.normal(0.0, 0.05, v.shape)
    if fault is not None:
        v[:, :2] = v[:, :2] @ np.asarray(fault).T
    return t, lla_to_ecef(LAT, LON, 100.0) + (p + error) @ C_en.T, v @ C_en.T


@pytest.mark.parametrize("rate", [1.0, 5.0, 10.0])
@pytest.mark.parametrize("speed", [1.5, 5.0, 10.0, 30.0])
@pytest.mark.parametrize(
    ("noise", "declared", "correlated"), [(3.0, 3.0, 0.0), (6.0, 2.0, 0.0), (5.0, 2.0, 20.0)]
)
def test_noise_is_not_refused_whatever_is_declared(rate, speed, noise, declared, correlated):
    """Where single differences scatter by ten times the speed, and σ is declared 3 × too small."""
    for seed in range(3):
        data = drive(seed, speed=speed, rate=rate, noise=noise, correlated=correlated)
        found = agreement(*data, np.full(data[0].size, declared))
        assert found is not None and not found.contradicts
        assert found.misfit(np.eye(2)) < 0.05 + 4.0 * found.sigma


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (SWAP, "swapped"),
        (-np.eye(2), "sign is reversed"),
        (np.diag([1.0, -1.0]), "east component"),
        (np.diag([-1.0, 1.0]), "north component"),
        (3.6 * np.eye(2), "km/h, not m/s"),
        (3600.0 / 1852.0 * np.eye(2), "knots, not m/s"),
        (np.eye(2) / 0.3048, "ft/s, not m/s"),
        (np.eye(2) / 3.6, "m/s, not km/h"),
    ],
)
@pytest.mark.parametrize(("noise", "rate"), [(0.02, 1.0), (3.0, 1.0), (3.0, 10.0)])
def test_faults_are_told_through_the_noise(fault, words, noise, rate):
    for seed in range(3):
        data = drive(seed, noise=noise, rate=rate, fault=fault)
        found = agreement(*data, np.full(data[0].size, max(noise / 2.0, 0.02)))
        assert found.contradicts and words in found.cause().words


def test_velocities_of_something_else_have_no_cause():
    t, pos_e, vel_e = drive(0, noise=0.1)
    found = agreement(t, pos_e, np.random.default_rng(1).permutation(vel_e), np.full(t.size, 0.1))
    assert found.contradicts and found.cause() is None


def test_a_component_that_is_missing_is_no_agreement():
    """East always zero: what there is of north fits, half of the way is elsewhere."""
    t, pos_e, vel_e = drive(0, noise=0.1, fault=np.diag([1.0, 0.0]))
    assert agreement(t, pos_e, vel_e, np.full(t.size, 0.1)).contradicts


def test_repeated_rows_are_not_measured():
    """One fix a second, printed at 5 Hz; and half of the drive repeats a fix and its velocity."""
    t, pos_e, vel_e = drive(0, noise=0.1)
    hold = np.arange(5 * t.size) // 5
    fast = np.arange(5 * t.size) / 5.0
    found = agreement(fast, pos_e[hold], vel_e[hold], np.full(fast.size, 0.1))
    assert not found.contradicts and found.misfit(np.eye(2)) < 0.02
    for k in range(8, 120, 16):
        pos_e[k : k + 8], vel_e[k : k + 8] = pos_e[k], vel_e[k]
    found = agreement(t, pos_e, vel_e, np.full(t.size, 0.1))
    assert not found.contradicts and found.misfit(np.eye(2)) < 0.02


def test_a_jump_of_the_position_begins_anew():
    t, pos_e, vel_e = drive(0, noise=0.1)
    north = C_en_at(LAT, LON)[:, 0]
    for k in (10, 31, 52, 70, 93, 110):
        pos_e[k:] += 5e4 * north
    assert agreement(t, pos_e, vel_e).misfit(np.eye(2)) < 0.02


def test_standing_or_few_rows_tell_nothing():
    assert agreement(*drive(0, speed=0.0, noise=5.0)) is None
    assert agreement(*(a[:8] for a in drive(0))) is None


def test_reader_refuses_with_the_remedy_or_lets_it_be_collected():
    t, pos_e, vel_e = drive(0, fault=SWAP)
    sigma = np.full(t.size, 3.0)
    with pytest.raises(DataError, match="exchange them"):
        check_velocity(t, pos_e, vel_e, sigma, file="gnss.csv", declared="ned")
    with collected_refusals() as refused:
        check_velocity(t, pos_e, vel_e, sigma, file="gnss.csv", declared="ned")
    assert [r.against for r in refused] == ["velocity"]
