"""Findings and the page: order, verdict, strict JSON."""

from __future__ import annotations

import json

import pytest

from certnav.nav.check.findings import Finding, Report, in_order
from certnav.nav.notes import clock

NOTE = Finding("note", "gyro", "in order", numbers={"ratio": 1.0})
DOUBT = Finding("doubtful", "time", "0.1 s late", "subtract it", {"sigma": float("nan")})
FATAL = Finding("fatal", "gravity", "0 m/s²", "use the raw accelerometer")


def test_unknown_severity_is_refused():
    with pytest.raises(ValueError, match="severity"):
        Finding("bad", "x", "y")


@pytest.mark.parametrize(
    ("findings", "navigable", "verdict"),
    [
        ([NOTE], True, "can be navigated; nothing doubtful"),
        ([NOTE, DOUBT], True, "can be navigated; 1 doubtful finding"),
        ([NOTE, FATAL, FATAL], False, "cannot be navigated: 2 fatal findings"),
    ],
)
def test_verdict(findings, navigable, verdict):
    report = Report("drive", (), in_order(findings))
    assert report.navigable is navigable
    assert report.verdict == verdict


def test_worst_comes_first_and_the_page_says_what_to_declare():
    report = Report("drive", ("IMU: 10 rows",), in_order([NOTE, DOUBT, FATAL]))
    assert [f.severity for f in report.findings] == ["fatal", "doubtful", "note"]
    text = report.text()
    assert text.index("Fatal") < text.index("Doubtful") < text.index("in order")
    declare = text[text.index("To declare") :]
    assert "use the raw accelerometer" in declare and "subtract it" in declare
    assert max(map(len, text.splitlines())) <= 100


def test_json_is_strict():
    def refuse(constant: str) -> None:
        raise AssertionError(f"not strict: {constant}")

    report = Report("drive", (), (DOUBT,))
    read = json.loads(json.dumps(report.as_dict(), allow_nan=False), parse_constant=refuse)
    assert read["findings"][0]["numbers"] == {"sigma": None}
    assert read["navigable"] is True


def test_clock_prints_what_files_print():
    assert clock(2129 * 604800.0 + 180600.25) == "SOW 180600.25"
    assert clock(12.5) == "12.50 s"
