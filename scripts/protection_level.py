"""Do protection levels hold? Errors against levels over simulated drives, sound and with faults.

    python scripts/protection_level.py --seeds 2                          # tables on the screen
    python scripts/protection_level.py --seeds 2 --out docs/integrity.md  # the page's section
    python scripts/protection_level.py --figure stanford.png              # and a picture of it
    python scripts/protection_level.py --seeds 1 --worlds suburb --only orbit --smooth

Every second of every drive is held against its level (the truth is known); the share beyond it is
to be below the risk. What kσ alone would have held stands beside it. One fault in each run, for as
long as the drive lasts from its middle on, orbits from the beginning.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from certnav.datasets.great.writer import write_great
from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import NavError
from certnav.filters.rotation import FloatArray
from certnav.nav.config import Config
from certnav.nav.config_files import from_tables
from certnav.nav.engine.integrity.levels import factors
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate
from oracles import gnss_breaks as gnss

WORLDS = ("suburb", "urban", "canyon")
DURATION = 180.0
SECTION = "## Errors against levels"
COMMAND = "python scripts/protection_level.py --seeds {} --out docs/integrity.md"

Change = Callable[[Path], Sequence]


def orbit(anomaly: float, which: int = 0) -> Change:
    """Return a satellite shifted along its orbit in the navigation file."""

    def change(folder: Path) -> Sequence:
        gnss.ephemeris(anomaly, which)(folder, 0.0)
        return load(folder)

    return change


def satellite(metres: float, rate: float = 0.0) -> Change:
    """Return the most seen satellite wrong from the middle of the drive on."""

    def change(folder: Path) -> Sequence:
        sequence = load(folder)
        begin = sequence.inertial.time[0] + 0.5 * DURATION
        return gnss.wrong_satellite(metres, rate)(sequence, begin)

    return change


FAULTS: dict[str, Change] = {
    "none": load,
    "orbit 26 m": orbit(1e-6),
    "orbit 106 m": orbit(4e-6),
    "orbit 265 m": orbit(1e-5),
    "orbit 265 m, another satellite": orbit(1e-5, 3),
    "code 10 m": satellite(10.0),
    "code 30 m": satellite(30.0),
    "code 100 m": satellite(100.0),
    "code 300 m": satellite(300.0),
    "code 1000 m": satellite(1000.0),
    "Doppler 0.3 m/s": satellite(0.0, 0.3),
    "Doppler 1 m/s": satellite(0.0, 1.0),
}


@dataclass(frozen=True, eq=False)
class Seconds:
    """Errors, levels and kσ once a second, horizontal and vertical, shape (n, 2) [m]."""

    error: FloatArray
    level: FloatArray
    k_sigma: FloatArray


def seconds(sequence: Sequence, config: Config) -> Seconds:
    """Navigate, and return a row a second."""
    solution = navigate(sequence, config)
    found, track = evaluate(solution, sequence), solution.trajectory
    every = slice(None, None, max(round(1.0 / float(np.median(np.diff(found.time)))), 1))
    off, sigma = found.error_pos_n[every], found.sigma_pos_n[every]
    level = [np.interp(found.time[every], track.time, column) for column in track.protection.T]
    worst = np.column_stack([sigma[:, :2].max(axis=1), sigma[:, 2]])
    error = np.column_stack([np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])])
    return Seconds(
        error, np.column_stack(level), worst * np.array(factors(config.filter.protection_risk))
    )


def together(parts: list[Seconds]) -> Seconds:
    """Return the seconds of several drives as one."""
    names = ("error", "level", "k_sigma")
    return Seconds(*(np.vstack([getattr(p, name) for p in parts]) for name in names))


def run(
    worlds: list[str], faults: list[str], seeds: list[int], config: Config, work: Path
) -> dict[tuple[str, str], Seconds]:
    """Return the seconds by world and fault."""
    found: dict[tuple[str, str], list[Seconds]] = {}
    for world in worlds:
        for seed in seeds:
            folder = work / f"{world}-{seed}"
            write_great(
                simulate(SimulationConfig(world, seed, duration=DURATION, density=world)), folder
            )
            for fault in faults:
                copy = work / "copy"
                shutil.copytree(folder, copy)
                try:
                    made = seconds(FAULTS[fault](copy), config)
                    found.setdefault((world, fault), []).append(made)
                    print(f"{world} {seed} {fault}: {made.error.max(axis=0)}", file=sys.stderr)
                except NavError as error:
                    print(f"{world} {seed} {fault}: {error}", file=sys.stderr)
                finally:
                    shutil.rmtree(copy)
    return {key: together(parts) for key, parts in found.items()}


def table(found: dict[tuple[str, str], Seconds], risk: float) -> list[str]:
    """Return the table, and what it says on the whole."""
    lines = [
        "| world | fault | s | largest error H / V [m] | level H / V, median [m] | 95 % [m] | "
        "beyond level H / V | largest error / level H / V | beyond kσ H / V |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for (world, fault), s in found.items():
        columns = (
            [f"{v:.1f}" for v in s.error.max(axis=0)],
            [f"{v:.1f}" for v in np.median(s.level, axis=0)],
            [f"{v:.0f}" for v in np.percentile(s.level, 95, axis=0)],
            [f"{100.0 * v:.2g} %" for v in (s.error > s.level).mean(axis=0)],
            [f"{v:.2f}" for v in (s.error / s.level).max(axis=0)],
            [f"{100.0 * v:.2g} %" for v in (s.error > s.k_sigma).mean(axis=0)],
        )
        cells = " | ".join(" / ".join(pair) for pair in columns)
        lines.append(f"| {world} | {fault} | {len(s.error)} | {cells} |")
    whole = together(list(found.values()))
    beyond, alone = ((whole.error > part).sum(axis=0) for part in (whole.level, whole.k_sigma))
    count = len(whole.error)
    lines += [
        "",
        f"Of {count} s {beyond[0]} are beyond the horizontal level and {beyond[1]} beyond the "
        f"vertical one (kσ alone: {alone[0]} and {alone[1]}); at a risk of {risk:g} "
        f"{count * risk:.1f} would be allowed.",
    ]
    return lines


def draw(found: dict[tuple[str, str], Seconds], path: Path) -> None:
    """Draw the Stanford diagram: level over error, a dot a second; below the line it has failed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.6), layout="constrained")
    for k, (axes, name) in enumerate(
        zip(figure.subplots(1, 2), ("horizontal", "vertical"), strict=True)
    ):
        for fault, colour in ((False, "#0072b2"), (True, "#d55e00")):
            parts = [s for (_, f), s in found.items() if (f != "none") == fault]
            if not parts:
                continue
            s = together(parts)
            label = "one satellite wrong" if fault else "no fault"
            axes.loglog(np.maximum(s.error[:, k], 1e-2), s.level[:, k], ".", color=colour,
                        markersize=2.0, alpha=0.4, label=label, zorder=3 - fault)  # fmt: skip
        ends = np.array([1e-2, 2e3])
        axes.fill_between(ends, 1e-1, ends, color="#dcdfe4", linewidth=0.0, zorder=0)
        axes.set(
            xlim=ends, ylim=(0.3, 2e3), xlabel=f"{name} error [m]",
            ylabel="protection level [m]", title=name,
        )  # fmt: skip
        axes.legend(loc="lower left", markerscale=4.0)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Make the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", type=int, default=1, metavar="N")
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--worlds", default=",".join(WORLDS))
    parser.add_argument("--only", default="", metavar="TEXT", help="faults with this in their name")
    parser.add_argument("--risk", type=float, default=Config().filter.protection_risk)
    parser.add_argument("--smooth", action="store_true")
    parser.add_argument("--out", type=Path, metavar="PAGE")
    parser.add_argument("--figure", type=Path, metavar="PNG")
    arguments = parser.parse_args()
    config = from_tables({
        "filter": {"protection_risk": arguments.risk, "smooth": arguments.smooth},
    })  # fmt: skip
    seeds = list(range(arguments.first, arguments.first + arguments.seeds))
    faults = [name for name in FAULTS if arguments.only in name]
    with tempfile.TemporaryDirectory() as work:
        found = run(arguments.worlds.split(","), faults, seeds, config, Path(work))
    lines = table(found, arguments.risk)
    if arguments.figure is not None:
        draw(found, arguments.figure)
    if arguments.out is None:
        print("\n".join(lines))
        return
    command = COMMAND.format(arguments.seeds)
    head = [
        SECTION, "",
        f"Made by `{command}` ({arguments.seeds} simulated drives of {DURATION:.0f} s a row). H is "
        "horizontal, V vertical; *beyond* is the share of seconds with a larger error.", "",
    ]  # fmt: skip
    page = arguments.out.read_text(encoding="utf-8")
    before, _, rest = page.partition(SECTION)
    after = rest[rest.index("\n## ") :] if "\n## " in rest else ""
    arguments.out.write_text(before + "\n".join([*head, *lines]) + "\n" + after, encoding="utf-8")


if __name__ == "__main__":
    main()
