"""Times of what the filter does at a sample, a measurement and an epoch: ``pytest benchmarks``.

Not collected with the tests: a time is no property of the code alone; CI runs each once with
``--benchmark-disable``. `test_passes.py` times passes over a whole recording,
`scripts/benchmark.py` whole runs and the peers, `scripts/profile_commands.py` stages of commands.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pytest_benchmark")

from certnav.alignment.problem import build_problem
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver.fast_solver import fast_minimum
from certnav.alignment.velocity_matching import heading_offset
from certnav.datasets.text.numbers import read_numbers
from certnav.filters import measurements
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ErrorModel
from certnav.filters.measurement_update import compiled, with_filterpy
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream, NavState
from certnav.nav.results.text import row_blocks
from certnav.velocity.range_rate import line_of_sight

SAMPLES, RATE = 20_000, 200.0


def new_filter(states: int) -> ErrorStateFilter:
    """A filter at rest on the equator, with room for all rows."""
    rng = np.random.default_rng(1)
    time = np.arange(1, SAMPLES + 1) / RATE
    gyro_b = 1e-3 * rng.standard_normal((SAMPLES, 3))
    accel_b = 0.01 * rng.standard_normal((SAMPLES, 3)) + [-9.8, 0.0, 0.0]
    model = ErrorModel(imu_preset("adis16470"), states)
    P = model.initial_covariance(np.eye(3), 0.01 * np.eye(3), 1e-4 * np.eye(3))
    state = NavState(0.001, [6378137.0, 0.0, 0.0], np.zeros(3), np.eye(3))
    kalman = ErrorStateFilter(model, InertialStream(time, gyro_b, accel_b), state, P)
    kalman._reserve(kalman.stream.end)
    return kalman


@pytest.mark.parametrize("states", [15, 21])
def test_time_update(benchmark, states):
    """20 000 samples with covariance and a recorded row at each."""
    benchmark.pedantic(
        lambda kalman: kalman.propagate(kalman.stream.end),
        setup=lambda: ((new_filter(states),), {}),
        rounds=10,
        warmup_rounds=1,
    )


@pytest.mark.parametrize("update", [compiled, with_filterpy], ids=lambda f: f.__name__)
def test_measurement_update(benchmark, update):
    kalman = new_filter(15)
    m = measurements.position(kalman.state, 15, kalman.pos_e + 1.0, np.eye(3), [0.5, 0.0, -1.0])
    benchmark(update, kalman.P, m)


def test_lines_of_sight_of_an_epoch(benchmark):
    """Twelve satellites, as every pass over the data asks at every epoch."""
    rng = np.random.default_rng(7)
    sat_pos_e = 2.6e7 * rng.standard_normal((12, 3)) / 3**0.5
    sight = benchmark(line_of_sight, [6378137.0, 0.0, 0.0], sat_pos_e, np.zeros((12, 3)))
    np.testing.assert_allclose(np.linalg.norm(sight.e_e, axis=1), 1.0, atol=1e-12)


def test_heading_from_velocities(benchmark):
    """Half a minute at 1 Hz, as the watch over the heading asks every 2.5 s."""
    time = np.arange(30.0)
    vel_n = 10.0 * np.column_stack([np.cos(0.1 * time), np.sin(0.1 * time)])
    felt_n, C_nb = vel_n - vel_n[0], np.broadcast_to(np.eye(3), (30, 3, 3))
    found = benchmark(heading_offset, time, vel_n, np.full(30, 0.05), felt_n, C_nb)
    assert abs(found.offset) < 1e-3


def test_certified_solve(benchmark):
    window = simulate_window(np.random.default_rng(3), 6, "3d", sigma=0.05)
    benchmark(fast_minimum, build_problem(window.rows).Q)


def test_reading_numbers(benchmark, tmp_path: Path):
    """20 000 lines of seven columns."""
    file = tmp_path / "imu.txt"
    table = np.random.default_rng(5).standard_normal((SAMPLES, 7))
    file.write_text("".join(" ".join(f"{x:.12e}" for x in row) + "\n" for row in table))
    assert benchmark(read_numbers, file, 7, True) is not None


def test_writing_numbers(benchmark):
    """20 000 rows of twelve columns."""
    table = 100.0 * np.random.default_rng(6).standard_normal((SAMPLES, 12))
    template = ",".join(["%.6f"] * 6 + ["%.5g"] * 6)
    benchmark(lambda: sum(map(len, row_blocks(template, table))))
