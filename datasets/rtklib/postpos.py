"""RTKLIB's post-processing as a function: files and options in, positions out."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyrtklib5 as rtk

from ...filters.errors import DataError
from ...filters.rotation import FloatArray
from ..formats.rtklib_pos import read_pos
from ..observations import GnssFixes

NAVSYS = {
    "G": rtk.SYS_GPS, "R": rtk.SYS_GLO, "E": rtk.SYS_GAL, "C": rtk.SYS_CMP, "J": rtk.SYS_QZS
}  # fmt: skip
AMBIGUITIES = {
    "continuous": rtk.ARMODE_CONT, "hold": rtk.ARMODE_FIXHOLD, "off": rtk.ARMODE_OFF
}  # fmt: skip
DIRECTIONS = {"forward": 0, "backward": 1, "combined": 2}
#: RTKLIB's bound on the variance of a float position from which integers are looked for [m²]: 0.5 m
#: is 2.6 cycles of L1.
_GUARD_L1 = 0.25
#: With two frequencies the same 2.6 cycles are of the wide lane, 0.862 m.
_GUARD_WIDE = _GUARD_L1 * (0.862 / 0.190) ** 2


@dataclass(frozen=True, eq=False)
class Positions:
    """Positions of RTKLIB's post-processing in order of time.

    Attributes
    ----------
    fixes : GnssFixes
    ratio : ndarray, shape (n,)
        Of the second-best to the best integer ambiguities; 0 where none were looked for.
    age : ndarray, shape (n,)
        From the base's epoch to the rover's [s].
    """

    fixes: GnssFixes
    ratio: FloatArray
    age: FloatArray


def relative_options(
    elevation_mask: float,
    systems: str,
    frequencies: int,
    min_ratio: float,
    max_age: float,
    ambiguities: str,
    direction: str,
) -> Any:
    """Return RTKLIB's options: kinematic, broadcast orbits, no model of the motion.

    Without a motion model an epoch owes to the others its ambiguities only; the inertial filter
    downstream has a better model than RTKLIB's constant acceleration. For the parameters see
    `relative_positions`.
    """
    options = _copied(rtk.prcopt_t(), rtk.prcopt_default)
    options.mode, options.dynamics = rtk.PMODE_KINEMA, 0
    options.soltype = DIRECTIONS[direction]
    options.navsys = sum(NAVSYS[letter] for letter in systems)
    options.nf = frequencies
    options.elmin = elevation_mask
    options.sateph = rtk.EPHOPT_BRDC
    options.ionoopt, options.tropopt = rtk.IONOOPT_BRDC, rtk.TROPOPT_SAAS
    options.modear = AMBIGUITIES[ambiguities]
    options.thresar[0] = min_ratio
    options.thresar[1] = _GUARD_L1 if frequencies == 1 else _GUARD_WIDE
    options.maxtdiff = max_age
    options.glomodear = 0  # inter-channel biases between receivers of two makers
    options.bdsmodear = 1
    options.outsingle = 0
    options.refpos, options.rovpos = rtk.POSOPT_POS_XYZ, rtk.POSOPT_POS_XYZ
    return options


def single_options(elevation_mask: float) -> Any:
    """Return RTKLIB's options for single-point positions from broadcasts."""
    options = _copied(rtk.prcopt_t(), rtk.prcopt_default)
    options.mode = rtk.PMODE_SINGLE
    options.navsys = sum(NAVSYS.values())
    options.nf = 1
    options.elmin = elevation_mask
    options.ionoopt, options.tropopt = rtk.IONOOPT_BRDC, rtk.TROPOPT_SAAS
    return options


def _copied(target: Any, default: Any) -> Any:
    """Return `target` with the numbers of `default`, which is shared and must not be edited."""
    for name in dir(default):
        value = getattr(default, name)
        if name.startswith("_") or name == "ptr":
            continue
        if isinstance(value, int | float):
            setattr(target, name, value)
        elif name in ("err", "eratio", "std", "prn", "thresar", "maxinno", "sep"):
            array = getattr(target, name)
            for k in range(1 if name == "sep" else len(value)):
                array[k] = value[k]
    return target


def post_processed(
    scratch: Path,
    observations: list[list[Path]],
    navigation: list[Path],
    options: Any,
    interval: float = 0.0,
) -> Positions:
    """Run RTKLIB on copies in a folder: names with % and * would be patterns to it.

    Parameters
    ----------
    scratch : Path
    observations : list of list of Path
        The rover's files and, for relative positions, the base's; each receiver's are joined.
    navigation : list of Path
    options : prcopt_t
    interval : float
        Of every so many seconds one epoch [s]; 0: all.

    Raises
    ------
    DataError
        RTKLIB refuses the files.
    """
    names = []
    for receiver, files in zip(("rover", "base"), observations, strict=False):
        for k, file in enumerate(files):
            shutil.copyfile(file, scratch / f"{receiver}{k:04d}.obs")
        # One pattern, one receiver: RTKLIB takes every further name for another receiver.
        names.append(str(scratch / f"{receiver}*.obs"))
    for k, file in enumerate(navigation):
        shutil.copyfile(file, scratch / f"navigation{k:04d}.nav")
    names += [str(scratch / f"navigation{k:04d}.nav") for k in range(len(navigation))]
    out = scratch / "solution.pos"
    form = _copied(rtk.solopt_t(), rtk.solopt_default)
    form.posf, form.times, form.timef, form.timeu = rtk.SOLF_XYZ, rtk.TIMES_GPST, 0, 6
    form.outhead, form.sstat, form.trace = 1, 0, 0
    status = rtk.postpos(
        rtk.gtime_t(), rtk.gtime_t(), interval, 0.0, options, form, rtk.filopt_t(), names,
        len(names), str(out), "", "",
    )  # fmt: skip
    if status != 0 or not out.is_file():
        raise DataError(
            "RTKLIB gave up on these files",
            file=observations[0][0],
            remedy="run rnx2rtkp on them",
        )
    lines = out.read_text().splitlines()
    rows = sorted((line for line in lines if line.strip()[:1].isdigit()), key=_week_and_second)
    if not rows:
        none = np.empty((0, 3)), np.empty((0, 3, 3))
        count, quality = np.empty(0, dtype=np.int64), np.empty(0, dtype="U8")
        nothing = np.empty(0)
        return Positions(GnssFixes(nothing, *none, *none, count, quality), nothing, nothing)
    header = [line for line in lines if line.startswith("%")]
    out.write_text("\n".join([*header, *rows]) + "\n")  # backwards, the last comes first
    age, ratio = np.array([[float(v) for v in row.split()[13:15]] for row in rows]).T
    return Positions(read_pos(out), ratio, age)


def _week_and_second(row: str) -> tuple[int, float]:
    week, second = row.split()[:2]
    return int(week), float(second)
