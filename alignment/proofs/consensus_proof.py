"""Proof that no other rotation explains as many rows: branch and bound over all of SO(3).

A certificate of the least-squares cost says nothing about which rows went into it. What can be
proved about the choice is that every rotation with at least m inliers lies near the one at hand.
Rows may be counted by `row_weights`, the share of all directions of C v in which they would be
outliers: a weak signal, or one of a car that hardly moves, agrees with every rotation, and a plain
count would hide the difference behind such rows.

Rotation vectors within a ball of radius π are cut into cubes; Exp of a cube of half-width h turns
a vector by no more than √3·h away from where its centre does (Hartley and Kahl 2009), so a row is
an inlier for *some* rotation of the cube only with a clock drift in

    |v| cos(min(φ + √3h, π)) − z − c  ≤  cδṫ  ≤  |v| cos(max(φ − √3h, 0)) − z + c,

φ between the line of sight and the velocity as the centre turns it. The largest number of such
intervals that share a point, by weight, bounds the consensus of the cube.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...filters.errors import ConfigError
from ...filters.rotation import FloatArray, matrix_from_rotvec
from ..priors import Prior
from ..rows import AlignmentRows
from ..solver.refinement import rotation_angle

#: Cells examined at a time, and the smallest half-width [rad].
_CHUNK, _SMALLEST = 1024, 1e-3
#: How far a rotation may be from what a prior says, in σ.
_PRIOR_LIMIT = 4.0
_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


@dataclass(frozen=True, eq=False)
class ConsensusProof:
    """What branch and bound found out.

    Attributes
    ----------
    proved : bool
        Every rotation with `required` inliers or more lies within `radius` of the one given.
    required : float
        Inliers asked for, by weight.
    radius : float
        [rad].
    cells : int
        Cubes examined.
    rival : ndarray, shape (3, 3), or None
        A rotation outside with that many inliers, if one was met: the disproof.
    """

    proved: bool
    required: float
    radius: float
    cells: int
    rival: FloatArray | None

    def __repr__(self) -> str:
        said = "proved" if self.proved else "not proved" if self.rival is None else "disproved"
        return (
            f"<ConsensusProof {said}: none with {self.required:.4g} beyond "
            f"{np.degrees(self.radius):.3g}°, {self.cells} cells>"
        )


def row_weights(rows: AlignmentRows, cutoff: float, slack: float = 0.0) -> FloatArray:
    """Return the share of all directions in which each row would be an outlier, shape (k,).

    `slack` is that of `prove_consensus` [m/s].
    """
    speed = np.linalg.norm(rows.vel_w, axis=1) * np.linalg.norm(rows.e_e, axis=1)
    return 1.0 - np.minimum((cutoff * rows.sigma + slack) / np.maximum(speed, 1e-300), 1.0)


def consensus(
    rows: AlignmentRows,
    C_ew: ArrayLike,
    cutoff: float,
    *,
    per_epoch: bool,
    weight: ArrayLike | None = None,
) -> float:
    """Return how many rows agree with a rotation, for the clock that suits most of them.

    Parameters
    ----------
    rows : AlignmentRows
    C_ew : array_like, shape (3, 3)
    cutoff : float
        Largest residual of an inlier, in σ.
    per_epoch : bool
        A clock drift of its own for every epoch, instead of one for all.
    weight : array_like, shape (k,), optional
        What each row counts; default 1.
    """
    speed, cosine = _cosines(rows, np.asarray(C_ew, dtype=float)[None])
    drift = speed * cosine - rows.z
    half, weight = cutoff * rows.sigma, _counted(rows, weight)
    return float(_stabbed(drift - half, drift + half, _groups(rows, per_epoch), weight)[0])


def prove_consensus(
    rows: AlignmentRows,
    C_ew: ArrayLike,
    required: float,
    *,
    cutoff: float = 3.5,
    radius: float = np.radians(10.0),
    per_epoch: bool = False,
    parts: ArrayLike | None = None,
    slack: ArrayLike = 0.0,
    max_cells: int = 40_000,
    weight: ArrayLike | None = None,
    priors: Iterable[Prior] = (),
) -> ConsensusProof:
    """Try to prove that all rotations with `required` inliers lie within `radius` of C_ew.

    Parameters
    ----------
    rows : AlignmentRows
        All of them, outliers too.
    C_ew : array_like, shape (3, 3)
    required : float
        Of `consensus`, or less for a stronger statement.
    cutoff : float
        Largest residual of an inlier, in σ.
    radius : float
        [rad]. Rotations within the noise of the best one have as many inliers as that: it cannot
        be arbitrarily small.
    per_epoch : bool
        As for `consensus`.
    parts : array_like of int, shape (k,), optional
        Rows with the same number share a drift, in place of the whole window or an epoch.
    slack : array_like, shape () or (k,)
        How much the drift may wander while it is shared, and what all rows share move each of
        them, either way [m/s]; inliers are then counted too generously, which makes the proof
        harder, not weaker.
    max_cells : int
        Where to give up; about 10 µs each with 60 rows.
    weight : array_like, shape (k,), optional
        As for `consensus`.
    priors : iterable of Prior
        Rotations that contradict one of them by more than 4σ are not asked about.
    """
    if not (required > 0.0 and 0.0 < radius < np.pi):
        raise ConfigError(
            f"consensus proof: expected 0 < required and 0 < radius < 180°, "
            f"found {required:g} and {np.degrees(radius):g}°"
        )
    C_ew = np.asarray(C_ew, dtype=float)
    groups = _groups(rows, per_epoch) if parts is None else Groups.alike(parts)
    # The clock's size costs digits in the sums below, and any constant is as good.
    z, half = rows.z - np.median(rows.z), cutoff * rows.sigma + np.asarray(slack) + 1e-7
    weight, priors = _counted(rows, weight), tuple(priors)
    least = required * (1.0 - 1e-9)  # of sums in another order
    stack, cells = [(np.zeros((1, 3)), np.pi)], 0
    while stack:
        centres, width = stack.pop()
        if len(centres) > _CHUNK:
            stack.append((centres[_CHUNK:], width))
            centres = centres[:_CHUNK]
        nearest = np.maximum(np.abs(centres) - width, 0.0)
        centres = centres[np.sum(nearest * nearest, axis=1) <= (np.pi + 1e-9) ** 2]
        cells += len(centres)
        if cells > max_cells or width < _SMALLEST:
            return ConsensusProof(False, required, radius, cells, None)
        C = matrix_from_rotvec(centres)
        reach = np.sqrt(3.0) * width
        away = rotation_angle(C_ew, C)
        open_ = (away + reach >= radius) & _allowed(priors, C, reach)
        centres, C, away = centres[open_], C[open_], away[open_]
        if not len(centres):
            continue
        speed, cosine = _cosines(rows, C)
        alive = _reached(speed, cosine, reach, z, half, groups, weight, least)
        if not alive.any():
            continue
        centres, C, away, cosine = centres[alive], C[alive], away[alive], cosine[alive]
        outside = (away > radius) & _allowed(priors, C, 0.0)
        if width < 0.5 and outside.any():
            drift = speed * cosine[outside] - z
            found = _stabbed(drift - half, drift + half, groups, weight)
            if found.max() >= least:
                rival = C[outside][int(np.argmax(found))]
                return ConsensusProof(False, required, radius, cells, rival)
        stack.append(((centres[:, None] + width * _CORNERS).reshape(-1, 3), 0.5 * width))
    return ConsensusProof(True, required, radius, cells, None)


def _cosines(rows: AlignmentRows, C: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return |v||e| of the rows and the cosines between C v and e, shapes (k,) and (n, k)."""
    size = np.linalg.norm(rows.vel_w, axis=1) * np.linalg.norm(rows.e_e, axis=1)
    pairs = (rows.vel_w[:, :, None] * rows.e_e[:, None, :]).reshape(-1, 9)
    cosine = np.swapaxes(C, 1, 2).reshape(-1, 9) @ pairs.T / np.maximum(size, 1e-300)
    return size, np.clip(cosine, -1.0, 1.0)


