"""Run every recording of the results table and print it as Markdown; draw the README's picture.

    python scripts/readme_results.py [--data DIR] [--picture docs/demo.png] [--json]

Recordings come from CERTNAV_DATA (default ../shared/data); those that are absent are left out.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.filters.earth import C_en_of
from certnav.nav.commands import cli
from certnav.nav.results.directory import Result, read_result

SETS = [
    "comma2k19-example1",
    "rtklibexplorer-drive",
    "oakville-drives/parking-lot-figure8-nominal-001",
    "oakville-drives/urban-long-turn-loop-nominal-001",
    "oakville-drives/urban-medium-turn-loop-nominal-001",
    "instinct/spirent_dynamic",
    "tumsat-tsukishima",
]
# Okabe–Ito: distinguishable with any colour vision.
BLUE, ORANGE, GREY = "#0072B2", "#E69F00", "#999999"


def fix_rms(sequence: Sequence) -> float | None:
    """Horizontal RMS of the carried positions against the reference [m]: the floor of the set."""
    fixes, reference = sequence.fixes, sequence.reference
    if fixes is None or reference is None or "fixed epochs themselves" in reference.source:
        return None
    near = np.interp(fixes.time, reference.time, reference.time)
    step = np.searchsorted(reference.time, fixes.time).clip(1, len(reference) - 1)
    inside = (np.abs(near - fixes.time) < 1e-9) & (np.diff(reference.time)[step - 1] < 0.5)
    at = np.column_stack([np.interp(fixes.time, reference.time, x) for x in reference.pos_e.T])
    error_n = (fixes.pos_e - at)[inside] @ C_en_of(fixes.pos_e[0])
    return float(np.sqrt(np.mean(np.sum(error_n[:, :2] ** 2, axis=1))))


def row(result: Result, floor: float | None, command: str) -> dict:
    """One line of the table."""
    errors = result.summary["errors"]
    return {
        "name": result.name,
        "duration_s": round(result.summary["duration_s"]),
        "horizontal_rms_m": errors["horizontal_rms_m"],
        "horizontal_p95_m": errors["horizontal_p95_m"],
        "heading_rms_deg": errors["heading_rms_deg"],
        "fixes_alone_rms_m": floor,
        "command": command,
    }


def picture(result: Result, path: Path) -> None:
    """Draw the demo: horizontal error with its 3σ bound, and satellites, over time."""
    evaluation, epochs = result.evaluation, result.solution.epochs
    start = evaluation.time[0]
    t = evaluation.time - start
    error = np.hypot(*evaluation.error_pos_n[:, :2].T)
    bound = 3.0 * np.hypot(*evaluation.sigma_pos_n[:, :2].T)
    figure = Figure(figsize=(9.0, 4.2), layout="constrained", dpi=150)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    inside = epochs.time >= start
    weak = epochs.usable < 4
    for axes in (top, bottom):
        for when, low in zip(epochs.time[inside] - start, weak[inside], strict=True):
            if low:
                axes.axvspan(when - 0.5, when + 0.5, color=ORANGE, alpha=0.18, lw=0)
        axes.grid(alpha=0.3)
        axes.spines[["top", "right"]].set_visible(False)
    top.fill_between(t, bound, color=BLUE, alpha=0.2, lw=0, label="3σ the filter claims")
    top.plot(t, error, color=BLUE, lw=1.4, label="horizontal error")
    top.set(
        ylabel="horizontal error [m]", xlim=(0, t[-1]), yscale="log",
        ylim=(0.1, 2.0 * max(error.max(), bound.max())),
    )  # fmt: skip
    top.yaxis.set_major_formatter("{x:g}")
    top.legend(loc="upper right", ncols=2, frameon=False)
    when = epochs.time[inside] - start
    bottom.step(when, epochs.tracked[inside], color=GREY, where="post", label="tracked")
    bottom.step(when, epochs.usable[inside], color=BLUE, where="post", label="usable")
    bottom.axhline(4, color="black", lw=0.8, ls="--")
    bottom.set(
        ylabel="satellites", xlabel="time since alignment [s]  (shaded: fewer than 4 usable)"
    )
    bottom.set_ylim(0, 15)
    bottom.legend(loc="upper right", ncols=2, frameon=False)
    figure.savefig(path)


def main() -> None:
    """Run, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = os.environ.get("CERTNAV_DATA", "../shared/data")
    parser.add_argument("--data", type=Path, default=Path(default))
    parser.add_argument("--picture", type=Path, help="write the README's picture there")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "demo"
        cli.main(["demo", "--out", str(out)])
        demo = read_result(out)
        rows.append(row(demo, None, "certnav demo"))
        if arguments.picture:
            picture(demo, arguments.picture)
        for name in SETS:
            path = arguments.data / name
            if not path.is_dir():
                continue
            out = Path(folder) / path.name
            if cli.main(["run", str(path), "--out", str(out)]):
                raise SystemExit(f"{name}: the run failed")
            rows.append(
                row(read_result(out), fix_rms(load(path)), f"certnav run $CERTNAV_DATA/{name}")
            )
    if arguments.json:
        print(json.dumps(rows, indent=2))
        return

    def number(value: float | None) -> str:
        return "–" if value is None else f"{value:.2f}"

    titles = ["s", "horizontal RMS [m]", "95 % [m]", "fixes alone, RMS [m]", "heading RMS [deg]"]
    print(f"| recording | {' | '.join(titles)} | command |")
    print("|---|---|---|---|---|---|---|")
    for r in rows:
        cells = [
            number(r[k])
            for k in (
                "horizontal_rms_m",
                "horizontal_p95_m",
                "fixes_alone_rms_m",
                "heading_rms_deg",
            )
        ]
        print(f"| {r['name']} | {r['duration_s']} | {' | '.join(cells)} | `{r['command']}` |")


if __name__ == "__main__":
    main()
