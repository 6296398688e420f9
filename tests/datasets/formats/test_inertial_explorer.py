"""Inertial Explorer exports: every layout met in the wild, from one drive written in each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.datasets.formats.inertial_explorer import (
    dms_to_radians,
    read_reference,
    read_reference_table,
)
from certnav.filters.earth import C_en_at, lla_to_ecef
from certnav.filters.errors import DataError
from certnav.filters.rotation import matrix_from_rpy

NAMES_2020 = (
    "Week GPSTime X-ECEF Y-ECEF Z-ECEF Latitude Longitude H-Ell VX-ECEF VY-ECEF VZ-ECEF "
    "Cx11 Cx22 Cx33 Vel-Cx11 Vel-Cx22 Vel-Cx33 Heading Pitch Roll AmbStatus PDOP Q NS"
)
UNITS_2020 = (
    "(weeks) (sec) (m) (m) (m) (+/-D M S) (+/-D M S) (m) (m/s) (m/s) (m/s) (m^2) (m^2) (m^2) "
    "(m^2/s^2) (m^2/s^2) (m^2/s^2) (deg) (deg) (deg) () (dop) () ()"
)
NAMES_2021 = NAMES_2020.replace("H-Ell", "H-Ell Easting Northing Grid-Z")
UNITS_2021 = UNITS_2020.replace("S) (m) (m/s)", "S) (m) (m) (m) (m) (m/s)")


class Drive:
    """Eleven seconds on a circle, exact to the digits written."""

    def __init__(self, lat_deg: float = 30.53, lon_deg: float = 114.36) -> None:
        self.sow = 180590.0 + np.arange(0.0, 11.0, 0.1)
        angle = 0.1 * (self.sow - self.sow[0])
        vel_n = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), np.zeros(angle.size)])
        pos_n = np.column_stack([100 * np.sin(angle), 100 - 100 * np.cos(angle), 0 * angle])
        C_en = C_en_at(np.radians(lat_deg), np.radians(lon_deg))
        self.pos_e = lla_to_ecef(np.radians(lat_deg), np.radians(lon_deg), 25.0) + pos_n @ C_en.T
        self.vel_e = vel_n @ C_en.T
        self.heading = np.degrees(angle) % 360.0

    def rows(self, *, week: str = "2129", easting: bool = False, dms: bool = True) -> list[str]:
        from certnav.filters.earth import ecef_to_lla

        lla = ecef_to_lla(self.pos_e)
        rows = []
        for k in range(self.sow.size):
            angles = [self._angle(np.degrees(a), dms) for a in lla[k, :2]]
            tokens = [
                *(week, f"{self.sow[k]:.3f}", *(f"{x:.4f}" for x in self.pos_e[k])),
                *(*angles, f"{lla[k, 2]:.4f}"),
                *(["530000.123", "3380000.456", "25.0"] if easting else []),
                *(f"{x:.5f}" for x in self.vel_e[k]),
                *(["1e-4", "1e-4", "1e-4", "1e-6", "1e-6", "1e-6"]),
                *(f"{self.heading[k]:.7f}", "1.5", "-2.5", "Fixed", "1.3", "1", "17"),
            ]
            rows.append(" ".join(tokens))
        return rows

    @staticmethod
    def _angle(value: float, dms: bool) -> str:
        if not dms:
            return f"{value:.10f}"
        degree, rest = divmod(abs(value), 1.0)
        minute, rest = divmod(rest * 60.0, 1.0)
        return f"{'-' if value < 0 else ''}{degree:.0f} {minute:.0f} {rest * 60.0:.6f}"


def write(folder: Path, *lines: str) -> Path:
    file = folder / "groundtruth.txt"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def assert_is(drive: Drive, table) -> None:
    np.testing.assert_allclose(table.pos_e, drive.pos_e, atol=6e-5)
    np.testing.assert_allclose(table.vel_e, drive.vel_e, atol=6e-6)
    np.testing.assert_allclose(np.degrees(table.rpy[:, 2]), drive.heading, atol=1e-6)
    np.testing.assert_allclose(np.degrees(table.rpy[0, :2]), [-2.5, 1.5], atol=1e-12)


@pytest.mark.parametrize("prefix", ["", "% ", "%", "# ", "#"])
def test_2020_header_with_and_without_comment_sign(tmp_path, prefix):
    drive = Drive()
    table = read_reference_table(
        write(tmp_path, prefix + NAMES_2020, prefix + UNITS_2020, *drive.rows())
    )
    assert_is(drive, table)
    np.testing.assert_allclose(table.time - 2129 * 604800.0, drive.sow, atol=1e-6)
    assert (table.week, table.week_line) == (2129, 3)


def test_2021_layout_easting_moves_everything_by_three_and_the_week_is_a_decimal(tmp_path):
    drive = Drive()
    rows = drive.rows(week="2179.00000", easting=True)
    table = read_reference_table(write(tmp_path, NAMES_2021, UNITS_2021, *rows))
    assert_is(drive, table)
    assert table.week == 2179


def test_week_2233_of_urban_02(tmp_path):
    rows = Drive().rows(week="2233")
    assert read_reference_table(write(tmp_path, NAMES_2020, UNITS_2020, *rows)).week == 2233


def test_decimal_degrees_are_one_token(tmp_path):
    drive = Drive()
    units = UNITS_2020.replace("(+/-D M S)", "(deg)")
    table = read_reference_table(write(tmp_path, NAMES_2020, units, *drive.rows(dms=False)))
    assert_is(drive, table)


@pytest.mark.parametrize("place", [(-33.5, -70.25), (-0.4, 30.0), (51.4, -0.0005), (0.001, -179.9)])
def test_the_sign_of_degrees_holds_for_minutes_and_seconds_also_at_minus_zero(tmp_path, place):
    drive = Drive(*place)
    assert_is(drive, read_reference_table(write(tmp_path, NAMES_2020, UNITS_2020, *drive.rows())))


def test_dms():
    exact = np.radians([30.5125, -30.5125, -0.5125, 0.5125])
    found = dms_to_radians([30.0, -30.0, -0.0, 0.0], [30] * 4, [45.0] * 4)
    np.testing.assert_allclose(found, exact, rtol=1e-15)


def test_blank_lines_and_the_error_report_at_the_end(tmp_path):
    drive = Drive()
    rows = drive.rows()
    tail = ["", "Errors/warnings: 3", "2129 1.0 this is no data", "nor this"]
    lines = [NAMES_2020, UNITS_2020, "", *rows[:5], "", *rows[5:], *tail]
    assert_is(drive, read_reference_table(write(tmp_path, *lines)))


def test_without_header_the_2020_layout_is_assumed_and_said(tmp_path):
    drive = Drive()
    table = read_reference_table(write(tmp_path, *drive.rows()))
    assert_is(drive, table)
    assert any("2020 layout assumed" in note for note in table.notes)


def test_without_header_a_2021_file_is_refused_by_its_velocity(tmp_path):
    file = write(tmp_path, *Drive().rows(easting=True))
    with pytest.raises(DataError, match=r"velocity .*disagree.*Easting"):
        read_reference_table(file)


def test_a_header_that_lies_about_dms_is_refused_by_the_position(tmp_path):
    """Three tokens each in the data, one each by the header: the height is then a minute."""
    units = UNITS_2020.replace("(+/-D M S)", "(deg)")
    file = write(tmp_path, NAMES_2020, units, *Drive().rows())
    with pytest.raises(DataError, match="ECEF position are"):
        read_reference_table(file)


def test_missing_column_is_named(tmp_path):
    file = write(tmp_path, NAMES_2020.replace(" Roll", " Rall"), UNITS_2020, *Drive().rows())
    with pytest.raises(DataError, match=r"groundtruth\.txt:1: header lacks Roll"):
        read_reference_table(file)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda row: row.replace("180590.500", "18o590.500"), r":8: GPSTime: .*'18o590\.500'"),
        (lambda row: row.replace("180590.500", "180589.500"), r":8: GPSTime: .*increasing"),
        (lambda row: " ".join(row.split()[:20]), r":8: expected 24 columns .*found 20"),
        (lambda row: row.replace("2129 ", "2129.5 "), r":8: Week: .*2129\.5"),
    ],
)
def test_a_bad_row_is_refused_with_its_line(tmp_path, edit, message):
    rows = Drive().rows()
    rows[5] = edit(rows[5])
    with pytest.raises(DataError, match=message):
        read_reference_table(write(tmp_path, NAMES_2020, UNITS_2020, *rows))


def test_attitude_is_greats_own_matrix_after_the_change_of_axes():
    """GREAT: C_b^n (RFU → ENU) = Rz(−heading) Rx(pitch) Ry(roll)."""
    rng = np.random.default_rng(0)
    rpy = rng.uniform(-1.4, 1.4, (50, 3)) * [1.0, 1.0, 2.0]
    enu_from_rfu = (
        Rotation.from_euler("z", -rpy[:, [2]])
        * Rotation.from_euler("x", rpy[:, [1]])
        * Rotation.from_euler("y", rpy[:, [0]])
    ).as_matrix()
    swap = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    np.testing.assert_allclose(swap @ enu_from_rfu @ swap, matrix_from_rpy(rpy), atol=1e-14)


def test_the_point_and_its_lever_are_the_callers(tmp_path):
    file = write(tmp_path, NAMES_2020, UNITS_2020, *Drive().rows())
    reference, notes = read_reference(file, point="antenna", lever_b=(-0.65, -0.05, -0.15))
    assert (reference.point, reference.attitude_frame) == ("antenna", "b")
    np.testing.assert_array_equal(reference.lever_b, [-0.65, -0.05, -0.15])
    assert "10 Hz" in notes[0]


URBAN_NAMES = "UTCTime Week GPSTime Latitude Longitude H-Ell {velocity} Roll Pitch Heading Q"
URBAN_UNITS = "(sec) (weeks) (sec) (+/-D M S) (+/-D M S) (m) {units} (deg) (deg) (deg) ()"


def urban(drive: Drive, velocity: str, *, units: bool = True, each: int = 1) -> list[str]:
    """A file as public sets publish it: no ECEF columns."""
    from certnav.filters.earth import C_en_of, ecef_to_lla

    lla = ecef_to_lla(drive.pos_e)
    C_en = C_en_of(drive.pos_e)
    rpy = np.radians(np.column_stack([0 * drive.sow - 2.5, 0 * drive.sow + 1.5, drive.heading]))
    vel_n = np.einsum("nji,nj->ni", C_en, drive.vel_e)
    vel_b = np.einsum("nji,nj->ni", matrix_from_rpy(rpy), vel_n)
    values = {
        "VEast VNorth VUp": vel_n[:, [1, 0, 2]] * [1, 1, -1],
        "VelBdyX VelBdyY VelBdyZ": vel_b[:, [1, 0, 2]] * [1, 1, -1],
        "": np.empty((drive.sow.size, 0)),
    }[velocity]
    rows = []
    for k in range(0, drive.sow.size, each):
        place = [drive._angle(np.degrees(a), True) for a in lla[k, :2]]
        tokens = [
            *("1615964783.00", "2129", f"{drive.sow[k]:.3f}", *place, f"{lla[k, 2]:.4f}"),
            *(f"{v:.5f}" for v in values[k]),
            *("-2.5", "1.5", f"{drive.heading[k]:.7f}", "1"),
        ]
        rows.append(" ".join(tokens))
    head = [URBAN_NAMES.format(velocity=velocity)]
    if units:
        head.append(URBAN_UNITS.format(units="(m/s) (m/s) (m/s)" if velocity else ""))
    return [*head, *rows]


@pytest.mark.parametrize("units", [True, False])
@pytest.mark.parametrize("velocity", ["VEast VNorth VUp", "VelBdyX VelBdyY VelBdyZ"])
def test_position_from_latitude_and_longitude_where_ecef_is_missing(tmp_path, velocity, units):
    drive = Drive()
    table = read_reference_table(write(tmp_path, *urban(drive, velocity, units=units)))
    np.testing.assert_allclose(table.pos_e, drive.pos_e, atol=2e-4)
    np.testing.assert_allclose(table.vel_e, drive.vel_e, atol=2e-5)
    assert "position from latitude, longitude and height; velocity from" in table.notes[0]


def test_velocity_from_differences_where_there_is_none_and_the_rate_bears_it(tmp_path):
    drive = Drive()
    table = read_reference_table(write(tmp_path, *urban(drive, "")))
    np.testing.assert_allclose(table.vel_e[1:-1], drive.vel_e[1:-1], atol=5e-3)
    assert "no velocity columns: velocity from differenced positions" in table.notes[0]
    slow = read_reference_table(write(tmp_path, *urban(drive, "", each=10)))
    assert np.isnan(slow.vel_e).all()
    assert "no velocity columns: no velocity" in slow.notes[0]


def test_body_velocities_that_contradict_the_positions_are_left_out_and_said(tmp_path):
    lines = urban(Drive(), "VelBdyX VelBdyY VelBdyZ")
    lines[0] = lines[0].replace("VelBdyX VelBdyY", "VelBdyY VelBdyX")
    table = read_reference_table(write(tmp_path, *lines))
    assert "body velocities left out, 14.2 m/s from differenced" in table.notes[0]
    np.testing.assert_allclose(table.vel_e[1:-1], Drive().vel_e[1:-1], atol=5e-3)


def test_local_velocities_that_contradict_the_positions_are_refused(tmp_path):
    lines = urban(Drive(), "VEast VNorth VUp")
    lines[0] = lines[0].replace("VEast VNorth", "VNorth VEast")
    with pytest.raises(DataError, match=r"velocity \(tokens .*disagree"):
        read_reference_table(write(tmp_path, *lines))


def test_neither_kind_of_position_names_both(tmp_path):
    lines = urban(Drive(), "")
    lines[0] = lines[0].replace("H-Ell", "H-MSL")
    with pytest.raises(DataError, match=r":1: header lacks X-ECEF.*or Latitude, Longitude, H-Ell"):
        read_reference_table(write(tmp_path, *lines))


def test_a_late_week_number_of_a_reference_is_mended_and_said(tmp_path):
    drive = Drive()
    drive.sow = 604800.0 - 4.95 + np.arange(0.0, 11.0, 0.1)
    lines = urban(drive, "")
    for k, sow in enumerate(drive.sow):
        past = sow >= 604800.0
        lines[k + 2] = lines[k + 2].replace(
            f"2129 {sow:.3f}", f"{2129 + (sow >= 604800.3)} {sow - 604800.0 * past:.3f}"
        )
    table = read_reference_table(write(tmp_path, *lines))
    np.testing.assert_allclose(table.time - 2129 * 604800.0, drive.sow, atol=1e-6)
    assert "week number of 3 rows mended" in table.notes[0]
