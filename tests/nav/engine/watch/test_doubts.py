"""What the update log says: nothing of a sound run, a sentence of each way it contradicts."""

import numpy as np
import pytest

from certnav.nav.engine.watch.doubts import doubts, outages
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


# Where the sentences begin.


def steady(nis, count, refused=(), dof=3, kind="position"):
    """A log of constant innovations, one a second; `nis` per update, by index or for all."""
    nis = np.broadcast_to(np.asarray(nis, dtype=float), count)
    whitened = np.sqrt(nis / dof)[:, None] * np.ones(dof)
    return log(whitened, kind, set(refused))


def told(updates, gate=GATE):
    return [note.text for note in doubts(updates, gate)]


@pytest.mark.parametrize(("count", "refused", "said"), [
    (300, [10, 50, 90], None),
    (300, [10, 50, 90, 130], "position: 4 of 300 updates failed the innovation test;"),
    (400, [10, 50, 90, 130], "position: 4 of 400"),
    (401, [10, 50, 90, 130], None),  # less than one in a hundred
    (500, [10, 11, 12], None),
    (500, [10, 11, 12, 13], "position: 4 of 500 updates failed the innovation test, 4 in a row"),
    (300, [10, 11, 50, 90, 130], "position: 5 of 300 updates failed the innovation test, 2 in a "
     "row from 10.00 s to 11.00 s; 0.03 would be chance: wrong data"),
    (300, [296, 297, 298, 299], "position: 4 of 300 updates failed the innovation test, 4 in a "
     "row from 296.00 s to 299.00 s"),
    (300, [0, 1, 2, 3], "position: 4 of 300 updates failed the innovation test, 4 in a row from "
     "0.00 s to 3.00 s"),
])  # fmt: skip
def test_four_refusals_and_one_in_a_hundred_or_four_in_a_row(count, refused, said):
    found = told(steady(1.0, count, refused))
    assert len(found) == (said is not None)
    assert said is None or found[0].startswith(said)


def test_five_times_what_chance_makes_is_often():
    """At a gate of 1 % chance makes three of three hundred."""
    scattered = list(range(5, 300, 20))
    assert len(scattered) == 15
    (text,) = told(steady(1.0, 300, scattered), 0.01)
    assert "15 of 300" in text and "; 3 would be chance" in text
    assert told(steady(1.0, 300, scattered[:14]), 0.01) == []


@pytest.mark.parametrize(("kind", "cause"), [
    ("nhc", "the vehicle moved as"), ("zupt", "the vehicle moved as"),
    ("zaru", "the vehicle moved as"), ("odometer", "wrong data"), ("doppler", "wrong data"),
])  # fmt: skip
def test_what_no_sensor_has_measured_is_the_vehicles_doing(kind, cause):
    (text,) = told(steady(1.0, 100, range(10, 20), kind=kind))
    assert f"would be chance: {cause}" in text


def test_of_several_runs_the_longest_is_named():
    (text,) = told(steady(1.0, 300, [5, 6, 7, *range(100, 105), 200, 201]))
    assert "10 of 300" in text and "5 in a row from 100.00 s to 104.00 s" in text


def test_weighted_down_is_a_failed_test_too():
    updates = steady(1.0, 100)
    for k in range(20, 24):
        updates[k] = Update(float(k), "position", (), (3.0,) * 3, 27.0, True, "weighted down")
    (text,) = told(updates)
    assert "4 of 100" in text


@pytest.mark.parametrize(("dof", "factor"), [(3, 3.0), (1, 1.0), (8, 8.0)])
def test_sixty_updates_of_half_as_much_again_are_a_sigma_too_small(dof, factor):
    """1.51 per degree of freedom over sixty; √1.51 = 1.23."""
    assert told(steady(1.49 * factor, 60, dof=dof)) == []
    assert told(steady(1.51 * factor, 59, dof=dof)) == []
    (text,) = told(steady(1.51 * factor, 60, dof=dof))
    assert text.startswith("position: from 0.00 s to 59.00 s innovations are 1.2 times as large")


def test_the_worst_sixty_are_named():
    nis = np.full(300, 3.0)
    nis[100:160] = 12.0
    (text,) = told(steady(nis, 300))
    assert "from 100.00 s to 159.00 s innovations are 2.0 times" in text


def test_a_few_gross_errors_are_no_sigma_too_small():
    """Each counts as the test's limit, 21.1 of 3: four of sixty add 0.4."""
    nis = np.full(300, 3.0)
    nis[100:103] = 1e6
    assert told(steady(nis, 300)) == []
    # Where refusals were named, their cause is not guessed at twice.
    nis[100:160] = 12.0
    assert len(told(steady(nis, 300, range(120, 130)))) == 1


def test_without_a_gate_nothing_is_too_far_out():
    (text,) = told(steady(12.0, 100), gate=0.0)
    assert "2.0 times as large" in text


def test_long_spells_without_a_position_are_told(sound):
    """Twenty seconds refused, thirty at the end; ten are what a run bridges anyway."""
    updates = log(sound, refused={*range(10, 19), *range(100, 119)})
    assert outages(updates[:99], 99.0) == () == outages([], 300.0)
    (note,) = outages(updates, 299.0)
    assert not note.doubtful and "in 1 spells, the longest 20.0 s from 99.00 s" in note.text
    (note,) = outages(updates, 329.0)
    assert "in 2 spells, the longest 30.0 s from 299.00 s" in note.text
    assert outages(log(sound, kind="velocity"), 900.0) == ()
