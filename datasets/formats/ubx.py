"""u-blox logs: the NAV-PVT solutions of a UBX file, as fixes.

One message holds position, velocity, their accuracy estimates, and GPS time of week. The
estimates hAcc, vAcc and sAcc, which u-blox does not define further, are taken as 1σ of *each*
axis they cover; 0, or the largest number there is, means that the receiver does not know.
"""

from __future__ import annotations

import io
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...filters.earth import C_en_at, lla_to_ecef
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray
from .. import gpstime
from ..observations import GnssFixes
from .receiver_logs import (
    GPS_EPOCH_UNIX,
    covariance,
    decoded,
    in_order,
    log_bytes,
    needs,
    of_damaged,
)

#: Accuracies beyond these are no estimates [m], [m/s]: the field is full, or was never set.
_UNKNOWN_POSITION, _UNKNOWN_SPEED = 1e5, 1e4
#: A log of which more than this share steps back in time is in the wrong order.
_OUT_OF_ORDER = 0.2


def read_ubx(
    path: str | Path,
    *,
    position_sigma: FloatArray | None = None,
    velocity_sigma: FloatArray | None = None,
) -> tuple[GnssFixes, tuple[str, ...]]:
    """Return the NAV-PVT solutions of a UBX log.

    Parameters
    ----------
    path : path
    position_sigma, velocity_sigma : array_like, shape (1,) or (3,), optional
        1σ north, east, down [m], [m/s] where the receiver does not know its accuracy. Without,
        such positions are left out, and such velocities missing.

    Returns
    -------
    fixes : GnssFixes
        3-D fixes with a valid date, in order of time.
    notes : tuple of str
        With what was left out, and why.

    Raises
    ------
    DataError
        No such message, most of them out of order, or the package pyubx2 is not installed.
    ConfigError
        No position with an accuracy, and none declared.
    """
    path = Path(path)
    damaged: list[str] = []
    left_out: Counter[str] = Counter()
    rows = []
    for m in _messages(path, damaged):
        if m.fixType not in (3, 4) or not (m.validDate and m.validTime and m.gnssFixOk):
            left_out["without a 3-D fix"] += 1
        elif m.numSV == 0:
            left_out["with a fix of no satellite"] += 1
        else:
            rows.append(
                (
                    *(_epoch(m, path), m.lat, m.lon),
                    *(1e-3 * v for v in (m.height, m.hAcc, m.vAcc)),
                    *(1e-3 * v for v in (m.velN, m.velE, m.velD, m.sAcc)),
                    *(m.numSV, getattr(m, "carrSoln", 0)),
                )
            )
    if not rows:
        raise DataError(
            f"no NAV-PVT message with a 3-D fix found ({sum(left_out.values())} without)",
            file=path,
            remedy="enable UBX-NAV-PVT in the receiver, or convert the raw data to RINEX",
        )
    value = np.array(rows, dtype=float)
    value = value[_ordered(path, value[:, 0], left_out)]
    pos_sigma = _sigma(value[:, [4, 4, 5]], _UNKNOWN_POSITION, position_sigma)
    known = np.isfinite(pos_sigma).all(axis=1)
    if not known.any():
        raise ConfigError(
            f"{path}: the receiver tells no accuracy of its positions (hAcc, vAcc = 0) — add "
            "under [gnss]: position_sigma_m = [2.0, 2.0, 4.0]"
        )
    left_out["of unknown accuracy"] += int((~known).sum())
    value, pos_sigma = value[known], pos_sigma[known]
    vel_sigma = _sigma(value[:, [9, 9, 9]], _UNKNOWN_SPEED, velocity_sigma)
    lat, lon = np.radians(value[:, 1:3]).T
    C_en = C_en_at(lat, lon)
    vel_e = np.einsum("nij,nj->ni", C_en, value[:, 6:9])
    slow = ~np.isfinite(vel_sigma).all(axis=1)
    vel_e[slow] = np.nan
    words = np.array(["receiver", "float", "fixed"])
    fixes = GnssFixes(
        time=value[:, 0],
        pos_e=lla_to_ecef(lat, lon, value[:, 3]),
        pos_cov_e=covariance(C_en, pos_sigma),
        vel_e=vel_e,
        vel_cov_e=covariance(C_en, vel_sigma),
        satellites=value[:, 10].astype(int),
        quality=words[np.clip(value[:, 11].astype(int), 0, 2)],
    )
    counted = ", ".join(f"{n} {why}" for why, n in left_out.items() if n)
    missing = f"; {int(slow.sum())} velocities of unknown accuracy left out" if slow.any() else ""
    return fixes, (
        f"UBX NAV-PVT, {path.name}: {len(fixes)} fixes; messages left out: {counted or 'none'}"
        f"{missing}; hAcc and sAcc taken as 1σ of each axis" + of_damaged(damaged),
    )


def _messages(path: Path, damaged: list[str]) -> Any:
    try:
        from pyubx2 import UBX_PROTOCOL, UBXReader
    except ImportError:
        raise needs("pyubx2", path) from None
    reader = UBXReader(
        io.BytesIO(log_bytes(path)), protfilter=UBX_PROTOCOL, quitonerror=1,
        errorhandler=lambda error: damaged.append(str(error)),
    )  # fmt: skip
    for message in decoded(lambda: next(reader)[1], damaged):
        if message.identity == "NAV-PVT":
            yield message


def _epoch(m: Any, path: Path) -> float:
    """Return GPS time [s]: time of week as given, week from the UTC date."""
    try:
        utc = gpstime.from_calendar(m.year, m.month, m.day, m.hour, m.min, m.second)
    except ValueError:
        raise DataError(
            f"NAV-PVT: expected a date, found {m.year}-{m.month}-{m.day} {m.hour}:{m.min}, iTOW "
            f"{m.iTOW} ms",
            file=path,
            remedy="the log is damaged: copy it again, or cut the message out",
        ) from None
    near = float(gpstime.from_unix(utc + GPS_EPOCH_UNIX))
    sow = m.iTOW * 1e-3
    week = round((near - sow) / gpstime.SECONDS_PER_WEEK)
    return float(gpstime.from_week_sow(week, sow))


def _ordered(path: Path, time: FloatArray, left_out: Counter[str]) -> NDArray[np.bool_]:
    """Return the rows to keep so that time increases; refuse a log in the wrong order."""
    keep = np.diff(time, prepend=-np.inf) != 0.0
    left_out["repeated"] += int((~keep).sum())
    back = keep.copy()
    back[keep] = ~in_order(time[keep])
    keep &= ~back
    left_out["out of order in time"] += int(back.sum())
    if back.sum() > _OUT_OF_ORDER * time.size:
        k = int(np.flatnonzero(np.diff(time) < 0.0)[0]) + 1
        raise DataError(
            f"{int(back.sum())} of {time.size} NAV-PVT fixes are out of order in time, the first "
            f"step back is {time[k - 1] - time[k]:.1f} s at fix {k + 1}",
            file=path,
            remedy="logs put together: put them in order of time, or read them one by one",
        )
    return keep


def _sigma(told: FloatArray, unknown: float, declared: FloatArray | None) -> FloatArray:
    """Return told deviations, those declared where none is told, or NaN."""
    bad = ~((told > 0.0) & (told < unknown)).all(axis=1)
    out = told.copy()
    out[bad] = np.nan if declared is None else declared
    return out
