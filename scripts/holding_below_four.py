"""What is left of a navigation solution when satellites go: every method, the same spells.

    python scripts/holding_below_four.py [--seeds 20] [--only simulated,…] [--live] [--json]

simulated      urban drives in the GREAT layout (ADIS16470), 60 s in every 180 s with two or three
               satellites; NEES just before and at the end of each spell against its χ² bounds
comma2k19      the recorded minute cut to two and to three satellites, drawn, from second 10 on
fixes          the oakville and rtklibexplorer drives with 15, 30 and 60 s without GNSS
spirent        RF-simulator observations with a simulated ADIS16470: in full, then two or three
               satellites

Drift is max |e(t) − e(t₀)| in a spell, e the horizontal error and t₀ its beginning.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.filters.errors import NavError
from certnav.nav.compare.comparison import compare
from certnav.nav.compare.methods import METHODS, parse_methods
from certnav.nav.compare.runs import Comparison, as_dict, spells_of
from certnav.nav.config import Config, GnssConfig
from certnav.nav.config_files import from_tables
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate
from certnav.nav.results.summary import strict
from certnav.nav.spells.drift import SpellFigures
from certnav.nav.spells.outages import parse_outages

LIVE = "lc4,lc+ddia,lc+rows,lc4+vehicle,lc+ddia+vehicle,lc+rows+vehicle"
SMOOTHED = ",".join(f"{name}+smooth" for name in LIVE.split(","))
#: Every method that has a position.
POSITIONS = ",".join(name for name, method in METHODS.items() if method.kind != "windows")
FIXES = "lc4,lc4+vehicle,lc4+smooth,lc4+vehicle+smooth"


def main() -> None:
    """Run the experiments that are asked for; print tables, or JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(os.environ.get("CERTNAV_DATA", "../shared/data"))
    parser.add_argument("--data", type=Path, default=default)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--duration", type=float, default=600.0, help="of a simulated drive [s]")
    parser.add_argument("--only", default="simulated,comma2k19,fixes,spirent", metavar="LIST")
    parser.add_argument(
        "--min-cn0", type=float, default=GnssConfig().min_cn0_dbhz, help="screening [dB-Hz]"
    )
    parser.add_argument("--live", action="store_true", help="without the smoother")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    out: dict[str, Any] = {}
    for name in arguments.only.split(","):
        experiment = {
            "simulated": simulated,
            "comma2k19": comma2k19,
            "fixes": fixes,
            "spirent": spirent,
        }[name]
        for label, result in experiment(arguments):
            out[label] = result
            if not arguments.json:
                show(label, result)
    if arguments.json:
        print(json.dumps(strict(out), allow_nan=False))


def simulated(arguments: argparse.Namespace) -> Iterable[tuple[str, dict[str, Any]]]:
    """Yield the simulated drives, one after the other in one comparison."""
    with tempfile.TemporaryDirectory() as folder:
        drives = []
        for seed in range(arguments.seeds):
            config = SimulationConfig(name=f"s{seed}", seed=seed, duration=arguments.duration)
            drives.append(load(simulate_folder(config, Path(folder) / f"s{seed}")))
        methods = LIVE if arguments.live else f"{LIVE},{SMOOTHED}"
        plain = configuration(arguments)
        found = compared(drives, methods, "60/180:2-3", plain, 1, arguments.jobs)
        yield "simulated GREAT urban, 60 s with 2–3 satellites", found


def comma2k19(arguments: argparse.Namespace) -> Iterable[tuple[str, dict[str, Any]]]:
    """Yield two and three satellites from second 10 on."""
    drive = load(arguments.data / "comma2k19-example1")
    for count in (2, 3):
        found = compared(
            [drive],
            LIVE if arguments.live else POSITIONS,
            f"10-end:{count}",
            # Ten seconds of satellites are too few for a certificate.
            configuration(arguments, method="level+course"),
            arguments.seeds,
            arguments.jobs,
        )
        yield f"comma2k19, {count} satellites from second 10 on", found


def fixes(arguments: argparse.Namespace) -> Iterable[tuple[str, dict[str, Any]]]:
    """Yield each recorded drive without raw GNSS, by length of the spells."""
    constrained = configuration(arguments, nhc="on")
    folders = sorted(p for p in (arguments.data / "oakville-drives").iterdir() if p.is_dir())
    for folder in (*folders, arguments.data / "rtklibexplorer-drive"):
        drive = load(folder)
        for duration in (15, 30, 60):
            spec = f"{duration}/{duration + 45}@0,{(duration + 45) // 3},{2 * (duration + 45) // 3}"
            try:
                found = compared([drive], FIXES, spec, constrained, 1, arguments.jobs)
            except NavError as error:
                found = {"not_available": str(error)}
            yield f"{folder.name}, {duration} s without GNSS", found


