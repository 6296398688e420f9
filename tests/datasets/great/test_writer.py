"""What is written reads back as what was simulated, to the digits printed."""

from __future__ import annotations

import dataclasses
from datetime import datetime

import numpy as np
import pytest

from certnav.datasets.great import writer as great_writer
from certnav.datasets.great.options import GreatOptions
from certnav.datasets.great.reader import read_great
from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import DataError
from certnav.filters.rotation import wrap_angle

CONFIG = SimulationConfig(duration=120.0, seed=4, density="suburb", static_start=10.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return simulate_folder(CONFIG, tmp_path_factory.mktemp("great") / "Dataset_simulated")


@pytest.fixture(scope="module")
def simulation():
    return simulate(CONFIG)


def test_layout_is_that_of_great(folder):
    files = sorted(str(f.relative_to(folder)) for f in folder.rglob("*") if f.is_file())
    assert files == [
        "GNSS/Product/BRDC00SIM_R_20203010000_01D_GN.rnx",
        "GNSS/Rover/SEPT3010.20O",
        "Groundtruth/groundtruth.txt",
        "IMU/MEMS_imu_data.txt",
        "IMU/Tactical_imu_data.txt",
        "great.toml",
    ]
    rover = (folder / "GNSS/Rover/SEPT3010.20O").read_text()
    assert "APPROX POSITION" not in rover and rover.startswith("     3.02")


def test_round_trip_of_the_inertial_data(folder, simulation):
    sequence = read_great(folder)
    assert np.array_equal(sequence.imu.time, simulation.imu.time)
    np.testing.assert_allclose(sequence.imu.gyro_b, simulation.imu.gyro_b, rtol=0, atol=1e-12)
    np.testing.assert_allclose(sequence.imu.accel_b, simulation.imu.accel_b, rtol=0, atol=6e-11)
    lever = sequence.calibration.lever_antenna_b
    np.testing.assert_array_equal(lever, simulation.calibration.lever_antenna_b)
    assert sequence.calibration.imu.name == CONFIG.imu


def test_round_trip_of_the_reference(folder, simulation):
    reference, truth = read_great(folder).reference, simulation.reference
    assert np.array_equal(reference.time, truth.time)
    np.testing.assert_allclose(reference.pos_e, truth.pos_e, rtol=0, atol=6e-5)
    np.testing.assert_allclose(reference.vel_e, truth.vel_e, rtol=0, atol=6e-6)
    assert np.degrees(np.abs(wrap_angle(reference.rpy - truth.rpy))).max() < 6e-8
    assert reference.attitude_frame == "b" and not reference.lever_b.any()


def test_round_trip_of_the_observations(folder, simulation):
    read, truth = read_great(folder).observations, simulation.observations
    order = np.lexsort((read.sat, read.time))
    read = read.take(order)
    assert np.array_equal(read.sat, truth.sat) and np.array_equal(read.time, truth.time)
    np.testing.assert_allclose(read.pseudorange, truth.pseudorange, rtol=0, atol=5.1e-4)
    np.testing.assert_allclose(read.carrier, truth.carrier, rtol=0, atol=5.1e-4)
    # 0.5 mHz of print and 0.25 mHz of RTKLIB's single precision, times 0.19 m
    np.testing.assert_allclose(read.range_rate, truth.range_rate, rtol=0, atol=1.5e-4)
    np.testing.assert_array_equal(read.cn0, truth.cn0)
    np.testing.assert_array_equal(read.loss_of_lock & 1, truth.loss_of_lock)
    assert (read.rejected == "").all()
    # transmission time from a pseudorange that is metres off, at 4 km/s
    np.testing.assert_allclose(read.sat_pos_e, truth.sat_pos_e, atol=2e-3)
    np.testing.assert_allclose(read.sat_vel_e, truth.sat_vel_e, atol=1e-5)
    np.testing.assert_allclose(read.sat_clock, truth.sat_clock, atol=1e-6)


def test_tactical_imu_is_where_great_has_it(tmp_path):
    """Its exact data follow the lever between the IMUs and the vehicle's axes."""
    config = dataclasses.replace(CONFIG, noise=False, duration=60.0, mounting_rpy_deg=(0, 2, -3))
    folder = simulate_folder(config, tmp_path / "sim")
    sequence = read_great(folder, GreatOptions(imu="tactical"))
    s = simulate(config)
    C_bv = s.trajectory.C_bv
    gyro, accel = s.trajectory.imu_means(sequence.imu.time, C_bv @ [-0.32, 0.0, 0.01])
    np.testing.assert_allclose(sequence.imu.gyro_b, gyro @ C_bv, rtol=0, atol=1e-12)
    np.testing.assert_allclose(sequence.imu.accel_b, accel @ C_bv, rtol=0, atol=6e-11)
    assert sequence.imu.interval == pytest.approx(0.005, abs=1e-6)
    assert sequence.calibration.imu.name == "tactical"
    np.testing.assert_allclose(sequence.calibration.lever_antenna_b, [-0.33, -0.05, -0.16])
    # the reference is the MEMS IMU's, with the attitude of vehicle and tactical IMU
    np.testing.assert_allclose(sequence.reference.lever_b, [0.32, 0.0, -0.01])
    C_ev = s.trajectory.C_eb(sequence.reference.time) @ C_bv
    assert np.allclose(C_ev[:, 2, 0], _C_eb(sequence.reference)[:, 2, 0], atol=1e-8)


def _C_eb(reference):
    from certnav.filters.earth import C_en_of
    from certnav.filters.rotation import matrix_from_rpy

    return C_en_of(reference.pos_e) @ matrix_from_rpy(reference.rpy)


def test_other_lever_other_imu_and_the_end_of_a_week(tmp_path):
    config = dataclasses.replace(
        CONFIG,
        duration=60.0,
        start=datetime(2023, 3, 18, 23, 59, 30),
        origin_deg=(-33.9, -70.6, 500.0),
        lever_antenna_b=(0.3, 0.2, -1.1),
        imu="consumer",
    )
    sequence = read_great(simulate_folder(config, tmp_path / "sim"))
    np.testing.assert_array_equal(sequence.calibration.lever_antenna_b, [0.3, 0.2, -1.1])
    assert sequence.calibration.imu.name == "consumer"
    s = simulate(config)
    assert np.array_equal(sequence.imu.time, s.imu.time)
    assert np.array_equal(np.unique(sequence.observations.time), np.unique(s.observations.time))
    assert np.array_equal(sequence.reference.time, s.reference.time)
    np.testing.assert_allclose(sequence.reference.pos_e, s.reference.pos_e, rtol=0, atol=6e-5)


def test_degrees_minutes_seconds_carry_and_keep_their_sign():
    assert great_writer._dms(np.radians(30.0 - 1e-12)) == "30 0 0.000000"
    assert great_writer._dms(np.radians(-0.5)) == "-0 30 0.000000"
    assert great_writer._dms(np.radians(114 + 21 / 60 + 35.981347 / 3600)) == "114 21 35.981347"


def test_existing_folders_are_replaced_only_when_asked_and_ours(tmp_path):
    config = dataclasses.replace(CONFIG, duration=15.0)
    out = simulate_folder(config, tmp_path / "sim")
    with pytest.raises(DataError, match="exists already"):
        simulate_folder(config, out)
    told = []
    simulate_folder(
        dataclasses.replace(config, seed=5),
        out,
        overwrite=True,
        progress=lambda fraction, what: told.append((fraction, what)),
    )
    assert "seed 5" in (out / "great.toml").read_text()
    assert [what for _, what in told] == ["simulating the drive", "writing the folder"]
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("precious")
    with pytest.raises(DataError, match="not a folder the simulator wrote"):
        simulate_folder(config, foreign, overwrite=True)
    assert (foreign / "thesis.txt").read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["foreign", "sim"]


def test_a_failed_run_leaves_nothing(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr(great_writer, "write_navigation", fail)
    with pytest.raises(OSError, match="no space"):
        simulate_folder(dataclasses.replace(CONFIG, duration=15.0), tmp_path / "sim")
    assert not any(tmp_path.iterdir())


def test_a_simulated_folder_never_passes_for_the_sequence_it_is_named_after(tmp_path, folder):
    config = dataclasses.replace(CONFIG, duration=20.0, static_start=5.0)
    named = read_great(simulate_folder(config, tmp_path / "Dataset_campus-01"))
    assert named.name == "Dataset_campus-01-simulated"
    assert any(note.startswith("simulated drive") for note in named.notes)
    assert read_great(folder).name == "Dataset_simulated"


def test_drives_of_a_day_may_share_their_satellites():
    apart = [
        simulate(SimulationConfig(duration=10.0, seed=seed, sky_seed=9, start=start)).ephemerides
        for seed, start in ((1, datetime(2020, 10, 27, 2)), (2, datetime(2020, 10, 27, 9)))
    ]
    first, second = apart
    assert second.toe - first.toe >= 6 * 3600.0
    later = first.shifted(second.toe)
    at = np.array([1000.0])
    there, here = (e.state(np.repeat(at[:, None], 31, axis=1))[0] for e in (second, later))
    np.testing.assert_allclose(there, here, atol=1e-2)
    other = simulate(SimulationConfig(duration=10.0, seed=1, start=datetime(2020, 10, 27, 2)))
    assert not np.allclose(other.ephemerides.m0, first.m0)
