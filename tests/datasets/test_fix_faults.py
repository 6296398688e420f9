"""Rows that are no fixes, and fixes repeated in motion, are marked; a standstill is believed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.fix_faults import COPIED, HELD, screened, stretches
from certnav.datasets.observations import GnssFixes
from certnav.filters.earth import C_en_at, lla_to_ecef

START = 1.3e9
LAT, LON = np.radians([48.0, 11.0])


def fixes(rate: float, duration: float, speed, sigma: float = 0.1, **columns) -> GnssFixes:
    """Fixes of a vehicle that drives north at ``speed(t)`` [m/s], without noise."""
    t = np.arange(0.0, duration, 1.0 / rate)
    fine = np.linspace(0.0, duration, 20_001)
    v = np.array([speed(x) for x in fine])
    way = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(fine))])
    north = C_en_at(LAT, LON)[:, 0]
    pos_e = lla_to_ecef(LAT, LON, 500.0) + np.interp(t, fine, way)[:, None] * north
    vel_e = np.interp(t, fine, v)[:, None] * north
    n = t.size
    made = {
        "time": START + t, "pos_e": pos_e, "pos_cov_e": np.tile(np.eye(3) * sigma**2, (n, 1, 1)),
        "vel_e": vel_e, "vel_cov_e": np.tile(np.eye(3) * 0.05**2, (n, 1, 1)),
        "satellites": np.full(n, 9), "quality": np.full(n, "single"),
    }  # fmt: skip
    return GnssFixes(**(made | columns))


def held(found: GnssFixes, first: float, last: float, velocity: str) -> GnssFixes:
    """The receiver says the fix of `first` again until `last` [s]; velocity too, or zero."""
    t = found.time - START
    i = int(np.searchsorted(t, first))
    rows = (t > first) & (t <= last)
    pos_e, vel_e = found.pos_e.copy(), found.vel_e.copy()
    pos_e[rows] = pos_e[i]
    vel_e[rows] = vel_e[i] if velocity == "held" else 0.0
    return GnssFixes(**{**vars(found), "pos_e": pos_e, "vel_e": vel_e})


@pytest.mark.parametrize("rate", [1.0, 4.0, 5.0, 10.0, 20.0])
@pytest.mark.parametrize("velocity", ["held", "zero"])
@pytest.mark.parametrize("lasting", [3.0, 10.0, 30.0])
def test_a_fix_repeated_in_motion_is_marked_and_nothing_else(rate, velocity, lasting):
    sound = fixes(rate, 90.0, lambda t: 15.0)
    found = screened(held(sound, 20.0, 20.0 + lasting, velocity))
    t = found.time - START
    repeated = (t > 20.0) & (t <= 20.0 + lasting)
    np.testing.assert_array_equal(found.rejected == HELD, repeated)
    ((reason, rows, first, last),) = stretches(found)
    assert reason == HELD and rows == repeated.sum()
    assert (first, last) == (found.time[repeated][0], found.time[repeated][-1])


def test_repeated_to_the_end_of_the_recording_is_told_by_the_speed_before():
    found = screened(held(fixes(5.0, 60.0, lambda t: 12.0), 50.0, 60.0, "zero"))
    assert (found.rejected == HELD).sum() == 49


def test_a_vehicle_that_stands_is_believed_whatever_the_receiver_prints():
    def stops(t):  # brakes at 20 s, stands from 25 s to 45 s, and drives on
        return float(np.interp(t, [0.0, 20.0, 25.0, 45.0, 50.0, 90.0], [12, 12, 0, 0, 12, 12]))

    for rate in (1.0, 5.0, 10.0):
        found = screened(fixes(rate, 90.0, stops))  # exact positions repeat at rest
        assert found.usable.all()


@pytest.mark.parametrize(("printed", "reported"), [(5, 1), (10, 1), (10, 5), (4, 2)])
def test_a_log_printed_faster_than_the_receiver_keeps_the_first_of_each(printed, reported):
    def stops(t):
        return float(np.interp(t, [0.0, 30.0, 35.0, 45.0, 50.0, 90.0], [12, 12, 0, 0, 12, 12]))

    slow = fixes(reported, 90.0, stops)
    times = printed // reported
    fast = {
        name: np.repeat(getattr(slow, name), times, axis=0)
        for name in ("pos_e", "pos_cov_e", "vel_e", "vel_cov_e", "satellites", "quality")
    }
    time = np.repeat(slow.time, times) + np.tile(np.arange(times) / printed, len(slow))
    found = screened(GnssFixes(time=time, **fast))
    moving = np.repeat(np.linalg.norm(slow.vel_e, axis=1) > 0.5, times)
    first = np.tile(np.arange(times) == 0, len(slow))
    np.testing.assert_array_equal(found.usable[moving], first[moving])
    assert set(found.rejected[~found.usable]) == {COPIED}
    assert len(stretches(found)) == 1


def empty(kind: str) -> GnssFixes:
    sound = fixes(5.0, 30.0, lambda t: 10.0)
    first = np.arange(len(sound)) < 12
    columns = {name: np.array(value) for name, value in vars(sound).items()}
    if kind == "0/0":
        columns["pos_e"][first] = lla_to_ecef(0.0, 0.0, 0.0)
    elif kind == "origin":
        columns["pos_e"][first] = 0.0
    elif kind == "satellites":
        columns["satellites"][first] = 0
    elif kind == "accuracy 0":
        columns["pos_cov_e"][first] = 0.0
    elif kind == "accuracy 4000 km":
        columns["pos_cov_e"][first] = np.eye(3) * 4e6**2
    elif kind == "quality":
        columns["quality"] = np.where(first, "none", sound.quality)
    elif kind == "correlation 2":
        columns["pos_cov_e"][first] = [[0.01, 0.02, 0.0], [0.02, 0.01, 0.0], [0.0, 0.0, 0.01]]
    elif kind == "velocity's correlation 2":
        columns["vel_cov_e"][first] = [[0.01, 0.02, 0.0], [0.02, 0.01, 0.0], [0.0, 0.0, 0.01]]
    elif kind == "elsewhere":
        columns["pos_e"][first] = lla_to_ecef(LAT, LON + 1.0, 500.0)
    return GnssFixes(**columns)


@pytest.mark.parametrize(
    "kind",
    [
        *("0/0", "origin", "satellites", "accuracy 0", "accuracy 4000 km", "quality", "elsewhere"),
        *("correlation 2", "velocity's correlation 2"),
    ],
)
def test_rows_without_a_fix_are_marked_wherever_they_stand(kind):
    found = screened(empty(kind))
    np.testing.assert_array_equal(~found.usable, np.arange(len(found)) < 12)
    ((_, rows, _, _),) = stretches(found)
    assert rows == 12


def test_a_correlation_of_one_written_with_few_digits_is_believed():
    sound = fixes(5.0, 30.0, lambda t: 10.0)
    cov = np.array([[0.0400, 0.0300, 0.0], [0.0300, 0.0225, 0.0], [0.0, 0.0, 0.01]])
    cov[0, 1] = cov[1, 0] = 0.030003
    sound = dataclasses.replace(sound, pos_cov_e=np.tile(cov, (len(sound), 1, 1)))
    assert screened(sound).usable.all()


def test_screening_twice_is_screening_once():
    once = screened(held(empty("0/0"), 15.0, 20.0, "zero"))
    twice = screened(once)
    np.testing.assert_array_equal(once.rejected, twice.rejected)
    assert len(stretches(once)) == 2
