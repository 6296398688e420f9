"""A filter with a wrong heading that it is sure of does not go on."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.nav.config_files import from_tables
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A drive under the open sky that is in motion when it begins."""
    folder = tmp_path_factory.mktemp("heading") / "open"
    made = SimulationConfig(name="open", seed=31, duration=150.0, density="open", moving_start=True)
    simulate_folder(made, folder)
    return load(folder)


def started(drive, heading_deg):
    """Run it from a heading that is given, sure to half a degree."""
    given = {"roll_deg": 0.0, "pitch_deg": 0.0, "heading_deg": heading_deg}
    config = from_tables({"alignment": {**given, "sigma_heading_deg": 0.5}})
    return navigate(drive, config)


@pytest.mark.parametrize("off_deg", [70.0, -120.0, 180.0])
def test_a_heading_far_off_is_noticed_and_mended(drive, off_deg):
    reference = drive.reference
    assert reference is not None
    true_deg = float(np.degrees(reference.rpy[0, 2]))
    solution = started(drive, true_deg + off_deg)
    assert solution.status == "restarted"
    (note,) = [n for n in solution.notes if n.severity == "lost"]
    assert "started again" in note.text
    late = drive.between(drive.span[1] - 20.0, drive.span[1])
    assert evaluate(solution, late).metrics["heading_rms_deg"] < 2.0


def test_a_heading_that_is_right_is_left_alone(drive):
    reference = drive.reference
    assert reference is not None
    solution = started(drive, float(np.degrees(reference.rpy[0, 2])))
    assert solution.status in ("ok", "doubtful")
    assert not [n for n in solution.notes if n.severity == "lost"]
