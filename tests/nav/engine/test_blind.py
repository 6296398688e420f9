"""Spells without inertial data: found where they are, and paid for in covariance."""

import dataclasses

import numpy as np
import pytest

from certnav.datasets.sequence import Sequence
from certnav.datasets.series import ImuData
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.error_model import ATT, POS, VEL
from certnav.filters.strapdown import InertialStream
from certnav.nav.config import Config
from certnav.nav.config_files import from_tables
from certnav.nav.engine.blind import Spell, blind_axes, blind_spells, gap, is_gap, propagate
from certnav.nav.engine.events import GnssEvent, missing
from certnav.nav.engine.gnss import gnss_timeline
from certnav.nav.engine.model import error_model
from certnav.nav.engine.start.finder import find_start
from certnav.nav.engine.start.state import start_filter
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate
from oracles import rigs


@pytest.fixture(scope="module")
def drive():
    config = SimulationConfig(seed=0, duration=160.0, density="open")
    simulation = simulate(config)
    fixes = fixes_from_truth(
        simulation.trajectory, config.start_time + np.arange(1.0, 159.0),
        config.lever_antenna_b, 1.0, 0.05, np.random.default_rng(0),
    )  # fmt: skip
    return dataclasses.replace(simulation.sequence(fixes), observations=None)


def turn(sequence: Sequence) -> int:
    """Return the first IMU sample of the ten seconds that turn most."""
    rate = np.cumsum(sequence.imu.gyro_b[:, 2]) * sequence.imu.interval
    return int(np.argmax(np.abs(rate[1000:] - rate[:-1000])))


def without(sequence: Sequence, k: int, samples: int) -> Sequence:
    keep = np.ones(len(sequence.imu), dtype=bool)
    keep[k : k + samples] = False
    imu = sequence.imu
    return dataclasses.replace(
        sequence, imu=ImuData(imu.time[keep], imu.gyro_b[keep], imu.accel_b[keep])
    )


def frozen(sequence: Sequence, k: int, samples: int, gyro: bool, accel: bool) -> Sequence:
    imu, rows = sequence.imu, slice(k, k + samples)
    gyro_b, accel_b = imu.gyro_b.copy(), imu.accel_b.copy()
    if gyro:
        gyro_b[rows] = gyro_b[k]
    if accel:
        accel_b[rows] = accel_b[k]
    return dataclasses.replace(sequence, imu=ImuData(imu.time, gyro_b, accel_b))


def spells(sequence):
    blind = blind_axes(sequence.imu, gnss_timeline(sequence, Config().gnss).events)
    return blind_spells(sequence.imu, blind)


def times(sequence):
    return [(spell.begin, spell.end) for spell in spells(sequence)]


def test_a_sound_drive_has_none(drive):
    assert spells(drive) == []


def test_gap_and_frozen_sensors_are_found_where_they_are(drive):
    k, time = turn(drive), drive.imu.time
    assert times(without(drive, k, 300)) == [(time[k - 1], time[k + 300])]
    assert times(frozen(drive, k, 300, True, False)) == [(time[k], time[k + 299])]
    both = frozen(without(drive, k + 250, 300), k, 250, True, True)
    assert times(both) == [(time[k], time[k + 550])]  # touching spells are one


def test_values_that_repeat_at_rest_are_not_frozen(drive):
    """Exact data of a vehicle that stands repeat; only GNSS can tell."""
    at_rest = frozen(drive, 100, 2000, True, True)
    assert (np.diff(at_rest.imu.gyro_b[100:2100], axis=0) == 0.0).all()
    assert spells(at_rest) == []


def test_a_missing_sample_is_no_gap():
    assert not is_gap(0.02, 0.01) and not is_gap(0.05, 0.01)
    assert is_gap(0.06, 0.01)
    assert not is_gap(0.25, 0.1)  # three intervals of a slow sensor


def noise(samples, rate=100.0):
    rng = np.random.default_rng(3)
    gyro_b, accel_b = rng.normal(size=(2, samples, 3))
    return ImuData(np.arange(1, samples + 1) / rate, gyro_b, accel_b)


