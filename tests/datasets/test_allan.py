"""Known noise is recovered from a log at rest; a preset in a file is the preset that was made."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.allan import (
    axis_noise,
    preset_from_rest,
    preset_toml,
    read_preset,
)
from certnav.datasets.series import ImuData
from certnav.filters.errors import ConfigError, DataError, NavError
from certnav.filters.sensors import STANDARD_GRAVITY, imu_preset

pytest.importorskip("allantools")
RATE = 50.0


def white(rng, n, density):
    return density * np.sqrt(RATE) * rng.standard_normal(n)


def flicker(rng, n, instability):
    """Noise with the one-sided spectrum B²/(πf), whose Allan deviation is 0.664 B everywhere."""
    f = np.fft.rfftfreq(n, 1.0 / RATE)
    amplitude = np.zeros(f.size)
    amplitude[1:] = np.sqrt(instability**2 / (np.pi * f[1:]) * RATE * n / 2.0)
    phase = rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)
    return np.fft.irfft(amplitude * phase / np.sqrt(2.0), n)


@pytest.mark.parametrize("seed", range(3))
def test_white_noise_and_bias_instability_are_recovered(seed):
    rng, n = np.random.default_rng(seed), int(7200 * RATE)
    found = axis_noise(white(rng, n, 2e-4) + flicker(rng, n, 5e-5) + 0.01, 1.0 / RATE)
    assert found.density == pytest.approx(2e-4, rel=0.03)
    assert abs(found.density - 2e-4) < 6.0 * found.density_sigma
    assert found.instability == pytest.approx(5e-5, rel=0.3)
    assert 10.0 < found.tau < 2000.0


def test_flicker_alone_has_no_white_noise():
    rng = np.random.default_rng(1)
    with pytest.raises(DataError, match="no white noise"):
        axis_noise(flicker(rng, int(3600 * RATE), 5e-5), 1.0 / RATE)


def test_a_log_too_short_gives_an_upper_bound():
    rng = np.random.default_rng(2)
    found = axis_noise(white(rng, int(300 * RATE), 2e-4) + 0.0, 1.0 / RATE)
    assert not found.bounded
    assert found.density == pytest.approx(2e-4, rel=0.05)


def at_rest(seconds=120.0, density=2e-4, accel_density=2e-3, begin=0.0):
    rng, n = np.random.default_rng(3), int(seconds * RATE)
    bias = np.array([0.001, -0.02, 0.003])
    gyro = bias + np.column_stack([white(rng, n, density * k) for k in (1.0, 2.0, 1.0)])
    accel = np.column_stack([white(rng, n, accel_density) for _ in range(3)])
    accel[:, 2] -= STANDARD_GRAVITY + 0.2
    return ImuData(begin + np.arange(1, n + 1) / RATE, gyro, accel)


def test_the_preset_is_of_the_worst_axis_and_widens_turn_on():
    base = imu_preset("tactical")
    spec, notes = preset_from_rest(at_rest(600.0), base, "mine")
    assert spec.gyro_noise_density == pytest.approx(4e-4, rel=0.05)
    assert spec.accel_noise_density == pytest.approx(2e-3, rel=0.05)
    assert spec.gyro_bias_initial_sigma == pytest.approx(0.02, rel=0.01)
    assert spec.accel_bias_initial_sigma == pytest.approx(0.2, rel=0.01)
    assert spec.gyro_scale_ppm == base.gyro_scale_ppm
    assert "upper bound" in spec.source and "'tactical'" in spec.source
    assert len(notes) == 6
    wide, _ = preset_from_rest(at_rest(600.0), imu_preset("consumer"), "mine")
    assert wide.accel_bias_turn_on_mg == imu_preset("consumer").accel_bias_turn_on_mg


def test_a_preset_reads_back(tmp_path):
    spec = dataclasses.replace(
        imu_preset("consumer"), source='a "quoted" \\ source', bias_correlation_time_s=np.inf
    )
    file = tmp_path / "mine.toml"
    file.write_text(preset_toml(spec, ("a note",)))
    assert read_preset(file) == spec


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("gyro_arw_deg_sqrth", "gyro_arw", "gyro_arw"),
        ("gyro_arw_deg_sqrth = 0.6\n", "", "gyro_arw_deg_sqrth is missing"),
        ("= 0.6\n", '= "much"\n', "expected a number, found 'much'"),
        ('name = "consumer"', "name = 3", "name: expected a text, found 3"),
        ("= 0.6\n", "= -0.6\n", "expected a number ≥ 0"),
        ("= 0.6\n", "= = 0.6\n", "not readable as TOML"),
    ],
)
def test_a_damaged_preset_is_refused(tmp_path, old, new, problem):
    file = tmp_path / "mine.toml"
    text = preset_toml(imu_preset("consumer"))
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(NavError, match=problem):
        read_preset(file)


def test_without_the_package_the_remedy_is_named(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "allantools", None)
    with pytest.raises(ConfigError, match=r"pip install 'certnav\[allan\]'"):
        axis_noise(np.ones(100), 0.02)
