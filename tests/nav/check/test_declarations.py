"""What is measured other than declared is a line to paste, and pasting it settles the matter."""

from __future__ import annotations

import dataclasses
import re
import tomllib

import numpy as np
import pytest

from certnav.datasets.loading import load
from certnav.datasets.series import Reference
from certnav.filters.rotation import matrix_from_rpy
from certnav.nav.check.declarations import with_declarations
from certnav.nav.check.findings import Finding, Report
from certnav.nav.check.mounting import with_roll_of
from certnav.nav.check.recording import check
from oracles.drives import Drive
from oracles.seeds import UNIT_FORMATS

TIME = "time, IMU and GNSS"


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A drive in one's own files, whose IMU stamps are 0.15 s late."""
    folder = tmp_path_factory.mktemp("own")
    UNIT_FORMATS["own data"](folder, Drive.of(150.0, 50.0, 0.2))
    file = folder / "sequence.toml"
    text = file.read_text()
    assert "time_offset_s" not in text
    file.write_text(text.replace("[imu]\n", "[imu]\ntime_offset_s = 0.15\n", 1))
    return folder


def lines(report: Report, subject: str) -> str:
    (found,) = (f for f in report.findings if f.subject == subject)
    return found.declare


def test_pasting_the_line_settles_it(own):
    report = check(own)
    declare = lines(report, TIME)
    value = tomllib.loads(declare)["imu"]["time_offset_s"]
    assert value == pytest.approx(0.0, abs=0.04)
    text = report.text()
    pasted = text[text.index("lines to paste") : text.index("To declare or to do")]
    assert f"time_offset_s = {value:.3f}" in pasted
    file = own / "sequence.toml"
    before = file.read_text()
    file.write_text(re.sub(r"time_offset_s = .*", f"time_offset_s = {value}", before, count=1))
    settled = check(own)
    file.write_text(before)
    assert lines(settled, TIME) == ""
    assert settled.as_dict()["findings"][0]["declare"] == ""


@pytest.fixture
def sequence(own):
    return load(own)


def time(lag: float, severity: str = "note") -> Finding:
    return Finding(severity, TIME, "x", numbers={"offset_s": lag, "offset_sigma_s": 0.028})


def declared(finding, sequence, own, **options):
    ((found),) = with_declarations([finding], sequence, own, options)
    return found.declare


def test_only_what_is_beyond_its_sigma_is_proposed(sequence, own):
    assert declared(time(-0.080), sequence, own) == ""
    line = declared(time(-0.120), sequence, own)
    assert tomllib.loads(line)["imu"]["time_offset_s"] == pytest.approx(0.15 + 0.12)
    assert declared(time(-18.0, "fatal"), sequence, own) == ""


def test_each_format_has_its_own_key_or_says_that_it_has_none(sequence, own):
    option = declared(time(0.1), sequence, own, format="rtklibexplorer", imu_lag=0.12)
    assert tomllib.loads(option) == {"data": {"imu_lag": pytest.approx(0.22)}}
    default = declared(time(0.1), sequence, own, format="tumsat")
    assert tomllib.loads(default) == {"data": {"imu_lag": pytest.approx(0.1)}}
    none = declared(time(0.1), sequence, own, format="oakville")
    assert "no key" in none and "subtract 0.100 s" in none
    assert tomllib.loads(none) == {}


def test_mounting_keeps_the_declared_roll(sequence, own):
    C_bv = matrix_from_rpy(np.radians([1.0, 2.0, 3.0])).T
    turned = dataclasses.replace(
        sequence, calibration=dataclasses.replace(sequence.calibration, C_bv=C_bv)
    )
    numbers = {"yaw_deg": 3.1, "yaw_sigma_deg": 0.2, "pitch_deg": 2.1, "pitch_sigma_deg": 0.1}
    same = Finding("note", "mounting", "x", numbers=numbers)
    assert declared(same, turned, own) == ""
    other = dataclasses.replace(same, numbers={**numbers, "pitch_deg": -1.0})
    line = declared(other, turned, own)
    found = tomllib.loads(line)["vehicle"]["mounting_rpy_deg"]
    # roll and yaw turn 3° of pitch into tenths of the others
    np.testing.assert_allclose(found, [1.0, -1.0, 3.1], atol=0.2)
    great = declared(other, turned, own, format="great")
    np.testing.assert_allclose(tomllib.loads(great)["mounting_rpy_deg"], found)


@pytest.mark.parametrize("rpy", [(8.0, -12.0, -40.0), (20.0, 5.0, 60.0), (0.0, 3.0, -2.0)])
def test_pitch_and_yaw_of_a_rolled_imu_are_what_a_declaration_holds(rpy):
    """Forward and the vertical alone: what a drive shows of any mounting."""
    C_bv = matrix_from_rpy(np.radians(rpy)).T
    forward_b = C_bv[:, 0]  # and as pitch and yaw without roll: C_bv = R_z(yaw) R_y(pitch)
    yaw, pitch = np.arctan2(forward_b[1], forward_b[0]), -np.arcsin(forward_b[2])
    found = with_roll_of(C_bv, -np.degrees(pitch), -np.degrees(yaw))
    np.testing.assert_allclose(found, rpy, atol=1e-9)


def test_a_lever_arm_is_proposed_where_it_is_unknown_and_the_reference_is_of_the_imu(sequence, own):
    numbers = {"lever_forward_m": 1.2, "lever_right_m": -0.3, "lever_sigma_m": 0.1}
    finding = Finding("note", "lever arm", "x", numbers=numbers)
    known = dataclasses.replace(sequence.calibration, lever_antenna_sigma=0.0)
    assert declared(finding, dataclasses.replace(sequence, calibration=known), own) == ""
    unknown = dataclasses.replace(
        known, lever_antenna_sigma=0.5, lever_antenna_b=np.array([0.0, 0.0, -1.0])
    )
    f, zero = sequence.fixes, np.zeros(3)
    at_imu = Reference(f.time, f.pos_e, f.vel_e, f.pos_e * np.nan, zero, "imu", "made")
    of_imu = dataclasses.replace(sequence, calibration=unknown, reference=at_imu)
    line = declared(finding, of_imu, own)
    assert tomllib.loads(line)["antenna"]["lever_frd_m"] == [1.2, -0.3, -1.0]
    at_antenna = dataclasses.replace(at_imu, point="antenna")
    elsewhere = dataclasses.replace(of_imu, reference=at_antenna)
    assert declared(finding, elsewhere, own) == ""


def test_it_is_not_listed_among_what_is_in_order():
    measured = Finding("note", "mounting", "pitch −3°", declare="[vehicle]\nkey = 1")
    doubt = Finding("doubtful", TIME, "0.1 s late", "subtract it", declare="[imu]\nt = 2")
    text = Report("drive", (), (doubt, measured, Finding("note", "gyro", "fine"))).text()
    in_order = text[text.index("in order") : text.index("Measured, and other")]
    assert "gyro" in in_order and "mounting" not in in_order
    pasted = text[text.index("Measured, and other") : text.index("To declare or to do")]
    assert "mounting: pitch −3°" in pasted and "key = 1" in pasted and "t = 2" in pasted
    assert text.index("0.1 s late") < text.index("in order")
