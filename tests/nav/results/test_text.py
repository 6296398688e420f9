"""Compiled formatting against Python's own."""

import numpy as np
import pytest

from certnav.nav.results.text import plain, row_blocks


def text(template, table):
    return b"".join(row_blocks(template, table))


@pytest.mark.parametrize("number", ["%.1f", "%.6f", "%.10f", "%.12f", "%.3g", "%.5g", "%d"])
def test_digits_are_those_of_c(number):
    rng = np.random.default_rng(5)
    size = rng.uniform(-9.0, 9.0, 3000)
    values = rng.standard_normal(3000) * 10.0**size
    if number.endswith("f"):
        values = values[np.abs(values) < 1e6]
    table = values[:, None]
    np.testing.assert_array_equal(text(number, table).split(), plain(number, table).split())


@pytest.mark.parametrize(
    "value",
    [0.0, -0.0, 1.0, -1.0, 0.1, 99999.5, 99999.4, 1e5, 1e-4, 0.00009999999, 123456.0, 9.9999995,
     0.9999996, 359.9999999999, np.nan, np.inf, -np.inf, 1e15, 3e15, 1e22, 5e-324, 1e308],
)  # fmt: skip
@pytest.mark.parametrize("number", ["%.4f", "%.5g"])
def test_awkward_values(value, number):
    table = np.array([[value]])
    assert text(number, table) == plain(number, table)


def test_rows_columns_and_blocks():
    table = np.arange(30.0).reshape(10, 3) / 7.0
    template = "%.3f,%d %.5g"
    expected = "".join(template % tuple(row) + "\n" for row in table.tolist())
    assert b"".join(row_blocks(template, table, rows_at_once=4)) == expected.encode()


def test_other_templates_go_through_python():
    table = np.array([[1.5, 2.0]])
    assert text("%8.3f: %s", table) == b"   1.500: 2.0\n"
    assert text("%.4f", np.empty((0, 1))) == b""