def speed(time, metres_per_second=10.0, kind="velocity"):
    return GnssEvent(time, kind, np.array([metres_per_second, 0.0, 0.0]), np.eye(3))


def spans_of(imu, events):
    return [(spell.begin, spell.end) for spell in blind_spells(imu, blind_axes(imu, events))]


def repeating(first, last, imu):
    """The rows first … last are equal."""
    gyro_b = imu.gyro_b.copy()
    gyro_b[first : last + 1] = gyro_b[first]
    return ImuData(imu.time, gyro_b, imu.accel_b)


def test_a_sensor_is_frozen_after_a_fifth_of_a_second_and_six_equal_rows():
    moving = [speed(2.0)]
    for last, found in ((219, False), (221, True)):
        spans = spans_of(repeating(200, last, noise(400)), moving)
        assert spans == ([(2.01, (last + 1) / 100.0)] if found else [])
    for last, found in ((24, False), (25, True)):  # at 10 Hz
        spans = spans_of(repeating(20, last, noise(40, 10.0)), moving)
        assert spans == ([(2.1, (last + 1) / 10.0)] if found else [])


@pytest.mark.parametrize(("events", "found"), [
    ([speed(1.02)], True), ([speed(3.99)], True), ([speed(5.5)], True),
    ([speed(2.5, 0.49)], False), ([speed(2.5, 0.51)], True), ([speed(2.5, kind="position")], False),
    ([missing(2.5, "velocity", "too few")], False),
    ([speed(1.5), speed(9.0, 0.0)], True), ([speed(0.2, 0.0), speed(9.0)], False),
    ([speed(1.0, 0.0), speed(2.1), speed(4.0, 0.0)], True),
])  # fmt: skip
def test_frozen_is_what_repeats_while_gnss_sees_motion(events, found):
    """By a velocity that can be used: one within a second, or else the nearest."""
    imu = repeating(200, 300, noise(600))  # 2.01 … 3.01 s
    assert bool(spans_of(imu, events)) == found


def test_one_axis_that_repeats_is_blind_for_itself():
    imu = noise(600)
    gyro_b = imu.gyro_b.copy()
    gyro_b[200:300, 0] = 1.0
    broken = ImuData(imu.time, gyro_b, imu.accel_b)
    (spell,) = blind_spells(broken, blind_axes(broken, [speed(2.5)]))
    assert spell == (2.01, 3.0, ((2.01, 3.0), *(None,) * 5))


def test_spells_do_not_overlap():
    imu = repeating(200, 300, noise(900))
    accel_b = imu.accel_b.copy()
    accel_b[230:260] = accel_b[230]  # within the other
    accel_b[500:600] = accel_b[500]
    spans = spans_of(ImuData(imu.time, imu.gyro_b, accel_b), [speed(2.5), speed(5.5)])
    assert spans == [(2.01, 2.31), (2.31, 2.6), (2.6, 3.01), (5.01, 6.0)]


def grown(begin, end, until, sigma=1e-6):
    """Return σ of velocity, tilt and heading after `until` with one spell on the way."""
    kalman = rigs.filter_at_rest(12.0, sigma=(1.0, 1e-6, sigma))
    propagate(kalman, until, [gap(begin, end)])
    assert kalman.time == pytest.approx(until)
    C_nb = rigs.C_EN.T @ kalman.C_eb
    att = np.sqrt(np.diag(C_nb @ kalman.P[ATT, ATT] @ C_nb.T))
    return np.sqrt(rigs.C_EN[:, 2] @ kalman.P[VEL, VEL] @ rigs.C_EN[:, 2]), att[0], att[2]


