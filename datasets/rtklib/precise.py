"""Precise ephemerides: a recording's satellite states from SP3 orbits and clock files.

    observations, note = precise_observations(observations, ["igs21771.sp3", "igs21771.clk"])

They take the place of the broadcast states, for Doppler and velocities; broadcast ones stay where
the products have none, and so does what the broadcast says of health. Positions keep the broadcast
ephemerides altogether: an SP3 file has the satellite's centre of mass, metres from the antenna that
sends, and without a file of antennas the code would be wrong by more than a broadcast orbit is.
"""

from __future__ import annotations

import dataclasses
import math
import re
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyrtklib5 as rtk

from ...filters.earth import SPEED_OF_LIGHT
from ...filters.errors import DataError
from ..observations import GnssObservations
from ..text.rinex_repair import without_mark
from .satellites import GPS_EPOCH_GTIME, broadcast_states

#: RTKLIB interpolates positions over eleven epochs.
_EPOCHS = 11
#: Broadcast orbits are metres off, their clock rates millimetres a second. So much apart, one of
#: both is of another day or damaged [m], [m/s].
_APART, _APART_RATE = 200.0, 0.5
_EPOCH, _POSITION = re.compile(r"\*\s+\d{4}"), re.compile(r"P[A-Z ]\s*\d+")


def precise_observations(
    observations: GnssObservations, files: Sequence[str | Path]
) -> tuple[GnssObservations, str]:
    """Return the observations with satellite states of precise products, and what was replaced.

    Parameters
    ----------
    observations : GnssObservations
        With broadcast states.
    files : sequence of path
        SP3 orbits (a, c or d), one or more, and RINEX clock files, which are optional: an SP3 file
        has clocks, too, but fewer.

    Raises
    ------
    DataError
        A file that is neither, damaged, of another time, or far from the broadcast orbits.
    """
    nav, names = _loaded([Path(file) for file in files])
    number = np.array([rtk.satid2no(str(sat)) for sat in observations.sat], dtype=np.int64)
    travel = observations.pseudorange / SPEED_OF_LIGHT
    whole = np.floor(observations.time)
    states = broadcast_states(
        nav, number, whole + GPS_EPOCH_GTIME, observations.time - whole - travel,
        by_satellite_clock=True, precise=True,
    )  # fmt: skip
    # RTKLIB has exactly no clock where the products have none.
    known = np.isfinite(states.pos_e).all(1) & (states.clock != 0.0)
    if not known.any():
        raise DataError(
            "precise ephemerides of none of the satellites at the time of the observations "
            f"({names})",
            file=files[0],
            remedy="wrong day, or fewer than eleven epochs around the drive",
        )
    both = known & np.isfinite(observations.sat_pos_e).all(1)
    apart = np.linalg.norm(states.pos_e - observations.sat_pos_e, axis=1)[both]
    rates = np.abs(states.clock_drift - observations.sat_clock_drift)[both]
    if both.any() and (np.median(apart) > _APART or np.nanmedian(rates) > _APART_RATE):
        raise DataError(
            f"precise orbits lie {np.median(apart):.3g} m from the broadcast ones, their clocks "
            f"run {np.nanmedian(rates):.2g} m/s apart ({names})",
            file=files[0],
            remedy="of another day, or damaged",
        )
    replaced = dataclasses.replace(
        observations,
        sat_pos_e=np.where(known[:, None], states.pos_e, observations.sat_pos_e),
        sat_vel_e=np.where(known[:, None], states.vel_e, observations.sat_vel_e),
        sat_clock=np.where(known, states.clock, observations.sat_clock),
        sat_clock_drift=np.where(known, states.clock_drift, observations.sat_clock_drift),
    )
    share = f"{int(known.sum())} of {known.size} rows"
    return replaced, f"satellites from precise ephemerides ({names}) in {share}, else broadcast"


def _loaded(files: list[Path]) -> tuple[Any, str]:
    """Return RTKLIB's nav_t of the products, and the files' names."""
    nav = rtk.nav_t()
    for file in files:
        if not file.is_file():
            raise DataError("no such file", file=file, remedy="check data.precise")
        head = without_mark(file.read_bytes()[:200]).decode("ascii", "replace")
        with tempfile.TemporaryDirectory(prefix="certnav-") as folder:
            if head.startswith(("#a", "#b", "#c", "#d")):
                _check_sp3(file)
                rtk.readsp3(str(_named(file, Path(folder) / "file.sp3")), nav, 0)
            elif head[20:21] == "C":
                before = nav.nc
                rtk.readrnxc(str(_named(file, Path(folder) / "file.clk")), nav)
                if nav.nc == before:
                    raise DataError("no clocks found", file=file, remedy="the file may be cut off")
            else:
                raise DataError(
                    "expected SP3 orbits or RINEX clocks", file=file, line=1,
                    remedy="broadcast ephemerides stay where they are: name products alone",
                )  # fmt: skip
    if not nav.ne:
        raise DataError("no orbits: clocks alone are no ephemerides", file=files[0],
                        remedy="name an SP3 file, too")  # fmt: skip
    return nav, ", ".join(file.name for file in files)


def _named(file: Path, other: Path) -> Path:
    """Return the file by a name whose ending RTKLIB goes by."""
    try:
        other.symlink_to(file.resolve())
    except OSError:  # no links on this file system
        shutil.copyfile(file, other)
    return other


def _check_sp3(file: Path) -> None:
    """Refuse an SP3 file with too few epochs, or positions that are missing or no numbers.

    RTKLIB counts lines: one that is missing makes it lose the epoch after it.
    """
    lines = file.read_text(encoding="ascii", errors="replace").splitlines()
    begins = [k for k, line in enumerate(lines) if _EPOCH.match(line)]
    counts = [
        sum(_POSITION.match(line) is not None for line in lines[begin:end])
        for begin, end in zip(begins, [*begins[1:], len(lines)], strict=True)
    ]
    for begin, count in zip(begins, counts, strict=True):
        if count != counts[0]:
            raise DataError(
                f"expected {counts[0]} satellites as in the first epoch, found {count}",
                file=file, line=begin + 1, remedy="the file is damaged: copy it again",
            )  # fmt: skip
    for number, line in enumerate(lines, 1):
        if _POSITION.match(line):
            cells = [line[k : k + 14].strip() for k in (4, 18, 32, 46)]
            try:
                fine = all(math.isfinite(float(cell)) for cell in cells)
            except ValueError:
                fine = False
            if not fine:
                raise DataError(
                    f"expected X, Y, Z and clock of a satellite, found '{line[:60]}'",
                    file=file, line=number, remedy="the file is damaged: copy it again",
                )  # fmt: skip
    if len(begins) < _EPOCHS:
        raise DataError(f"expected {_EPOCHS} epochs or more, found {len(begins)}", file=file,
                        remedy="name the file of the whole day")  # fmt: skip
