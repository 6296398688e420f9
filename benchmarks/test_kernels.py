"""Times of what is compiled: ``pip install -e '.[bench]' && pytest benchmarks``.

Not collected with the tests: a time is no property of the code alone. `test_passes.py` times
passes over a whole recording, `scripts/benchmark.py` whole runs, and the peers.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pytest_benchmark")

from certnav.alignment.problem import build_problem
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver.fast_solver import fast_minimum
from certnav.datasets.text.numbers import read_numbers
from certnav.filters import measurements
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ErrorModel
from certnav.filters.measurement_update import compiled, with_filterpy
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream, NavState
from certnav.nav.results.text import row_blocks

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
