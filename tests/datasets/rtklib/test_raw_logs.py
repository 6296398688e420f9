"""Receivers' own logs give what their RINEX twins give; mixtures and damage cost what they must."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from certnav.datasets.cache import kept_in
from certnav.datasets.great.reader import read_great
from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load
from certnav.datasets.own.declare import draft_declaration
from certnav.datasets.own.drafted import declaration_of
from certnav.datasets.receivers.raw_frames import find_frames
from certnav.datasets.rtklib import (
    given_files,
    is_raw_log,
    raw_log,
    read_observations,
    relative_positions,
    single_point,
)
from certnav.datasets.rtklib.satellites import load_navigation, satellite_name
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.filters.errors import ConfigError, DataError
from certnav.velocity.least_squares import doppler_velocities
from oracles import receiver_logs as logs

WAVELENGTH = 299792458.0 / 1575.42e6
CONFIG = SimulationConfig(duration=60.0, seed=5, density="open", base_distance_m=3000.0)
NMEA = b"$GNGGA,021000.00,3031.7,N,11421.4,E,1,10,0.9,20.0,M,,,,*5A\r\n"


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    return read_great(simulate_folder(CONFIG, tmp_path_factory.mktemp("raw") / "drive"))


@pytest.fixture(scope="module")
def epochs(drive):
    return logs.epochs_of(drive.observations)


@pytest.fixture(scope="module")
def ephemerides(drive, epochs):
    """The ephemerides in force, by satellite."""
    nav, at = load_navigation(drive.navigation), epochs[0][0] + 315964800.0
    found = [(satellite_name(nav.eph[k].sat), nav.eph[k]) for k in range(nav.n)]
    near = {}
    for name, e in sorted(found, key=lambda pair: -abs(pair[1].toe.time - at)):
        near[name] = e
    seen = set(drive.observations.sat.tolist())
    return [(name, e) for name, e in near.items() if name in seen]


@pytest.fixture(scope="module")
def frames(epochs, ephemerides):
    return logs.ubx_log(epochs, ephemerides)


@pytest.fixture(scope="module")
def twin(epochs, tmp_path_factory):
    file = tmp_path_factory.mktemp("twin") / "twin.obs"
    file.write_text(logs.rinex(epochs))
    return file


def written(folder: Path, name: str, parts: list[bytes]) -> Path:
    (folder / name).write_bytes(b"".join(parts))
    return folder / name


def solved(observations, navigation):
    read = read_observations(observations, navigation)
    spp = single_point(read, navigation)
    velocities = doppler_velocities(read, spp.fixes.pos_e[0])
    return read, spp.fixes, np.array([v.vel_e for v in velocities if v.ok])


@pytest.mark.parametrize("kind", ["ubx", "sbf", "novatel"])
def test_a_log_and_its_twin_have_one_solution(tmp_path, twin, epochs, ephemerides, kind):
    """The same numbers, in the maker's binary and in RINEX: positions, velocities, carriers."""
    parts = {
        "ubx": lambda: logs.ubx_log(epochs, ephemerides),
        "sbf": lambda: logs.sbf_log(epochs, ephemerides, WAVELENGTH),
        "novatel": lambda: logs.novatel_log(epochs, ephemerides),
    }[kind]()
    log = raw_log(written(tmp_path, f"drive.{kind}", parts))
    read, fixes, velocities = solved(log.observations, [log.navigation])
    twins, expected, twin_velocities = solved(twin, [log.navigation])
    assert len(read) == len(twins) == sum(len(rows) for _, rows in epochs)
    np.testing.assert_allclose(fixes.pos_e, expected.pos_e, rtol=0, atol=1e-6)
    np.testing.assert_allclose(velocities, twin_velocities, rtol=0, atol=1e-6)
    np.testing.assert_allclose(read.carrier, twins.carrier, rtol=0, atol=1.01e-3)
    np.testing.assert_array_equal(read.cn0, twins.cn0)


