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
