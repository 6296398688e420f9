"""Marks against their definitions; every pair and epoch that is refused says why."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.filters.errors import ConfigError
from certnav.velocity.screening import (
    REASONS,
    Screening,
    epoch_reasons,
    reason_counts,
    reasons,
    screen,
    usable_pairs,
    usable_rows,
)
from certnav.velocity.study.pairs import Pairs


def pairs(**columns):
    """Six pairs of four epochs (2, 3, 1 and 0 satellites … one with two)."""
    values = {
        "epoch": [0, 1, 1, 1, 4],
        "a": [0, 2, 2, 3, 6],
        "b": [1, 3, 4, 4, 7],
        "k": [0.5, 0.2, 0.3, 0.05, 0.9],
        "cosine": [0.9, 0.15, 0.3, 0.1, 0.7],
        "cn0_mean": [45.0, 45.0, 40.0, 38.0, np.nan],
        "cn0_min": [39.0, 44.0, 38.0, 37.0, np.nan],
        "elevation_min": np.radians([5.0, 30.0, 30.0, 30.0, np.nan]),
        "speed": np.ones(5),
        "sigma": np.ones(5),
        "residual": [np.nan, 1.0, -4.0, 0.5, np.nan],
        "counts": [2, 3, 1, 0, 2],
    }
    values |= columns
    return Pairs(**{name: np.asarray(value) for name, value in values.items()})


def test_thresholds_have_to_be_exceeded():
    marks = screen(pairs(), Screening(min_cn0_dbhz=40.0, min_k=0.2))
    assert list(reasons(marks)) == [
        "", "singular geometry", "weak signal", "weak signal and singular geometry", "C/N0 unknown",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "screening, usable",
    [
        (Screening(40.0, "min", 0.1), [1]),
        (Screening(0.0, min_k=0.0), [0, 1, 2, 3, 4]),
        (Screening(0.0, min_k=0.25, k_of="cosine"), [0, 2, 4]),
        (Screening(0.0, min_k=0.0, min_elevation_deg=10.0), [1, 2, 3, 4]),
        (Screening(0.0, min_k=0.0, max_residual=3.0), [0, 1, 3, 4]),
    ],
)
def test_each_threshold_alone(screening, usable):
    assert list(np.flatnonzero(screen(pairs(), screening) == 0)) == usable


def test_epochs_say_why_nothing_is_left():
    found = pairs(k=np.array([0.5, 0.1, 0.1, 0.1, 0.9]))
    marks = screen(found, Screening(min_cn0_dbhz=42.0))
    assert epoch_reasons(found, marks) == [
        "", "weak signal 2, singular geometry 3", "only one satellite", "no satellites",
        "C/N0 unknown 1",
    ]  # fmt: skip
    assert list(usable_pairs(found, marks)) == [1, 0, 0, 0, 0]
    assert list(np.flatnonzero(usable_rows(found, marks, 8))) == [0, 1]
    assert reason_counts(marks) == dict(zip(REASONS, [1, 2, 3, 0, 0], strict=True))


@pytest.mark.parametrize(
    "options, named",
    [
        ({"cn0_of": "max"}, "cn0_of: expected mean or min, found 'max'"),
        ({"k_of": "angle"}, "k_of: expected sdv or cosine"),
        ({"min_cn0_dbhz": 90.0}, "min_cn0_dbhz: expected 0 … 70"),
        ({"min_k": 2.5}, "min_k: expected"),
        ({"max_residual": 0.0}, "max_residual"),
    ],
)
def test_impossible_thresholds_are_refused(options, named):
    with pytest.raises(ConfigError, match=named):
        Screening(**options)
