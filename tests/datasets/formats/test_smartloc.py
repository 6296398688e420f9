"""smartLoc: signs of heading, yaw rate and Doppler tested by motion; labels kept, none used."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from certnav.datasets.formats.smartloc import DRIVE, RAW, read_smartloc
from certnav.datasets.loading import load
from certnav.filters.earth import EARTH_RATE, SPEED_OF_LIGHT, C_en_of
from certnav.filters.errors import DataError
from certnav.filters.rotation import wrap_angle
from certnav.velocity.phase_rates import phase_intervals


@pytest.fixture(scope="module")
def folder(data_dir):
    return data_dir / "smartloc-berlin1"


@pytest.fixture(scope="module")
def drive(folder):
    return load(folder)


def range_rate_errors(observations, reference):
    """Return measured minus expected range rate, without the epoch's median, per row."""
    pos, vel = (
        np.column_stack([np.interp(observations.time, reference.time, c) for c in value.T])
        for value in (reference.pos_e, reference.vel_e)
    )
    line = observations.sat_pos_e - pos
    line /= np.linalg.norm(line, axis=1)[:, None]
    s, v = observations.sat_pos_e, observations.sat_vel_e
    rotation = EARTH_RATE / SPEED_OF_LIGHT * (
        v[:, 1] * pos[:, 0] + s[:, 1] * vel[:, 0] - v[:, 0] * pos[:, 1] - s[:, 0] * vel[:, 1]
    )  # fmt: skip
    error = observations.range_rate - np.einsum("ni,ni->n", line, v - vel) - rotation
    parts = [
        error[rows] - np.median(error[rows])
        for _, rows in observations.epochs()
        if rows.stop - rows.start >= 4
    ]
    return np.abs(np.concatenate(parts))


def test_no_imu_is_said_by_name(drive):
    from certnav.nav.config import Config
    from certnav.nav.pipeline import navigate

    assert drive.imu is None
    with pytest.raises(DataError, match="no IMU data — certnav run needs an IMU"):
        navigate(drive, Config())


def test_contents(drive):
    observations = drive.observations
    assert len(observations) == 4355
    assert {str(s)[0] for s in observations.sat} == {"G", "R", "S"}
    assert (observations.label == "los").sum() == 1781
    assert (observations.label == "nlos").sum() == 2574
    assert observations.has_range_rate.sum() == 2326
    assert drive.span == pytest.approx((1900 * 604800 + 126641.5, 1900 * 604800 + 126701.5))
    assert len(drive.odometer.time) == 14131
    assert drive.reference.time[-1] - drive.reference.time[0] > 280.0


def test_heading_is_clockwise_from_north(drive):
    reference = drive.reference
    vel_n = np.einsum("nji,nj->ni", C_en_of(reference.pos_e), reference.vel_e)
    fast = np.hypot(vel_n[:, 0], vel_n[:, 1]) > 4.0
    course = np.arctan2(vel_n[:, 1], vel_n[:, 0])
    error = np.degrees(wrap_angle(course - reference.rpy[:, 2]))[fast]
    assert abs(np.median(error)) < 2.0
    assert np.ptp(np.unwrap(reference.rpy[:, 2])) > 3.0  # not a straight road


def test_odometer_speed_and_yaw_rate_follow_the_truth(drive):
    odometer, reference = drive.odometer, drive.reference
    speed = np.linalg.norm(reference.vel_e, axis=1)
    found = np.interp(reference.time, odometer.time, odometer.speed)
    assert np.median(np.abs(found - speed)) < 0.1
    turned = np.concatenate([[0.0], np.cumsum(odometer.yaw_rate[1:] * np.diff(odometer.time))])
    heading = np.unwrap(reference.rpy[:, 2])
    along = np.interp(reference.time, odometer.time, turned)
    step = 15  # 3 s: short against the drift of the bias
    slope = np.polyfit(heading[step:] - heading[:-step], along[step:] - along[:-step], 1)[0]
    assert slope == pytest.approx(1.0, abs=0.01)


def test_doppler_in_line_of_sight_agrees_with_the_truth_and_labels_mean_something(drive):
    observations = drive.observations.take(drive.observations.has_range_rate)
    los = range_rate_errors(observations.take(observations.label == "los"), drive.reference)
    nlos = range_rate_errors(observations.take(observations.label == "nlos"), drive.reference)
    assert np.median(los) < 0.16
    assert np.median(nlos) > 3.0 * np.median(los)
    mirrored = observations.take(observations.label == "los")
    mirrored = mirrored.with_columns(range_rate=-mirrored.range_rate)
    assert np.median(range_rate_errors(mirrored, drive.reference)) > 100.0


