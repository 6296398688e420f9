"""What the windows of a recording say: as a table, as JSON, as a picture, with proofs."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from ...alignment.proofs.evidence import Evidence
from ...alignment.proofs.exact import evidence_of, exact_proof
from ...alignment.proofs.proof_file import write
from ...alignment.result import Ask, Verdict
from ...filters.errors import AlignmentError
from ..notes import clock
from .noise import WindowNoise
from .options import WindowOptions
from .recording import WindowResult, summary

# Okabe–Ito.
_BLUE, _ORANGE, _GREY = "#0072B2", "#D55E00", "#999999"

#: Verdicts that have a letter, in the table's order.
_COLUMNS = (
    Ask.OPTIMAL, Ask.UNIQUE, Ask.UNAMBIGUOUS, Ask.BOUNDED, Ask.CONSISTENT, Ask.CONSENSUS,
)  # fmt: skip


def write_proofs(
    name: str, results: list[WindowResult], path: Path, options: WindowOptions
) -> None:
    """Write the exact proofs of the windows that have one, passed or not."""
    proofs = []
    for number, r in enumerate(results):
        if r.result is not None:
            label = f"{name}, {r.start - results[0].start:.1f} s ({r.status})"
            proof = exact_proof(r.result.problem.Q, r.result.minimum, label, evidence(r))
            proofs += [] if proof is None else [replace(proof, window=number)]
    if not proofs:
        raise AlignmentError(f"{name}: no window has an optimum that could be proved exactly")
    # Floats as text, which is exact; `certnav verify --rows` cuts the same windows again.
    how = {k: v.hex() if isinstance(v, float) else v for k, v in asdict(options).items()}
    write(path, name, proofs, how)


def evidence(result: WindowResult) -> Evidence | None:
    """Return the rows that a window's cost was made from."""
    if result.believed is None:
        return None
    return evidence_of(result.believed.rows, result.believed.clock, result.believed.priors)


def as_dict(
    name: str, options: WindowOptions, results: list[WindowResult], noise: WindowNoise
) -> dict:
    """Return everything the table says, angles in degrees."""
    windows = [
        {
            "start_s": r.start,
            "epochs": r.epochs,
            "rows": r.rows,
            "left_out": r.left_out,
            "satellites": r.satellites,
            "status": r.status,
            "heading_deg": math.degrees(r.heading) % 360.0,
            "sigma_heading_deg": math.degrees(r.sigma_heading),
            "error_deg": math.degrees(r.error),
            "bound_deg": math.degrees(r.bound),
            "chi2_per_dof": r.chi2_per_dof,
            "message": r.message,
            "verdicts": {
                v.name: {
                    "passed": v.passed,
                    "value": v.value,
                    "limit": v.limit,
                    "message": v.message,
                }
                for v in r.verdicts
            },
        }
        for r in results
    ]
    return {
        "name": name,
        "method": options.method,
        "window_s": options.window,
        "noise": {
            "source": noise.source,
            "sigma_45_mps": noise.doppler.sigma_45,
            "floor_mps": noise.doppler.floor,
            "decade_db": noise.doppler.decade_db,
            "low_elevation": noise.doppler.low,
            "correlated": noise.correlated,
            "clock_walk": options.clock_walk if noise.clock_walk is None else noise.clock_walk,
        },
        "level_deg": options.level_deg,
        "min_cn0": options.min_cn0,
        "phase": options.phase,
        "summary": summary(results),
        "windows": windows,
    }


