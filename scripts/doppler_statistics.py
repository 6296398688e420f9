"""Statistics of DDIA-VE pairs of a drive: the tables and figures behind the thresholds.

    python scripts/doppler_statistics.py PATH [--json] [--pictures DIR]
    python scripts/doppler_statistics.py --tables [--data DIR] [--json]

With --tables: the recordings in CERTNAV_DATA (default ../shared/data; absent ones are left out)
and simulated drives, beside what the paper gives for three sequences of GREAT.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import NavError
from certnav.velocity.doppler_noise import fit_doppler_noise, reference_residuals
from certnav.velocity.study.below_four import few_satellites
from certnav.velocity.study.samples import Samples, reference_samples
from certnav.velocity.study.tables import describe, pair_table
from certnav.velocity.study.unaided import drift_effect

#: Tables 2, 3 and 5 of the paper (GREAT): pairs after k > 0.05 and 3·RMS, RMS at k > 0.05 [m/s],
#: C/N0 [dB-Hz], and what it says of SNR > 40, k > 0.2.
PAPER = {
    "paper, set 1": {"kept_3rms": 11035, "rms_k05_mps": 2.92, "cn0_mean_dbhz": 42.47,
                     "kept_40_20": "> 70 %", "rms_40_20": "about 0.3"},
    "paper, set 2": {"kept_3rms": 53317, "rms_k05_mps": 0.66, "cn0_mean_dbhz": None,
                     "kept_40_20": "> 70 %", "rms_40_20": "about 0.3"},
    "paper, set 3": {"kept_3rms": 11590, "rms_k05_mps": 4.15, "cn0_mean_dbhz": None,
                     "kept_40_20": "> 44 %", "rms_40_20": "about 0.3"},
}  # fmt: skip
SETS = {
    "comma2k19": ("comma2k19-example1", ""),
    "smartLoc, all rows": ("smartloc-berlin1", ""),
    "smartLoc, LOS rows": ("smartloc-berlin1", "los"),
    "Spirent": ("instinct/spirent_dynamic", ""),
}
SIMULATED = {"suburb": 1, "urban": 2, "canyon": 3}
BLUE, ORANGE = "#0072B2", "#E69F00"


def strict(value: Any) -> Any:
    """Return JSON values, NaN and infinity as None."""
    if isinstance(value, dict):
        return {key: strict(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [strict(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return int(value) if isinstance(value, np.integer) else value


def cross_fitted(samples: Samples, blocks: int = 5, draws: int = 20) -> dict[str, Any]:
    """Return few-satellite figures of each block of time, weights fitted to the other blocks."""
    edges = np.linspace(samples.time[0], samples.time[-1] + 1e-6, blocks + 1)
    residual = reference_residuals(samples)
    weighted = []
    for start, end in itertools.pairwise(edges):
        others = ~((samples.time >= start) & (samples.time < end))[samples.epoch]
        noise = fit_doppler_noise(samples.cn0[others], residual[others], spread="rms").noise
        weighted.append(samples.between(start, end).weighted(noise))
    out = {}
    for count in (2, 3, 4, 5):
        found = [few_satellites(block, count, draws=draws) for block in weighted if block.time.size]
        epochs = np.array([f.epochs for f in found])
        pairs, joint = (
            np.sqrt(
                np.sum(epochs * np.nan_to_num([getattr(f, key) for f in found]) ** 2) / epochs.sum()
            )
            for key in ("rms_pairs", "rms_joint")
        )
        out[str(count)] = {
            "availability": epochs.sum() / (draws * samples.time.size),
            "rms_mean_of_pairs_mps": pairs,
            "rms_least_squares_mps": joint,
            "lower_by": 1.0 - joint / pairs,
        }
    return out


def statistics(
    sequence: Sequence, *, direction: str, systems: str, label: str, delay: float
) -> dict[str, Any]:
    """Return everything about one drive."""
    samples = reference_samples(
        sequence, direction=direction, systems=systems, label=label, reference_delay=delay
    )
    out: dict[str, Any] = {
        "name": sequence.name,
        "direction": direction,
        "epochs": samples.time.size,
    }
    out |= describe(pair_table(samples))
    out["left_out"] = samples.left_out
    try:
        fit = fit_doppler_noise(samples.cn0, reference_residuals(samples))
        out["noise"] = {
            "sigma_45_mps": fit.noise.sigma_45, "floor_mps": fit.noise.floor,
            "decade_db": fit.noise.decade_db, "misfit": fit.misfit,
        }  # fmt: skip
        out["few_satellites"] = cross_fitted(samples)
    except NavError as error:
        out["noise"], out["few_satellites"] = str(error), None
    out["attitude_200s"] = attitude(sequence)
    return out


def attitude(sequence: Sequence) -> dict[str, Any] | None:
    """Return Table 4: 200 s of inertial attitude against the reference's; None if too short."""
    if sequence.imu is None or sequence.reference is None:
        return None
    start = max(sequence.imu.time[0], sequence.reference.time[0])
    end = min(sequence.imu.time[-1], sequence.reference.time[-1])
    if end - start < 270.0:
        return None
    try:
        effect = drift_effect(sequence, start + 0.5 * (end - start - 270.0) + 65.0)
    except NavError:
        return None
    return {
        "duration_s": effect.duration,
        "rpy_rms_deg": np.degrees(effect.rpy_rms),
        "rpy_end_deg": np.degrees(effect.rpy_end),
        **effect.figures,
    }


