"""The exact checker: its forms vanish on rotations, true proofs pass, tampered ones do not."""

from __future__ import annotations

import ast
import dataclasses
import json
import random
import sys
import time
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import certnav.alignment.proofs.evidence as evidence_module
import certnav.alignment.proofs.proof as proof_module
import certnav.alignment.proofs.proof_file as file_module
from certnav.alignment.priors import up_prior, with_priors
from certnav.alignment.problem import ClockModel, build_problem
from certnav.alignment.proofs.exact import evidence_of, exact_proof
from certnav.alignment.proofs.proof import check, forms, positive_definite, rotation
from certnav.alignment.proofs.proof_file import read, write
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver.constraints import constraint_matrices
from certnav.alignment.solver.fast_solver import fast_minimum
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.status import GAP
from certnav.filters.errors import DataError


def proved(seed: int, satellites: int = 5, motion: str = "3d", sigma: float = 0.1):
    rows = simulate_window(np.random.default_rng(seed), satellites, motion, sigma=sigma).rows
    Q = build_problem(rows).Q
    minimum = fast_minimum(Q)
    return exact_proof(Q, minimum, "window", evidence_of(rows, ClockModel(), ())), minimum


def test_checker_uses_nothing_but_exact_arithmetic():
    imported = set()
    for module in (proof_module, file_module, evidence_module):
        tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add(node.module.split(".")[0])
    assert imported <= set(sys.stdlib_module_names) | {"filters", "evidence", "proof"}


def test_what_counts_as_closed_is_the_same_as_in_floating_point():
    assert float(proof_module.GAP) == GAP


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
    assert checked.proved and "rows every rotation costs" in checked.reason
    assert 0 < checked.gap < 1e-12 * minimum.scale
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


def test_a_constant_hides_no_gap():
    """tr Q grows without bound with a constant that changes no difference of costs."""
    found, _ = proved(7)
    found = dataclasses.replace(found, evidence=None)
    worse = dataclasses.replace(found, bound=found.bound - 1)
    assert check(found).proved and not check(worse).proved
    for constant in (Fraction(10**6), Fraction(10**30)):

        def raised(proof, constant=constant):
            Q = (*proof.Q[:-1], proof.Q[-1] + constant)
            cost, bound = proof.cost + constant, proof.bound + constant
            return dataclasses.replace(proof, Q=Q, cost=cost, bound=bound)

        assert check(raised(found)).proved and check(raised(found)).gap == check(found).gap
        assert "may not be the best" in check(raised(worse)).reason


def test_a_proof_is_of_its_own_rows():
    """Another Q has its proofs too: with a lower cost, a constant, the cost of other rows."""
    found, _ = proved(7)
    own = found.evidence
    assert check(found).proved
    (first, *others), *_ = (own.rows,)
    for k, by in ((0, 1e-6), (4, 1e-4), (6, 1e-3), (7, 1e-5)):
        row = tuple(v + by if i == k else v for i, v in enumerate(first))
        changed = dataclasses.replace(own, rows=(row, *others))
        checked = check(dataclasses.replace(found, evidence=changed))
        assert not checked.proved and "Q is not that of its rows" in checked.reason
    other, _ = proved(8)
    assert not check(dataclasses.replace(found, evidence=other.evidence)).proved
    fewer = dataclasses.replace(own, rows=own.rows[1:], epoch=own.epoch[1:])
    assert not check(dataclasses.replace(found, evidence=fewer)).proved


@pytest.mark.parametrize(
    "clock",
    [ClockModel(), ClockModel("linear"), ClockModel("per-epoch"), ClockModel("random-walk", 0.3)],
    ids=lambda clock: clock.kind,
)
@pytest.mark.parametrize("shared", [0, 2])
def test_q_from_rows_in_integers_is_that_of_floating_point(clock, shared, rng):
    rows = simulate_window(rng, 5, sigma=0.1, clock_walk=0.1, clock_drift=300.0).rows
    rows = rows.take(rng.permutation(len(rows)))
    rows = dataclasses.replace(rows, common=rng.normal(0.0, 0.2, (len(rows), shared)))
    prior = up_prior([0.0, 0.1, -1.0], np.eye(3), 0.03)
    problem = with_priors(build_problem(rows, clock, correlated=2.5), [prior])
    evidence = evidence_of(rows, clock, [prior], 2.5)
    assert evidence_module.parsed(evidence.as_dict()) == evidence
    Q = [[float(q) for q in row] for row in evidence_module.cost_matrix(evidence)]
    np.testing.assert_allclose(Q, problem.Q, rtol=0.0, atol=1e-13 * np.trace(problem.Q))


def test_a_weaker_bound_is_not_passed_off_as_an_optimum():
    found, minimum = proved(4)
    lower = dataclasses.replace(found, bound=found.bound - Fraction(1, 90))
    assert minimum.scale > 1e4  # a millionth of it was once called closed
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
        ("bound", 1.5, "no exact number"),
        ("bound", 1, "fraction of at most"),
        ("bound", "1/3", "powers of two"),
        ("bound", "1/0", "proof 1"),
        ("bound", "1e1000000000", "fraction of at most"),
        ("bound", "NaN", "fraction of at most"),
        ("cost", "9" * 1001, "fraction of at most"),
        ("Q", ["1"] * 54, "55 entries"),
        ("label", "\x1b[2Jproved", "printable"),
        ("label", "a\u202eb", "printable"),
        ("label", "x" * 201, "printable"),
        ("evidence", None, "proof 1"),
        ("quaternion", [True, 0, 0, 0], "integers"),
        ("quaternion", [1.0, 0, 0, 0], "no exact number"),
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


HOSTILE = {
    "no end of brackets": (b"[" * 1_000_000, "brackets without end"),
    "keys without end": (b'{"a":' * 1_000_000, "brackets without end"),
    "a billion digits": (b'{"format": 1' + b"0" * 10_000_000 + b"}", "10000001 digits"),
    "exponents": (b'{"format": 1e400}', "1e400 is no exact number"),
    "a huge exponent": (b'{"version": 1e1000000000}', "no exact number"),
    "no number": (b'{"version": NaN}', "NaN is no exact number"),
    "infinity": (b'{"version": -Infinity}', "-Infinity is no exact number"),
    "a key twice": (b'{"format": "certnav", "format": "certnav"}', "a key is there twice"),
    "too large": (b" " * 16_000_001, "at most 16 MB"),
    "no text": (b"\xff\xfe{}", "no JSON"),
    "nothing": (b"", "no JSON"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_in_one_line_and_at_once(tmp_path, name):
    path = tmp_path / "proof.json"
    content, said = HOSTILE[name]
    path.write_bytes(content)
    began = time.process_time()
    with pytest.raises(DataError, match=said) as refused:
        read(path)
    assert time.process_time() - began < 1.0
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 300


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("rows", []),
        ("rows", ["0x1p0"] * 50),
        ("rows", "0x1p0"),
        ("clock", "sundial"),
        ("clock_walk", "-0x1p0"),
        ("clock_walk", "0x1p5000"),
        ("clock_walk", "nan"),
        ("clock_walk", "0x" + "1" * 1_000_000),
        ("priors", [" ".join(["inf"] * 10)]),
        ("epoch", ["1"]),
    ],
)
def test_hostile_rows_are_refused(tmp_path, key, value):
    path = tmp_path / "proof.json"
    write(path, "drive", [proved(6)[0]])
    content = json.loads(path.read_text())
    content["proofs"][0]["evidence"][key] = value
    path.write_text(json.dumps(content))
    with pytest.raises(DataError, match="proof 1: "):
        read(path)
