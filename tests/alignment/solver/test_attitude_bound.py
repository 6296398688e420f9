"""The certified bound against samples of the region it encloses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.alignment.problem import build_problem
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver import fast_compiled, fast_numpy
from certnav.alignment.solver.attitude_bound import attitude_bound, region_threshold
from certnav.alignment.solver.constraints import lift
from certnav.alignment.solver.fast_solver import fast_minimum, local_minima
from certnav.alignment.solver.refinement import rotation_angle
from certnav.filters.errors import ConfigError

T = region_threshold()


def farthest(Q: np.ndarray, minimum, rng: np.random.Generator) -> float:
    """Largest angle found inside the region: around the ellipsoid, everywhere, at other minima."""
    root = np.linalg.cholesky(np.linalg.inv(0.5 * minimum.hessian))
    towards = rng.normal(size=(4000, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    theta = (towards * np.sqrt(T) * rng.uniform(0.8, 1.3, 4000)[:, None]) @ root.T
    R = np.concatenate(
        [
            minimum.C @ Rotation.from_rotvec(theta).as_matrix(),
            Rotation.random(4000, rng=rng).as_matrix(),
            local_minima(Q).C,
        ]
    )
    x = lift(R)
    return float(
        rotation_angle(minimum.C, R[np.sum((x @ Q) * x, axis=1) <= minimum.cost + T]).max()
    )


@pytest.mark.parametrize(
    ("satellites", "motion", "looseness"),
    [(6, "3d", 1.03), (3, "3d", 1.1), (2, "3d", 1.3), (4, "2d", 1.4)],
)
@pytest.mark.parametrize("sigma", [0.05, 0.3])
def test_encloses_the_region_and_not_much_more(satellites, motion, looseness, sigma):
    rng = np.random.default_rng(satellites)
    ratios = []
    for _ in range(12):
        window = simulate_window(rng, satellites, motion, epochs=20, sigma=sigma)
        Q = build_problem(window.rows).Q
        minimum = fast_minimum(Q)
        bound = attitude_bound(minimum, T)
        ratios.append(bound / farthest(Q, minimum, rng))
    assert min(ratios) >= 1.0
    assert np.median(ratios) < looseness


def test_is_near_the_axis_of_the_ellipsoid_where_the_region_is_small():
    """θᵀ(Hessian/2)θ = T: an angle of √(2T/λ_min), to first order."""
    rng = np.random.default_rng(1)
    for _ in range(10):
        window = simulate_window(rng, 8, "3d", epochs=20, sigma=0.001)
        minimum = fast_minimum(build_problem(window.rows).Q)
        axis = np.sqrt(2.0 * T / np.linalg.eigvalsh(minimum.hessian)[0])
        assert 1.0 < attitude_bound(minimum, T) / axis < 1.2


def test_backends_agree():
    rng = np.random.default_rng(2)
    for satellites, motion in ((3, "3d"), (4, "2d"), (2, "2d")):
        window = simulate_window(rng, satellites, motion, epochs=20, sigma=0.1)
        minimum = fast_minimum(build_problem(window.rows).Q)
        one, other = (attitude_bound(minimum, T, backend=name) for name in ("numba", "numpy"))
        assert one == pytest.approx(other, rel=0.01)


def test_grows_with_the_threshold():
    window = simulate_window(np.random.default_rng(3), 4, "3d", epochs=20, sigma=0.1)
    minimum = fast_minimum(build_problem(window.rows).Q)
    bounds = [attitude_bound(minimum, threshold) for threshold in (1.0, 4.0, 14.0, 50.0, 1e9)]
    assert np.all(np.diff(bounds) > 0.0)
    assert bounds[1] == pytest.approx(2.0 * bounds[0], rel=0.05)
    assert bounds[-1] == np.pi


def test_says_nothing_about_mirrors_and_continua():
    rng = np.random.default_rng(4)
    for satellites, motion in ((2, "2d"), (5, "line"), (1, "2d")):
        window = simulate_window(rng, satellites, motion, sigma=0.05)
        assert attitude_bound(fast_minimum(build_problem(window.rows).Q), T) == np.pi
    assert attitude_bound(fast_minimum(np.eye(10)), T) == np.pi


def test_truth_is_inside_at_the_rate_promised():
    rng = np.random.default_rng(5)
    inside = []
    for _ in range(150):
        window = simulate_window(rng, 4, "3d", epochs=20, sigma=0.5)
        minimum = fast_minimum(build_problem(window.rows).Q)
        bound = attitude_bound(minimum, region_threshold(0.9))
        inside.append(rotation_angle(minimum.C, window.C_ew) <= bound)
    # The bound is a ball around the ellipsoid, so that it holds at least as often.
    assert np.mean(inside) > 0.9


def test_a_barrier_that_starts_outside_says_so():
    for barrier in (fast_compiled.barrier, fast_numpy.barrier):
        reached = barrier(np.eye(9), np.ones(9), 1.5, np.inf, -np.inf, 1e-6)
        assert reached[0] == -np.inf and reached[-1] == 0
    # From inside it gets to the largest s: at least that of the matrix as it is.
    for barrier in (fast_compiled.barrier, fast_numpy.barrier):
        assert barrier(np.eye(9), np.ones(9), 0.0, np.inf, -np.inf, 1e-6)[0] > 1.0 - 1e-6


def test_thresholds():
    assert region_threshold(0.9973) == pytest.approx(14.16, abs=0.01)
    assert region_threshold(0.6827, 1) == pytest.approx(1.0, abs=1e-3)
    with pytest.raises(ConfigError, match="threshold > 0"):
        attitude_bound(fast_minimum(np.eye(10)), 0.0)
