"""Is the covariance honest? NEES and NIS of filter and smoother, over drives of all kinds.

    python scripts/consistency.py --seeds 20 --out docs/consistency.md     # the page
    python scripts/consistency.py --seeds 4 --only suburb urban Tokyo      # tables on the screen

NEES is eᵀP⁻¹e against the reference, from 20 s after the start on: 3 is right for the three
components of position and velocity, 1 for the heading. NIS per degree of freedom is 1 where model
and noise are right. Everything is as configured by default but the start (level and course).
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import tempfile
import time as clock
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from consistency_drives import DATA, DURATION, RECORDINGS, WORLDS, Judged, drives
from scipy.stats import chi2

from certnav.datasets.sequence import Sequence
from certnav.filters.earth import C_en_of
from certnav.filters.errors import NavError
from certnav.filters.rotation import FloatArray
from certnav.nav.config_files import from_tables
from certnav.nav.evaluation.accuracy import evaluate, mean_rate_b
from certnav.nav.evaluation.interpolation import interpolate
from certnav.nav.pipeline import navigate
from certnav.nav.solution import Solution, Update

SETTLED = 20.0
PARTS = {"position": 3, "velocity": 3, "heading": 1}
#: What is asked for, per degree of freedom.
LOW, HIGH = 0.5, 5.0 / 3.0
#: Heading of the section that is written by hand.
SECTION = "## What it says"
COMMAND = "python scripts/consistency.py --seeds {seeds} --out docs/consistency.md"


@dataclass(frozen=True)
class Innovations:
    """Normalised innovations of one kind of update.

    Attributes
    ----------
    count, dof : int
        Updates tested, and components in all.
    nis, typical : float
        NIS per degree of freedom, from the mean and from the median: a few gross errors do not
        move that.
    refused : float
        Share that failed the test.
    correlation : float
        Between neighbours of the same component: 0 where errors are white.
    """

    count: int
    dof: int
    nis: float
    typical: float
    refused: float
    correlation: float


@dataclass(frozen=True)
class Figures:
    """NEES of one run by part, mean and from the median; mean square of the position error [m²]."""

    mean: dict[str, float]
    typical: dict[str, float]
    square: float


def bounds(dof: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Return the central 95 % of χ² per degree of freedom."""
    return chi2.ppf(0.025, dof) / dof, chi2.ppf(0.975, dof) / dof


def innovations(updates: tuple[Update, ...]) -> dict[str, Innovations]:
    """Return the innovations of a log by kind of update."""
    by_kind: dict[str, list[Update]] = {}
    for update in updates:
        if np.isfinite(update.nis) and update.whitened:
            by_kind.setdefault(update.kind, []).append(update)
    return {kind: _of_kind(tested) for kind, tested in by_kind.items()}


def _of_kind(tested: list[Update]) -> Innovations:
    dof = np.array([len(u.whitened) for u in tested])
    nis = np.array([u.nis for u in tested])
    typical = float(np.median(nis / chi2.median(dof)))
    pairs = [
        (a.whitened, b.whitened)
        for a, b in itertools.pairwise(tested)
        if len(a.whitened) == len(b.whitened) and b.time - a.time < 1.5
    ]
    correlation = np.nan
    if len(pairs) > 20:
        first, second = (
            np.clip(np.concatenate(side), -4.0, 4.0) for side in zip(*pairs, strict=True)
        )
        correlation = float(np.sum(first * second) / np.sqrt(np.sum(first**2) * np.sum(second**2)))
    return Innovations(
        len(tested), int(dof.sum()), float(nis.sum() / dof.sum()), typical,
        float(np.mean([bool(u.reason) for u in tested])), correlation,
    )  # fmt: skip


