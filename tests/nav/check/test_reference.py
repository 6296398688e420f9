"""Reference against GNSS: lever arm, shift, time and heading are told apart and recovered."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.observations import GnssFixes
from certnav.datasets.sequence import Calibration, Sequence
from certnav.datasets.series import ImuData, Reference
from certnav.filters.earth import C_en_at, lla_to_ecef
from certnav.filters.rotation import matrix_from_rpy
from certnav.filters.sensors import imu_preset
from certnav.nav.check.reference import reference_findings
from certnav.velocity.tracks import tracks

ORIGIN = np.radians([48.0, 11.0])
LEVER = np.array([-0.65, -0.05, -0.15])


def drive(lever=LEVER, shift=(0.0, 0.0, 0.0), late: float = 0.0, sigma: float = 0.0) -> Sequence:
    """Return a drive with a reference of the IMU and antenna positions, faults in the reference."""
    t = np.arange(0.0, 300.0, 0.25)
    w = 0.06
    C_en = C_en_at(*ORIGIN)

    def motion(t):
        moved = np.column_stack([200 * np.sin(w * t), 150 * np.sin(2 * w * t), 0 * t])
        vel = np.column_stack([200 * w * np.cos(w * t), 300 * w * np.cos(2 * w * t), 0 * t])
        heading = np.arctan2(vel[:, 1], vel[:, 0])
        rate = np.gradient(np.unwrap(heading), t)
        return moved, vel, heading, rate

    moved, vel, heading, rate = motion(t)
    zero = np.zeros_like(t)
    C_nb = matrix_from_rpy(np.column_stack([zero, zero, heading]))
    origin_e = lla_to_ecef(*ORIGIN, 500.0)
    noise = np.random.default_rng(0).normal(0.0, sigma, (t.size, 3)) if sigma else 0.0
    antenna = moved + C_nb @ LEVER + noise
    omega = np.column_stack([zero, zero, rate])
    antenna_vel = vel + np.einsum("nij,nj->ni", C_nb, np.cross(omega, LEVER))
    cov = np.tile(np.eye(3), (t.size, 1, 1))
    return Sequence(
        name="drive",
        imu=ImuData(t, np.zeros((t.size, 3)), np.tile([0.0, 0, -9.8], (t.size, 1))),
        calibration=Calibration(imu_preset("adis16470"), np.asarray(lever), "declared"),
        fixes=GnssFixes(
            t, origin_e + antenna @ C_en.T, cov, antenna_vel @ C_en.T, 0.01 * cov,
            np.full(t.size, 9), np.full(t.size, "fixed"),
        ),
        reference=Reference(
            t + late, origin_e + (moved + shift) @ C_en.T, vel @ C_en.T,
            np.column_stack([zero, zero, heading]), np.zeros(3), "imu", "made up",
        ),
    )  # fmt: skip


def judged(sequence: Sequence):
    fixes = sequence.fixes
    found = reference_findings(sequence, tracks(sequence), (fixes.time, fixes.pos_e))
    return {f.subject: f for f in found}


def alarms(found) -> set[str]:
    return {subject for subject, f in found.items() if f.severity != "note"}


def test_lever_arm_is_recovered_and_nothing_doubted():
    found = judged(drive())
    assert alarms(found) == set()
    numbers = found["lever arm"].numbers
    assert numbers["lever_forward_m"] == pytest.approx(LEVER[0], abs=0.02)
    assert numbers["lever_right_m"] == pytest.approx(LEVER[1], abs=0.02)
    assert numbers["shift_north_m"] == pytest.approx(0.0, abs=0.02)


def test_opposite_lever_arm_is_called_so():
    found = judged(drive(lever=-LEVER, sigma=0.3))
    assert alarms(found) == {"lever arm"}
    assert "the opposite" in found["lever arm"].found and "reverse" in found["lever arm"].remedy


def test_shift_is_not_taken_for_a_lever_arm():
    found = judged(drive(shift=(0.0, 3.0, 0.0), sigma=0.3))
    assert alarms(found) == {"reference position"}
    assert "+3.0 m east" in found["reference position"].found


def test_height_above_the_geoid():
    found = judged(drive(shift=(0.0, 0.0, 47.0)))
    assert alarms(found) == {"reference height"}
    assert "-47.0 m" in found["reference height"].found


@pytest.mark.parametrize(("late", "word"), [(0.3, "late"), (-18.0, "early.*leap seconds")])
def test_time_offset_is_found_and_taken_out_first(late, word):
    found = judged(drive(late=late, sigma=0.1))
    assert alarms(found) == {"time, reference and GNSS"}
    line = found["time, reference and GNSS"]
    assert line.numbers["offset_s"] == pytest.approx(late, abs=0.02)
    assert word.split(".*")[0] in line.found


def test_another_place():
    found = judged(drive(shift=(5000.0, 0.0, 0.0)))
    assert alarms(found) == {"reference position"}
    assert "5.0 km" in found["reference position"].found


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        (lambda psi: np.pi / 2 - psi, "ENU yaw"),
        (lambda psi: -psi, "counter-clockwise"),
        (lambda psi: psi + np.pi, "opposite"),
        (np.radians, "in radians, read as degrees"),
    ],
)
def test_heading_conventions(wrong, words):
    sequence = drive()
    rpy = sequence.reference.rpy.copy()
    rpy[:, 2] = wrong(rpy[:, 2])
    reference = dataclasses.replace(sequence.reference, rpy=rpy)
    found = reference_findings(
        dataclasses.replace(sequence, reference=reference), tracks(sequence), None
    )
    doubtful = [f.found for f in found if f.severity == "doubtful"]
    assert any(words in text for text in doubtful), doubtful
