"""Rows of the alignment problem: Doppler measurements paired with local velocities.

A row says how fast the antenna moves along one line of sight,

    z = e·C_ew v_w − cδṫ + noise,            e from receiver to satellite,

where w is the local frame (the axes the local velocity is given in) and C_ew is wanted. `z` is
that of `velocity.range_rate.DopplerRows`: e·v^s − ρ̇ to first order, eq. (5) of DDIA-VE. Song et
al. write the same with n = −e; in their eqs. (4) and (7), as printed, the satellite's velocity
cancels, which their published code does not repeat.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..filters.errors import ConfigError, DataError
from ..filters.rotation import FloatArray

if TYPE_CHECKING:
    from ..velocity.range_rate import DopplerRows

#: 1σ per axis of a position of which nothing is said [m]: a single-point position in a street,
#: 8 mm/s of Doppler.
POSITION_SIGMA = 30.0


@dataclass(frozen=True, eq=False)
class AlignmentRows:
    """Doppler measurements paired with the local velocity at the same instant.

    Parameters
    ----------
    e_e : array_like, shape (k, 3)
        Line of sight from receiver to satellite, ECEF (unit vectors to 1e-3; `DopplerRows.e_e`
        carries the factor 1/κ).
    vel_w : array_like, shape (k, 3)
        Antenna velocity relative to the Earth in local axes [m/s].
    z : array_like, shape (k,)
        Measured velocity along the line of sight plus clock, z = e_e·C_ew·vel_w − cδṫ [m/s]: the
        range rate with the satellite's part taken out, positive towards the satellite.
    sigma : array_like, shape (k,)
        1σ of `z` [m/s].
    epoch : array_like of int, shape (k,)
        Index of the epoch; rows of one epoch share their clock drift.
    time : array_like, shape (k,)
        [s].
    common : array_like, shape (k, m), optional
        What 1σ of each error that all rows share does to `z` [m/s], z = … + common @ u with
        u ~ N(0, I): of the position that lines of sight were computed for, of the speed's scale.
        They are unknowns like the clock, with what is known of them. Default: none.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.alignment import AlignmentRows
    >>> from certnav.alignment.reference import simulate_window
    >>> rng = np.random.default_rng(7)
    >>> window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05)
    >>> rows = window.rows
    >>> arrays = {"e_e": rows.e_e, "vel_w": rows.vel_w, "z": rows.z, "sigma": rows.sigma}
    >>> AlignmentRows.of({**arrays, "time": rows.time})
    <AlignmentRows, 80 at 20 epochs over 19.0 s>
    >>> rows.take(rows.time < 5.0)
    <AlignmentRows, 20 at 5 epochs over 4.0 s>
    """

    e_e: FloatArray
    vel_w: FloatArray
    z: FloatArray
    sigma: FloatArray
    epoch: NDArray[np.int64]
    time: FloatArray
    common: FloatArray | None = None

    def __post_init__(self) -> None:
        k = np.size(self.z)
        for name, shape in (("z", (k,)), ("e_e", (k, 3)), ("vel_w", (k, 3)), ("sigma", (k,)),
                            ("time", (k,))):  # fmt: skip
            object.__setattr__(self, name, _checked(name, getattr(self, name), shape))
        epoch = np.asarray(self.epoch)
        if epoch.shape != (k,) or (k and not np.issubdtype(epoch.dtype, np.integer)):
            raise DataError(
                f"alignment rows.epoch: expected {k} integers, "
                f"found shape {epoch.shape} of {epoch.dtype}"
            )
        object.__setattr__(self, "epoch", epoch.astype(np.int64))
        common = np.zeros((k, 0)) if self.common is None else np.asarray(self.common, dtype=float)
        shape = (k, common.shape[1] if common.ndim == 2 else 0)
        object.__setattr__(self, "common", _checked("common", common, shape))
        length = np.linalg.norm(self.e_e, axis=1)
        _refuse("e_e", np.abs(length - 1.0) > 1e-3, length, "a unit vector")
        _refuse("sigma", self.sigma <= 0.0, self.sigma, "a positive 1σ")

    def __repr__(self) -> str:
        epochs = np.unique(self.epoch).size
        return f"<AlignmentRows, {len(self)} at {epochs} epochs over {self._span:.1f} s>"

    def __len__(self) -> int:
        return self.z.size

    @property
    def _span(self) -> float:
        return float(np.ptp(self.time)) if len(self) else 0.0

    @classmethod
    def paired(
        cls,
        doppler: DopplerRows,
        time: ArrayLike,
        vel_w: ArrayLike,
        *,
        vel_sigma: float = 0.0,
        position_sigma: float = POSITION_SIGMA,
        speed_scale_sigma: float = 0.0,
    ) -> AlignmentRows:
        """Return Doppler rows paired with local velocities.

        Parameters
        ----------
        doppler : DopplerRows
            k of them.
        time : array_like, shape (k,)
            Their epochs [s].
        vel_w : array_like, shape (k, 3)
            Antenna velocity in local axes at these times [m/s].
        vel_sigma : float
            1σ per axis of it [m/s], added to that of every row.
        position_sigma : float
            1σ per axis of the position that the Doppler rows were made with [m]: three unknowns
            of the window, as far as the rows know their geometry (`DopplerRows.z_by_pos`). What
            it turns of the lines of sight themselves, 0.003° a kilometre, is left out.
        speed_scale_sigma : float
            1σ of the relative error of the velocities' scale, if it is not known; one unknown.
        """
        time, vel_w = np.asarray(time, dtype=float), np.asarray(vel_w, dtype=float)
        _, epoch = np.unique(time, return_inverse=True)
        sigma = np.hypot(doppler.sigma, vel_sigma)
        common = shared_errors(
            doppler.z, doppler.z_by_pos, position_sigma=position_sigma,
            speed_scale_sigma=speed_scale_sigma,
        )  # fmt: skip
        return cls(doppler.e_e, vel_w, doppler.z, sigma, epoch, time, common)

    @classmethod
    def of(cls, arrays: Mapping[str, ArrayLike]) -> AlignmentRows:
        """Return rows from plain arrays by their names; rows of one time are one epoch.

        Parameters
        ----------
        arrays : mapping
            'e_e', 'vel_w', 'z', 'sigma' and 'time', as above; 'epoch' and 'common' if there are.

        Raises
        ------
        DataError
            If one is missing, or there is another.
        """
        names = [field.name for field in fields(cls)]
        for name in arrays:
            if name not in names:
                raise DataError(f"alignment rows: '{name}' is none of {', '.join(names)}")
        for name in ("e_e", "vel_w", "z", "sigma", "time"):
            if name not in arrays:
                raise DataError(f"alignment rows: expected '{name}', found {', '.join(arrays)}")
        epoch = np.unique(np.asarray(arrays["time"], dtype=float), return_inverse=True)[1]
        return cls(**{"epoch": epoch, **arrays})  # type: ignore[arg-type]

    def take(self, rows: slice | NDArray) -> AlignmentRows:
        """Return the given rows (a slice, a mask or indices)."""
        return AlignmentRows(
            self.e_e[rows], self.vel_w[rows], self.z[rows], self.sigma[rows],
            self.epoch[rows], self.time[rows], self.shared[rows],
        )  # fmt: skip

    @property
    def shared(self) -> FloatArray:
        """`common`, of no columns where there is none, shape (k, m)."""
        assert self.common is not None  # __post_init__ has seen to it
        return self.common

    def reach(self, sigmas: float) -> FloatArray:
        """Return how far shared errors of so many σ move rows against their middle [m/s]."""
        apart = self.shared - self.shared.mean(axis=0)
        return np.asarray(sigmas * np.sqrt(np.sum(apart * apart, axis=1)))

    def correlated(self, count: float) -> AlignmentRows:
        """Return the rows with the σ that makes `count` of them weigh as much as one."""
        if not 1.0 <= count < np.inf:
            raise ConfigError(f"alignment rows: expected correlated ≥ 1, found {count!r}")
        return self if count == 1.0 else replace(self, sigma=self.sigma * np.sqrt(count))


def shared_errors(
    z: FloatArray, z_by_pos: FloatArray | None, *, position_sigma: float, speed_scale_sigma: float
) -> FloatArray:
    """Return what 1σ of position and speed scale do to rows [m/s], shape (k, m).

    Rows made at p + δp have z that is larger by ∂z/∂p·δp. Velocities s times too small leave
    e·C v (1 + s): s·(z − level), since e·C v is z less the clock, which takes up the level.
    """
    if not (0.0 <= position_sigma < np.inf and 0.0 <= speed_scale_sigma < np.inf):
        raise ConfigError(
            "alignment rows: expected position_sigma ≥ 0 m and speed_scale_sigma ≥ 0, found "
            f"{position_sigma!r} and {speed_scale_sigma!r}"
        )
    columns = np.zeros((z.size, 0))
    if z_by_pos is not None and position_sigma > 0.0:
        columns = position_sigma * z_by_pos
    if speed_scale_sigma > 0.0 and z.size:
        scale = speed_scale_sigma * (z - np.median(z))
        columns = np.hstack([columns, scale[:, None]])
    return columns


def _checked(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    array = np.asarray(value, dtype=float)
    if array.shape != shape:
        raise DataError(f"alignment rows.{name}: expected shape {shape}, found {array.shape}")
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        raise DataError(f"alignment rows.{name}: not finite at index {int(bad[0, 0])}")
    return array


def _refuse(name: str, bad: NDArray[np.bool_], found: FloatArray, expected: str) -> None:
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(
            f"alignment rows.{name}: expected {expected}, found {found[k]:.6g} at index {k}"
        )
