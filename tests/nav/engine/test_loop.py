"""The loop: each event at its time, constraints in between, and a filter that may be wrong."""

from collections import deque

import numpy as np
import pytest

from certnav.filters.error_model import POS, VEL
from certnav.filters.errors import DataError
from certnav.nav.config_files import from_tables
from certnav.nav.engine.blind import gap
from certnav.nav.engine.events import GnssEvent, missing
from certnav.nav.engine.fix_update import ENLARGED
from certnav.nav.engine.loop import Diverged, FilterLoop
from certnav.nav.engine.vehicle import VehicleConstraints
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate
from oracles import rigs

ALONE = {"nhc": "off", "zupt": False, "zaru": False}
EAST, DOWN = rigs.C_EN[:, 1], rigs.C_EN[:, 2]


def loop_of(kalman, calibration=None, spells=None, **tables):
    config = from_tables({"vehicle": ALONE, "filter": {"patience_s": 3.0}, **tables})
    calibration = calibration or rigs.calibration()
    vehicle = VehicleConstraints(calibration, config.vehicle)
    return FilterLoop(kalman, calibration, vehicle, config, spells)


def position(time, metres=0.0, satellites=(), shared=False):
    return GnssEvent(
        time, "position", rigs.PLACE + metres * EAST, np.eye(3), satellites, shared=shared
    )


def velocity(time, speed=0.0):
    return GnssEvent(time, "velocity", speed * EAST, 0.01 * np.eye(3))


def doppler(time, names=rigs.NAMES[:6], **sky):
    nothing = np.full(3, np.nan)
    return GnssEvent(
        time, "velocity", nothing, np.full((3, 3), np.nan), tuple(names),
        observations=rigs.sky(tuple(names), time=time, **sky),
    )  # fmt: skip


# When.


def test_constraints_come_every_interval_between_the_events():
    """At begin + k·interval, those before an event before it, one at its instant after it."""
    kalman = rigs.filter_at_rest(6.0)
    loop = loop_of(kalman, vehicle={"interval_s": 0.5, "nhc": "on", "zupt": False, "zaru": False})
    loop.offer(position(1.25))
    loop.offer(position(2.0))
    loop.advance(3.2)
    log = [(round(u.time, 6), u.kind) for u in loop.updates]
    assert log == [
        (0.5, "nhc"), (1.0, "nhc"), (1.25, "position"), (1.5, "nhc"), (2.0, "position"),
        (2.0, "nhc"), (2.5, "nhc"), (3.0, "nhc"),
    ]  # fmt: skip
    assert kalman.time == pytest.approx(3.2) and all(u.accepted for u in loop.updates)


@pytest.mark.parametrize("off", [-5e-7, -2e-8, 0.0, 5e-10, 2e-8, 5e-7])
def test_an_event_at_the_time_of_a_constraint_goes_first_whatever_rounding_says(off):
    kalman = rigs.filter_at_rest(6.0)
    loop = loop_of(kalman, vehicle={"interval_s": 0.5, "nhc": "on", "zupt": False, "zaru": False})
    loop.offer(position(1.0 + off))
    loop.offer(position(1.7))
    assert [u.kind for u in loop.updates] == ["nhc", "position", "nhc", "nhc", "position"]


def test_they_count_from_where_the_filter_began():
    stream = rigs.stream_at_rest(rigs.C_EN, 6.0, start=100.0)
    kalman = rigs.filter_at_rest(stream=stream)
    kalman.propagate(100.3)
    loop = loop_of(kalman, vehicle={"interval_s": 2.0, "nhc": "on", "zupt": False, "zaru": False})
    loop.constrain(105.0)
    assert [u.time for u in loop.updates] == pytest.approx([102.3, 104.3])