def spirent(arguments: argparse.Namespace) -> Iterable[tuple[str, dict[str, Any]]]:
    """Yield the full run, then two or three satellites."""
    drive = load(arguments.data / "instinct" / "spirent_dynamic")
    # Where nothing passes, as here, 'auto' levels too, after a hundred attempts.
    constrained = configuration(arguments, nhc="on", method="level+course")
    whole = evaluate(navigate(drive, constrained), drive)
    yield "Spirent, all satellites", {"errors": whole.metrics, "consistency": whole.consistency}
    methods = LIVE if arguments.live else f"{LIVE},{SMOOTHED}"
    spec = "60/180:2-3@0,60,120"
    seeds = arguments.seeds // 4 or 1
    found = compared([drive], methods, spec, constrained, seeds, arguments.jobs)
    yield "Spirent, 60 s with 2–3 satellites", found


def configuration(arguments: argparse.Namespace, nhc: str = "auto", method: str = "auto") -> Config:
    """Return the configuration of an experiment; `nhc` where the mounting is known all the same."""
    return from_tables(
        {
            "alignment": {"method": method},
            "gnss": {"min_cn0_dbhz": arguments.min_cn0},
            "vehicle": {"nhc": nhc},
        }
    )


def compared(
    drives: list[Sequence], methods: str, spec: str, config: Config, seeds: int, jobs: int
) -> dict[str, Any]:
    """Return the figures of a comparison, with the NEES test of its spells."""
    comparison = compare(
        drives, parse_methods(methods), parse_outages(spec), config, seeds=seeds, jobs=jobs
    )
    out = as_dict(comparison)
    for name in comparison.methods:
        out["methods"][name]["nees_test"] = nees_test(comparison, name)
        out["methods"][name]["spell_s"] = spell_lengths(comparison, name)
    return out


def spell_lengths(comparison: Comparison, method: str) -> list[float]:
    """Return how long the spells of a method's runs are [s]: where one was lost, until then."""
    return sorted(s.end - s.start for s in spells_of(comparison.of(method)))


def nees_test(comparison: Comparison, method: str) -> dict[str, Any]:
    """Return the mean NEES of position just before and at the end of spells, with 95 % bounds.

    Spells are minutes apart and taken as independent, which is what the bounds assume: n spells
    of 3 degrees of freedom.
    """
    spells: list[SpellFigures] = [s for run in comparison.of(method) for s in run.spells]
    before = np.array([s.nees_before for s in spells])
    end = np.array([s.nees_end for s in spells])
    n = int(np.isfinite(end).sum())
    if not n:
        return {}
    low, high = chi2.ppf([0.025, 0.975], 3 * n) / n
    return {
        "before": float(np.nanmean(before)),
        "end": float(np.nanmean(end)),
        "bounds": [float(low), float(high)],
        "spells": n,
    }


def show(label: str, result: dict[str, Any]) -> None:
    """Print one experiment as a table."""
    print(f"\n{label}", flush=True)
    if "methods" not in result:
        print(f"  {result}")
        return
    print(
        f"  {'method':24}{'spells':>7}{'drift median':>13}{'RMS':>9}{'95 %':>9}{'final median':>13}"
        f"{'heading':>9}{'NEES before':>12}{'end':>8}  (bounds)   NIS by kind"
    )
    for name, f in result["methods"].items():
        if f["drift_m"]["median"] is None:
            print(f"  {name:24}{why_no_figure(f)}")
            continue
        d, test = f["drift_m"], f["nees_test"]
        low, high = test["bounds"]
        heading = f["errors"]["heading_rms_deg"]
        nis = ", ".join(
            f"{kind} {u['nis_mean']:.2f}" for kind, u in f["updates"].items() if u["nis_mean"]
        )
        print(
            f"  {name:24}{f['spells']:7d}{d['median']:13.2f}{d['rms_of_maxima']:9.2f}"
            f"{d['p95']:9.2f}{f['final_error_m']['median']:13.2f}"
            f"{float('nan') if heading is None else heading:9.2f}"
            f"{test['before']:12.2f}{test['end']:8.2f}  ({low:.2f}–{high:.2f})  {nis}"
        )


def why_no_figure(f: dict[str, Any]) -> str:
    """Say why a method has no drift."""
    if length := f["spell_s"]:
        short = sum(each < 0.95 * length[-1] for each in length)
        return (
            f"no figure for all: {short} of {len(length)} runs were lost in their spell, the first "
            f"after {length[0]:.0f} of {length[-1]:.0f} s, and drift grows with time"
        )
    return str(f.get("not_available") or f.get("alignment_windows"))


if __name__ == "__main__":
    main()
