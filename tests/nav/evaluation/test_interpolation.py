"""Interpolation of a trajectory: exact where its model is exact, and never outside."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.filters.errors import DataError
from certnav.filters.rotation import matrix_from_rotvec
from certnav.nav.evaluation.interpolation import covered, interpolate


def test_interpolation_is_exact_for_a_cubic_and_a_steady_turn(drive):
    solution, _ = drive(noise=0.0, duration=10.0, rate=1.0)
    t = solution.trajectory.time - solution.trajectory.time[0]
    rate = np.array([0.1, -0.2, 0.3])

    def cubic(s):
        return np.stack([s**3 - s, 2 * s**2, 5 - s], axis=-1)

    track = dataclasses.replace(
        solution.trajectory,
        pos_e=cubic(t),
        vel_e=np.stack([3 * t**2 - 1, 4 * t, -np.ones_like(t)], axis=-1),
        C_eb=matrix_from_rotvec(t[:, None] * rate),
    )
    s = np.array([0.0, 0.25, 3.5, 9.9, 10.0])
    at = interpolate(track, track.time[0] + s)
    np.testing.assert_allclose(at.pos_e, cubic(s), atol=1e-4)  # 0.2 µs of time at 300 m/s
    np.testing.assert_allclose(at.C_eb, matrix_from_rotvec(s[:, None] * rate), atol=1e-6)
    np.testing.assert_array_equal(at.pos_e[[0, 4]], track.pos_e[[0, 10]])
    with pytest.raises(DataError, match="outside"):
        interpolate(track, track.time[:1] - 0.1)


def test_covered_at_edges_and_gaps():
    nodes = np.array([0.0, 1.0, 2.0, 10.0, 11.0])
    time = np.array([-0.1, 0.0, 0.5, 2.0, 2.1, 9.9, 10.0, 11.0, 11.1])
    wanted = [False, True, True, True, False, False, True, True, False]
    assert covered(nodes, time, max_gap=1.0).tolist() == wanted
    # A solution that is slow throughout is not all gap.
    assert covered(2.0 * np.arange(5.0), np.array([3.0]), max_gap=1.0).all()
    assert covered(np.array([5.0]), np.array([4.0, 5.0]), 1.0).tolist() == [False, True]


def test_a_gap_of_just_the_longest_step_is_none():
    nodes = np.array([0.0, 0.25, 0.5, 0.75, 1.75, 3.0])
    assert covered(nodes, np.array([1.25, 2.0]), max_gap=1.0).tolist() == [True, False]
    # Half a second is the usual step here, so that three quarters of one are no gap.
    slow = np.array([0.0, 0.5, 1.0, 1.75, 2.625, 3.125])
    assert covered(slow, np.array([1.5, 2.0]), max_gap=0.1).tolist() == [True, False]


def test_nothing_covers_nothing_and_one_epoch_itself(drive):
    time = np.array([1.0, 2.0])
    none = covered(np.zeros(0), time, 1.0)
    assert none.dtype == bool and none.tolist() == [False, False]
    solution, _ = drive(noise=0.0, duration=10.0, rate=1.0)
    track = solution.trajectory
    one = next(track.parts(1))
    at = interpolate(one, one.time)
    np.testing.assert_array_equal(at.pos_e, one.pos_e)
    np.testing.assert_allclose(at.C_eb, one.C_eb, atol=1e-15)
    nowhere = interpolate(track, np.zeros(0))
    assert len(nowhere) == 0 and nowhere.C_eb.shape == (0, 3, 3)
    for wrong in (track.time[-1:] + 0.1, np.array([track.time[3], track.time[-1] + 0.1])):
        with pytest.raises(DataError, match="outside"):
            interpolate(track, wrong)
    empty = dataclasses.replace(
        track, **{f.name: getattr(track, f.name)[:0] for f in dataclasses.fields(track)}
    )
    with pytest.raises(DataError, match="outside"):
        interpolate(empty, np.zeros(0))


def test_everything_else_is_linear(drive):
    """Each field on its own line: none is taken for another."""
    solution, _ = drive(noise=0.0, duration=4.0, rate=1.0)
    track = solution.trajectory
    lines = {}
    for k, name in enumerate((
        "vel_e", "gyro_bias", "accel_bias", "cov_pos_n", "cov_vel_n", "cov_att_n",
        "std_gyro_bias", "std_accel_bias",
    )):  # fmt: skip
        shape = getattr(track, name).shape
        slope = (k + 1.0) * np.arange(1.0, 1.0 + np.prod(shape[1:])).reshape(shape[1:])
        lines[name] = slope
    t = track.time - track.time[0]
    made = dataclasses.replace(
        track, **{n: np.multiply.outer(t, slope) for n, slope in lines.items()}
    )
    at = interpolate(made, track.time[0] + np.array([0.25, 3.75]))
    for name, slope in lines.items():
        expected = np.multiply.outer([0.25, 3.75], slope)
        np.testing.assert_allclose(getattr(at, name), expected, atol=1e-5, err_msg=name)


@pytest.mark.parametrize(("time", "nodes"), [
    (2.25, (2, 3)), (0.5, (0, 1)), (3.75, (3, 4)), (2.0, (2, 3)), (4.0, (3, 4)),
])  # fmt: skip
def test_the_two_nodes_around_it_and_no_other(drive, time, nodes):
    solution, _ = drive(noise=0.0, duration=4.0, rate=1.0)
    track = solution.trajectory
    others = np.setdiff1d(np.arange(5), nodes)
    spoilt = {"time": track.time}
    for field in dataclasses.fields(track)[1:]:
        values = getattr(track, field.name).copy()
        if field.name == "C_eb":
            values[others] = np.diag([1.0, -1.0, -1.0])
        else:
            values[others] = np.nan
        spoilt[field.name] = values
    at = track.time[:1] + time
    sound, made = (interpolate(t, at) for t in (track, type(track)(**spoilt)))
    for field in dataclasses.fields(track):
        np.testing.assert_array_equal(getattr(made, field.name), getattr(sound, field.name))
