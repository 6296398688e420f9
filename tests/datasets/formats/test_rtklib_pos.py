"""RTKLIB solutions: the same fix in every form, and the sign of covariances."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from certnav.datasets import gpstime
from certnav.datasets.formats.rtklib_pos import is_pos, read_pos
from certnav.filters.earth import C_en_at, lla_to_ecef
from certnav.filters.errors import DataError

GEODETIC = (
    "%  GPST            latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) "
    "sdeu(m) sdun(m) age(s) ratio vn(m/s) ve(m/s) vu(m/s) sdvn sdve sdvu sdvne sdveu sdvun"
)
ECEF = (
    "%  GPST            x-ecef(m) y-ecef(m) z-ecef(m) Q ns sdx(m) sdy(m) sdz(m) sdxy(m) sdyz(m) "
    "sdzx(m) age(s) ratio vx(m/s) vy(m/s) vz(m/s) sdvx sdvy sdvz sdvxy sdvyz sdvzx"
)
LAT, LON, HEIGHT = 40.0966268, -105.1474483, 1601.474
VALUES = (
    f"{LAT} {LON} {HEIGHT} 2 21 3.0 4.0 5.0 1.0 -2.0 0.5 0.0 3.2 "
    "1.0 2.0 -3.0 0.3 0.4 0.5 0.1 -0.2 0.05"
)
# covariance of north, east, up from signed roots
COV_NEU = np.array([[9.0, 1.0, 0.25], [1.0, 16.0, -4.0], [0.25, -4.0, 25.0]])


def write(folder: Path, *lines: str) -> Path:
    file = folder / "rover.pos"
    file.write_text("\n".join(lines) + "\n")
    return file


def test_geodetic_solution_with_velocity(tmp_path):
    file = write(tmp_path, "% program   : RTKPOST", GEODETIC, f"2025/07/08 19:34:18.499 {VALUES}")
    assert is_pos(file)
    fixes = read_pos(file)
    assert fixes.time[0] == pytest.approx(gpstime.from_calendar(2025, 7, 8, 19, 34, 18.499))
    C_en = C_en_at(np.radians(LAT), np.radians(LON))
    flip = np.diag([1.0, 1.0, -1.0])  # up to down
    np.testing.assert_allclose(
        fixes.pos_e[0], lla_to_ecef(np.radians(LAT), np.radians(LON), HEIGHT), atol=1e-8
    )
    np.testing.assert_allclose(
        C_en.T @ fixes.pos_cov_e[0] @ C_en, flip @ COV_NEU @ flip, atol=1e-12
    )
    np.testing.assert_allclose(C_en.T @ fixes.vel_e[0], [1.0, 2.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(
        C_en.T @ fixes.vel_cov_e[0] @ C_en, 0.01 * flip @ COV_NEU @ flip, atol=1e-12
    )
    assert (fixes.quality[0], fixes.satellites[0]) == ("float", 21)


def test_ecef_solution_is_the_same_fix(tmp_path):
    """Rotate the covariance to ECEF, print it as RTKLIB would, read it back."""
    geodetic = read_pos(write(tmp_path, GEODETIC, f"2025/07/08 19:34:18.499 {VALUES}"))

    def roots(cov):
        pairs = [cov[0, 0], cov[1, 1], cov[2, 2], cov[0, 1], cov[1, 2], cov[2, 0]]
        return " ".join(f"{np.sign(c) * np.sqrt(abs(c)):.12f}" for c in pairs)

    pos = " ".join(f"{x:.9f}" for x in geodetic.pos_e[0])
    vel = " ".join(f"{x:.12f}" for x in geodetic.vel_e[0])
    row = (
        f"2025/07/08 19:34:18.499 {pos} 1 7 {roots(geodetic.pos_cov_e[0])} 0 0 "
        f"{vel} {roots(geodetic.vel_cov_e[0])}"
    )
    ecef = read_pos(write(tmp_path, ECEF, row))
    np.testing.assert_allclose(ecef.pos_cov_e, geodetic.pos_cov_e, atol=1e-9)
    np.testing.assert_allclose(ecef.vel_cov_e, geodetic.vel_cov_e, atol=1e-9)
    np.testing.assert_allclose(ecef.vel_e, geodetic.vel_e, atol=1e-11)
    assert ecef.quality[0] == "fixed"


def test_week_and_seconds_equal_the_calendar(tmp_path):
    time = gpstime.from_calendar(2025, 7, 8, 19, 34, 18.5)
    week, sow = gpstime.to_week_sow(time)
    a = read_pos(write(tmp_path, GEODETIC, f"2025/07/08 19:34:18.500 {VALUES}"))
    b = read_pos(write(tmp_path, GEODETIC, f"{week} {sow:.3f} {VALUES}"))
    c = read_pos(write(tmp_path, GEODETIC, f"2025/07/08 19:34:18.5 {VALUES}"))
    np.testing.assert_allclose([a.time[0], b.time[0], c.time[0]], time, atol=1e-6)


@pytest.mark.parametrize(("year", "leap"), [(2025, 18), (2016, 17), (2013, 16)])
def test_utc_gets_the_leap_seconds_of_its_day(tmp_path, year, leap):
    rows = [
        h + f"\n{year}/01/08 00:00:00.000 {VALUES}"
        for h in (GEODETIC, GEODETIC.replace("GPST", "UTC "))
    ]
    gpst, utc = (read_pos(write(tmp_path, row)).time[0] for row in rows)
    assert utc - gpst == leap


@pytest.mark.parametrize("south", [False, True])
def test_degrees_minutes_seconds_are_the_same_place(tmp_path, south):
    """Half a degree from the equator: the sign stands before a zero."""
    lat, lon = (-0.5050123 if south else 0.5050123), -105.1474483

    def dms(angle):
        whole, rest = divmod(abs(angle), 1.0)
        minutes, seconds = divmod(rest * 60.0, 1.0)
        return f"{'-' if angle < 0 else ''}{whole:.0f} {minutes:02.0f} {seconds * 60.0:09.6f}"

    header = GEODETIC.replace("(deg)", "(d'\")")
    rest = VALUES.split(" ", 2)[2]
    stamp = "2025/07/08 19:34:18.499"
    a = read_pos(write(tmp_path, GEODETIC, f"{stamp} {lat} {lon} {rest}"))
    b = read_pos(write(tmp_path, header, f"{stamp} {dms(lat)} {dms(lon)} {rest}"))
    np.testing.assert_allclose(a.pos_e, b.pos_e, atol=1e-4)
    np.testing.assert_allclose(a.pos_cov_e, b.pos_cov_e, atol=1e-7)
    with pytest.raises(DataError, match=r"rover\.pos:2: latitude: .*found 61"):
        read_pos(write(tmp_path, header, f"{stamp} 0 61 00.0 {dms(lon)} {rest}"))


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_field_separators(tmp_path, separator):
    stamp, values = "2025/07/08 19:34:18.499", VALUES.split()
    plain = read_pos(write(tmp_path, GEODETIC, f"{stamp} {VALUES}"))
    header = "%  GPST" + separator + separator.join(GEODETIC.split()[2:])
    found = read_pos(write(tmp_path, header, separator.join([stamp, *values])))
    np.testing.assert_array_equal(found.pos_e, plain.pos_e)
    np.testing.assert_array_equal(found.vel_cov_e, plain.vel_cov_e)


def test_ecef_position_with_velocity_north_east_up_and_the_other_way_round(tmp_path):
    """Velocity axes follow their own columns, not those of the position."""
    stamp = "2025/07/08 19:34:18.499"
    plain = read_pos(write(tmp_path, GEODETIC, f"{stamp} {VALUES}"))
    x = " ".join(f"{v:.9f}" for v in plain.pos_e[0])
    header = ECEF.split(" vx")[0] + " vn(m/s) ve(m/s) vu(m/s) sdvn sdve sdvu sdvne sdveu sdvun"
    velocity = " ".join(VALUES.split()[-9:])
    mixed = read_pos(write(tmp_path, header, f"{stamp} {x} 2 21 3 4 5 1 1 1 0 3 {velocity}"))
    np.testing.assert_allclose(mixed.vel_e, plain.vel_e, atol=1e-9)
    np.testing.assert_allclose(mixed.vel_cov_e, plain.vel_cov_e, atol=1e-9)

    header = GEODETIC.split(" vn")[0] + " vx(m/s) vy(m/s) vz(m/s) sdvx sdvy sdvz sdvxy sdvyz sdvzx"
    vel = " ".join(f"{v:.12f}" for v in plain.vel_e[0])
    position = " ".join(VALUES.split()[:-9])
    mixed = read_pos(write(tmp_path, header, f"{stamp} {position} {vel} 1 1 1 0 0 0"))
    np.testing.assert_allclose(mixed.vel_e, plain.vel_e, atol=1e-9)
    np.testing.assert_array_equal(mixed.vel_cov_e[0], np.eye(3))


def test_position_only(tmp_path):
    header = " ".join(GEODETIC.split()[:14])
    values = " ".join(VALUES.split()[:13])
    fixes = read_pos(write(tmp_path, header + " ratio", f"2025/07/08 19:34:18.499 {values}"))
    assert np.isnan(fixes.vel_e).all()
    assert not fixes.has_velocity.any()
    assert np.linalg.eigvalsh(fixes.pos_cov_e[0]).min() > 0


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (GEODETIC.replace("GPST", "JST"), "expected GPST or UTC, found JST"),
        (GEODETIC.replace("latitude(deg)", "latitude(d'\")"), "expected latitude"),
        (GEODETIC.replace("vu(m/s)", "vz(m/s)"), "expected vn ve vu or vx vy vz"),
        (
            GEODETIC.replace("latitude(deg) longitude(deg) height(m)", "e-baseline(m) n-b u-b"),
            "llh",
        ),
        ("% (lat/lon/height=WGS84/geodetic,Q=1:fix)\n" + GEODETIC, "above the geoid"),
        ("% nothing", "no column header"),
    ],
)
def test_what_cannot_be_a_position_is_refused(tmp_path, header, message):
    with pytest.raises(DataError, match=message) as caught:
        read_pos(write(tmp_path, header, f"2025/07/08 19:34:18.499 {VALUES}"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (f"2025/07/08 19:34:18.400 {VALUES}", "increasing"),
        (f"2025/13/08 19:34:19.499 {VALUES}", "time: expected as"),
        (f"2025/07/08 19:34:19.499 {VALUES} 1", "expected 24 columns"),
        (f"2025/07/08 19:34:19.499 nan{VALUES[10:]}", "finite"),
    ],
)
def test_a_bad_row_is_refused_with_its_line(tmp_path, row, message):
    good = f"2025/07/08 19:34:18.499 {VALUES}"
    with pytest.raises(DataError, match=rf"rover\.pos:3: .*{message}"):
        read_pos(write(tmp_path, GEODETIC, good, row))


def test_the_rtk_drive(data_dir):
    fixes = read_pos(data_dir / "rtklibexplorer-drive/gnss_1934_sf.pos")
    assert len(fixes) == 2197
    assert (fixes.quality == "fixed").mean() > 0.99
    # velocities are those of the positions: trapezoid over 0.25 s against 1 cm positions
    between = np.diff(fixes.pos_e, axis=0) / np.diff(fixes.time)[:, None]
    error = between - 0.5 * (fixes.vel_e[1:] + fixes.vel_e[:-1])
    assert np.sqrt(np.mean(error**2)) < 0.1