def test_events_that_the_filter_cannot_take_say_why():
    kalman = rigs.filter_at_rest(3.0)
    loop = loop_of(kalman)
    assert loop.offer(position(0.0)).reason == "before alignment"
    assert loop.offer(position(3.01)).reason == "after the IMU data"
    assert kalman.time == 0.0
    assert loop.offer(position(2.0)).accepted and kalman.time == pytest.approx(2.0)
    assert loop.offer(position(2.0 - 1e-10)).accepted  # the same instant
    late = loop.offer(position(1.9))
    assert late.reason == "late: the filter is past it" and not late.accepted
    assert loop.offer(position(3.0)).accepted  # up to the last sample
    assert kalman.time == pytest.approx(3.0)
    own = loop.offer(missing(2.5, "position", "no fix: few", ("G01",)))
    assert (own.reason, own.satellites, own.kind) == ("no fix: few", ("G01",), "position")
    assert own.whitened == () and np.isnan(own.nis)
    assert loop.offer(missing(0.0, "velocity", "no fix: few")).reason == "no fix: few"
    assert len(loop.updates) == 8 and loop.updates[-2] is own


def test_the_last_position_before_the_start_is_the_one_the_filter_began_with():
    """What it came from is what the first position after it is compared with."""
    for before, fades in (
        ([position(-1.0, 0.0, ("A", "B"), True), position(0.0, 0.0, ("C", "D"), True)], True),
        ([position(-1.0, 0.0, ("C", "D"), True), position(0.0, 0.0, ("A", "B"), True)], False),
        ([position(0.0, 0.0, ("C", "D"), False)], False),
        ([missing(0.0, "position", "no fix: few", ("C", "D"))], False),
    ):
        kalman = rigs.filter_at_rest(fix_correlation=1e9)
        loop = loop_of(kalman)
        for event in before:
            loop.offer(event)
        update = loop.offer(position(1.0, 0.5, ("A", "B"), True))
        # Other satellites: S = 1 + 0.9 + 0.1; the same: 1 − 1.8 + 0.9 + 0.1.
        assert update.nis == pytest.approx(0.25 / (2.0 if fades else 0.2), rel=0.05)


def test_spells_that_are_over_are_taken_out_and_those_to_come_widen():
    kalman = rigs.filter_at_rest(8.0)
    spells = deque([gap(0.5, 1.0), gap(3.0, 5.0)])
    loop = loop_of(kalman, spells=spells)
    loop.advance(2.0)
    before = kalman.P[VEL, VEL][0, 0]
    loop.advance(2.9)
    assert list(spells) == [gap(3.0, 5.0)]
    assert kalman.P[VEL, VEL][0, 0] < before + 0.1
    loop.advance(4.0)  # 2 m/s² for a second, and what the tilt adds
    assert before + 4.0 < kalman.P[VEL, VEL][0, 0] < before + 4.5
    spells.append(gap(6.0, 7.0))  # as a live stream does
    loop.advance(7.5)
    assert kalman.P[VEL, VEL][0, 0] > before + 16.0 + 4.0
    assert loop_of(kalman).spells == deque()


# Refusals that last.


def insisted(loop, events):
    """Return at which events the covariance was enlarged."""
    times = []
    for event in events:
        before = loop.kalman.P[POS, POS][0, 0]
        loop.offer(event)
        if loop.kalman.P[POS, POS][0, 0] > 5.0 * before:
            times.append(round(event.time, 6))
    return times


@pytest.mark.parametrize(("interval", "patience", "times"), [
    (1.0, 3.0, [4.0, 6.0, 8.0]),
    (0.1, 3.0, [3.1, 5.1, 7.1]),
    (1.0, 5.0, [6.0, 8.0]),
    (1.0, 0.0, []),
])  # fmt: skip
def test_patience_is_a_time_whatever_the_rate(interval, patience, times):
    """A kilometre off: three seconds, and again after every two."""
    loop = loop_of(rigs.filter_at_rest(9.0), filter={"patience_s": patience})
    events = [position(t, 1000.0) for t in interval * np.arange(1, 8.6 / interval)]
    assert insisted(loop, events) == times


