"""Table III of Song et al. on the whole smartLoc Berlin1 run, the paper's numbers beside ours.

    python scripts/alignment_table3.py [--data DIR] [--window 120] [--step 2] [--json] [--out PNG]

GPS alone, windows of 120 s, a constant clock, all rows weighted alike, at full rate (5 Hz) and with
every tenth epoch: what the paper says. Which satellites were taken it does not say: the first four
or two by number (what comes closest), the highest, the strongest, and drawn at random. Heading of
the vehicle at the window's begin against the NovAtel SPAN truth; STD is that of |error|, as in the
paper. *robust* is `certnav align --method robust --noise fitted --level 2` on the same satellites,
at 1 Hz where the others have 5 Hz (its clock has an unknown at every epoch) and in fewer windows;
with all satellites of both systems it is in the last row.
"""

from __future__ import annotations

import os

# Small matrices: threads cost more than they bring.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from certnav.datasets.loading import load
from certnav.datasets.observations import GnssObservations
from certnav.datasets.sequence import Sequence
from certnav.nav.results.summary import strict
from certnav.nav.windows.options import WindowOptions
from certnav.nav.windows.recording import WindowResult, align_windows
from certnav.nav.windows.rows import prepared_observations

METHODS = ("voba", "gauss-newton", "sdp", "robust")
NAMES = {
    "voba": "VOBA",
    "gauss-newton": "Gauss–Newton from identity",
    "sdp": "SDP",
    "robust": "robust",
}
COLOURS = {"voba": "#E69F00", "gauss-newton": "#D55E00", "sdp": "#0072B2", "robust": "#009E73"}
SELECTIONS = ("by number", "highest", "strongest", "random")
#: Table III of the paper, Berlin1: MAE/STD/MAX [deg] of VOBA, GVINS from the identity, SDP.
PAPER = {
    (4, 1): ("5.76/2.27/11.98", "4.72/2.59/10.84", "4.69/2.57/9.42"),
    (2, 1): ("–", "6.05/22.98/172.25", "2.64/2.06/7.25"),
    (4, 10): ("5.76/2.27/11.98", "5.16/3.66/14.57", "5.10/3.63/14.33"),
    (2, 10): ("–", "9.33/25.02/193.91", "4.53/3.20/18.55"),
}


def selected(sequence: Sequence, count: int, how: str) -> Sequence:
    """Return the recording with so many GPS satellites an epoch, chosen in one of four ways."""
    every, _ = prepared_observations(sequence, WindowOptions(phase="off"))
    gps = every.take(np.char.startswith(every.sat, "G"))
    rng, keep = np.random.default_rng(0), np.zeros(len(gps), dtype=bool)
    for _, epoch in gps.epochs():
        rows = np.arange(epoch.start, epoch.stop)
        order = {
            "by number": np.argsort(gps.sat[rows]),
            "highest": np.argsort(-gps.elevation[rows]),
            "strongest": np.argsort(-gps.cn0[rows], kind="stable"),
            "random": rng.permutation(rows.size),
        }[how]
        keep[rows[order[:count]]] = True
    chosen: GnssObservations = gps.take(keep)
    return replace(sequence, observations=chosen)


def cell(results: list[WindowResult]) -> dict[str, float | int]:
    """Return MAE, STD and MAX of |heading error| [deg], and how many windows were solved."""
    error = np.degrees([abs(r.error) for r in results if np.isfinite(r.error)])
    if not error.size:
        error = np.array([np.nan])
    return {
        "windows": len(results),
        "solved": int(np.isfinite(error).sum()),
        "passed": sum(r.passed for r in results),
        "beyond_bound": sum(bool(abs(r.error) > r.bound) for r in results if r.passed),
        "MAE": float(np.mean(error)),
        "STD": float(np.std(error)),
        "MAX": float(np.max(error)),
    }