def _allowed(priors: Iterable[Prior], C: FloatArray, reach: float) -> NDArray[np.bool_]:
    """Return where some rotation within `reach` of C satisfies each prior, shape (n,)."""
    allowed = np.ones(len(C), dtype=bool)
    x = np.hstack([np.swapaxes(C, 1, 2).reshape(-1, 9), np.ones((len(C), 1))])
    distance = 2.0 * np.sqrt(2.0) * np.sin(0.5 * min(reach, np.pi))  # |R − C|, Frobenius
    for prior in priors:
        nearest = np.linalg.norm(x @ prior.rows.T, axis=1)
        nearest -= np.linalg.norm(prior.rows[:, :9], 2) * distance
        allowed &= nearest <= _PRIOR_LIMIT
    return allowed


def _counted(rows: AlignmentRows, weight: ArrayLike | None) -> FloatArray:
    return np.ones(len(rows)) if weight is None else np.asarray(weight, dtype=float)


class Groups(NamedTuple):
    """Rows that share a clock drift: `member[first[g] : first[g + 1]]` are those of group g."""

    member: NDArray[np.int64]
    first: NDArray[np.int64]

    @classmethod
    def alike(cls, labels: ArrayLike) -> Groups:
        """Return the groups of equal labels."""
        labels = np.asarray(labels)
        _, count = np.unique(labels, return_counts=True)
        return cls(np.argsort(labels, kind="stable"), np.append(0, np.cumsum(count)))


def _groups(rows: AlignmentRows, per_epoch: bool) -> Groups:
    return Groups.alike(rows.epoch if per_epoch else np.zeros(len(rows), dtype=np.int64))


def _stabbed(low: FloatArray, high: FloatArray, groups: Groups, weight: FloatArray) -> FloatArray:
    """Return the weight of the intervals that one point per group can hit at most, shape (n,)."""
    from .stabbing import stabbed  # numba is slow to import: left until it is used

    total = np.zeros(len(low))
    stabbed(low, high, groups.member, groups.first, weight, total)
    return total


def _reached(
    speed: FloatArray, cosine: FloatArray, reach: float, z: FloatArray, half: FloatArray,
    groups: Groups, weight: FloatArray, least: float,
) -> NDArray[np.bool_]:  # fmt: skip
    """Return whether turns of up to `reach` can have `least` of the weight agree, shape (n,)."""
    from .stabbing import reached

    reached_by = np.empty(len(cosine), dtype=bool)
    c, s = (np.cos(reach), np.sin(reach)) if reach < np.pi else (-1.0, 0.0)
    reached(
        speed, cosine, float(c), float(s), z, half, groups.member, groups.first, weight, least,
        reached_by,
    )  # fmt: skip
    return reached_by
