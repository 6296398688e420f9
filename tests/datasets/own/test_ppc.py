"""The Precise Positioning Challenge's layout, written by hand from a simulated drive."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from certnav.datasets.great.reader import read_great
from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load, recognise
from certnav.datasets.own.ppc import CITIES
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of, ecef_to_lla
from certnav.filters.errors import DataError
from certnav.filters.rotation import rpy_from_matrix

#: Tokyo's base, and its antenna.
CONFIG = SimulationConfig(
    duration=40.0, seed=2, density="open", base_distance_m=500.0, static_start=10.0,
    origin_deg=CITIES["tokyo"][0], lever_antenna_b=CITIES["tokyo"][1],
)  # fmt: skip
IMU = (
    "GPS TOW (s), GPS Week, Acc X (m/s^2), Acc Y (m/s^2), Acc Z (m/s^2), Ang Rate X (deg/s),  "
    "Ang Rate Y (deg/s),  Ang Rate Z (deg/s)"
)
REFERENCE = (
    "GPS TOW (s), GPS Week, Latitude (deg), Longitude (deg), Ellipsoid Height (m), ECEF X (m), "
    "ECEF Y (m), ECEF Z (m), Roll (deg), Pitch (deg), Heading (deg), East Velocity (m/s), "
    "North Velocity (m/s), Up Velocity (m/s)"
)


def rpy(truth):
    return rpy_from_matrix(np.swapaxes(C_en_of(truth.pos_e), 1, 2) @ truth.C_eb)


@pytest.fixture(scope="module")
def simulation():
    return simulate(CONFIG)


@pytest.fixture(scope="module")
def run(simulation, tmp_path_factory):
    root = tmp_path_factory.mktemp("ppc")
    drive = read_great(simulate_folder(CONFIG, root / "drive"))
    folder = root / "tokyo" / "run1"
    folder.mkdir(parents=True)
    for source, name in (
        (drive.rover_file, "rover.obs"), (drive.base[0], "base.obs"),
        (drive.navigation[0], "base.nav"),
    ):  # fmt: skip
        shutil.copyfile(source, folder / name)
    imu = simulation.imu
    rows = np.column_stack([
        imu.time % 604800.0, imu.time // 604800.0, imu.accel_b, np.degrees(imu.gyro_b)
    ])  # fmt: skip
    np.savetxt(folder / "imu.csv", rows, "%.8f", ",", header=IMU, comments="")
    time = imu.time[20:-20:20]
    truth = simulation.trajectory.kinematics(time, CONFIG.lever_antenna_b)
    lla = ecef_to_lla(truth.pos_e)
    v_n = np.einsum("nji,nj->ni", C_en_of(truth.pos_e), truth.vel_e)
    table = np.column_stack([
        time % 604800.0, time // 604800.0, np.degrees(lla[:, :2]), lla[:, 2], truth.pos_e,
        np.degrees(rpy(truth)), v_n[:, 1], v_n[:, 0], -v_n[:, 2],
    ])  # fmt: skip
    np.savetxt(folder / "reference.csv", table, "%.8f", ",", header=REFERENCE, comments="")
    return folder


def test_a_run_is_read_as_the_readme_says(run, simulation):
    assert recognise(run) == "ppc"
    found = load(run)
    assert found.name == "tokyo-run1" and found.base == (run / "base.obs",)
    np.testing.assert_allclose(found.imu.accel_b, simulation.imu.accel_b, atol=1e-7)
    np.testing.assert_allclose(found.imu.gyro_b, simulation.imu.gyro_b, atol=1e-9)
    np.testing.assert_allclose(found.imu.time, simulation.imu.time, atol=1e-6)
    np.testing.assert_allclose(found.calibration.lever_antenna_b, CITIES["tokyo"][1])
    assert "tokyo" in found.calibration.lever_antenna_source
    truth = simulation.trajectory.kinematics(found.reference.time, CONFIG.lever_antenna_b)
    np.testing.assert_allclose(found.reference.pos_e, truth.pos_e, atol=1e-5)
    np.testing.assert_allclose(found.reference.vel_e, truth.vel_e, atol=1e-5)
    np.testing.assert_allclose(np.sin(found.reference.rpy), np.sin(rpy(truth)), atol=1e-6)
    assert found.reference.point == "antenna" and found.rover_file == run / "rover.obs"


def test_other_columns_and_other_places_are_refused(run, tmp_path):
    other = tmp_path / "run2"
    shutil.copytree(run, other)
    text = (run / "imu.csv").read_text()
    (other / "imu.csv").write_text(text.replace("Acc X", "Ang Rate X", 1))
    with pytest.raises(DataError, match=r"imu\.csv:1: expected the columns gpstow.*found GPS TOW"):
        load(other)
    (other / "imu.csv").write_text(text)
    base = (run / "base.obs").read_text()
    line = next(x for x in base.splitlines() if "APPROX POSITION" in x)
    far = "".join(f"{v:14.4f}" for v in (4.0e6, 1.0e6, 4.85e6)).ljust(60) + "APPROX POSITION XYZ"
    (other / "base.obs").write_text(base.replace(line, far))
    with pytest.raises(DataError, match=r"near none of tokyo, nagoya.*certnav declare"):
        load(other)


def test_axes_that_gravity_contradicts_are_refused(run):
    with pytest.raises(DataError, match=r"expected up = −z"):
        load(run, axes="FLU")
