"""A record prints what it is in a line or a few, not its numbers; lists do where arrays do."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.observations import GnssFixes, GnssObservations
from certnav.datasets.sequence import Calibration, Sequence
from certnav.datasets.series import ImuData, Odometer, Reference
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters import measurements
from certnav.filters.errors import DataError
from certnav.filters.measurements import Measurement
from certnav.filters.sensors import imu_preset
from certnav.velocity import (
    DopplerRows,
    ForwardMotion,
    calibrate_mounting,
    ddia_velocity,
    doppler_rows,
    doppler_velocity,
    drift_free,
    fit_doppler_noise,
    forward_motion,
    line_of_sight,
)
from certnav.velocity.study import all_pairs, epoch_speeds, velocity_errors
from oracles import rigs


@pytest.fixture(scope="module")
def sequence():
    return simulate(
        SimulationConfig(name="drive", seed=1, duration=60.0, density="open")
    ).sequence()


@pytest.fixture(scope="module")
def epoch(sequence):
    """Doppler rows of one epoch, and the antenna's place then."""
    (time, rows), *_ = sequence.observations.epochs()
    pos_e = sequence.reference.pos_e[0]
    return time, doppler_rows(sequence.observations.take(rows), pos_e), pos_e


def fixes(n=11):
    return GnssFixes(
        np.arange(n) / 2.0, np.tile([6378137.0, 0.0, 0.0], (n, 1)), np.tile(np.eye(3), (n, 1, 1)),
        np.vstack([np.zeros((n - 1, 3)), np.full((1, 3), np.nan)]),
        np.tile(np.eye(3), (n, 1, 1)), np.full(n, 9), ["fixed"] * (n - 4) + ["single"] * 4,
    )  # fmt: skip


# --- what is printed -------------------------------------------------------------------------


def test_series_say_how_much_how_often_and_how_long():
    time = np.arange(60000) / 100.0
    imu = ImuData(time, np.zeros((60000, 3)), np.zeros((60000, 3)))
    assert repr(imu) == "ImuData(60000 samples, 100 Hz, 600.0 s)"
    assert repr(Odometer(time[:201], time[:201])) == "Odometer(201 samples, 100 Hz, 2.0 s)"
    turning = Odometer(time[:201], time[:201], time[:201])
    assert repr(turning) == "Odometer(201 samples, 100 Hz, 2.0 s, with yaw rate)"
    zero = np.zeros((3, 3))
    reference = Reference([0, 1, 2], zero, zero, zero * np.nan, [0, 0, 0], "antenna", "RTK")
    assert repr(reference) == (
        "Reference(3 epochs, 1 Hz, 2.0 s, position of the antenna, no attitude: RTK)"
    )
    assert repr(fixes()) == (
        "GnssFixes(11 epochs, 2 Hz, 5.0 s, 10 with velocity; fixed 7, single 4)"
    )
    assert repr(fixes().take([0])) == "GnssFixes(1 epochs, at 0.000 s, 1 with velocity; fixed 1)"


def test_observations_say_what_they_are_of(sequence):
    marked = sequence.observations.mark(np.arange(len(sequence.observations)) < 5, "test")
    words = repr(marked)
    assert words.startswith(f"GnssObservations({len(marked)} rows, {len(marked) - 5} usable, ")
    assert "1 Hz, 60.0 s, systems G, signals 1C" in words
    assert repr(marked.take(slice(0, 0))).startswith("GnssObservations(0 rows, 0 usable, 0 epochs")


def test_a_sequence_says_it_a_line_a_part(sequence):
    lines = repr(sequence).splitlines()
    assert lines[0] == "Sequence('drive', gps time"
    for part in (sequence.imu, sequence.observations, sequence.reference, sequence.calibration):
        assert any(line.strip().rstrip(")") == repr(part).rstrip(")") for line in lines)
    assert len(lines) == 5 and all(len(line) < 120 for line in lines)


def test_velocities_say_how_fast_how_sure_and_from_what(epoch):
    time, rows, _ = epoch
    least = doppler_velocity(rows, time)
    motion = forward_motion(np.eye(3), np.zeros(3), np.zeros(3))
    aided = ddia_velocity(rows, motion, time)
    few = rows.take(slice(0, 1))
    assert f"{len(least.satellites)} satellites" in repr(least) and "m/s ±" in repr(least)
    assert f"k = {aided.k:.2f}" in repr(aided) and f"{aided.speed:.2f} ±" in repr(aided)
    assert repr(doppler_velocity(few, 5.0)) == "DopplerVelocity(t = 5.000 s, too few satellites)"
    assert repr(ddia_velocity(few, motion, 5.0)) == "AidedVelocity(t = 5.000 s, too few satellites)"


