"""Time and agreement of the alignment solvers on simulated windows.

    python scripts/alignment_benchmark.py [--runs 1000] [--seed 1] [--against FOLDER] [--json]

Windows of ten epochs, 2 to 8 satellites in level circles and over hills, 0.01 to 1 m/s of noise
or none (one in ten). 'certified' counts the windows that are observable; 'agreement' is the share
in which the fast solver's cost equals the SDP's to 1e-9 of the scale and, where both prove the
optimum unique, the attitude to 1e-5°. 'verdict_us' is from rows to verdict (`certnav.align`), 60
rows under a random-walk clock; with another checkout, `git worktree add FOLDER COMMIT`, that is
measured there too, by turns, and the ratio given.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from certnav.alignment.observability import observability
from certnav.alignment.problem import build_problem
from certnav.alignment.reference.certifiable import certified_minimum
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.solver.fast_solver import fast_minimum
from certnav.alignment.solver.quartic import Z
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.status import AlignmentStatus
from certnav.filters.errors import ConfigError

CVXPY_RUNS = 20
#: Processes by turns, each the median over windows of the best of several.
TURNS = 5
FROM_ROWS = """
import time
import numpy as np
from certnav.alignment.problem import ClockModel
from certnav.alignment.reference.simulation import simulate_window
from certnav.alignment.verdict import align
rng, clock = np.random.default_rng(0), ClockModel("random-walk", 0.1)
windows = [simulate_window(rng, 6, "3d", sigma=0.05, clock_walk=0.1).rows for _ in range(40)]
best = np.full(len(windows), np.inf)
for _ in range(15):
    for k, rows in enumerate(windows):
        start = time.perf_counter()
        align(rows, clock)
        best[k] = min(best[k], time.perf_counter() - start)
print(1e6 * float(np.median(best)))
"""


def from_rows_us(against: Path | None) -> dict[str, float]:
    """Time from rows to verdict here and in another checkout, by turns [µs]."""
    folders = {"verdict_us": Path(__file__).resolve().parents[1]}
    if against is not None:
        folders["verdict_before_us"] = against.resolve()
    found: dict[str, list[float]] = {name: [] for name in folders}
    with tempfile.TemporaryDirectory() as place:
        for name, folder in folders.items():
            (Path(place) / name).mkdir()
            (Path(place) / name / "certnav").symlink_to(folder)
        for name in [*folders] * TURNS:
            paths = {"PYTHONPATH": str(Path(place) / name), "OPENBLAS_NUM_THREADS": "1"}
            command = [sys.executable, "-c", FROM_ROWS]
            said = subprocess.run(
                command, env=os.environ | paths, capture_output=True, text=True, check=True
            )
            found[name].append(float(said.stdout))
    out = {name: round(min(times), 1) for name, times in found.items()}
    if against is not None:
        out["verdict_ratio"] = round(out["verdict_before_us"] / out["verdict_us"], 2)
    return out


def problems(runs: int, seed: int) -> list[np.ndarray]:
    """Cost matrices of simulated windows."""
    rng = np.random.default_rng(seed)
    out = []
    for k in range(runs):
        satellites, motion = int(rng.integers(2, 9)), "2d" if k % 2 else "3d"
        sigma = 0.0 if k % 10 == 0 else float(10.0 ** rng.uniform(-2.0, 0.0))
        out.append(build_problem(simulate_window(rng, satellites, motion, sigma=sigma).rows).Q)
    return out


def timed(function, matrices: list[np.ndarray], repeat: int) -> tuple[list, np.ndarray]:
    """Results, and the best of `repeat` times of each call [s]: other processes cost time too."""
    function(matrices[0])
    results, times = [], np.empty(len(matrices))
    for k, Q in enumerate(matrices):
        best = np.inf
        for _ in range(repeat):
            start = time.perf_counter()
            result = function(Q)
            best = min(best, time.perf_counter() - start)
        results.append(result)
        times[k] = best
    return results, times


def quantiles_us(times: np.ndarray) -> dict[str, float]:
    p50, p99, p999 = 1e6 * np.percentile(times, [50.0, 99.0, 99.9])
    return {
        "mean": round(1e6 * float(times.mean()), 1),
        "p50": round(float(p50), 1),
        "p99": round(float(p99), 1),
        "p999": round(float(p999), 1),
    }


def choi_lam() -> np.ndarray:
    """A nonnegative quartic that is no sum of squares: the relaxation has a gap."""
    G = np.diag([1.0, 0, 0, 0, 0, 0, 0, 0.5, 0.5, 0.5])
    for a, b in ((1, 9), (2, 8), (3, 7)):
        G[a, b] = G[b, a] = -1.0 / 3.0
    return Z @ G @ Z.T / 16.0


def cvxpy_ms(matrices: list[np.ndarray]) -> float | None:
    """Median time of the modelling layer's SDP [ms]; None where it is not installed."""
    from certnav.alignment.reference.sdp_cvxpy import solve_dual_cvxpy

    try:
        _, times = timed(solve_dual_cvxpy, matrices[:CVXPY_RUNS], 1)
    except ConfigError:
        return None
    return round(1e3 * float(np.median(times)), 2)


def run(runs: int, seed: int, against: Path | None = None) -> dict:
    """All figures."""
    matrices = problems(runs, seed)
    fast, fast_times = timed(lambda Q: fast_minimum(Q, backend="numba"), matrices, 3)
    plain, plain_times = timed(lambda Q: fast_minimum(Q, backend="numpy"), matrices, 3)
    sdp, sdp_times = timed(certified_minimum, matrices, 1)
    agree, same = [], []
    for one, two, reference in zip(fast, plain, sdp, strict=True):
        ok = abs(one.cost - reference.cost) <= 1e-9 * one.scale
        # Where t is at the limit of the arithmetic, so is the attitude.
        firm = one.uniqueness > 1e-9 * one.scale
        if firm and one.status is reference.status is AlignmentStatus.CERTIFIED:
            ok &= bool(rotation_angle(one.C, reference.C) < np.radians(1e-5))
        agree.append(ok)
        near = rotation_angle(one.C, two.C) < 1e-7 or not firm
        same.append(abs(one.cost - two.cost) <= 1e-12 * one.scale and near)
    seen = [observability(Q).geometry.determined for Q in matrices]
    proved = np.array([m.status is AlignmentStatus.CERTIFIED for m in fast])
    return {
        "runs": runs,
        **from_rows_us(against),
        "solver_us": quantiles_us(fast_times),
        "numpy_us": quantiles_us(plain_times),
        "sdp_ms": round(1e3 * float(np.median(sdp_times)), 2),
        "cvxpy_ms": cvxpy_ms(matrices),
        "certified": float(np.mean(proved[seen])),
        "observable": int(np.sum(seen)),
        "agreement": float(np.mean(agree)),
        "numba_equals_numpy": float(np.mean(same)),
        "choi_lam_refused": fast_minimum(choi_lam()).status is AlignmentStatus.NOT_TIGHT,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--against", type=Path, metavar="FOLDER", help="checkout to compare with")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    figures = run(arguments.runs, arguments.seed, arguments.against)
    if arguments.json:
        print(json.dumps(figures))
        return
    for name, value in figures.items():
        print(f"{name:20} {value}")


if __name__ == "__main__":
    main()
