"""What counts as better: intervals that cover, a default that stays, nothing judged by itself."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.nav.tune.choice import (
    Change,
    Group,
    best,
    change,
    cross_validated,
    of_candidate,
)
from certnav.nav.tune.settings import decide, interval, knee


def group(square, recording="drive", part="as recorded", folds=5):
    square = np.asarray(square, dtype=float)
    count = square.shape[1]
    fold = np.arange(count) * folds // count
    return Group(recording, part, square, np.ones(count), fold)


def drawn(rng, ratio, blocks=12, spread=0.3, recording="drive"):
    """Squared errors of the default and of candidates `ratio` times as large, block by block."""
    common = rng.lognormal(0.0, 0.8, blocks)
    own = rng.lognormal(0.0, spread, (len(ratio), blocks))
    return group(common * own * np.square(ratio)[:, None], recording)


def test_a_change_is_the_ratio_of_the_rms_and_identical_errors_are_no_change():
    square = np.array([[1.0, 4.0, 2.0], [0.81, 3.24, 1.62], [1.0, 4.0, 2.0]])
    found = of_candidate([group(square)], 1)
    assert found.value == pytest.approx(-0.1)
    assert found.low == pytest.approx(-0.1)  # the same in every block: no doubt about it
    assert of_candidate([group(square)], 2) == Change(0.0, 0.0, 0.0)
    # Every part counts the same, however large its errors are.
    far = group(1e6 * square[[0, 2, 1]], part="weak GNSS")
    both = change([group(square), far], [square[1], 1e6 * square[0]])
    assert both.value == pytest.approx(np.sqrt(0.9) - 1.0)


@pytest.mark.parametrize("recordings, blocks", [(1, 6), (1, 12), (2, 12), (4, 8)])
def test_intervals_cover_no_difference_as_often_as_they_say(recordings, blocks):
    rng = np.random.default_rng(1)
    outside = 0
    for _ in range(400):
        groups = [drawn(rng, [1.0, 1.0], blocks, recording=f"r{k}") for k in range(recordings)]
        found = of_candidate(groups, 1)
        outside += found.better or found.worse
    assert outside / 400 < 0.09  # 5 % and what 400 draws allow


def test_a_real_gain_is_found_and_taken():
    rng = np.random.default_rng(2)
    groups = [drawn(rng, [1.0, 0.6, 1.2])]
    changes = [of_candidate(groups, k) for k in range(3)]
    validated, folds = cross_validated(groups)
    assert best(groups) == 1
    assert {chosen for _, chosen in folds} == {1}
    chosen, said = decide(groups, ["default", "less", "more"], changes, 1, validated)
    assert chosen == 1
    assert "both exclude zero" in said


def test_the_best_of_many_equals_is_not_taken():
    """Of twenty that differ by chance alone the best looks good in every fifth draw.

    Chosen without the data it is judged by, it is taken in some 6 of 100.
    """
    rng = np.random.default_rng(3)
    taken = fooled = 0
    for _ in range(40):
        groups = [drawn(rng, np.ones(20))]
        changes = [of_candidate(groups, k) for k in range(20)]
        validated, _ = cross_validated(groups)
        names = [str(k) for k in range(20)]
        chosen, said = decide(groups, names, changes, best(groups), validated)
        taken += chosen > 0
        fooled += changes[best(groups)].better
        assert chosen or "keep" in said or "nothing tried" in said
    assert fooled > 4
    assert taken <= 5


def test_a_fold_is_judged_by_what_was_chosen_without_it():
    # In the last fold candidate 1 is a disaster that the others do not foresee.
    square = np.array([np.ones(10), np.r_[np.full(8, 0.5), 50.0, 50.0]])
    validated, folds = cross_validated([group(square)])
    assert [chosen for _, chosen in folds] == [0, 0, 0, 0, 1]
    assert validated.value == pytest.approx(np.sqrt((8 + 100) / 10) - 1.0)


def test_three_recordings_are_left_out_one_by_one_and_have_to_agree():
    rng = np.random.default_rng(4)
    groups = [drawn(rng, [1.0, r], recording=name) for name, r in zip("abc", (0.5, 0.5, 1.4),
                                                                   strict=True)]  # fmt: skip
    _, folds = cross_validated(groups)
    assert [name for name, _ in folds] == ["a", "b", "c"]
    assert not of_candidate(groups, 1).better  # on average less, not on each
    pair = of_candidate(groups[:2], 1)
    assert pair.better


def test_worse_on_one_part_beyond_doubt_is_not_recommended():
    better, worse = np.full(12, 0.2), np.full(12, 1.5)
    jitter = np.random.default_rng(5).uniform(0.95, 1.05, (2, 12))
    groups = [
        group([np.ones(12), better * jitter[0]]),
        group([np.ones(12), worse * jitter[1]], part="weak GNSS"),
    ]
    changes = [of_candidate(groups, k) for k in range(2)]
    validated, _ = cross_validated(groups)
    assert changes[1].better
    chosen, said = decide(groups, ["default", "other"], changes, 1, validated)
    assert chosen == 0
    assert "weak GNSS" in said


def test_what_no_table_shows_decides_nothing():
    """A ten-thousandth worse on one recording, whatever its interval, does not cost the gain."""
    jitter = np.random.default_rng(5).uniform(0.95, 1.05, 12)
    for factor, taken in ((1.0001, 1), (1.01, 0)):
        groups = [group([np.ones(12), np.full(12, 0.2) * jitter])]
        groups.append(group([np.ones(12), np.full(12, factor)], part="weak GNSS"))
        changes = [of_candidate(groups, k) for k in range(2)]
        validated, _ = cross_validated(groups)
        assert change([groups[1]], [groups[1].square[1]]).worse
        assert decide(groups, ["default", "other"], changes, 1, validated)[0] == taken


def test_what_could_not_be_judged_is_never_the_best():
    square = np.array([[1.0, 1.0, 1.0], [0.1, np.inf, 0.1]])
    groups = [group(square)]
    assert best(groups) == 0
    assert interval(of_candidate(groups, 1)) == "not known"
    assert (
        interval(of_candidate([group(square[:, :1])], 0)) == "not known"
    )  # one block says nothing


def test_knee_of_candidates():
    assert knee([0.2, 0.5, 0.9, 1.0, 0.4], [1.0, 1.1, 1.2, 9.0, 5.0]) == 2
    assert knee([0.2, 0.5], [1.0, 2.0]) is None
    assert knee([np.nan] * 4, [1.0, 2.0, 3.0, 4.0]) is None


def test_a_change_is_told_in_per_cent_and_beyond_tenfold_as_such():
    assert interval(Change(-0.305, -1.0, 3884.898)) == "−30.5 % [−100.0, > +1000]"
    assert interval(Change(0.1, 0.05, 9.99)) == "+10.0 % [+5.0, +999.0]"
