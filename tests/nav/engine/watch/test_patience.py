"""Patience is a matter of seconds: how many refusals fill them makes no difference."""

import numpy as np
import pytest

from certnav.nav.engine.watch.patience import Patience


def refusing(limit, times):
    patience = Patience(limit)
    for time in times:
        patience.refused(time)
    return patience


def test_the_first_refusal_is_never_one_too_many():
    patience = Patience(3.0)
    assert patience.lasted == 0.0
    assert not patience.over(1e6)
    assert not patience.over(1e6, 0.0)  # nothing is insisted on before anything was refused
    patience.refused(5.0)
    assert patience.lasted == 0.0  # it takes two to last


@pytest.mark.parametrize("interval", [0.1, 0.5, 1.0, 1.5])
def test_it_ends_after_three_seconds_however_often_it_is_tried(interval):
    patience = Patience(3.0)
    for time in np.arange(0.0, 3.0 - 1e-9, interval):
        assert not patience.over(time)
        patience.refused(time)
    assert not patience.over(3.0 - 2e-3)
    assert patience.over(3.0)
    assert patience.over(3.0 - 5e-4)  # times are by a receiver's clock: no refusal is a millisecond


def test_silence_refuses_nothing():
    """Of a pause two seconds count, whatever its length."""
    patience = refusing(3.0, [0.0])
    assert not patience.over(100.0)
    patience.refused(100.0)
    assert patience.lasted == 2.0
    assert patience.over(101.0) and not patience.over(100.9)


def test_one_that_is_accepted_begins_it_anew():
    patience = refusing(3.0, [0.0, 1.0, 2.0])
    assert patience.lasted == 2.0
    patience.accepted()
    assert patience.lasted == 0.0 and not patience.over(3.0)
    patience.refused(3.0)
    assert patience.lasted == 0.0  # what was before is forgotten with its time
    assert not patience.over(4.0)


def test_a_failed_attempt_is_repeated_after_two_seconds():
    patience = refusing(8.0, [0.0, 1.0])
    patience.failed(10.0)
    for limit in (None, 2.0):  # whatever the evidence
        assert not patience.over(11.9, limit) and patience.over(12.0, limit)
    patience.refused(11.0)
    assert not patience.over(11.9) and patience.over(12.0)
    patience.accepted()
    patience.refused(11.5)
    assert not patience.over(13.0)


def test_better_evidence_has_a_limit_of_its_own():
    patience = refusing(8.0, [0.0, 1.0])
    assert patience.over(2.0, 2.0) and not patience.over(1.9, 2.0)
    assert not patience.over(2.0)


def test_zero_is_never_not_at_once():
    patience = refusing(0.0, [0.0, 1.0, 2.0])
    assert not patience.over(100.0) and not patience.over(100.0, 1.0)
    assert refusing(0.5, [0.0]).over(0.5)  # but anything above zero is a limit
