"""Columns by name or number, whatever the separator; what cannot be read names its line."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from certnav.datasets.text.columns import open_text, read_columns
from certnav.filters.errors import ConfigError, DataError

ROWS = [[0.0, 1.5, -2.0], [1.0, 2.5, -3.0], [2.0, 3.5, -4.0]]


def text(separator: str, header: bool = True) -> str:
    lines = [separator.join(["t", "a", "b"])] if header else []
    lines += [separator.join(map(str, row)) for row in ROWS]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("separator", [",", ";", "\t", " ", ", "])
@pytest.mark.parametrize("packed", [False, True])
def test_names_and_numbers_give_the_same_columns(tmp_path, separator, packed):
    file = tmp_path / "f.csv"
    raw = text(separator).encode()
    file.write_bytes(gzip.compress(raw) if packed else raw)
    source = open_text(file)
    named = read_columns(source, {"x": ("b", "t")})
    np.testing.assert_array_equal(named.numbers["x"], np.array(ROWS)[:, [2, 0]])
    numbered = read_columns(source, {"x": (3, 1)})
    np.testing.assert_array_equal(numbered.numbers["x"], named.numbers["x"])
    np.testing.assert_array_equal(named.table.line, [2, 3, 4])


def test_header_with_quotes_units_and_comment_lines(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text('# made by x\n"t [s]","h (0° = East, ccw) [rad]"\n\n1,2\n# mid\n3,4\n')
    source = open_text(file)
    assert source.names == ("t [s]", "h (0° = East, ccw) [rad]")
    found = read_columns(source, {"x": ("h (0° = East, ccw) [rad]",)})
    np.testing.assert_array_equal(found.numbers["x"][:, 0], [2.0, 4.0])
    np.testing.assert_array_equal(found.table.line, [4, 6])


def test_commented_header_of_white_space_columns(tmp_path):
    file = tmp_path / "f.txt"
    file.write_text("% t a b\n0 1 2\n")
    assert open_text(file).names == ("t", "a", "b")


@pytest.mark.parametrize(
    ("column", "message"),
    [
        ("aa", "did you mean 'a'"),
        (0, "numbered from 1"),
        (4, "expected 1 … 3"),
        (True, "expected a column name or number"),
    ],
)
def test_a_column_that_is_not_there(tmp_path, column, message):
    file = tmp_path / "f.csv"
    file.write_text(text(","))
    with pytest.raises(ConfigError, match=message):
        read_columns(open_text(file), {"gyro": (column,)})


def test_name_without_header_and_ambiguous_name(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text(text(",", header=False))
    with pytest.raises(ConfigError, match="has no header"):
        read_columns(open_text(file), {"gyro": ("a",)})
    file.write_text("a,a\n1,2\n")
    with pytest.raises(ConfigError, match=r"several columns 'a' \(1, 2\)"):
        read_columns(open_text(file), {"gyro": ("a",)})


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("3,x,1", r"f\.csv:5: a: expected a finite number, found 'x'"),
        ("3,nan,1", r"f\.csv:5: a: expected a finite number"),
        ("3,1", r"f\.csv:5: expected 3 columns"),
        (",1,2", r"f\.csv:5: t: expected a value, found an empty cell"),
    ],
)
def test_bad_rows_are_refused_with_their_line(tmp_path, row, message):
    file = tmp_path / "f.csv"
    file.write_text(text(",") + row + "\n4,5,6\n")
    with pytest.raises(DataError, match=message):
        read_columns(open_text(file), {"x": ("t", "a", "b")})


def test_cells_that_may_be_missing_become_nan_and_words_do_not(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text("t,v\n0,\n1,2.5\n2,NaN\n")
    found = read_columns(open_text(file), {"t": ("t",), "v": ("v",)}, may_miss=("v",))
    np.testing.assert_array_equal(found.numbers["v"][:, 0], [np.nan, 2.5, np.nan])
    file.write_text("t,v\n0,1\n1,fast\n2,3\n")
    with pytest.raises(DataError, match=r"f\.csv:3: v: expected a number or nothing, found 'fast'"):
        read_columns(open_text(file), {"t": ("t",), "v": ("v",)}, may_miss=("v",))


def test_text_columns_are_joined(tmp_path):
    file = tmp_path / "f.txt"
    file.write_text("2025/07/08 19:34:18.5 1.0\n2025/07/08 19:34:19.5 2.0\n")
    found = read_columns(open_text(file), {"x": (3,)}, {"stamp": (1, 2)})
    assert found.text["stamp"] == ["2025/07/08 19:34:18.5", "2025/07/08 19:34:19.5"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "expected rows of numbers"),
        (b"a,b\n", "expected rows of numbers"),
        (b"\x1f\x8b\x00\x00", "damaged gzip"),
        (b"\xff\xfe\x00\x01\x80", "expected UTF-16 text, found byte 0x80"),
        (b"\x00\x01" * 100, "zero bytes: binary data"),
    ],
)
def test_what_is_no_table(tmp_path, content, message):
    file = tmp_path / "f.csv"
    file.write_bytes(content)
    with pytest.raises(DataError, match=message):
        open_text(file)
    with pytest.raises(DataError, match="not found"):
        open_text(tmp_path / "g.csv")
    with pytest.raises(DataError, match="folder"):
        open_text(tmp_path)


@pytest.mark.parametrize("separator", [";", "\t", " "])
@pytest.mark.parametrize("header", ["a{0}b{0}c\n", ""])
def test_decimal_commas_where_no_comma_separates(tmp_path, separator, header):
    rows = [[1.5, -0.25, 3.0], [2.5, 1e-3, 4.0]]
    lines = [separator.join(f"{v:g}".replace(".", ",") for v in row) for row in rows]
    file = tmp_path / "f.csv"
    file.write_text(header.format(separator) + "\n".join(lines) + "\n")
    found = read_columns(open_text(file), {"x": (1, 2, 3)})
    np.testing.assert_array_equal(found.numbers["x"], rows)


def test_a_tab_beside_a_comma_that_separates_is_white_space(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text("a,\tb\n1,\t2\n3,\t4\n")
    np.testing.assert_array_equal(
        read_columns(open_text(file), {"x": (1, 2)}).numbers["x"], [[1, 2], [3, 4]]
    )


@pytest.mark.parametrize("number", ["1.234,5", "1,234.5"])
def test_thousands_separators_are_refused_with_their_line(tmp_path, number):
    file = tmp_path / "f.csv"
    file.write_text(f"a;b\n1;2\n3;{number}\n")
    with pytest.raises(DataError, match=rf"f.csv:3: .*thousands separators, found '{number[:5]}"):
        open_text(file)


@pytest.mark.parametrize(
    "content",
    [
        "a,b\n1,2,\n3,4,\n",  # rows only
        "a,b,\n1,2,\n3,4,\n",  # header too
        "a,b,\n1,2\n3,4\n",  # header only
        "a,b\n1,2,,,\n3,4\n",  # a spreadsheet's further columns, and not in all rows
    ],
)
def test_trailing_separators_are_no_columns(tmp_path, content):
    file = tmp_path / "f.csv"
    file.write_text(content)
    source = open_text(file)
    assert source.names == ("a", "b")
    np.testing.assert_array_equal(
        read_columns(source, {"x": ("b", "a")}).numbers["x"], [[2, 1], [4, 3]]
    )


def test_a_named_last_column_may_be_empty_in_the_first_row(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text("a,b\n1,\n3,4\n")
    found = read_columns(open_text(file), {"b": ("b",)}, may_miss=("b",))
    np.testing.assert_array_equal(found.numbers["b"], [[np.nan], [4.0]])


def test_columns_without_a_name_leave_open_which_is_which(tmp_path):
    """People leave out the last name, R the first: only numbers are sure."""
    file = tmp_path / "f.csv"
    file.write_text("t,x\n1,2,3\n4,5,6\n")
    source = open_text(file)
    with pytest.raises(ConfigError, match=r"time: f.csv has 2 names above 3 columns.*1 … 3"):
        read_columns(source, {"time": ("t",)})
    np.testing.assert_array_equal(read_columns(source, {"x": (3,)}).numbers["x"], [[3], [6]])
