"""Weighted least squares against the mean of screened pairs, with few satellites drawn at random.

The paper's estimate from more than two satellites is a choice among pairs; their mean is the
natural one. n-satellite least squares uses the same draws, at the same epochs: those in which at
least one pair passes the screening.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray
from ..screening import Screening, screen, usable_pairs
from .pairs import all_pairs, epoch_speeds, projected
from .samples import Samples
from .statistics import rms


@dataclass(frozen=True)
class FewSatellites:
    """Speed errors with `satellites` drawn from every epoch.

    Attributes
    ----------
    satellites : int
    epochs : int
        Epochs judged, all draws together.
    availability : float
        Share of the epochs in which a pair passed; the same for both.
    rms_pairs, rms_joint : float
        RMS of the speed error: mean of the pairs that passed, and least squares of all
        satellites drawn [m/s].
    largest_difference : float
        Between the two, over all epochs [m/s]; 0 for two satellites.
    """

    satellites: int
    epochs: int
    availability: float
    rms_pairs: float
    rms_joint: float
    largest_difference: float

    @property
    def improvement(self) -> float:
        """Share of the RMS that least squares takes away."""
        return 1.0 - self.rms_joint / self.rms_pairs


def few_satellites(
    samples: Samples,
    satellites: int,
    *,
    draws: int = 5,
    seed: int = 0,
    screening: Screening | None = None,
) -> FewSatellites:
    """Return how both estimates do with `satellites` drawn at random in every epoch.

    Parameters
    ----------
    samples : Samples
        Its range rates' σ are the weights.
    satellites : int
        2 or more.
    draws : int
        Independent draws for every epoch.
    seed : int
    screening : Screening, optional
        Of the pairs.
    """
    if satellites < 2:
        raise ConfigError(f"satellites: expected 2 or more, found {satellites}")
    rng = np.random.default_rng(seed)
    true_e = samples.vel_e - samples.motion.swing_e
    truth = np.einsum("ij,ij->i", true_e, samples.motion.u_e)
    errors: list[tuple[FloatArray, FloatArray]] = []
    for _ in range(draws):
        pick = _drawn(samples, satellites, rng)
        rows, epoch = samples.rows.take(pick), samples.epoch[pick]
        pairs = all_pairs(rows, epoch, samples.motion, samples.cn0[pick], samples.elevation[pick])
        marks = screen(pairs, screening or Screening())
        count = usable_pairs(pairs, marks)
        passed = marks == 0
        total = np.bincount(pairs.epoch[passed], pairs.speed[passed], truth.size)
        h, y = projected(rows, epoch, samples.motion)
        joint = epoch_speeds(h, y, rows.sigma, epoch, truth.size)
        have = count > 0
        errors.append((total[have] / count[have] - truth[have], joint.speed[have] - truth[have]))
    by_pairs, by_joint = (np.concatenate(e) for e in zip(*errors, strict=True))
    return FewSatellites(
        satellites, by_pairs.size, by_pairs.size / (draws * truth.size), rms(by_pairs),
        rms(by_joint), float(np.abs(by_pairs - by_joint).max(initial=0.0)),
    )  # fmt: skip


def _drawn(samples: Samples, satellites: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return the rows of `satellites` satellites drawn from every epoch."""
    order = np.lexsort((rng.random(len(samples.rows)), samples.epoch))
    counts = np.bincount(samples.epoch, minlength=samples.time.size)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    rank = np.arange(order.size) - first[samples.epoch[order]]
    pick = np.zeros(order.size, dtype=bool)
    pick[order[rank < satellites]] = True
    return pick
