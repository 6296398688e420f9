"""From observations to events: at their true times, as sure as they are, and why not otherwise."""

from pathlib import Path

import numpy as np
import pytest

from certnav.datasets.rtklib import SinglePoint
from certnav.datasets.rtklib.persistence import Persistent
from certnav.filters.earth import SPEED_OF_LIGHT
from certnav.filters.errors import ConfigError
from certnav.nav.config_files import from_tables
from certnav.nav.engine.gnss import gnss_timeline
from certnav.nav.notes import Note
from certnav.velocity.range_rate import line_of_sight
from oracles import rigs

CITY = {"min_cn0_dbhz": 27.0, "elevation_mask_deg": 5.0}
ALL = rigs.NAMES


def gnss(**options):
    return from_tables({"gnss": {"elevation_mask_deg": 0.0, **options}}).gnss


@pytest.fixture
def single(monkeypatch):
    """Single-point positioning that says what it is told: fixes, clock [s], failures, faults."""

    def says(
        time,
        clock=0.0,
        failed=(),
        rejected=(),
        satellites=ALL,
        pos_e=rigs.PLACE,
        persistent=(),
        left_out=(),
    ):
        n = len(time)
        result = SinglePoint(
            rigs.positions(time, pos_e),
            SPEED_OF_LIGHT * np.broadcast_to(clock, n), tuple(failed), (satellites,) * n,
            tuple(rejected), tuple(persistent), tuple(left_out),
        )  # fmt: skip
        asked = {}

        def fake(observations, navigation, **options):
            asked.update(options, observations=observations, navigation=navigation)
            return result

        monkeypatch.setattr("certnav.datasets.rtklib.single_point", fake)
        return asked

    return says


def of_kind(timeline, *kinds):
    return [e for e in timeline.events if e.kind in kinds]


# A drive with a receiver whose clock is 50 ms ahead.


@pytest.fixture(scope="module")
def timeline(city):
    return gnss_timeline(city.sequence, from_tables({"gnss": CITY}).gnss)


def test_events_belong_to_the_true_time_not_to_the_label(city, timeline):
    """A clock 50 ms ahead and 15 m/s: 75 cm if ignored, 1.5 m if it is added."""
    label = np.unique(city.sequence.observations.time)
    true = label - city.clock.bias(label)
    for kinds in (("position",), ("velocity", "doppler")):
        events = of_kind(timeline, *kinds)
        np.testing.assert_allclose([e.time for e in events], true, rtol=0, atol=1e-6)
    doppler = of_kind(timeline, "velocity", "doppler")
    np.testing.assert_array_equal([e.epoch.time for e in doppler], [e.time for e in doppler])
    assert list(timeline.events) == sorted(timeline.events, key=lambda e: (e.time, e.kind))


def test_values_are_those_of_the_antenna_at_that_time(city, timeline):
    config = city.simulation.config
    for kind, limit in (("position", 60.0), ("velocity", 0.3)):
        events = [e for e in of_kind(timeline, kind) if not e.reason]
        truth = city.simulation.trajectory.kinematics(
            np.array([e.time for e in events]), np.array(config.lever_antenna_b)
        )
        true = truth.pos_e if kind == "position" else truth.vel_e
        off = np.linalg.norm([e.value_e for e in events] - true, axis=1)
        assert len(events) > 60 and np.median(off) < limit


def test_positions_share_their_errors_and_name_their_satellites(timeline):
    found = of_kind(timeline, "position")
    assert all(e.shared and len(e.satellites) >= 4 for e in found)
    assert not any(e.resolved for e in found) and 0.0 < timeline.misfit < 1.0
    assert not any(e.shared for e in of_kind(timeline, "velocity", "doppler"))


def test_reflections_that_least_squares_sees_are_marked(city, timeline):
    marked = timeline.observations.rejected == "doppler residual"
    assert marked.sum() > 10
    assert np.mean(city.signals.path[marked] == "reflected") > 0.8


# Single-point positions that say what they are told.


def epochs_of(times, **options):
    return rigs.joined(*(rigs.sky(time=t, **options) for t in times))


def test_a_fix_is_scaled_and_dated(single):
    asked = single([10.0, 11.0], clock=[0.05, 0.07], satellites=("G01", "G02", "G03", "G04"))
    options = gnss(position_sigma_scale=2.0, position_sigma_floor_m=0.5, velocity="none")
    found = gnss_timeline(rigs.recording(epochs_of([10.0, 11.0])), options)
    assert [e.time for e in found.events] == pytest.approx([9.95, 10.93], abs=1e-9)
    for event in found.events:
        np.testing.assert_allclose(event.cov_e, 4.0 * rigs.FIX_COV + 0.25 * np.eye(3))
        assert event.satellites == ("G01", "G02", "G03", "G04") and event.shared
    assert asked["elevation_mask"] == 0.0 and asked["raim"] is True
    assert [n.text for n in found.notes] == ["positions: spp; velocities: none"]


