"""A handful of killed runs; ``scripts/kill_loop.py --count 200`` does it properly."""

import os

import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills forked processes")


def test_killed_runs_leave_the_old_or_the_new(script, tmp_path):
    tally = script("kill_loop").kill_loop(6, 1, tmp_path)
    assert tally.faults == []
    assert tally.found["old"] + tally.found["new"] + tally.found["none yet"] == 6
    assert tally.looks > 0
