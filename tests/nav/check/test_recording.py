"""`check`: sound recordings raise no alarm, broken copies are named in plain words.

The faults are `oracles.broken_copies`; ``scripts/broken_copies.py`` goes through all of them, here
are one or two of each kind.
"""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from certnav.datasets.loading import load
from certnav.nav.check.recording import check, check_sequence
from oracles import broken_copies, recordings
from oracles.recordings import REAL, SIMULATED

FAULTS = {(f.base, f.name): f for f in broken_copies.FAULTS}
SIMULATED_SUBSET = [
    "x and y swapped in both triads (left-handed axes)",
    "IMU in UTC, declared GPS time (18 s)",
    "IMU 0.1 s late",
    "Doppler mirrored",
    "no Doppler (dropped in conversion)",
    "gyro frozen for 8 s",
    "lever arm with the opposite sign",
    "reference shifted by 3 m to the east",
]
REAL_SUBSET = [
    ("Oakville", "right axis reversed (left-handed)"),
    ("Oakville", "latitude and longitude swapped"),
    ("comma2k19", "IMU 18 s late"),
    ("comma2k19", "Doppler in Hz, declared m/s"),
    ("rtklibexplorer", "accelerometer in m/s², declared g"),
]


@pytest.fixture(scope="module")
def work(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("broken")
    recordings.simulate_base(folder / "base")
    return folder


def _alarms(report) -> list[str]:
    return [f.line for f in report.findings if f.severity != "note"]


def test_sound_simulation_raises_no_alarm(work):
    report = check(work / "base")
    assert _alarms(report) == []
    by_subject = {f.subject: f.numbers for f in report.findings}
    assert by_subject["gyro"]["yaw_over_course"] == pytest.approx(1.0, abs=0.02)
    assert abs(by_subject["time, IMU and GNSS"]["offset_s"]) < 0.05
    # the simulator's antenna: 0.65 m behind the IMU, 0.05 m left
    assert by_subject["lever arm"]["lever_forward_m"] == pytest.approx(-0.65, abs=0.25)


@pytest.mark.parametrize("name", SIMULATED_SUBSET)
def test_fault_in_simulation_is_named(work, name):
    fault = FAULTS[SIMULATED, name]
    report = broken_copies.broken(fault, work)
    assert broken_copies.named(fault, report), _alarms(report)


@pytest.mark.parametrize("name", list(REAL))
def test_sound_recording_raises_no_alarm(data_dir, name):
    assert _alarms(check(data_dir / REAL[name])) == []


@pytest.mark.parametrize(("base", "name"), REAL_SUBSET)
def test_fault_in_real_recording_is_named(data_dir, work, monkeypatch, base, name):
    monkeypatch.setattr(recordings, "DATA", data_dir)
    fault = FAULTS[base, name]
    report = broken_copies.broken(fault, work)
    assert broken_copies.named(fault, report), _alarms(report)


def test_what_cannot_be_seen_raises_no_alarm(data_dir, work, monkeypatch):
    monkeypatch.setattr(recordings, "DATA", data_dir)
    report = broken_copies.broken(FAULTS["comma2k19", "yaw gyro with the opposite sign"], work)
    assert _alarms(report) == []
    assert any("cannot be told" in f.found for f in report.findings if f.subject == "gyro")


@pytest.mark.parametrize(("late", "sign"), [(0.2, 1.0), (-0.2, -1.0)])
def test_offset_has_the_sign_of_late_stamps(work, late, sign):
    sequence = load(work / "base")
    imu = sequence.imu
    moved = type(imu)(imu.time + late, imu.gyro_b, imu.accel_b)
    found = check_sequence(type(sequence)(**{**vars(sequence), "imu": moved}))
    line = next(f for f in found if f.subject == "time, IMU and GNSS")
    assert line.severity == "doubtful"
    assert line.numbers["offset_s"] == pytest.approx(late, abs=0.05)
    assert ("late" if sign > 0 else "early") in line.found


def test_lags_of_gyro_and_accelerometer_are_kept_apart(work):
    """A gyro 0.27 s behind its accelerometer: said, and no fault of its scale."""
    sequence = load(work / "base")
    imu = sequence.imu
    slow = np.column_stack([np.interp(imu.time - 0.27, imu.time, g) for g in imu.gyro_b.T])
    apart = dataclasses.replace(sequence, imu=type(imu)(imu.time, slow, imu.accel_b))
    lines = {}
    for name, one in (("sound", sequence), ("apart", apart)):
        found = check_sequence(one)
        lines[name] = next(f for f in found if f.subject == "time, IMU and GNSS")
        (gyro,) = (f.numbers for f in found if f.subject == "gyro")
        assert abs(gyro["yaw_over_course"] - 1.0) < 3.0 * gyro["sigma"] < 0.06
    for key, moved in (("turn_rate_lag_s", 0.27), ("speed_lag_s", 0.0)):
        shift = lines["apart"].numbers[key] - lines["sound"].numbers[key]
        assert shift == pytest.approx(moved, abs=0.03)
    assert "accelerometer: speed" in lines["apart"].found
    assert "gyro: turn rate" in lines["apart"].found


def test_one_fault_is_one_fatal_finding(work):
    """A slip of time must not be found again as wrong axes or a wrong unit."""
    report = broken_copies.broken(FAULTS[SIMULATED, "IMU in UTC, declared GPS time (18 s)"], work)
    assert [f.subject for f in report.of("fatal")] == ["time, IMU and GNSS"]


def test_missing_folder_is_a_finding_not_an_exception(tmp_path):
    report = check(tmp_path / "nowhere")
    assert not report.navigable
    assert "no such file or folder" in report.findings[0].found
    assert report.findings[0].remedy == "check the path"


def test_unknown_option_is_a_finding(work):
    report = check(work / "base", {"levr": "figure"})
    assert "lever" in report.findings[0].remedy


def test_report_is_strict_json_and_one_page(work):
    report = check(work / "base")
    json.dumps(report.as_dict(), allow_nan=False)
    assert len(report.text().splitlines()) < 60
