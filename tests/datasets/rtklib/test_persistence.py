"""Satellites that are wrong all the time: found by their mean, named with their error."""

import numpy as np
import pytest

from certnav.datasets.rtklib.persistence import persistent_faults

SATELLITES = tuple(f"G{k:02d}" for k in range(1, 10))


def sky(seed, n=9):
    rng = np.random.default_rng(seed)
    azimuth = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False) + rng.uniform(-0.3, 0.3, n)
    elevation = rng.uniform(0.3, 1.4, n)
    e = np.column_stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
    )
    return np.column_stack([-e, np.ones(n)]), 3.0 * np.sqrt(1.0 + 1.0 / np.sin(elevation))


def fixes(bias, epochs=100, noise=4.0, systematic=0.0, seed=0):
    """Return residuals of least squares with one satellite off by `bias` [m]."""
    H, sigma = sky(seed)
    rng = np.random.default_rng(seed)
    common = systematic * rng.standard_normal(9)
    w = 1.0 / sigma
    projector = np.eye(9) - H @ np.linalg.pinv(H * w[:, None]) * w
    error = noise * rng.standard_normal((epochs, 9)) + common
    error[:, 4] += bias
    return [SATELLITES] * epochs, [H] * epochs, list(error @ projector.T), [sigma] * epochs


@pytest.mark.parametrize("bias", [30.0, -40.0])
def test_a_satellite_off_by_tens_of_metres_is_found(bias):
    (fault,) = persistent_faults(*fixes(bias))
    assert fault.satellite == "G05" and fault.fixes == 100
    assert fault.bias == pytest.approx(bias, abs=3.0)


def test_sound_satellites_are_not_accused():
    for seed in range(30):
        assert persistent_faults(*fixes(0.0, systematic=1.5, seed=seed)) == ()


def test_few_fixes_and_no_redundancy_say_nothing():
    assert persistent_faults(*fixes(50.0, epochs=59)) == ()
    names, H, residuals, sigma = fixes(50.0)
    few = [[a[:4] for a in part] for part in (names, H, residuals, sigma)]
    assert persistent_faults(*few) == ()
    assert persistent_faults([], [], [], []) == ()
