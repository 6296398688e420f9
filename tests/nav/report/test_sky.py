"""The satellites of a run: the geometry that its page draws."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.nav.report.sky import _dilution
from certnav.nav.signals import Signals


def _signals(rows: list[tuple[float, str, float, float]]) -> Signals:
    """Return signals from time, satellite, elevation and azimuth [°]."""
    time, sat, elevation, azimuth = zip(*rows, strict=True)
    nothing = np.full(len(rows), np.nan)
    return Signals(
        np.array(time), np.array(sat), np.full(len(rows), "1C"), nothing,
        np.deg2rad(elevation), np.deg2rad(azimuth), nothing, np.full(len(rows), ""),
    )  # fmt: skip


def test_dilution_of_one_above_and_three_at_the_horizon():
    """√(4/3) both ways; a second signal of a satellite adds nothing, three give no position."""
    around = [("G01", 0.0, 0.0), ("G02", 0.0, 120.0), ("G03", 0.0, 240.0)]
    four = [*around, ("G04", 90.0, 0.0)]
    t, dop = _dilution(_signals(
        [(10.0, *s) for s in around] + [(11.0, *s) for s in (*four, four[-1])]
        + [(12.0, *s) for s in four]
    ))  # fmt: skip
    assert t.tolist() == [11.0, 12.0]
    assert dop == pytest.approx(np.full((2, 2), np.sqrt(4 / 3)))


def test_satellites_in_one_direction_have_no_dilution():
    t, dop = _dilution(_signals([(0.0, f"G{k:02d}", 45.0, 30.0) for k in range(1, 6)]))
    assert t.size == 0 and dop.shape == (0, 2)
