"""RINEX as the standard allows and converters write it gives what a plain file gives."""

from __future__ import annotations

import codecs
import datetime
import re

import numpy as np
import pytest

from certnav.datasets.great.files import first_observation, rinex_kind
from certnav.datasets.great.writer import write_great
from certnav.datasets.rtklib import read_observations
from certnav.datasets.rtklib.satellites import load_navigation
from certnav.datasets.text.rinex_repair import readable_rinex
from certnav.filters.errors import DataError
from oracles.drives import Drive, rinex_2


def labelled(content, label):
    return f"{content:<60}{label:<20}"


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    """RINEX 3 and RINEX 2 of the same six epochs, and a navigation file."""
    root = tmp_path_factory.mktemp("rinex")
    write_great(Drive.of(duration=12.0, imu_rate=25.0).simulation, root)
    lines = next(root.glob("GNSS/Rover/*")).read_text().splitlines()
    epochs = [k for k, line in enumerate(lines) if line.startswith(">")]
    (root / "three.obs").write_text("\n".join(lines[: epochs[6]]) + "\n")
    (root / "two.obs").write_text(rinex_2(root / "three.obs"))
    return root / "three.obs", root / "two.obs", next(root.glob("GNSS/Product/*"))


@pytest.fixture
def edited(sound, tmp_path):
    """Return a function that writes edited lines of the RINEX 3 or 2 file and reads them."""

    def edited(edit, version=3):
        lines = sound[3 - version].read_text().splitlines()
        content = edit(lines)
        if not isinstance(content, bytes):
            content = "\n".join(content).encode("latin-1") + b"\n"
        (tmp_path / "odd.obs").write_bytes(content)
        return read_observations(tmp_path / "odd.obs", [sound[2]])

    return edited


def same(found, expected, tolerance=0.0):
    np.testing.assert_array_equal(found.sat, expected.sat)
    np.testing.assert_allclose(found.time, expected.time, rtol=0, atol=1e-6)
    for name in ("pseudorange", "carrier", "range_rate", "cn0", "sat_pos_e", "sat_clock"):
        a, b = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(a, b, rtol=0, atol=max(tolerance, 1e-6), err_msg=name)


def end(lines):
    return next(k for k, line in enumerate(lines) if "END OF HEADER" in line)


def without(label):
    return lambda lines: [line for line in lines if label not in line]


def shift_labels(lines):
    """Labels two columns early where there is room, END OF HEADER behind a single tab."""
    out = list(lines)
    for k in range(end(lines) + 1):
        content, label = lines[k][:60].rstrip(), lines[k][60:]
        out[k] = f"{content:<58}{label}" if len(content) <= 58 else lines[k]
    out[end(lines)] = "\tEND OF HEADER"
    return out


def long_program(lines):
    """A program, agency and date of 70 columns push the label out of its place."""
    k = next(k for k, line in enumerate(lines) if "PGM / RUN BY" in line)
    return [*lines[:k], f"{'x' * 70}PGM / RUN BY / DATE", *lines[k + 1 :]]


def blank_counts(lines):
    return [
        line[:3] + "   " + line[6:] if "OBS TYPES" in line
        else 6 * " " + line[6:] if "TYPES OF OBSERV" in line else line
        for line in lines
    ]  # fmt: skip


def wavelength_factors(lines):
    k = end(lines)
    return [
        *lines[:k],
        labelled("     1     1", "WAVELENGTH FACT L1/2"),
        labelled("     1     2     2   G03   G05", "WAVELENGTH FACT L1/2"),
        *lines[k:],
    ]


ODD = {
    "byte order mark": lambda lines: codecs.BOM_UTF8 + ("\r\n".join(lines) + "\r\n").encode(),
    "UTF-16": lambda lines: "\n".join(lines).encode("utf-16"),
    "no TIME OF FIRST OBS": without("TIME OF FIRST OBS"),
    "shifted labels": shift_labels,
    "blank counts": blank_counts,
    "wavelength factors": wavelength_factors,
}