def test_what_is_configured_reaches_single_point_positioning(single):
    asked = single([10.0])
    options = gnss(
        elevation_mask_deg=15.0, ionosphere="off", troposphere="off", raim=False,
        code_sigma_m=1.5, code_weak_sigma_m=4.0,
    )  # fmt: skip
    gnss_timeline(rigs.recording(rigs.sky(time=10.0)), options)
    assert asked["elevation_mask"] == pytest.approx(np.radians(15.0))
    assert (asked["ionosphere"], asked["troposphere"], asked["raim"]) == ("off", "off", False)
    assert (asked["code_sigma"], asked["weak_sigma"]) == (1.5, 4.0)


def test_an_epoch_without_a_fix_says_why_when_and_whose(single):
    """Its time by the clock of the fixes around it; of the satellites those with a range."""
    observations = epochs_of([10.0, 11.0, 12.0])
    silent = (observations.time == 11.0) & np.isin(observations.sat, ["G02", "G05"])
    observations = observations.with_columns(
        pseudorange=np.where(silent, np.nan, observations.pseudorange)
    )
    single([10.0, 12.0], clock=[0.02, 0.04], failed=[(11.0, "chi-square error nv=7 vs=21.3")])
    found = gnss_timeline(rigs.recording(observations), gnss(velocity="none")).events
    assert [e.time for e in found] == pytest.approx([9.98, 10.97, 11.96], abs=1e-9)
    assert [e.reason for e in found] == ["", "no fix: chi-square error", ""]
    assert found[1].satellites == ("G01", "G03", "G04", "G06", "G07", "G08")


def test_reasons_of_rtklib_are_told_without_their_numbers(single):
    single([], failed=[(10.0, "3 satellites"), (11.0, "13 satellites")])
    found = gnss_timeline(rigs.recording(epochs_of([10.0, 11.0])), gnss(velocity="none")).events
    assert [e.reason for e in found] == ["no fix: too few satellites"] * 2
    assert [e.time for e in found] == [10.0, 11.0]  # no fix, no clock


def test_a_faulty_pseudorange_is_marked_and_its_doppler_still_used(single):
    single([10.0], rejected=[2])
    found = gnss_timeline(rigs.recording(rigs.sky(time=10.0)), gnss())
    assert list(found.observations.rejected) == ["", "", "pseudorange residual", *[""] * 5]
    (velocity,) = of_kind(found, "velocity")
    assert "G03" in velocity.satellites


@pytest.mark.parametrize(("epochs", "wrong", "said"), [
    (30, 16, "53 %"), (30, 15, None), (29, 29, None), (31, 31, "100 %"),
])  # fmt: skip
def test_a_satellite_whose_doppler_is_always_refused_is_named(single, epochs, wrong, said):
    """More than half of thirty range rates and more: not chance, and not a few."""
    times = 10.0 + np.arange(epochs)
    observations = epochs_of(times)
    rows = np.flatnonzero(observations.sat == "G04")[:wrong]
    rate = observations.range_rate.copy()
    rate[rows] += 20.0
    single(times)
    observations = observations.with_columns(range_rate=rate)
    notes = [n.text for n in gnss_timeline(rigs.recording(observations), gnss()).notes[1:]]
    assert len(notes) == (said is not None)
    if said is not None:
        assert notes[0].startswith(f"G04: {said} of its Doppler contradicts")


def test_epochs_that_cannot_tell_who_is_wrong_do_not_count(single):
    """Of 60 epochs 25 have eight satellites and refuse one; five satellites cannot."""
    times = 10.0 + np.arange(60)
    observations = epochs_of(times)
    rate = np.where(observations.sat == "G04", 20.0, 0.0) + observations.range_rate
    few = (observations.time >= 41.0) & np.isin(observations.sat, ["G06", "G07", "G08"])
    observations = observations.with_columns(range_rate=np.where(few, np.nan, rate))
    single(times)
    (note,) = gnss_timeline(rigs.recording(observations), gnss()).notes[1:]
    assert note.text.startswith("G04: 100 % of its Doppler") and not note.doubtful


def test_a_satellite_that_is_wrong_all_the_time_is_doubtful(single):
    single([10.0], persistent=[Persistent("G04", -7.4, 60, suspects=("G06",))])
    found = gnss_timeline(rigs.recording(rigs.sky(time=10.0)), gnss())
    (note,) = found.notes[1:]
    assert note.doubtful and note.text.startswith("G04 or G06: its pseudoranges contradict")
    assert "by -7 m on the average of 60 fixes, which are off" in note.text


