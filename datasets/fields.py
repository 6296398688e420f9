"""What fields of the records hold: arrays of one shape, finite, ordered in time, read-only."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from ..filters.errors import DataError
from ..filters.rotation import FloatArray

StrArray = NDArray[np.str_]

#: Beyond any quantity in SI units here; squares and cubes of it are finite.
_LARGEST = 1e40


def checked(owner: str, name: str, value: object, shape: tuple[int, ...], finite: bool = True):
    """Return `value` as a read-only float array of `shape` (−1: any), or refuse it by name."""
    array = np.ascontiguousarray(value, dtype=float)
    if array.ndim != len(shape) or any(
        s not in (-1, a) for s, a in zip(shape, array.shape, strict=True)
    ):
        wanted = tuple("n" if s == -1 else s for s in shape)
        raise DataError(f"{owner}.{name}: expected shape {wanted}, found {array.shape}")
    if finite and not np.isfinite(array).all():
        index = int(np.argwhere(~np.isfinite(array))[0, 0])
        raise DataError(f"{owner}.{name}: not finite at index {index}")
    huge = np.abs(array) > _LARGEST  # also where missing values may be NaN
    if huge.any():
        at = tuple(np.argwhere(huge)[0])
        raise DataError(f"{owner}.{name}: {array[at]:.3g} at index {at[0]}: no such quantity")
    array.flags.writeable = False
    return array


def ordered(owner: str, time: FloatArray, strictly: bool = True) -> None:
    """Refuse times that do not increase (strictly), naming the first bad index."""
    step = np.diff(time)
    bad = np.flatnonzero(step <= 0 if strictly else step < 0)
    if bad.size:
        k = int(bad[0]) + 1
        raise DataError(
            f"{owner}.time: goes backwards or repeats at index {k} "
            f"({time[k - 1]:.6f} s, then {time[k]:.6f} s)"
        )


def freeze(record: object, **arrays: object) -> None:
    """Set fields of a frozen record while it is made."""
    for name, value in arrays.items():
        object.__setattr__(record, name, value)


def span(time: FloatArray) -> str:
    """Return rate and length of a series in words: '100 Hz, 600.0 s'."""
    if time.size < 2:
        return f"at {time[0]:.3f} s" if time.size else "empty"
    return f"{1.0 / float(np.median(np.diff(time))):.4g} Hz, {time[-1] - time[0]:.1f} s"


def rows_of(record, rows: NDArray[np.bool_]):
    """Return a copy of `record` with the masked rows of every per-epoch array."""
    n = record.time.size
    values = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
    per_epoch = {
        name: value[rows]
        for name, value in values.items()
        if isinstance(value, np.ndarray)
        and value.ndim
        and value.shape[0] == n
        and name != "lever_b"
    }
    return dataclasses.replace(record, **per_epoch)
