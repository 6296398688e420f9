"""Which errors a run estimates."""

import pytest

from certnav.filters.sensors import imu_preset
from certnav.nav.config_files import from_tables
from certnav.nav.engine.model import error_model, imu_spec
from oracles import rigs

CALIBRATION = rigs.calibration()


def test_the_configured_imu_replaces_the_recordings():
    assert imu_spec(CALIBRATION, from_tables({}).filter) is rigs.IMU
    tactical = from_tables({"filter": {"imu": "tactical"}})
    assert imu_spec(CALIBRATION, tactical.filter) == imu_preset("tactical")
    assert error_model(CALIBRATION, tactical).imu == imu_preset("tactical")


@pytest.mark.parametrize(("what", "size"), [
    ({}, 19), ({"odometer": True}, 20), ({"doppler": False}, 18), ({"shared": False}, 16),
    ({"doppler": False, "shared": False}, 15),
])  # fmt: skip
def test_only_what_will_be_measured_is_a_state(what, size):
    """15, the clock's drift, three of a shared position error, and an odometer's scale."""
    assert error_model(CALIBRATION, from_tables({}), **what).size == size


def test_the_rest_is_as_configured():
    config = from_tables({
        "filter": {"states": 21, "bias_model": "gauss-markov"},
        "gnss": {"clock_walk_mps": 0.3, "position_correlation_s": 25.0},
    })  # fmt: skip
    model = error_model(CALIBRATION, config)
    assert (model.states, model.bias_model, model.size) == (21, "gauss-markov", 25)
    assert (model.clock_walk, model.fix_correlation, model.odometer) == (0.3, 25.0, False)
