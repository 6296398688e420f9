"""Velocities and the positions that go with them, carried from the antenna to the IMU."""

from types import SimpleNamespace

import numpy as np
import pytest

from certnav.filters.strapdown import InertialStream
from certnav.nav.engine.events import GnssEvent, missing
from certnav.nav.engine.start.fixes import Fixes, level_speed
from certnav.nav.vehicles import VEHICLES
from oracles import rigs

NORTH, EAST, DOWN = rigs.C_EN.T
STREAM = rigs.stream_at_rest(rigs.C_EN, 20.0)
LEVER = np.array([2.0, 0.0, 0.0])


def position(time, value_e=rigs.PLACE, variance=4.0):
    return GnssEvent(time, "position", value_e, variance * np.eye(3))


def velocity(time, value_e=10.0 * NORTH, variance=0.01):
    return GnssEvent(time, "velocity", np.asarray(value_e), variance * np.eye(3))


def fixes(*events, lever=(0.0, 0.0, 0.0), stream=STREAM):
    made = Fixes(stream, rigs.calibration(lever), VEHICLES["car"])
    for event in events:
        made.add(event)
    return made


def pairs(made):
    return [(v.time, p.time) for v, p in made.pairs]


@pytest.mark.parametrize(("times", "paired"), [
    ([("p", 5.0), ("v", 5.0)], [(5.0, 5.0)]),
    ([("v", 5.0), ("p", 5.0)], [(5.0, 5.0)]),
    ([("p", 5.0), ("v", 7.5)], [(7.5, 5.0)]),
    ([("p", 5.0), ("v", 7.51)], []),
    ([("v", 5.0), ("p", 7.5)], [(5.0, 7.5)]),
    ([("v", 5.0), ("p", 7.51)], []),
    # The last before it; one that was too old makes it wait for the next.
    ([("p", 4.0), ("p", 5.0), ("v", 6.0)], [(6.0, 5.0)]),
    ([("p", 4.0), ("v", 8.0), ("p", 9.0)], [(8.0, 9.0)]),
    ([("v", 5.0), ("v", 6.0), ("v", 9.0), ("p", 8.0), ("p", 10.0)],
     [(6.0, 8.0), (9.0, 8.0)]),
    ([("v", 5.0), ("p", 6.0), ("p", 7.0)], [(5.0, 6.0)]),
])  # fmt: skip
def test_each_velocity_has_the_position_nearest_before_else_the_next(times, paired):
    make = {"p": position, "v": velocity}
    assert pairs(fixes(*(make[kind](time) for kind, time in times))) == paired


def test_it_says_which_pairs_an_event_completes():
    made = fixes(velocity(5.0), velocity(6.0))
    assert [v.time for v, _ in made.add(position(6.5))] == [5.0, 6.0]
    assert made.add(position(7.0)) == []
    assert [v.time for v, _ in made.add(velocity(8.0))] == [8.0]


def test_only_what_can_be_used_counts():
    made = fixes(
        missing(4.0, "position", "no fix"), missing(4.0, "velocity", "too few"),
        missing(4.0, "doppler", ""), position(5.0), velocity(5.0), velocity(6.0),
    )  # fmt: skip
    assert made.counts == {"position": 1, "velocity": 2}
    assert made.position.time == 5.0 and pairs(made) == [(5.0, 5.0), (6.0, 5.0)]


def test_a_velocity_must_lie_where_a_sample_has_ended():
    for time, inside in ((0.0, False), (0.009, False), (0.01, True), (19.99, True), (20.0, False)):
        made = fixes(position(time), velocity(time))
        assert bool(made.pairs) == inside
        assert made.counts["velocity"] == 1  # it is there all the same


def test_the_track_is_that_of_the_pairs():
    made = fixes(position(5.0, rigs.PLACE), velocity(5.0), velocity(6.0, 3.0 * EAST, 0.04))
    made.add(velocity(19.0))
    track = made.track()
    np.testing.assert_array_equal(track.time, [5.0, 6.0])
    np.testing.assert_allclose(track.vel_e, [10.0 * NORTH, 3.0 * EAST])
    np.testing.assert_allclose(track.sigma, [0.1, 0.2])
    np.testing.assert_array_equal(track.pos_e, [rigs.PLACE] * 2)
    there = made.at(np.array([4.0, 5.0, 5.0 + 5e-7, 5.0 + 2e-6, 6.0, 19.0]))
    assert there.tolist() == [False, True, True, False, True, False]


