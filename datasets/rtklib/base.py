"""Where the antenna of a base station is: as declared or as its file says, and by its ranges."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ...filters.earth import C_en_of
from ...filters.errors import ConfigError, DataError, as_given, is_converted
from ...filters.rotation import FloatArray
from ..text import rinex_header as header
from .postpos import post_processed, single_options

#: Single-point positions of a base that are looked at: more know its place no better, for what
#: ionosphere and orbits do to them lasts.
_ENOUGH = 120
#: Below that, reflections and troposphere are the larger part [rad].
_MASK = np.radians(10.0)


@dataclass(frozen=True, eq=False)
class OwnMean:
    """Where a base's own pseudoranges have it.

    Attributes
    ----------
    pos_e : ndarray, shape (3,)
        Median of its single-point positions [m].
    sigma : float
        1σ of one of them per axis [m]: what makes it lasts, and no mean is much better.
    """

    pos_e: FloatArray
    sigma: float


def own_mean(
    bases: list[Path], navigation: list[Path], span: tuple[float, float]
) -> OwnMean | None:
    """Return where a base's own pseudoranges have it; None where they give no position.

    Parameters
    ----------
    bases, navigation : list of Path
        Plain RINEX of one station.
    span : tuple of float
        First and last epoch of the base [s].
    """
    interval = float(np.floor((span[1] - span[0]) / _ENOUGH))
    with tempfile.TemporaryDirectory(prefix="certnav-base-") as scratch:
        found = post_processed(
            Path(scratch), [bases], navigation, single_options(_MASK), max(interval, 0.0)
        ).fixes
    if not len(found):
        return None
    variance = np.median(np.trace(found.pos_cov_e, axis1=1, axis2=2)) / 3.0
    return OwnMean(np.median(found.pos_e, axis=0), float(np.sqrt(variance)))


def base_position(file: Path, declared: ArrayLike | None) -> tuple[FloatArray, str] | None:
    """Return the base's antenna [m] and where that comes from; None where nothing says it.

    Parameters
    ----------
    file : Path
        RINEX observations.
    declared : array_like, shape (3,), optional
        Goes before what the file says [m].

    Raises
    ------
    DataError
        A position that is not on the Earth, or no number, with its line.
    """
    if declared is not None:
        position, source = np.asarray(declared, dtype=float), "declared"
        if position.shape != (3,):
            raise ConfigError(f"base position: expected X, Y, Z in metres, found {declared!r}")
        remedy, line = "give ECEF X, Y, Z in metres", None
    else:
        found = _header_position(file)
        if found is None:
            return None
        position, line = found
        name = Path(as_given(file)).name
        source = f"{'position in' if is_converted(file) else 'APPROX POSITION of'} {name}"
        remedy = "declare the base's position"
    if not 6.3e6 < np.linalg.norm(position) < 6.5e6:
        raise DataError(
            f"base position {np.round(position, 3)} m is not on the Earth",
            file=file, line=line, remedy=remedy,
        )  # fmt: skip
    return position, source


def refuse_no_position(file: Path, own: OwnMean | None) -> None:
    """Refuse a base whose position nobody tells, with what its own ranges say."""
    remedy = "declare the base's ECEF position in metres (gnss.base_position_e_m)"
    if own is not None:
        where = ", ".join(f"{v:.1f}" for v in own.pos_e)
        remedy += (
            f"; its own single-point positions have it at [{where}], to {own.sigma:.0f} m (1σ)"
        )
    lacks = "its header has no APPROX POSITION XYZ"
    if is_converted(file):
        lacks = "its log tells none (in RTCM 3: 1005 or 1006)"
    raise DataError(
        f"no position of the base station: {lacks}",
        file=file,
        remedy=remedy,
    )


def _header_position(file: Path) -> tuple[FloatArray, int] | None:
    """Return the antenna's position from a RINEX header, and the line it stands in."""
    marker, line, offset = None, 0, np.zeros(3)
    with file.open(encoding="latin-1") as stream:
        for number, text in enumerate(stream, start=1):
            label = header.split(text)[1]
            if label == "END OF HEADER":
                break
            if label not in ("APPROX POSITION XYZ", "ANTENNA: DELTA H/E/N"):
                continue
            try:
                value = np.array([float(text[14 * k : 14 * k + 14]) for k in range(3)])
            except ValueError:
                raise DataError(
                    f"{label}: expected three numbers, found '{text[:42].strip()}'",
                    file=file, line=number,
                ) from None  # fmt: skip
            if label.startswith("APPROX"):
                marker, line = value, number
            else:
                offset = value
    if marker is None or not marker.any():
        return None
    if np.linalg.norm(marker) < 6e6:  # refused by the caller
        return marker, line
    up, east, north = offset
    return marker + C_en_of(marker) @ np.array([north, east, -up]), line
