"""`certnav allan` makes a preset of a log, and a run takes it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.allan import read_preset
from certnav.datasets.sequence import Calibration
from certnav.filters.sensors import imu_preset
from certnav.nav.commands.cli import main
from certnav.nav.config import FilterConfig
from certnav.nav.engine.model import imu_spec

pytest.importorskip("allantools")


@pytest.fixture
def log(tmp_path):
    """Ten minutes of an IMU text file in deg/s and g."""
    rng, n = np.random.default_rng(5), 30000
    gyro = np.degrees(2e-4 * np.sqrt(50.0)) * rng.standard_normal((n, 3))
    accel = 2e-3 * np.sqrt(50.0) / 9.80665 * rng.standard_normal((n, 3)) + [0.0, 0.0, 1.0]
    table = np.column_stack([1000.0 + 0.02 * np.arange(n), gyro, accel])
    file = tmp_path / "imu.txt"
    np.savetxt(file, table, fmt="%.9f")
    return file


def test_a_preset_is_written_and_a_run_takes_it(log, tmp_path, capsys):
    out = tmp_path / "mine.toml"
    command = ["allan", str(log), "--gyro-unit", "deg/s", "--accel-unit", "g", "--out", str(out)]
    assert main(command) == 0
    assert f"filter.imu={out}" in capsys.readouterr().out
    made = read_preset(out)
    assert made.name == "mine"
    assert made.gyro_noise_density == pytest.approx(2e-4, rel=0.05)
    assert made.accel_noise_density == pytest.approx(2e-3, rel=0.05)
    calibration = Calibration(imu_preset("tactical"), np.zeros(3), "test")
    config = FilterConfig(imu=str(out))
    assert imu_spec(calibration, config) == made
    assert imu_spec(calibration, dataclasses.replace(config, imu="consumer")).name == "consumer"
    assert main(command) == 1  # it is there already
    assert "exists already" in capsys.readouterr().err


def test_on_screen_and_what_is_missing_is_named(log, tmp_path, capsys):
    assert main(["allan", str(log)]) == 1
    assert "give --gyro-unit" in capsys.readouterr().err
    assert main(["allan", str(log), "--gyro-unit", "deg/s", "--out", str(tmp_path / "a.txt")]) == 1
    assert "expected a file *.toml" in capsys.readouterr().err
    assert main(["allan", str(log), "--gyro-unit", "deg/s", "--accel-unit", "g"]) == 0
    printed = capsys.readouterr().out
    assert 'name = "measured"' in printed and "# gyro x:" in printed


def test_a_missing_preset_is_one_line(tmp_path):
    from certnav.filters.errors import DataError

    calibration = Calibration(imu_preset("tactical"), np.zeros(3), "test")
    with pytest.raises(DataError, match="no such file"):
        imu_spec(calibration, FilterConfig(imu=str(tmp_path / "nowhere.toml")))