def test_nothing_prints_its_arrays(sequence, epoch):
    time, rows, pos_e = epoch
    motion = forward_motion(np.eye(3), np.zeros(3), np.zeros(3))
    many = ForwardMotion(motion.u_e[None], motion.swing_e[None], motion.att_cov_e)
    number = np.zeros(len(rows), dtype=int)
    cn0 = np.full(len(rows), 45.0)
    pairs = all_pairs(rows, number, many, cn0, np.ones(len(rows)))
    rng = np.random.default_rng(0)
    records = [
        sequence.imu, sequence.observations, sequence.reference, sequence.calibration, fixes(),
        rows, rows.take(slice(0, 0)), motion, many, doppler_velocity(rows, time),
        ddia_velocity(rows, motion, time), drift_free(rows), pairs,
        line_of_sight(pos_e, sequence.observations.sat_pos_e, sequence.observations.sat_vel_e),
        fit_doppler_noise(rng.uniform(30, 50, 200), rng.standard_normal(200)),
        epoch_speeds(np.ones(3), np.ones(3), np.ones(3), np.zeros(3, int), 1),
        Measurement(np.zeros(3), np.zeros((3, 15)), np.eye(3)),
    ]  # fmt: skip
    for record in records:
        words = repr(record)
        assert words.startswith(type(record).__name__ + "(")
        assert "array" not in words and "\n" not in words and len(words) < 160


# --- what is taken ---------------------------------------------------------------------------


def test_records_take_lists():
    imu = ImuData([0.0, 0.5, 1.0], [[0, 0, 1]] * 3, [[0, 0, -9.8]] * 3)
    np.testing.assert_array_equal(imu.gyro_b, np.tile([0.0, 0.0, 1.0], (3, 1)))
    one = [0.0]
    observations = GnssObservations(
        one, ["G01"], ["1C"], [0.19], one, one, one, one, [0], [[2e7, 0, 0]], [[0, 3e3, 0]],
        one, one, one, one, [""],
    )  # fmt: skip
    assert observations.usable.tolist() == [True]
    assert observations.mark([True], "test").rejected.tolist() == ["test"]
    assert len(observations.take([0])) == 1
    place = Calibration(imu_preset("consumer"), [0.1, 0, -1], "test", C_bv=np.eye(3).tolist())
    carried = GnssFixes(
        [0.0], [[6.4e6, 0, 0]], [np.eye(3).tolist()], [[0, 0, 0]], [np.eye(3).tolist()], [7], ["x"]
    )
    assert Sequence("s", imu, place, observations, fixes=carried).span == (0.0, 1.0)
    with pytest.raises(DataError, match=r"fixes\.quality: expected shape \(1,\), found \(2,\)"):
        GnssFixes([0.0], [[6.4e6, 0, 0]], [np.eye(3)], [[0, 0, 0]], [np.eye(3)], [7], ["x", "y"])


def test_velocities_take_lists(epoch):
    """To the last digit what arrays give."""
    time, rows, _ = epoch
    listed = DopplerRows(*(getattr(rows, name).tolist() for name in rows.__dataclass_fields__))
    np.testing.assert_array_equal(
        doppler_velocity(listed, time).vel_e, doppler_velocity(rows, time).vel_e
    )
    motion = forward_motion(np.eye(3).tolist(), [0.0, 0.0, 0.1], [0.5, 0.0, -1.0])
    plain = ForwardMotion(motion.u_e.tolist(), motion.swing_e.tolist(), np.zeros((3, 3)).tolist())
    assert ddia_velocity(listed, plain, time).speed == ddia_velocity(rows, motion, time).speed
    many = ForwardMotion([motion.u_e], [motion.swing_e], motion.att_cov_e)
    n = len(rows)
    pairs = all_pairs(listed, [0] * n, many, [45.0] * n, [1.0] * n)
    assert len(pairs) == n * (n - 1) // 2
    errors = velocity_errors(pairs.speed.tolist(), pairs.epoch.tolist(), many, [[1.0, 0.0, 0.0]])
    assert errors.shape == (len(pairs),)
    seconds = np.arange(60.0)
    found = calibrate_mounting(
        seconds.tolist(), [[10.0, 0.0, 0.0]] * 60, [np.eye(3).tolist()] * 60, [[0.0, 0.0, 0.0]] * 60
    )
    assert found.yaw == found.pitch == 0.0


def test_measurements_take_lists(sequence):
    from certnav.filters.strapdown import NavState

    state = NavState(0.0, [6378137.0, 0.0, 0.0], [1.0, 2.0, 3.0], np.eye(3).tolist())
    lever, rate, cov = [0.5, 0.0, -1.0], [0.0, 0.0, 0.1], np.eye(3)
    e_e = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    for make in (
        lambda of: measurements.position(state, 15, of(state.pos_e), of(cov), of(lever)),
        lambda of: measurements.velocity(
            state, 15, of([1.0, 2.0, 3.0]), of(cov), of(lever), of(rate)
        ),
        lambda of: rigs.range_rates(
            state, 15, of(e_e), of([1.0, 2.0, 3.0]), of([0.1, 0.2, 0.3]), of(lever), of(rate)
        ),
        lambda of: measurements.with_shared_error(
            measurements.position(state, 18, of(state.pos_e), of(cov), of(lever)),
            of(cov), slice(15, 18), of([0.1, 0.2, 0.3]),
        ),
        lambda of: Measurement(of([1.0]), of([[1.0, 2.0]]), of([[3.0]])),
    ):  # fmt: skip
        arrays, lists = make(np.asarray), make(lambda value: np.asarray(value).tolist())
        for name in ("z", "H", "R"):
            assert isinstance(getattr(lists, name), np.ndarray)
            np.testing.assert_array_equal(getattr(lists, name), getattr(arrays, name))
