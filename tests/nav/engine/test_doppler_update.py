"""Which Doppler the loop believes, for how long, and when it doubts itself instead."""

import dataclasses

import numpy as np
import pytest

from certnav.datasets.sequence import Calibration
from certnav.filters.earth import C_en_of
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import VEL, ErrorModel
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream, NavState
from certnav.nav.config_files import from_tables
from certnav.nav.engine.doppler_screening import DopplerScreening
from certnav.nav.engine.doppler_update import DopplerUpdates, rows_measurement
from certnav.nav.engine.events import GnssEvent
from certnav.velocity.range_rate import DopplerRows, doppler_rows
from oracles import rigs

HOLD, SIGMA = 10.0, 0.05
DRIFT = 12.0


@pytest.fixture
def kalman():
    """A filter at rest that knows its velocity to 5 cm/s and the clock's drift to 10 cm/s."""
    model = ErrorModel(imu_preset("adis16470"), clock_walk=0.1)
    pos_e = np.array([-2267e3, 5009e3, 3221e3])
    C_eb = C_en_of(pos_e)
    time = np.arange(0.0, 2.0, 0.01)
    stream = InertialStream(time, np.zeros((time.size, 3)), np.zeros((time.size, 3)))
    P = model.initial_covariance(np.eye(3), np.eye(3) * 0.05**2, np.eye(3) * 1e-6)
    P[model.clock, model.clock] = 0.1**2
    made = ErrorStateFilter(model, stream, NavState(stream.start, pos_e, np.zeros(3), C_eb), P)
    made.gnss.clock_drift = DRIFT
    return made


def epoch(bias, drift=DRIFT, names="ABCDEF"):
    """Range rates of a receiver at rest; `bias` [m/s] by satellite."""
    rng = np.random.default_rng(7)
    n = len(names)
    azimuth, elevation = np.arange(n) * 2.1, rng.uniform(0.3, 1.2, n)
    C_en = C_en_of(np.array([-2267e3, 5009e3, 3221e3]))
    e_n = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
         -np.sin(elevation)]
    )  # fmt: skip
    z = np.full(n, -drift) + [bias.get(name, 0.0) for name in names]
    return _rows(e_n @ C_en.T, z, np.array(list(names)))


def _rows(e_e, z, sat):
    fields = {f.name for f in dataclasses.fields(DopplerRows)}
    n = len(z)
    values = {
        "e_e": e_e, "z": z, "sigma": np.full(n, SIGMA), "sat": sat, "row": np.arange(n),
        "epoch": np.zeros(n, dtype=int), "time": np.zeros(n),
    }  # fmt: skip
    return DopplerRows(**{k: v for k, v in values.items() if k in fields})


CALIBRATION = Calibration(imu_preset("adis16470"), np.zeros(3), "test")


def test_sound_satellites_are_believed(kalman):
    screening = DopplerScreening(HOLD, 1e-4)
    assert screening.test(kalman, CALIBRATION, epoch({}), 0.0).all()


def test_a_refused_satellite_stays_out_while_the_filter_grows_modest(kalman):
    screening = DopplerScreening(HOLD, 1e-4)
    used = screening.test(kalman, CALIBRATION, epoch({"B": 3.0}), 0.0)
    np.testing.assert_array_equal(used, [True, False, True, True, True, True])
    kalman.P[VEL, VEL] *= 1e4  # now 3 m/s would pass
    pair = epoch({"B": 3.0}, names="AB")
    assert not screening.test(kalman, CALIBRATION, pair, 5.0)[1]
    # Held off, but found in order meanwhile: believed when its time is over.
    assert screening.test(kalman, CALIBRATION, epoch({}), HOLD + 0.1).all()


def test_on_hold_its_time_does_not_run_while_it_disagrees(kalman):
    screening = DopplerScreening(HOLD, 1e-4)
    for t in (0.0, 6.0, 12.0):
        used = screening.test(kalman, CALIBRATION, epoch({"B": 3.0}), t)
        assert not used[1] and used.sum() == 5
    assert screening.held(epoch({}), 21.9)[1]
    assert not screening.held(epoch({}), 22.1)[1]


