"""Times as they are said: seconds of week where there is a date, the file's stamps where not."""

from __future__ import annotations

import pytest

from certnav.nav.notes import clock, counted_from, span_words, times_in

WEEK = 604800.0


@pytest.mark.parametrize("start", [-0.03, 0.25])
def test_a_clock_from_no_date_has_no_week(start):
    """Nor week −1, where resampled stamps begin just before zero."""
    assert span_words(start, 300.0).startswith(f"{start:.2f} … 300.00 s, no date")
    with counted_from(start):
        text = f"jumped from {clock(start)} to {clock(12.0)}"
    assert "SOW" not in text and "(+0.00 s)" in text
    assert times_in(text, start) == [pytest.approx(start), 12.0]


def test_seconds_of_week_where_there_is_a_date():
    start = 2129 * WEEK + 5.0
    assert span_words(start, start + 9.0).startswith("GPS week 2129, SOW 5.00 … 14.00")
    text = f"frozen from {clock(start + 1.0)}"
    assert "SOW 6.00" in text and times_in(text, start) == [start + 1.0]
