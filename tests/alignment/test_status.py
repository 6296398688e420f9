"""What is proved of a rotation: the inequality, the region it leaves, and the word for both."""

from __future__ import annotations

import math

import numpy as np
import pytest

from certnav.alignment.status import GAP, REGION, AlignmentStatus, Growth

CASES = [(1.0, 1e-4, 0.0), (1.0, 1e-4, 1e-6), (3.0, 0.3, 0.0), (5.0, 0.0, 0.02), (0.1, 0.2, 0.0)]


def growth_at(growth: Growth, theta: np.ndarray) -> np.ndarray:
    """Return what f(R) − f(C) is at least, θ away."""
    w2 = np.cos(0.5 * theta) ** 2
    a = np.sqrt(1.0 - w2 * w2)
    return growth.margin * a * a - 2.0 * growth.slope * w2 * a - growth.offset


@pytest.mark.parametrize(("margin", "slope", "offset"), CASES)
def test_nothing_costs_less_beyond_the_region_nor_by_more_than_the_gap(margin, slope, offset):
    growth = Growth(margin, slope, 10.0, offset)
    theta = np.linspace(0.0, np.pi, 20_001)
    least = growth_at(growth, theta)
    assert np.all(least[theta > growth.region] >= -1e-12)
    assert least.min() >= -growth.gap
    # Neither is larger than it has to be, but for w² ≤ 1 where the region is wide.
    if growth.region < 0.1:
        assert growth_at(growth, np.array(0.9 * growth.region)) < 0.0
        assert least.min() == pytest.approx(-growth.gap, rel=0.05)


def test_a_region_is_twice_the_slope_over_the_margin():
    """θ ≈ √2 a for small a, and a = 2κ/t."""
    growth = Growth(1e3, 1e-5, 1e6)
    assert growth.region == pytest.approx(math.sqrt(2.0) * 2.0 * 1e-5 / 1e3, rel=1e-9)
    assert growth.gap == pytest.approx(1e-10 / 1e3)


def test_without_a_margin_nothing_is_unique():
    for margin in (0.0, -1e-6):
        growth = Growth(margin, 1e-7, 1e3)
        assert growth.region == math.pi
        assert growth.gap == pytest.approx(2e-7 - margin)
    # More slope than margin: a cheaper rotation may be anywhere.
    assert Growth(1e-7, 1e-7, 1e3).region == math.pi


@pytest.mark.parametrize(
    ("growth", "status"),
    [
        (Growth(1.0, 1e-9, 1e3), AlignmentStatus.CERTIFIED),
        (Growth(1e-7, 1e-9, 1e3), AlignmentStatus.AMBIGUOUS),  # region 1.6°
        (Growth(-1e-8, 1e-9, 1e3), AlignmentStatus.AMBIGUOUS),
        (Growth(-1e-3, 1e-9, 1e3), AlignmentStatus.NOT_TIGHT),
        (Growth(-1e-3, 1e-3, 1e3), AlignmentStatus.NUMERICAL),  # no stationary point
        (Growth(-38e3, 1.0, 1e14), AlignmentStatus.NUMERICAL),  # 4e-10 of tr Q, and 38,000 χ²
        (Growth(1e3, 100.0, 1e14), AlignmentStatus.NUMERICAL),
        (Growth(1e9, 100.0, 1e14), AlignmentStatus.CERTIFIED),
    ],
)
def test_one_rule_makes_the_word(growth, status):
    assert growth.status is status
    if status is AlignmentStatus.CERTIFIED:
        assert growth.gap <= GAP and growth.region <= REGION