def test_better_evidence_takes_two_seconds():
    """Six satellites of a single-point position; not five, nor what was made elsewhere."""
    for count, shared, first in ((6, True, 3.0), (5, True, 4.0), (6, False, 4.0)):
        loop = loop_of(rigs.filter_at_rest(9.0))
        names = rigs.NAMES[:count]
        events = [position(t, 1000.0, names, shared) for t in np.arange(1.0, 5.0)]
        assert insisted(loop, events)[0] == first


def test_one_accepted_position_begins_it_anew():
    loop = loop_of(rigs.filter_at_rest(9.0))
    off = [1000.0, 1000.0, 1000.0, 0.0, 1000.0, 1000.0, 1000.0, 1000.0]
    assert insisted(loop, [position(1.0 + k, m) for k, m in enumerate(off)]) == [8.0]


def test_kinds_have_a_patience_each():
    loop = loop_of(rigs.filter_at_rest(9.0))
    for t in (1.0, 2.0, 3.0):
        loop.offer(velocity(t, 50.0))
    assert insisted(loop, [position(4.0, 1000.0)]) == []
    assert insisted(loop, [velocity(4.5, 50.0)]) == [4.5]


def test_a_shift_that_stays_is_believed_in_the_end():
    """40 m: NIS 800; ×10 leaves 145, ×100 leaves 15.9."""
    loop = loop_of(rigs.filter_at_rest(9.0, sigma=(1.0, 1e-3, 1e-5)))
    reasons = {}
    for t in np.arange(1.0, 9.0):
        reasons[t] = loop.offer(position(t, 40.0 + 0.01 * t)).reason
    refused = "innovation test (NIS > 21.1)"
    assert [reasons[t] for t in (3.0, 4.0, 5.0)] == [refused] * 3
    assert [reasons[t] for t in (6.0, 7.0)] == [ENLARGED, ""]
    assert EAST @ (loop.kalman.pos_e - rigs.PLACE) == pytest.approx(40.0, abs=1.0)


def test_refused_doppler_is_refused_velocity():
    """Eight satellites say 5 m/s: after two seconds it is the filter that is doubted."""
    loop = loop_of(rigs.filter_at_rest(9.0, clock_walk=0.1))
    moving = {"vel_e": 5.0 * EAST, "names": rigs.NAMES}
    for t in (1.0, 2.0):
        assert not loop.offer(doppler(t, **moving)).accepted
    assert loop.offer(doppler(3.0, **moving)).accepted
    np.testing.assert_allclose(loop.kalman.vel_e, 5.0 * EAST, atol=0.1)


def test_fewer_than_six_satellites_wait_as_long_as_any_other():
    loop = loop_of(rigs.filter_at_rest(9.0, clock_walk=0.1))
    moving = {"vel_e": 1.5 * EAST, "names": rigs.NAMES[:5]}
    accepted = [loop.offer(doppler(t, **moving)).accepted for t in (1.0, 2.0, 3.0, 4.0)]
    assert accepted == [False, False, False, True]


def test_two_or_three_satellites_need_longer_than_a_reflection_lasts():
    """What takes four ten seconds takes three half a minute."""
    for count, first in ((4, 11.0), (3, 29.0)):
        loop = loop_of(rigs.filter_at_rest(45.0, clock_walk=0.1), filter={"patience_s": 10.0})
        bias = dict(zip(rigs.NAMES, (50.0, -40.0, 60.0, -70.0), strict=False))
        before = after = 0.0
        for t in np.arange(1.0, first + 1.0):
            before = after
            assert not loop.offer(doppler(t, rigs.NAMES[:count], bias=bias)).accepted
            after = loop.kalman.P[VEL, VEL][0, 0]
        assert before < 0.3**2 and after > 5.0 * before  # doubted at last


def test_one_satellite_that_agrees_speaks_for_the_filter():
    """Of three, two are reflected: that is no reason to doubt it, however long it lasts."""
    loop = loop_of(rigs.filter_at_rest(12.0, clock_walk=0.1))
    bias = {"G02": 30.0, "G03": -50.0}
    for t in np.arange(1.0, 11.0):
        update = loop.offer(doppler(t, rigs.NAMES[:3], bias=bias))
        assert update.reason == "fewer than two satellites agree with the filter"
    assert loop.kalman.P[VEL, VEL][0, 0] < 0.2**2


