"""Does a wrong attitude ever pass? Simulated windows, good and bad, judged by the verdict.

    python scripts/alignment_hazard.py [--runs 1000] [--seed 1] [--windows mixed|coherent]
        [--checkpoint FILE] [--jobs 1] [--json] [--scheduler ADDRESS]

*mixed*: 1 to 8 satellites, level, hilly or straight, 10 to 30 epochs, 0.01 to 1 m/s of noise, a
clock that is steady, drifts by up to 0.1 m/s² or wanders by up to 0.2 m/s/√s (known to be no
worse), and in half of the windows 5 to 60 % of outliers of five kinds. *coherent*: ten satellites,
of which 2 to 6 are wrong from the first epoch to the last, and agree with each other: reflected at
one facade, explained by the attitude turned about the vertical, or shifted together, by a constant
or along a walk. A result is hazardous if it passes and its error exceeds 30°, or its bound more
often than the bound's probability allows; `beyond_bound` counts the latter, `beyond_30_deg` the
former.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from certnav.alignment.problem import ClockModel
from certnav.alignment.reference.simulation import SimulatedWindow, simulate_window
from certnav.alignment.robust import align_robust
from certnav.alignment.rows import AlignmentRows
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.verdict import VerdictLimits
from certnav.filters.errors import AlignmentError
from certnav.nav.sweep.parallel import in_parallel

OUTLIERS = ("random", "moderate", "clustered", "satellite", "other attitude")
COHERENT = ("facade", "turned", "shifted", "walking")
WINDOWS = ("mixed", "coherent")
#: What the clock is known not to exceed [m/s/√s].
CLOCK_WALK = 0.2


def contaminate(
    rng: np.random.Generator, window: SimulatedWindow, kind: str, share: float
) -> AlignmentRows:
    """Rows of which a share is wrong."""
    rows, z = window.rows, window.rows.z.copy()
    k = len(z)
    wrong = rng.choice(k, round(share * k), replace=False)
    sign = rng.choice([-1.0, 1.0], wrong.size)
    if kind == "random":
        z[wrong] += sign * rng.uniform(10.0, 50.0, wrong.size)
    elif kind == "moderate":
        z[wrong] += sign * rng.uniform(1.0, 8.0, wrong.size)
    elif kind == "clustered":
        z[wrong] += 20.0 + 0.5 * rng.normal(size=wrong.size)
    elif kind == "satellite":
        satellites = int(np.sum(rows.epoch == rows.epoch[0]))
        for s in rng.choice(satellites, round(share * satellites), replace=False):
            z[s::satellites] += rng.choice([-1.0, 1.0]) * rng.uniform(1.0, 40.0)
    else:
        C = Rotation.random(rng=rng).as_matrix()
        z[wrong] += np.sum(rows.e_e * (rows.vel_w @ (C - window.C_ew).T), axis=1)[wrong]
    return replace(rows, z=z)


def conspire(
    rng: np.random.Generator, window: SimulatedWindow, kind: str, wrong: int
) -> AlignmentRows:
    """Rows of which those of `wrong` satellites agree with each other on something else."""
    rows, z = window.rows, window.rows.z.copy()
    epochs = rows.time.max() - rows.time.min() + 1.0
    satellites = int(np.sum(rows.epoch == rows.epoch[0]))
    those = np.isin(np.arange(len(z)) % satellites, rng.choice(satellites, wrong, replace=False))
    vel_e, across = rows.vel_w @ window.C_ew.T, np.cross(window.up_e, rng.normal(size=3))
    across /= np.linalg.norm(across)
    if kind == "facade":
        shown = vel_e - 2.0 * np.outer(vel_e @ across, across)
        z += those * np.sum(rows.e_e * (shown - vel_e), axis=1)
    elif kind == "turned":
        angle = rng.choice([-1.0, 1.0]) * np.radians(rng.uniform(5.0, 180.0))
        turn = Rotation.from_rotvec(angle * window.up_e).as_matrix()
        z += those * np.sum(rows.e_e * (vel_e @ (turn.T - np.eye(3))), axis=1)
    else:
        shift = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-0.5, 1.3)
        if kind == "walking":
            steps = rng.normal(size=int(epochs)) * 0.3 * shift
            shift = shift + np.cumsum(steps)[rows.epoch]
        z += those * shift
    return replace(rows, z=z)


def coherent(seed: int) -> tuple[str, bool, bool, bool, float, float, tuple[str, ...]]:
    """One of the windows with coherently wrong satellites; as `one`."""
    rng = np.random.default_rng(seed)
    wrong, kind = int(rng.integers(2, 7)), str(rng.choice(COHERENT))
    window = simulate_window(
        rng, 10, str(rng.choice(["2d", "3d"])), epochs=int(rng.integers(10, 31)),
        speed=float(np.exp(rng.uniform(np.log(3.0), np.log(20.0)))),
        sigma=float(10.0 ** rng.uniform(-2.0, -0.3)),
        clock_walk=float(rng.uniform(0.0, CLOCK_WALK)),
    )  # fmt: skip
    return judged(f"{wrong} of 10, {kind}", window, conspire(rng, window, kind, wrong), True)


def one(seed: int) -> tuple[str, bool, bool, bool, float, float, tuple[str, ...]]:
    """Kind, observable?, passed?, contaminated?, error and bound [rad], failed verdicts."""
    rng = np.random.default_rng(seed)
    satellites = int(rng.integers(1, 9))
    motion = str(rng.choice(["2d", "3d", "line"], p=[0.45, 0.45, 0.1]))
    clock = str(rng.choice(["steady", "rate", "walk"]))
    window = simulate_window(
        rng, satellites, motion, epochs=int(rng.integers(10, 31)),
        speed=float(np.exp(rng.uniform(np.log(3.0), np.log(20.0)))),
        sigma=float(10.0 ** rng.uniform(-2.0, 0.0)),
        clock_rate=float(rng.uniform(-0.1, 0.1)) if clock == "rate" else 0.0,
        clock_walk=float(rng.uniform(0.0, CLOCK_WALK)) if clock == "walk" else 0.0,
    )  # fmt: skip
    rows, kind = window.rows, "none"
    if rng.random() < 0.5:
        kind = str(rng.choice(OUTLIERS))
        rows = contaminate(rng, window, kind, float(rng.uniform(0.05, 0.6)))
    return judged(f"{satellites} satellites", window, rows, kind != "none")


def judged(
    label: str, window: SimulatedWindow, rows: AlignmentRows, bad: bool
) -> tuple[str, bool, bool, bool, float, float, tuple[str, ...]]:
    """What the robust method says about these rows."""
    try:
        found = align_robust(rows, ClockModel("random-walk", CLOCK_WALK))
    except AlignmentError:
        return label, False, False, bad, np.nan, np.pi, ("rows",)
    result = found.result
    error = float(rotation_angle(result.C_ew, window.C_ew))
    failed = tuple(str(verdict.name) for verdict in result.failed)
    return label, bool(result.bound < np.pi), bool(found.passed), bad, error, result.bound, failed


def several(seeds: range, windows: str = "mixed") -> list:
    """What one process does at a time: starting a run costs more than the run."""
    return [(one if windows == "mixed" else coherent)(seed) for seed in seeds]


def outcomes_of(
    runs: int, seed: int, jobs: int, windows: str, scheduler: str | None, checkpoint: Path | None
) -> Iterator[tuple]:
    """Yield every window's outcome; those a checkpoint has are not run again."""
    known: dict[int, list] = {}
    if checkpoint is not None and checkpoint.exists():
        for line in checkpoint.read_text().splitlines():
            begin, portion = json.loads(line)
            known[begin] = portion
    seeds = range(seed * 10_000_000, seed * 10_000_000 + runs)
    portions = [(seeds[k : k + 64], windows) for k in range(0, runs, 64)]
    for portion in portions:
        yield from map(tuple, known.get(portion[0][0], []))
    left = [portion for portion in portions if portion[0][0] not in known]
    for portion, found in zip(
        left, in_parallel(several, left, jobs=jobs, scheduler=scheduler), strict=True
    ):
        if checkpoint is not None:
            with checkpoint.open("a") as file:
                file.write(json.dumps([portion[0][0], found]) + "\n")
        yield from found