def test_a_jump_of_the_clock_is_no_fault_of_the_satellites(kalman):
    screening = DopplerScreening(HOLD, 1e-4)
    used = screening.test(kalman, CALIBRATION, epoch({}, drift=DRIFT + 40.0), 0.0)
    assert used.all()
    assert kalman.P[kalman.model.clock, kalman.model.clock] > 1e5
    kalman.update(rows_measurement(kalman, CALIBRATION, epoch({}, drift=DRIFT + 40.0)))
    assert kalman.gnss.clock_drift == pytest.approx(DRIFT + 40.0, abs=0.1)
    assert np.linalg.norm(kalman.vel_e) < 0.1


def test_one_satellite_says_something_once_the_clock_is_known(kalman):
    before = np.trace(kalman.P[VEL, VEL])
    kalman.P[kalman.model.clock, kalman.model.clock] = 0.01**2
    kalman.update(rows_measurement(kalman, CALIBRATION, epoch({}, names="A")))
    assert np.trace(kalman.P[VEL, VEL]) < 0.9 * before


# Updates: what is done with what is believed.

NORTH, EAST = rigs.C_EN[:, 0], rigs.C_EN[:, 1]
FEW = "fewer than two satellites agree with the filter"


def event(names=rigs.NAMES, time=0.0, known=None, **sky):
    """Doppler of an epoch; `known` are those behind its least-squares velocity."""
    nothing = np.full(3, np.nan)
    return GnssEvent(
        time, "velocity", nothing, np.full((3, 3), np.nan), tuple(known or names),
        observations=rigs.sky(tuple(names), time=time, **sky),
    )  # fmt: skip


def updates(kalman, forward=False, calibration=None, **gnss):
    """Return `DopplerUpdates` and the log of what it says beside its answers."""
    log = []
    config = from_tables({"gnss": gnss})
    made = DopplerUpdates(kalman, calibration or rigs.calibration(), config, forward, log.append)
    return made, log


def knowing(velocity=0.05, attitude=1e-3, **more):
    return rigs.filter_at_rest(sigma=(1.0, velocity, attitude), clock_walk=0.1, **more)


def told(update):
    return update.kind, update.accepted, update.reason


def test_what_is_predicted_is_the_velocity_of_the_antenna(monkeypatch):
    """0.3 rad/s at the end of a lever; lines of sight, too, are seen from there."""
    seen = []

    def watched(observations, pos_e, noise):
        seen.append(pos_e)
        return doppler_rows(observations, pos_e, noise)

    monkeypatch.setattr("certnav.nav.engine.doppler_update.doppler_rows", watched)
    lever = np.array([-15.0, 4.0, -3.0])
    kalman = knowing(heading=0.7)
    kalman.omega_b = np.array([0.0, 0.0, 0.3]) + kalman.C_eb.T @ [0.0, 0.0, 7.292115e-5]
    swing = kalman.C_eb @ np.cross([0.0, 0.0, 0.3], lever)
    made, _ = updates(kalman, calibration=rigs.calibration(lever))
    update = made.offer(event(vel_e=swing), False, True)
    assert update.accepted and update.nis < 1e-2
    np.testing.assert_allclose(seen, [rigs.PLACE + kalman.C_eb @ lever], atol=1e-2)


def test_eight_satellites_are_a_velocity():
    kalman = knowing()
    made, log = updates(kalman)
    update = made.offer(event(vel_e=0.1 * EAST), False, True)
    assert told(update) == ("velocity", True, "") and update.satellites == rigs.NAMES
    assert len(update.whitened) == 8 and log == []
    # Information adds: 1/σ² of the prior, and that of the rows, the clock being a state.
    rows = doppler_rows(rigs.sky(), rigs.PLACE)
    H = np.column_stack([rows.e_e, -np.ones(8)]) / rows.sigma[:, None]
    prior = np.diag([0.05**-2] * 3 + [0.1**-2])
    cov = np.linalg.inv(prior + H.T @ H)
    np.testing.assert_allclose(kalman.P[VEL, VEL], cov[:3, :3], atol=1e-8)
    pulled = cov @ H.T @ (rows.e_e @ (0.1 * EAST) / rows.sigma)
    np.testing.assert_allclose(kalman.vel_e, pulled[:3], atol=1e-5)


