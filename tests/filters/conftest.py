"""A driven, turning, tilted state for derivative tests, and a drive for the filter."""

import numpy as np
import pytest

from certnav.datasets.gpstime import from_week_sow
from certnav.datasets.simulation.streets import RouteConfig, drive
from certnav.datasets.simulation.trajectory import Trajectory
from certnav.filters import earth
from certnav.filters.rotation import matrix_from_rpy
from certnav.filters.strapdown import NavState


@pytest.fixture
def moving_state() -> NavState:
    lat, lon = np.radians(30.53), np.radians(114.36)
    C_en = earth.C_en_at(lat, lon)
    C_eb = C_en @ matrix_from_rpy(np.radians([3.0, -4.0, 137.0]))
    return NavState(1000.0, earth.lla_to_ecef(lat, lon, 25.0), C_eb @ [14.0, 0.3, -0.2], C_eb)


@pytest.fixture(scope="session")
def city_drive() -> Trajectory:
    """Ten minutes of city driving: stops, turns, hills; the IMU sits ahead of the rear axle."""
    route = drive(RouteConfig(duration=610.0, static_start=20.0), np.random.default_rng(42))
    return Trajectory(
        from_week_sow(2129, 180000.0),
        route.time,
        route.pos_t,
        route.rpy,
        (np.radians(30.53), np.radians(114.36), 25.0),
        lever_imu_v=(1.2, 0.1, -0.8),
    )