@pytest.mark.parametrize("version", [3, 2])
@pytest.mark.parametrize("oddity", ODD)
def test_header_oddities_change_nothing(sound, edited, oddity, version):
    expected = read_observations(sound[3 - version], [sound[2]])
    assert len(expected) > 20
    same(edited(ODD[oddity], version), expected)


def test_a_program_line_that_is_too_long(sound, edited):
    same(edited(long_program), read_observations(sound[0], [sound[2]]))


@pytest.mark.parametrize("flag", "2345")
@pytest.mark.parametrize("count", ["  2", "  0", "   "])
@pytest.mark.parametrize("version", [3, 2])
def test_events_without_date(sound, edited, version, flag, count):
    """Where the date means nothing it may be blank, in any place of the file."""

    def edit(lines):
        rows = 2 * [labelled("an event", "COMMENT")] if count == "  2" else []
        event = [(">" + 28 * " " if version == 3 else 26 * " ") + f"  {flag}{count}", *rows]
        heads = [k for k in range(end(lines) + 1, len(lines)) if is_epoch(lines[k], version)]
        for k in (len(lines), heads[4], heads[3], heads[0]):
            lines = [*lines[:k], *event, *lines[k:]]
        return lines

    same(edited(edit, version), read_observations(sound[3 - version], [sound[2]]))


@pytest.mark.parametrize("version", [3, 2])
def test_cycle_slip_records_are_no_observations(sound, edited, tmp_path, version):
    """Flag 6: laid out as the epoch before, with numbers of cycles."""

    def edit(lines):
        heads = [k for k in range(end(lines) + 1, len(lines)) if is_epoch(lines[k], version)]
        flag = 31 if version == 3 else 28
        epoch = lines[heads[2] : heads[3]]
        slips = [epoch[0][:flag] + "6" + epoch[0][flag + 1 :], *epoch[1:]]
        return [*lines[: heads[3]], *slips, *lines[heads[3] :]]

    same(edited(edit, version), read_observations(sound[3 - version], [sound[2]]))
    notes = readable_rinex(tmp_path / "odd.obs").notes
    assert notes == ("odd.obs: 1 records of cycle slips left out",)


def is_epoch(line, version):
    return line.startswith(">") if version == 3 else bool(re.match(r" \d\d [ \d]\d [ \d]\d ", line))


def moved(lines, version, seconds, system):
    """Return the file in another time system, whose clock shows `seconds` less."""
    out = []
    for line in lines:
        if "TIME OF FIRST OBS" in line:
            line = f"{line[:48]}{system:<3}{line[51:]}"
        elif is_epoch(line, version):
            at = slice(2, 29) if version == 3 else slice(1, 26)
            numbers = line[at].split()
            year = int(numbers[0]) + (0 if version == 3 else 2000)
            date = datetime.datetime(year, *map(int, numbers[1:5]))
            date += datetime.timedelta(seconds=float(numbers[5]) - seconds)
            stamp = f"{date:%Y %m %d %H %M} {date.second + date.microsecond * 1e-6:10.7f}"
            line = line[: at.start] + stamp[0 if version == 3 else 2 :] + line[at.stop :]
        out.append(line)
    return out


@pytest.mark.parametrize("version", [3, 2])
@pytest.mark.parametrize(
    ("system", "behind"),
    [("GPS", 0), ("GAL", 0), ("QZS", 0), ("IRN", 0), ("GLO", 18), ("UTC", 18), ("BDT", 14)],
)
def test_every_time_system_becomes_gps_time(sound, edited, tmp_path, version, system, behind):
    expected = read_observations(sound[3 - version], [sound[2]])
    same(edited(lambda lines: moved(lines, version, behind, system), version), expected)
    notes = readable_rinex(tmp_path / "odd.obs").notes
    assert notes == ((f"odd.obs: epochs of {system} moved by {behind} s to GPS time",) if behind
                     else ())  # fmt: skip


@pytest.mark.parametrize(("letter", "behind"), [("C", 14), ("R", 18)])
def test_a_file_of_one_constellation_has_its_time_where_it_does_not_say(
    sound, edited, letter, behind
):
    def edit(lines):
        lines = moved(lines, 3, behind, "")
        return [lines[0][:40] + letter + lines[0][41:], *lines[1:]]

    same(edited(edit), read_observations(sound[0], [sound[2]]))


