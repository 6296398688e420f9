"""The entrance: plain arrays or rows, all of them believed or those that may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import certnav
from certnav.alignment.entrance import align
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.result import Ask
from certnav.alignment.solver.refinement import rotation_angle
from certnav.filters.errors import DataError


def test_plain_arrays_are_an_entrance(rng):
    """The same numbers as rows, by name; what is missing or unknown is named."""
    rows = simulate_window(rng, 5, sigma=0.05, epochs=20).rows
    arrays = {name: getattr(rows, name) for name in ("e_e", "vel_w", "z", "sigma", "time")}
    plain = align({name: value.tolist() for name, value in arrays.items()})
    np.testing.assert_array_equal(plain.C_ew, align(rows).C_ew)
    assert plain.inliers is None
    assert certnav.align is align
    with pytest.raises(DataError, match="expected 'sigma'"):
        align({name: value for name, value in arrays.items() if name != "sigma"})
    with pytest.raises(DataError, match="'velocity' is none of"):
        align({**arrays, "velocity": rows.vel_w})


def test_the_same_entrance_finds_out_which_rows_to_believe(rng):
    w = simulate_window(rng, 6, sigma=0.05, epochs=20)
    wrong = np.zeros(len(w.rows), dtype=bool)
    wrong[[3, 40, 77]] = True
    rows = replace(w.rows, z=w.rows.z + 4.0 * wrong)
    assert not align(rows).passed
    found = align(rows, robust=True)
    assert found.passed and Ask.CONSENSUS in found.asked
    np.testing.assert_array_equal(found.inliers, ~wrong)
    assert rotation_angle(found.C_ew, w.C_ew) < found.bound
