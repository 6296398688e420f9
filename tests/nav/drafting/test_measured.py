"""What files show of each other: right, or blank with the reason; never a guess."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest

from certnav.datasets import gpstime
from certnav.datasets.axes import all_axes, axes_matrix, axes_name
from certnav.datasets.own.blanks import BLANK
from certnav.datasets.own.draft import Draft, Line
from certnav.datasets.sequence import Calibration, Sequence
from certnav.datasets.simulation.sensors import fixes_from_truth, imu_measurements
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.datasets.simulation.streets import RouteConfig
from certnav.datasets.simulation.streets import drive as drive_along
from certnav.datasets.simulation.trajectory import Trajectory
from certnav.filters.earth import C_en_of, ecef_to_lla
from certnav.filters.rotation import matrix_from_rpy
from certnav.filters.sensors import imu_preset
from certnav.nav.check.motion import integrals
from certnav.nav.check.orientation import mounting_rpy_deg, named, orientation
from certnav.nav.check.recording import check
from certnav.nav.drafting import installed, measured_draft
from certnav.velocity.tracks import gnss_tracks

DEGREES = float(np.degrees(1.0))
LEVER = (-0.65, -0.05, -0.15)


@pytest.fixture(scope="module")
def drive():
    return simulate(
        SimulationConfig(seed=3, duration=180.0, density="open", static_start=10.0, imu_rate=50.0)
    )


@pytest.fixture(scope="module")
def fixes(drive):
    time = drive.config.start_time + np.arange(1.0, 179.0, 0.5)
    rng = np.random.default_rng(1)
    return fixes_from_truth(drive.trajectory, time, LEVER, (0.5, 0.5, 1.0), 0.05, rng)


def write_imu(file, drive, C_bs=None, gyro=1.0, accel=1.0, stamp=None, names="t w1 w2 w3 f1 f2 f3"):
    C_bs = np.eye(3) if C_bs is None else C_bs
    imu = drive.imu
    time = imu.time % 604800.0 if stamp is None else stamp
    columns = [time, *(gyro * imu.gyro_b @ C_bs).T, *(accel * imu.accel_b @ C_bs).T]
    table = pd.DataFrame(dict(zip(names.split(), columns, strict=True)))
    table.to_csv(file, index=False, float_format="%.9g" if stamp is None else None)
    return file


def write_gnss(file, fixes, speed=1.0, angle=DEGREES, stamp=None, names=None, rows=None):
    lla = ecef_to_lla(fixes.pos_e)
    vel_n = np.einsum("nij,ni->nj", C_en_of(fixes.pos_e), fixes.vel_e)
    time = fixes.time % 604800.0 if stamp is None else stamp
    columns = [time, *(lla[:, :2] * angle).T, lla[:, 2], *(vel_n * speed).T]
    names = (names or "t lat lon height vn ve vd").split()
    pd.DataFrame(dict(zip(names, columns, strict=True)))[:rows].to_csv(file, index=False)
    return file


@pytest.fixture(scope="module")
def track(fixes):
    return gnss_tracks(fixes, None)[0]


@pytest.mark.parametrize("C_bs", all_axes(), ids=axes_name)
def test_every_right_handed_set_of_axes_is_told(drive, track, C_bs):
    imu = drive.imu
    turned = dataclasses.replace(imu, gyro_b=imu.gyro_b @ C_bs, accel_b=imu.accel_b @ C_bs)
    found = orientation(integrals(turned), track)
    assert found.problem == ""
    name, C_bv = named(found.C_sv)
    assert name == axes_name(C_bs)
    assert np.abs(mounting_rpy_deg(C_bv)).max() < 3.0 * np.degrees(found.sigma)
    assert found.rate.is_close_to(1.0)


@pytest.mark.parametrize("axis", range(3))
def test_no_set_of_axes_is_named_for_a_mirrored_one(drive, track, axis):
    mirror = np.eye(3)
    mirror[axis, axis] = -1.0
    imu = drive.imu
    turned = dataclasses.replace(imu, gyro_b=imu.gyro_b @ mirror, accel_b=imu.accel_b @ mirror)
    assert "handed" in (problem := orientation(integrals(turned), track).problem) or (
        "signs of one of them differ" in problem
    )


def test_a_tilted_imu_is_told_by_axes_and_mounting_together(drive, track):
    C_bv = matrix_from_rpy(np.radians([8.0, -12.0, 35.0])).T
    imu = drive.imu
    turned = dataclasses.replace(imu, gyro_b=imu.gyro_b @ C_bv.T, accel_b=imu.accel_b @ C_bv.T)
    found = orientation(integrals(turned), track)
    off = found.C_sv.T @ C_bv
    assert np.degrees(np.arccos((np.trace(off) - 1.0) / 2.0)) < 3.0 * np.degrees(found.sigma)


def test_made_up_names_units_and_axes(drive, fixes, tmp_path):
    """Names that tell nothing, g and deg/s, knots and radians, an IMU that lies on its side."""
    C_bs = all_axes()[7]
    imu = write_imu(
        tmp_path / "a.csv", drive, C_bs, np.degrees(1.0), 1 / 9.80665,
        names="Zeit Drehung1 Drehung2 Drehung3 Kraft1 Kraft2 Kraft3",
    )  # fmt: skip
    gnss = write_gnss(
        tmp_path / "b.csv", fixes, 3600.0 / 1852.0, 1.0,
        names="Zeit Breite Laenge Hoehe Nord Ost Unten",
    )  # fmt: skip
    draft = measured_draft([imu, gnss], navigated=False)
    assert draft.get("imu", "gyro") == ["Drehung1", "Drehung2", "Drehung3"]
    assert draft.get("imu", "accel") == ["Kraft1", "Kraft2", "Kraft3"]
    assert draft.get("imu", "gyro_unit") == "deg/s"
    assert draft.get("imu", "accel_unit") == "g"
    assert draft.get("imu", "axes") == axes_name(C_bs)
    assert draft.get("gnss", "position") == ["Breite", "Laenge", "Hoehe"]
    assert draft.get("gnss", "velocity") == ["Nord", "Ost", "Unten"]
    assert draft.get("gnss", "angle_unit") == "rad"
    assert draft.get("gnss", "velocity_unit") == "knots"
    assert draft.get("imu", "time_scale") == draft.get("gnss", "time_scale") == "relative"
    asked = {key for _, key in draft.blanks}
    assert asked == {"preset", "lever_frd_m", "height", "position_sigma_m", "velocity_sigma_mps"}
    assert "explained" in draft.comment("imu", "axes")


@pytest.mark.parametrize(
    ("stamp", "scale", "offset"),
    [
        (lambda t: t - t[0] + 12.5, "gps", None),  # a clock with a start of its own
        (lambda t: gpstime.to_week_sow(t)[1], "gps-sow", None),
        (lambda t: gpstime.to_week_sow(t)[1] - 18.0, "gps-sow", 18.0),
        (lambda t: gpstime.to_week_sow(t)[1] + 0.25, "gps-sow", -0.25),
    ],
)
def test_clocks_are_put_on_one_by_the_motion(drive, fixes, tmp_path, stamp, scale, offset):
    unix = fixes.time + 315964800.0 - gpstime.gps_minus_utc(float(fixes.time[0]))
    imu = write_imu(tmp_path / "imu.csv", drive, stamp=stamp(drive.imu.time))
    gnss = write_gnss(tmp_path / "gnss.csv", fixes, stamp=unix)
    draft = measured_draft([imu, gnss], navigated=False)
    assert draft.get("imu", "time_scale") == scale
    if scale == "gps":
        start = draft.get("imu", "time_offset_s") + 12.5
        assert start == pytest.approx(drive.imu.time[0], abs=0.1)
    else:
        week = int(gpstime.to_week_sow(drive.imu.time[0])[0])
        assert draft.get("imu", "week") == week
        assert draft.get("imu", "time_offset_s", 0.0) == pytest.approx(offset or 0.0, abs=0.06)
    if offset == 18.0:  # exactly the leap seconds, not what was measured of them
        assert draft.get("imu", "time_offset_s") == 18.0


@pytest.mark.parametrize("axes", ["FRD", "BLD", "RFU"])
@pytest.mark.parametrize("arm", [LEVER, (1.2, 0.5, -1.3)])
def test_turns_show_how_far_forward_and_right_the_antenna_is(drive, tmp_path, axes, arm):
    """In forward, right, down of the declared axes, however the IMU lies; down is not proposed."""
    time = drive.config.start_time + np.arange(1.0, 179.0, 0.5)
    rng = np.random.default_rng(4)
    fixes = fixes_from_truth(drive.trajectory, time, arm, (0.5, 0.5, 1.0), 0.05, rng)
    imu = write_imu(tmp_path / "imu.csv", drive, axes_matrix(axes))
    draft = measured_draft([imu, write_gnss(tmp_path / "gnss.csv", fixes)])
    assert draft.get("imu", "axes") == axes
    forward, right, down = draft.get("antenna", "lever_frd_m")
    sigma = draft.get("antenna", "lever_sigma_m")
    assert down == BLANK and 0.02 < sigma < 0.3
    assert np.abs(np.subtract([forward, right], arm[:2])).max() < 3.0 * sigma
    assert f"measured: forward {forward:+.2f} ± " in draft.comment("antenna", "lever_frd_m")
    assert ("antenna", "lever_frd_m") in draft.blanks


def test_without_turns_the_antenna_is_anywhere():
    """Straight ahead, stop and go: speeds change, and the axes are known from elsewhere."""
    points = drive_along(
        RouteConfig(duration=120.0, turn_probability=0.0), np.random.default_rng(8)
    )
    trajectory = Trajectory(
        gpstime.from_week_sow(2300, 1000.0), points.time, points.pos_t, points.rpy,
        (np.radians(48.0), np.radians(9.0), 300.0), C_bv=np.eye(3),
    )  # fmt: skip
    spec, start = imu_preset("adis16470"), trajectory.span[0] + 0.5
    rng = np.random.default_rng(5)
    imu, *_ = imu_measurements(trajectory, start + np.arange(1, 11000) / 100.0, spec, rng)
    fixes = fixes_from_truth(trajectory, start + np.arange(1.0, 109.0), LEVER, 0.5, 0.05, rng)
    calibration = Calibration(spec, np.zeros(3), "trial", mounting_source="known")
    draft = Draft(sections={"antenna": [Line("lever_frd_m", BLANK)]})
    installed.lever(draft, Sequence("straight", imu, calibration, fixes=fixes))
    assert draft.get("antenna", "lever_frd_m") == BLANK
    assert "not measured" in draft.comment("antenna", "lever_frd_m")
    assert not draft.has("antenna", "lever_sigma_m")


def test_a_drive_that_hardly_moves_leaves_blanks_with_the_reason(drive, fixes, tmp_path):
    imu, gnss = write_imu(tmp_path / "imu.csv", drive), tmp_path / "gnss.csv"
    write_gnss(gnss, fixes, rows=16)  # 8 s, at rest
    draft = measured_draft([imu, gnss], navigated=False)
    for key in ("gyro_unit", "axes", "time_scale"):
        assert draft.asks("imu", key)
        assert "not measured" in draft.comment("imu", key)
    assert draft.asks("gnss", "velocity_unit")


def test_a_header_that_motion_contradicts_is_asked(drive, fixes, tmp_path):
    names = "t gx_radps gy_radps gz_radps ax ay az"  # and the numbers are deg/s
    imu = write_imu(tmp_path / "imu.csv", drive, gyro=np.degrees(1.0), names=names)
    draft = measured_draft([imu, write_gnss(tmp_path / "gnss.csv", fixes)], navigated=False)
    assert draft.asks("imu", "gyro_unit")
    assert "deg/s" in draft.comment("imu", "gyro_unit")


def test_of_two_files_of_positions_the_quieter_is_the_truth(drive, fixes, tmp_path):
    imu = write_imu(tmp_path / "imu.csv", drive)
    time = fixes.time
    rng = np.random.default_rng(2)
    good = fixes_from_truth(drive.trajectory, time, LEVER, (0.01, 0.01, 0.02), 0.02, rng)
    a, b = tmp_path / "a.csv", tmp_path / "b.csv"
    for first, second in ((fixes, good), (good, fixes)):
        write_gnss(a, first)
        write_gnss(b, second)
        draft = measured_draft([imu, a, b], navigated=False)
        truth = "b.csv" if second is good else "a.csv"
        assert draft.get("reference", "file") == truth
        assert {draft.get("gnss", "file"), truth} == {"a.csv", "b.csv"}
        assert draft.get("reference", "time_scale") == "relative"


def test_angles_of_a_reference_by_the_course(drive, fixes, tmp_path):
    imu = write_imu(tmp_path / "imu.csv", drive)
    gnss = write_gnss(tmp_path / "gnss.csv", fixes)
    reference = drive.reference
    lla = ecef_to_lla(reference.pos_e)
    roll, pitch, heading = reference.rpy.T
    yaw = np.pi / 2 - heading  # ENU, counter-clockwise from east
    columns = [reference.time % 604800.0, *np.degrees(lla[:, :2]).T, lla[:, 2]]
    columns += [roll, -pitch, (yaw + np.pi) % (2 * np.pi) - np.pi]
    names = ["t", "lat", "lon", "height", "roll", "pitch", "yaw"]
    table = pd.DataFrame(dict(zip(names, columns, strict=True)))
    table.to_csv(tmp_path / "ref.csv", index=False)
    draft = measured_draft([imu, gnss, tmp_path / "ref.csv"], navigated=False)
    assert draft.get("reference", "attitude_convention") == "flu-enu"
    assert draft.get("reference", "attitude_unit") == "rad"
    assert draft.get("reference", "time_scale") == "relative"


def test_check_has_lines_to_paste_for_axes_that_are_declared_wrongly(drive, fixes, tmp_path):
    write_imu(tmp_path / "imu.csv", drive)
    write_gnss(tmp_path / "gnss.csv", fixes)
    draft = measured_draft([tmp_path / "imu.csv", tmp_path / "gnss.csv"])
    assert draft.get("imu", "axes") == "FRD"
    for section, key in draft.blanks:
        answers = {"preset": "consumer", "lever_frd_m": list(LEVER), "height": "ellipsoid",
                   "position_sigma_m": 0.5, "velocity_sigma_mps": 0.05}  # fmt: skip
        draft.put(section, key, answers[key])
    draft.put("imu", "axes", "BLD")
    (tmp_path / "sequence.toml").write_text(draft.text())
    report = check(tmp_path)
    assert not report.navigable
    lines = next(f.declare for f in report.findings if f.subject == "orientation")
    assert 'axes = "FRD"' in lines
    draft.put("imu", "axes", "FRD")
    (tmp_path / "sequence.toml").write_text(draft.text())
    assert check(tmp_path).navigable
    assert BLANK not in [x.value for x in draft.sections["imu"]]
