"""Every scale puts the same instant at the same GPS time; stamps of another scale are refused."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets import gpstime
from certnav.datasets.text.columns import open_text, read_columns
from certnav.datasets.text.tables import increasing
from certnav.datasets.time_scales import SCALES, TimeScale, evenly_spaced, gps_time
from certnav.filters.errors import DataError

#: 2025-07-08 19:34:18.5 in GPS time; UTC is 18 s less.
NOON = gpstime.from_calendar(2025, 7, 8, 19, 34, 18.5)
WEEK, SOW = (float(v) for v in gpstime.to_week_sow(NOON))
UNIX = NOON + 315964800.0 - 18.0


def converted(tmp_path, scale, *rows):
    return converted_table(tmp_path, scale, *rows)[1]


def converted_table(tmp_path, scale, *rows):
    file = tmp_path / "f.csv"
    file.write_text("\n".join(f"{row},0,0,0" for row in rows) + "\n")
    columns = (1, 2) if scale.name == "gps-week-sow" else (1,)
    found = read_columns(
        open_text(file),
        {} if scale.is_text else {"time": columns},
        {"time": columns} if scale.is_text else {},
    )
    return found.table, gps_time(
        found.table, scale, found.numbers.get("time", np.empty((0, 0))), found.text.get("time", [])
    )


@pytest.mark.parametrize(
    ("scale", "stamp"),
    [
        (TimeScale("gps"), f"{NOON:.3f}"),
        (TimeScale("gps", unit="ms"), f"{NOON * 1e3:.0f}"),
        (TimeScale("gps-sow", week=int(WEEK)), f"{SOW:.3f}"),
        (TimeScale("gps-week-sow"), f"{WEEK:.0f},{SOW:.3f}"),
        (TimeScale("gps-calendar"), "2025-07-08T19:34:18.500"),
        (TimeScale("gps-calendar"), "2025/07/08 19:34:18.5"),
        (TimeScale("utc"), "2025-07-08 19:34:00.5"),
        (TimeScale("utc"), "2025-07-08T19:34:00.5Z"),
        (TimeScale("utc"), "2025-07-08T21:34:00.5+02:00"),
        (TimeScale("unix"), f"{UNIX:.3f}"),
        (TimeScale("unix", unit="us"), f"{UNIX * 1e6:.0f}"),
        (TimeScale("unix", unit="ns"), f"{UNIX:.1f}".replace(".", "") + "0" * 8),
        (TimeScale("unix", offset=-18.0), f"{UNIX + 18.0:.3f}"),
        (TimeScale("relative", offset=NOON), "0.0"),
    ],
)
def test_one_instant_in_every_scale(tmp_path, scale, stamp):
    assert converted(tmp_path, scale, stamp)[0] == pytest.approx(NOON, abs=1e-6)
    assert scale.name in SCALES


def test_leap_seconds_are_those_of_the_day(tmp_path):
    for year, leap in ((2025, 18), (2016, 17), (2013, 16)):
        scales = (TimeScale("utc"), TimeScale("gps-calendar"))
        utc, gps = (converted(tmp_path, scale, f"{year}-01-08 00:00:00")[0] for scale in scales)
        assert utc - gps == leap


def test_seconds_of_week_run_over_the_end_of_the_week(tmp_path):
    time = converted(tmp_path, TimeScale("gps-sow", week=2129), 604799.5, 0.5, 1.5)
    np.testing.assert_allclose(np.diff(time), 1.0)
    assert time[0] == 2129 * 604800 + 604799.5


@pytest.mark.parametrize(
    ("scale", "stamp", "message"),
    [
        (TimeScale("gps"), f"{SOW}", r"gps time: expected .* would fit time_scale = \"gps-sow\""),
        (TimeScale("gps-sow", week=1), f"{NOON}", 'would fit time_scale = "gps"'),
        (TimeScale("unix"), f"{UNIX * 1e3:.0f}", 'time_scale = "unix", time_unit = "ms"'),
        (TimeScale("gps-week-sow"), f"{SOW},{WEEK}", r"f\.csv:1: GPS week"),
        (TimeScale("utc"), "2025-13-08 00:00:00", r"f\.csv:1: time: expected a date such as"),
        (TimeScale("utc"), f"{UNIX}", "expected a date"),
    ],
)
def test_stamps_of_another_scale_are_refused(tmp_path, scale, stamp, message):
    with pytest.raises(DataError, match=message):
        converted(tmp_path, scale, stamp)


@pytest.mark.parametrize("lag", [-7, 0, 7])
@pytest.mark.parametrize("begin", [-40, -3, 2])
def test_a_week_number_out_of_step_at_the_end_of_the_week_is_mended(tmp_path, lag, begin):
    """Week and seconds of week by two tasks; also where the file begins or ends in between."""
    k = np.arange(begin, begin + 60)
    time = 2130 * 604800.0 + 0.5 * k
    week = 2129 + (k >= lag)
    rows = [f"{w},{t % 604800.0:.1f}" for w, t in zip(week, time, strict=True)]
    np.testing.assert_array_equal(converted(tmp_path, TimeScale("gps-week-sow"), *rows), time)


def test_a_week_number_out_of_step_elsewhere_is_left_to_be_refused(tmp_path):
    rows = [f"{2129 + (k in (4, 5))},{300000 + k}" for k in range(20)]
    table, time = converted_table(tmp_path, TimeScale("gps-week-sow"), *rows)
    with pytest.raises(DataError, match=r"f.csv:7: time: expected increasing"):
        increasing(table, time, "time")


@pytest.mark.parametrize(("digits", "step"), [(0, "1"), (-1, "10"), (2, "0.01")])
def test_rounded_stamps_are_called_so(tmp_path, digits, step):
    stamps = np.round(1000.0 + 0.004 * np.arange(20000), digits)
    table, time = converted_table(tmp_path, TimeScale("relative"), *stamps)
    with pytest.raises(
        DataError, match=rf"in steps of {step} s: rounded by a spreadsheet\?.*rate_hz"
    ):
        increasing(table, time, "time")


def test_a_few_repeated_rows_are_not_called_rounded(tmp_path):
    stamps = [*range(50), 49, *range(50, 60)]
    table, time = converted_table(tmp_path, TimeScale("relative"), *stamps)
    with pytest.raises(DataError, match=r"f.csv:51: .*sort the file or remove the repeated rows"):
        increasing(table, time, "time")


@pytest.mark.parametrize("digits", [0, 1, 2])
def test_a_declared_rate_puts_rounded_stamps_back(tmp_path, digits):
    true = 1000.3 + 0.004 * np.arange(20000)
    table, time = converted_table(tmp_path, TimeScale("relative"), *np.round(true, digits))
    np.testing.assert_allclose(evenly_spaced(table, time, 250.0), true, rtol=0, atol=0.0041)


def test_a_rate_that_the_stamps_do_not_keep_is_refused(tmp_path):
    true = 1000.3 + 0.004 * np.arange(20000)
    table, time = converted_table(tmp_path, TimeScale("relative"), *np.round(true, 1))
    with pytest.raises(DataError, match=r"at 200 Hz \(rate_hz\).*on average 249.988"):
        evenly_spaced(table, time, 200.0)
    lost = np.delete(true, slice(9000, 9100))
    table, time = converted_table(tmp_path, TimeScale("relative"), *np.round(lost, 1))
    with pytest.raises(DataError, match="rows are missing"):
        evenly_spaced(table, time, 250.0)
