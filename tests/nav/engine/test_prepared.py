"""What runs over one recording have in common changes none of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import AlignmentError
from certnav.nav.config import Config
from certnav.nav.engine import prepared as module
from certnav.nav.engine.prepared import Prepared, plain_run
from certnav.nav.pipeline import navigate, navigate_twice


@pytest.fixture(scope="module")
def drive():
    simulation = simulate(
        SimulationConfig(name="made", seed=4, duration=120.0, density="suburb", imu_rate=25.0)
    )
    time = np.arange(1.0, 119.0) + simulation.config.start_time
    lever = simulation.calibration.lever_antenna_b
    rng = np.random.default_rng(5)
    return simulation.sequence(fixes_from_truth(simulation.trajectory, time, lever, 1.0, 0.05, rng))


PLAIN = plain_run(Config())
SMOOTH = dataclasses.replace(PLAIN, filter=dataclasses.replace(PLAIN.filter, smooth=True))


def _same(a, b, rtol: float = 0.0, atol: float = 0.0) -> None:
    for field in dataclasses.fields(a.trajectory):
        one, two = (getattr(s.trajectory, field.name) for s in (a, b))
        np.testing.assert_allclose(one, two, rtol, atol, err_msg=field.name)
    assert len(a.updates) == len(b.updates)
    assert a.alignment == b.alignment and a.notes == b.notes


def test_a_plain_run_is_the_same_to_the_last_digit(drive):
    _same(navigate(drive, PLAIN, prepared=Prepared(drive)), navigate(drive, PLAIN))


def test_one_pass_serves_the_run_and_the_smoothed_run(drive):
    causal, smoothed = navigate_twice(drive, SMOOTH, Prepared(drive))
    # What is kept for the smoother cuts the way into other pieces: rounding; and protection levels
    # are taken once a second at the ends of pieces, so that they are of other instants.
    one, two = (
        dataclasses.replace(
            s, trajectory=dataclasses.replace(s.trajectory, protection=np.empty((0, 2)))
        )
        for s in (causal, navigate(drive, PLAIN))
    )
    _same(one, two, rtol=1e-6, atol=1e-7)
    _same(smoothed, navigate(drive, SMOOTH))
    late = slice(-500, -100)
    one, two = (solution.trajectory.pos_e[late] for solution in (causal, smoothed))
    assert np.abs(one - two).max() > 0.1


def test_start_and_gnss_are_computed_once(drive, monkeypatch):
    counts = dict.fromkeys(("found_start", "gnss_timeline", "with_fitted_noise"), 0)

    def counted(name):
        real = getattr(module, name)

        def call(*arguments):
            counts[name] += 1
            return real(*arguments)

        return call

    for name in counts:
        monkeypatch.setattr(module, name, counted(name))
    prepared = Prepared(drive)
    for below_four in ("off", "ddia", "rows"):
        gnss = dataclasses.replace(PLAIN.gnss, below_four=below_four)
        for config in (Config(), PLAIN, SMOOTH):
            navigate(drive, dataclasses.replace(config, gnss=gnss), prepared=prepared)
    assert counts == {"found_start": 1, "gnss_timeline": 2, "with_fitted_noise": 1}


def _with(config, **gnss):
    return dataclasses.replace(config, gnss=dataclasses.replace(config.gnss, **gnss))


BELOW_FOUR = (
    {},
    {"below_four": "ddia"},
    {"below_four": "ddia", "ddia_min_k": 0.9, "ddia_min_cn0_dbhz": 30.0},
    {"below_four": "off"},
)


@pytest.mark.parametrize("few", [False, True])
def test_with_its_own_noise_a_run_is_what_it_is_by_itself_and_shares_no_more(
    drive, few, monkeypatch
):
    """Where there are four satellites throughout, what is done below changes no fit."""
    seen = drive.observations
    names, count = np.unique(seen.sat[seen.usable], return_counts=True)
    steady = np.isin(seen.sat, names[np.argsort(-count)][: 2 if few else 8])
    late = seen.time > drive.inertial.time[0] + 70.0
    kept = np.ones(len(seen), dtype=bool) if not few else steady | ~late
    sequence = dataclasses.replace(drive, observations=seen.take(kept))
    if not few:
        strong = np.where(seen.usable, 50.0, seen.cn0)
        sequence = dataclasses.replace(drive, observations=dataclasses.replace(seen, cn0=strong))
    calls = []
    real = module.with_fitted_noise
    monkeypatch.setattr(module, "with_fitted_noise", lambda *a: calls.append(1) or real(*a))
    prepared = Prepared(sequence, own_noise=True)
    for changes in BELOW_FOUR:
        config = _with(Config(), **changes)
        _same(navigate(sequence, config, prepared=prepared), navigate(sequence, config))
    assert len(calls) == (len(BELOW_FOUR) if few else 1)


def test_timelines_are_shared_by_what_offers_the_same(drive):
    """None of these settings changes an event."""
    plain = module.gnss_timeline(drive, Config().gnss)
    others = {
        "below_four": "ddia", "forward_motion": "on", "ddia_min_k": 0.7, "ddia_min_cn0_dbhz": 31.0,
        "clock_walk_mps": 0.3, "doppler_hold_off_s": 9.0, "position_noise": "declared",
        "velocity_noise": "declared", "doppler_known_mps": (0.1, 0.02, 0.2, 0.1),
        "position_correlation_s": 3.0, "delay_sigma_s": 0.1,
    }  # fmt: skip
    assert set(others) == {"below_four", *module._OF_THE_FILTER}
    changed = _with(Config(), **others)
    assert module.offered_by(changed) == module.offered_by(Config())
    other = module.gnss_timeline(drive, changed.gnss)
    assert other.notes == plain.notes and len(other.events) == len(plain.events) > 100
    for one, two in zip(plain.events, other.events, strict=True):
        assert (one.time, one.kind, one.reason) == (two.time, two.kind, two.reason)
        np.testing.assert_array_equal(one.value_e, two.value_e)
        np.testing.assert_array_equal(one.cov_e, two.cov_e)
    for key in ("min_cn0_dbhz", "doppler_sigma_mps"):
        assert module.offered_by(_with(Config(), **{key: 36.0})) != module.offered_by(Config())


def test_without_gnss_after_the_start_there_is_none(drive):
    prepared = Prepared(drive)
    start, _ = prepared.start(PLAIN)
    alone = navigate(drive, PLAIN, prepared=prepared, until=start.known)
    offered = [u.time for u in alone.updates if u.kind in ("position", "velocity", "doppler")]
    assert max(offered) <= start.known < max(e.time for e in prepared.timeline(PLAIN).events)
    assert alone.epochs.time.max() <= start.known
    assert alone.trajectory.time[-1] == pytest.approx(drive.inertial.time[-1])


def test_a_start_knows_nothing_later_than_it_says(drive):
    """Whatever comes after `known` may be taken away: the start stays as it is."""
    prepared = Prepared(drive)
    start, _ = prepared.start(PLAIN)
    last = start.known + 0.1
    kept = dataclasses.replace(
        drive,
        observations=drive.observations.take(drive.observations.time <= last),
        fixes=drive.fixes.take(drive.fixes.time <= last),
    )
    again, _ = Prepared(kept).start(PLAIN)
    assert again.state.time == start.state.time
    turned = np.degrees(np.arccos((np.trace(again.state.C_eb.T @ start.state.C_eb) - 1) / 2))
    assert turned < 0.01 and np.linalg.norm(again.state.pos_e - start.state.pos_e) < 1.0


def _certified(drive, **changes):
    alignment = dataclasses.replace(PLAIN.alignment, method="certified", **changes)
    start, _ = Prepared(drive).start(dataclasses.replace(PLAIN, alignment=alignment))
    return start


def test_a_certified_start_carries_a_position_from_long_before(drive):
    """Positions end while the vehicle stands: the window's own velocity takes the last one on."""
    begin = drive.inertial.time[0]
    fixes = drive.fixes.take(drive.fixes.time <= begin + 24.0)
    silent = dataclasses.replace(fixes, vel_e=np.full_like(fixes.vel_e, np.nan))
    few = dataclasses.replace(drive, fixes=silent)
    few = _few_satellites_until(few, begin + 34.0)
    with pytest.raises(AlignmentError, match=r"within 2\.5 s"):
        _certified(few, position_age_s=2.5)
    start = _certified(few)
    assert start.known > few.fixes.time[-1] + 2.5
    truth = drive.reference
    at = int(np.argmin(np.abs(truth.time - start.state.time)))
    off = start.state.pos_e + start.state.C_eb @ truth.lever_b - truth.pos_e[at]
    assert off @ np.linalg.solve(start.pos_cov_e, off) < 16.3  # χ² of 3, once in a thousand
    before = int(np.argmin(np.abs(truth.time - few.fixes.time[-1])))
    moved = np.linalg.norm(truth.pos_e[at] - truth.pos_e[before])
    assert np.linalg.norm(off) < 0.1 * moved + 3.0 and moved > 10.0


def _few_satellites_until(drive, time):
    """Three of them, so that no velocity of least squares puts the start anywhere earlier."""
    seen = drive.observations
    names, count = np.unique(seen.sat[seen.usable], return_counts=True)
    three = np.isin(seen.sat, names[np.argsort(-count)][:3])
    return dataclasses.replace(drive, observations=seen.take(three | (seen.time > time)))


def test_what_three_satellites_leave_open_carries_no_position(drive):
    begin = drive.inertial.time[0]
    few = dataclasses.replace(drive, fixes=drive.fixes.take(drive.fixes.time <= begin + 24.0))
    with pytest.raises(AlignmentError, match="carries no old position"):
        _certified(_few_satellites_until(few, np.inf), position_age_s=np.inf)
