"""The exact checker: its forms vanish on rotations, true proofs pass, tampered ones do not."""

from __future__ import annotations

import ast
import dataclasses
import json
import random
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import certnav.alignment.proofs.proof as proof_module
from certnav.alignment.problem import build_problem
from certnav.alignment.proofs.exact import exact_proof
from certnav.alignment.proofs.proof import check, forms, positive_definite, read, rotation, write
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver.constraints import constraint_matrices
from certnav.alignment.solver.fast_solver import fast_minimum
from certnav.alignment.solver.refinement import rotation_angle
from certnav.filters.errors import DataError


def proved(seed: int, satellites: int = 5, motion: str = "3d", sigma: float = 0.1):
    Q = build_problem(
        simulate_window(np.random.default_rng(seed), satellites, motion, sigma=sigma).rows
    ).Q
    minimum = fast_minimum(Q)
    return exact_proof(Q, minimum, "window"), minimum


def test_checker_uses_nothing_but_exact_arithmetic():
    tree = ast.parse(Path(proof_module.__file__).read_text(encoding="utf-8"))
    imported = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imported |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            imported.add(node.module.split(".")[0])
    assert imported <= set(sys.stdlib_module_names) | {"filters"}


def test_forms_vanish_on_exact_rotations():
    draw = random.Random(1)
    for _ in range(20):
        C = rotation(tuple(draw.randint(-99, 99) for _ in range(4)))
        x = [C[i][j] for j in range(3) for i in range(3)] + [Fraction(1)]
        for form in forms():
            assert sum(v * x[i] * x[j] for (i, j), v in form.items()) == 0


def test_forms_are_those_of_the_relaxation():
    expected = constraint_matrices()
    assert len(forms()) == len(expected) == 20
    for form, A in zip(forms(), expected, strict=True):
        dense = np.zeros((10, 10))
        for place, value in form.items():
            dense[place] = float(value)
        np.testing.assert_array_equal(dense, A)


def test_positive_definite_decides_where_floats_cannot():
    tiny = Fraction(1, 10**40)
    one = [[Fraction(1), Fraction(1)], [Fraction(1), 1 + tiny]]
    assert positive_definite(one)
    one[1][1] = Fraction(1)
    assert not positive_definite(one)
    one[1][1] = 1 - tiny
    assert not positive_definite(one)


@pytest.mark.parametrize("motion", ["2d", "3d"])
@pytest.mark.parametrize("satellites", [3, 5, 8])
@pytest.mark.parametrize("sigma", [0.0, 0.3])
def test_minima_are_proved_with_a_small_gap(motion, satellites, sigma):
    found, minimum = proved(satellites, satellites, motion, sigma)
    checked = check(found)
    assert checked.proved and "for this Q every rotation costs" in checked.reason
    assert 0 < checked.relative_gap < 1e-10
    assert float(checked.cost) == pytest.approx(minimum.cost, abs=1e-11 * minimum.scale)
    C = np.array([[float(c) for c in row] for row in rotation(found.quaternion)])
    assert rotation_angle(C, minimum.C) < 1e-10


def test_no_rotation_sampled_costs_less_than_the_bound():
    found, _ = proved(11, sigma=0.5)
    draw = random.Random(2)
    for _ in range(200):
        q = tuple(draw.randint(-999, 999) for _ in range(4))
        assert proof_module.cost_of(found.Q, q) >= found.bound


def test_tampering_is_refused():
    found, _ = proved(3)
    bit = Fraction(1, 10**9)

    def changed(values, k, by):
        return tuple(v + by if i == k else v for i, v in enumerate(values))

    assert check(found).proved
    for k in range(0, 55, 6):
        assert not check(dataclasses.replace(found, Q=changed(found.Q, k, bit))).proved
    for k in range(20):
        wrong = changed(found.multipliers, k, abs(found.multipliers[k]) / 1000 + 1)
        assert not check(dataclasses.replace(found, multipliers=wrong)).proved
    above = dataclasses.replace(found, bound=found.cost + bit)
    assert "not positive definite" in check(above).reason
    turned = dataclasses.replace(
        found, quaternion=(found.quaternion[0] + 2**20, *found.quaternion[1:])
    )
    assert "costs" in check(turned).reason and not check(turned).proved
    assert not check(dataclasses.replace(found, quaternion=(0, 0, 0, 0))).proved


