"""Damage that `scripts/fuzz.py` found readers to stumble over: now one line that says where.

Each case breaks one file of a sound recording and reads it as a user would.
"""

from __future__ import annotations

import gzip
import io
import shutil

import numpy as np
import pytest

from certnav.datasets.physics import gyro_unit_ratio
from certnav.datasets.series import ImuData
from certnav.datasets.text.rinex import check_observations
from certnav.datasets.text.tables import read_lines, read_table, sampling_note
from certnav.datasets.text.toml_files import parse_toml
from certnav.filters.errors import DataError, NavError
from oracles.readers import READ
from oracles.seeds import SHARED, make_seeds, seed_drive


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    """A small sound input for every reader: their folder, and what they are by name."""
    for package in ("pyubx2", "pynmeagps", "hatanaka"):
        pytest.importorskip(package)
    root = tmp_path_factory.mktemp("seeds")
    return root, {t.name: t for t in make_seeds(root, None)}


def lines(change):
    """Return a function of bytes from one of a list of lines."""

    def of(data):
        text = data.decode().split("\n")
        change(text)
        return "\n".join(text).encode()

    return of


def replaced(old, new):
    return lambda data: data.replace(old, new, 1)


def line(k, new):
    return lines(lambda text: text.__setitem__(k, new(text[k]) if callable(new) else new))


def array(change):
    def of(data):
        stream = io.BytesIO()
        np.save(stream, change(np.load(io.BytesIO(data))))
        return stream.getvalue()

    return of


def inside(change):
    return lambda data: gzip.compress(change(gzip.decompress(data)))


LONG = line(30, lambda s: s + " 1" * 20000)
WIDE = lines(lambda text: text.__setitem__(0, text[0] + ",x" * 100_000))
NARROW = lines(lambda text: text.__setitem__(0, text[0].partition(",")[2]))
POSE, GNSS = "global_pose", "processed_log/GNSS"
DIRECTORY = object()

