"""IMU text: what may stand in a file, what is refused and where, and the conversion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from certnav.datasets.text.imu import read_imu_table, read_imu_text
from certnav.filters.errors import ConfigError, DataError

ROWS = [
    "180590.00000 0.1000000000 -0.2000000000 0.3000000000 0.0100000000 0.0200000000 9.7900000000",
    "180590.01000 0.1100000000 -0.2100000000 0.3100000000 0.0110000000 0.0210000000 9.7910000000",
    "180590.02000 0.1200000000 -0.2200000000 0.3200000000 0.0120000000 0.0220000000 9.7920000000",
    "180590.03000 0.1300000000 -0.2300000000 0.3300000000 0.0130000000 0.0230000000 9.7930000000",
]


def write(folder: Path, *lines: str) -> Path:
    file = folder / "MEMS_imu_data.txt"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


@pytest.mark.parametrize(
    "header",
    [
        [],
        ["Time gx gy gz ax ay az"],
        ["# sow gyro accel"],
        ["%Time(s) gx(deg/s)", "T second header line"],
        ["", "# after a blank line"],
    ],
)
def test_any_number_of_header_lines_is_skipped(tmp_path, header):
    table = read_imu_table(write(tmp_path, *header, *ROWS))
    assert table.sow.tolist() == [180590.0, 180590.01, 180590.02, 180590.03]
    np.testing.assert_array_equal(table.gyro[0], [0.1, -0.2, 0.3])
    np.testing.assert_array_equal(table.accel[3], [0.013, 0.023, 9.793])
    named = [line for line in header if line]
    assert any("skipped" in note for note in table.notes) == bool(named)


def test_right_forward_up_becomes_forward_right_down_in_si(tmp_path):
    imu = read_imu_text(write(tmp_path, *ROWS), week=2129, gyro_unit="deg/s")
    np.testing.assert_allclose(imu.gyro_b[0], np.radians([-0.2, 0.1, -0.3]), rtol=1e-15)
    np.testing.assert_array_equal(imu.accel_b[0], [0.02, 0.01, -9.79])
    assert imu.time[0] == 2129 * 604800.0 + 180590.0
    in_radians = read_imu_text(write(tmp_path, *ROWS), week=2129, gyro_unit="rad/s")
    np.testing.assert_array_equal(in_radians.gyro_b[0], [-0.2, 0.1, -0.3])


@pytest.mark.parametrize("axes", ["RFU", "FLU", "FRD"])
def test_axes_are_rotations_that_leave_lengths_and_handedness(tmp_path, axes):
    imu = read_imu_text(write(tmp_path, *ROWS), week=1, gyro_unit="rad/s", axes=axes)
    raw = read_imu_table(write(tmp_path, *ROWS))
    lengths = np.linalg.norm(raw.accel, axis=1)
    np.testing.assert_allclose(np.linalg.norm(imu.accel_b, axis=1), lengths, rtol=1e-15)
    triple = np.einsum("ni,ni->n", np.cross(imu.gyro_b, imu.accel_b), imu.gyro_b + imu.accel_b)
    assert np.abs(triple).max() < 1e-12
    np.testing.assert_allclose(
        np.cross(imu.gyro_b, imu.accel_b)[:, 2] * (1 if axes == "FRD" else -1),
        np.cross(raw.gyro, raw.accel)[:, 2],
        rtol=1e-12,
    )


def test_accelerometer_in_g(tmp_path):
    rows = ["0.0 0 0 0 0 0 1", "0.01 0 0 0 0 0 1"]
    imu = read_imu_text(write(tmp_path, *rows), week=1, gyro_unit="rad/s", accel_unit="g")
    np.testing.assert_array_equal(imu.accel_b[:, 2], [-9.80665, -9.80665])


@pytest.mark.parametrize(
    ("row", "found"),
    [
        ("180590.02000 0.12 -0.22 nan 0.012 0.022 9.792", r"gz: .*finite.*'nan'"),
        ("180590.02000 0.12 -0.22 inf 0.012 0.022 9.792", r"gz: .*finite.*'inf'"),
        ("180590.02000 0.12 -0.22 0.3.2 0.012 0.022 9.792", r"gz: .*'0\.3\.2'"),
        ("180590.02000 0.12 -0.22 0.32 0.012 0.022", r"expected 7 columns .*found 6"),
        ("180590.02000 0.12 -0.22 0.32 0.012 0.022 9.792 1", r"expected 7 columns .*found 8"),
        (
            "180590.00500 0.12 -0.22 0.32 0.012 0.022 9.792",
            r"sow: .*increasing time.*90\.005.*90\.01",
        ),
        ("180590.01000 0.12 -0.22 0.32 0.012 0.022 9.792", r"sow: .*increasing time"),
        ("-1.0 0.12 -0.22 0.32 0.012 0.022 9.792", r"sow: .*seconds of week"),
        ("1603765808.02 0.12 -0.22 0.32 0.012 0.022 9.792", r"sow: .*seconds of week"),
    ],
)
@pytest.mark.parametrize("header", [[], ["# one"], ["# one", "", "# two"]])
def test_a_bad_row_is_refused_with_its_line(tmp_path, header, row, found):
    file = write(tmp_path, *header, *ROWS[:2], row, ROWS[3])
    line = len(header) + 3
    with pytest.raises(DataError, match=rf"MEMS_imu_data\.txt:{line}: {found}") as caught:
        read_imu_table(file)
    assert caught.value.line == line
    assert "\n" not in str(caught.value)
    assert caught.value.remedy


def test_lines_without_data_in_the_middle_are_skipped_and_reported(tmp_path):
    table = read_imu_table(write(tmp_path, *ROWS[:2], "# restart", "", *ROWS[2:]))
    assert table.sow.size == 4
    assert any("skipped lines without data: 3" in note for note in table.notes)


def test_dropped_epochs_keep_their_true_intervals_and_are_reported(tmp_path):
    table = read_imu_table(write(tmp_path, *ROWS, *(ROWS[0].replace("590.0", "590.1"),)))
    np.testing.assert_allclose(np.diff(table.sow), [0.01, 0.01, 0.01, 0.07])
    assert any("6 dropped in 1 gaps, longest 0.07 s" in note for note in table.notes)


def test_the_end_of_the_week_is_not_time_going_backwards(tmp_path):
    rows = ["604799.99 0 0 0 0 0 9.8", "0.00 0 0 0 0 0 9.8", "0.01 0 0 0 0 0 9.8"]
    imu = read_imu_text(write(tmp_path, *rows), week=2129, gyro_unit="rad/s")
    np.testing.assert_allclose(np.diff(imu.time), 0.01, atol=1e-6)
    assert imu.time[1] == 2130 * 604800.0


def test_unknown_units_axes_and_files(tmp_path):
    file = write(tmp_path, *ROWS)
    for key in ("gyro_unit", "accel_unit", "axes"):
        with pytest.raises(ConfigError, match=key):
            read_imu_text(file, **{"week": 1, "gyro_unit": "deg/s", key: "furlong"})
    with pytest.raises(DataError, match="not found"):
        read_imu_table(tmp_path / "nowhere.txt")
    with pytest.raises(DataError, match="found none"):
        read_imu_table(write(tmp_path, "# nothing but a header"))
    (tmp_path / "binary.txt").write_bytes(b"\xff\xfe\x00\x93" * 100)
    with pytest.raises(DataError, match="binary"):
        read_imu_table(tmp_path / "binary.txt")


def test_a_long_file_is_read_exactly(tmp_path):
    n = 24_001
    rng = np.random.default_rng(0)
    data = np.column_stack([367140.0 + 0.01 * np.arange(n), rng.normal(size=(n, 6))])
    file = tmp_path / "ADIS.txt"
    np.savetxt(file, data, fmt=["%.5f", *6 * ["%.10f"]])
    table = read_imu_table(file)
    np.testing.assert_allclose(table.sow, data[:, 0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(np.hstack([table.gyro, table.accel]), data[:, 1:], atol=5.1e-11)
