"""Damaged RINEX is refused with the line at fault; sound RINEX passes."""

from __future__ import annotations

import gzip

import pytest

from certnav.datasets.text.rinex import check_navigation, check_observations
from certnav.filters.errors import DataError


def labelled(content, label):
    return f"{content:<60}{label:<20}"


OBS_3 = [
    labelled("     3.04           OBSERVATION DATA    M: MIXED", "RINEX VERSION / TYPE"),
    labelled("G    2 C1C D1C", "SYS / # / OBS TYPES"),
    labelled("", "END OF HEADER"),
    "> 2020 10 27 02 10  0.0000000  0  2",
    "G01  21735785.983 8     -2437.386 8",
    "G 7  21735785.983",
    "> 2020 10 27 02 10  0.5000000  4  1",
    "any text at all                                             COMMENT",
    "> 2020 10 27 02 10  1.0000000  0  1",
    "G01                     -2437.386",
]
OBS_2 = [
    labelled("     2.11           OBSERVATION DATA    M (MIXED)", "RINEX VERSION / TYPE"),
    labelled("     6    C1    L1    D1    S1    P2    L2", "# / TYPES OF OBSERV"),
    labelled("", "END OF HEADER"),
    " 20 10 27  2 10  0.0000000  0 13G01G02G03G04G05G06G07G08G09G10G11G12",
    "                                R01",
    *(13 * ["  21735785.983 8 114221234.12318     -2437.386          44.250", "  21735785.983"]),
    " 20 10 27  2 10  1.0000000  0  1G01",
    "  21735785.983",
    "",
]
NUMBERS = " 1.000000000000E+00-2.000000000000D-05 0.000000000000E+00"
NAV_3 = [
    labelled("     3.04           N: GNSS NAV DATA    M: MIXED", "RINEX VERSION / TYPE"),
    labelled("", "END OF HEADER"),
    "G01 2020 10 27 02 00 00" + NUMBERS,
    *(7 * ["    " + NUMBERS + "                   "]),
    "R01 2020 10 27 02 15 00" + NUMBERS,
    *(3 * ["    " + NUMBERS]),
]
NAV_2 = [
    labelled("     2.10           N: GPS NAV DATA", "RINEX VERSION / TYPE"),
    labelled("", "END OF HEADER"),
    " 1 20 10 27  2  0  0.0" + NUMBERS,
    *(7 * ["   " + NUMBERS]),
]


@pytest.fixture
def write(tmp_path):
    def write(lines, name="file.rnx"):
        (tmp_path / name).write_text("\n".join(lines) + "\n", encoding="latin-1")
        return tmp_path / name

    return write


def refused(check, path):
    with pytest.raises(DataError) as caught:
        check(path)
    assert "\n" not in str(caught.value) and caught.value.remedy
    assert str(path) in str(caught.value)
    return caught.value


def last_value_garbled(lines):
    """The file with a letter in the last number, and the line it is in, counted from 1."""
    last = max(k for k, line in enumerate(lines) if line.strip())
    head, dot, tail = lines[last].rpartition(".")
    return [*lines[:last], f"{head[:-1]}O{dot}{tail}", *lines[last + 1 :]], last + 1


@pytest.mark.parametrize("lines", [OBS_3, OBS_2, [*OBS_3, "", ""]])
def test_sound_observations_pass_and_are_read_to_the_end(write, lines):
    assert check_observations(write(lines)) is None
    garbled, line = last_value_garbled(lines)
    assert refused(check_observations, write(garbled)).line == line


@pytest.mark.parametrize("lines", [NAV_3, NAV_2])
def test_sound_navigation_passes_and_is_read_to_the_end(write, lines):
    assert check_navigation(write(lines)) is None
    garbled, line = last_value_garbled(lines)
    assert refused(check_navigation, write(garbled)).line == line


@pytest.mark.parametrize(
    ("lines", "line"), [(OBS_3[:5], 4), (OBS_3[:9], 9), (OBS_2[:20], 4), (OBS_2[:32], 32)]
)
def test_truncated_epochs_are_named(write, lines, line):
    error = refused(check_observations, write(lines))
    assert error.line == line
    assert "announces" in str(error) and "cut short" in str(error)


def test_a_file_cut_inside_a_value_is_refused(write, tmp_path):
    path = write(OBS_3)
    path.write_bytes(path.read_bytes()[:-4])
    assert refused(check_observations, path).line == len(OBS_3)


@pytest.mark.parametrize(
    ("lines", "index", "bad"),
    [
        (OBS_3, 4, "G01  21735x85.983 8     -2437.386 8"),
        (OBS_3, 4, "G01  21735785.983 8   -2437.386 8"),
        (OBS_3, 4, "G01\x00 21735785.983 8"),
        (OBS_3, 3, "> 2020 1O 27 02 10  0.0000000  0  2"),
        (OBS_2, 3, " 2O 10 27  2 10  0.0000000  0 13G01G02G03G04G05G06G07G08G09G10G11G12"),
        (OBS_2, 6, "  21735?85.983"),
    ],
)
def test_garbled_observations_are_named_by_line(write, lines, index, bad):
    damaged = [*lines[:index], bad, *lines[index + 1 :]]
    assert refused(check_observations, write(damaged)).line == index + 1


@pytest.mark.parametrize(
    ("lines", "line"),
    [(NAV_3[:7], 3), (NAV_3[:-1], 11), (NAV_2[:-2], 3)],
)
def test_truncated_ephemerides_are_named(write, lines, line):
    error = refused(check_navigation, write(lines))
    assert error.line == line and "lines" in str(error)


def test_garbled_ephemeris_is_named_by_line(write):
    damaged = [*NAV_3[:5], NAV_3[5].replace("2.0000", "2.O000"), *NAV_3[6:]]
    assert refused(check_navigation, write(damaged)).line == 6


def test_headers_that_are_not_rinex(write, tmp_path):
    assert "found 'week,tow'" in str(refused(check_observations, write(["week,tow", "1,2"])))
    (tmp_path / "empty").touch()
    assert "an empty file" in str(refused(check_observations, tmp_path / "empty"))
    assert "END OF HEADER" in str(refused(check_observations, write(OBS_3[:2])))
    assert "nothing after" in str(refused(check_navigation, write(NAV_3[:2])))
    assert "no ephemeris" in str(refused(check_navigation, write([*NAV_3[:2], "    1.0"])))
    assert "not found" in str(refused(check_observations, tmp_path / "none"))


def test_exchanged_files_are_told_apart(write):
    assert "exchanged" in str(refused(check_observations, write(NAV_3)))
    assert "exchanged" in str(refused(check_navigation, write(OBS_3)))


def test_compressed_files_name_the_tool(write, tmp_path):
    packed = tmp_path / "a.gz"
    packed.write_bytes(gzip.compress(b"text"))
    assert "unpack" in str(refused(check_observations, packed))
    hatanaka = [labelled("3.0                 COMPACT RINEX FORMAT", "CRINEX VERS   / TYPE")]
    assert "CRX2RNX" in str(refused(check_observations, write(hatanaka)))