def test_pyubx2_reads_what_was_meant(epochs, ephemerides):
    """The log that the tests write is what u-blox's messages are, says another reader of them."""
    pyubx2 = pytest.importorskip("pyubx2")
    time, rows = epochs[7]
    raw = logs.rawx(time, rows)
    m = pyubx2.UBXReader.parse(raw)
    assert (m.identity, m.numMeas, m.week) == ("RXM-RAWX", len(rows), int(time // 604800))
    assert m.rcvTow == time % 604800 and m.leapS == 18
    for k, row in enumerate(rows, start=1):
        names = ("prMes", "cpMes", "doMes", "gnssId", "svId", "sigId", "cno", "prValid", "halfCyc")
        found = [getattr(m, f"{name}_{k:02d}") for name in names]
        expected = [row.pseudorange, row.carrier, np.float32(row.doppler), 0, int(row.sat[1:]), 0]
        assert found[:6] == pytest.approx(expected, rel=1e-12)
        assert found[6:] == [row.cn0, 1, 1]
    again = pyubx2.UBXMessage(b"\x02", b"\x15", pyubx2.GET, payload=raw[6:-2])
    assert again.serialize() == raw
    name, ephemeris = ephemerides[0]
    words = [w << 6 for w in logs.lnav(ephemeris, 1, time)]
    m = pyubx2.UBXReader.parse(logs.sfrbx(name, words))
    assert (m.identity, m.gnssId, m.svId, m.numWords) == ("RXM-SFRBX", 0, int(name[1:]), 10)
    said = [getattr(m, f"dwrd_{k:02d}") for k in range(1, 11)]
    assert said == words


def test_the_ephemerides_of_a_log_are_those_that_were_sent(tmp_path, drive, frames):
    """The message holds them in steps; orbits are metres, steps centimetres."""
    log = raw_log(written(tmp_path, "drive.ubx", frames))
    sent, read = (
        read_observations(log.observations, n) for n in (drive.navigation, [log.navigation])
    )
    assert read.usable.all()
    assert np.abs(read.sat_pos_e - sent.sat_pos_e).max() < 0.05
    assert np.abs(read.sat_clock - sent.sat_clock).max() < 0.1


def test_what_was_found_is_said(tmp_path, frames, epochs):
    first = len(frames) - len(epochs)
    cut = [f for k, f in enumerate(frames) if not first + 20 <= k < first + 24]
    gone = sum(len(rows) for _, rows in epochs[20:24])
    text = raw_log(written(tmp_path, "drive.ubx", cut)).notes[0]
    rows = sum(len(rows) for _, rows in epochs)
    satellites = {r.sat for _, rows in epochs for r in rows}
    assert text.startswith("drive.ubx: u-blox UBX, 58 RXM-RAWX; 57 epochs at 1 Hz with 1 gaps, the")
    assert f"signals G 1C; ephemerides G {len(satellites)};" in text
    assert text.endswith(f"of {rows - gone} phases; 0 losses of lock")
    open_half = [*frames[:first], *(logs.rawx(*e, half_cycles=True) for e in epochs)]
    text = raw_log(written(tmp_path, "h.ubx", open_half)).notes[0]
    assert f"half cycles unresolved in 100.0 % of {rows} phases" in text


def test_among_nmea_and_rtcm_a_log_is_the_same(tmp_path, frames):
    rtcm = logs.rtcm3(bytes.fromhex("3ed00003000000000000000000000000000000"))
    mixed = [part for frame in frames for part in (frame, NMEA, rtcm)]
    plain = raw_log(written(tmp_path, "a.ubx", frames))
    other = raw_log(written(tmp_path, "b.ubx", mixed))
    assert (
        other.observations.read_text().partition("END OF")[2]
        == (plain.observations.read_text().partition("END OF")[2])
    )
    assert f"{len(frames)} RTCM 3 messages passed over" in other.notes[0]


def test_one_damaged_message_costs_one_epoch_and_a_cut_costs_the_last(tmp_path, frames, epochs):
    flipped = bytearray(frames[-10])
    flipped[40] ^= 1
    parts = [*frames[:-10], bytes(flipped), *frames[-9:-1], frames[-1][:-7]]
    log = raw_log(written(tmp_path, "a.ubx", parts))
    assert "; 2 damaged messages left out" in log.notes[0]
    assert log.observations.read_text().count("\n> ") == len(epochs) - 2


def test_checksums_find_any_single_error(frames, epochs, ephemerides):
    samples = [
        frames[-1], logs.sbf_log(epochs[:1], ephemerides, WAVELENGTH)[-1],
        logs.novatel_log(epochs[:1], ephemerides)[-1], logs.rtcm3(b"\x3e\xd0" + bytes(range(60))),
    ]  # fmt: skip
    rng = np.random.default_rng(1)
    for frame in samples:
        assert [f.stop for f in find_frames(b"x" + frame).frames] == [1 + len(frame)]
        for at in rng.integers(0, len(frame), 40):
            broken = bytearray(frame)
            broken[at] ^= 1 << int(rng.integers(8))
            assert not any(f.stop - f.start == len(frame) for f in find_frames(broken).frames)


def test_a_log_without_raw_messages_says_which_to_switch_on(tmp_path):
    pvt = logs.ubx(0x01, 0x07, bytes(92))
    for name, parts, words in (
        ("a.ubx", [pvt], "UBX-RXM-RAWX and UBX-RXM-SFRBX"),
        ("a.sbf", [logs.sbf(4007, bytes(88))], "SBF MeasEpoch with GPSRawCA"),
        ("a.gps", [logs.novatel(42, 1.28e9, bytes(72))], "RANGEB"),
    ):
        with pytest.raises(DataError, match=f"none of raw observations.*switch on.*{words}") as e:
            raw_log(written(tmp_path, name, parts))
        assert "\n" not in str(e.value)
    with pytest.raises(DataError, match="neither RINEX nor a receiver's log"):
        raw_log(written(tmp_path, "a.bin", [bytes(1000)]))
    with pytest.raises(DataError, match="hold no observation"):
        raw_log(written(tmp_path, "b.ubx", [logs.rawx(1.28e9, [])]))


def test_a_log_is_taken_wherever_rinex_is(tmp_path, drive, frames, twin):
    import gzip

    log = written(tmp_path, "drive.ubx", frames)
    packed = tmp_path / "drive.ubx.gz"
    packed.write_bytes(gzip.compress(log.read_bytes()))
    assert is_raw_log(log) and not is_raw_log(twin)
    for file in (log, packed):
        given = given_files(file)
        assert given.observations.suffix == ".obs" and len(given.navigation) == 1
    assert given_files(twin, [log]).navigation == given_files(log).navigation
    base = given_files(log).observations  # a fix of the receiver's is no base position
    with pytest.raises(DataError, match="no position of the base station"):
        relative_positions(drive.rover_file, base, drive.navigation)
    alone = load(log)
    assert alone.imu is None and alone.rover_file == given_files(log).observations
    assert alone.logs and alone.logs[0].startswith("drive.ubx: u-blox UBX")
    with pytest.raises(DataError, match=r"no ephemerides.*data\.navigation"):
        load(written(tmp_path, "bare.ubx", frames[-60:]))


def test_text_before_the_first_message_may_be_long(tmp_path, frames):
    """A receiver writes NMEA until it is told otherwise: an hour of it is a megabyte."""
    late = written(tmp_path, "late.ubx", [NMEA * 5000, *frames])
    assert is_raw_log(late) and len(given_files(late).navigation) == 1
    assert 'observations = "late.ubx"' in draft_declaration([late])
    assert not is_raw_log(written(tmp_path, "talk.nmea", [NMEA * 5000]))


@pytest.mark.parametrize("kind", ["ubx", "sbf", "novatel"])
def test_parts_in_any_order_are_one_log(tmp_path, epochs, ephemerides, kind):
    """As a folder lists them, or twice: the same observations, and what was done is said."""
    make = {
        "ubx": lambda e: logs.ubx_log(e, ephemerides)[1:],
        "sbf": lambda e: logs.sbf_log(e, ephemerides, WAVELENGTH),
        "novatel": lambda e: logs.novatel_log(e, ephemerides),
    }[kind]
    plain = raw_log(written(tmp_path, f"plain.{kind}", make(epochs)))
    parts = [make(epochs[40:]), make(epochs[:20]), make(epochs[15:40])]
    mixed = raw_log(written(tmp_path, f"mixed.{kind}", [f for part in parts for f in part]))
    assert "moved" not in plain.notes[0]
    assert mixed.observations.read_text().partition("END OF")[2].split("\n", 1)[1].count("> ") == (
        len(epochs)
    )
    one, other = (read_observations(x.observations, [x.navigation]) for x in (plain, mixed))
    np.testing.assert_array_equal(one.time, other.time)
    np.testing.assert_array_equal(one.pseudorange, other.pseudorange)
    assert "that were behind later ones put before them; 5 epochs of a time" in mixed.notes[0]


def test_errors_name_the_file_that_was_given(tmp_path, drive, frames):
    """Not the copy that was unpacked or converted of it."""
    import gzip

    log = written(tmp_path, "base.ubx", frames)
    base = given_files(log).observations
    with pytest.raises(DataError, match=rf"^{log}: no position of the base.*its log tells none"):
        relative_positions(drive.rover_file, base, drive.navigation)
    cut = tmp_path / "cut.obs.gz"
    cut.write_bytes(gzip.compress(drive.rover_file.read_bytes()[:20000]))
    with pytest.raises(DataError, match=rf"^{cut}:\d+: "):
        read_observations(given_files(cut).observations, drive.navigation)


def test_conversion_is_kept(tmp_path, frames, monkeypatch):
    log = written(tmp_path, "drive.ubx", frames)
    with kept_in(tmp_path / "kept"):
        first = raw_log(log)
    monkeypatch.setattr("certnav.datasets.rtklib.logs.raw_logs._convert", None)
    moved = tmp_path / "moved.ubx"
    moved.write_bytes(log.read_bytes())
    with kept_in(tmp_path / "kept"):
        again = raw_log(moved)
    assert again.observations.read_bytes() == first.observations.read_bytes()


def test_a_drive_is_drafted_from_a_log_and_an_imu(tmp_path, drive, frames):
    log = written(tmp_path, "drive.ubx", frames)
    imu = tmp_path / "imu.csv"
    rows = ["t,gx,gy,gz,ax,ay,az"] + [
        ",".join(f"{v:.8f}" for v in (t % 604800.0, *g, *a))
        for t, g, a in zip(
            drive.imu.time, np.degrees(drive.imu.gyro_b), drive.imu.accel_b, strict=True
        )
    ]
    imu.write_text("\n".join(rows))
    draft = draft_declaration([log, imu])
    assert "week = 2129: drive.ubx begins at second 180600 of it" in draft
    assert 'observations = "drive.ubx"\nnavigation = ["drive.ubx"]' in draft
    with pytest.raises(ConfigError, match=r"drafted for drive\.ubx and imu\.csv; \d+ answers"):
        declaration_of(log, imu)
    with pytest.raises(ConfigError, match="is still"):
        declaration_of(log, imu)
    file = tmp_path / "drive.toml"
    answers = {
        "time_scale": '"gps-sow"\nweek = 2129', "axes": '"FRD"', "preset": '"adis16470"',
        "lever_frd_m": "[-0.65, -0.05, -0.15]", "mounting_rpy_deg": "[0, 0, 0]",
        "gyro_unit": '"deg/s"',
    }  # fmt: skip
    text = file.read_text()
    for key, value in answers.items():
        text = text.replace(f'{key} = "?"', f"{key} = {value}")
    file.write_text(text)
    assert declaration_of(log, imu) == file
    sequence = load(file)
    assert sequence.logs and sequence.navigation == given_files(log).navigation
    assert np.unique(sequence.observations.time).size == 61
    with pytest.raises(ConfigError, match=r"\[imu\] file: expected .*other\.csv"):
        (tmp_path / "other.csv").write_text(imu.read_text())
        declaration_of(log, tmp_path / "other.csv")


def test_a_receivers_own_fixes_go_beside_an_imu_likewise(tmp_path):
    imu = tmp_path / "imu.csv"
    imu.write_text("t,gx,gy,gz,ax,ay,az\n" + "".join(f"{k},0,0,0,0,0,-9.8\n" for k in range(99)))
    log = written(tmp_path, "talk.nmea", [NMEA * 50])
    with pytest.raises(ConfigError, match="drafted for"):
        declaration_of(log, imu)
    file = tmp_path / "talk.toml"
    text = file.read_text()
    assert '[gnss]\nfile = "talk.nmea"' in text
    file.write_text(text.replace('"?"', '"FRD"'))
    assert declaration_of(log, imu) == file
    with pytest.raises(DataError, match="found a folder"):
        declaration_of(tmp_path, imu)


def test_a_base_in_rtcm_is_its_rinex(tmp_path, drive):
    """Its date is that of its ephemerides, or of the rover; its place that of its message 1006."""
    base = drive.base[0]
    parts = logs.rtcm3_log(str(base), str(drive.navigation[0]), {"G": 1077})
    log = raw_log(written(tmp_path, "base.rtcm3", parts))
    assert "RTCM 3, 61 1077; 61 epochs at 1 Hz" in log.notes[0]
    expected = relative_positions(drive.rover_file, base, drive.navigation)
    found = relative_positions(drive.rover_file, log.observations, drive.navigation)
    np.testing.assert_allclose(found.base_pos_e, expected.base_pos_e, atol=1.01e-4)
    np.testing.assert_array_equal(found.fixes.quality, expected.fixes.quality)
    assert "fixed" in found.fixes.quality
    np.testing.assert_allclose(found.fixes.pos_e, expected.fixes.pos_e, atol=0.02)
    bare = [f for f in parts if int.from_bytes(f[3:5], "big") >> 4 != 1019]
    undated = written(tmp_path, "undated.rtcm3", bare)
    with pytest.raises(DataError, match=r"RTCM 3 without a date.*1019"):
        raw_log(undated)
    dated = raw_log(undated, near=drive.span[0] + 1e5)
    assert dated.navigation is None
    assert (
        dated.observations.read_text().partition("END OF")[2]
        == (log.observations.read_text().partition("END OF")[2])
    )


def test_a_great_folder_with_the_receivers_log_needs_no_rinex(tmp_path, drive, epochs, ephemerides):
    """The Septentrio's own SBF in GNSS/Rover, its ephemerides where there are no others."""
    import shutil

    folder = tmp_path / "drive"
    shutil.copytree(drive.rover_file.parents[2], folder)
    (folder / "GNSS/Rover" / drive.rover_file.name).unlink()
    shutil.rmtree(folder / "GNSS/Product")
    written(folder / "GNSS/Rover", "SEPT3010.sbf", logs.sbf_log(epochs, ephemerides, WAVELENGTH))
    found = read_great(folder)
    assert len(found.observations) == sum(len(rows) for _, rows in epochs)
    assert [f.suffix for f in found.navigation] == [".nav"] and found.observations.usable.all()
    assert found.rover_file.name == "SEPT3010.obs"


RAWX = """float64 rcvTOW
uint16 week
int8 leapS
uint8 numMeas
uint8 recStat
uint8 version
uint8[2] reserved1
ublox_msgs/RxmRAWX_Meas[] meas
"""
MEAS = """float64 prMes
float64 cpMes
float32 doMes
uint8 gnssId
uint8 svId
uint8 reserved0
uint8 freqId
uint16 locktime
int8 cno
uint8 prStdev
uint8 cpStdev
uint8 doStdev
uint8 trkStat
uint8 reserved1
"""
SFRBX = """uint8 gnssId
uint8 svId
uint8 reserved0
uint8 freqId
uint8 numWords
uint8 chn
uint8 version
uint8 reserved1
uint32[] dwrd
"""


def test_a_bag_of_raw_messages_is_the_log_they_were(tmp_path, frames):
    """ublox_msgs as the ROS driver writes them; the log that comes out is the one that went in."""
    import struct

    pytest.importorskip("rosbags")
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    for text, name in ((MEAS, "RxmRAWX_Meas"), (RAWX, "RxmRAWX"), (SFRBX, "RxmSFRBX")):
        store.register(get_types_from_msg(text, f"ublox_msgs/msg/{name}"))
    kinds = {number: f"ublox_msgs/msg/{name}" for number, name in ((0x15, "RxmRAWX"),
                                                                   (0x13, "RxmSFRBX"))}  # fmt: skip
    with Writer(tmp_path / "raw.bag") as writer:
        topics = {n: writer.add_connection(f"/ublox/{n}", k, typestore=store)
                  for n, k in kinds.items()}  # fmt: skip
        for k, frame in enumerate(frames):
            number, body = frame[3], frame[6:-2]
            make = store.types[kinds[number]]
            if number == 0x15:
                head = struct.unpack("<dHbBBB", body[:14])
                meas = [
                    store.types["ublox_msgs/msg/RxmRAWX_Meas"](
                        *struct.unpack("<ddfBBBBHbBBBBB", body[at : at + 32])
                    )
                    for at in range(16, len(body), 32)
                ]
                message = make(*head, np.zeros(2, np.uint8), meas)
            else:
                words = np.frombuffer(body[8:], "<u4")
                message = make(*body[:8], words)
            raw = store.serialize_ros1(message, kinds[number])
            writer.write(topics[number], 10**18 + k, raw)
    log = written(tmp_path, "raw.ubx", frames)
    expected, found = given_files(log), given_files(tmp_path / "raw.bag")
    for mine, theirs in zip(found.navigation, expected.navigation, strict=True):
        assert (
            mine.read_bytes().partition(b"END OF")[2]
            == (theirs.read_bytes().partition(b"END OF")[2])
        )
    assert (
        found.observations.read_bytes().partition(b"END OF")[2]
        == (expected.observations.read_bytes().partition(b"END OF")[2])
    )