def nees(
    solution: Solution, sequence: Sequence, judged: Judged
) -> tuple[dict[str, FloatArray], float]:
    """Return NEES by part at the reference's epochs, and the mean square of the position error."""
    found, track = evaluate(solution, sequence), solution.trajectory
    late = found.time > track.time[0] + SETTLED
    time = found.time[late]
    at = interpolate(track, time)
    # What the reference does not know: its own noise, and where it sits on the turning vehicle.
    omega_b = mean_rate_b(sequence.inertial, time)
    omega_n = np.einsum("nji,njk,nk->ni", C_en_of(at.pos_e), at.C_eb, np.nan_to_num(omega_b))
    square = np.einsum("ni,ni->n", omega_n, omega_n)[:, None, None] * np.eye(3)
    turning = judged.lever**2 * (square - omega_n[:, :, None] * omega_n[:, None, :])
    position = (judged.position**2 + judged.lever**2) * np.eye(3)
    out = {
        "position": _squares(found.error_pos_n[late], at.cov_pos_n + position),
        "velocity": _squares(
            found.error_vel_n[late], at.cov_vel_n + judged.velocity**2 * np.eye(3) + turning
        ),
    }
    error = (found.error_rpy_aligned if judged.turned else found.error_rpy)[late, 2]
    sigma = np.hypot(found.sigma_rpy[late, 2], np.radians(judged.heading))
    out["heading"] = error**2 / sigma**2
    squares = np.sum(found.error_pos_n[late] ** 2, axis=1)
    return out, float(np.mean(squares)) if squares.size else np.nan


def _squares(error: FloatArray, cov: FloatArray) -> FloatArray:
    return np.einsum("ni,ni->n", error, np.linalg.solve(cov, error[..., None])[..., 0])


def figures(values: dict[str, FloatArray], square: float) -> Figures:
    """Return the mean NEES by part, and what the median says it is."""
    known = {part: v[np.isfinite(v)] for part, v in values.items()}
    return Figures(
        {p: float(v.mean()) if v.size else np.nan for p, v in known.items()},
        {
            p: float(np.median(v)) * PARTS[p] / chi2.median(PARTS[p]) if v.size else np.nan
            for p, v in known.items()
        },
        square,
    )


@dataclass(frozen=True, eq=False)
class Row:
    """Everything about one world or recording: runs of filter and of smoother, innovations."""

    name: str
    runs: dict[str, list[Figures]]
    innovations: dict[str, Innovations]
    found: list[str]


def measured(name: str, seeds: range) -> Row:
    """Navigate the drives of a world, or a recording, by filter and by smoother."""
    judged = RECORDINGS.get(name, Judged(""))
    runs: dict[str, list[Figures]] = {"filter": [], "smoother": []}
    log: list[Update] = []
    found: list[str] = []
    with tempfile.TemporaryDirectory() as work:
        for sequence in drives(name, seeds, Path(work)):
            began = clock.perf_counter()
            for what in runs:
                tables = {
                    "alignment": {"method": "level+course"},
                    "filter": {"smooth": what == "smoother"},
                }
                try:
                    solution = navigate(sequence, from_tables(tables))
                except NavError as error:
                    print(f"{name}, {sequence.name}, left out: {error}", file=sys.stderr)
                    break
                values, square = nees(solution, sequence, judged)
                if np.isnan(square):
                    text = f"navigated for less than {SETTLED:.0f} s"
                    print(f"{name}, {sequence.name}, left out: {text}", file=sys.stderr)
                    break
                runs[what].append(figures(values, square))
            else:
                log += solution.updates
                found += [n.text for n in solution.notes if n.text.startswith("noise of ")]
            seconds = clock.perf_counter() - began
            print(f"{name}, {sequence.name}: {seconds:.0f} s", file=sys.stderr, flush=True)
    return Row(name, runs, innovations(tuple(log)), found)


def cell(runs: list[Figures], part: str) -> str:
    """Return mean | typical | worst drive of a part's NEES; what is outside the aim in bold."""
    means = np.array([run.mean[part] for run in runs])
    if not np.isfinite(means).any():
        return "–"
    mean = float(np.nanmean(means))
    text = f"{mean:.2g}" if LOW <= mean / PARTS[part] <= HIGH else f"**{mean:.2g}**"
    text += f" · {np.nanmedian([run.typical[part] for run in runs]):.2g}"
    return text + (f" · {np.nanmax(means):.2g}" if len(runs) > 1 else "")


