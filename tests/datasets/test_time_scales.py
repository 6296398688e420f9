"""Every scale puts the same instant at the same GPS time; stamps of another scale are refused."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets import gpstime
from certnav.datasets.text.columns import open_text, read_columns
from certnav.datasets.time_scales import SCALES, TimeScale, gps_time
from certnav.filters.errors import DataError

#: 2025-07-08 19:34:18.5 in GPS time; UTC is 18 s less.
NOON = gpstime.from_calendar(2025, 7, 8, 19, 34, 18.5)
WEEK, SOW = (float(v) for v in gpstime.to_week_sow(NOON))
UNIX = NOON + 315964800.0 - 18.0


def converted(tmp_path, scale, *rows):
    file = tmp_path / "f.csv"
    file.write_text("\n".join(f"{row},0,0,0" for row in rows) + "\n")
    columns = (1, 2) if scale.name == "gps-week-sow" else (1,)
    found = read_columns(
        open_text(file),
        {} if scale.is_text else {"time": columns},
        {"time": columns} if scale.is_text else {},
    )
    return gps_time(
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