def test_a_satellite_that_is_left_out_is_named_and_has_no_doppler(single):
    single([10.0], persistent=[Persistent("G03", 512.0, 60)], left_out=[2])
    found = gnss_timeline(rigs.recording(rigs.sky(time=10.0)), gnss())
    (note,) = found.notes[1:]
    assert not note.doubtful and "G03" in note.text and "left out" in note.text
    assert found.observations.rejected[2] == "contradicts the other satellites all the time"
    (velocity,) = of_kind(found, "velocity")
    assert "G03" not in velocity.satellites


def test_relative_positions_get_only_what_a_fix_vouches_for(single, monkeypatch):
    """Neither a pseudorange that was refused, nor an epoch without a fix, nor what is weak."""
    seen = {}

    def fake(events, screened, given, config):
        seen["screened"] = screened
        return events, "figures", (Note("note", "RTK: so and so"),)

    monkeypatch.setattr("certnav.nav.engine.gnss.with_relative_positions", fake)
    single([10.0, 12.0], rejected=[2], failed=[(11.0, "3 satellites")])
    observations = epochs_of([10.0, 11.0, 12.0], cn0={"G05": 20.0})
    with_base = rigs.recording(observations, rover_file=Path("rover"), base=(Path("base"),))
    found = gnss_timeline(with_base, gnss(position="rtk"))
    rejected = seen["screened"].rejected.reshape(3, 8).tolist()
    lost = "not in the single-point fix"
    assert rejected[0] == ["", "", lost, "", "weak signal", "", "", ""]
    assert rejected[1] == [lost] * 4 + ["weak signal"] + [lost] * 3
    assert rejected[2] == ["", "", "", "", "weak signal", "", "", ""]
    assert found.notes[-1].text == "RTK: so and so" and found.resolution == "figures"
    assert lost not in found.observations.rejected  # its Doppler is as good as any


# Doppler.


def only(names, **options):
    return rigs.sky(tuple(names), time=10.0, **options)


def test_a_velocity_that_nothing_has_checked_is_worth_three_metres_per_second(single):
    single([10.0])
    options = gnss(velocity_sigma_scale=2.0, velocity_sigma_floor_mps=4.0)
    (four,) = of_kind(gnss_timeline(rigs.recording(only(ALL[:4])), options), "velocity")
    (five,) = of_kind(gnss_timeline(rigs.recording(only(ALL[:5])), options), "velocity")
    for event, extra in ((four, 16.0 + 9.0), (five, 16.0)):
        n = len(event.satellites)
        obs = event.observations
        e_e = line_of_sight(rigs.PLACE, obs.sat_pos_e, obs.sat_vel_e).e_e
        H = np.column_stack([e_e, -np.ones(n)]) / np.hypot(0.06, 0.04)
        cov = np.linalg.inv(H.T @ H)[:3, :3]
        np.testing.assert_allclose(event.cov_e, 4.0 * cov + extra * np.eye(3), rtol=1e-4)
        np.testing.assert_allclose(event.value_e, 0.0, atol=1e-5)


@pytest.mark.parametrize(("count", "below", "kind", "reason"), [
    (3, "rows", "doppler", ""), (2, "rows", "doppler", ""), (2, "ddia", "doppler", ""),
    (1, "rows", "velocity", "too few satellites"), (3, "off", "velocity", "too few satellites"),
])  # fmt: skip
def test_below_four_the_rows_are_handed_on(single, count, below, kind, reason):
    single([10.0])
    found = gnss_timeline(rigs.recording(only(ALL[:count])), gnss(below_four=below))
    (event,) = of_kind(found, "velocity", "doppler")
    assert (event.kind, event.reason) == (kind, reason)
    assert event.satellites == ALL[:count] and np.isnan(event.value_e).all()
    assert (event.observations is None) == bool(reason)
    if not reason:
        assert tuple(event.observations.sat) == ALL[:count]
    assert len(event.epoch.rows) == count  # alignment takes what it can get


def test_a_row_that_least_squares_refuses_is_offered_to_the_filter_not_to_alignment(single):
    """The filter tests again, and knows better; alignment has no prior yet."""
    single([10.0])
    found = gnss_timeline(rigs.recording(only(ALL, bias={"G06": 5.0})), gnss())
    (event,) = of_kind(found, "velocity")
    assert event.satellites == tuple(n for n in ALL if n != "G06")
    assert "G06" in event.observations.sat and "G06" not in event.epoch.rows.sat
    assert found.observations.rejected[5] == "doppler residual"


def test_without_any_row_there_is_no_epoch(single):
    single([10.0])
    observations = only(ALL)
    silent = observations.with_columns(
        range_rate=np.where(np.arange(8) < 7, np.nan, observations.range_rate)
    )
    lone = silent.mark(np.arange(8) == 7, "out")
    mixed = rigs.joined(lone, rigs.sky(time=11.0))
    first, second = of_kind(gnss_timeline(rigs.recording(mixed), gnss()), "velocity", "doppler")
    assert first.epoch is None and first.reason == "too few satellites"
    assert second.epoch is not None


