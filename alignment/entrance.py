"""One entrance to alignment with rows: arrays in, one result out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from numpy.typing import ArrayLike

from . import verdict
from .priors import Prior
from .problem import ClockModel
from .result import AlignmentResult
from .robust import align_robust
from .rows import AlignmentRows
from .verdict import VerdictLimits


def align(
    rows: AlignmentRows | Mapping[str, ArrayLike],
    clock: ClockModel | None = None,
    *,
    robust: bool = False,
    nuisance: ArrayLike | None = None,
    priors: Iterable[Prior] = (),
    correlated: float = 1.0,
    limits: VerdictLimits | None = None,
    vel_sigma: float = 0.0,
    backend: str | None = None,
) -> AlignmentResult:
    """Find the attitude of the local frame from Doppler rows with local velocities, and judge it.

    Parameters
    ----------
    rows : AlignmentRows or mapping
        Plain arrays by name, `AlignmentRows.of`; or rows as `AlignmentRows.paired` makes them of
        Doppler and local velocities, with the position's σ.
    clock : ClockModel, optional
        Default: one drift for the whole window.
    robust : bool
        Whether to find out which rows may be believed, as `alignment.robust.align_robust` does,
        which also says how. The result then has `inliers`, and CONSENSUS among its verdicts if
        some may not.
    nuisance : array_like, shape (k, m), optional
        Further unknowns, as for `alignment.problem.build_problem`.
    priors : iterable of Prior
        What else is known of the attitude.
    correlated : float
        How many rows say what one independent row would, as for `build_problem`.
    limits : VerdictLimits, optional
    vel_sigma : float
        1σ per axis of the local velocities [m/s], for the observability test.
    backend : {'numba', 'numpy'}, optional
        Of the solver.

    Raises
    ------
    DataError
        If arrays are missing, or not what they should be.
    AlignmentError
        If there are no rows, or they say nothing about the attitude.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import align
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05)
    >>> result = align(window.rows)
    >>> result.passed, bool(np.degrees(result.bound) < 10.0)
    (True, True)
    >>> error = np.arccos(0.5 * (np.trace(result.C_ew.T @ window.C_ew) - 1.0))
    >>> bool(error < result.bound)  # the truth is within what is claimed
    True
    """
    if not isinstance(rows, AlignmentRows):
        rows = AlignmentRows.of(rows)
    if not robust:
        return verdict.align(
            rows, clock, nuisance=nuisance, priors=priors, correlated=correlated, limits=limits,
            vel_sigma=vel_sigma, backend=backend,
        )  # fmt: skip
    found = align_robust(
        rows, clock, nuisance=nuisance, priors=priors, correlated=correlated, limits=limits,
        vel_sigma=vel_sigma, backend=backend,
    )  # fmt: skip
    return replace(found.result, inliers=found.inliers)
