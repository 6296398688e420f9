"""What GNSS says: observations row by row, and the positions somebody made of them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..filters.errors import DataError
from ..filters.rotation import FloatArray
from .fields import StrArray, checked, freeze, ordered, span


@dataclass(frozen=True, eq=False)
class GnssObservations:
    """GNSS observations: one row per satellite signal and epoch, ordered by time.

    Nothing is ever removed: a row that must not be used carries the reason in `rejected`
    ('' = usable). Missing values are NaN.

    Parameters
    ----------
    time : array_like, shape (n,)
        Reception time by the receiver's clock, as a GPS time [s].
    sat : array_like of str, shape (n,)
        RINEX satellite identifier, constellation letter and number: 'G05'.
    signal : array_like of str, shape (n,)
        RINEX 3 band and attribute: '1C'.
    wavelength : array_like, shape (n,)
        Carrier wavelength [m].
    pseudorange : array_like, shape (n,)
        [m].
    carrier : array_like, shape (n,)
        Carrier phase [cycles].
    range_rate : array_like, shape (n,)
        −λD [m/s]: positive when receding, satellite and receiver clock drift still in it.
    cn0 : array_like, shape (n,)
        Carrier-to-noise density [dB-Hz].
    loss_of_lock : array_like of int, shape (n,)
        RINEX loss-of-lock indicator bits, 0 when unknown.
    sat_pos_e, sat_vel_e : array_like, shape (n, 3)
        Satellite position [m] and velocity [m/s] at transmission, in the ECEF axes *of the
        transmission instant*; rotating them to reception is the range-rate model's job.
    sat_clock, sat_clock_drift : array_like, shape (n,)
        c·δt^s [m] (relativity included, group delay not) and its rate [m/s].
    elevation, azimuth : array_like, shape (n,)
        Seen from the receiver [rad], azimuth clockwise from north; NaN until a position is known.
    rejected : array_like of str, shape (n,)
        Why the row is not used; '' when it is.
    label : array_like of str, shape (n,), optional
        What a data set says of the path: 'los', 'nlos', or '' where it says nothing. Nothing in
        the pipeline uses it; it is there to judge by.
    noise_factor : array_like, shape (n,), optional
        1σ of the range rate over what C/N0 alone says: 1, or as fits the row's constellation.

    Examples
    --------
    >>> from certnav.datasets import SimulationConfig, simulate
    >>> drive = simulate(SimulationConfig(duration=10.0, density="open", seed=1))
    >>> drive.observations
    GnssObservations(99 rows, 99 usable, 11 epochs, 1 Hz, 10.0 s, systems G, signals 1C)
    >>> time, rows = next(drive.observations.epochs())
    >>> int((drive.observations.rejected[rows] == "").sum())  # usable in the first epoch
    9
    """

    time: FloatArray
    sat: StrArray
    signal: StrArray
    wavelength: FloatArray
    pseudorange: FloatArray
    carrier: FloatArray
    range_rate: FloatArray
    cn0: FloatArray
    loss_of_lock: NDArray[np.int64]
    sat_pos_e: FloatArray
    sat_vel_e: FloatArray
    sat_clock: FloatArray
    sat_clock_drift: FloatArray
    elevation: FloatArray
    azimuth: FloatArray
    rejected: StrArray
    label: StrArray = field(default_factory=lambda: np.empty(0, dtype="U4"))
    noise_factor: FloatArray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        time = checked("observations", "time", self.time, (-1,))
        n = time.size
        ordered("observations", time, strictly=False)
        if np.size(self.label) == 0:
            freeze(self, label=np.full(n, "", dtype="U4"))
        if np.size(self.noise_factor) == 0:
            freeze(self, noise_factor=np.ones(n))
        freeze(self, noise_factor=checked("observations", "noise_factor", self.noise_factor, (n,)))
        for name in ("sat", "signal", "rejected", "label", "loss_of_lock"):
            value = np.asarray(getattr(self, name))
            if value.shape != (n,):
                raise DataError(f"observations.{name}: expected shape ({n},), found {value.shape}")
            if name == "loss_of_lock":
                value = value.astype(np.int64)
            elif value.dtype.kind != "U":
                value = value.astype(str)
            freeze(self, **{name: value})
        freeze(
            self, time=time, wavelength=checked("observations", "wavelength", self.wavelength, (n,))
        )
        for name in ("pseudorange", "carrier", "range_rate", "cn0", "sat_clock"):
            freeze(self, **{name: checked("observations", name, getattr(self, name), (n,), False)})
        for name in ("sat_clock_drift", "elevation", "azimuth"):
            freeze(self, **{name: checked("observations", name, getattr(self, name), (n,), False)})
        for name in ("sat_pos_e", "sat_vel_e"):
            freeze(
                self, **{name: checked("observations", name, getattr(self, name), (n, 3), False)}
            )

    def __len__(self) -> int:
        return self.time.size

    def __repr__(self) -> str:
        epochs = np.unique(self.time)
        systems, signals = np.unique(self.sat.astype("U1")), np.unique(self.signal)
        return (
            f"GnssObservations({len(self)} rows, {int(self.usable.sum())} usable, {epochs.size} "
            f"epochs, {span(epochs)}, systems {''.join(systems)}, signals {' '.join(signals)})"
        )

    @property
    def usable(self) -> NDArray[np.bool_]:
        """True for rows that nothing has rejected, shape (n,)."""
        return np.asarray(self.rejected == "")

    @cached_property
    def has_range_rate(self) -> NDArray[np.bool_]:
        """True for usable rows whose range rate and satellite state are known, shape (n,)."""
        state = np.isfinite(self.sat_vel_e).all(1) & np.isfinite(self.sat_clock_drift)
        return np.asarray(self.usable & np.isfinite(self.range_rate) & state)

    def epochs(self) -> Iterator[tuple[float, slice]]:
        """Yield the time of each epoch and the slice of its rows."""
        if not len(self):
            return
        starts = np.flatnonzero(np.diff(self.time, prepend=-np.inf) > 0)
        for start, stop in zip(starts, [*starts[1:], len(self)], strict=True):
            yield float(self.time[start]), slice(int(start), int(stop))

    def take(self, rows: slice | NDArray) -> GnssObservations:
        """Return the given rows (a slice, a mask or indices)."""
        taken = object.__new__(GnssObservations)  # what is taken of sound columns is sound
        freeze(taken, **{name: getattr(self, name)[rows] for name in _COLUMNS})
        ordered("observations", taken.time, strictly=False)
        for name in _COLUMNS:
            getattr(taken, name).flags.writeable = False
        return taken

    def with_columns(self, **columns: object) -> GnssObservations:
        """Return a copy with the named columns replaced."""
        return dataclasses.replace(self, **columns)  # type: ignore[arg-type]

    def mark(self, rows: NDArray[np.bool_], reason: str) -> GnssObservations:
        """Return a copy in which the still usable rows of the mask are rejected for `reason`."""
        rejected = np.where(rows & self.usable, reason, self.rejected)
        return self.with_columns(rejected=rejected)


_COLUMNS = tuple(f.name for f in dataclasses.fields(GnssObservations))


@dataclass(frozen=True, eq=False)
class GnssFixes:
    """Antenna positions, and velocities where the source has them, with covariance.

    Parameters
    ----------
    time : array_like, shape (n,)
        GPS time [s], strictly increasing.
    pos_e, vel_e : array_like, shape (n, 3)
        ECEF [m], [m/s]; velocity rows are NaN where there is none.
    pos_cov_e, vel_cov_e : array_like, shape (n, 3, 3)
        Covariances in ECEF axes [m²], [m²/s²]; NaN together with a missing velocity.
    satellites : array_like of int, shape (n,)
        Satellites used, −1 when the source does not say.
    quality : array_like of str, shape (n,)
        'fixed', 'float', 'dgps', 'single', 'receiver' …
    rejected : array_like of str, shape (n,), optional
        Why the row is not used (`datasets.fix_faults`); '' when it is.

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.datasets import GnssFixes
    >>> from certnav.filters import lla_to_ecef
    >>> pos_e = np.tile(lla_to_ecef(0.5, 2.0, 30.0), (3, 1))
    >>> cov = np.tile(4.0 * np.eye(3), (3, 1, 1))
    >>> none = np.full((3, 3), np.nan), np.full((3, 3, 3), np.nan)  # no velocities
    >>> GnssFixes(np.arange(3.0), pos_e, cov, *none, np.full(3, 7), np.full(3, "single"))
    GnssFixes(3 epochs, 1 Hz, 2.0 s, 0 with velocity; single 3)
    """

    time: FloatArray
    pos_e: FloatArray
    pos_cov_e: FloatArray
    vel_e: FloatArray
    vel_cov_e: FloatArray
    satellites: NDArray[np.int64]
    quality: StrArray
    rejected: StrArray = field(default_factory=lambda: np.empty(0, dtype="U1"))

    def __post_init__(self) -> None:
        time = checked("fixes", "time", self.time, (-1,))
        n = time.size
        ordered("fixes", time)
        freeze(
            self,
            time=time,
            pos_e=checked("fixes", "pos_e", self.pos_e, (n, 3)),
            pos_cov_e=checked("fixes", "pos_cov_e", self.pos_cov_e, (n, 3, 3)),
            vel_e=checked("fixes", "vel_e", self.vel_e, (n, 3), False),
            vel_cov_e=checked("fixes", "vel_cov_e", self.vel_cov_e, (n, 3, 3), False),
            satellites=np.asarray(self.satellites, dtype=np.int64),
            quality=np.asarray(self.quality).astype(str),
            rejected=np.full(n, "") if np.size(self.rejected) != n else np.asarray(self.rejected),
        )
        for name in ("satellites", "quality"):
            if getattr(self, name).shape != (n,):
                found = getattr(self, name).shape
                raise DataError(f"fixes.{name}: expected shape ({n},), found {found}")

    def __len__(self) -> int:
        return self.time.size

    def __repr__(self) -> str:
        quality, count = np.unique(self.quality, return_counts=True)
        shares = ", ".join(f"{q} {c}" for q, c in zip(quality, count, strict=True))
        return (
            f"GnssFixes({len(self)} epochs, {span(self.time)}, {int(self.has_velocity.sum())} with "
            f"velocity; {shares})"
        )

    @property
    def usable(self) -> NDArray[np.bool_]:
        """True for rows that nothing has rejected, shape (n,)."""
        return np.asarray(self.rejected == "")

    @property
    def has_velocity(self) -> NDArray[np.bool_]:
        """True where a velocity with covariance is given, shape (n,)."""
        both = np.isfinite(self.vel_e).all(1) & np.isfinite(self.vel_cov_e).all((1, 2))
        return np.asarray(both)

    def take(self, rows: slice | NDArray) -> GnssFixes:
        """Return the given rows (a slice, a mask or indices)."""
        return GnssFixes(**{f.name: getattr(self, f.name)[rows] for f in dataclasses.fields(self)})