CASES = [
    # folders in the place of files
    ("rtklib_pos_llh", "a.pos", DIRECTORY, r"a\.pos: expected a file, found a folder"),
    ("ubx", "a.ubx", DIRECTORY, "expected a file, found a folder"),
    ("nmea", "a.nmea", DIRECTORY, "expected a file, found a folder"),
    ("imu_text", "imu.txt", DIRECTORY, "expected a file, found a folder"),
    ("rtklibexplorer", "imu_1.csv.tag", DIRECTORY, "expected a file, found a folder"),
    ("kfgins", "options.yaml", DIRECTORY, "lever arm IMU→antenna not given"),
    # lines that no table has
    ("imu_text", "imu.txt", LONG, r"imu\.txt:31: expected a table, found a line of 40\d+ char"),
    ("smartloc", "RXM-RAWX.csv", line(9, lambda s: s + "1" * 9000), "RAWX.*:10: .*expected a word"),
    ("smartloc", "RXM-RAWX.csv", LONG, r"RXM-RAWX\.csv:31: expected a table, found a line of"),
    ("oakville", "imu.csv", WIDE, r"imu\.csv:1: expected a table, found a line of"),
    ("instinct", "Rover-dynamic_motion_Spirent.csv",
     lines(lambda text: text.__setitem__(1, text[1] + ",x" * 100_000)), "found a line of 16385"),
    ("own_data", "gnss.csv", line(0, lambda s: s + "x" * 150_000), "found a line of 150"),
    ("rinex_3", "rover.obs", line(20, lambda s: s + " " * 5000), "expected lines of up to 1024"),
    ("rinex_3", "brdc.nav", line(9, lambda s: s + ".1" * 5000), "expected lines of up to 100"),
    # headers that do not fit their rows: pandas would shift every column without a word
    ("oakville", "imu.csv", NARROW, r"imu\.csv:1: header of 6 columns above a row of 7"),
    ("comma2k19", "derived/gps_ublox_with_satpv.csv", NARROW, "header of 9 columns above a row of"),
    # content
    ("rtklib_pos_llh", "a.pos", lambda data: data.replace(b" ", b"\xc2\xa0"), r"a\.pos.*not read"),
    ("oakville", "imu.csv", lines(lambda text: text.__delitem__(slice(1, None))), "found 0"),
    ("oakville", "gnss.csv.gz", lambda data: data[:400] + bytes(20) + data[420:], "gnss.csv.gz"),
    ("instinct", "Rover-dynamic_motion_Spirent.csv",
     line(5, lambda s: s.replace(",", ",inf,", 1).rpartition(",")[0]), ":6: expected finite"),
    ("instinct", "Rover-dynamic_motion_Spirent.csv",
     lines(lambda text: text.__delitem__(slice(8, 14))), "Time_ms: expected steps of up to 1000"),
    ("instinct", "Rover-dynamic_motion_Spirent.csv",
     lines(lambda text: text.__delitem__(slice(5, None))), "at least 4 s of motion"),
    ("comma2k19", f"{POSE}/frame_times", array(lambda a: a[:-1]), "as many as it has values"),
    ("comma2k19", f"{GNSS}/raw_gnss_ublox/t", array(lambda a: a[:0]), "as many as it has values"),
    ("comma2k19", f"{POSE}/frame_orientations", array(lambda a: 0 * a), "unit quaternions"),
    ("comma2k19", f"{POSE}/frame_positions", array(lambda a: a.astype("U8")), "array of real num"),
    ("comma2k19", f"{POSE}/frame_velocities", replaced(b"}", b"("), "not a numpy array"),
    ("comma2k19", f"{GNSS}/raw_gnss_ublox/value",
     array(lambda a: np.where(np.arange(10) == 2, np.nan, a)), "a constant, varies by nan"),
    ("comma2k19", "derived/gps_ublox_with_satpv.csv", line(3, "a,b,c,d,e,f,g,h,i,j"), "not read"),
    ("rinex_2", "rover.obs", line(4, lambda s: s[:29] + "   " + s[32:]), "a number of satellites"),
    ("own_data", "sequence.toml", lambda data: b"a" + b".0" * 50_000 + data, "a line of 100"),
    ("config", "config.toml", replaced(b"= 21", b"= " + b"[" * 2000), "nested too deeply|not read"),
    ("config", "config.toml", replaced(b"= 21", b"= " + b"9" * 90), "more than 64 bits"),
    ("great", "IMU/MEMS_imu_data.txt",
     lines(lambda text: text.__delitem__(slice(2, None)) or text.append("380000.0" + 6 * " 0.1")),
     "nothing for 199"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("target", "name", "change", "message"), CASES, ids=[f"{c[0]}-{k}" for k, c in enumerate(CASES)]
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_damage_is_one_line(seeds, tmp_path, target, name, change, message):
    root, targets = seeds
    folder = tmp_path / "copy"
    shutil.copytree(root / SHARED.get(target, target), folder)
    assert name in targets[target].kinds
    file = folder / name
    if change is DIRECTORY:
        file.unlink()
        file.mkdir()
    else:
        before = file.read_bytes()
        after = change(before)
        assert after != before
        file.write_bytes(after)
    with pytest.raises(NavError, match=message) as caught:
        READ[target](folder)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 700


@pytest.fixture(scope="module")
def truth():
    """The drive that the sound recordings were written from."""
    return seed_drive()


def same_imu(imu, truth):
    np.testing.assert_allclose(imu.time, truth.simulation.imu.time, atol=1e-5)
    np.testing.assert_allclose(imu.gyro_b, truth.gyro, atol=1e-6)
    np.testing.assert_allclose(imu.accel_b, truth.accel, atol=1e-5)


def same_fixes(fixes, truth, tolerance):
    k = np.searchsorted(truth.fixes.time, fixes.time - 1e-3)
    np.testing.assert_allclose(truth.fixes.time[k], fixes.time, atol=1e-3)
    assert np.linalg.norm(fixes.pos_e - truth.fixes.pos_e[k], axis=1).max() < tolerance
    assert len(fixes) == len(truth.fixes)


def same_observations(observations, truth, epochs):
    whole = truth.simulation.observations
    expected = whole.take(whole.time < np.unique(whole.time)[epochs] if epochs else slice(None))
    order, wanted = (np.lexsort((o.sat, o.time)) for o in (observations, expected))
    np.testing.assert_array_equal(observations.sat[order], expected.sat[wanted])
    np.testing.assert_allclose(
        observations.pseudorange[order], expected.pseudorange[wanted], atol=1e-3
    )
    np.testing.assert_allclose(
        observations.range_rate[order], expected.range_rate[wanted], atol=1e-3
    )


# The damage above would show nothing if the sound recordings were not read, and read as they are.


def test_a_sound_folder_is_read_as_it_was_driven(seeds, truth):
    found = READ["great"](seeds[0] / "great")
    same_imu(found.imu, truth)
    same_observations(found.observations, truth, None)
    at = truth.simulation.trajectory.reference(found.reference.time)
    np.testing.assert_allclose(found.reference.pos_e, at.pos_e, atol=1e-3)


def test_a_sound_declaration_is_read_as_it_was_driven(seeds, truth):
    found = READ["own_data"](seeds[0] / "own_data")
    same_imu(found.imu, truth)
    same_fixes(found.fixes, truth, 0.01)
    np.testing.assert_allclose(
        found.odometer.speed, np.linalg.norm(truth.fixes.vel_e, axis=1), atol=1e-5
    )
    np.testing.assert_allclose(found.reference.rpy, truth.fixes.rpy, atol=1e-6)


def test_sound_rinex_is_read_whatever_it_is_packed_in(seeds, truth):
    root, _ = seeds
    same_observations(READ["rinex_2"](root / "rinex_2"), truth, 6)
    packed = READ["packed"](root / "packed")
    assert len(packed) == 3  # gzip, Hatanaka, and both of Hatanaka and compress
    for observations in packed:
        same_observations(observations, truth, 6)


def test_sound_messages_and_drafts_are_read(seeds, truth):
    root, targets = seeds
    fixes, notes = READ["ubx"](root / "ubx")
    same_fixes(fixes, truth, 0.02)
    assert not [note for note in notes if "damaged" in note]
    draft = READ["declare"](root / SHARED["declare"])
    text = draft if isinstance(draft, str) else draft.text
    for name in targets["declare"].kinds:
        assert f'file = "{name}"' in text


def test_a_ubx_message_with_an_impossible_date(seeds, tmp_path):
    from certnav.datasets.formats.ubx import read_ubx

    data = bytearray((seeds[0] / "ubx/a.ubx").read_bytes())
    data[6 + 6] = 23  # the month of the first message
    a = b = 0
    for byte in data[2 : 6 + 92]:
        a = (a + byte) & 255
        b = (b + a) & 255
    data[6 + 92 : 8 + 92] = bytes((a, b))
    file = tmp_path / "a.ubx"
    file.write_bytes(data)
    with pytest.raises(DataError, match="NAV-PVT: expected a date, found 2020-23-27"):
        read_ubx(file)


def test_damaged_messages_are_counted(seeds, tmp_path):
    from certnav.datasets.formats.nmea import read_nmea
    from certnav.datasets.formats.ubx import read_ubx

    data = bytearray((seeds[0] / "ubx/a.ubx").read_bytes())
    data[40] ^= 1  # the checksum of the first message is wrong now
    (tmp_path / "a.ubx").write_bytes(data)
    fixes, notes = read_ubx(tmp_path / "a.ubx")
    sound, _ = read_ubx(seeds[0] / "ubx/a.ubx")
    assert len(fixes) == len(sound) - 1
    assert "1 damaged messages left out" in notes[0]
    text = (seeds[0] / "nmea/a.nmea").read_text()
    (tmp_path / "a.nmea").write_text(text.replace("GNGGA,02", "GNGGA,03", 1))
    _, notes = read_nmea(tmp_path / "a.nmea")
    assert "1 damaged messages left out" in notes[0]


def test_nmea_sentences_with_empty_fields_are_no_fixes(seeds, tmp_path):
    from certnav.datasets.formats.nmea import read_nmea

    def sentence(body):
        check = 0
        for c in body:
            check ^= ord(c)
        return f"${body}*{check:02X}\r\n"

    text = (seeds[0] / "nmea/a.nmea").read_text()
    file = tmp_path / "a.nmea"
    extra = sentence("GNGGA,021030.00,,,,,4,12,0.8,,M,-16.2,M,,") + sentence("GNZDA,,,,,00,00")
    extra += sentence("GNZDA,021030.00,31,02,2020,00,00") + sentence("GNGST,021030.00,,")
    file.write_text(text + extra)
    fixes, notes = read_nmea(file)
    assert len(fixes) == len(read_nmea(seeds[0] / "nmea/a.nmea")[0])
    assert "left out: 1 without latitude, longitude or height;" in notes[0]


def test_white_space_that_is_none_for_the_parser(tmp_path):
    """No-break spaces separate words for Python and not for pandas."""
    file = tmp_path / "a.txt"
    file.write_text("1\u00a02\n3\u00a04\n", encoding="utf-8")
    with pytest.raises(DataError, match="neither blank nor tab"):
        read_table(file, ("a", "b"))
    with pytest.raises(DataError, match="expected a file, found a folder"):
        read_lines(tmp_path)


def test_few_rows_have_no_rate():
    assert sampling_note(np.empty(0), "IMU") == "IMU: 0 rows"
    assert sampling_note(np.ones(1), "IMU") == "IMU: 1 rows"


@pytest.mark.parametrize("step", [1e-300, 0.01, 10.0])
def test_a_course_too_short_to_judge_by(step):
    """Fewer epochs than the span to compare over, also where their times are absurdly close."""
    time = np.arange(4) * step
    found = gyro_unit_ratio(np.arange(0.0, 60.0, 0.1), np.zeros(600), time, np.zeros(4))
    assert not found.conclusive


def test_an_absurd_time_stamp_is_refused():
    """One wrong stamp would make hours of data, and resampled arrays of gigabytes, of a minute."""
    time = np.append(np.arange(100) / 100.0, 1e6)
    with pytest.raises(DataError, match="nothing for 999999 s after index 99"):
        ImuData(time, np.zeros((101, 3)), np.zeros((101, 3)))


@pytest.mark.parametrize("text", ["a" + ".0" * 3000, "a = " + "[" * 3000, "a = " + "9" * 4090])
def test_toml_that_would_take_minutes_or_end_in_a_traceback(text):
    with pytest.raises(ValueError, match=r".") as caught:
        parse_toml(text)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("content", [b"a\r\nb", b"a\x85b", b"\x1b[31m", b"x" * 5000])
def test_an_error_is_one_printable_line(content):
    error = DataError(f"found '{content.decode('latin-1')}'", file="a.txt", line=3, remedy="repair")
    assert str(error).isprintable() and len(str(error)) < 700
    assert str(error).startswith("a.txt:3: found '") and str(error).endswith("— repair")


def test_an_archive_cut_short_is_refused(seeds, tmp_path):
    from certnav.datasets.great.importing import import_archives

    whole = (seeds[0] / "great_import/campus-01.zip").read_bytes()
    file = tmp_path / "campus-01.zip"
    import_archives([seeds[0] / "great_import/campus-01.zip"], tmp_path / "sound")
    for size in range(30, len(whole), len(whole) // 25):
        file.write_bytes(whole[-size:])  # the list of contents stays, what it points to does not
        with pytest.raises(DataError):
            import_archives([file], tmp_path / "to")
        assert not (tmp_path / "to").exists()


@pytest.mark.parametrize("ends", ["\r", "1 2 3\r", "1 2 3\r1 2 3\n", "\r\r\n", "1 2 3 4\r"])
def test_a_carriage_return_alone(tmp_path, ends):
    """Behind the last column wanted it sent the compiled parser round in circles."""
    file = tmp_path / "a.txt"
    file.write_text("1 2 3 4\n" + ends, newline="")
    table = read_table(file, ("a", "b", "c"), exact=False)
    np.testing.assert_array_equal(table.values[:, :3], np.tile([1.0, 2.0, 3.0], (len(table), 1)))
    file.write_text("1 2 3 4\r5\n", newline="")
    with pytest.raises(DataError, match="expected 3 columns"):
        read_table(file, ("a", "b", "c"), exact=False)


def test_ephemerides_of_an_impossible_date(seeds, tmp_path):
    """The week of ephemeris is as wrong as it can be printed: the message has no date for it."""
    folder = tmp_path / "copy"
    shutil.copytree(seeds[0] / "rinex_3", folder)
    text = (folder / "brdc.nav").read_text().split("\n")
    start = next(k for k, line in enumerate(text) if "END OF HEADER" in line) + 1
    for k in range(start, len(text) - 1, 8):
        text[k + 5] = text[k + 5][:42] + " 9.999999999999E+08" + text[k + 5][61:]
    (folder / "brdc.nav").write_text("\n".join(text))
    with pytest.raises(DataError, match="no ephemeris"):
        READ["rinex_3"](folder)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("> 2020 10 27 02", "> 2020 10 27 29", "expected an epoch line"),
        ("> 2020 10 27", "> 2020 13 27", "expected an epoch line"),
        ("> 2020 10 27", "> 2021 02 30", "expected the date of an epoch, found '2021 02 30"),
    ],
)
def test_epochs_of_an_impossible_date(seeds, tmp_path, old, new, message):
    """RTKLIB would take them for another time."""
    folder = tmp_path / "copy"
    shutil.copytree(seeds[0] / "relative", folder)
    text = (folder / "rover.obs").read_text()
    at = text.rindex(old)
    (folder / "rover.obs").write_text(text[:at] + new + text[at + len(old) :])
    with pytest.raises(DataError, match=message):
        READ["relative"](folder)


def test_an_absurd_satellite_clock_is_refused(seeds, tmp_path):
    """RTKLIB would carry a GLONASS orbit over as many years, a minute at a time."""
    folder = tmp_path / "copy"
    shutil.copytree(seeds[0] / "rinex_3", folder)
    text = (folder / "brdc.nav").read_text().split("\n")
    k = next(k for k, line in enumerate(text) if "END OF HEADER" in line) + 1
    text[k] = text[k][:23] + "-9.220000000000E+16" + text[k][42:]
    (folder / "brdc.nav").write_text("\n".join(text))
    with pytest.raises(DataError, match=r"clock off by less than 1 s, found -9\.22e\+16 s"):
        READ["rinex_3"](folder)


@pytest.mark.parametrize("number", ["1e308", "-1e21", "inf", "nan"])
def test_numbers_that_measure_nothing(tmp_path, number):
    """Their squares would overflow somewhere later, in a warning nobody understands."""
    file = tmp_path / "a.txt"
    file.write_text(f"1 2\n3 {number}\n")
    with pytest.raises(DataError, match=r"a\.txt:2: b: expected a finite number, found"):
        read_table(file, ("a", "b"))


def test_a_file_name_that_is_none(seeds, tmp_path):
    folder = tmp_path / "copy"
    shutil.copytree(seeds[0] / "own_rinex", folder)
    text = (folder / "sequence.toml").read_text()
    for old in ('file = "groundtruth.txt"', 'navigation = ["brdc.rnx"]'):
        key, _, value = old.partition(" = ")
        new = '["\\u0000"]' if value.startswith("[") else '"\\u0000"'
        (folder / "sequence.toml").write_text(text.replace(old, f"{key} = {new}"))
        with pytest.raises(NavError, match=r"expected a text|expected names of files"):
            READ["own_rinex"](folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda data: b"\n\n" + b"1," * 100_000 + b"\n" + data, ":3: expected a table, found a"),
        (lambda data: b"\n\n" + data, ":1: expected a header, found a blank"),
        (lines(lambda text: text.__setitem__(1, "\n" + "1," * 8000)), "above a row of 8001"),
    ],
)
def test_blank_lines_hide_no_columns(seeds, tmp_path, change, message):
    """pandas passes over blank lines, and took minutes to name 100 000 columns behind them."""
    folder = tmp_path / "copy"
    shutil.copytree(seeds[0] / "comma2k19", folder)
    file = folder / "derived/gps_ublox_with_satpv.csv"
    file.write_bytes(change(file.read_bytes()))
    with pytest.raises(DataError, match=message):
        READ["comma2k19"](folder)


def test_an_epoch_without_satellites_does_not_stop_the_reader(tmp_path):
    """RINEX 2: no satellites need no continuation line, not minus one; what follows is tested."""
    header = (
        "     2.11           OBSERVATION DATA    G (GPS)             RINEX VERSION / TYPE\n"
        "     1    L1                                                # / TYPES OF OBSERV \n"
        + " " * 60 + "END OF HEADER\n"
    )  # fmt: skip
    file = tmp_path / "rover.20o"
    empty = " 20 10 27  2 10  1.0000000  0  0\n" * 2
    file.write_text(header + empty + " 20 10 27  2 10  2.0000000  0  1G01\n 114221234.123\n")
    assert check_observations(file) is None
    file.write_text(header + empty + " 20 10 27  2 10  2.0000000  0  1G01\n")
    with pytest.raises(DataError, match="announces") as caught:
        check_observations(file)
    assert caught.value.line == 6
