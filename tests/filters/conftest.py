"""A driven, turning, tilted state for derivative tests."""

import numpy as np
import pytest

from filters import earth
from filters.rotation import matrix_from_rpy
from filters.strapdown import NavState


@pytest.fixture
def moving_state() -> NavState:
    lat, lon = np.radians(30.53), np.radians(114.36)
    C_en = earth.C_en_at(lat, lon)
    C_eb = C_en @ matrix_from_rpy(np.radians([3.0, -4.0, 137.0]))
    return NavState(1000.0, earth.lla_to_ecef(lat, lon, 25.0), C_eb @ [14.0, 0.3, -0.2], C_eb)
