"""How runs start, and how sure of it they are: every drive, started again and again.

    python scripts/starts.py [--seeds 100:116] [--every 20] [--duration 150] [--only simulated,real]

simulated   urban, canyon and suburb drives with single-point positions and Doppler, from rest, in
            motion, and reversing (the drive with its IMU, and the mounting that is declared, turned
            by half a turn: the course points over the boot)
real        every recording with a reference heading, started every so many seconds

A start is *right* if its heading is within 3σ of the truth, or within 5°; *waiting* if there was
none before the data ended; *wrong and said* if it is neither but the run ended 'lost' or
'restarted' or its message or notes doubt it; *wrong and sure* otherwise. The last must not occur.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.filters.earth import C_en_of
from certnav.filters.errors import NavError
from certnav.filters.rotation import rpy_from_matrix, wrap_angle
from certnav.nav.config import Config
from certnav.nav.pipeline import navigate
from oracles.imu_breaks import turned

#: Error that is no matter for a start, however sure it is [deg].
_FINE = 5.0
#: Recordings whose reference has a heading, and its own error [deg].
REAL = {
    "comma2k19-example1": 2.0,
    "oakville-drives/urban-long-turn-loop-nominal-001": 3.0,
    "oakville-drives/urban-medium-turn-loop-nominal-001": 3.0,
    "instinct/spirent_dynamic": 0.5,
}
VERDICTS = ("right", "waiting", "wrong and said", "wrong and sure")


def judged(sequence: Sequence, own: float) -> tuple[str, float, float]:
    """Return the verdict on a start, its heading error and its 1σ [deg]; `own` of the reference."""
    try:
        solution = navigate(sequence, Config())
    except NavError:
        return "waiting", float("nan"), float("nan")
    reference, found = sequence.reference, solution.trajectory
    assert reference is not None
    at = int(np.searchsorted(reference.time, found.time[0]))
    if at >= reference.time.size or not np.isfinite(reference.rpy[at, 2]):
        return "waiting", float("nan"), float("nan")
    k = int(np.argmin(np.abs(found.time - reference.time[at])))
    C_nb = C_en_of(found.pos_e[k]).T @ found.C_eb[k]
    if reference.attitude_frame == "v":
        C_nb = C_nb @ sequence.calibration.C_bv
    error = float(np.degrees(abs(wrap_angle(rpy_from_matrix(C_nb)[2] - reference.rpy[at, 2]))))
    sigma = float(np.degrees(solution.alignment.sigma_heading))
    if error <= max(_FINE, 3.0 * np.hypot(sigma, own)):
        return "right", error, sigma
    doubts = ("not decided", "do not bear out")
    said = solution.status in ("lost", "restarted")
    said |= any(doubt in solution.alignment.message for doubt in doubts)
    return ("wrong and said" if said else "wrong and sure"), error, sigma


def simulated(seeds: range, duration: float, scratch: Path) -> Iterator[tuple[str, Sequence]]:
    """Yield the simulated drives by what is started."""
    for density in ("urban", "canyon", "suburb"):
        for seed in seeds:
            for moving in (False, True):
                folder = scratch / f"{density}-{seed}-{moving}"
                simulate_folder(
                    SimulationConfig(
                        name=folder.name, seed=seed, duration=duration, density=density,
                        moving_start=moving,
                    ),
                    folder,
                )  # fmt: skip
                sequence = load(folder)
                yield f"{density}, {'in motion' if moving else 'from rest'}", sequence
                if not moving:
                    yield f"{density}, reversing", turned(sequence, sequence.span[0])


def real(every: float, data: Path) -> Iterator[tuple[str, Sequence, float]]:
    """Yield every recording from so many seconds on, a minute and a half at a time."""
    for name, own in REAL.items():
        sequence = load(data / name)
        first, last = sequence.span
        for begin in np.arange(first, last - 30.0, every):
            part = sequence.between(float(begin), float(min(begin + 90.0, last)))
            yield name.split("/")[-1], part, own


def main() -> None:
    """Print a row a kind of start, and the worst."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", default="100:116", help="FROM:TO, TO excluded [100:116]")
    parser.add_argument("--every", type=float, default=20.0, metavar="S", help="[20 s]")
    parser.add_argument("--duration", type=float, default=150.0, metavar="S", help="[150 s]")
    parser.add_argument("--only", default="simulated,real", help="[simulated,real]")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    seeds = range(*map(int, arguments.seeds.split(":")))
    counts: dict[str, Counter[str]] = {}
    worst: dict[str, float] = {}
    wrong = []

    def count(kind: str, name: str, found: tuple[str, float, float]) -> None:
        verdict, error, sigma = found
        counts.setdefault(kind, Counter())[verdict] += 1
        if np.isfinite(error):
            worst[kind] = max(worst.get(kind, 0.0), error)
        if verdict.startswith("wrong"):
            wrong.append(f"{name}: {verdict}, {error:.1f}° with σ {sigma:.1f}°")

    with tempfile.TemporaryDirectory() as scratch:
        if "simulated" in arguments.only:
            for kind, sequence in simulated(seeds, arguments.duration, Path(scratch)):
                count(kind, f"{kind} {sequence.name}", judged(sequence, 0.0))
        if "real" in arguments.only:
            data = Path(os.environ.get("CERTNAV_DATA", "../shared/data"))
            for kind, sequence, own in real(arguments.every, data):
                begin = sequence.inertial.time[0]
                count(kind, f"{kind} from {begin:.0f} s", judged(sequence, own))
    if arguments.json:
        print(json.dumps({"counts": counts, "worst_deg": worst, "wrong": wrong}))
        return
    print("| start | " + " | ".join(VERDICTS) + " | largest error [deg] |")
    print("|---|" + "---|" * (len(VERDICTS) + 1))
    for kind, found in counts.items():
        cells = " | ".join(str(found[verdict]) for verdict in VERDICTS)
        print(f"| {kind} | {cells} | {worst.get(kind, float('nan')):.1f} |")
    for line in wrong:
        print(line)


if __name__ == "__main__":
    main()
