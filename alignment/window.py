"""A window that slides: the cost matrix of the last epochs at a constant price per epoch.

The cost is a sum over epochs of small Gram matrices of [B, clock and nuisance columns]; only the
elimination at the end couples them. A queue of two stacks keeps the sum: one holds the sums of
its epochs from the newest of them back, the other a running total. Epochs are only ever added,
never subtracted, so that nothing is lost to cancellation however long it runs.

Clock models with a fixed number of unknowns per window are 'constant' and 'linear'; 'per-epoch'
is eliminated before the sum. The random walk couples all epochs and needs the window as a whole
(`alignment.problem`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..filters.errors import AlignmentError, ConfigError, DataError
from ..filters.rotation import FloatArray
from .problem import AlignmentProblem, AlignmentRows, ClockModel, design_matrix, project_out


@dataclass(frozen=True, eq=False)
class _Epoch:
    """One epoch's share of the normal equations, or the sum of several."""

    gram: FloatArray
    rows: int
    information: float
    eliminated: int
    time: float

    def __add__(self, other: _Epoch) -> _Epoch:
        return _Epoch(
            self.gram + other.gram, self.rows + other.rows,
            self.information + other.information, self.eliminated + other.eliminated, self.time,
        )  # fmt: skip


class SlidingWindow:
    """Alignment problem of the last seconds, updated epoch by epoch.

    Parameters
    ----------
    duration : float
        Epochs older than this, from the newest, are dropped [s].
    clock : ClockModel, optional
        'constant' (default), 'linear' or 'per-epoch'.
    nuisances : int
        Number of further unknowns, constant over the window, whose columns come with each epoch;
        three for an unknown start velocity.
    """

    def __init__(
        self, duration: float, clock: ClockModel | None = None, *, nuisances: int = 0
    ) -> None:
        self.clock = clock or ClockModel()
        if not 0.0 < duration < np.inf:
            raise ConfigError(f"alignment window: expected a duration > 0 s, found {duration!r}")
        if self.clock.kind == "random-walk":
            raise ConfigError(
                "alignment window: clock model 'random-walk' couples all epochs — "
                "use 'linear' or 'per-epoch', or build the whole window"
            )
        self.duration = duration
        self.nuisances = nuisances
        self._clocks = {"constant": 1, "linear": 2, "per-epoch": 0}[self.clock.kind]
        size = 10 + self._clocks + nuisances
        self._nothing = _Epoch(np.zeros((size, size)), 0, 0.0, 0, -np.inf)
        self._old: list[_Epoch] = []  # sums from each epoch to the newest of the old ones
        self._new: list[_Epoch] = []
        self._total = self._nothing  # of the new ones
        self._origin: tuple[float, float] | None = None
        self._newest = -np.inf

    def __len__(self) -> int:
        """Return the number of epochs held."""
        return len(self._old) + len(self._new)

    def push(self, rows: AlignmentRows, nuisance: ArrayLike | None = None) -> None:
        """Add one epoch and drop those that have become too old.

        Parameters
        ----------
        rows : AlignmentRows
            Of one instant, later than all before.
        nuisance : array_like, shape (k, nuisances), optional
            Columns as in `alignment.problem.build_problem`.
        """
        extra = np.zeros((len(rows), 0)) if nuisance is None else np.asarray(nuisance, dtype=float)
        if extra.shape != (len(rows), self.nuisances):
            raise DataError(
                f"nuisance: expected shape ({len(rows)}, {self.nuisances}), found {extra.shape}"
            )
        if len(rows):
            time = float(rows.time[0])
            if time <= self._newest:
                raise DataError(
                    f"alignment window: epoch at {time:.3f} s is not later than {self._newest:.3f}"
                )
            self._newest = time
            # The clock's size is taken out of z first: a constant that the clock takes up anyway.
            if self._origin is None:
                self._origin = (float(np.median(rows.z)), time)
            epoch = self._epoch(rows, extra)
            self._new.append(epoch)
            self._total = self._total + epoch
            while self._oldest() < time - self.duration * (1.0 + 1e-12):
                self._drop()

    def problem(self) -> AlignmentProblem:
        """Return the problem of the epochs held.

        The drift among the nuisances of a linear clock is that at an instant within the window
        which the window chooses, not at its mean time.

        Raises
        ------
        AlignmentError
            If there are none, or they say nothing about the attitude.
        """
        if not len(self) or self._origin is None:
            raise AlignmentError("no rows to align with: the alignment window is empty")
        held = self._total if not self._old else self._old[-1] + self._total
        A, N = held.gram[:10, :10], held.gram[:10, 10:]
        values, axes = np.linalg.eigh(held.gram[10:, 10:])
        kept = values > 1e-12 * max(float(values[-1]), 1e-300) if values.size else np.zeros(0, bool)
        root = axes[:, kept] / np.sqrt(values[kept])
        Q = A - (N @ root) @ (N @ root).T
        if np.trace(Q[:9, :9]) <= 1e-13 * np.trace(A):
            raise AlignmentError(
                "the window says nothing about the attitude: the vehicle stands still, or the "
                "clock model takes up every row — wait for motion, or use a stiffer clock model"
            )
        Q = 0.5 * (Q + Q.T)
        scale, vectors = np.linalg.eigh(Q)
        root_Q = np.sqrt(np.maximum(scale, 0.0))[:, None] * vectors.T
        factor = np.asarray(np.linalg.qr(root_Q, mode="r"), dtype=float)
        parameters = -(root @ root.T) @ N.T
        if self._clocks:
            parameters[0, 9] -= self._origin[0]
        dof = held.rows - int(kept.sum()) - held.eliminated - 3
        return AlignmentProblem(Q, factor, dof, held.information, parameters)

    def _epoch(self, rows: AlignmentRows, extra: FloatArray) -> _Epoch:
        assert self._origin is not None
        level, start = self._origin
        weight = 1.0 / rows.sigma[:, None]
        design = design_matrix(rows)
        design[:, 9] += level
        eliminated = 0
        columns = -np.ones((len(rows), self._clocks))
        if self._clocks == 2:
            columns[:, 1] *= rows.time - start
        stacked = weight * np.hstack([design, columns, extra])
        if self.clock.kind == "per-epoch":
            stacked, eliminated = project_out(stacked, weight * np.ones((len(rows), 1)))
        return _Epoch(
            stacked.T @ stacked, len(rows), float(np.sum(weight**2)), eliminated,
            float(rows.time[0]),
        )  # fmt: skip

    def _oldest(self) -> float:
        return self._old[-1].time if self._old else self._new[0].time

    def _drop(self) -> None:
        if not self._old:
            self._turn_over()
        self._old.pop()

    def _turn_over(self) -> None:
        """Make the new epochs the old ones, with their sums and times from their own middle."""
        assert self._origin is not None
        level, start = self._origin
        shift = 0.5 * (self._new[0].time + self._new[-1].time) - start
        T = np.eye(len(self._nothing.gram))
        if self._clocks == 2:
            T[10, 11] = -shift
            self._origin = (level, start + shift)
        total = self._nothing
        for epoch in reversed(self._new):
            moved = _Epoch(
                T.T @ epoch.gram @ T, epoch.rows, epoch.information, epoch.eliminated, epoch.time
            )
            total = moved + total
            self._old.append(total)
        self._new, self._total = [], self._nothing