def test_an_unknown_time_system_is_refused_with_its_line(edited):
    with pytest.raises(DataError, match=r"odd.obs:\d+: .*expected the time system GPS.*'XYZ' — "):
        edited(lambda lines: moved(lines, 3, 0, "XYZ"))


@pytest.mark.parametrize("named", [True, False])
def test_scale_factors_are_applied(sound, edited, tmp_path, named):
    """Of some types, or of all of a system where none is named; also set in an event."""

    def edit(lines):
        k = end(lines)
        types = next(line for line in lines if line.startswith("G") and "OBS TYPES" in line)
        scaled = ["C1C", "D1C"] if named else types[7:60].split()
        head = labelled("G   10" + ("   2 C1C D1C" if named else ""), "SYS / SCALE FACTOR")
        columns = [types[7:60].split().index(name) for name in scaled]
        out = [*lines[:k], head, lines[k]]
        for line in lines[k + 1 :]:
            for c in columns if line[0] == "G" else []:
                at = slice(3 + 16 * c, 17 + 16 * c)
                value = f"{10 * float(line[at]):14.3f}"
                line = line[: at.start] + value + line[at.stop :]
            out.append(line)
        return out

    same(edited(edit), read_observations(sound[0], [sound[2]]), tolerance=1e-3)
    assert readable_rinex(tmp_path / "odd.obs").notes == (
        "odd.obs: observations divided by their scale factors (G 1/10)",
    )


def test_a_scale_factor_that_begins_with_an_event(sound, edited):
    def edit(lines):
        heads = [k for k in range(len(lines)) if lines[k].startswith(">")]
        types = next(line for line in lines if line.startswith("G") and "OBS TYPES" in line)
        c = types[7:60].split().index("D1C")
        at = slice(3 + 16 * c, 17 + 16 * c)
        event = [">" + 30 * " " + "4  1", labelled("G   10   1 D1C", "SYS / SCALE FACTOR")]
        later = [
            line[: at.start] + f"{10 * float(line[at]):14.3f}" + line[at.stop :]
            if line[0] == "G" else line
            for line in lines[heads[3] :]
        ]  # fmt: skip
        return [*lines[: heads[3]], *event, *later]

    same(edited(edit), read_observations(sound[0], [sound[2]]), tolerance=1e-3)


def test_a_header_without_end_is_refused_with_the_line_that_begins_the_data(edited):
    with pytest.raises(DataError, match=r"odd.obs:\d+: expected 'END OF HEADER' before '> 20"):
        edited(without("END OF HEADER"))


def test_kind_and_first_epoch_of_odd_files(sound, tmp_path):
    lines = sound[0].read_text().splitlines()
    expected = first_observation(sound[0])
    for edit in (ODD["byte order mark"], without("TIME OF FIRST OBS"), shift_labels):
        content = edit(lines)
        content = content if isinstance(content, bytes) else ("\n".join(content) + "\n").encode()
        (tmp_path / "odd.obs").write_bytes(content)
        assert rinex_kind(tmp_path / "odd.obs") == "O"
        assert first_observation(tmp_path / "odd.obs") == expected
    (tmp_path / "odd.obs").write_text("\n".join(without("TIME OF FIRST")(
        sound[1].read_text().splitlines())) + "\n")  # fmt: skip
    assert first_observation(tmp_path / "odd.obs") == expected


def ephemerides(path):
    """Return the header and the ephemerides of RINEX 3."""
    lines = path.read_text().splitlines()
    k = end(lines) + 1
    starts = [i for i in range(k, len(lines)) if re.match(r"[A-Z]\d\d ", lines[i])]
    return lines[:k], [lines[a:b] for a, b in zip(starts, [*starts[1:], None], strict=True)]


MESSAGE = {"G": "LNAV", "E": "INAV", "C": "D1", "R": "FDMA", "J": "LNAV"}


