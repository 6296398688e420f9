"""What a run has learned of lever arm, mounting and delay serves the next run."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import ConfigError, DataError
from certnav.filters.rotation import matrix_from_rpy
from certnav.nav.config_files import from_tables
from certnav.nav.learned import learned, with_calibration
from certnav.nav.pipeline import navigate

DELAY = 0.08


@pytest.fixture(scope="module")
def drive() -> Sequence:
    """Fixes stamped 80 ms early; nothing of the installation is known well."""
    made = simulate(SimulationConfig(seed=3, duration=240.0, density="open"))
    true = made.calibration
    epochs = made.imu.time[0] + np.arange(1.0, 238.0)
    rng = np.random.default_rng(8)
    lever = true.lever_antenna_b
    fixes = fixes_from_truth(made.trajectory, epochs, lever, 0.02, 0.03, rng)
    fixes = dataclasses.replace(fixes, time=fixes.time - DELAY)
    calibration = dataclasses.replace(
        true, lever_antenna_b=lever + np.array([0.5, -0.4, 0.0]), lever_antenna_sigma=0.5,
        mounting_source="", delay_sigma=0.1,
    )  # fmt: skip
    return Sequence("drive", made.imu, calibration, fixes=fixes, reference=made.reference)


def test_the_next_run_starts_where_this_one_ended(drive, tmp_path):
    solution = navigate(drive, from_tables({}))
    file = tmp_path / "van.toml"
    file.write_text(learned(solution), encoding="utf-8")
    again = with_calibration(drive, file)
    found, calibration = solution.installation, again.calibration
    assert found is not None
    np.testing.assert_allclose(calibration.lever_antenna_b, found.antenna.lever_b, atol=6e-4)
    assert calibration.lever_antenna_sigma == pytest.approx(found.antenna.sigma.max(), abs=6e-4)
    np.testing.assert_allclose(calibration.C_bv, found.C_bv, atol=2e-4)
    np.testing.assert_allclose(calibration.lever_vehicle_b, found.C_bv @ found.wheel_v, atol=6e-3)
    assert calibration.mounting_source == "declared in van.toml"
    # GNSS is later than stamped: the IMU goes back by as much, and what is left is known.
    np.testing.assert_allclose(drive.imu.time - again.imu.time, DELAY, atol=0.02)
    second = navigate(again, from_tables({})).installation
    assert second is not None
    assert abs(second.antenna.delay) < 3.0 * calibration.delay_sigma + 0.005
    assert second.antenna.sigma.max() <= calibration.lever_antenna_sigma


def test_what_is_exact_teaches_nothing(drive):
    exact = dataclasses.replace(
        drive.calibration, lever_antenna_sigma=0.0, delay_sigma=0.0, mounting_source="exact"
    )
    solution = navigate(dataclasses.replace(drive, calibration=exact), from_tables({}))
    with pytest.raises(DataError, match="nothing was learned"):
        learned(solution)


@pytest.mark.parametrize(("text", "message"), [
    ("[antena]\nlever_frd_m = [0.0, 0.0, 0.0]", "antenna"),
    ("[antenna]\nlever_frd = [0.0, 0.0, 0.0]", "lever_frd_m"),
    ("[antenna]\nlever_frd_m = [0.0, 0.0]", "lever_frd_m"),
    ("[antenna]\nlever_frd_m = [900.0, 0.0, 0.0]", "metres on a road vehicle"),
    ("[antenna]\nlever_frd_m = [0.9, 0.0, 0.0]\nlever_sigma_m = -1.0", "0 or more"),
    ("antenna = 3", "antenna"),
])  # fmt: skip
def test_a_file_that_cannot_be_is_refused_in_a_line(drive, tmp_path, text, message):
    (tmp_path / "wrong.toml").write_text(text)
    with pytest.raises(ConfigError, match=message) as caught:
        with_calibration(drive, tmp_path / "wrong.toml")
    assert "\n" not in str(caught.value) and "wrong.toml" in str(caught.value)


def test_what_a_file_does_not_say_stays(drive, tmp_path):
    file = tmp_path / "part.toml"
    file.write_text("[vehicle]\nmounting_rpy_deg = [0.0, 2.0, -3.0]\n")
    calibration = with_calibration(drive, file).calibration
    expected = matrix_from_rpy(np.radians([0.0, 2.0, -3.0])).T
    np.testing.assert_allclose(calibration.C_bv, expected)
    assert calibration.mounting_sigma == 0.0
    np.testing.assert_array_equal(calibration.lever_antenna_b, drive.calibration.lever_antenna_b)
