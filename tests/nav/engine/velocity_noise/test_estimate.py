"""The noise of velocities from innovations that were made with a known one."""

import numpy as np
import pytest

from certnav.nav.engine.velocity_noise.collected import Epoch
from certnav.nav.engine.velocity_noise.estimate import (
    LEAST,
    lasts,
    range_rate_noise,
    velocity_scale,
)
from certnav.velocity.range_rate import DopplerNoise

DECLARED, TRUE = DopplerNoise(0.06, 0.04), DopplerNoise(0.03, 0.02)


def epochs(count, noise, walk=0.03, in_force=0.1, seed=0, wrong=0.0):
    """Epochs of six satellites; the filter allows for a clock that walks by `in_force`."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(count):
        cn0 = rng.uniform(30.0, 52.0, 6)
        e = rng.standard_normal((6, 3))
        H = np.column_stack([e / np.linalg.norm(e, axis=1)[:, None], -np.ones(6)])
        real, allowed = (np.diag([0.02, 0.02, 0.02, q]) ** 2 for q in (walk, in_force))
        x = rng.multivariate_normal(np.zeros(4), real)
        z = H @ x + noise.sigma(cn0) * rng.standard_normal(6)
        if rng.uniform() < wrong:
            z[0] += 3.0
        names = np.array([f"G{i:02d}" for i in range(6)])
        out.append(
            Epoch(
                float(k), 1.0, names, cn0, z, H @ allowed @ H.T, np.diag(DECLARED.sigma(cn0) ** 2)
            )
        )
    return out


def test_noise_by_signal_strength_and_the_walk_of_the_clock_are_found():
    noise, walk = range_rate_noise(epochs(300, TRUE), DECLARED, 0.1, 0.1)
    np.testing.assert_allclose(
        noise.sigma([34.0, 45.0, 51.0]), TRUE.sigma([34.0, 45.0, 51.0]), rtol=0.1
    )
    assert walk == pytest.approx(0.03, rel=0.3)
    louder = DopplerNoise(0.2, 0.1)
    noise, _ = range_rate_noise(epochs(300, louder), DECLARED, 0.1, 0.1)
    np.testing.assert_allclose(noise.sigma([34.0, 51.0]), louder.sigma([34.0, 51.0]), rtol=0.1)


def test_a_few_reflections_do_not_pass_for_noise():
    noise, _ = range_rate_noise(epochs(300, TRUE, wrong=0.02), DECLARED, 0.1, 0.1)
    np.testing.assert_allclose(noise.sigma([34.0, 45.0]), TRUE.sigma([34.0, 45.0]), rtol=0.2)


def test_of_few_data_little_is_learnt_and_nothing_is_believed_below_a_centimetre_per_second():
    exact = DopplerNoise(0.0, 1e-4)
    few, _ = range_rate_noise(epochs(1, exact), DECLARED, 0.1, 0.1)
    many, walk = range_rate_noise(epochs(300, exact, walk=0.0), DECLARED, 0.1, 0.1)
    assert few.sigma(45.0) > 1.25 * many.sigma(45.0)
    assert many.sigma(52.0) >= LEAST and walk >= 0.02
    modest = DopplerNoise(0.06, 0.002)  # what is declared smaller stays so
    assert range_rate_noise(epochs(100, exact), modest, 0.1, 0.1)[0].floor < LEAST


def velocities(count, scale, fade, seed=1):
    rng = np.random.default_rng(seed)
    R, A = np.diag([0.01, 0.01, 0.04]), 1e-6 * np.eye(3)
    b, out = rng.standard_normal(3), []
    for k in range(count):
        b = fade * b + np.sqrt(1.0 - fade**2) * rng.standard_normal(3)
        z = scale * np.sqrt(np.diag(R)) * b
        out.append(Epoch(float(k), 1.0, np.array([""] * 3), np.full(3, np.nan), z, A, R))
    return out


def test_scale_of_ready_made_velocities_and_how_many_count_as_one():
    white, lasting = velocities(400, 0.3, 0.0), velocities(400, 0.3, 0.6)
    assert velocity_scale(white) == pytest.approx(0.3, rel=0.08)
    assert velocity_scale(lasting) == pytest.approx(0.3, rel=0.15)
    assert lasts(white, 0.3) == pytest.approx(1.0, abs=0.25)
    assert lasts(lasting, 0.3) == pytest.approx(4.0, rel=0.3)


def test_what_wanders_more_than_a_quartz_is_found_as_it_is():
    """The walk is not held to what is declared: that it is none is said, not hidden."""
    _, walk = range_rate_noise(epochs(300, TRUE, walk=0.6), DECLARED, 0.1, 0.1)
    assert walk == pytest.approx(0.6, rel=0.3)
