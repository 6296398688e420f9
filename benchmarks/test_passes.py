"""Times of passes over a whole recording: ``pytest benchmarks``; CI runs each once, untimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pytest_benchmark")

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.datasets.text.imu import read_imu_table
from certnav.nav.check.recording import check_sequence
from certnav.velocity.range_rate import DopplerRows
from certnav.velocity.screening import Screening, screen
from certnav.velocity.study.pairs import all_pairs, velocity_errors
from certnav.velocity.study.statistics import binned_rms, heat_map, rejection
from certnav.velocity.vehicle_motion import ForwardMotion


def test_reading_imu_text(benchmark, tmp_path: Path):
    """Forty minutes at 100 Hz, with the checks of the reader."""
    rng = np.random.default_rng(0)
    time = 367140.0 + 0.01 * np.arange(240_000)
    file = tmp_path / "ADIS.txt"
    table = np.column_stack([time, rng.normal(size=(time.size, 6))])
    np.savetxt(file, table, fmt=["%.5f", *6 * ["%.10f"]])
    assert len(benchmark(read_imu_table, file).sow) == time.size


def test_checking_a_recording(benchmark, tmp_path: Path):
    """Five simulated minutes; every run begins with it, so it has to stay below a second."""
    config = SimulationConfig(seed=3, duration=300.0, density="suburb")
    sequence = load(simulate_folder(config, tmp_path / "drive"))
    assert benchmark(check_sequence, sequence)


@pytest.fixture
def offered():
    """Doppler of twelve satellites in as many epochs as a million pairs need."""
    epochs, satellites = 15_152, 12
    rng = np.random.default_rng(5)
    e_e, u_e = (rng.standard_normal((n, 3)) for n in (epochs * satellites, epochs))
    e_e /= np.linalg.norm(e_e, axis=1)[:, None]
    u_e /= np.linalg.norm(u_e, axis=1)[:, None]
    epoch = np.repeat(np.arange(epochs), satellites)
    sigma = rng.uniform(0.03, 0.3, epoch.size)
    z = np.sum(e_e * 10.0 * u_e[epoch], axis=1) + sigma * rng.standard_normal(epoch.size)
    rows = DopplerRows(np.arange(epoch.size), np.full(epoch.size, "G01"), e_e, z, sigma)
    motion = ForwardMotion(u_e, np.zeros((epochs, 3)), np.zeros((3, 3)))
    return rows, epoch, motion, rng.uniform(25, 52, epoch.size), rng.uniform(0, 1.5, epoch.size)


def test_a_million_pairs(benchmark, offered):
    """All that a tuning looks at: pairs, screening, errors, bins, rejection and heat map."""
    motion = offered[2]

    def study():
        pairs = all_pairs(*offered)
        screen(pairs, Screening())
        error = velocity_errors(pairs.speed, pairs.epoch, motion, 10.0 * motion.u_e)
        rejection(pairs.k, error)
        binned_rms(pairs.k, error)
        heat_map(pairs.cn0_mean, pairs.k, error, np.arange(30, 51.0), np.arange(0.05, 1, 0.05))
        return pairs

    assert len(benchmark(study)) == 1_000_032
