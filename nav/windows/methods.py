"""What each method says about the rows of one window."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...alignment.priors import Prior, up_prior
from ...alignment.problem import ClockModel, build_problem
from ...alignment.reference.baselines import gauss_newton, voba
from ...alignment.reference.certifiable import align_sdp
from ...alignment.result import AlignmentResult
from ...alignment.robust import align_robust
from ...alignment.rows import AlignmentRows
from ...alignment.verdict import align
from ...filters.rotation import FloatArray
from .noise import WindowNoise
from .options import WindowOptions


def clock_model(options: WindowOptions, noise: WindowNoise) -> ClockModel:
    """Return the model of the receiver's clock drift, its walk as fitted if it was."""
    if options.clock != "random-walk":
        return ClockModel(options.clock)
    return ClockModel(
        options.clock, options.clock_walk if noise.clock_walk is None else noise.clock_walk
    )


class Believed(NamedTuple):
    """What a cost was made of: rows with the σ they were weighted with, and what else is known."""

    rows: AlignmentRows
    clock: ClockModel
    priors: tuple[Prior, ...]


class Solved(NamedTuple):
    """What one method says about one window."""

    status: str
    C_ew: FloatArray
    sigma_heading: float = float("nan")
    chi2_per_dof: float = float("nan")
    bound: float = float("nan")
    result: AlignmentResult | None = None
    believed: Believed | None = None


def solve(
    rows: AlignmentRows, options: WindowOptions, noise: WindowNoise, C_en: FloatArray
) -> Solved:
    """Align one window; an `AlignmentError` says why there is no rotation."""
    if options.method == "voba":
        return Solved("BASELINE", voba(rows).C_ew)
    clock, correlated = clock_model(options, noise), noise.correlated
    priors = _priors(options, C_en)
    if options.method == "robust":
        robust = align_robust(rows, clock, correlated=correlated, priors=priors)
        kept = rows.take(robust.inliers).correlated(correlated)
        return _judged(robust.result, Believed(kept, clock, priors))
    if options.method == "certified":
        result = align(rows, clock, correlated=correlated, priors=priors)
        return _judged(result, Believed(rows.correlated(correlated), clock, priors))
    problem = build_problem(rows, clock, correlated=correlated)
    if options.method == "gauss-newton":
        found = gauss_newton(problem)
        chi2 = problem.cost(found.C_ew) / problem.dof if problem.dof > 0 else float("nan")
        status = "BASELINE" if found.converged else "NOT_CONVERGED"
        return Solved(status, found.C_ew, chi2_per_dof=chi2)
    result = align_sdp(problem)
    chi2 = result.cost / result.dof if result.dof > 0 else float("nan")
    # θ is in w axes; its down component there is the heading's error on level ground.
    sigma = float(np.sqrt(result.cov_w[2, 2]))
    return Solved(result.status.name, result.C_ew, sigma, chi2)


def _priors(options: WindowOptions, C_en: FloatArray) -> tuple[Prior, ...]:
    """Return the up prior of a vehicle on a road, if asked for."""
    if options.level_deg is None:
        return ()
    return (up_prior([0.0, 0.0, -1.0], C_en, np.radians(options.level_deg)),)


def _judged(result: AlignmentResult, believed: Believed) -> Solved:
    """Return the overall verdict, or the names of the verdicts that did not pass."""
    failed = "not " + ", ".join(v.name for v in result.failed)
    chi2 = result.cost / result.dof if result.dof > 0 else float("nan")
    sigma = float(np.sqrt(result.cov_w[2, 2]))
    status = "PASSED" if result.passed else failed
    return Solved(status, result.C_ew, sigma, chi2, result.bound, result, believed)
