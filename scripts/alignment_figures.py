"""Reproduce Figs. 3–7 of "Certifiable Alignment of GNSS and Local Frames via Lagrangian Duality".

    python scripts/alignment_figures.py --figure 3 --runs 200 --json --out figure3.png

- 3, 4: certified rate against the number of satellites, planar (3) and hilly (4) motion, with the
  relaxation of CᵀC = I alone ('none' redundant), with CCᵀ = I added ('orthogonal'), and with
  handedness as well ('all'). Noise-free windows. 'certified' is the paper's test, two smallest
  eigenvalues of the solver's H below 1e-6; 'proved' is the certificate made anew after refinement.
- 5, 6: error against Doppler noise for the certifiable method, Gauss–Newton from the identity and
  VOBA, planar (5) and hilly (6) motion.
- 7: where Gauss–Newton ends, over starts whose first axis points anywhere on the sphere, with two
  satellites: in the first of twenty windows that has several minima (how many do is printed along).
  The centre of the map is the certified optimum.

Same numbers for the same --runs and --seed. Progress goes to stderr.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import sys
from pathlib import Path

import numpy as np

from certnav.alignment.problem import AlignmentProblem, build_problem
from certnav.alignment.proofs.certificate import PAPER_RATIO, eigenvalue_ratio
from certnav.alignment.reference.baselines import gauss_newton, voba
from certnav.alignment.reference.certifiable import align_sdp
from certnav.alignment.reference.simulation import SimulatedWindow, simulate_window
from certnav.alignment.result import AlignmentResult
from certnav.alignment.solver.constraints import ALL
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.status import AlignmentStatus
from certnav.filters.errors import AlignmentError, NavError
from certnav.filters.rotation import FloatArray, matrix_from_rpy

FAMILIES = {"none": ("columns",), "orthogonal": ("columns", "rows"), "all": ALL}
MOTION = {3: "2d", 4: "3d", 5: "2d", 6: "3d", 7: "3d"}
NOISE = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)  # [m/s]
NOISE_SATELLITES = {"2d": (3, 4, 8), "3d": (2, 4, 8)}
METHODS = ("sdp", "gauss-newton", "voba")
WINDOWS = 20  # looked through for figure 7
#: Colours that colour-blind readers tell apart (Okabe and Ito).
BLUE, ORANGE, GREEN, VERMILION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
COLOURS = {
    "none": VERMILION, "orthogonal": ORANGE, "all": BLUE,
    "sdp": BLUE, "gauss-newton": ORANGE, "voba": GREEN,
}  # fmt: skip
MARKERS = {"none": "v", "orthogonal": "s", "all": "o", "sdp": "o", "gauss-newton": "s", "voba": "^"}


def certified_rates(motion: str, runs: int, seed: int) -> list[dict]:
    """Return Figs. 3 and 4: one row per number of satellites and set of constraints."""
    rows = []
    for satellites in range(1, 9):
        rng = np.random.default_rng([seed, satellites])
        windows = [simulate_window(rng, satellites, motion) for _ in range(runs)]
        for name, families in FAMILIES.items():
            results = [align_sdp(build_problem(w.rows), families=families) for w in windows]
            errors = [
                float(np.degrees(rotation_angle(r.C_ew, w.C_ew)))
                for r, w in zip(results, windows, strict=True)
            ]
            rows.append({"satellites": satellites, "constraints": name, "motion": motion})
            rows[-1] |= _rates(results, errors)
        _progress(f"{motion}: {satellites} satellites")
    return rows


def _rates(results: list[AlignmentResult], errors: list[float]) -> dict:
    ratios = [eigenvalue_ratio(np.linalg.eigvalsh(r.minimum.dual.H)) for r in results]
    proved = [r.minimum.status is AlignmentStatus.CERTIFIED for r in results]
    determined = [r.observability.geometry.determined for r in results]
    gaps = [
        r.minimum.gap / r.minimum.scale for r, ok in zip(results, determined, strict=True) if ok
    ]
    good = [e for e, ok in zip(errors, determined, strict=True) if ok]
    return {
        "certified": float(np.mean(np.array(ratios) < PAPER_RATIO)),
        "proved": float(np.mean(proved)),
        "observable": float(np.mean(determined)),
        "eigenvalue_ratio_median": float(np.median(ratios)),
        "relative_gap_max": max(gaps, default=None),
        "error_deg_median": float(np.median(errors)),
        "error_deg_max_where_observable": max(map(float, good), default=None),
        "runs": len(results),
    }


def errors_against_noise(motion: str, runs: int, seed: int) -> list[dict]:
    """Return Figs. 5 and 6: one row per number of satellites, noise and method."""
    rows = []
    for satellites in NOISE_SATELLITES[motion]:
        for sigma in NOISE:
            rng = np.random.default_rng([seed, satellites])  # the same geometries at every σ
            errors: dict[str, list[float]] = {method: [] for method in METHODS}
            proved = 0
            for _ in range(runs):
                window = simulate_window(rng, satellites, motion, sigma=sigma)
                problem = build_problem(window.rows)
                result = align_sdp(problem)
                proved += result.minimum.status is AlignmentStatus.CERTIFIED
                found = {"sdp": result.C_ew, "gauss-newton": gauss_newton(problem).C_ew}
                with contextlib.suppress(AlignmentError):  # under four satellites: not solved
                    found["voba"] = voba(window.rows).C_ew
                for method, C_ew in found.items():
                    errors[method].append(float(np.degrees(rotation_angle(C_ew, window.C_ew))))
            for method in METHODS:
                row = {"satellites": satellites, "motion": motion, "sigma_mps": sigma}
                row |= {"method": method, "runs": runs} | _statistics(errors[method], runs)
                rows.append(row | ({"proved": proved / runs} if method == "sdp" else {}))
            _progress(f"{motion}: {satellites} satellites, {sigma} m/s")
    return rows


def _statistics(errors: list[float], runs: int) -> dict:
    if not errors:
        return {"solved": 0.0, "median_deg": None, "p95_deg": None, "max_deg": None, "wrong": None}
    return {
        "solved": len(errors) / runs,
        "median_deg": float(np.median(errors)),
        "p95_deg": float(np.percentile(errors, 95)),
        "max_deg": max(errors),
        "wrong": float(np.mean(np.array(errors) > 30.0)),
    }


def basins(runs: int, seed: int) -> tuple[list[dict], dict]:
    """Return Fig. 7: where Gauss–Newton ends from each start, and the window's own figures."""
    chosen, several = 0, 0
    for k in range(WINDOWS):
        ends = _ends(*_basin_window(seed, k), _sphere(40))
        if any(row["from_optimum_deg"] > 1.0 for row in ends):
            chosen, several = (chosen if several else k), several + 1
    window, problem, result = _basin_window(seed, chosen)
    rows = _ends(window, problem, result, _sphere(runs))
    return rows, {
        "windows": WINDOWS,
        "windows_with_local_minima": several,
        "sdp_error_deg": float(np.degrees(rotation_angle(result.C_ew, window.C_ew))),
        "sdp_cost": result.cost,
        "sdp_status": result.status.name,
        "gauss_newton_reaches_optimum": float(
            np.mean([row["from_optimum_deg"] < 1.0 for row in rows])
        ),
    }


