"""Table III of Song et al. on smartLoc Berlin1: heading errors of three methods.

    python scripts/alignment_table3.py [--data DIR] [--window 15] [--step 1] [--json] [--out PNG]

The paper aligns over the whole Berlin1 run; 60 s of its raw Doppler are at hand, so this slides
windows over those and reports MAE, STD and MAX of the heading over the windows. Four satellites
or two on average are drawn at random per epoch (seeded), at full rate (5 Hz) and decimated by ten,
with all rows and with the rows labelled line of sight.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from certnav.datasets.loading import load
from certnav.nav.results.summary import strict
from certnav.nav.windows.options import WindowOptions
from certnav.nav.windows.recording import align_windows, summary

METHODS = ("sdp", "voba", "gauss-newton")
NAMES = {"voba": "VOBA", "gauss-newton": "Gauss–Newton from identity", "sdp": "SDP"}
COLOURS = {"voba": "#E69F00", "gauss-newton": "#D55E00", "sdp": "#0072B2"}


def main() -> None:
    """Run every cell of the table; print it, and draw the errors by window."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(os.environ.get("CERTNAV_DATA", "../shared/data"))
    parser.add_argument("--data", type=Path, default=default)
    parser.add_argument("--window", type=float, default=15.0)
    parser.add_argument("--step", type=float, default=1.0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path, help="picture")
    arguments = parser.parse_args()
    sequence = load(arguments.data / "smartloc-berlin1")
    rows, curves = [], {}
    cells = itertools.product(("all", "los"), (4.0, 2.0), (1, 10), METHODS)
    for labels, satellites, decimate, method in cells:
        options = WindowOptions(
            window=arguments.window, step=arguments.step, method=method, satellites=satellites,
            labels=labels, decimate=decimate, clock="linear",
        )  # fmt: skip
        results = align_windows(sequence, options)
        s = summary(results)
        rows.append(
            {
                "dataset": "smartLoc Berlin1, 60 s",
                "rows": labels,
                "satellites": satellites,
                "decimation": decimate,
                "method": method,
                "windows": s["windows"],
                "solved": s["solved"],
                "MAE": s["mae_deg"],
                "STD": s["std_deg"],
                "MAX": s["max_deg"],
            }
        )
        if labels == "los" and decimate == 1:
            start = results[0].start
            curves[satellites, method] = np.array(
                [(r.start - start, np.degrees(abs(r.error))) for r in results]
            )
    if arguments.out:
        draw(curves, arguments.window, arguments.out)
    if arguments.json:
        print(json.dumps(strict(rows), indent=2))
        return
    print(
        "| rows | satellites | decimation | method | solved | MAE [deg] | STD [deg] | MAX [deg] |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for r in rows:
        numbers = [f"{r[k]:.2f}" if np.isfinite(r[k]) else "–" for k in ("MAE", "STD", "MAX")]
        print(
            f"| {r['rows']} | {r['satellites']:g} | {r['decimation']} | {NAMES[r['method']]} "
            f"| {r['solved']}/{r['windows']} | {' | '.join(numbers)} |"
        )


def draw(curves: dict, window: float, path: Path) -> None:
    """Draw the absolute heading error by window, one panel per number of satellites."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained", dpi=150)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, satellites in zip(panels, (4.0, 2.0), strict=True):
        for method in METHODS:
            t, error = curves[satellites, method].T
            axes.semilogy(t, error, "o-", ms=3, lw=1, color=COLOURS[method], label=NAMES[method])
        which = "4 satellites" if satellites == 4.0 else "2 satellites on average"
        axes.set(
            title=f"{which}, line of sight only", xlabel=f"begin of the {window:g} s window [s]"
        )
        axes.grid(alpha=0.3, which="both")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("|heading error| [deg]")
    panels[0].legend(frameon=False)
    figure.savefig(path)


if __name__ == "__main__":
    main()
