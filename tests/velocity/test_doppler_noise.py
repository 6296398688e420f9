"""Noise that was put in has to come out."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import ConfigError, DataError
from certnav.velocity.doppler_noise import (
    correlated_epochs,
    fit_doppler_noise,
    fit_low_elevation,
    own_residuals,
    reference_residuals,
)
from certnav.velocity.range_rate import DopplerNoise
from certnav.velocity.study.samples import reference_samples

TRUE = DopplerNoise(0.08, 0.03, decade_db=16.0)


def drawn(rng, n=20000):
    cn0 = rng.uniform(26.0, 52.0, n)
    return cn0, TRUE.sigma(cn0) * rng.standard_normal(n)


@pytest.mark.parametrize("spread", ["mad", "rms"])
def test_gaussian_noise_is_recovered(spread):
    cn0, residual = drawn(np.random.default_rng(1))
    fit = fit_doppler_noise(cn0, residual, spread=spread)
    level = np.linspace(27, 51, 9)
    np.testing.assert_allclose(fit.noise.sigma(level), TRUE.sigma(level), rtol=0.12)
    assert fit.noise.decade_db == pytest.approx(16.0, abs=2.0)
    assert fit.misfit < 0.1


def test_reflections_do_not_pass_for_noise_unless_asked():
    rng = np.random.default_rng(2)
    cn0, residual = drawn(rng)
    reflected = rng.random(cn0.size) < 0.05
    residual[reflected] += rng.choice([-8.0, 8.0], reflected.sum())
    level = np.array([30.0, 40.0, 50.0])
    robust = fit_doppler_noise(cn0, residual).noise.sigma(level)
    np.testing.assert_allclose(robust, TRUE.sigma(level), rtol=0.2)
    everything = fit_doppler_noise(cn0, residual, spread="rms").noise.sigma(level)
    assert everything.min() > 1.5


@pytest.mark.parametrize("low", [0.0, 0.7, 3.0])
def test_what_low_satellites_have_too_much_of_is_recovered(low):
    rng = np.random.default_rng(5)
    elevation = rng.uniform(0.09, 1.5, 20000)
    true = DopplerNoise(0.08, 0.03, low=low)
    normal = true.sigma(45.0, elevation) / true.sigma(45.0) * rng.standard_normal(20000)
    assert fit_low_elevation(elevation, normal) == pytest.approx(low, abs=0.1 + 0.15 * low)
    # Elevations that are all the same, or not known, say nothing.
    assert fit_low_elevation(0.02 * elevation, normal) == 0.0
    assert fit_low_elevation(np.full(20000, np.nan), normal) == 0.0
    assert np.all(true.sigma(40.0, np.nan) == true.sigma(40.0))


def test_without_range_of_cn0_the_thermal_slope_is_taken():
    rng = np.random.default_rng(3)
    cn0 = rng.uniform(54.0, 56.0, 2000)
    fit = fit_doppler_noise(cn0, 0.02 * rng.standard_normal(2000))
    assert fit.noise.decade_db == pytest.approx(20.0, abs=0.01)
    assert fit.noise.sigma(55.0) == pytest.approx(0.02, rel=0.1)


def test_too_little_data_is_refused():
    with pytest.raises(DataError, match="expected 60 rows with C/N0 or more, found 3"):
        fit_doppler_noise([40.0, 41.0, 42.0, np.nan], [0.1, 0.1, 0.1, 0.1])
    with pytest.raises(ConfigError, match="spread"):
        fit_doppler_noise(np.ones(99), np.ones(99), spread="std")


def test_simulated_receiver_with_and_without_reference():
    """The simulator's σ: 0.02 m/s floor and 0.3 m/s at 25 dB-Hz, 20 dB per decade."""
    sim = simulate(SimulationConfig(duration=150.0, density="open", seed=3, atmosphere=False))
    samples = reference_samples(sim.sequence())
    level = np.array([40.0, 44.0, 48.0])
    true = np.hypot(0.02, 0.3 * 10.0 ** ((25.0 - level) / 20.0))
    fit = fit_doppler_noise(samples.cn0, reference_residuals(samples)).noise
    np.testing.assert_allclose(fit.sigma(level), true, rtol=0.2)
    time, reference = sim.observations.time, sim.reference
    pos_e = np.column_stack([np.interp(time, reference.time, x) for x in reference.pos_e.T])
    cn0, residual = own_residuals(sim.observations, pos_e)
    alone = fit_doppler_noise(cn0, residual).noise
    np.testing.assert_allclose(alone.sigma(level), true, rtol=0.25)


def test_correlated_errors_count_as_few():
    """First-order Gauss–Markov: 1 + 2Σρᵏ = (1 + ρ)/(1 − ρ)."""
    rng, n, rho = np.random.default_rng(4), 4000, 0.8
    time, names, errors = [], [], []
    for sat in ("G01", "G02", "G03"):
        x = np.empty(n)
        x[0] = rng.standard_normal()
        for k, white in enumerate(rng.standard_normal(n - 1)):
            x[k + 1] = rho * x[k] + np.sqrt(1.0 - rho**2) * white
        time.append(0.2 * np.arange(n))
        names.append(np.full(n, sat))
        errors.append(x)
    time, names, errors = (np.concatenate(a) for a in (time, names, errors))
    assert correlated_epochs(time, names, errors) == pytest.approx(9.0, rel=0.15)
    errors[rng.random(errors.size) < 0.3] = np.nan  # gaps change nothing
    assert correlated_epochs(time, names, errors) == pytest.approx(9.0, rel=0.2)
    white = rng.standard_normal(errors.size)
    assert correlated_epochs(time, names, white) == pytest.approx(1.0, abs=0.5)
    # Of satellites that share nothing, no pair of different ones is compared.
    assert correlated_epochs(np.zeros(3), ["G01", "G02", "G03"], [1.0, 1.0, 1.0]) == 1.0