def attitude(time, C_eb=rigs.C_EN, gyro_bias=(0.0, 0.0, 0.0)):
    return SimpleNamespace(time=time, C_eb=C_eb, gyro_bias=np.asarray(gyro_bias))


def test_the_position_is_carried_to_the_time_of_the_attitude():
    """10 m/s for two seconds are 20 m: the velocity nearest to it, its own position."""
    made = fixes(
        position(4.0), velocity(4.0, 30.0 * EAST), velocity(6.0, 10.0 * NORTH, 0.04),
        position(9.0, rigs.PLACE + 500.0 * EAST), velocity(9.0, 30.0 * EAST), lever=LEVER,
    )  # fmt: skip
    start = made.start(attitude(6.5))
    assert start.state.time == 6.5
    expected = rigs.PLACE + 25.0 * NORTH - 2.0 * NORTH
    np.testing.assert_allclose(start.state.pos_e, expected, atol=1e-6)
    np.testing.assert_allclose(start.state.vel_e, 10.0 * NORTH, atol=1e-9)
    np.testing.assert_array_equal(start.pos_cov_e, 4.0 * np.eye(3))
    np.testing.assert_allclose(start.vel_cov_e, 0.04 * np.eye(3))
    back = made.start(attitude(3.5)).state.pos_e
    np.testing.assert_allclose(back, rigs.PLACE - 15.0 * EAST - 2.0 * NORTH, atol=1e-6)


def test_velocities_that_no_car_has_start_nothing():
    """Four satellites, one of them reflected: 53 m/s downwards, 29 m/s to the south."""
    made = fixes(
        position(5.0), velocity(5.0, 5.0 * NORTH), velocity(6.0, 5.0 * NORTH),
        velocity(7.0, 5.0 * NORTH - 53.0 * -DOWN), velocity(8.0, -29.0 * NORTH),
        velocity(9.0, 7.0 * NORTH), velocity(10.0, 8.0 * NORTH), velocity(11.0, 90.0 * NORTH),
        position(7.4), position(10.0),
    )  # fmt: skip
    assert [v.time for v, _ in made.pairs] == [5.0, 6.0, 9.0, 10.0]


def test_what_is_not_known_to_that_is_borne_out():
    made = fixes(
        position(5.0), velocity(5.0, 5.0 * NORTH), velocity(6.0, 5.0 * NORTH),
        velocity(7.0, -29.0 * NORTH, 100.0), position(7.0),
    )  # fmt: skip
    assert len(made.pairs) == 3


def test_what_the_antenna_has_from_turning_is_taken_off():
    """(0, 0, 0.5) × (2, 0, 0) = (0, 1, 0), the gyros' bias and the Earth's rate taken off."""
    bias = np.array([0.0, 0.0, 0.3])
    rate = np.zeros((len(STREAM), 3))
    rate[500:] = [0.0, 0.0, 0.5]
    stream = InertialStream.of_edges(STREAM.edges, STREAM.gyro + bias + rate, STREAM.accel)
    made = fixes(position(10.0), velocity(10.0), lever=LEVER, stream=stream)
    start = made.start(attitude(10.0, gyro_bias=bias))
    np.testing.assert_allclose(start.state.vel_e, 10.0 * NORTH - EAST, atol=1e-9)
    before = made.lever_velocity(attitude(4.995, gyro_bias=bias))
    np.testing.assert_allclose(before, 0.0, atol=1e-12)
    np.testing.assert_allclose(made.lever_velocity(attitude(5.0, gyro_bias=bias)), EAST)
    last = made.lever_velocity(attitude(20.0, gyro_bias=bias))  # the end of the last sample
    np.testing.assert_allclose(last, EAST, atol=1e-12)


def test_speed_is_level_and_sigma_per_axis():
    climbing = velocity(0.0, 3.0 * NORTH - 4.0 * EAST + 12.0 * DOWN)
    assert level_speed(climbing, position(0.0)) == pytest.approx(5.0, abs=0.1)
    event = GnssEvent(0.0, "velocity", NORTH, np.diag([1.0, 4.0, 7.0]))
    assert event.sigma == pytest.approx(2.0)
