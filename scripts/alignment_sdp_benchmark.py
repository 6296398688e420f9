"""Time the semidefinite relaxation: clarabel called directly against the same through cvxpy.

    python scripts/alignment_sdp_benchmark.py --runs 200 --json

Each problem is solved by both in turn, after a warm-up; their costs are compared as well. 1–8
satellites, planar and hilly motion, 0.1 m/s of noise or, with three satellites and more, none in
half of the windows (fewer leave the rotation undetermined without noise, and both solvers then
stop 1e-8 away). Differences of cost are relative to tr Q, which the tolerances refer to.
"""

from __future__ import annotations

import argparse
import json
import sys
import time

import numpy as np

from certnav.alignment.problem import build_problem
from certnav.alignment.reference.certifiable import align_sdp
from certnav.alignment.reference.sdp import solve_dual
from certnav.alignment.reference.sdp_cvxpy import solve_dual_cvxpy
from certnav.alignment.reference.simulation import simulate_window
from certnav.filters.errors import NavError


def measure(runs: int, seed: int) -> dict:
    """Return medians and 95th percentiles in milliseconds, and the largest difference in cost."""
    rng = np.random.default_rng(seed)
    times: dict[str, list[float]] = {"clarabel": [], "cvxpy": [], "align": []}
    differences = []
    for k in range(runs + 3):
        satellites = int(rng.integers(1, 9))
        sigma = 0.0 if satellites > 2 and k // 2 % 2 else 0.1
        window = simulate_window(rng, satellites, ("2d", "3d")[k % 2], sigma=sigma)
        problem = build_problem(window.rows)
        start = time.perf_counter()
        direct = solve_dual(problem.Q).dual_cost
        after_direct = time.perf_counter()
        layered = solve_dual_cvxpy(problem.Q)
        after_cvxpy = time.perf_counter()
        align_sdp(problem)
        after_align = time.perf_counter()
        if k < 3:  # imports and caches
            continue
        times["clarabel"].append(after_direct - start)
        times["cvxpy"].append(after_cvxpy - after_direct)
        times["align"].append(after_align - after_cvxpy)
        differences.append(abs(direct - layered) / np.trace(problem.Q))
    out: dict = {"runs": runs, "cost_difference_max": max(differences)}
    for name, spent in times.items():
        out[f"{name}_ms_median"] = 1e3 * float(np.median(spent))
        out[f"{name}_ms_p95"] = 1e3 * float(np.percentile(spent, 95))
    out["speed_up"] = out["cvxpy_ms_median"] / out["clarabel_ms_median"]
    return out


def main(arguments: list[str] | None = None) -> int:
    """Run the script; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs: expected at least 1, found {options.runs}")
    try:
        result = measure(options.runs, options.seed)
    except NavError as error:
        print(error, file=sys.stderr)
        return 1
    if options.json:
        print(json.dumps(result))
    else:
        print("\n".join(f"{name:>20}  {value:.4g}" for name, value in result.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