def table(rows: list[Row]) -> list[str]:
    """Return the tables of NEES and of innovations, as Markdown."""
    lines = [
        "| | drives | | position | velocity | heading | 3-D RMS [m] |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        for what, runs in row.runs.items():
            if runs:
                rms = np.sqrt(np.mean([run.square for run in runs]))
                cells = " | ".join(cell(runs, part) for part in PARTS)
                lines.append(f"| {row.name} | {len(runs)} | {what} | {cells} | {rms:.2f} |")
    lines += [
        "", "## Innovations", "",
        "NIS per degree of freedom: mean, and from the median; share refused by the test; "
        "correlation with the next one. The 95 % of χ² are what the mean of as many white errors "
        "of the stated σ would keep to.", "",
        "| | update | number | NIS | typical | 95 % of χ² | refused | correlation |",
        "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for row in rows:
        for kind, i in row.innovations.items():
            low, high = bounds(i.dof)
            correlation = "–" if np.isnan(i.correlation) else f"{i.correlation:.2f}"
            lines.append(
                f"| {row.name} | {kind} | {i.count} | {i.nis:.2f} | {i.typical:.2f} | "
                f"{low:.2f} … {high:.2f} | {100 * i.refused:.1f} % | {correlation} |"
            )
    return lines


def page(rows: list[Row], seeds: int) -> str:
    """Return the page without what is written by hand."""
    lines = [
        "# Is the covariance honest?", "", f"Made by `{COMMAND.format(seeds=seeds)}`.", "",
        "A filter states its accuracy with every epoch; two figures test whether to believe it. "
        "NEES is the square of the error in units of the stated σ, summed over components: it "
        "needs a reference. NIS is the same of an innovation, the difference between a "
        "measurement and its prediction: it needs none.", "",
        "## NEES", "",
        f"From {SETTLED:.0f} s after the start on; simulated drives last {DURATION:.0f} s where "
        "nothing else is said. Mean over all drives · what the median says the mean should be · "
        "worst drive's mean. 3 is right for position and velocity, 1 for the heading; 1.5 … 5 and "
        "0.5 … 1.7 are aimed at, and what is outside is bold.", "",
    ]  # fmt: skip
    lines += [*table(rows), "", "### What is judged, and by what", ""]
    for row in rows:
        what = WORLDS.get(row.name) or RECORDINGS[row.name].why
        lines.append(f"- {row.name}: {what}" + (f". *{row.found[0]}*" if row.found else "") + ".")
    return "\n".join(lines) + "\n"


def by_hand(old: str) -> str:
    """Return the section of a page that is written by hand, to be kept."""
    found = old.find(SECTION)
    return "\n" + old[found:] if found >= 0 else ""


def main() -> int:
    """Print or write the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4, metavar="N", help="drives a world [4]")
    parser.add_argument("--first", type=int, default=0, metavar="K", help="seed of the first [0]")
    parser.add_argument("--only", nargs="+", choices=[*WORLDS, *RECORDINGS], metavar="NAME")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the page there")
    arguments = parser.parse_args()
    names = arguments.only or [*WORLDS, *RECORDINGS]
    here = [n for n in names if n in WORLDS or (DATA / RECORDINGS[n].folder).is_dir()]
    out: Path | None = arguments.out
    old = out.read_text(encoding="utf-8") if out is not None and out.exists() else ""
    rows: list[Row] = []
    for name in here:
        # A quarter of the long drives.
        count = -(-arguments.seeds // 4) if name == "demo" else arguments.seeds
        seeds = range(arguments.first, arguments.first + count)
        rows.append(measured(name, seeds))
        if out is not None:  # as far as it is
            out.write_text(page(rows, arguments.seeds) + by_hand(old), encoding="utf-8")
    if arguments.json:
        print(json.dumps([asdict(row) for row in rows], indent=2, default=float))
    elif out is None:
        print("\n".join(table(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
