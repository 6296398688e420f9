"""Do positions move as velocities say? A regression that noise does not decide.

Positions are regressed on the integral of the velocities, block by block with a start of its own:
``p(t) = p_0 + B ∫v dt``, north and east. In order, B is the identity; exchanged axes, signs and
units are other matrices, and noise, however large against one step, only widens B's σ. Blocks are
long enough that the declared σ is small against the way in them. What is claimed rests on blocks
left out (jackknife), so that positions whose σ is declared too small are not refused either.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ..filters.earth import C_en_of
from ..filters.errors import DataError
from ..filters.rotation import FloatArray
from .physics import refuse

#: B may be off by this share of the way before anything is said: half of what knots do.
TOLERANCE = 0.25
#: A cause explains B to this share.
_EXPLAINED = 0.15
#: And both have to hold beyond this many σ.
_SIGMAS = 3.0
#: What no B explains is another motion, not noise, from this share of the way on, and if it is so
#: many times the declared σ; that σ where none is declared [m].
_UNEXPLAINED, _BEYOND_NOISE, _UNDECLARED = 0.4, 6.0, 3.0
#: Length of a block [s], and how often the way in it holds the position's σ.
_BLOCK, _SIGMAS_IN_BLOCK = 20.0, 20.0
#: Blocks into which a short recording is divided all the same, and rows a block needs.
_FEWEST_BLOCKS, _FEWEST_IN_BLOCK = 6, 3
#: Rows needed in motion, and what is motion: mean speed of a block [m/s].
_FEWEST_ROWS, _MOVING = 10, 1.0
#: A step so many times the median one, and so long [m], is a jump and begins another block.
_JUMP, _JUMP_M = 100.0, 100.0
#: Times between rows that are a gap, in median ones.
_GAP = 3.0
_GROUPS = 8
_ITERATIONS = 8
_SWAP = np.array([[0.0, 1.0], [1.0, 0.0]])


@dataclass(frozen=True, eq=False)
class Cause:
    """What makes a B other than the identity.

    Attributes
    ----------
    matrix : ndarray, shape (2, 2)
        The B it makes, north and east.
    words, remedy : str
        What it is, said of the velocity; what to do.
    """

    matrix: FloatArray
    words: str
    remedy: str


def _unit(name: str, factor: float) -> Cause:
    """Return the cause "in another unit": `factor` [m/s] of it was taken for 1 m/s."""
    return Cause(
        factor * np.eye(2), f"it is in {name}, not m/s",
        f'the velocity is in {name}: velocity_unit = "{name}"',
    )  # fmt: skip


#: What velocities are mistaken for; factors are those on what was read as m/s.
CAUSES = (
    Cause(
        _SWAP, "north and east are swapped",
        "the columns are east before north: exchange them, or declare the other of ned, enu",
    ),
    Cause(-np.eye(2), "its sign is reversed", "the velocity has the opposite sign"),
    Cause(np.diag([1.0, -1.0]), "its east component has the wrong sign",
          "east has the opposite sign"),
    Cause(np.diag([-1.0, 1.0]), "its north component has the wrong sign",
          "north has the opposite sign"),
    _unit("km/h", 1.0 / 3.6),
    _unit("knots", 1852.0 / 3600.0),
    _unit("ft/s", 0.3048),
    Cause(
        3.6 * np.eye(2), "it is in m/s, not km/h",
        'the velocity is in m/s: velocity_unit = "m/s"',
    ),
    Cause(
        3600.0 / 1852.0 * np.eye(2), "it is in m/s, not knots",
        'the velocity is in m/s: velocity_unit = "m/s"',
    ),
    *(
        Cause(
            seconds * np.eye(2), f"the stamps are in {unit}, not seconds",
            f'the stamps are in {unit}, not seconds: time_unit = "{unit}"',
        )
        for unit, seconds in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))
    ),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Agreement:
    """Positions against velocities.

    Attributes
    ----------
    B : ndarray, shape (2, 2)
        Displacement over displacement by velocity, north and east.
    root : ndarray, shape (2, 2)
        Square root of the mean square of the displacements by velocity: what B rests on [m].
    sigma : float
        1σ of B along them, as a share.
    scatter : float
        Median distance of the positions from the fit [m].
    way : float
        Root mean square of the displacements of the positions [m].
    noise : float
        Their declared 1σ [m].
    """

    B: FloatArray
    root: FloatArray
    sigma: float
    scatter: float
    way: float
    noise: float

    def misfit(self, matrix: ArrayLike) -> float:
        """Return how far B is from a matrix, as a share of the way that matrix makes."""
        M = np.asarray(matrix, dtype=float)
        way = float(np.linalg.norm(M @ self.root))
        return float(np.linalg.norm((self.B - M) @ self.root)) / way

    def unexplained(self, matrix: ArrayLike) -> float:
        """Return the mean square of what a matrix leaves of the way, as a share of its own."""
        M, X = np.asarray(matrix, dtype=float), self.root @ self.root.T
        left = self.way**2 - 2.0 * np.trace(M.T @ self.B @ X) + np.trace(M @ X @ M.T)
        return float(left) / max(self.way**2, 1e-12)

    @property
    def factor(self) -> float:
        """How many times as far positions move as velocities say."""
        return float(np.linalg.norm(self.B @ self.root) / np.linalg.norm(self.root))

    @property
    def contradicts(self) -> bool:
        """Whether the positions move otherwise than the velocities say, beyond doubt."""
        off = self.misfit(np.eye(2))
        # What fits neither each other nor one B is not noisy but something else.
        share = _UNEXPLAINED / 2.0 if off > 2.0 * TOLERANCE else _UNEXPLAINED
        elsewhere = self.scatter > max(share * self.way, _BEYOND_NOISE * self.noise)
        return elsewhere or off > TOLERANCE + _SIGMAS * self.sigma

    @property
    def agrees(self) -> bool:
        """Whether they are known to move as the velocities say."""
        return self.misfit(np.eye(2)) + _SIGMAS * self.sigma < 2.0 * TOLERANCE

    def cause(self, causes: Iterable[Cause] = CAUSES) -> Cause | None:
        """Return the cause that makes this B, or None."""
        best = min(causes, key=lambda cause: self.misfit(cause.matrix))
        size = float(np.linalg.norm(best.matrix)) / np.sqrt(2.0)
        limit = _EXPLAINED + _SIGMAS * self.sigma / size
        fits = self.misfit(best.matrix) < min(limit, 2.0 * _EXPLAINED)
        noise = (_SIGMAS * self.noise / max(self.way, 1e-6)) ** 2
        return best if fits and self.unexplained(best.matrix) < 0.1 + noise else None


def agreement(
    time: ArrayLike, pos_e: ArrayLike, vel_e: ArrayLike, sigma: ArrayLike | None = None
) -> Agreement | None:
    """Return the regression of positions on the integral of their velocities.

    Parameters
    ----------
    time : array_like, shape (n,)
        [s], increasing.
    pos_e, vel_e : array_like, shape (n, 3)
        ECEF [m], [m/s]; NaN where unknown.
    sigma : array_like, shape (n,), optional
        Horizontal 1σ of the positions as declared [m].

    Returns
    -------
    Agreement or None
        None with too little motion to tell.
    """
    t, p, v = (np.asarray(a, dtype=float) for a in (time, pos_e, vel_e))
    known = np.isfinite(p).all(axis=1) & np.isfinite(v).all(axis=1)
    known &= _fresh(p, known)
    t, p, v = t[known], p[known], v[known]
    declared = np.full(t.size, np.nan) if sigma is None else np.asarray(sigma, dtype=float)[known]
    if t.size < _FEWEST_ROWS:
        return None
    C_ne = np.swapaxes(C_en_of(p), 1, 2)
    v_n = np.einsum("nij,nj->ni", C_ne, v)[:, :2]
    step = np.diff(t)
    moved = np.einsum("nij,nj->ni", C_ne[1:], np.diff(p, axis=0))[:, :2]
    said = 0.5 * (v_n[1:] + v_n[:-1]) * step[:, None]
    length = np.linalg.norm(moved, axis=1)
    broken = step > _GAP * np.median(step)
    broken |= (length > _JUMP * np.median(length)) & (length > _JUMP_M)
    x, y = (np.concatenate([[[0.0, 0.0]], np.cumsum(d, axis=0)]) for d in (said, moved))
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(said, axis=1))])
    block = _blocks(t, broken, way, declared)
    use = _moves(block, t, way)
    if use.sum() < _FEWEST_ROWS:
        return None
    noise = float(np.nanmedian(declared)) if np.isfinite(declared).any() else _UNDECLARED
    return _fitted(x[use], y[use], np.unique(block[use], return_inverse=True)[1], noise)


def _fresh(p: FloatArray, known: np.ndarray) -> np.ndarray:
    """Tell the rows that do not repeat the position before: a repeated one was not measured.

    Where nearly all are repeated, it is the position that stands still.
    """
    before = np.concatenate([[[np.nan] * 3], p[:-1]])
    fresh = ~(np.abs(p - before).max(axis=1) < 1e-6)
    return fresh if (fresh & known).sum() >= _FEWEST_ROWS else np.ones_like(fresh)


def _blocks(t: FloatArray, broken: np.ndarray, way: FloatArray, sigma: FloatArray) -> np.ndarray:
    """Return the number of the block of each row."""
    segment = np.concatenate([[0], np.cumsum(broken)])
    duration = float(t[-1] - t[0])
    length = _BLOCK
    if np.isfinite(sigma).any():
        speed = float(way[-1]) / duration
        length = max(length, _SIGMAS_IN_BLOCK * float(np.nanmedian(sigma)) / max(speed, _MOVING))
    least = _FEWEST_IN_BLOCK * float(np.median(np.diff(t)))
    length = max(min(length, duration / _FEWEST_BLOCKS), least)
    start = t[np.searchsorted(segment, segment, "left").astype(int)]
    inside = ((t - start) / length + 1e-9).astype(int)
    return np.cumsum(np.concatenate([[0], (np.diff(segment) > 0) | (np.diff(inside) > 0)]))


def _moves(block: np.ndarray, t: FloatArray, way: FloatArray) -> np.ndarray:
    """Tell the rows of blocks that are long enough and in motion."""
    first = np.searchsorted(block, block)
    last = np.searchsorted(block, block, side="right") - 1
    lasted = np.maximum(t[last] - t[first], 1e-9)
    rows = last - first + 1
    return (rows >= _FEWEST_IN_BLOCK) & ((way[last] - way[first]) / lasted > _MOVING)


def _fitted(x: FloatArray, y: FloatArray, block: np.ndarray, noise: float) -> Agreement:
    """Fit y = B x, each block about its own mean, with Cauchy weights."""
    weight = np.ones(len(x))
    for _ in range(_ITERATIONS):
        a, b = _centred(x, block, weight), _centred(y, block, weight)
        B = _slope(a, b, weight)
        apart = np.linalg.norm(b - a @ B.T, axis=1)
        scale = 1.5 * float(np.median(apart)) + 1e-3
        weight = 1.0 / (1.0 + (apart / scale) ** 2)
    count = int(block[-1]) + 1
    groups = block * min(_GROUPS, count) // count
    square = (a * weight[:, None]).T @ a / weight.sum()
    value, vector = np.linalg.eigh(square)
    root = vector * np.sqrt(np.maximum(value, 0.0))
    parts = [_slope(a[groups != g], b[groups != g], weight[groups != g]) for g in np.unique(groups)]
    n, sigma = len(parts), np.inf
    if n > 1:
        spread = sum(float(np.linalg.norm((part - B) @ root)) ** 2 for part in parts)
        sigma = float(np.sqrt((n - 1) / n * spread) / np.linalg.norm(root))
    way = float(np.sqrt((weight * (b**2).sum(axis=1)).sum() / weight.sum()))
    return Agreement(B, root, sigma, float(np.median(apart)), way, noise)


def _centred(value: FloatArray, block: np.ndarray, weight: FloatArray) -> FloatArray:
    total = np.bincount(block, weight)
    mean = np.column_stack([np.bincount(block, weight * column) / total for column in value.T])
    return np.asarray(value - mean[block])


def _slope(a: FloatArray, b: FloatArray, weight: FloatArray) -> FloatArray:
    normal = (a * weight[:, None]).T @ a
    # A road in one direction leaves the other open: what B is there does not count.
    normal += 1e-9 * np.trace(normal) * np.eye(2) + 1e-300 * np.eye(2)
    return np.asarray(np.linalg.solve(normal, (a * weight[:, None]).T @ b).T)


def horizontal_sigma(cov_e: FloatArray) -> FloatArray:
    """Return the horizontal 1σ [m], shape (n,), of position covariances in ECEF; NaN as they."""
    return np.asarray(np.sqrt(2.0 / 3.0 * np.trace(cov_e, axis1=1, axis2=2)))


def check_velocity(
    time: FloatArray,
    pos_e: FloatArray,
    vel_e: FloatArray,
    sigma: FloatArray | None = None,
    *,
    file: Path,
    declared: str,
) -> None:
    """Refuse velocities that contradict the positions they stand beside.

    Parameters
    ----------
    time, pos_e, vel_e, sigma
        As of `agreement`.
    file : Path
    declared : str
        Frame of the velocities, for the message.

    Raises
    ------
    DataError
        With the frame, the sign or the unit in which they would agree.
    """
    found = agreement(time, pos_e, vel_e, sigma)
    if found is None or not found.contradicts:
        return
    cause = found.cause()
    remedy = "check columns, velocity_frame, velocity_unit and position order"
    problem = (
        f"velocity declared {declared} contradicts the positions: they move {found.factor:.3g} "
        f"times as far as it says, {100.0 * found.misfit(np.eye(2)):.0f} % of the way is elsewhere "
        f"(± {100.0 * found.sigma:.0f} %)"
    )
    remedy = remedy if cause is None else cause.remedy
    refuse(DataError(problem, file=file, remedy=remedy), "velocity")
