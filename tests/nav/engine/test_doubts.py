"""What the update log says: nothing of a sound run, a sentence of each way it contradicts."""

import numpy as np
import pytest

from certnav.nav.engine.doubts import doubts
from certnav.nav.solution import Update

GATE = 1e-4


def log(whitened, kind="position", refused=(), reason="innovation test (NIS > 21.1)"):
    out = []
    for k, w in enumerate(whitened):
        bad = k in refused
        out.append(
            Update(float(k), kind, (), tuple(w), float(w @ w), not bad, reason if bad else "")
        )
    return out


@pytest.fixture
def sound():
    return np.random.default_rng(4).standard_normal((300, 3))


def test_a_sound_log_is_not_commented(sound):
    assert doubts(log(sound), GATE) == ()
    assert doubts(log(sound, refused={17}), GATE) == ()
    assert doubts([], GATE) == ()
    assert doubts([Update(0.0, "velocity", reason="no fix")] * 100, GATE) == ()


def test_refusals_in_a_row_are_named_with_their_time(sound):
    sound[50:60] += 9.0
    (note,) = doubts(log(sound, refused=set(range(50, 60))), GATE)
    assert note.doubtful
    text = note.text
    assert text.startswith("position: 10 of 300 updates failed the innovation test")
    assert "10 in a row from 50.00 s to 59.00 s" in text and "0.03 would be chance" in text


def test_scattered_refusals_are_named_when_chance_cannot_be(sound):
    (note,) = doubts(log(sound, refused={3, 60, 130, 200, 280}), GATE)
    assert note.doubtful
    text = note.text
    assert "5 of 300" in text and "in a row" not in text
    # At a gate of 2 % five of 300 are what chance does.
    assert doubts(log(sound, refused={3, 60, 130, 200, 280}), 0.02) == ()


def test_an_enlarged_covariance_is_named(sound):
    updates = log(sound, refused=set(range(10, 20)))
    updates[20] = Update(
        20.0, "position", (), (5.0,) * 3, 75.0, True, "covariance enlarged after repeated refusal"
    )
    first, second = (note.text for note in doubts(updates, GATE))
    assert "11 of 300" in first and "enlarged 1 times, first at 20.00 s" in second


def test_a_sigma_too_small_is_named_with_its_factor_and_time(sound):
    assert doubts(log(1.1 * sound), GATE) == ()
    assert doubts(log(1.5 * sound[:50]), GATE) == ()  # too few to say
    sound[150:] *= 1.6
    (note,) = doubts(log(sound), GATE)
    assert note.doubtful
    text = note.text
    assert float(text.split("innovations are ")[1].split()[0]) == pytest.approx(1.6, abs=0.15)
    begin = float(text.split("from ")[1].split()[0])
    assert 140.0 <= begin <= 240.0


def test_kinds_are_judged_apart(sound):
    updates = log(sound) + log(2.0 * sound, kind="velocity")
    assert [note.text.split(":")[0] for note in doubts(updates, GATE)] == ["velocity"]
