"""A trajectory that somebody else has computed, as far as the file tells."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...filters.earth import C_en_of
from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ..fields import checked, freeze, ordered

#: Points of the vehicle that a solution may follow.
POINTS = ("imu", "antenna")


def _unstated() -> FloatArray:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class ForeignSolution:
    """Time and position, and whatever else is stated; NaN where it is not.

    Parameters
    ----------
    source : str
        Program and file.
    time : array_like, shape (n,)
        GPS time [s], strictly increasing.
    pos_e : array_like, shape (n, 3)
        ECEF [m].
    vel_e : array_like, shape (n, 3), optional
        ECEF [m/s].
    rpy : array_like, shape (n, 3), optional
        Roll, pitch, heading of forward-right-down axes with respect to NED [rad].
    cov_pos_n, cov_vel_n : array_like, shape (n, 3, 3), optional
        As stated, north-east-down [m²], [m²/s²].
    sigma_rpy : array_like, shape (n, 3), optional
        [rad].
    point : {'imu', 'antenna'}
        Which point of the vehicle it follows.
    notes : tuple of str
        What was assumed about the file.
    """

    source: str
    time: FloatArray
    pos_e: FloatArray
    vel_e: FloatArray = field(default_factory=_unstated)
    rpy: FloatArray = field(default_factory=_unstated)
    cov_pos_n: FloatArray = field(default_factory=_unstated)
    cov_vel_n: FloatArray = field(default_factory=_unstated)
    sigma_rpy: FloatArray = field(default_factory=_unstated)
    point: str = "imu"
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        time = checked("solution", "time", self.time, (-1,))
        n = time.size
        if n < 2:
            raise DataError(f"solution: expected at least 2 epochs, found {n}")
        ordered("solution", time)
        if self.point not in POINTS:
            raise DataError(f"solution.point: expected 'imu' or 'antenna', found {self.point!r}")
        shapes = {
            "vel_e": (n, 3), "rpy": (n, 3), "cov_pos_n": (n, 3, 3), "cov_vel_n": (n, 3, 3),
            "sigma_rpy": (n, 3),
        }  # fmt: skip
        parts = {}
        for name, shape in shapes.items():
            value = getattr(self, name)
            value = value if np.size(value) else np.full(shape, np.nan)
            parts[name] = checked("solution", name, value, shape, False)
        pos_e = checked("solution", "pos_e", self.pos_e, (n, 3))
        freeze(self, time=time, pos_e=pos_e, **parts)


def checked_places(pos_e: FloatArray, line: NDArray[np.int64], file: Path) -> None:
    """Refuse (`DataError`) positions that are not near the Earth's surface.

    Parameters
    ----------
    pos_e : ndarray, shape (n, 3)
        [m].
    line : ndarray of int, shape (n,)
        Of each row in the file.
    file : Path
    """
    radius = np.linalg.norm(pos_e, axis=1)
    bad = ~((radius > 6.33e6) & (radius < 6.48e6))  # 20 km below to 100 km above the ellipsoid
    if bad.any():
        k = int(np.argmax(bad))
        raise DataError(
            f"expected a position near the Earth's surface, found {pos_e[k].round(1).tolist()} m",
            file=file,
            line=int(line[k]),
            remedy="an epoch without a solution? leave it out",
        )


def turned_to_ned(pos_e: FloatArray, cov_e: FloatArray) -> FloatArray:
    """Return covariances in north-east-down axes of those in ECEF, shape (n, 3, 3)."""
    C_en = C_en_of(pos_e)
    turned: FloatArray = np.swapaxes(C_en, 1, 2) @ cov_e @ C_en
    return turned


def diagonal(sigma: FloatArray) -> FloatArray:
    """Return covariances of standard deviations; NaN where one is not positive."""
    positive = np.all(sigma > 0.0, axis=1)
    stated = np.where(positive[:, None], sigma, np.nan)
    return np.asarray(stated[:, :, None] ** 2 * np.eye(3))