def _basin_window(seed: int, k: int) -> tuple[SimulatedWindow, AlignmentProblem, AlignmentResult]:
    window = simulate_window(np.random.default_rng([seed, k]), 2, MOTION[7], sigma=0.05)
    problem = build_problem(window.rows)
    return window, problem, align_sdp(problem)


def _sphere(points: int) -> FloatArray:
    """Return azimuth and elevation of Fibonacci points [rad], shape (points, 2)."""
    k = np.arange(points) + 0.5
    azimuth = (np.pi * (1.0 + np.sqrt(5.0)) * k + np.pi) % (2.0 * np.pi) - np.pi
    return np.column_stack([azimuth, np.arcsin(1.0 - 2.0 * k / points)])


def _ends(
    window: SimulatedWindow,
    problem: AlignmentProblem,
    result: AlignmentResult,
    starts: FloatArray,
) -> list[dict]:
    rows = []
    for azimuth, elevation in starts:
        found = gauss_newton(problem, result.C_ew @ matrix_from_rpy([0.0, elevation, azimuth]))
        rows.append(
            {
                "azimuth_deg": float(np.degrees(azimuth)),
                "elevation_deg": float(np.degrees(elevation)),
                "error_deg": float(np.degrees(rotation_angle(found.C_ew, window.C_ew))),
                "from_optimum_deg": float(np.degrees(rotation_angle(found.C_ew, result.C_ew))),
                "converged": found.converged,
                "cost": problem.cost(found.C_ew),
            }
        )
    return rows


def compute(figure: int, runs: int, seed: int) -> dict:
    """Return everything a figure shows, ready for JSON."""
    summary: dict = {}
    if figure in (3, 4):
        rows = certified_rates(MOTION[figure], runs, seed)
    elif figure in (5, 6):
        rows = errors_against_noise(MOTION[figure], runs, seed)
    else:
        rows, summary = basins(runs, seed)
    return {"figure": figure, "runs": runs, "seed": seed, **summary, "rows": rows}


