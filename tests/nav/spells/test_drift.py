"""Drift is what its definition says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.spells.drift import judgeable, spell_figures, statistics
from certnav.nav.spells.outages import Spell


def test_drift_is_what_the_definition_says(drive):
    solution, sequence = drive(noise=0.0)
    evaluation = evaluate(solution, sequence)
    start, end = evaluation.time[0] + 50.0, evaluation.time[0] + 80.0
    t = np.clip(evaluation.time - start, 0.0, 30.0)
    # 5 m north throughout, a detour of 12 m east that is over at the end
    error = np.zeros_like(evaluation.error_pos_n)
    error[:, 0], error[:, 1] = 5.0, 12.0 * np.sin(np.pi * t / 30.0)
    found = spell_figures(dataclasses.replace(evaluation, error_pos_n=error), Spell(start, end))
    assert found.drift == pytest.approx(12.0, rel=1e-3)
    assert found.max_error == pytest.approx(13.0, rel=1e-3)
    assert found.final_error == pytest.approx(5.0, abs=0.2)
    np.testing.assert_allclose(found.growth, 12.0 * np.sin(np.pi * found.since / 30.0), atol=0.3)


def test_a_spell_without_reference_epochs_is_no_spell(drive):
    evaluation = evaluate(*drive(noise=0.0))
    end = evaluation.time[-1]
    assert spell_figures(evaluation, Spell(end + 10.0, end + 40.0)) is None


def test_statistics_of_maxima():
    found = statistics([3.0, 4.0, float("nan")])
    assert found["median"] == 3.5 and found["rms_of_maxima"] == pytest.approx(np.sqrt(12.5))
    assert statistics([]) == {"median": None, "rms_of_maxima": None, "p95": None}


def test_a_spell_counts_if_the_reference_has_seen_it_begin_and_end():
    """What is missing in between may be; 3 s of a minute at either end may be, too."""
    spell = Spell(100.0, 160.0)
    every = np.arange(0.0, 300.0, 0.2)

    def seen(*gaps):
        gone = np.zeros(every.size, dtype=bool)
        for a, b in gaps:
            gone |= (every > a) & (every < b)
        return judgeable([spell], every[~gone]) == [spell]

    assert seen() and seen((110.0, 150.0)) and seen((97.5, 120.0)) and seen((140.0, 157.5))
    assert not seen((96.0, 101.0)) and not seen((156.0, 170.0)) and not seen((90.0, 200.0))
    assert judgeable([spell], every[every > 130.0]) == []
