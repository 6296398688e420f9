"""The certificate under attack; `scripts/alignment_attacks.py` has 20,000 of these."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.alignment.problem import build_problem
from certnav.alignment.reference.certifiable import certified_minimum
from certnav.alignment.rows import AlignmentRows
from certnav.alignment.solver.fast_solver import fast_minimum
from certnav.alignment.status import REGION, AlignmentStatus
from certnav.filters.errors import AlignmentError
from tests.oracles.attacks import KINDS, PRECISE, Costs, angle, attacks

pytestmark = pytest.mark.skipif(not PRECISE, reason="longdouble is a double here")


def problems(first: int, last: int):
    for attack in attacks(2, first, last):
        time = attack.epoch.astype(float)
        rows = AlignmentRows(attack.e, attack.v, attack.z, attack.sigma, attack.epoch, time)
        try:
            yield attack, build_problem(rows)
        except AlignmentError:
            continue


def test_no_rotation_elsewhere_costs_less_than_a_certified_one():
    rng = np.random.default_rng(1)
    certified = dict.fromkeys(KINDS, 0)
    for attack, problem in problems(0, 60):
        found = fast_minimum(problem.Q, factor=problem.factor)
        if found.status is not AlignmentStatus.CERTIFIED:
            continue
        certified[attack.kind] += 1
        assert found.region <= REGION
        costs = Costs(attack)
        here = costs(found.C)
        for R in (attack.C, *costs.wells(rng, [found.C, attack.C])):
            assert angle(R, found.C) < 0.06 or costs(R) > here
    assert min(certified.values()) > 5


def test_the_relaxation_says_the_same():
    said = set()
    for _, problem in problems(60, 130):
        fast = fast_minimum(problem.Q, factor=problem.factor)
        assert certified_minimum(problem.Q, factor=problem.factor).status is fast.status
        said.add(fast.status)
    assert len(said) > 2


def test_costs_of_the_oracle_are_those_of_the_rows():
    for attack, problem in problems(200, 205):
        costs = Costs(attack)
        for C in (attack.C, np.eye(3)):
            assert float(costs(C)) == pytest.approx(problem.cost(C), rel=1e-6, abs=1e-6)