def draw(data: dict, path: Path) -> None:
    """Write the picture of `compute`'s data."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update({"font.size": 10, "axes.grid": True, "grid.alpha": 0.3})
    drawer = _draw_rates if data["figure"] in (3, 4) else _draw_noise
    figure = (_draw_basins if data["figure"] == 7 else drawer)(plt, data)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def _draw_rates(plt, data: dict):
    figure, axes = plt.subplots(figsize=(6.0, 3.8), layout="constrained")
    for name in FAMILIES:
        rows = [row for row in data["rows"] if row["constraints"] == name]
        axes.plot(
            [row["satellites"] for row in rows],
            [100.0 * row["certified"] for row in rows],
            color=COLOURS[name], marker=MARKERS[name], label=f"redundant constraints: {name}",
            markersize={"none": 11, "orthogonal": 8, "all": 5}[name],  # curves coincide
        )  # fmt: skip
    motion = "planar" if data["figure"] == 3 else "hilly"
    axes.set(
        xlabel="satellites", ylabel="certified runs [%]", ylim=(-4, 104),
        title=f"Rank test passed, {motion} motion, {data['runs']} runs",
    )  # fmt: skip
    axes.legend()
    return figure


def _draw_noise(plt, data: dict):
    counts = sorted({row["satellites"] for row in data["rows"]})
    figure, panels = plt.subplots(
        1, len(counts), figsize=(3.4 * len(counts), 3.8), sharey=True, layout="constrained"
    )
    for axes, satellites in zip(panels, counts, strict=True):
        for method in METHODS:
            rows = [
                r for r in data["rows"] if (r["satellites"], r["method"]) == (satellites, method)
            ]
            if rows[0]["median_deg"] is None:
                continue
            sigma = [row["sigma_mps"] for row in rows]
            style = {"color": COLOURS[method], "marker": MARKERS[method]}
            axes.loglog(sigma, [row["median_deg"] for row in rows], label=method, **style)
            axes.loglog(sigma, [row["p95_deg"] for row in rows], linestyle=":", **style)
        axes.set(title=f"{satellites} satellites", xlabel="Doppler noise 1σ [m/s]")
    panels[0].set_ylabel("attitude error [°], median and 95 % (dotted)")
    panels[-1].legend()
    return figure


def _draw_basins(plt, data: dict):
    figure = plt.figure(figsize=(7.0, 4.2), layout="constrained")
    axes = figure.add_subplot(projection="hammer")
    points = axes.scatter(
        np.radians([row["azimuth_deg"] for row in data["rows"]]),
        np.radians([row["elevation_deg"] for row in data["rows"]]),
        c=[row["error_deg"] for row in data["rows"]],
        s=max(6.0, 12000.0 / data["runs"]), cmap="cividis", vmin=0.0, vmax=180.0, zorder=2,
    )  # fmt: skip
    figure.colorbar(points, ax=axes, label="final attitude error [°]", shrink=0.7)
    axes.set_xticks(np.radians([-120, -60, 0, 60, 120]))
    for label in axes.get_xticklabels():
        label.set_bbox({"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.0})
    axes.set_yticks(np.radians([-60, -30, 0, 30, 60]))
    axes.set_xlabel("first axis of the start against the optimum: azimuth [°]")
    axes.set_ylabel("elevation [°]")
    axes.set_title(
        "Gauss–Newton by start, two satellites: "
        f"{100.0 * data['gauss_newton_reaches_optimum']:.0f} % reach the certified optimum "
        f"({data['sdp_error_deg']:.1f}° off the truth)",
        fontsize=9,
    )
    return figure


def _progress(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _table(rows: list[dict]) -> str:
    def cell(value) -> str:
        return f"{value:.4g}" if isinstance(value, float) else str(value)

    columns = list(rows[0])
    body = [[cell(row.get(c)) for c in columns] for row in rows]
    width = [max(len(c), *(len(line[k]) for line in body)) for k, c in enumerate(columns)]
    lines = [columns, *body]
    return "\n".join("  ".join(c.rjust(w) for c, w in zip(x, width, strict=True)) for x in lines)


def main(arguments: list[str] | None = None) -> int:
    """Run the script; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--figure", type=int, choices=sorted(MOTION), required=True)
    parser.add_argument("--runs", type=int, default=200, help="runs (figure 7: starts)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    parser.add_argument("--out", type=Path, help="write the picture here (.png, .pdf, .svg)")
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs: expected at least 1, found {options.runs}")
    try:
        data = compute(options.figure, options.runs, options.seed)
    except NavError as error:
        print(error, file=sys.stderr)
        return 1
    if options.out:
        draw(data, options.out)
    print(json.dumps(data) if options.json else _table(data["rows"]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
