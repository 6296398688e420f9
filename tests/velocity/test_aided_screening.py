"""Doppler held against a velocity that is known already."""

import numpy as np
import pytest

from certnav.velocity.aided_screening import agreeing

SIGNIFICANCE = 1e-3


def epoch(rng, n, sigma=0.05):
    """Whitened rows of n satellites in antenna velocity and clock drift, and noise."""
    azimuth, elevation = rng.uniform(0, 2 * np.pi, n), rng.uniform(0.3, 1.4, n)
    e = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
         np.sin(elevation)]
    )  # fmt: skip
    return np.column_stack([e, -np.ones(n)]) / sigma, rng.standard_normal(n)


PRIOR = np.diag([0.05, 0.05, 0.05, 0.3]) ** 2


def test_sound_rows_are_rarely_accused():
    rng = np.random.default_rng(1)
    accused = 0
    for _ in range(2000):
        H, noise = epoch(rng, 6)
        x = np.sqrt(np.diag(PRIOR)) * rng.standard_normal(4)
        accused += not agreeing(H, H @ x + noise, PRIOR, SIGNIFICANCE).all()
    assert accused <= 2000 * SIGNIFICANCE * 4  # P(more) < 1 % for a true rate of 1e-3


def test_reflected_ones_are_found_although_they_agree_with_each_other():
    """Four of five that share a wrong velocity outvote the fifth, but not what was known before."""
    rng = np.random.default_rng(2)
    found = 0
    for _ in range(200):
        H, noise = epoch(rng, 5)
        z = noise.copy()
        z[:2] += H[:2, :3] @ np.array([3.0, -2.0, 1.0])
        keep = agreeing(H, z, PRIOR, SIGNIFICANCE)
        shift = np.abs(H[:2, :3] @ np.array([3.0, -2.0, 1.0]))
        found += not keep[:2][shift > 12.0].any()
    assert found >= 198


def test_two_satellites_can_be_told_apart_by_a_clock_that_is_known():
    H, _ = epoch(np.random.default_rng(3), 2)
    z = np.array([0.3, 60.0])
    known = np.diag([0.05, 0.05, 0.05, 0.05]) ** 2
    np.testing.assert_array_equal(agreeing(H, z, known, SIGNIFICANCE), [True, False])
    # With an unknown clock the difference is wrong, and either may be the culprit.
    unknown = np.diag([0.05, 0.05, 0.05, 1000.0]) ** 2
    assert not agreeing(H, z, unknown, SIGNIFICANCE).all()


def test_rows_that_might_as_well_be_the_culprit_go_too():
    """Two satellites in one direction disagree and nothing else sees there: neither is kept."""
    sigma = 0.05
    e = np.array([[1.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    H = np.column_stack([e, -np.ones(5)]) / sigma
    z = np.array([40.0, -40.0, 0.0, 0.0, 0.0])
    keep = agreeing(H, z, np.diag([2.0, 0.05, 0.05, 0.05]) ** 2, SIGNIFICANCE)
    np.testing.assert_array_equal(keep, [False, False, True, True, True])


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_answer_does_not_depend_on_units(scale):
    H, z = epoch(np.random.default_rng(5), 6)
    z[4] += 50.0
    base = agreeing(H, z, PRIOR, SIGNIFICANCE)
    np.testing.assert_array_equal(agreeing(H / scale, z, PRIOR * scale**2, SIGNIFICANCE), base)
    assert not base[4]
