"""UBX and NMEA logs made by hand: the same fix comes out that went in."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from certnav.datasets import gpstime
from certnav.datasets.formats.nmea import read_nmea
from certnav.datasets.formats.receiver_logs import in_order
from certnav.datasets.formats.ubx import read_ubx
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
    assert "left out: 1 without a 3-D fix, 1 repeated;" in notes[0]


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
    assert "sentences left out: 1 without a fix;" in notes[0]


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
    with pytest.raises(
        DataError, match=r"no GGA or GNS sentence with a fix found \(1 without a fix\)"
    ):
        read_nmea(file)


def written(tmp_path, *messages):
    file = tmp_path / "a.ubx"
    file.write_bytes(b"".join(messages))
    return file


def test_ubx_logs_put_together_lose_their_overlap_and_say_so(tmp_path):
    rows = [nav_pvt(k) for k in (*range(20), *range(17, 40))]
    fixes, notes = read_ubx(written(tmp_path, *rows))
    np.testing.assert_allclose(np.diff(fixes.time), 1.0)
    assert fixes.time[-1] == EPOCH + 39
    assert "a.ubx: 40 fixes; messages left out: 3 out of order in time" in notes[0]


def test_ubx_with_a_clock_ahead_until_the_first_fix(tmp_path):
    """Not the many right stamps after it are left out, but the few wrong ones before."""
    ahead = [nav_pvt(k, iTOW=round((EPOCH % 604800 + k + 3600) * 1e3), hour=20) for k in range(3)]
    rows = [nav_pvt(k) for k in range(3, 40)]
    fixes, notes = read_ubx(written(tmp_path, *ahead, *rows))
    np.testing.assert_allclose(fixes.time, EPOCH + np.arange(3, 40))
    assert "left out: 3 out of order in time" in notes[0]


def test_ubx_logs_in_the_wrong_order_are_refused(tmp_path):
    rows = [nav_pvt(k) for k in (*range(30, 59), *range(30))]
    message = r"a.ubx: 29 of 59 NAV-PVT .*step back is 58.0 s at fix 30 — .*order of time"
    with pytest.raises(DataError, match=message):
        read_ubx(written(tmp_path, *rows))


def test_in_order_keeps_the_most_there_can_be():
    rng = np.random.default_rng(5)
    for _ in range(200):
        time = rng.integers(0, 12, 8).astype(float)
        keep = in_order(time)
        assert (np.diff(time[keep]) > 0).all()
        best = max(
            sum(pick)
            for pick in itertools.product((False, True), repeat=8)
            if (np.diff(time[list(pick)]) > 0).all()
        )
        assert keep.sum() == best


def test_ubx_accuracy_of_zero_is_unknown(tmp_path):
    rows = [nav_pvt(k, **({"hAcc": 0} if k == 2 else {"sAcc": 0} if k == 4 else {}))
            for k in range(6)]  # fmt: skip
    file = written(tmp_path, *rows)
    fixes, notes = read_ubx(file)
    np.testing.assert_allclose(fixes.time - EPOCH, [0, 1, 3, 4, 5])
    np.testing.assert_array_equal(fixes.has_velocity, [True, True, True, False, True])
    assert "1 of unknown accuracy; 1 velocities of unknown accuracy left out" in notes[0]
    declared = {"position_sigma": np.array([3.0]), "velocity_sigma": np.array([0.2, 0.2, 0.4])}
    fixes, _ = read_ubx(file, **declared)
    assert len(fixes) == 6 and fixes.has_velocity.all()
    np.testing.assert_allclose(np.trace(fixes.pos_cov_e[2]), 27.0)
    np.testing.assert_allclose(np.trace(fixes.vel_cov_e[4]), 0.24)
    np.testing.assert_allclose(np.trace(fixes.pos_cov_e[1]), 0.25 * 2 + 0.81)


def test_ubx_that_never_tells_its_accuracy_is_asked_for_it(tmp_path):
    file = written(tmp_path, *(nav_pvt(k, vAcc=0xFFFFFFFF) for k in range(3)))
    with pytest.raises(ConfigError, match=r"a.ubx: .*position_sigma_m = \[2.0, 2.0, 4.0\]"):
        read_ubx(file)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"fixType": 0}, "without a 3-D fix"),
        ({"fixType": 1}, "without a 3-D fix"),  # dead reckoning only
        ({"fixType": 5}, "without a 3-D fix"),  # time only
        ({"gnssFixOk": 0}, "without a 3-D fix"),
        ({"numSV": 0}, "with a fix of no satellite"),
    ],
)
def test_ubx_messages_that_are_no_fixes_are_counted(tmp_path, change, why):
    fixes, notes = read_ubx(written(tmp_path, nav_pvt(0), nav_pvt(1, **change), nav_pvt(2)))
    np.testing.assert_allclose(fixes.time - EPOCH, [0, 2])
    assert f"left out: 1 {why};" in notes[0]


SIGMA = {"position_sigma": np.array([2.0, 2.0, 4.0])}


def nmea(tmp_path, *parts, **options):
    pytest.importorskip("pynmeagps")
    file = tmp_path / "a.nmea"
    file.write_bytes("".join(parts).encode())
    return read_nmea(file, **SIGMA, **options)


def without_separation(text):
    return sentence(text.strip()[1:-3].replace(f"{GEOID:.1f},M", ",M"))


def test_nmea_without_geoid_separation_asks_for_it(tmp_path):
    parts = [
        part for k in range(3)
        for part in (rmc(f"19340{k}.00"), without_separation(gga(f"19340{k}.00")))
    ]  # fmt: skip
    with pytest.raises(ConfigError, match=r"a.nmea: none of 3 .* under \[gnss\]: geoid_m ="):
        nmea(tmp_path, *parts)
    fixes, notes = nmea(tmp_path, *parts, geoid=GEOID)
    np.testing.assert_allclose(ecef_to_lla(fixes.pos_e)[:, 2], HEIGHT, atol=2e-3)
    assert "heights raised by -16.2 m, as declared" in notes[0]


def test_nmea_with_some_separations_takes_the_nearest(tmp_path):
    parts = [rmc("193400.00"), gga("193400.00"), without_separation(gga("193401.00"))]
    fixes, notes = nmea(tmp_path, *parts)
    np.testing.assert_allclose(ecef_to_lla(fixes.pos_e)[:, 2], HEIGHT, atol=2e-3)
    assert "(1 without: as at the nearest time)" in notes[0]


def test_nmea_separations_of_zero_throughout_are_doubted_aloud(tmp_path):
    zero = gga("193400.00").strip()[1:-3].replace(f"{GEOID:.1f},M", "0.0,M")
    _, notes = nmea(tmp_path, rmc("193400.00"), sentence(zero))
    assert "0.0 throughout: if the receiver does not know it, declare geoid_m" in notes[0]


def test_nmea_gns_alone(tmp_path):
    lat, lon = (f"{int(a)}{(a % 1) * 60:010.7f}" for a in (LAT, abs(LON)))
    place = f"{lat},N,{lon},W"
    rest = f"12,0.8,{HEIGHT - GEOID:.3f},{GEOID:.1f},,"
    parts = [rmc("193400.00")] + [
        sentence(f"GNGNS,19340{k}.00,{place},{mode},{rest}")
        for k, mode in enumerate(("AN", "RF", "NN", "DA"))
    ]
    fixes, notes = nmea(tmp_path, *parts)
    np.testing.assert_allclose(fixes.time - EPOCH, [0, 1, 3], atol=1e-6)
    assert list(fixes.quality) == ["single", "fixed", "dgps"]
    np.testing.assert_allclose(ecef_to_lla(fixes.pos_e)[:, 2], HEIGHT, atol=2e-3)
    assert "left out: 1 without a fix;" in notes[0]


def vtg(speed_kmh, course=45.0):
    return sentence(f"GNVTG,{course},T,,M,{speed_kmh / 1.852:.3f},N,{speed_kmh:.3f},K,A")


def zda(time):
    return sentence(f"GNZDA,{time},08,07,2025,00,00")


def test_nmea_speed_and_course_where_their_sigma_is_declared(tmp_path):
    """Five knots to the north-east, by RMC."""
    parts = [rmc("193400.00"), gga("193400.00"), gga("193401.00")]
    fixes, notes = nmea(tmp_path, *parts, velocity_sigma=np.array([0.2]))
    np.testing.assert_array_equal(fixes.has_velocity, [True, False])
    C_en = C_en_of(fixes.pos_e[0])
    expected = 5 * 1852 / 3600 * np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0])
    np.testing.assert_allclose(C_en.T @ fixes.vel_e[0], expected, atol=1e-9)
    sigma = np.sqrt(np.diag(C_en.T @ fixes.vel_cov_e[0] @ C_en))
    np.testing.assert_allclose(sigma, [0.2, 0.2, 1.0])
    assert "1 velocities from speed and course, zero down" in notes[0]
    fixes, notes = nmea(tmp_path, *parts)
    assert not fixes.has_velocity.any()
    assert "1 speeds and courses left out, for they have no σ: declare velocity_sigma" in notes[0]


@pytest.mark.parametrize("first", [True, False])
def test_nmea_vtg_belongs_to_its_own_epoch(tmp_path, first):
    """VTG has no time: it is of the epoch that begins with it, or of the sentence before."""
    parts = []
    for k in range(4):
        epoch = [zda(f"19340{k}.00"), gga(f"19340{k}.00")]
        parts += [vtg(10.0 + k), *epoch] if first else [*epoch, vtg(10.0 + k)]
    fixes, _ = nmea(tmp_path, *parts, velocity_sigma=np.array([0.2]))
    speed = np.linalg.norm(fixes.vel_e, axis=1)
    np.testing.assert_allclose(speed, (10.0 + np.arange(4)) / 3.6, atol=1e-4)


def test_nmea_standing_without_course_is_a_velocity_of_zero(tmp_path):
    still = sentence("GNRMC,193400.00,A,4005.7976,N,10508.8469,W,0.0,,080725,,,A")
    void = sentence("GNRMC,193401.00,V,,,,,5.0,45.0,080725,,,N")
    fixes, _ = nmea(
        tmp_path, still, gga("193400.00"), void, gga("193401.00"), velocity_sigma=np.array([0.2])
    )
    np.testing.assert_array_equal(fixes.vel_e[0], 0.0)
    assert not fixes.has_velocity[1]


def bare(text):
    return text[: text.index("*")] + "\r\n"


def test_nmea_without_checksums(tmp_path):
    parts = [bare(f(f"19340{k}.00")) for k in range(5) for f in (rmc, gga)]
    fixes, notes = nmea(tmp_path, *parts, bare(gga("193405.00"))[:60])
    np.testing.assert_allclose(fixes.time - EPOCH, np.arange(5), atol=1e-6)
    assert "1 damaged messages left out" in notes[0]  # the last is cut short


def test_nmea_a_sentence_without_checksum_among_others_is_damaged(tmp_path):
    parts = [f(f"19340{k}.00") for k in range(5) for f in (rmc, gga)]
    fixes, notes = nmea(tmp_path, *parts, bare(gga("193405.00")))
    assert len(fixes) == 5
    assert "1 damaged messages left out" in notes[0]


def test_nmea_behind_a_logger_s_own_stamps_and_in_utf_16(tmp_path):
    pytest.importorskip("pynmeagps")
    text = "".join(f"[12:00:0{k}] {f(f'19340{k}.00')}" for k in range(5) for f in (rmc, gga))
    file = tmp_path / "a.nmea"
    file.write_bytes(text.encode("utf-16"))
    fixes, _ = read_nmea(file, **SIGMA)
    np.testing.assert_allclose(fixes.time - EPOCH, np.arange(5), atol=1e-6)


def test_nmea_of_several_talkers_counts_one_position_a_time(tmp_path):
    other = sentence(gga("193400.00", alt=HEIGHT - GEOID + 9).strip()[1:-3].replace("GN", "GP"))
    later = sentence(gga("193401.00").strip()[1:-3].replace("GN", "GP"))
    for parts in ((other, gga("193400.00")), (gga("193400.00"), other)):
        fixes, notes = nmea(tmp_path, rmc("193400.00"), *parts, later)
        np.testing.assert_allclose(fixes.time - EPOCH, [0, 1], atol=1e-6)
        np.testing.assert_allclose(ecef_to_lla(fixes.pos_e)[:, 2], HEIGHT, atol=2e-3)
        assert "1 of a time there is already" in notes[0]


@pytest.mark.parametrize("quality", [0, 6, 7])
def test_nmea_estimated_and_typed_in_positions_are_no_fixes(tmp_path, quality):
    fixes, _ = nmea(tmp_path, rmc("193400.00"), gga("193400.00"), gga("193401.00", quality))
    assert len(fixes) == 1


def test_nmea_of_rmc_only_says_what_is_missing(tmp_path):
    with pytest.raises(DataError, match="enable GGA in the receiver: RMC holds no height"):
        nmea(tmp_path, rmc("193400.00"), rmc("193401.00"))
