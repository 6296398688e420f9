"""NEES and innovations: exact for errors of known size, and for noise that is known."""

import dataclasses

import numpy as np
import pytest

from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.filters.rotation import matrix_from_rotvec, matrix_from_rpy
from certnav.nav.solution import Trajectory, Update


@pytest.fixture
def module(script):
    return script("consistency")


def track(reference, position_n, velocity_n, phi_n, sigma):
    """Return a trajectory that is off by given errors (true − estimated), of one σ each."""
    n = len(reference)
    C_en = C_en_of(reference.pos_e)
    C_nb = matrix_from_rpy(reference.rpy)
    cov = np.tile(np.eye(3) * sigma**2, (n, 1, 1))
    none = np.zeros((n, 3))
    return Trajectory(
        reference.time, reference.pos_e - C_en @ position_n, reference.vel_e - C_en @ velocity_n,
        C_en @ (matrix_from_rotvec(-np.tile(phi_n, (n, 1))) @ C_nb), none, none,
        cov, cov, cov, none, none,
    )  # fmt: skip


def test_nees_is_the_square_of_errors_in_sigma(module):
    made = simulate(SimulationConfig(seed=1, duration=60.0, density="open"))
    reference, sequence = made.reference, made.sequence()
    errors = [np.array(e) for e in ([0.02, 0, 0], [0, 0.03, 0], [0, 0, 0.05])]

    class Solution:
        trajectory = track(reference, *errors, 0.01)
        updates = ()

    exact = module.Judged("")
    found, square = module.nees(Solution, sequence, exact)
    late = reference.time > reference.time[0] + module.SETTLED
    assert len(found["position"]) == late.sum()
    for part, expected in (("position", 4.0), ("velocity", 9.0), ("heading", 25.0)):
        np.testing.assert_allclose(found[part], expected, rtol=2e-2)
    assert square == pytest.approx(0.02**2, rel=1e-3)
    # A reference as uncertain as the solution halves it; a lever takes part where the car turns.
    halved, _ = module.nees(Solution, sequence, dataclasses.replace(exact, position=0.01))
    np.testing.assert_allclose(halved["position"], 2.0, rtol=2e-2)
    turning, _ = module.nees(Solution, sequence, dataclasses.replace(exact, lever=1.0))
    assert (
        turning["velocity"].min() < 1.0 and (turning["velocity"] <= found["velocity"] + 1e-9).all()
    )


def test_white_innovations_of_unit_variance_are_right(module):
    w = np.random.default_rng(2).standard_normal((800, 3))

    def log(factor, values):
        return tuple(
            Update(float(k), "position", (), tuple(factor * v), factor**2 * float(v @ v), True)
            for k, v in enumerate(values)
        )

    found = module.innovations(log(1.0, w))["position"]
    low, high = module.bounds(found.dof)
    assert low < found.nis < high and found.typical == pytest.approx(1.0, abs=0.1)
    assert abs(found.correlation) < 0.1 and found.dof == 2400 and found.refused == 0.0
    assert module.innovations(log(2.0, w))["position"].nis == pytest.approx(4.0 * found.nis)
    lasting = np.cumsum(w, axis=0)
    lasting /= lasting.std()
    assert module.innovations(log(1.0, lasting))["position"].correlation > 0.9


def test_the_page_marks_what_is_outside_the_aim(module):
    rng = np.random.default_rng(3)
    drives = [
        module.figures({p: f * rng.chisquare(n, 4000) for p, n in module.PARTS.items()}, 4.0)
        for f in (1.0, 1.0, 1.1)
    ]
    assert drives[0].typical["position"] == pytest.approx(3.0, rel=0.1)
    assert drives[0].typical["heading"] == pytest.approx(1.0, rel=0.1)
    sure = module.figures({p: np.full(9, 7.0) for p in module.PARTS}, 1.0)
    runs = {"filter": drives, "smoother": [sure]}
    kinds = {"velocity": module.Innovations(100, 300, 0.5, 0.4, 0.01, float("nan"))}
    text = module.page([module.Row("suburb", runs, kinds, ["noise of Doppler: small"])], 3)
    filtered, smoothed = (
        t for t in text.splitlines() if t.startswith("| suburb | ") and "er |" in t
    )
    assert "**" not in filtered and filtered.endswith("| 2.00 |")
    assert smoothed.count("**7** · ") == 3
    assert "| suburb | velocity | 100 | 0.50 | 0.40 | 0.85 … 1.17 | 1.0 % | – |" in text
    assert "*noise of Doppler: small*" in text