def pictures(result: dict[str, Any], folder: Path) -> None:
    """Draw Figs. 3, 6 and 8."""
    folder.mkdir(parents=True, exist_ok=True)
    bins = result["bins"]
    figure = Figure(figsize=(7.0, 3.6), layout="constrained", dpi=130)
    axes = figure.subplots()
    axes.bar([b["low"] + 0.025 for b in bins], [b["rms_mps"] for b in bins], 0.045, color=BLUE)
    axes.set(xlabel="k = |SDV·RMD|", ylabel="RMS velocity error [m/s]", yscale="log")
    axes.grid(axis="y", alpha=0.3)
    figure.savefig(folder / "error_over_k.png")

    figure = Figure(figsize=(7.0, 3.6), layout="constrained", dpi=130)
    axes = figure.subplots()
    histogram = result["cn0"]["histogram"]
    axes.bar([h["dbhz"] + 0.5 for h in histogram], [100 * h["share"] for h in histogram], 0.9,
             color=BLUE)  # fmt: skip
    axes.axvline(result["cn0"]["mean_dbhz"], color=ORANGE)
    axes.set(xlabel="C/N0 [dB-Hz]", ylabel="share of the pairs' satellites [%]")
    figure.savefig(folder / "cn0.png")

    snr = sorted({h["snr"] for h in result["heatmap"]})
    k = sorted({h["k"] for h in result["heatmap"]})
    figure = Figure(figsize=(10.0, 4.0), layout="constrained", dpi=130)
    columns = (("rms_mps", "RMS velocity error [m/s]", 1.0), ("kept", "retained [%]", 100.0))
    for axes, (key, title, scale) in zip(figure.subplots(1, 2), columns, strict=True):
        values = np.array([h[key] for h in result["heatmap"]], dtype=float) * scale
        mesh = axes.pcolormesh(
            k, snr, np.ma.masked_invalid(values.reshape(len(snr), len(k))), shading="nearest"
        )
        axes.set(xlabel="k above", ylabel="C/N0 above [dB-Hz]", title=title)
        figure.colorbar(mesh, ax=axes)
    figure.savefig(folder / "heat_map.png")


def drives(data: Path) -> Iterator[tuple[str, Sequence, str]]:
    """Yield what the tables are made of."""
    for title, (folder, label) in SETS.items():
        if (data / folder).is_dir():
            yield title, load(data / folder), label
    for density, seed in SIMULATED.items():
        config = SimulationConfig(name=density, seed=seed, duration=600.0, density=density)
        yield f"simulated, {density}", simulate(config).sequence(), ""


def cell(value: Any) -> str:
    """Return one cell of the table."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    return f"{value:.2f}" if isinstance(value, float) else str(value)


def print_table(results: dict[str, dict[str, Any]]) -> None:
    """Print Tables 2, 3 and 5 and the recommended operating point as Markdown."""
    head = ["drive", "pairs", "k ≤ 0.05", "RMS, k > 0.05 [m/s]", "left by 3·RMS", "RMS then [m/s]",
            "C/N0 [dB-Hz]", "SNR > 40, k > 0.2: RMS [m/s]", "kept"]  # fmt: skip
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for title, r in results.items():
        point = next(h for h in r["heatmap"] if h["snr"] == 40.0 and h["k"] == 0.2)
        cells = [
            title, r["pairs"], f"{r['k05_discarded_share']:.1%}", r["rms_k05_mps"],
            r["kept_3rms"], r["rms_3rms_mps"],
            f"{cell(r['cn0']['mean_dbhz'])} ± {cell(r['cn0']['std_db'])}", point["rms_mps"],
            f"{point['kept']:.0%}",
        ]  # fmt: skip
        print("| " + " | ".join(map(cell, cells)) + " |")
    for title, p in PAPER.items():
        cells = [title, None, None, p["rms_k05_mps"], p["kept_3rms"], None, p["cn0_mean_dbhz"],
                 p["rms_40_20"], p["kept_40_20"]]  # fmt: skip
        print("| " + " | ".join(map(cell, cells)) + " |")


def main() -> None:
    """Compute, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("path", type=Path, nargs="?", help="folder of a sequence")
    parser.add_argument("--tables", action="store_true", help="all recordings and simulations")
    default = Path(os.environ.get("CERTNAV_DATA", "../shared/data"))
    parser.add_argument("--data", type=Path, default=default)
    parser.add_argument("--direction", default="motion", help="motion or attitude [motion]")
    parser.add_argument("--systems", default="G", help="constellation letters [G]")
    parser.add_argument("--label", default="", help="only rows labelled so, e.g. los")
    parser.add_argument(
        "--reference-delay", type=float, default=0.0, metavar="S",
        help="added to the reference's times, to see what a wrong stamp costs",
    )  # fmt: skip
    parser.add_argument("--pictures", type=Path, metavar="DIR")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    options = {"direction": arguments.direction, "systems": arguments.systems}
    try:
        if arguments.tables:
            results = {
                title: statistics(drive, label=label, delay=0.0, **options)
                for title, drive, label in drives(arguments.data)
            }
            if arguments.json:
                print(json.dumps(strict({**results, "paper": PAPER}), allow_nan=False))
            else:
                print_table(results)
            return
        if arguments.path is None:
            parser.error("name the folder of a sequence, or --tables")
        result = statistics(
            load(arguments.path), label=arguments.label, delay=arguments.reference_delay, **options
        )
    except NavError as error:
        sys.exit(f"doppler_statistics: {error}")
    if arguments.pictures:
        pictures(result, arguments.pictures)
    if arguments.json:
        print(json.dumps(strict(result), allow_nan=False))
    else:
        print_table({result["name"]: result})


if __name__ == "__main__":
    main()
