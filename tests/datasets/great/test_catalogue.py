"""The catalogue agrees with the calendar and with itself."""

from __future__ import annotations

import pytest

from certnav.datasets import gpstime
from certnav.datasets.great.catalogue import (
    GREAT,
    PAGE,
    catalogue_text,
    entry,
    great_sequence,
    named_in,
)
from certnav.filters.errors import ConfigError


def test_week_and_day_are_those_of_the_date():
    for e in GREAT:
        year, month, day = (int(part) for part in e.date.split("-"))
        week, sow = gpstime.to_week_sow(gpstime.from_calendar(year, month, day))
        assert (int(week), float(sow)) == (e.week, e.day * 86400.0), e.name


def test_eight_sequences_and_the_one_without_a_drawn_antenna():
    assert len({e.name for e in GREAT}) == 8
    assert [e.name for e in GREAT if not e.lever_known] == ["urban-02"]


def test_names_however_spelt():
    assert entry("Campus_01").name == "campus-01"
    assert entry("campus01").name == "campus-01"
    assert entry("campus") is None
    assert named_in("Dataset_campus-night").name == "campus-night"
    assert named_in("suburb02_IMU.zip").name == "suburb-02"
    assert named_in("IMU.zip") is None
    assert named_in("campus-01 and campus-02") is None


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ("campus-09", "of campus there are campus-01, campus-02, campus-03, campus-night$"),
        ("Urban_7", "of urban there are urban-01, urban-02$"),
        ("suburb", "of suburb there are suburb-01, suburb-02$"),
        ("cmpus-01", "did you mean 'campus-01'"),
    ],
)
def test_a_name_that_is_none_is_answered_by_its_place(tmp_path, asked, words):
    with pytest.raises(ConfigError, match=words):
        great_sequence(tmp_path, asked, {})


def test_the_table_says_what_is_known_and_fits_a_terminal():
    text = catalogue_text()
    assert PAGE in text
    for e in GREAT:
        assert f"{e.name} " in text
        assert e.date in text
    for words in ("0.24 m", "not drawn", "reference_point", "datasets import"):
        assert words in text
    assert max(map(len, text.splitlines())) <= 100
    assert "1drv.ms" not in text