def test_lines_of_sight_are_seen_from_where_the_antenna_was(single):
    """Interpolated between fixes, held before the first and after the last one."""
    east = 10e3 * rigs.C_EN[:, 1]
    single([10.0, 12.0], pos_e=np.array([rigs.PLACE, rigs.PLACE + 2.0 * east]))
    found = gnss_timeline(rigs.recording(epochs_of([9.0, 11.0, 13.0])), gnss())
    at = [e.epoch.pos_e for e in of_kind(found, "velocity", "doppler")]
    expected = [rigs.PLACE, rigs.PLACE + east, rigs.PLACE + 2.0 * east]
    np.testing.assert_allclose(at, expected, atol=1e-6)


def test_weak_and_low_signals_are_marked_and_counted_out(single):
    single([10.0])
    options = gnss(min_cn0_dbhz=35.0, elevation_mask_deg=30.0)
    power = {"G02": 34.9, "G03": 35.0}
    found = gnss_timeline(rigs.recording(only(ALL, cn0=power)), options)
    rejected = dict(zip(found.observations.sat, found.observations.rejected, strict=True))
    low = np.degrees(found.observations.elevation) < 30.0
    assert 0 < low.sum() < 7 and rejected["G02"] == "weak signal"
    assert {n for n, why in rejected.items() if why == "below elevation mask"} == set(
        found.observations.sat[low & (found.observations.sat != "G02")]
    )
    assert found.epochs.tracked.tolist() == [8]
    assert found.epochs.usable.tolist() == [sum(not why for why in rejected.values())]


def test_two_signals_of_a_satellite_are_one_satellite(single):
    single([10.0])
    both = rigs.joined(only(ALL[:5]), only(ALL[:2]))
    epochs = gnss_timeline(rigs.recording(both), gnss()).epochs
    assert epochs.tracked.tolist() == [5] and epochs.usable.tolist() == [5]


def test_doppler_without_any_position_is_refused(single):
    single([], failed=[(10.0, "3 satellites")])
    with pytest.raises(ConfigError, match="needs an approximate position"):
        gnss_timeline(rigs.recording(only(ALL)), gnss())
    with pytest.raises(ConfigError, match="needs an approximate position"):
        gnss_timeline(rigs.recording(only(ALL), navigation=()), gnss())


def test_constellations_that_are_not_asked_for_take_no_part(single):
    sky = rigs.sky(time=10.0)
    mixed = sky.with_columns(sat=np.where(np.arange(8) < 2, "E0" + np.char.mod("%d", np.arange(8)),
                                          sky.sat))  # fmt: skip
    single([10.0])
    found = gnss_timeline(rigs.recording(mixed), gnss(systems="G"))
    assert list(found.observations.rejected[:3]) == ["constellation not asked for"] * 2 + [""]
    assert not gnss_timeline(rigs.recording(mixed), gnss()).observations.rejected[0]
    with pytest.raises(ConfigError, match=r"gnss\.systems: found 'C', and the recording has E, G"):
        gnss_timeline(rigs.recording(mixed), gnss(systems="C"))


def mixed(times, offset=0.0, few=0):
    """Return a sky of GPS and Galileo, Galileo's range rates off by `offset`; first `few` of it."""
    o = epochs_of(times)
    names = np.array([*("G01", "G02", "G03", "G04", "G05"), *("E06", "E07", "E08")])
    sat = np.tile(names, len(times))
    rate = o.range_rate + offset * np.char.startswith(sat, "E")
    o = o.with_columns(sat=sat, range_rate=rate)
    keep = np.tile(np.isin(np.arange(8), [0, 5, 6][:few] if few else np.arange(8)), len(times))
    return o.take(keep)


def test_a_constellation_with_another_drift_is_refused_with_the_reason(single):
    times = 10.0 + np.arange(30.0)
    for offset, refused in ((0.0, False), (0.8, True)):
        single(times)
        found = gnss_timeline(rigs.recording(mixed(times, offset)), gnss())
        marked = found.observations.rejected == "constellation's Doppler disagrees"
        assert marked.sum() == (3 * 30 if refused else 0)
        said = [n.text for n in found.notes if n.doubtful]
        assert bool(said) is refused and all("Galileo: its Doppler has another" in t for t in said)
        (first, *_) = of_kind(found, "velocity")
        assert {satellite[0] for satellite in first.satellites} == set("G" if refused else "GE")


def test_three_satellites_of_any_mixture_are_rows(single):
    single([10.0])
    found = gnss_timeline(rigs.recording(mixed([10.0], few=3)), gnss())
    (offered,) = of_kind(found, "doppler")
    assert offered.satellites == ("G01", "E06", "E07") and len(offered.observations) == 3
