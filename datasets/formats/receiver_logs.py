"""What the readers of receivers' own logs share: decoding that goes on, and covariances by σ.

Decoding is done by pyubx2 and pynmeagps (extra ``receivers``).
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ..text.tables import cannot_open

#: Unix time of the GPS epoch [s].
GPS_EPOCH_UNIX = 315964800.0
#: A σ of the vertical velocity where a receiver tells speed and course only [m/s].
VERTICAL_SPEED = 1.0


def log_bytes(path: Path) -> bytes:
    """Return the content of a log; one that cannot be opened is a `DataError`."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise cannot_open(path, error) from None


def decoded(following: Callable[[], Any], damaged: list[str]) -> Iterator[Any]:
    """Yield the messages of a decoder; what it cannot read is told in `damaged`."""
    while True:
        try:
            message = following()
        except StopIteration:
            return
        except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError) as error:
            damaged.append(str(error))  # the decoder's own surprise: it goes on behind it
            continue
        if message is not None:
            yield message


def of_damaged(damaged: list[str]) -> str:
    """Return the end of a note on what could not be decoded."""
    return f"; {len(damaged)} damaged messages left out" if damaged else ""


def needs(package: str, path: Path) -> DataError:
    """Return the error for a decoder that is not installed."""
    return DataError(
        f"reading this log needs the package {package}",
        file=path,
        remedy="pip install 'certnav[receivers]'",
    )


def covariance(C_en: FloatArray, sigma: FloatArray) -> FloatArray:
    """Return covariances in ECEF of deviations north, east, down."""
    return np.einsum("nij,nj,nkj->nik", C_en, sigma**2, C_en)


def in_order(time: FloatArray) -> NDArray[np.bool_]:
    """Return the most rows that can be kept so that time increases, shape (n,).

    A log put together of two that overlap loses the overlap of one of them; a clock that runs
    ahead until the first fix loses what it stamped.
    """
    if (np.diff(time) > 0.0).all():
        return np.ones(time.size, dtype=bool)
    tails: list[float] = []  # the earliest end of an increasing run of each length …
    last: list[int] = []  # … and its row
    before = np.full(time.size, -1)
    for k, t in enumerate(time.tolist()):
        length = bisect_left(tails, t)
        if length == len(tails):
            tails.append(t)
            last.append(k)
        else:
            tails[length], last[length] = t, k
        before[k] = last[length - 1] if length else -1
    keep = np.zeros(time.size, dtype=bool)
    k = last[-1]
    while k >= 0:
        keep[k] = True
        k = int(before[k])
    return keep
