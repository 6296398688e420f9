"""VOBA and Gauss–Newton: exact without noise, honest about what they need."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.alignment.reference.baselines import gauss_newton, voba
from certnav.alignment.reference.certifiable import align_sdp
from certnav.alignment.solver.refinement import gradient, rotation_angle
from certnav.filters.errors import AlignmentError
from certnav.filters.rotation import matrix_from_rotvec


@pytest.mark.parametrize("motion", ["2d", "3d"])
def test_voba_recovers_the_noise_free_rotation(windows, motion):
    for window, _ in windows(10, 6, motion):
        found = voba(window.rows)
        assert found.used == 10
        assert np.degrees(rotation_angle(found.C_ew, window.C_ew)) < 1e-6


def test_voba_needs_four_satellites_and_a_turn(windows):
    ((window, _),) = windows(1, 3)
    with pytest.raises(AlignmentError, match=r"0 epoch\(s\)"):
        voba(window.rows)
    ((window, _),) = windows(1, 6, "line")
    with pytest.raises(AlignmentError, match="parallel"):
        voba(window.rows)


def test_voba_skips_epochs_with_too_few_satellites(windows):
    ((window, _),) = windows(1, 5)
    keep = np.ones(len(window.rows), dtype=bool)
    keep[10:13] = False  # two of five left at the third epoch
    assert voba(window.rows.take(keep)).used == 9


def test_voba_solves_wahba_not_an_orthogonal_procrustes_with_reflection(windows):
    # Planar velocities leave the sign of the third axis to the determinant.
    for window, _ in windows(20, 6, "2d", sigma=0.05):
        assert np.linalg.det(voba(window.rows).C_ew) == pytest.approx(1.0)


def test_gauss_newton_from_nearby_reaches_the_certified_optimum(windows):
    for _, problem in windows(20, 4, sigma=0.05):
        best = align_sdp(problem).C_ew
        start = best @ matrix_from_rotvec(np.radians([4.0, -3.0, 5.0]))
        found = gauss_newton(problem, start, tolerance=1e-10, max_steps=50)
        assert found.converged
        assert np.degrees(rotation_angle(found.C_ew, best)) < 1e-6
        assert np.linalg.norm(gradient(problem.Q, found.C_ew)) < 1e-8 * np.trace(problem.Q)


def test_gauss_newton_with_the_clock_alongside_takes_the_same_steps(windows):
    ((window, problem),) = windows(1, 4, sigma=0.1)
    rows = window.rows
    start = window.C_ew @ matrix_from_rotvec([0.5, -0.4, 0.3])
    np.testing.assert_array_equal(gauss_newton(problem).C_ew, gauss_newton(problem, np.eye(3)).C_ew)
    eliminated = gauss_newton(problem, start, max_steps=1)
    predicted = np.einsum("ki,ij,kj->k", rows.e_e, start, rows.vel_w) - 4321.0
    local = rows.e_e @ start  # ∂(e·C Exp(θ) v)/∂θ = (v × Cᵀe)ᵀ
    jacobian = np.column_stack([np.cross(rows.vel_w, local), -np.ones(len(rows))])
    step = np.linalg.lstsq(jacobian, rows.z - predicted, rcond=None)[0]
    assert rotation_angle(eliminated.C_ew, start @ matrix_from_rotvec(step[:3])) < 1e-9
    assert not eliminated.converged


def test_gauss_newton_gives_up_where_the_published_code_does(windows):
    ((_, problem),) = windows(1, 4, sigma=0.1)
    endless = gauss_newton(problem, tolerance=0.0)
    assert (endless.used, endless.converged) == (20, False)


def test_gauss_newton_can_fail_where_the_relaxation_does_not(windows):
    lost = 0
    for window, problem in windows(60, 3, "2d"):
        assert np.degrees(rotation_angle(align_sdp(problem).C_ew, window.C_ew)) < 1e-6
        lost += np.degrees(rotation_angle(gauss_newton(problem).C_ew, window.C_ew)) > 20.0
    assert 5 < lost < 55


def test_baselines_do_not_alter_their_input(windows):
    ((window, problem),) = windows(1, 5)
    before = dataclasses.astuple(window.rows)
    voba(window.rows)
    gauss_newton(problem, np.eye(3))
    for old, new in zip(before, dataclasses.astuple(window.rows), strict=True):
        np.testing.assert_array_equal(old, new)