def test_rows_that_are_noisier_than_they_say_weigh_less():
    """NIS per row is 1 when R is right; where it is f, R counts f-fold."""
    bias = dict(zip(rigs.NAMES, [0.14, -0.14, 0.14, 0.14, -0.14, -0.14, 0.14, -0.14], strict=True))
    kalman, exact = knowing(), knowing()
    m = rows_measurement(exact, CALIBRATION, doppler_rows(rigs.sky(bias=bias), rigs.PLACE))
    factor = exact.test(m, 0.0).nis / 8.0
    assert factor > 1.5
    update = updates(kalman)[0].offer(event(bias=bias), False, True)
    assert len(update.satellites) == 8 and update.accepted
    information = np.linalg.inv(exact.P) + m.H.T @ m.H / factor
    np.testing.assert_allclose(kalman.P, np.linalg.inv(information), rtol=1e-4, atol=1e-9)
    # What is better than it says is taken at its word, not for more.
    quiet, sound = knowing(), knowing()
    updates(quiet)[0].offer(event(), False, True)
    sound.update(rows_measurement(sound, CALIBRATION, doppler_rows(rigs.sky(), rigs.PLACE)))
    np.testing.assert_allclose(quiet.P, sound.P, rtol=1e-9)


def test_who_is_left_out_is_told_once():
    kalman = knowing()
    made, log = updates(kalman, doppler_hold_off_s=1.5)
    bias = {"G02": 3.0}
    update = made.offer(event(bias=bias), False, True)
    assert update.satellites == tuple(n for n in rigs.NAMES if n != "G02")
    (left_out,) = log
    assert left_out.satellites == ("G02",) and left_out.kind == "doppler"
    assert left_out.reason == "disagrees with the filter: not believed for 1.5 s"
    assert (left_out.time, left_out.accepted) == (0.0, False)
    made.offer(event(time=1.0, bias=bias), False, True)  # on hold, and still wrong
    assert len(log) == 1
    made.offer(event(time=2.0), False, True)  # found in order, but its time is not over
    update = made.offer(event(time=2.6), False, True)
    assert "G02" in update.satellites and len(log) == 1


def test_four_count_as_a_velocity_only_the_second_time():
    kalman = knowing()
    made, _ = updates(kalman)
    four, three, five = rigs.NAMES[:4], rigs.NAMES[:3], rigs.NAMES[:5]
    kinds = [
        made.offer(event(names, time=float(k)), False, False).kind
        for k, names in enumerate([four, four, three, four, five, four, three])
    ]
    assert kinds == [
        "doppler", "velocity", "doppler", "doppler", "velocity", "velocity", "doppler",
    ]  # fmt: skip


def test_where_nothing_is_wanted_below_four_it_says_how_many_there_were():
    made, _ = updates(knowing(), below_four="off")
    said = [
        told(made.offer(event(rigs.NAMES[:n], time=float(k)), False, False))
        for k, n in enumerate([3, 4, 4, 2, 1])
    ]
    assert said == [
        ("velocity", False, "fewer than four satellites agree with the filter"),
        ("velocity", False, "four satellites, fewer the epoch before"),
        ("velocity", True, ""),
        ("velocity", False, "fewer than four satellites agree with the filter"),
        ("velocity", False, FEW),
    ]
    refused = made.offer(event(rigs.NAMES[:3], time=9.0), False, False)
    assert refused.satellites == rigs.NAMES[:3] and refused.whitened == ()


def test_two_satellites_are_two_rows_and_one_is_none():
    kalman = knowing()
    made, _ = updates(kalman)
    update = made.offer(event(rigs.NAMES[:2]), False, False)
    assert told(update) == ("doppler", True, "") and len(update.whitened) == 2
    assert told(made.offer(event(rigs.NAMES[:1], time=1.0), False, False)) == (
        "velocity", False, FEW,
    )  # fmt: skip


