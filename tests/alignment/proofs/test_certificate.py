"""Certificates: what they claim must hold on sampled rotations, and they must be able to refuse."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.alignment.proofs.certificate import certify, eigenvalue_ratio, stationary_multipliers
from certnav.alignment.reference.certifiable import certified_minimum
from certnav.alignment.reference.sdp import solve_dual
from certnav.alignment.solver.constraints import constraint_matrices, lagrangian, lift
from certnav.alignment.solver.refinement import cost, gradient, newton, rotation_angle
from certnav.alignment.status import AlignmentStatus
from certnav.filters.rotation import matrix_from_rotvec


def random_cost(rng):
    A = rng.normal(size=(10, 10))
    return A + A.T


def test_bound_and_separation_hold_on_sampled_rotations(rng):
    samples = Rotation.random(2000, rng=rng).as_matrix()
    x = lift(samples)
    for _ in range(10):
        Q = random_cost(rng)
        found = certified_minimum(Q)
        proof = found.certificate
        assert proof.status is AlignmentStatus.CERTIFIED
        costs = np.einsum("ki,ij,kj->k", x, Q, x)
        assert costs.min() >= proof.lower_bound
        angle = rotation_angle(found.C, samples)
        above = 4.0 * proof.second_eigenvalue * (1.0 - np.cos(angle / 2) ** 4)
        assert np.all(costs - proof.primal_cost >= above - 1e-9 * proof.scale)


def test_kkt_residual_is_zero_exactly_where_the_gradient_is(rng):
    Q = random_cost(rng)
    dual = solve_dual(Q)
    optimum = certified_minimum(Q).C
    assert certify(Q, optimum, dual.multipliers, dual.dual_cost).kkt_residual < 1e-14
    off = optimum @ matrix_from_rotvec([1e-3, 0.0, 0.0])
    proof = certify(Q, off, dual.multipliers, dual.dual_cost)
    # |x| = 2 and each tangent vector of vec(C) has length √2: |Hx| ≥ |gradient|/(2√2).
    expected = np.linalg.norm(gradient(Q, off)) / (2.0 * np.sqrt(2.0)) / proof.scale
    assert proof.kkt_residual == pytest.approx(expected, rel=1e-6)


def test_stationary_multipliers_move_little(rng):
    Q = random_cost(rng)
    dual = solve_dual(Q)
    C = certified_minimum(Q).C
    moved = stationary_multipliers(Q, C, dual.multipliers)
    assert np.linalg.norm(moved - dual.multipliers) < 1e-5 * np.linalg.norm(dual.multipliers)
    H = lagrangian(Q, cost(Q, C), moved)
    assert np.linalg.norm(H @ lift(C)) < 1e-13 * np.linalg.norm(H)


def test_eigenvalues_are_those_of_the_lagrangian_at_the_rotation(rng):
    """The first vanishes at an optimum and is negative elsewhere; the second is its rival."""
    Q = random_cost(rng)
    dual, C = solve_dual(Q), certified_minimum(Q).C
    off = C @ matrix_from_rotvec([0.0, 0.3, 0.0])
    for R, low in ((C, -1e-12), (off, -np.inf)):
        proof = certify(Q, R, dual.multipliers, dual.dual_cost)
        H = lagrangian(Q, cost(Q, R), proof.multipliers)
        values = np.linalg.eigvalsh(H)
        assert proof.smallest_eigenvalue == pytest.approx(values[0], abs=1e-12 * proof.scale)
        assert proof.second_eigenvalue == pytest.approx(values[1], rel=1e-9)
        assert low * proof.scale < proof.smallest_eigenvalue < proof.second_eigenvalue
        assert (proof.smallest_eigenvalue < -1e-6) == (R is off)
        ratio = abs(proof.smallest_eigenvalue / proof.second_eigenvalue)
        assert proof.eigenvalue_ratio == pytest.approx(min(ratio, 1.0 / ratio), rel=1e-6)


def test_other_local_minimum_is_not_certified(rng):
    refused = 0
    for _ in range(30):
        Q = random_cost(rng)
        dual, best = solve_dual(Q), certified_minimum(Q)
        for start in Rotation.random(8, rng=rng).as_matrix():
            local = newton(Q, start)
            if local.cost > best.cost + 1e-6:
                proof = certify(Q, local.C, dual.multipliers, dual.dual_cost)
                assert proof.status is AlignmentStatus.NOT_TIGHT
                assert proof.kkt_residual < 1e-10
                assert proof.lower_bound <= best.cost
                refused += 1
    assert refused > 5


def test_point_that_is_no_minimum_is_numerical(rng):
    Q = random_cost(rng)
    dual, C = solve_dual(Q), certified_minimum(Q).C
    off = C @ matrix_from_rotvec([0.0, 1e-2, 0.0])
    assert certify(Q, off, dual.multipliers, dual.dual_cost).status is AlignmentStatus.NUMERICAL


def test_several_optima_are_ambiguous():
    # |C₃₃| = 1 is best: a continuum on both poles.
    Q = -np.diag([0.0] * 8 + [1.0, 0.0])
    found = certified_minimum(Q)
    assert found.certificate.status is AlignmentStatus.AMBIGUOUS
    assert found.certificate.corank > 1
    assert found.cost == pytest.approx(-1.0, abs=1e-9)


def test_choi_lam_quartic_is_refused(choi_lam):
    np.testing.assert_allclose(cost(choi_lam, np.eye(3)), 1.0, atol=1e-12)
    found = certified_minimum(choi_lam)
    proof = found.certificate
    assert found.cost == pytest.approx(0.0, abs=1e-12)  # the solution is right …
    assert proof.status is AlignmentStatus.NOT_TIGHT  # … and there is no proof
    assert proof.lower_bound == pytest.approx(-0.0342, abs=1e-4)
    assert proof.kkt_residual < 1e-12


def test_choi_lam_is_refused_in_any_frame(choi_lam, rotations):
    turn = np.eye(10)
    turn[:9, :9] = np.kron(np.eye(3), rotations[0])
    proof = certified_minimum(turn.T @ choi_lam @ turn).certificate
    assert proof.status is AlignmentStatus.NOT_TIGHT
    assert proof.lower_bound == pytest.approx(-0.0342, abs=1e-4)


def test_adding_multiples_of_the_constraints_changes_nothing(rng):
    Q = random_cost(rng)
    shifted = Q + np.tensordot(rng.normal(size=20), constraint_matrices(), axes=1)
    one, other = certified_minimum(Q), certified_minimum(shifted)
    assert rotation_angle(one.C, other.C) < 1e-10
    assert other.cost == pytest.approx(one.cost, abs=1e-11)


def test_eigenvalue_ratio_is_by_size():
    assert eigenvalue_ratio([-1e-9, 1e-3, 2.0]) == pytest.approx(1e-6)
    assert eigenvalue_ratio([0.0, 0.0, 1.0]) == 1.0
