"""A drive without noise whose receiver clock is far off, as a window at its biases."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest

from certnav.alignment.in_motion.rows import InertialDoppler, inertial_doppler
from certnav.datasets.simulation.simulator import Simulation, SimulationConfig, simulate
from certnav.filters.strapdown import InertialStream


class Drive(NamedTuple):
    simulation: Simulation
    stream: InertialStream
    doppler: InertialDoppler
    lever_b: np.ndarray


@pytest.fixture(scope="session")
def noise_free():
    """Traffic with a turn, 45 s of it, and a clock drift of 150 m/s that grows by 0.02 m/s²."""
    simulation = simulate(
        SimulationConfig(
            seed=3, duration=45.0, static_start=0.0, moving_start=True, density="open",
            noise=False, receiver_clock=False, atmosphere=False,
        )
    )  # fmt: skip
    imu, observations = simulation.imu, simulation.observations
    observations = observations.mark(observations.elevation < np.radians(10.0), "low")
    drift = 150.0 + 0.02 * (observations.time - observations.time[0])
    observations = observations.with_columns(range_rate=observations.range_rate + drift)
    lever_b = simulation.calibration.lever_antenna_b
    pos_e = simulation.trajectory.pos_e(observations.time, lever_b)
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    return Drive(simulation, stream, inertial_doppler(observations, pos_e), lever_b)