def rinex_4(path, extra=()):
    head, blocks = ephemerides(path)
    version = f"{'4.00':>9}{'':11}NAVIGATION DATA     M"
    out = [labelled(version, "RINEX VERSION / TYPE"), *head[1:]]
    out = [line for line in out if not line.startswith(("GPSA", "GPSB"))] + list(extra)
    for block in blocks:
        fifth = ["    " + 4 * " 0.000000000000E+00"] if block[0][0] == "R" else []
        out += [f"> EPH {block[0][:3]} {MESSAGE[block[0][0]]}", *block[: 4 if fifth else 8], *fifth]
    return out


def states(observations):
    return np.column_stack([observations.sat_pos_e, observations.sat_clock])


def test_rinex_4_navigation_without_the_messages_that_rtklib_misreads(sound, tmp_path):
    """Civil messages have other numbers in other places: as classic ones they are wrong orbits."""
    _, blocks = ephemerides(sound[2])
    of_gps = next(b for b in blocks if b[0][0] == "G")
    civil = [line[:4] + " 1.234000000000E-03" + line[23:] for line in of_gps[1:]]
    extra = [
        "> STO G05 LNAV", "    2020 10 27 02 00 00 GPUT", "     6.048000000000E+05",
        "> ION G05 LNAV",
        "    2020 10 27 02 00 00 1.117600000000E-08 1.490100000000E-08-5.960500000000E-08",
        "    -1.192100000000E-07 1.167500000000E+05-2.294000000000E+05-1.311000000000E+05",
        "     1.048600000000E+06",
        *(f"> EPH {b[0][:3]} CNAV\n" + "\n".join([b[0], *civil, civil[-1]])
          for b in blocks if b[0][0] == "G"),
    ]  # fmt: skip
    file = tmp_path / "four.rnx"
    file.write_text("\n".join(rinex_4(sound[2], extra)) + "\n")
    a, b = (read_observations(sound[0], [f]) for f in (sound[2], file))
    np.testing.assert_allclose(states(a), states(b), rtol=0, atol=1e-6)
    assert re.search(r"four.rnx: ephemerides .* left out: \d+ CNAV", readable_rinex(file).notes[0])
    ion = load_navigation([file]).ion_gps
    expected = [1.1176e-8, 1.4901e-8, -5.9605e-8, -1.1921e-7, 116750, -229400, -131100, 1048600]
    np.testing.assert_allclose([ion[k] for k in range(8)], expected, rtol=1e-4)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda lines, k: lines[: k + 5] + lines[k + 6 :], "expected 8 lines, found 7"),
        (lambda lines, k: [*lines[: k + 3], "    what?", *lines[k + 4 :]], "the numbers of an eph"),
        (lambda lines, k: [*lines[: k + 1], "junk", *lines[k + 2 :]], "the start of an ephemeris"),
        (lambda lines, k: [*lines[:k], *lines[k + 1 :]], "the start of a message"),
    ],
)
def test_damaged_rinex_4_navigation_is_refused_with_its_line(sound, tmp_path, edit, message):
    lines = rinex_4(sound[2])
    file = tmp_path / "four.rnx"
    file.write_text("\n".join(edit(lines, end(lines) + 1)) + "\n")
    with pytest.raises(DataError, match=rf"four.rnx:\d+: .*{message}"):
        load_navigation([file])


@pytest.mark.parametrize(("version", "count"), [("3.04", 5), ("3.05", 4), ("3.05", 5), ("3.04", 4)])
def test_glonass_of_four_lines_or_five_whatever_the_version_says(
    data_dir, tmp_path, version, count
):
    source = data_dir / "broadcast/BRDC00IGS_R_20230730000_01D_MN.rnx"
    head, blocks = ephemerides(source)
    blocks = [b for b in blocks if b[0][0] == "R"][:6] + [b for b in blocks if b[0][0] == "G"][:3]
    fifth = "    " + 4 * " 0.000000000000E+00"
    rows = [
        line for b in blocks for line in (*b, *([fifth] * (count - 4) if b[0][0] == "R" else []))
    ]
    file = tmp_path / "a.rnx"
    file.write_text("\n".join([f"{version:>9}{head[0][9:]}", *head[1:], *rows]) + "\n")
    nav = load_navigation([file])
    assert (nav.n, nav.ng) == (3, 6)
    assert max(abs(nav.geph[k].dtaun) for k in range(6)) < 1e-6