def test_who_agrees_speaks_for_the_filter_unless_least_squares_has_checked():
    for names, checked, bias, agreed in (
        (rigs.NAMES[:2], False, {}, True),
        (rigs.NAMES[:3], False, {"G02": 40.0, "G03": -60.0}, True),
        (rigs.NAMES[:2], False, {"G01": 40.0, "G02": -60.0}, False),
        (rigs.NAMES, True, {}, False),
    ):
        made, _ = updates(knowing())
        made.offer(event(names, bias=bias), False, checked)
        assert made.agreed is agreed
    assert updates(knowing())[0].agreed is False


# Doubts of the filter.


def test_doubted_for_good_reason_it_is_the_velocity_that_is_enlarged():
    """Position is not in sight of Doppler, and keeps its σ."""
    kalman = knowing()
    made, log = updates(kalman)
    update = made.offer(event(vel_e=5.0 * EAST), True, True)
    assert told(update) == ("velocity", True, "") and update.satellites == rigs.NAMES
    np.testing.assert_allclose(kalman.vel_e, 5.0 * EAST, atol=0.1)
    assert kalman.P[0, 0] == pytest.approx(1.0) and log == []


def test_doubted_again_within_a_minute_everything_is():
    for second, grown in ((59.0, True), (61.0, False)):
        kalman = knowing()
        made, _ = updates(kalman)
        made.offer(event(vel_e=5.0 * EAST), True, True)
        made.offer(event(time=second, vel_e=-5.0 * EAST), True, True)
        assert (kalman.P[0, 0] > 5.0) == grown


def test_without_a_check_everything_is_at_once():
    kalman = knowing()
    updates(kalman)[0].offer(event(rigs.NAMES[:5], vel_e=1.5 * EAST), True, False)
    assert kalman.P[0, 0] > 5.0


def test_doubting_uses_what_least_squares_has_used():
    """One that it had refused says nothing about the filter."""
    known = tuple(n for n in rigs.NAMES if n != "G02")
    kalman = knowing()
    update = updates(kalman)[0].offer(event(known=known, bias={"G02": 500.0}), True, True)
    assert update.satellites == known
    assert kalman.P[VEL, VEL][0, 0] < 0.05**2  # it fitted without: nothing was enlarged


def test_doubting_believes_every_satellite_again():
    kalman = knowing()
    made, log = updates(kalman)
    made.offer(event(bias={"G02": 3.0}), False, True)
    assert len(log) == 1
    assert "G02" not in made.offer(event(time=0.5), False, True).satellites
    assert "G02" in made.offer(event(time=0.6), True, True).satellites


# The car goes where it points.


def test_straight_ahead_is_a_measurement_of_its_own():
    """σ 0.1 m/s across; it is told after rows of three, never with a velocity."""
    kalman = knowing(velocity=1.0, attitude=1e-6)
    kalman.vel_e += 0.5 * EAST
    made, log = updates(kalman, forward=True)
    two = rigs.sky(rigs.NAMES[:2])
    rows = doppler_rows(two, rigs.PLACE)
    H = np.column_stack([rows.e_e, -np.ones(2)]) / rows.sigma[:, None]
    across = np.zeros((2, 4))
    across[:, :3] = rigs.C_EN[:, 1:].T / 0.1
    information = np.diag([1.0, 1.0, 1.0, 100.0]) + H.T @ H
    update = made.offer(event(rigs.NAMES[:2]), False, False)
    assert told(update) == ("doppler", True, "")
    (nhc,) = log
    assert (nhc.kind, nhc.satellites, nhc.accepted) == ("nhc", (), True)
    assert len(nhc.whitened) == 2
    expected = np.linalg.inv(information + across.T @ across)[:3, :3]
    np.testing.assert_allclose(kalman.P[VEL, VEL], expected, rtol=1e-3, atol=1e-6)


