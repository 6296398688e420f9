"""What people look at in a console says in one line what they want to know."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.nav.check import Finding, Report
from certnav.nav.compare import Comparison, Run
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.results import read_result, write_result
from certnav.nav.spells import Spell, spell_figures
from certnav.nav.tune import Score, Tuning
from certnav.nav.windows import WindowResult
from certnav.velocity.screening import Screening


@pytest.fixture
def shown(drive, tmp_path):
    """Of each kind one, as it is shown."""
    solution, sequence = drive(duration=60.0)
    evaluation = evaluate(solution, sequence)
    start = float(evaluation.time[0])
    spell = spell_figures(evaluation, Spell(start + 10.0, start + 30.0))
    run = Run("lc4", "suburb", "@0", evaluation.metrics, spells=(spell,))
    score = Score(np.ones((21, 20)), np.ones((21, 20)), np.ones((21, 20)), 450)
    tuning = Tuning(
        np.arange(30.0, 51.0), np.arange(20.0), score, {"a": score, "b": score},
        Screening(40.0, min_k=0.2), "the knee decided", None, np.ones((21, 20), bool), (),
        "time blocks", 0.31, 0.45, 0.4,
        {}, {},
    )  # fmt: skip
    window = WindowResult(
        12.0, 15, 90, 6.0, "PASSED", np.radians(-90.0), np.radians(0.3), np.nan, 1.1
    )
    return {
        "result": read_result(write_result(tmp_path / "run", solution, evaluation, sequence, "")),
        "run": run,
        "missing run": dataclasses.replace(run, reason="no odometer"),
        "comparison": Comparison((run, run), {"suburb": np.zeros((9, 2))}, "20/60:2"),
        "spell": spell,
        "score": score,
        "tuning": tuning,
        "window": window,
        "failed window": dataclasses.replace(window, status="FAILED", message="no Doppler"),
        "report": Report("drive", ("IMU: …",) * 9, (Finding("doubtful", "gyro", "odd"),) * 9),
    }  # fmt: skip


def test_everything_is_one_line(shown):
    for name, value in shown.items():
        assert len(repr(value)) < 200 and "\n" not in repr(value), name
        assert repr(value).startswith(f"<{type(value).__name__} "), name


def test_the_line_says_what_one_wants_to_know(shown):
    line = {name: repr(value) for name, value in shown.items()}
    rms = shown["result"].evaluation.metrics["horizontal_rms_m"]
    assert f"horizontal RMS {rms:.3g} m" in line["result"]
    drift = shown["spell"].drift
    assert f"drift {drift:.3g} m" in line["spell"] and f"drift RMS {drift:.3g} m" in line["run"]
    assert "not available: no odometer" in line["missing run"]
    assert line["comparison"] == "<Comparison of 2 runs, weak GNSS 20/60:2: lc4>"
    assert "k > 0.2" in line["tuning"] and "2 sequences" in line["tuning"]
    assert "heading 270°, 1σ 0.3°>" in line["window"]
    assert line["failed window"].endswith("FAILED: no Doppler>")
    assert "9 doubtful findings" in line["report"]