@pytest.mark.parametrize(("begin", "end", "until", "size"), [
    (2.0, 4.0, 5.0, 2.0),
    (2.0, 4.0, 3.0, 1.0),  # half of it so far
    (2.0, 2.5, 5.0, 0.25),  # short ones count less: half of half a second
    (0.0, 1.0, 5.0, 1.0),
    (2.0, 3.3, 5.0, 1.3),  # in steps, the last of them shorter
    (6.0, 7.0, 5.0, 0.0),
])  # fmt: skip
def test_what_a_car_may_do_unseen(begin, end, until, size):
    """σ of a rate that lasts: 2 m/s², 0.05 and 0.3 rad/s, times the length."""
    vertical, tilt, heading = grown(begin, end, until)
    assert vertical == pytest.approx(2.0 * size, rel=0.02, abs=0.01)
    assert tilt == pytest.approx(0.05 * size, rel=0.02, abs=1e-3)
    assert heading == pytest.approx(min(0.3 * size, 1.0), rel=0.02, abs=1e-3)


def test_no_heading_is_less_known_than_a_radian():
    assert grown(1.0, 9.0, 10.0)[2] == pytest.approx(1.0, rel=0.01)
    assert grown(1.0, 9.0, 10.0, sigma=2.0)[2] == pytest.approx(2.0, rel=0.01)


def test_spells_that_are_over_before_it_begins_change_nothing():
    kalman, other = (rigs.filter_at_rest(6.0) for _ in range(2))
    for each in (kalman, other):
        each.propagate(3.0)
    propagate(kalman, 5.0, [gap(0.0, 1.0), gap(1.5, 3.0), gap(5.0, 6.0)])
    other.propagate(5.0)
    np.testing.assert_allclose(kalman.P, other.P, rtol=1e-9)
    propagate(kalman, 5.5, [gap(4.0, 5.0), gap(5.2, 5.4), gap(5.4, 5.5)])
    assert kalman.P[VEL, VEL][0, 0] > other.P[VEL, VEL][0, 0] + 1e-4
    assert kalman.P[POS, POS][0, 0] < 2.0


@pytest.mark.parametrize("fault", ["gap", "gyro", "accelerometer"])
def test_the_solution_stays_within_its_sigma(drive, fault):
    """Five blind seconds in a turn: without the widening the errors are tens of 3σ."""
    k = turn(drive)
    broken = {
        "gap": lambda: without(drive, k, 500),
        "gyro": lambda: frozen(drive, k, 500, True, False),
        "accelerometer": lambda: frozen(drive, k, 500, False, True),
    }[fault]()
    solution = navigate(broken, Config())
    assert any("covariance is widened" in note.text for note in solution.notes)
    result, sound = evaluate(solution, broken), evaluate(navigate(drive, Config()), drive)
    ratio = np.abs(result.error_pos_n[:, :2]) / (3.0 * result.sigma_pos_n[:, :2])
    assert ratio.max() < 1.5
    assert result.metrics["horizontal_max_m"] < sound.metrics["horizontal_max_m"] + 3.0


def clipped(sequence: Sequence, axes: tuple[int, ...], limit: float) -> Sequence:
    imu, accel_b = sequence.imu, sequence.imu.accel_b.copy()
    accel_b[:, axes] = np.clip(accel_b[:, axes], -limit, limit)
    return dataclasses.replace(sequence, imu=ImuData(imu.time, imu.gyro_b, accel_b))


@pytest.mark.parametrize("axes", [(0,), (1,), (0, 1)])
def test_axes_that_are_clipped_alone_are_not_believed(drive, axes):
    """The third axis moves on. Believed, two clipped axes lead the solution off by tens of 3σ."""
    broken = clipped(drive, axes, 1.0)
    solution = navigate(broken, Config())
    told = [n.text for n in solution.notes if n.doubtful and "clipped at" in n.text]
    assert len(told) == len(axes)
    assert all(f"accelerometer {'xyz'[a]}" in t for a, t in zip(axes, told, strict=True))
    result, sound = evaluate(solution, broken), evaluate(navigate(drive, Config()), drive)
    ratio = np.abs(result.error_pos_n[:, :2]) / (3.0 * result.sigma_pos_n[:, :2])
    assert ratio.max() < 1.5
    assert result.metrics["horizontal_max_m"] < sound.metrics["horizontal_max_m"] + 1.0


