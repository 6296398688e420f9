"""UBX and NMEA logs made by hand: the same fix comes out that went in."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets import gpstime
from certnav.datasets.formats.receiver_logs import read_nmea, read_ubx
from certnav.filters.earth import C_en_of, ecef_to_lla, lla_to_ecef
from certnav.filters.errors import ConfigError, DataError

#: 2025-07-08 19:34:00 UTC is 18 s later in GPS time.
EPOCH = gpstime.from_calendar(2025, 7, 8, 19, 34, 18.0)
LAT, LON, HEIGHT, GEOID = 40.0966268, -105.1474483, 1601.474, -16.2


def nav_pvt(k, **changes):
    pyubx2 = pytest.importorskip("pyubx2")
    values = {
        "iTOW": round((EPOCH % 604800.0 + k) * 1000), "year": 2025, "month": 7, "day": 8,
        "hour": 19, "min": 34, "second": k, "validDate": 1, "validTime": 1, "fullyResolved": 1,
        "fixType": 3, "gnssFixOk": 1, "carrSoln": 2, "numSV": 17, "lon": LON, "lat": LAT,
        "height": round(HEIGHT * 1e3), "hMSL": round((HEIGHT - GEOID) * 1e3), "hAcc": 500,
        "vAcc": 900, "velN": 1000 + k, "velE": -2000, "velD": 300, "sAcc": 250,
    }  # fmt: skip
    return pyubx2.UBXMessage("NAV", "NAV-PVT", pyubx2.GET, **{**values, **changes}).serialize()


def test_ubx(tmp_path):
    file = tmp_path / "a.ubx"
    messages = [nav_pvt(0), b"noise", nav_pvt(1), nav_pvt(1), nav_pvt(2, fixType=0), nav_pvt(3)]
    file.write_bytes(b"".join(messages))
    fixes, notes = read_ubx(file)
    np.testing.assert_allclose(fixes.time, EPOCH + np.array([0.0, 1.0, 3.0]), atol=1e-6)
    lla = ecef_to_lla(fixes.pos_e)
    np.testing.assert_allclose(np.degrees(lla[:, :2]), [[LAT, LON]] * 3, atol=2e-7)
    np.testing.assert_allclose(lla[:, 2], HEIGHT, atol=1e-3)
    C_en = C_en_of(fixes.pos_e[1])
    np.testing.assert_allclose(C_en.T @ fixes.vel_e[1], [1.001, -2.0, 0.3], atol=1e-9)
    np.testing.assert_allclose(
        C_en.T @ fixes.pos_cov_e[1] @ C_en, np.diag([0.25, 0.25, 0.81]), atol=1e-9
    )
    np.testing.assert_allclose(fixes.vel_cov_e[1], 0.0625 * np.eye(3), atol=1e-9)
    assert list(fixes.quality) == ["fixed"] * 3
    assert "1 messages without a 3-D fix left out, 1 repeated" in notes[0]


def test_ubx_over_the_end_of_the_week(tmp_path):
    """Saturday 23:59:50 UTC is already 8 s into the next GPS week."""
    file = tmp_path / "a.ubx"
    rows = [
        nav_pvt(0, iTOW=604799000, day=5, hour=23, min=59, second=41),
        nav_pvt(0, iTOW=8000, day=5, hour=23, min=59, second=50),
    ]
    file.write_bytes(b"".join(rows))
    fixes, _ = read_ubx(file)
    np.testing.assert_allclose(np.diff(fixes.time), 9.0)
    assert fixes.time[1] == gpstime.from_calendar(2025, 7, 6, 0, 0, 8.0)


def test_ubx_without_fixes(tmp_path):
    file = tmp_path / "a.ubx"
    file.write_bytes(nav_pvt(0, fixType=2))
    with pytest.raises(DataError, match=r"no NAV-PVT message with a 3-D fix found \(1 without\)"):
        read_ubx(file)


def sentence(body):
    check = 0
    for c in body:
        check ^= ord(c)
    return f"${body}*{check:02X}\r\n"


def gga(time, quality=4, alt=HEIGHT - GEOID):
    lat, lon = LAT, abs(LON)
    return sentence(
        f"GNGGA,{time},{int(lat)}{(lat % 1) * 60:010.7f},N,{int(lon)}{(lon % 1) * 60:010.7f},W,"
        f"{quality},12,0.8,{alt:.3f},M,{GEOID:.1f},M,,"
    )


def rmc(time, day="080725"):
    return sentence(f"GNRMC,{time},A,4005.7976,N,10508.8469,W,5.0,45.0,{day},,,A")


def gst(time, n=0.5, e=0.6, u=1.1):
    return sentence(f"GNGST,{time},1.0,,,,{n},{e},{u}")


def test_nmea_with_deviations(tmp_path):
    pytest.importorskip("pynmeagps")
    file = tmp_path / "a.nmea"
    parts = [
        gga("193400.00"), rmc("193400.00"), gst("193400.00"),  # date after the first position
        gga("193401.00"), rmc("193401.00"), gst("193401.00"), gga("193402.00", quality=0),
    ]  # fmt: skip
    file.write_bytes("".join(parts).encode())
    fixes, notes = read_nmea(file)
    np.testing.assert_allclose(fixes.time, EPOCH + np.array([0.0, 1.0]), atol=1e-6)
    np.testing.assert_allclose(
        fixes.pos_e[0], lla_to_ecef(*np.radians([LAT, LON]), HEIGHT), atol=2e-2
    )
    C_en = C_en_of(fixes.pos_e[0])
    np.testing.assert_allclose(
        C_en.T @ fixes.pos_cov_e[0] @ C_en, np.diag([0.25, 0.36, 1.21]), atol=1e-9
    )
    assert list(fixes.quality) == ["fixed", "fixed"]
    assert not fixes.has_velocity.any()
    assert "1 sentences without a fix" in notes[0]


def test_nmea_over_midnight(tmp_path):
    pytest.importorskip("pynmeagps")
    file = tmp_path / "a.nmea"
    file.write_bytes(
        "".join([rmc("235959.00"), gga("235959.00"), gga("000000.00"), rmc("000001.00", "090725"),
                 gga("000001.00")]).encode()
    )  # fmt: skip
    fixes, _ = read_nmea(file, position_sigma=np.array([2.0, 2.0, 4.0]))
    np.testing.assert_allclose(np.diff(fixes.time), 1.0)


def test_nmea_without_deviation_or_date(tmp_path):
    pytest.importorskip("pynmeagps")
    file = tmp_path / "a.nmea"
    file.write_bytes((rmc("193400.00") + gga("193400.00")).encode())
    with pytest.raises(ConfigError, match=r"position_sigma_m = \[2.0, 2.0, 4.0\]"):
        read_nmea(file)
    file.write_bytes(gga("193400.00").encode())
    with pytest.raises(DataError, match="no date found"):
        read_nmea(file)
    file.write_bytes((rmc("193400.00") + gga("193400.00", quality=0)).encode())
    with pytest.raises(DataError, match=r"no GGA sentence with a fix found \(1 without\)"):
        read_nmea(file)