#: Two constraints a second, of 0.2 m/s each.
TWICE = {
    "interval_s": 0.5, "nhc": "on", "sigma_lateral_mps": 0.2 / 2**0.5,
    "sigma_vertical_mps": 0.2 / 2**0.5,
}  # fmt: skip


def sideways(speed, **vehicle):
    """A filter at rest that believes it drifts to the right."""
    kalman = rigs.filter_at_rest(12.0, sigma=(1.0, 0.01, 1e-4))
    kalman.vel_e += speed * EAST
    loop = loop_of(kalman, vehicle={**TWICE, **vehicle})
    loop.constrain(11.0)
    return loop


def test_a_constraint_that_is_refused_for_long_doubts_the_filter():
    """Refused from 0.5 s on: tried in force at 3.5 s, every two seconds, until it fits."""
    loop = sideways(1.5, zupt=False, zaru=False)
    log = {round(u.time, 6): (u.accepted, u.reason) for u in loop.updates}
    forced = [t for t, (_, reason) in log.items() if reason == ENLARGED]
    assert forced and forced[0] in (3.5, 5.5, 7.5)
    first = forced[0]
    assert all(not accepted for t, (accepted, _) in log.items() if t < first)
    assert all(accepted for t, (accepted, _) in log.items() if t >= first)
    assert all(np.isfinite(u.nis) and u.nis > 18.4 for u in loop.updates if u.time <= first)
    assert abs(EAST @ loop.kalman.vel_e) < 0.5


def test_the_attempts_of_a_constraint_are_two_seconds_apart():
    P = []
    kalman = rigs.filter_at_rest(12.0, sigma=(1.0, 0.01, 1e-4))
    kalman.vel_e += 300.0 * EAST
    loop = loop_of(kalman, vehicle={"interval_s": 0.5, "nhc": "on", "zupt": False, "zaru": False})
    for t in np.arange(0.5, 9.0, 0.5):
        loop.constrain(t + 0.01)
        P.append(kalman.P[POS, POS][0, 0])
    grown = 0.5 * (2 + np.flatnonzero(np.array(P[1:]) > 5.0 * np.array(P[:-1])))
    assert grown.tolist() == [3.5, 5.5, 7.5]


def test_what_was_forced_upon_it_begins_its_patience_anew():
    loop = sideways(1.5, zupt=False, zaru=False)
    (forced,) = [u.time for u in loop.updates if u.reason == ENLARGED]
    kalman = rigs.filter_at_rest(12.0, sigma=(1.0, 0.01, 1e-4))
    kalman.vel_e += 1.5 * EAST
    again = loop_of(kalman, vehicle={**TWICE, "zupt": False, "zaru": False})
    again.constrain(forced + 0.01)
    assert again.updates[-1].reason == ENLARGED
    kalman.vel_e += 300.0 * EAST
    before = kalman.P[POS, POS][0, 0]
    again.constrain(forced + 0.51)
    assert not again.updates[-1].accepted and kalman.P[POS, POS][0, 0] < 2.0 * before


def test_a_filter_that_is_contradicted_for_two_seconds_tells_no_standstill():
    """The rest of the IMU is believed until velocities have refused that long."""
    kalman = rigs.filter_at_rest(8.0)
    on = {"interval_s": 0.5, "nhc": "on", "zupt": True, "zaru": False}
    loop = loop_of(kalman, vehicle=on, filter={"patience_s": 0.0})
    for t in (1.2, 2.2, 3.2, 4.2):
        loop.offer(velocity(t, 50.0))
    kinds = {round(u.time, 6): u.kind for u in loop.updates if u.kind != "velocity"}
    assert {t for t, kind in kinds.items() if kind == "zupt"} == {0.5, 1.0, 1.5, 2.0, 2.5, 3.0}
    assert {t for t, kind in kinds.items() if kind == "nhc"} == {3.5, 4.0}


