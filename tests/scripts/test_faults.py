"""Faults are those their names say, and some of them all the way through a run."""

import dataclasses

import numpy as np
import pytest

from certnav.filters.earth import C_en_of
from oracles.faults import FAULTS
from oracles.gnss_breaks import jump


@pytest.fixture(scope="module")
def module(script):
    return script("faults")


@pytest.fixture(scope="module")
def drives(module, tmp_path_factory):
    return module.bases(0, tmp_path_factory.mktemp("faults"), {"fixes"}, real=False)


def fault(name, base="fixes"):
    (found,) = (f for f in FAULTS if f.name == name and f.base == base)
    return found


def test_faults_are_told_apart_and_can_be_done():
    assert len({(f.name, f.base) for f in FAULTS}) == len(FAULTS) >= 60
    assert all((f.files is None) != (f.data is None) for f in FAULTS)
    assert all(f.files is None or f.base == "raw" for f in FAULTS)


def test_the_drive_moves_and_turns_where_faults_begin(drives):
    drive = drives["fixes"]
    imu = drive.sequence.imu
    during = (imu.time > drive.begin) & (imu.time < drive.begin + 10.0)
    assert np.degrees(np.abs(imu.gyro_b[during, 2]).sum() * imu.interval) > 45.0


def test_a_jump_is_as_far_and_as_long_as_said(drives):
    drive = drives["fixes"]
    jumped = jump(15.0, 10)(drive.sequence, drive.begin).fixes
    moved = jumped.pos_e - drive.sequence.fixes.pos_e
    east = np.einsum("nji,nj->ni", C_en_of(jumped.pos_e), moved)
    far = np.abs(east[:, 1]) > 1.0
    assert far.sum() == 10 and jumped.time[far][0] == drive.begin
    np.testing.assert_allclose(east[far], np.tile([0.0, 15.0, 0.0], (10, 1)), atol=1e-3)


def test_a_long_jump_is_noted_and_a_short_one_does_no_harm(module, drives, tmp_path):
    drive = drives["fixes"]
    sound = drive.sound
    assert sound.ratio < 1.6 and sound.rms < 1.0
    one = module.broken(fault("15 m jump of the fix, 1 epoch"), drive, tmp_path)
    ten = module.broken(fault("15 m jump of the fix, 10 epochs"), drive, tmp_path)
    many = module.broken(fault("15 m jump of the fix, 40 epochs"), drive, tmp_path)
    assert one.verdict == "harmless" and one.refused == sound.refused + 1
    assert one.largest < sound.largest + 0.1
    assert ten.verdict == "noted" and ten.largest < sound.largest + 1.5  # of 15 m
    assert many.verdict == "noted" and many.largest > 10.0
    assert any("in a row" in line for line in many.lines)
    assert any("is a jump or wrong data, not noise" in line for line in many.lines)


def test_utc_is_refused_with_the_leap_seconds(module, drives, tmp_path):
    drive = drives["fixes"]
    outcome = module.broken(fault("GNSS 18 s early (UTC)"), drive, tmp_path)
    assert outcome.verdict == "refused" and "leap seconds" in outcome.lines[0]
    assert outcome.largest > 50.0  # what --unchecked would have made of it


def test_the_page_keeps_other_sections(module):
    row = module.Row(
        "a|b", "drive", "silent", "1 of 2", "", (1.0, 2.0, 3.0), (1.0, np.nan, np.nan),
        (0.5, 3.0, 4.0), (0.0, 1.0, 2.0), True,
    )  # fmt: skip
    assert row.unnoticed
    assert not dataclasses.replace(row, undetectable="because").unnoticed
    section = module.table([row], 1)
    assert "**silent**" in section and "1.0 → –" in section and "0.5 → 3.0 / 4.0" in section
    page = "# Trust\n\n## Fuzzing\n\nTheirs.\n"
    once = module.with_section(page, section)
    assert once.startswith(page) and module.SECTION in once
    before = f"# Trust\n\n{module.SECTION}\n\nold\n\n## Fuzzing\n\nTheirs.\n"
    twice = module.with_section(before, section)
    assert "old" not in twice and twice.endswith("## Fuzzing\n\nTheirs.\n")
    assert module.with_section(twice, section) == twice
