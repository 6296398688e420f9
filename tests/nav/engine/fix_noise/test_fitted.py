"""What a run makes of its positions: which are fitted, what they become, and what it says."""

import dataclasses

import numpy as np
import pytest

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.nav.config_files import from_tables
from certnav.nav.engine.events import GnssEvent
from certnav.nav.engine.fix_noise.estimate import ALLOWANCE, STEADY
from certnav.nav.engine.fix_noise.fitted import _reflections, _with_noise
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate
from certnav.nav.solution import FixErrors
from oracles import rigs

SIGMA = np.array([1.0, 1.0, 2.0])


def found(meaning=STEADY, share=0.8, scale=2.0, usual=(1.0, 2.0, 4.0)):
    return FixErrors(scale, share, 20.0 if share else 0.0, meaning, usual, 50.0, 0.1)


def position(variances, **more):
    cov = rigs.C_EN @ np.diag(variances) @ rigs.C_EN.T
    return GnssEvent(1.0, "position", rigs.PLACE, cov, **more)


def in_ned(cov_e):
    return rigs.C_EN.T @ cov_e @ rigs.C_EN


def test_what_is_shared_has_its_usual_size_and_what_is_own_the_declared_one():
    made = _with_noise(position((9.0, 9.0, 16.0)), found())
    usual, own = np.diag([1.0, 2.0, 4.0]), np.diag([9.0, 9.0, 16.0])
    np.testing.assert_allclose(in_ned(made.common_cov_e), 4.0 * 0.8 * usual, atol=1e-9)
    np.testing.assert_allclose(in_ned(made.cov_e), 4.0 * (0.8 * usual + 0.2 * own), atol=1e-9)
    nearly = _with_noise(position((9.0, 9.0, 16.0)), found(share=0.9999))
    left = in_ned(nearly.cov_e - nearly.common_cov_e)
    np.testing.assert_allclose(left, 4.0 * 0.1 * own, atol=1e-9)  # millimetres teach nothing
    alone = _with_noise(position((9.0, 9.0, 16.0), shared=True), found(share=0.0))
    assert not alone.common_cov_e.any()
    assert _with_noise(position((9.0, 9.0, 16.0)), found(share=0.0)).common_cov_e is None
    np.testing.assert_allclose(in_ned(alone.cov_e), 4.0 * own, atol=1e-9)


def test_an_allowance_for_reflections_is_not_scaled():
    """7 m² are usual in all; of 28 a quarter is, and the rest stays, nine tenths of it shared."""
    V = np.array([4.0, 8.0, 16.0])
    made = _with_noise(position(V), found(ALLOWANCE, scale=0.5))
    np.testing.assert_allclose(np.diag(in_ned(made.cov_e)), (0.25 * 0.25 + 0.75) * V)
    np.testing.assert_allclose(
        np.diag(in_ned(made.common_cov_e)), (0.25 * 0.25 * 0.8 + 0.75 * 0.9) * V
    )
    less = _with_noise(position(V / 8.0), found(ALLOWANCE, scale=0.5))
    np.testing.assert_allclose(np.diag(in_ned(less.cov_e)), 0.25 * V / 8.0)


def test_reflections_are_expected_where_signals_are_blocked_or_contradict_each_other():
    there = position((1.0, 1.0, 1.0))
    gone = dataclasses.replace(there, reason="no fix: too few satellites")
    assert not _reflections((there,) * 20, 0.01)
    assert _reflections((there,) * 20, 0.2)
    assert _reflections((there,) * 20, float("nan"))
    assert _reflections((there,) * 17 + (gone,) * 3, 0.01)


def drive(seed, *, lasting=0.0, quality="single", duration=150.0, velocities=True):
    """A drive with positions of 1, 1, 2 m of which the share `lasting` lasts 20 s."""
    config = SimulationConfig(
        seed=seed, duration=duration, density="open", moving_start=True, static_start=0.0
    )
    made = simulate(config)
    rng = np.random.default_rng([5, seed])
    time = np.arange(config.start_time + 1.0, config.start_time + duration)
    fixes = fixes_from_truth(
        made.trajectory, time, config.lever_antenna_b, (1e-6, 1e-6, 1e-6), 0.05, rng
    )
    n, fade = time.size, np.exp(-1.0 / 20.0)
    b = rng.standard_normal((n, 3))
    for k in range(1, n):
        b[k] = fade * b[k - 1] + np.sqrt(1.0 - fade**2) * b[k]
    e = np.sqrt(lasting) * b + np.sqrt(1.0 - lasting) * rng.standard_normal((n, 3))
    C = C_en_of(fixes.pos_e)
    cov_e = C @ np.diag(SIGMA**2) @ np.swapaxes(C, 1, 2)
    fixes = dataclasses.replace(
        fixes, pos_e=fixes.pos_e + np.einsum("nij,nj->ni", C, SIGMA * e), pos_cov_e=cov_e,
        quality=np.full(n, quality),
    )  # fmt: skip
    return dataclasses.replace(made.sequence(fixes), observations=None)


def run(sequence, **gnss):
    tables = {"alignment": {"method": "level+course"}, "gnss": gnss}
    return navigate(sequence, from_tables(tables))


def nees(solution, sequence):
    evaluation = evaluate(solution, sequence)
    settled = evaluation.time > solution.trajectory.time[0] + 20.0
    return float(np.mean(evaluation.nees_position[settled]))


def said(solution):
    return [note.text for note in solution.notes if note.text.startswith("noise of positions")]


def test_errors_that_last_are_found_and_the_solution_is_no_longer_too_sure():
    sequence = drive(3, lasting=0.9)
    fitted, declared = run(sequence), run(sequence, position_noise="declared")
    errors = fitted.fix_errors
    assert errors is not None and errors.share > 0.8 and 8.0 < errors.correlation_s < 150.0
    assert 0.5 < errors.scale < 2.5
    (note,) = said(fitted)
    assert f"{100.0 * errors.share:.3g} % of the variance shared" in note
    assert declared.fix_errors is None and not said(declared)
    assert nees(declared, sequence) > 10.0 > 6.0 > nees(fitted, sequence)


def test_positions_as_declared_stay_as_good_as_they_are():
    sequence = drive(2)
    fitted = run(sequence)
    assert fitted.fix_errors.share == 0.0
    assert fitted.fix_errors.scale == pytest.approx(1.0, abs=0.12)


def test_what_cannot_be_fitted_is_taken_as_declared_and_the_reason_said():
    fixed = run(drive(2, lasting=0.9, quality="fixed", duration=60.0))
    (note,) = said(fixed)
    assert fixed.fix_errors is None and "as declared" in note and "ambiguities resolved" in note
    short = run(drive(2, duration=14.0))
    (note,) = said(short)
    assert short.fix_errors is None and "positions are too few" in note
