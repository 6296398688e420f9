"""Compiled reading of plain tables: Python's own numbers, or no answer."""

import sys

import numpy as np
import pytest

from certnav.datasets.text import numbers
from certnav.datasets.text.numbers import read_numbers
from certnav.datasets.text.tables import read_table
from certnav.filters.errors import DataError

RNG = np.random.default_rng(11)


def written(tmp_path, text):
    file = tmp_path / "t.txt"
    file.write_bytes(text.encode())
    return file


@pytest.mark.parametrize("style", ["%.6f", "%.12e", "%.18e", "%g", "%+.3f", "%.17g", "%025.9f"])
def test_every_number_is_the_one_python_reads(tmp_path, style):
    """From denormals to the largest double, to the last bit, in any common way of writing."""
    scale = 10.0 ** RNG.integers(-8 if "f" in style else -300, 9 if "f" in style else 300, (400, 3))
    table = RNG.choice([-1.0, 1.0], (400, 3)) * RNG.uniform(0.1, 1.0, (400, 3)) * scale
    text = "".join(" ".join(style % x for x in row) + "\n" for row in table)
    values, line = read_numbers(written(tmp_path, text), 3, True)
    expected = [[float(token) for token in row.split()] for row in text.splitlines()]
    np.testing.assert_array_equal(values, expected)
    np.testing.assert_array_equal(line, np.arange(1, 401))


@pytest.mark.parametrize(
    "token",
    ["0", "-0.0", "5.", ".5", "+7", "1e5", "1E-05", "9007199254740993", "1e22", "1e23", "3e-324",
     "0.1e1", "00012.50", "123456789012345678901234567890", "1.7976931348623157e308", "1e-400"],
)  # fmt: skip
def test_odd_but_valid_numbers(tmp_path, token):
    values, _ = read_numbers(written(tmp_path, f"{token} 1\n"), 2, True)
    assert values[0, 0] == float(token)
    assert np.signbit(values[0, 0]) == np.signbit(float(token))


def test_blank_lines_tabs_and_windows_ends_keep_the_line_numbers(tmp_path):
    text = "\r\n  1\t2 \r\n\r\n \t\r\n3 4\r\n5 6"
    values, line = read_numbers(written(tmp_path, text), 2, True)
    np.testing.assert_array_equal(values, [[1, 2], [3, 4], [5, 6]])
    np.testing.assert_array_equal(line, [2, 5, 6])


def test_further_columns_are_left_alone_only_where_that_is_wanted(tmp_path):
    file = written(tmp_path, "1 2 x 9\n3 4 5\n")
    assert read_numbers(file, 2, True) is None
    np.testing.assert_array_equal(read_numbers(file, 2, False)[0], [[1, 2], [3, 4]])


@pytest.mark.parametrize(
    "text",
    ["", "\n \n", "a b\n", "1 2\n3\n", "1 2\n3", "1 x\n", "1 nan\n", "1 inf\n", "1 2e\n", "1 -\n",
     "1 0x1\n", "1 .\n", "1,2\n", "1 1_0\n", "1 2\r3 4\r", "1 1e400\n", "\ufeff1 2\n", "1 2\0\n",
     "1 1.2.3\n", "1 ²\n", "# h\n1 2\n", "1 e5\n", "1 --2\n"],
)  # fmt: skip
def test_anything_else_gets_a_closer_look(tmp_path, text):
    assert read_numbers(written(tmp_path, text), 2, True) is None


def test_a_missing_file_is_for_the_reader_to_report(tmp_path):
    assert read_numbers(tmp_path / "no.txt", 2, True) is None
    assert read_numbers(tmp_path, 2, True) is None
    with pytest.raises(DataError, match=r"no\.txt.*file not found"):
        read_table(tmp_path / "no.txt", ("a", "b"))


def test_both_ways_of_reading_agree(tmp_path):
    """A header sends the same rows through pandas: the same table, one line further down."""
    rows = "".join(f"{x:.9f} {y:.12e}\n" for x, y in RNG.standard_normal((500, 2)))
    plain = read_table(written(tmp_path, rows), ("a", "b"))
    headed = read_table(written(tmp_path, "time value\n" + rows), ("a", "b"))
    np.testing.assert_allclose(plain.values, headed.values, rtol=4 * sys.float_info.epsilon)
    np.testing.assert_array_equal(plain.line + 1, headed.line)
    assert plain.skipped == () and headed.skipped == (1,)


@pytest.mark.parametrize("piece", [1, 7, 64, 1000])
@pytest.mark.parametrize("end", ["", "\n", "\n\n"])
def test_a_file_in_pieces_is_the_file(tmp_path, monkeypatch, piece, end):
    rng = np.random.default_rng(4)
    lines = [" ".join(f"{x:.17g}" for x in row) for row in rng.standard_normal((40, 3))]
    lines[7:7] = ["", "  "]
    file = tmp_path / "table.txt"
    file.write_text("\n".join(lines) + end)
    whole = read_numbers(file, 3, True)
    monkeypatch.setattr(numbers, "_PIECE", piece)
    values, line = read_numbers(file, 3, True)
    np.testing.assert_array_equal(values, whole[0])
    np.testing.assert_array_equal(line, whole[1])
    assert line[7] == 10 and values[39].tolist() == [float(x) for x in lines[41].split()]
    file.write_text("\n".join([*lines, "1 2"]))
    assert read_numbers(file, 3, True) is None