def test_straight_ahead_needs_rows_that_were_believed_and_too_few():
    for forward, names, bias, there in (
        (True, rigs.NAMES[:3], {}, True),
        (False, rigs.NAMES[:3], {}, False),
        (True, rigs.NAMES, {}, False),
        (True, rigs.NAMES[:1], {}, False),
    ):
        made, log = updates(knowing(), forward=forward)
        made.offer(event(names, bias=bias), False, False)
        assert bool(log) == there


# DDIA-VE.


def ddia(names=rigs.NAMES[:3], heading=0.0, kalman=None, **options):
    kalman = kalman or knowing(velocity=1.0, heading=heading)
    sky = {k: options.pop(k) for k in ("cn0", "vel_e", "bias") if k in options}
    made, log = updates(kalman, forward=True, below_four="ddia", **options)
    return kalman, made.offer(event(names, **sky), False, False), log


def test_ddia_is_a_velocity_along_the_nose():
    kalman, update, log = ddia(vel_e=1.5 * NORTH)
    assert told(update) == ("doppler", True, "") and update.satellites == rigs.NAMES[:3]
    assert len(update.whitened) == 3 and log == []  # the assumption is in it
    np.testing.assert_allclose(kalman.vel_e, 1.5 * NORTH, atol=0.1)
    assert np.sqrt(EAST @ kalman.P[VEL, VEL] @ EAST) < 0.11


def test_ddia_takes_the_threshold_itself_and_nothing_weaker():
    for weakest, names in ((40.0, rigs.NAMES[:3]), (39.0, rigs.NAMES[:2])):
        _, update, _ = ddia(cn0={"G03": weakest}, ddia_min_cn0_dbhz=40.0)
        assert update.accepted and update.satellites == names


def test_ddia_says_why_it_has_none():
    _, update, _ = ddia(cn0=39.0, ddia_min_cn0_dbhz=40.0)
    assert told(update) == (
        "doppler", False, "fewer than two satellites above the C/N0 of DDIA-VE",
    )  # fmt: skip
    assert update.satellites == rigs.NAMES[:3] and update.whitened == ()
    _, update, _ = ddia(ddia_min_k=10.0)
    assert told(update) == ("doppler", False, "singular geometry")
    # Two that agree with a filter of 1 m/s, and a car that drives across where it points.
    kalman = knowing(velocity=0.3, heading=np.pi / 2)
    kalman.vel_e += 4.0 * NORTH
    _, update, _ = ddia(rigs.NAMES[:2], kalman=kalman, vel_e=4.0 * NORTH)
    assert not update.accepted and update.reason.startswith("innovation test (NIS > ")
    assert update.nis > 21.1


def test_ddia_is_scaled_and_floored_like_any_velocity():
    sigma = {}
    for name, options in {
        "plain": {}, "scaled": {"velocity_sigma_scale": 3.0},
        "floored": {"velocity_sigma_floor_mps": 0.5},
    }.items():  # fmt: skip
        kalman, *_ = ddia(kalman=knowing(velocity=30.0, attitude=1e-9), **options)
        sigma[name] = np.sqrt(EAST @ kalman.P[VEL, VEL] @ EAST)
    # Across the nose: 0.1 m/s and the floor of 0.02 m/s.
    assert sigma["plain"] == pytest.approx(np.hypot(0.1, 0.02), rel=0.02)
    assert sigma["scaled"] == pytest.approx(np.hypot(0.3, 0.02), rel=0.02)
    assert sigma["floored"] == pytest.approx(np.hypot(0.1, 0.5), rel=0.02)


def test_ddia_turns_with_the_attitude_it_was_made_with():
    """An attitude error turns the velocity: it is no news about the velocity across."""
    kalman = knowing(velocity=30.0, attitude=0.05)
    kalman.vel_e += 20.0 * NORTH
    ddia(kalman=kalman, vel_e=20.0 * NORTH)
    across = np.sqrt(EAST @ kalman.P[VEL, VEL] @ EAST)
    assert across == pytest.approx(np.hypot(np.hypot(0.1, 0.02), 20.0 * 0.05), rel=0.05)
