"""The mounting that a check measures is the one the simulator tilted the IMU by."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.nav.check.mounting import mounting_findings, with_coarse_mounting
from certnav.nav.check.recording import check, check_sequence
from certnav.nav.config_files import from_tables
from certnav.nav.pipeline import navigate

TILTS = [(2.0, -3.0, 5.0), (-1.0, 2.0, -4.0), (0.5, 4.0, 1.0)]


def undeclared(simulation):
    """The recording as one has it whose owner does not know how the IMU is turned."""
    sequence = simulation.sequence()
    calibration = dataclasses.replace(
        sequence.calibration, C_bv=np.eye(3), lever_vehicle_b=np.zeros(3), mounting_source=""
    )
    return dataclasses.replace(sequence, calibration=calibration, reference=None, odometer=None)


def declared_as(simulation):
    """Yaw and pitch [deg] that put the IMU's axes where they are, without roll."""
    x, y, z = simulation.trajectory.C_bv[:, 0]
    return np.degrees([-np.arctan2(y, x), np.arcsin(z)])


@pytest.fixture(scope="module", params=range(len(TILTS)), ids=str)
def tilted(request):
    number = request.param
    return simulate(
        SimulationConfig(
            seed=number, duration=240.0, density="suburb", mounting_rpy_deg=TILTS[number]
        )
    )


def test_an_unknown_mounting_is_measured_within_its_sigma(tilted):
    (found,) = mounting_findings(undeclared(tilted))
    n = found.numbers
    error = np.array([n["yaw_deg"], n["pitch_deg"]]) - declared_as(tilted)
    sigma = np.array([n["yaw_sigma_deg"], n["pitch_sigma_deg"]])
    assert np.all(np.abs(error) < 3.5 * sigma), (error, sigma)
    assert np.all(sigma < [0.4, 0.1]) and np.all(sigma > 0.0)
    assert found.severity == "note" and not found.remedy
    assert f"yaw {n['yaw_deg']:+.2f} ± {n['yaw_sigma_deg']:.2f}°" in found.found
    assert f"pitch {n['pitch_deg']:+.2f} ± {n['pitch_sigma_deg']:.2f}°" in found.found


def test_what_was_declared_does_not_show_in_what_is_measured(tilted):
    """Nothing the recording says of the vehicle may be what it is measured with."""
    sequence = undeclared(tilted)
    wrong = dataclasses.replace(
        sequence.calibration, C_bv=tilted.trajectory.C_bv, mounting_source="declared"
    )
    (one,), (other,) = (
        mounting_findings(s)
        for s in (sequence, dataclasses.replace(sequence, calibration=wrong))
    )  # fmt: skip
    for key in ("yaw_deg", "pitch_deg"):
        assert one.numbers[key] == pytest.approx(other.numbers[key], abs=0.05)


def test_without_turns_or_with_faults_nothing_is_said(tilted, tmp_path):
    sequence = undeclared(tilted)
    start = sequence.span[0]
    assert mounting_findings(sequence.between(start, start + 25.0)) == []  # it stands
    rough = sequence.observations.with_columns(
        range_rate=np.full(len(sequence.observations), np.nan)
    )
    assert mounting_findings(dataclasses.replace(sequence, observations=rough)) == []


def test_the_command_says_it_and_a_run_does_not_wait_for_it(tmp_path):
    config = SimulationConfig(
        name="m", seed=3, duration=240.0, density="suburb", mounting_rpy_deg=(0.0, -2.0, 3.0)
    )
    folder = simulate_folder(config, tmp_path / "m")
    (found,) = (f for f in check(folder).findings if f.subject == "mounting")
    assert found.numbers["yaw_deg"] == pytest.approx(3.0, abs=0.6)
    assert found.numbers["pitch_deg"] == pytest.approx(-2.0, abs=0.2)
    assert not [f for f in check_sequence(simulate(config).sequence()) if f.subject == "mounting"]
    file = folder / "IMU" / "MEMS_imu_data.txt"
    rows = np.loadtxt(file, skiprows=1)
    rows[:, 0] += 1.0  # late by a second: attitude and velocity do not belong together
    np.savetxt(file, rows, fmt=["%.5f", *6 * ["%.8f"]], header="Time", comments="")
    late = check(folder)
    assert any(f.subject == "time, IMU and GNSS" for f in late.of("fatal"))
    assert not [f for f in late.findings if f.subject == "mounting"]


def test_a_run_begins_where_an_imu_lies_that_nobody_has_declared():
    made = simulate(
        SimulationConfig(
            seed=7, duration=180.0, density="open", mounting_rpy_deg=(4.0, -18.0, 35.0)
        )
    )
    epochs = made.imu.time[0] + np.arange(1.0, 178.0)
    lever, rng = made.calibration.lever_antenna_b, np.random.default_rng(4)
    fixes = fixes_from_truth(made.trajectory, epochs, lever, 0.5, 0.05, rng)
    sequence = dataclasses.replace(undeclared(made), observations=None, fixes=fixes)
    measured, (note,) = with_coarse_mounting(sequence, check_sequence(sequence))
    true = made.trajectory.C_bv
    off = np.degrees(np.arccos(np.clip((measured.calibration.C_bv * true).sum(axis=0), -1.0, 1.0)))
    assert off.max() < 2.0 * np.degrees(measured.calibration.mounting_sigma), off
    assert "mounting not declared: measured" in note.text and "mounting_rpy_deg" in note.text
    found = navigate(measured, from_tables({})).installation
    assert found is not None and not found.off
    miss = np.degrees(found.pitch_yaw) - declared_as(made)[::-1]
    assert np.all(np.abs(miss) < 4.0 * np.degrees(found.pitch_yaw_sigma)), miss


def test_what_is_square_or_declared_is_not_measured_coarsely(tilted):
    sequence = undeclared(tilted)
    findings = check_sequence(sequence)
    assert with_coarse_mounting(sequence, findings) == (sequence, ())
    C_bv = np.diag([-1.0, -1.0, 1.0])
    declared = dataclasses.replace(sequence.calibration, C_bv=C_bv, mounting_source="the owner")
    sequence = dataclasses.replace(sequence, calibration=declared)
    assert with_coarse_mounting(sequence, findings) == (sequence, ())
