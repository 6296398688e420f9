"""Delays against RTKLIB's, and against what physics allows."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets import rtklib
from certnav.datasets.simulation.atmosphere import klobuchar_delay, saastamoinen_delay
from certnav.datasets.simulation.constellation import (
    ION_ALPHA,
    ION_BETA,
    draw_constellation,
    write_navigation,
)
from certnav.filters.earth import ecef_to_lla, lla_to_ecef

TIME = 2129 * 604800.0 + 180600.0


@pytest.fixture(scope="module")
def geometry():
    rng = np.random.default_rng(1)
    n = 300
    pos_e = lla_to_ecef(rng.uniform(-1.2, 1.2, n), rng.uniform(-3, 3, n), rng.uniform(0, 3000, n))
    return pos_e, rng.uniform(0, 2 * np.pi, n), np.radians(rng.uniform(5, 90, n))


def test_ionosphere_is_the_broadcast_model_all_over_the_earth(geometry, tmp_path):
    pos_e, azimuth, elevation = geometry
    file = tmp_path / "brdc.rnx"
    write_navigation(file, draw_constellation(TIME, np.random.default_rng(0)), TIME, TIME)
    ours = klobuchar_delay(
        ION_ALPHA, ION_BETA, TIME % 86400.0, ecef_to_lla(pos_e), azimuth, elevation
    )
    theirs = rtklib.ionosphere_delay([file], TIME, pos_e, azimuth, elevation)
    np.testing.assert_allclose(ours, theirs, atol=1e-6)
    assert ours.min() > 1.4 and np.ptp(ours) > 5.0


def test_troposphere_is_the_standard_atmosphere(geometry):
    pos_e, _, elevation = geometry
    ours = saastamoinen_delay(ecef_to_lla(pos_e), elevation)
    np.testing.assert_allclose(ours, rtklib.troposphere_delay(TIME, pos_e, elevation), atol=1e-6)


def test_zenith_delay_at_sea_level():
    assert saastamoinen_delay(np.array([0.5, 0.0, 0.0]), np.pi / 2) == pytest.approx(2.4, abs=0.1)
