"""The calibration of a run: what it estimated, what it was told, what no motion has shown."""

from __future__ import annotations

import re

import numpy as np
import pytest

from certnav.nav.installation import AntennaPlace, Installation
from certnav.nav.report.calibration import calibration
from certnav.nav.results.summary import strict


def place(sigma, prior, delay_sigma=0.0):
    lever = np.array([-0.65, -0.05, -0.15])
    return AntennaPlace(lever, np.array(sigma), np.array(prior), 0.02, delay_sigma, 0.1)


@pytest.fixture
def figures():
    def make(off=""):
        found = Installation(
            off, "tape measure", np.eye(3), np.radians(0.5) ** 2 * np.eye(2),
            np.array([-0.5, 0.0, 1.4]), np.array([0.1, 0.0]),
            place([0.02, 0.3, 0.0], [0.3, 0.3, 0.0]),
        )  # fmt: skip
        return strict(found.figures())

    return make


def rows(html):
    """Return the cells of each row by its name."""
    lines = re.findall(r"<tr><th[^>]*>([^<]*)</th>(.*?)</tr>", html)
    return {name: re.findall(r"<td[^>]*>([^<]*)</td>", cells) for name, cells in lines}


def test_every_constant_has_its_sigma_and_says_where_it_comes_from(figures):
    found = rows(calibration(figures()))
    assert found["IMU in the vehicle, yaw"] == ["°", "+0.000", "0.500", "the run"]
    assert found["wheels, down of the IMU"] == ["m", "+1.400", "–", "tape measure, taken as exact"]
    assert found["antenna, forward of the IMU"] == ["m", "−0.650", "0.020", "the run"]
    assert found["antenna, right of the IMU"][-1] == "not observed: as it was assumed"
    assert found["antenna, down of the IMU"][-1] == "declared, taken as exact"


def test_what_was_not_used_is_not_told_as_known(figures):
    page = calibration(figures(off="a <boat>"))
    assert "were not used: a &lt;boat&gt;." in page
    assert not any("vehicle" in name or "wheels" in name for name in rows(page))
    assert calibration(None) == ""
