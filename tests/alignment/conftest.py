"""Random rotations and windows shared by the alignment tests."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.alignment.problem import build_problem
from certnav.alignment.reference.simulation import simulate_window


@pytest.fixture
def rng():
    return np.random.default_rng(20240607)


@pytest.fixture
def rotations(rng):
    """A hundred random rotations, shape (100, 3, 3)."""
    return Rotation.random(100, rng=rng).as_matrix()


@pytest.fixture
def windows():
    """Return a function: n simulated windows with their problems, [(window, problem)]."""

    def draw(n, satellites, motion="3d", seed=1, **options):
        rng = np.random.default_rng(seed)
        drawn = [simulate_window(rng, satellites, motion, **options) for _ in range(n)]
        return [(window, build_problem(window.rows)) for window in drawn]

    return draw


@pytest.fixture
def choi_lam():
    """Q of the quartic w⁴ + x²y² + y²z² + z²x² − 4xyzw of the unit quaternion.

    Choi and Lam (1977): non-negative, zero at 1, but no sum of squares, so that the relaxation
    cannot close the gap. The forms vanishing on SO(3) leave Q as undetermined as the fit does.
    """
    q = np.random.default_rng(5).normal(size=(200, 4))
    w, x, y, z = (q / np.linalg.norm(q, axis=1)[:, None]).T
    value = w**4 + (x * y) ** 2 + (y * z) ** 2 + (z * x) ** 2 - 4.0 * x * y * z * w
    C = Rotation.from_quat(q, scalar_first=True).as_matrix()
    r = np.column_stack([np.swapaxes(C, 1, 2).reshape(-1, 9), np.ones(len(q))])
    i, j = np.triu_indices(10)
    fit = np.linalg.lstsq(r[:, i] * r[:, j] * np.where(i == j, 1.0, 2.0), value, rcond=1e-10)
    assert fit[2] == 35  # quartic forms in four variables
    Q = np.zeros((10, 10))
    Q[i, j] = Q[j, i] = fit[0]
    return Q