# Two or three satellites: the car goes where it points.


@pytest.mark.parametrize(("wanted", "mounted", "nhc", "there"), [
    ("on", "", "off", True), ("auto", "test", "off", True), ("auto", "", "off", False),
    ("off", "test", "off", False), ("on", "test", "on", False), ("auto", "test", "auto", False),
])  # fmt: skip
def test_rows_come_with_straight_ahead_where_nothing_else_says_so(wanted, mounted, nhc, there):
    kalman = rigs.filter_at_rest(3.0, sigma=(1.0, 1.0, 1e-3), clock_walk=0.1)
    vehicle = {"nhc": nhc, "zupt": False, "zaru": False, "interval_s": 10.0}
    tables = {"gnss": {"forward_motion": wanted}, "vehicle": vehicle}
    loop = loop_of(kalman, rigs.calibration(mounted=mounted), **tables)
    loop.offer(doppler(1.0, rigs.NAMES[:2]))
    assert [u.kind for u in loop.updates] == (["nhc"] if there else []) + ["doppler"]
    across = np.sqrt([a @ kalman.P[VEL, VEL] @ a for a in (EAST, DOWN)])
    assert (across < 0.11).all() == there  # σ is 0.1 m/s


# When it breaks.


def test_a_solution_that_is_no_number_is_a_divergence():
    for spoil in ("pos_e", "P"):
        kalman = rigs.filter_at_rest(3.0)
        loop = loop_of(kalman)
        loop.advance(1.0)
        getattr(kalman, spoil)[:] = np.nan
        with pytest.raises(Diverged, match=r"diverged after 1\.0 s") as error:
            loop.advance(2.0)
        assert "check units and axes of the IMU" in str(error.value)


@pytest.mark.parametrize("error", [DataError("nothing"), np.linalg.LinAlgError("singular")])
def test_what_the_filter_chokes_on_is_a_divergence(monkeypatch, error):
    loop = loop_of(rigs.filter_at_rest(3.0))

    def fail(*_):
        raise error

    monkeypatch.setattr(loop.kalman, "update", fail)
    with pytest.raises(Diverged) as raised:
        loop.offer(position(1.0))
    assert raised.value.__cause__ is error and loop.updates == []


# The whole of it, in a city.


@pytest.fixture(scope="module")
def solution(city):
    return navigate(city.sequence, from_tables({
        "gnss": {"min_cn0_dbhz": 27.0, "elevation_mask_deg": 5.0},
        "vehicle": {"interval_s": 0.5},
        "alignment": {"method": "level+course"},
    }))  # fmt: skip


def test_in_a_city_the_errors_stay_within_their_sigma(city, solution):
    result = evaluate(solution, city.sequence)
    assert (np.abs(result.error_pos_n) < 4.0 * result.sigma_pos_n).all()
    assert result.metrics["velocity_3d_rms_mps"] < 0.1
    assert result.metrics["heading_rms_deg"] < 0.5


def test_what_is_left_out_is_what_was_reflected(city, solution):
    observations, path = city.sequence.observations, city.signals.path
    true = observations.time - city.clock.bias(observations.time)
    left_out = [u for u in solution.updates if u.reason.startswith("disagrees with the filter")]
    kinds = [
        path[(np.abs(true - u.time) < 1e-3) & (observations.sat == sat)][0]
        for u in left_out
        for sat in u.satellites
    ]
    assert len(kinds) >= 10 and kinds.count("reflected") >= 0.8 * len(kinds)


def test_constraints_of_a_run_are_half_a_second_apart(solution):
    times = np.array([u.time for u in solution.updates if u.kind in ("nhc", "zupt")])
    np.testing.assert_allclose(np.diff(times), 0.5, atol=1e-6)
    began = solution.alignment.time
    assert times[0] == pytest.approx(began + 0.5, abs=1e-6)
