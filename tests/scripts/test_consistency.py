"""NEES and innovations: exact for errors of known size, and for one drive of known noise."""

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
    reference = simulate(SimulationConfig(seed=1, duration=60.0, density="open")).reference
    errors = [np.array(e) for e in ([0.02, 0, 0], [0, 0.03, 0], [0, 0, 0.05])]
    time = np.ceil(reference.time[0]) + np.arange(1.0, 59.0)
    found = module.nees(track(reference, *errors, 0.01), reference, time)
    settled = np.isfinite(found["position"])
    assert settled.sum() == (time >= reference.time[0] + module.SETTLED).sum()
    for part, expected in zip(module.PARTS, (4.0, 9.0, 25.0), strict=True):
        np.testing.assert_allclose(found[part][settled], expected, rtol=1e-3)


def test_white_innovations_of_unit_variance_are_right(module):
    w = np.random.default_rng(2).standard_normal((800, 3))

    def log(factor, values):
        return tuple(
            Update(float(k), "position", (), tuple(factor * v), factor**2 * float(v @ v), True)
            for k, v in enumerate(values)
        )

    found = module.innovations(log(1.0, w))["position"]
    assert found.verdict == "right" and found.rms == pytest.approx(1.0, abs=0.05)
    assert abs(found.correlation) < 0.1 and found.dof == 2400 and found.refused == 0.0
    twice = module.innovations(log(2.0, w))["position"]
    assert twice.verdict.startswith("too small by 2.") or twice.verdict == "too small by 1.9"
    lasting = np.cumsum(w, axis=0)
    lasting /= lasting.std()
    assert "errors last" in module.innovations(log(1.0, lasting))["position"].verdict


def test_the_page_and_the_figure_hold_every_kind(module, tmp_path):
    rng = np.random.default_rng(3)
    stats = module.Innovations(100, 300, 1.2, 1.1, 0.01, float("nan"))
    worlds = {
        name: module.World(
            {p: rng.chisquare(3, (4, 100)) for p in module.PARTS}, {"position": stats}
        )
        for name in module.WORLDS
    }
    recordings = {"somewhere": {"velocity": dataclasses.replace(stats, typical=0.5)}}
    text = module.page(worlds, recordings, 4)
    assert "| somewhere | velocity | 100 |" in text and "too large by 2.0" in text
    # χ² draws are inside their own bounds as often as they should be.
    inside = [world.inside(p) for world in worlds.values() for p in module.PARTS]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)
    module.draw(worlds, recordings, tmp_path / "a" / "figure.png")
    assert (tmp_path / "a" / "figure.png").stat().st_size > 20_000