def test_overlapping_blindness_keeps_its_own_beginning(drive):
    """Gyro z blind from k on, the accelerometers a second later: three spells, one after another.

    The second covers both, and each counts from where its own sensor stopped.
    """
    k, time = turn(drive), drive.imu.time
    gyro_b, accel_b = drive.imu.gyro_b.copy(), drive.imu.accel_b.copy()
    gyro_b[k : k + 300, 2] = gyro_b[k, 2]
    accel_b[k + 100 : k + 400] = accel_b[k + 100]
    broken = dataclasses.replace(drive, imu=ImuData(time, gyro_b, accel_b))
    first, both, last = spells(broken)
    z, accel = (time[k], time[k + 299]), (time[k + 100], time[k + 399])
    assert first == (z[0], accel[0], (None, None, z, None, None, None))
    assert both == (accel[0], z[1], (None, None, z, accel, accel, accel))
    assert last == (z[1], accel[1], (None, None, None, accel, accel, accel))


def widened(drive, blind):
    """Return what a blind second adds to attitude and velocity, in body axes."""
    config = from_tables({"vehicle": {"nhc": "off", "zupt": False, "zaru": False}})
    stream = InertialStream(drive.imu.time, drive.imu.gyro_b, drive.imu.accel_b)
    model = error_model(drive.calibration, config)
    events = gnss_timeline(drive, config.gnss).events
    start = find_start(events, stream, drive.calibration, config.alignment, model)
    pairs = []
    for axes in (((None,) * 6), blind):
        kalman = start_filter(start, stream, drive.calibration, model, config.filter)
        begin = kalman.time
        spans = tuple((begin, begin + 1.0) if axis else None for axis in axes)
        propagate(kalman, begin + 1.0, [Spell(begin, begin + 1.0, spans)])
        C = kalman.C_eb
        pairs.append((kalman.P[ATT, ATT], C.T @ kalman.P[VEL, VEL] @ C))
    return [np.diag(after - before) for before, after in zip(*pairs, strict=True)]


@pytest.mark.parametrize("axis", range(3))
def test_a_blind_gyro_axis_costs_attitude_about_it(drive, axis):
    attitude, _ = widened(drive, tuple(k == axis for k in range(6)))
    rate = 0.3 if axis == 2 else 0.05
    assert attitude[axis] == pytest.approx(rate**2, rel=0.1)
    assert np.delete(attitude, axis).max() < 0.05 * attitude[axis]


@pytest.mark.parametrize("axis", range(3))
def test_a_blind_accelerometer_axis_costs_velocity_along_it(drive, axis):
    attitude, velocity = widened(drive, tuple(k == 3 + axis for k in range(6)))
    assert velocity[axis] == pytest.approx(4.0, rel=0.1)
    assert np.delete(velocity, axis).max() < 0.05 * velocity[axis]
    assert np.abs(attitude).max() < 1e-6


def test_the_covariance_grows_as_a_rate_error_makes_it(drive):
    """Attitude σ over a gap without updates: TURN times its length, added to what it was."""
    k = turn(drive)
    broken = without(drive, k, 300)
    end = drive.imu.time[k + 300]
    fixes = broken.fixes.take(
        (broken.fixes.time < drive.imu.time[k] - 1.0) | (broken.fixes.time > end + 1)
    )
    alone = from_tables({"vehicle": {"nhc": "off", "zupt": False, "zaru": False}})
    trajectory = navigate(dataclasses.replace(broken, fixes=fixes), alone).trajectory
    at = np.searchsorted(trajectory.time, end + 1e-3)
    down = np.sqrt(trajectory.cov_att_n[at - 1, 2, 2])
    before = np.sqrt(
        trajectory.cov_att_n[np.searchsorted(trajectory.time, drive.imu.time[k]) - 2, 2, 2]
    )
    assert before < 0.05
    assert down == pytest.approx(np.hypot(0.3 * 3.0, before), rel=0.05)
