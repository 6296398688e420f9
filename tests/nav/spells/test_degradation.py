"""Simulated weak GNSS: what is left is what was asked for, and nothing else changes."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import ConfigError
from certnav.nav.spells.degradation import REASON, degrade
from certnav.nav.spells.outages import in_spells, parse_outages


@pytest.fixture(scope="module")
def drive():
    """A drive under open sky, with carried positions once a second."""
    simulation = simulate(
        SimulationConfig(seed=4, duration=240.0, density="open", imu_rate=20.0, noise=False)
    )
    time = np.arange(1.0, 239.0) + simulation.config.start_time
    lever = simulation.calibration.lever_antenna_b
    rng = np.random.default_rng(1)
    fixes = fixes_from_truth(simulation.trajectory, time, lever, 1.0, 0.05, rng)
    return simulation.sequence(fixes)


def test_grammar_says_what_was_meant():
    spec = parse_outages("60/180:2-3high@0,60,120")
    assert (spec.duration, spec.period, spec.least, spec.most) == (60.0, 180.0, 2, 3)
    assert spec.order == "high" and spec.shifts == (0.0, 60.0, 120.0)
    assert spec.is_random and spec.keeps_some
    plain = parse_outages("60/180")
    assert plain.most == 0 and not plain.is_random and not plain.keeps_some
    street = parse_outages("60/180:canyon50")
    assert street.order == "canyon" and street.mask_deg == 50.0 and street.keeps_some
    rest = parse_outages("10-end:2")
    assert rest.start == 10.0 and np.isinf(rest.end) and rest.order == "random"


@pytest.mark.parametrize(
    "text", ["", "60", "180/60", "60/180:", "60/180:3-2", "20-10", "10-end@5", "60/180:canyon95"]
)
def test_nonsense_is_refused_in_one_line(text):
    with pytest.raises(ConfigError) as error:
        parse_outages(text)
    assert "\n" not in str(error.value) and "--outages" in str(error.value)


def test_shifts_cover_the_drive_once():
    spec = parse_outages("60/180@0,60,120")
    time = np.arange(180.0, 900.0, 0.5)
    covered = sum(
        in_spells(time, spec.spells(0.0, 1080.0, 0.0, shift)).astype(int) for shift in spec.shifts
    )
    assert (covered == 1).all()


def test_no_spell_before_the_filter_has_settled_or_beyond_the_end():
    spells = parse_outages("60/180").spells(100.0, 700.0, 300.0)
    np.testing.assert_allclose(spells, [[400.0, 460.0], [580.0, 640.0]])
    with pytest.raises(ConfigError, match="no spell fits"):
        parse_outages("60/180").spells(0.0, 170.0, 0.0)
    with pytest.raises(ConfigError, match="begins at second 10"):
        parse_outages("10-end").spells(0.0, 60.0, 12.0)


@pytest.mark.parametrize("order", ["", "high", "low"])
def test_exactly_n_satellites_are_left_in_spells_and_all_outside(drive, order):
    first, last = drive.span
    spec = parse_outages(f"40/100:2{order}")
    spells = spec.spells(first, last, first)
    cut = degrade(drive, spells, spec, seed=1)
    before, after = drive.observations, cut.observations
    inside = in_spells(before.time, spells)
    np.testing.assert_array_equal(after.rejected[~inside], before.rejected[~inside])
    assert len(after) == len(before)
    assert set(after.rejected[inside & ~after.usable]) >= {REASON}
    for time, rows in after.epochs():
        if in_spells(np.array([time]), spells)[0]:
            assert np.unique(after.sat[rows][after.usable[rows]]).size == 2


def test_high_and_low_are_at_the_ends_of_the_sky(drive):
    first, last = drive.span
    mean = {}
    for order in ("high", "low"):
        spec = parse_outages(f"40/100:2{order}")
        spells = spec.spells(first, last, first)
        left = degrade(drive, spells, spec).observations
        rows = left.usable & in_spells(left.time, spells)
        mean[order] = np.degrees(left.elevation[rows].mean())
        everything = drive.observations.elevation[in_spells(left.time, spells)]
        mean["all"] = np.degrees(everything[everything > np.radians(10.0)].mean())
    assert mean["low"] + 5.0 < mean["all"] < mean["high"] - 5.0


def test_a_street_hides_what_is_low_across_it(drive):
    first, last = drive.span
    spec = parse_outages("40/100:canyon60")
    spells = spec.spells(first, last, first)
    left = degrade(drive, spells, spec).observations
    inside = in_spells(left.time, spells) & drive.observations.usable
    heading = np.interp(left.time, drive.reference.time, np.unwrap(drive.reference.rpy[:, 2]))
    across = np.abs(np.sin(left.azimuth - heading))
    low = left.elevation < np.radians(30.0)
    turning = np.abs(np.gradient(np.unwrap(drive.reference.rpy[:, 2]), drive.reference.time))
    straight = np.interp(left.time, drive.reference.time, turning) < 1e-3
    hidden = inside & low & (across > 0.8) & straight
    assert hidden.any() and not left.usable[hidden].any()
    assert left.usable[inside & (left.elevation > np.radians(61.0))].all()
    along = inside & (across < 0.05) & (left.elevation > np.radians(12.0)) & straight
    assert left.usable[along].all()


def test_seeds_draw_and_repeat(drive):
    first, last = drive.span
    spec = parse_outages("40/100:3")
    spells = spec.spells(first, last, first)
    a, b, c = (degrade(drive, spells, spec, seed=s).observations.usable for s in (1, 1, 2))
    np.testing.assert_array_equal(a, b)
    assert (a != c).any()


def test_carried_positions_leave_within_spells_only(drive):
    first, last = drive.span
    spec = parse_outages("40/100")
    spells = spec.spells(first, last, first)
    cut = degrade(drive, spells, spec)
    gone = np.setdiff1d(drive.fixes.time, cut.fixes.time)
    np.testing.assert_array_equal(gone, drive.fixes.time[in_spells(drive.fixes.time, spells)])
    assert f"{gone.size} carried positions left out" in cut.notes[-1]


def test_satellites_cannot_be_left_where_there_are_none(drive):
    import dataclasses

    bare = dataclasses.replace(drive, observations=None)
    first, last = drive.span
    spec = parse_outages("40/100:2")
    with pytest.raises(ConfigError, match="no satellite observations"):
        degrade(bare, spec.spells(first, last, first), spec)