def test_gap_is_relative_to_the_trace_of_the_diagonal():
    found, _ = proved(7)
    Q = np.zeros((10, 10))
    Q[np.triu_indices(10)] = [float(q) for q in found.Q]
    gap = float(found.cost - found.bound) / np.trace(Q)
    assert float(check(found).relative_gap) == pytest.approx(gap, rel=1e-12)


def test_units_of_the_cost_do_not_matter():
    """tr Q far below one: the same proof."""
    found, minimum = proved(8)
    factor = Fraction(1, 10**9)
    small = dataclasses.replace(
        found, Q=tuple(factor * q for q in found.Q), bound=factor * found.bound,
        multipliers=tuple(factor * m for m in found.multipliers), cost=factor * found.cost,
    )  # fmt: skip
    assert minimum.scale * float(factor) < 1.0
    assert check(small).proved and check(small).relative_gap == check(found).relative_gap


@pytest.mark.parametrize("trace", [0, -1])
def test_a_matrix_without_a_positive_trace_proves_nothing(trace):
    """tr Q is what the gap is small against: without one everything would be small."""
    entries = tuple(Fraction(trace if i == j == 0 else 0) for i, j in proof_module.UPPER)
    quaternion = (1, 0, 0, 0)
    cost = proof_module.cost_of(entries, quaternion)
    proof = proof_module.Proof("", entries, (Fraction(1),) * 20, cost - 1, quaternion, cost)
    checked = check(proof)
    assert not checked.proved and "tr Q is not positive" in checked.reason


def test_a_weaker_bound_is_not_passed_off_as_an_optimum():
    found, minimum = proved(4)
    lower = dataclasses.replace(found, bound=found.bound - Fraction(minimum.scale) / 1000)
    checked = check(lower)
    assert not checked.proved and "may not be the best" in checked.reason


def test_another_local_rotation_is_not_proved():
    """A wrong rotation with its own, true cost: the gap gives it away."""
    found, _ = proved(5)
    q = (1, 2, 3, 4)
    other = dataclasses.replace(found, quaternion=q, cost=proof_module.cost_of(found.Q, q))
    assert not check(other).proved


def test_a_gap_is_no_proof():
    """Choi–Lam: nonnegative, but no sum of squares."""
    from certnav.alignment.solver.quartic import Z

    G = np.diag([1.0, 0, 0, 0, 0, 0, 0, 0.5, 0.5, 0.5])
    for a, b in ((1, 9), (2, 8), (3, 7)):
        G[a, b] = G[b, a] = -1.0 / 3.0
    Q = Z @ G @ Z.T / 16.0
    assert exact_proof(Q, fast_minimum(Q)) is None


def test_files_round_trip_and_bad_ones_are_refused(tmp_path):
    found, _ = proved(6)
    path = tmp_path / "proof.json"
    write(path, "drive", [found, found])
    assert read(path) == [found, found]
    content = json.loads(path.read_text())
    for key, value, message in (
        ("bound", 1.5, "fraction as text"),
        ("bound", "1/0", "proof 1"),
        ("Q", ["1"] * 54, "55 entries"),
        ("quaternion", [1.0, 0, 0, 0], "4 integers"),
    ):
        wrong = json.loads(json.dumps(content))
        wrong["proofs"][0][key] = value
        path.write_text(json.dumps(wrong))
        with pytest.raises(DataError, match=message):
            read(path)
    del content["proofs"][1]["cost"]
    path.write_text(json.dumps(content))
    with pytest.raises(DataError, match="proof 2: no 'cost'"):
        read(path)
    path.write_text("[]")
    with pytest.raises(DataError, match="expected 'certnav alignment proof'"):
        read(path)
    path.write_text("{")
    with pytest.raises(DataError, match="no JSON"):
        read(path)