def table(
    name: str, options: WindowOptions, results: list[WindowResult], noise: WindowNoise
) -> str:
    """Return the windows as text."""
    start, judged = results[0].start, any(r.verdicts for r in results)
    lines = [
        f"{name}: {options.method}, windows of {options.window:g} s every {options.step:g} s, "
        f"clock {options.clock}",
        f"{noise}"
        + (f"; C/N0 ≥ {options.min_cn0:g} dB-Hz" if options.min_cn0 > 0.0 else "")
        + ("" if options.level_deg is None else f"; level within {options.level_deg:g}° (1σ)")
        + f"; from: since {clock(start)}",
        "   from  epochs  rows  sats  heading [deg]      σ   bound   error  χ²/dof  "
        + ("OUABCK  verdict" if judged else "verdict"),
    ]
    for r in results:
        lines.append(
            f"{r.start - start:6.1f} s {r.epochs:6d} {r.rows:6d} {_cell(r.satellites, 5, 1)} "
            f"{_cell(math.degrees(r.heading) % 360.0, 13, 2)} "
            f"{_cell(math.degrees(r.sigma_heading), 6, 2)} {_cell(math.degrees(r.bound), 7, 2)} "
            f"{_cell(math.degrees(r.error), 7, 2)} "
            f"{_cell(r.chi2_per_dof, 7, 1)}  "
            + (f"{_marks(r.verdicts):6}  " if judged else "")
            + (r.message or r.status)
        )
    lost: Counter[str] = Counter()
    for r in results:
        lost.update(r.left_out)
    if lost:
        said = ", ".join(f"{reason} {count}" for reason, count in lost.most_common())
        lines.append(f"rows of the windows left out: {said}")
    s = summary(results)
    lines.append(
        f"heading error over {s['windows']} windows: mean |error| {s['mae_deg']:.2f}°, standard "
        f"deviation {s['std_deg']:.2f}°, largest {s['max_deg']:.2f}°; passed {s['passed']}"
        + (f", their largest error {s['largest_passed_deg']:.2f}°" if s["passed"] else "")
    )
    if judged:
        lines.append(
            "O optimal, U unique, A unambiguous, B bounded, C consistent, K consensus: + passed, "
            "- not, · nothing to ask; one - and the window is not believed"
        )
    if any(r.status == "CERTIFIED" and r.chi2_per_dof > 3.0 for r in results):
        lines.append(
            "certified says that no other rotation fits these rows better, not that the rows are "
            "right: χ²/dof far above 1 means outliers or a clock the model does not follow"
        )
    return "\n".join(lines)


def _marks(verdicts: tuple[Verdict, ...]) -> str:
    passed = {verdict.name: verdict.passed for verdict in verdicts}
    return "".join("·" if name not in passed else "-+"[passed[name]] for name in _COLUMNS)


def _cell(value: float, width: int, digits: int) -> str:
    return f"{value:{width}.{digits}f}" if math.isfinite(value) else f"{'–':>{width}}"


def draw(results: list[WindowResult], options: WindowOptions, name: str, path: Path) -> None:
    """Draw heading and heading error of the windows over time."""
    from matplotlib.figure import Figure

    t = np.array([r.start for r in results]) - results[0].start
    heading = np.degrees([r.heading for r in results])
    error = np.degrees([r.error for r in results])
    bound = 3.0 * np.degrees([r.sigma_heading for r in results])
    sure = np.array([r.passed for r in results])
    figure = Figure(figsize=(9.0, 5.0), layout="constrained", dpi=150)
    top, bottom = figure.subplots(2, 1, sharex=True)
    top.plot(t, (heading - error) % 360.0, "s", color=_GREY, mfc="none", ms=8, label="reference")
    top.plot(t, heading % 360.0, "o", color=_BLUE, ms=5, label=options.method)
    top.set(ylabel="heading [deg]", title=f"{name}: windows of {options.window:g} s")
    top.legend(frameon=False)
    known = np.isfinite(bound)
    bottom.errorbar(t[known], error[known], bound[known], fmt="none", color=_BLUE, capsize=3)
    bottom.plot(t[sure], error[sure], "o", color=_BLUE, label="passed (bars: 3σ claimed)")
    bottom.plot(t[~sure], error[~sure], "x", color=_ORANGE, label="not passed")
    bottom.axhline(0.0, color="black", lw=0.8)
    bottom.set(ylabel="heading error [deg]", xlabel="begin of the window [s]")
    bottom.legend(frameon=False)
    for axes in (top, bottom):
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path)
