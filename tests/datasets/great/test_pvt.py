"""GREAT-PVT solutions: zero velocity is none, and a column more or less is refused."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.great.pvt import is_flt, read_flt
from certnav.filters.errors import DataError

HEADER = (
    "# SOW X Y Z Vx Vy Vz X-RMS Y-RMS Z-RMS Vx-RMS Vy-RMS Vz-RMS NSat PDOP sigma0 AmbStatus "
    "Ratio BL Quality\n# (s) (m) (m) (m)\n"
)


def row(sow, vx="0.000", status="Fixed", rms="0.01 0.02 0.03", vel_rms="0 0 0"):
    x = -2267776.0 + 5.0 * (float(sow) - 180000.0) * (vx != "0.000")
    return (
        f"{sow} {x:.4f} 5009357.4317 3220982.1038 {vx} 0.000 0.000 {rms} {vel_rms} "
        f"15 1.2 0.5 {status} 12.3 4500.1 1\n"
    )


def write(folder, text):
    file = folder / "rover.flt"
    file.write_text(text)
    return file


def test_rtk_without_velocity(tmp_path):
    file = write(tmp_path, HEADER + row(180000.0) + row(180001.0, status="Float"))
    assert is_flt(file)
    fixes, notes = read_flt(file, week=2129)
    assert not fixes.has_velocity.any()
    assert list(fixes.quality) == ["fixed", "float"]
    assert list(fixes.satellites) == [15, 15]
    np.testing.assert_array_equal(fixes.time, 2129 * 604800 + np.array([180000.0, 180001.0]))
    np.testing.assert_allclose(fixes.pos_cov_e[0], np.diag([1e-4, 4e-4, 9e-4]), atol=1e-15)
    assert any("velocity 0" in note for note in notes)


def test_velocity_where_there_is_one(tmp_path):
    rows = "".join(row(180000.0 + k, vx="5.000", vel_rms="0.1 0.1 0.1") for k in range(20))
    fixes, notes = read_flt(write(tmp_path, HEADER + rows), week=2129)
    assert fixes.has_velocity.all()
    assert len(notes) == 1
    rows = rows.replace(" 5.000 ", " -5.000 ")
    with pytest.raises(DataError, match="the velocity has the opposite sign"):
        read_flt(write(tmp_path, HEADER + rows), week=2129)


def test_the_end_of_the_week(tmp_path):
    fixes, _ = read_flt(write(tmp_path, HEADER + row(604799.0) + row(0.0)), week=2129)
    assert np.diff(fixes.time)[0] == 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEADER + row(180000.0).replace(" 1\n", "\n"), "expected 20 columns"),
        (HEADER.replace(" BL", "") + row(180000.0), r"rover\.flt:1: expected Ratio BL Quality"),
        (HEADER + row(180000.0) + row(180000.0), r"rover\.flt:4: SOW: expected increasing"),
        (HEADER + row(180000.0, rms="0 0 0"), r"rover\.flt:3: .*RMS > 0"),
        (HEADER + row(180000.0).replace("3220982", "0220982"), "ECEF position"),
        (HEADER, "expected rows of SOW"),
    ],
)
def test_what_is_refused(tmp_path, text, message):
    with pytest.raises(DataError, match=message):
        read_flt(write(tmp_path, text), week=2129)