def figures_of(outcomes: list[tuple]) -> dict:
    """All figures."""
    passed = [o for o in outcomes if o[2]]
    beyond = sum(bool(error > bound) for *_, error, bound, _ in passed)
    far = sum(bool(error > np.radians(30.0)) for *_, error, _, _ in passed)
    # Beyond the bound at no more than the rate it allows, with 99.9 % confidence.
    allowed = int(binom.ppf(0.999, len(passed), 1.0 - VerdictLimits().probability)) if passed else 0
    tried, good = Counter(o[0] for o in outcomes), Counter(o[0] for o in passed)
    clean = [o for o in outcomes if not o[3]]
    return {
        "runs": len(outcomes),
        "passed": len(passed),
        "hazardous": far + max(beyond - allowed, 0),
        "availability": len(passed) / max(len(outcomes), 1),
        "beyond_bound": beyond,
        "beyond_bound_allowed": allowed,
        "beyond_30_deg": far,
        "worst_error_deg": round(float(np.degrees(max((o[4] for o in passed), default=0.0))), 2),
        "availability_without_outliers": sum(o[2] for o in clean) / max(len(clean), 1),
        "availability_by": {k: round(good[k] / tried[k], 4) for k in sorted(tried)},
        "beyond_bound_by": dict(Counter(o[0] for o in passed if o[4] > o[5]).most_common()),
        "failed": dict(Counter(name for o in outcomes for name in o[6]).most_common()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--windows", choices=WINDOWS, default="mixed", help="[mixed]")
    parser.add_argument(
        "--checkpoint", type=Path, metavar="FILE", help="outcomes so far; continued if it exists"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes, −1: all processors")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler to spread over")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    outcomes = outcomes_of(
        arguments.runs, arguments.seed, arguments.jobs, arguments.windows, arguments.scheduler,
        arguments.checkpoint,
    )  # fmt: skip
    figures = figures_of(list(outcomes))
    if arguments.json:
        print(json.dumps(figures))
        return
    for name, value in figures.items():
        print(f"{name:32} {value}")


if __name__ == "__main__":
    main()
