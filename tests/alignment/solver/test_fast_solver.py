"""The fast solver: identities of the quartic form, agreement with the SDP, honest refusals."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.alignment.problem import build_problem
from certnav.alignment.proofs.certificate import certify
from certnav.alignment.reference.certifiable import certified_minimum
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver import fast_numpy
from certnav.alignment.solver.constraints import ALL, HOMOGENEOUS, constraint_matrices, lift
from certnav.alignment.solver.fast_solver import BACKENDS, fast_minimum, local_minima
from certnav.alignment.solver.quartic import (
    GRID,
    NORM,
    NULL_GRAMS,
    Z,
    gram,
    lagrangian_of,
    monomials,
    reduced_gram,
    super_fibonacci,
)
from certnav.alignment.solver.refinement import cost, gradient, hessian, rotation_angle
from certnav.alignment.status import AlignmentStatus
from certnav.filters.errors import ConfigError, DataError
from certnav.filters.rotation import matrix_from_rotvec


def random_q(rng: np.random.Generator, n: int = 100) -> np.ndarray:
    q = rng.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def matrix(q: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(q, scalar_first=True).as_matrix()


def random_form(rng: np.random.Generator) -> np.ndarray:
    A = rng.normal(size=(10, 10))
    return A + A.T


def choi_lam() -> np.ndarray:
    """Q of w⁴ + x²y² + y²z² + z²x² − 4wxyz, nonnegative but not a sum of squares."""
    G = np.zeros((10, 10))
    G[0, 0] = 1.0
    for k in (7, 8, 9):
        G[k, k] = 0.5
    for a, b in ((1, 9), (2, 8), (3, 7)):
        G[a, b] = G[b, a] = -1.0 / 3.0
    return Z @ G @ Z.T / 16.0


@pytest.fixture(scope="module")
def problems() -> list[np.ndarray]:
    """Cost matrices of simulated windows, all of them observable."""
    rng = np.random.default_rng(7)
    cases = [(3, "2d"), (4, "2d"), (2, "3d"), (3, "3d"), (5, "3d"), (8, "2d")]
    return [
        build_problem(simulate_window(rng, n, motion, sigma=sigma).rows).Q
        for n, motion in cases
        for sigma in (0.02, 0.1, 0.5)
        for _ in range(4)
    ]


class TestQuarticForm:
    def test_rotation_is_linear_in_the_monomials(self):
        q = random_q(np.random.default_rng(1))
        np.testing.assert_allclose(monomials(q) @ Z.T, lift(matrix(q)), atol=1e-14)
        np.testing.assert_allclose(Z.T @ Z, 4.0 * np.eye(10), atol=1e-14)
        np.testing.assert_allclose(monomials(3.0 * q) @ NORM, 9.0, rtol=1e-14)
        np.testing.assert_allclose(np.linalg.norm(monomials(q), axis=1), 1.0, rtol=1e-14)

    def test_fourteen_orthonormal_null_grams_vanish_on_every_quaternion(self):
        m = monomials(random_q(np.random.default_rng(2)))[:, 1:]
        assert NULL_GRAMS.shape == (14, 9, 9)
        np.testing.assert_allclose(np.einsum("ki,nij,kj->kn", m, NULL_GRAMS, m), 0.0, atol=1e-15)
        products = np.einsum("kij,lij->kl", NULL_GRAMS, NULL_GRAMS)
        np.testing.assert_allclose(products, np.eye(14), atol=1e-15)

    def test_they_are_all_there_are(self):
        """Quadratic forms in nine monomials, less those that are distinct quartics."""
        m = monomials(np.random.default_rng(3).normal(size=(200, 4)))[:, 1:]
        row, column = np.triu_indices(9)
        assert 45 - np.linalg.matrix_rank(m[:, row] * m[:, column]) == 14

    def test_gram_identity(self):
        rng = np.random.default_rng(4)
        Q, C, q = random_form(rng), Rotation.random(rng=rng).as_matrix(), random_q(rng)
        m = monomials(q)
        expected = [cost(Q, C @ R) for R in matrix(q)]
        np.testing.assert_allclose(np.einsum("ki,ij,kj->k", m, gram(Q, C), m), expected, atol=1e-12)
        H0, slope = reduced_gram(gram(Q, C))
        rest = m[:, 0] * (m[:, 1:4] @ slope) * np.sqrt(2.0)
        again = cost(Q, C) + np.einsum("ki,ij,kj->k", m[:, 1:], H0, m[:, 1:]) + rest
        np.testing.assert_allclose(again, expected, atol=1e-12)

    def test_gradient_and_hessian_against_finite_differences(self):
        rng = np.random.default_rng(5)
        Q, C, h = random_form(rng), Rotation.random(rng=rng).as_matrix(), 1e-4
        H0, slope = reduced_gram(gram(Q, C))

        def f(*theta):
            return cost(Q, C @ matrix_from_rotvec(np.sum(theta, axis=0)))

        axes = h * np.eye(3)
        central = [(f(a) - f(-a)) / (2 * h) for a in axes]
        np.testing.assert_allclose(slope, central, atol=1e-5)
        second = [
            [(f(a, b) - f(a, -b) - f(-a, b) + f(-a, -b)) / (4 * h * h) for b in axes] for a in axes
        ]
        np.testing.assert_allclose(H0[:3, :3], second, atol=1e-4)
        np.testing.assert_allclose(slope, gradient(Q, C), atol=1e-12)
        np.testing.assert_allclose(H0[:3, :3], hessian(Q, C), atol=1e-12)

    def test_grid_covers_the_group(self):
        nearest = np.einsum(
            "kij,lij->kl", Rotation.random(20000, rng=np.random.default_rng(6)).as_matrix(), GRID
        ).max(axis=1)
        assert nearest.min() > 1.0 + 2.0 * np.cos(np.radians(61.0))
        np.testing.assert_allclose(np.linalg.det(super_fibonacci(10)), 1.0)


def test_a_solver_that_stops_short_is_brought_to_the_end(monkeypatch, problems):
    """A rotation short of the minimum, as if handed over by the solver."""
    Q = 1e3 * problems[0]
    best = fast_minimum(Q)
    C = best.C @ matrix_from_rotvec([0.02, -0.01, 0.03])

    def stopped(scaled):
        X, slope = fast_numpy.smallest_gram(gram(scaled, C))
        return C, cost(scaled, C), -1.0, X, slope, 1, 1, 0

    monkeypatch.setattr(fast_numpy, "solve", stopped)
    found = fast_minimum(Q, backend="numpy")
    assert found.status is AlignmentStatus.CERTIFIED
    assert rotation_angle(found.C, best.C) < 1e-9
    np.testing.assert_allclose(found.hessian, hessian(Q, found.C), atol=1e-9 * found.scale)
    monkeypatch.setattr(fast_numpy, "own_bottom", lambda scaled, C: [C])
    monkeypatch.setattr(fast_numpy, "low_bottoms", lambda scaled, C: [C])
    found = fast_minimum(Q, backend="numpy")
    np.testing.assert_allclose(found.slope, gradient(Q, C), rtol=1e-9)
    assert found.cost == pytest.approx(cost(Q, C), rel=1e-12)
    assert found.status is AlignmentStatus.NUMERICAL
    assert found.lower_bound <= best.cost


@pytest.mark.parametrize("backend", BACKENDS)
class TestSolver:
    def test_agrees_with_the_sdp(self, problems, backend):
        for Q in problems[::2]:
            fast, sdp = fast_minimum(Q, backend=backend), certified_minimum(Q)
            assert fast.status is AlignmentStatus.CERTIFIED
            assert fast.cost == pytest.approx(sdp.cost, abs=1e-12 * fast.scale)
            assert rotation_angle(fast.C, sdp.C) < np.radians(1e-6)

    def test_bound_and_uniqueness_hold_everywhere(self, problems, backend):
        R = Rotation.random(5000, rng=np.random.default_rng(8)).as_matrix()
        x = lift(R)
        for Q in problems[::3]:
            found = fast_minimum(Q, backend=backend)
            costs = np.sum((x @ Q) * x, axis=1)
            assert found.lower_bound <= found.cost
            assert np.all(costs >= found.lower_bound)
            assert found.uniqueness > 0.0
            rise = found.uniqueness * (1.0 - np.cos(0.5 * rotation_angle(found.C, R)) ** 4)
            assert np.all(costs - found.cost >= rise - 1e-12 * found.scale)

    def test_gram_is_a_certificate_for_the_other_certifier(self, problems, backend):
        """The multipliers, put into the Lagrangian of the SDP, prove the same."""
        for Q in problems[::5]:
            found = fast_minimum(Q, backend=backend)
            forms = np.concatenate([constraint_matrices(ALL), [HOMOGENEOUS]]).reshape(-1, 100)
            lagrangian = lagrangian_of(found.gram, found.C)
            combination = np.append(found.multipliers(Q), -found.cost) @ forms
            np.testing.assert_allclose(
                Q + combination.reshape(10, 10), lagrangian, atol=1e-12 * found.scale
            )
            proof = certify(Q, found.C, found.multipliers(Q), found.cost)
            assert proof.status is AlignmentStatus.CERTIFIED
            assert proof.relative_gap < 1e-12

    def test_noise_free_truth_to_working_precision(self, backend):
        rng = np.random.default_rng(9)
        for motion, satellites in (("3d", 2), ("2d", 4), ("3d", 6)):
            window = simulate_window(rng, satellites, motion)
            found = fast_minimum(build_problem(window.rows).Q, backend=backend)
            assert rotation_angle(found.C, window.C_ew) < np.radians(1e-8)

    def test_turning_the_axes_turns_the_answer(self, problems, backend):
        rng = np.random.default_rng(10)
        R1, R2 = Rotation.random(2, rng=rng).as_matrix()
        T = np.eye(10)
        T[:9, :9] = np.kron(R2, R1)  # vec(R1 C R2ᵀ) = (R2 ⊗ R1) vec(C)
        for Q in problems[::6]:
            plain = fast_minimum(Q, backend=backend)
            turned = fast_minimum(T @ Q @ T.T, backend=backend)
            assert rotation_angle(turned.C, R1 @ plain.C @ R2.T) < 1e-9
            assert turned.cost == pytest.approx(plain.cost, abs=1e-12 * plain.scale)

    def test_scaling_the_cost_scales_all_of_it(self, problems, backend):
        plain, large = (fast_minimum(k * problems[5], backend=backend) for k in (1.0, 1e7))
        assert rotation_angle(plain.C, large.C) < 1e-12
        for name in ("cost", "lower_bound", "margin", "uniqueness", "scale"):
            assert getattr(large, name) == pytest.approx(1e7 * getattr(plain, name), rel=1e-6)

    def test_indefinite_forms_are_certified_too(self, backend):
        rng = np.random.default_rng(11)
        x = lift(Rotation.random(2000, rng=rng).as_matrix())
        for _ in range(20):
            Q = random_form(rng)
            found = fast_minimum(Q, backend=backend)
            assert found.status is AlignmentStatus.CERTIFIED
            assert np.all(np.sum((x @ Q) * x, axis=1) >= found.lower_bound)

    def test_choi_lam_is_refused(self, backend):
        """The relaxation has a gap there; a lower bound it gives all the same."""
        rng = np.random.default_rng(12)
        Q = choi_lam()
        q = random_q(rng, 2000)
        w, x, y, z = q.T
        quartic = w**4 + (x * y) ** 2 + (y * z) ** 2 + (z * x) ** 2 - 4 * w * x * y * z
        np.testing.assert_allclose(np.sum((lift(matrix(q)) @ Q) * lift(matrix(q)), 1), quartic)
        T = np.eye(10)
        T[:9, :9] = np.kron(np.eye(3), Rotation.random(rng=rng).as_matrix())
        found = fast_minimum(T @ Q @ T.T, backend=backend)
        assert found.status is AlignmentStatus.NOT_TIGHT
        assert found.cost == pytest.approx(0.0, abs=1e-12)
        assert -0.2 < found.lower_bound < certified_minimum(Q).certificate.lower_bound + 1e-6

    def test_equal_optima_are_not_called_unique(self, backend):
        """f = tr(C diag(…)) with a circle of minima, and f constant."""
        Q = np.zeros((10, 10))
        Q[8, 9] = Q[9, 8] = 1.0  # f = 2 C₃₃: any turn about z of diag(1, −1, −1)
        found = fast_minimum(Q, backend=backend)
        assert found.cost == pytest.approx(-2.0)
        assert found.status is AlignmentStatus.AMBIGUOUS
        assert fast_minimum(np.eye(10), backend=backend).status is AlignmentStatus.AMBIGUOUS

    def test_refuses_what_is_no_cost_matrix(self, backend):
        with pytest.raises(DataError, match="not finite"):
            fast_minimum(np.full((10, 10), np.nan), backend=backend)
        with pytest.raises(DataError, match="shape"):
            fast_minimum(np.eye(9), backend=backend)


def test_both_backends_say_the_same(problems):
    for Q in problems:
        one, other = (fast_minimum(Q, backend=name) for name in BACKENDS)
        assert one.status is other.status
        assert rotation_angle(one.C, other.C) < 1e-9
        assert one.cost == pytest.approx(other.cost, abs=1e-13 * one.scale)
        assert one.lower_bound == pytest.approx(other.lower_bound, abs=1e-9 * one.scale)


def test_both_backends_find_the_lower_of_two_mirrored_basins():
    """Two satellites over planar motion: the first few starts often end in the wrong one."""
    rng = np.random.default_rng(14)
    starts = []
    for _ in range(60):
        Q = build_problem(simulate_window(rng, 2, "2d", sigma=0.1).rows).Q
        one, other = (fast_minimum(Q, backend=name) for name in BACKENDS)
        assert one.cost == pytest.approx(other.cost, abs=1e-12 * one.scale)
        lowest = local_minima(Q).cost[0]
        assert one.cost <= lowest + 1e-12 * one.scale
        assert one.gap < 1e-9 * one.scale and other.gap < 1e-9 * one.scale
        starts.append(one.starts)
    assert max(starts) > 3


def test_both_backends_do_the_same_work_where_there_is_no_proof():
    """Every start is tried, and a barrier that failed is not asked about the same point again."""
    one, other = (fast_minimum(choi_lam(), backend=name) for name in BACKENDS)
    assert one.starts == other.starts == 24
    assert one.barrier_steps == other.barrier_steps > 0
    # A constant has no slope to descend along.
    assert fast_minimum(HOMOGENEOUS, backend="numba").newton_steps == 0


def test_unknown_backend():
    with pytest.raises(ConfigError, match="did you mean 'numba'"):
        fast_minimum(np.eye(10), backend="numbra")


@pytest.mark.parametrize("backend", BACKENDS)
def test_local_minima_are_minima_and_hold_the_mirror(backend):
    window = simulate_window(np.random.default_rng(13), 2, "2d", sigma=0.05)
    Q = build_problem(window.rows).Q
    found = local_minima(Q, backend=backend)
    assert np.all(np.diff(found.cost) >= 0.0)
    for C, value in zip(found.C, found.cost, strict=True):
        assert cost(Q, C) == pytest.approx(value, rel=1e-6, abs=1e-9 * np.trace(Q))
        assert np.linalg.norm(gradient(Q, C)) < 1e-6 * np.trace(Q)
        assert np.linalg.eigvalsh(hessian(Q, C))[0] > -1e-6 * np.trace(Q)
    assert found.cost[1] - found.cost[0] < 9.0
    assert rotation_angle(found.C[0], found.C[1]) > np.radians(5.0)


def test_covariance_is_twice_the_inverse_hessian_and_huge_where_flat(problems):
    found = fast_minimum(problems[0])
    np.testing.assert_allclose(
        found.covariance(), 2.0 * np.linalg.inv(hessian(problems[0], found.C)), rtol=1e-6
    )
    assert np.linalg.eigvalsh(fast_minimum(np.eye(10)).covariance())[0] > 1e9