def aligned(
    sequence: Sequence, method: str, decimate: int, window: float, step: float
) -> list[WindowResult]:
    """Return the windows as the paper does it, or as the robust method does."""
    if method == "robust":
        options = WindowOptions(
            window=window, step=step, method="robust", noise="fitted", level_deg=2.0,
            decimate=max(decimate, 5),
        )  # fmt: skip
        return align_windows(sequence, options)
    assert sequence.observations is not None
    alike = sequence.observations.with_columns(cn0=np.full(len(sequence.observations), 45.0))
    options = WindowOptions(
        window=window, step=step, method=method, clock="constant", decimate=decimate, phase="off"
    )
    return align_windows(replace(sequence, observations=alike), options)


def main() -> None:
    """Run every cell of the table; print it, and draw the errors by window."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(os.environ.get("CERTNAV_DATA", "../shared/data"))
    parser.add_argument("--data", type=Path, default=default)
    parser.add_argument("--window", type=float, default=120.0)
    parser.add_argument("--step", type=float, default=2.0)
    parser.add_argument("--robust-step", type=float, default=20.0, help="of the robust method")
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--out", type=Path, help="picture")
    arguments = parser.parse_args()
    whole = load(arguments.data / "smartloc-berlin1" / "full")
    rows, curves = [], {}
    for how, satellites in itertools.product(SELECTIONS, (4, 2)):
        sequence = selected(whole, satellites, how)
        for decimate, method in itertools.product((1, 10), METHODS):
            if method == "robust" and how != "by number":
                continue
            step = arguments.robust_step if method == "robust" else arguments.step
            results = aligned(sequence, method, decimate, arguments.window, step)
            rows.append({"selection": how, "satellites": satellites, "decimation": decimate,
                         "method": method, **cell(results)})  # fmt: skip
            if how == "by number" and decimate == 1:
                begin = results[0].start
                curves[satellites, method] = np.array(
                    [(r.start - begin, np.degrees(abs(r.error))) for r in results]
                )
    every = aligned(whole, "robust", 1, arguments.window, arguments.robust_step)
    rows.append({"selection": "all, both systems", "satellites": None, "decimation": 1,
                 "method": "robust", **cell(every)})  # fmt: skip
    if arguments.out:
        draw(curves, arguments.window, arguments.out)
    if arguments.json:
        print(json.dumps(strict(rows), indent=2))
        return
    show(rows)


def show(rows: list[dict]) -> None:
    """Print the table, MAE/STD/MAX in every cell, and the paper's where the cell is its own."""
    print("| selection | satellites | every | " + " | ".join(NAMES.values()) + " | robust passed |")
    print("|---" * (len(NAMES) + 4) + "|")
    keys = dict.fromkeys((r["selection"], r["satellites"], r["decimation"]) for r in rows)
    for how, satellites, decimate in keys:
        found = {
            r["method"]: r
            for r in rows
            if (r["selection"], r["satellites"], r["decimation"]) == (how, satellites, decimate)
        }
        cells = [text(found.get(method)) for method in METHODS]
        robust = found.get("robust")
        passed = f"{robust['passed']} of {robust['windows']}" if robust else ""
        print(f"| {how} | {satellites or 'all'} | {decimate} | {' | '.join(cells)} | {passed} |")
    for (satellites, decimate), cells in PAPER.items():
        print(f"| *the paper* | {satellites} | {decimate} | {' | '.join(cells)} | | |")


def text(found: dict | None) -> str:
    """Return one cell."""
    if found is None or not np.isfinite(found["MAE"]):
        return "–" if found is not None else ""
    return f"{found['MAE']:.2f}/{found['STD']:.2f}/{found['MAX']:.2f}"


def draw(curves: dict, window: float, path: Path) -> None:
    """Draw the absolute heading error by window, one panel per number of satellites."""
    figure = Figure(figsize=(9.0, 4.0), layout="constrained", dpi=150)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, satellites in zip(panels, (4, 2), strict=True):
        for method in METHODS:
            t, error = curves[satellites, method].T
            axes.semilogy(t, error, "o-", ms=3, lw=1, color=COLOURS[method], label=NAMES[method])
        axes.set(
            title=f"first {satellites} GPS satellites by number",
            xlabel=f"begin of the {window:g} s window [s]",
        )
        axes.grid(alpha=0.3, which="both")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("|heading error| [deg]")
    panels[0].legend(frameon=False)
    figure.savefig(path)


if __name__ == "__main__":
    main()
