"""A receiver that repeats its last fix, as many do in tunnels: what that does to a run.

    python scripts/held_fixes.py [--seconds 3,10,30] [--every 60]

The rtklibexplorer drive (4 Hz) with its fix and velocity repeated for so many seconds, again and
again, against the same drive without any fixes in the same spells. Errors are against the recorded
positions, at worst within the spells and five seconds after them.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
from pathlib import Path

import numpy as np

from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.filters.earth import C_en_of
from certnav.nav.config import Config
from certnav.nav.evaluation.interpolation import covered, interpolate
from certnav.nav.pipeline import navigate

#: Before the first spell [s].
_SETTLE = 60.0


def spells(sequence: Sequence, seconds: float, every: float) -> np.ndarray:
    """Return begin and end of each, where the car moves, shape (k, 2) [s]."""
    assert sequence.fixes is not None
    begin = np.arange(sequence.fixes.time[0] + _SETTLE, sequence.fixes.time[-1] - seconds, every)
    speed = np.linalg.norm(sequence.fixes.vel_e, axis=1)
    moves = [speed[np.argmin(np.abs(sequence.fixes.time - t))] > 3.0 for t in begin]
    return np.column_stack([begin, begin + seconds])[moves]


def held(sequence: Sequence, where: np.ndarray) -> Sequence:
    """Return the drive with the last fix before each spell repeated through it."""
    fixes = sequence.fixes
    assert fixes is not None
    pos_e, vel_e = fixes.pos_e.copy(), fixes.vel_e.copy()
    for begin, end in where:
        rows = (fixes.time > begin) & (fixes.time <= end)
        last = int(np.argmax(rows)) - 1
        pos_e[rows], vel_e[rows] = pos_e[last], vel_e[last]
    return dataclasses.replace(sequence, fixes=dataclasses.replace(fixes, pos_e=pos_e, vel_e=vel_e))


def without(sequence: Sequence, where: np.ndarray) -> Sequence:
    """Return the drive without fixes in the spells."""
    assert sequence.fixes is not None
    time = sequence.fixes.time
    gone = np.any((time[:, None] > where[:, 0]) & (time[:, None] <= where[:, 1]), axis=1)
    return dataclasses.replace(sequence, fixes=sequence.fixes.take(~gone))


def errors(sequence: Sequence, changed: Sequence, where: np.ndarray) -> tuple[float, float, str]:
    """Return the worst horizontal error in the spells and 5 s after them [m], and the status."""
    solution, fixes = navigate(changed, Config()), sequence.fixes
    assert fixes is not None
    keep = covered(solution.trajectory.time, fixes.time, 1.0)
    time = fixes.time[keep]
    at = interpolate(solution.trajectory, time)
    antenna_e = at.pos_e + at.C_eb @ sequence.calibration.lever_antenna_b
    C_ne = np.swapaxes(C_en_of(fixes.pos_e[keep]), 1, 2)
    off = np.einsum("nij,nj->ni", C_ne, antenna_e - fixes.pos_e[keep])
    horizontal = np.hypot(off[:, 0], off[:, 1])
    inside = np.any((time[:, None] > where[:, 0]) & (time[:, None] <= where[:, 1]), axis=1)
    back = [horizontal[np.argmin(np.abs(time - (end + 5.0)))] for _, end in where]
    return float(horizontal[inside].max()), float(max(back)), solution.status


def main() -> None:
    """Print a row a length of the spells."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seconds", default="3,10,30")
    parser.add_argument("--every", type=float, default=60.0, metavar="S")
    arguments = parser.parse_args()
    data = Path(os.environ.get("CERTNAV_DATA", "../shared/data"))
    sequence = load(data / "rtklibexplorer-drive")
    print(
        "| held | spells | worst in them | 5 s after | status | without fixes: worst | 5 s after |"
    )
    print("|---|---|---|---|---|---|---|")
    for seconds in map(float, arguments.seconds.split(",")):
        where = spells(sequence, seconds, arguments.every)
        a, b = (errors(sequence, f(sequence, where), where) for f in (held, without))
        print(
            f"| {seconds:g} s | {len(where)} | {a[0]:.2f} m | {a[1]:.2f} m | {a[2]} | {b[0]:.2f} m "
            f"| {b[1]:.2f} m |"
        )


if __name__ == "__main__":
    main()