def test_glonass_wavelengths_follow_the_slot(drive):
    """Frequency 1602 MHz + channel · 562.5 kHz; R20 has channel +2, R02 −4."""
    observations = drive.observations
    for sat, channel in (("R20", 2), ("R02", -4)):
        wavelength = observations.wavelength[observations.sat == sat]
        np.testing.assert_allclose(
            SPEED_OF_LIGHT / wavelength, 1602e6 + 562.5e3 * channel, rtol=1e-12
        )


def test_the_part_of_a_set_without_imu(drive):
    start, _ = drive.span
    part = drive.between(start + 10.0, start + 20.0)
    assert part.imu is None
    assert part.observations.time.min() >= start + 10.0
    assert set(part.observations.label) <= {"los", "nlos"}


@pytest.fixture(scope="module")
def whole(folder):
    return load(folder / "full")


def test_the_whole_run_has_glonass_labels_and_the_sets_odometer(whole, drive):
    observations = whole.observations
    assert {str(s)[0] for s in observations.sat} == {"G", "R"}
    assert np.ptp(observations.time) > 280.0 and observations.has_range_rate.mean() > 0.99
    labelled = observations.time[observations.label != ""]
    assert labelled.max() - labelled.min() < 61.0 < np.ptp(observations.time)
    # The labels are those of the same satellites at the same time.
    of = {
        (s, round(10 * t)): label
        for s, t, label in zip(
            drive.observations.sat, drive.observations.time, drive.observations.label, strict=True
        )
    }
    at = zip(observations.sat, observations.time, observations.label, strict=True)
    assert all(of[s, round(10 * t)] == label for s, t, label in at if label)
    assert len(whole.odometer.time) == len(drive.odometer.time)


@pytest.mark.parametrize("system", ["G", "R"])
def test_doppler_of_both_systems_agrees_with_the_truth_and_with_the_phase(whole, system):
    """A wavelength of the wrong GLONASS channel would be off by 0.03 % of 3 km/s: 1 m/s."""
    strong = whole.observations.cn0 >= 45.0
    mine = whole.observations.take(strong & np.char.startswith(whole.observations.sat, system))
    assert np.median(range_rate_errors(mine, whole.reference)) < 0.12
    misfit = phase_intervals(mine).misfit
    assert abs(np.median(misfit)) < 0.02 and np.median(np.abs(misfit)) < 0.08


def test_the_receivers_word_on_its_phase(drive):
    """Tracking status and lock time: no carrier where it is void, bit 0 at the start of a lock."""
    observations = drive.observations
    assert 0.3 < np.isfinite(observations.carrier).mean() < 0.6
    tracked = np.isfinite(observations.carrier)
    weak, strong = (np.median(observations.cn0[rows]) for rows in (~tracked, tracked))
    assert strong > weak + 6.0
    weak = observations.cn0 < 30.0  # locks end where signals fade
    lost = observations.loss_of_lock & 1 > 0
    assert lost[tracked & weak].mean() > 1.5 * lost[tracked & ~weak].mean()


def test_a_whole_run_without_ephemerides_names_what_it_needs(folder, tmp_path):
    inner = tmp_path / "full"
    inner.mkdir()
    shutil.copy(folder / "full" / "Berlin_Potsdamer_Platz.obs", inner)
    for name in (RAW, DRIVE):
        shutil.copy(folder / name, tmp_path)
    with pytest.raises(DataError, match="no broadcast ephemerides beside it"):
        load(inner)


def test_without_odometer_and_satellites_it_says_so(folder, tmp_path):
    shutil.copy(folder / RAW, tmp_path)
    s = read_smartloc(tmp_path)
    assert s.odometer is None
    assert not s.observations.has_range_rate.any()
    assert any("name the day's broadcast file" in note for note in s.notes)
    assert any("no MY_DATASET.csv" in note for note in s.notes)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (";GPS;", ";Navic;", r"RXM-RAWX\.csv:2: system 'Navic'"),
        (";Glonass;20;9;", ";Glonass;20;19;", "GLONASS slot 19"),
        (";15;0\n", ";15;yes\n", "NLOS label: expected 0, 1 or #, found 'yes'"),
    ],
)
def test_unknown_systems_slots_and_labels_are_refused(folder, tmp_path, old, new, message):
    text = "\n".join((folder / RAW).read_text().splitlines()[:40]) + "\n"
    assert old in text
    (tmp_path / RAW).write_text(text.replace(old, new, 1))
    with pytest.raises(DataError, match=message):
        read_smartloc(tmp_path)


def test_an_upside_down_yaw_rate_is_refused(folder, tmp_path):
    shutil.copy(folder / RAW, tmp_path)
    lines = (folder / DRIVE).read_text().splitlines()
    flipped = [lines[0]]
    for line in lines[1:]:
        *rest, rate = line.split(",")
        flipped.append(",".join([*rest, str(-float(rate))]))
    (tmp_path / DRIVE).write_text("\n".join(flipped) + "\n")
    with pytest.raises(DataError, match=r"yaw rate contradicts the truth's heading.*-1"):
        read_smartloc(tmp_path)
