"""Is the covariance honest? NEES and NIS over simulated drives, innovations of real ones.

    python scripts/consistency.py --seeds 8        # tables on the screen
    python scripts/consistency.py --seeds 8 --out docs/consistency.md \\
        --figure docs/figures/consistency.png
    python scripts/consistency.py --json

NEES is eᵀP⁻¹e against the simulated truth once a second: 3 is right for three components, and the
mean over N drives lies inside χ²(3N)/N nineteen times in twenty. NIS per degree of freedom is 1
where model and noise are right; its root is the factor by which innovations exceed their σ. Real
recordings (CERTNAV_DATA) have no truth of that accuracy: their innovations are judged alone.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from certnav.datasets.great.writer import write_great
from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.datasets.series import Reference
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.filters.rotation import FloatArray, matrix_from_rpy
from certnav.nav.config_files import from_tables
from certnav.nav.evaluation.interpolation import interpolate
from certnav.nav.pipeline import navigate
from certnav.nav.solution import Solution, Trajectory, Update

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("CERTNAV_DATA", ROOT.parent / "shared" / "data"))
REAL = {
    "comma2k19": "comma2k19-example1",
    "rtklibexplorer": "rtklibexplorer-drive",
    "Oakville medium": "oakville-drives/urban-medium-turn-loop-nominal-001",
    "Oakville long": "oakville-drives/urban-long-turn-loop-nominal-001",
    "Spirent": "instinct/spirent_dynamic",
}
#: How a drive starts is not the question.
CONFIG = from_tables({"alignment": {"method": "level+course"}})
DURATION, SETTLED = 180.0, 20.0
PARTS = ("position", "velocity", "attitude")
WORLDS = {
    "white fixes": "positions (1, 1, 2 m) and velocities (5 cm/s) with white errors of known σ",
    "suburb": "single-point positions and Doppler, few reflections",
    "urban": "the same between tall buildings",
}
#: Heading of the section that is written by hand.
SECTION = "## What it says"
COMMAND = (
    "python scripts/consistency.py --seeds {seeds} --out docs/consistency.md "
    "--figure docs/figures/consistency.png"
)


@dataclass(frozen=True, eq=False)
class World:
    """NEES of several drives of one kind, and their innovations.

    Attributes
    ----------
    nees : dict of ndarray, shape (drives, seconds)
        By `PARTS`; NaN where there is no solution.
    innovations : dict of Innovations
        By kind of update.
    """

    nees: dict[str, FloatArray]
    innovations: dict[str, Innovations]

    def mean(self, part: str) -> float:
        """Return the mean NEES."""
        return float(np.nanmean(self.nees[part]))

    def inside(self, part: str) -> float:
        """Return the share of seconds at which the mean of the drives is inside 95 % bounds."""
        counted = np.isfinite(self.nees[part]).sum(axis=0)
        some = counted > 0
        mean = np.nansum(self.nees[part][:, some], axis=0) / counted[some]
        low, high = bounds(3 * counted[some])
        return float(((mean / 3.0 > low) & (mean / 3.0 < high)).mean())


@dataclass(frozen=True)
class Innovations:
    """Normalised innovations of one kind of update.

    Attributes
    ----------
    count, dof : int
        Updates tested, and components in all.
    rms : float
        Root of NIS per degree of freedom of all that were tested: 1 is right.
    typical : float
        The same from the median, which a few gross errors do not move.
    refused : float
        Share that failed the test.
    correlation : float
        Between neighbours of the same component: 0 where errors are white.
    """

    count: int
    dof: int
    rms: float
    typical: float
    refused: float
    correlation: float

    @property
    def verdict(self) -> str:
        """What it says about the σ that were used."""
        low, high = np.sqrt(bounds(self.dof / 2.0))  # a median scatters more than a mean
        if low <= self.typical <= high:
            said = "right"
        elif self.typical < 1.0:
            said = f"too large by {1.0 / self.typical:.1f}"
        else:
            said = f"too small by {self.typical:.1f}"
        return said + (", errors last" if self.correlation > 0.3 else "")


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
    # a ratio of medians, at the dof that is usual
    usual = int(np.median(dof))
    typical = np.median(nis[dof == usual]) / chi2.median(usual)
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
        len(tested), int(dof.sum()), float(np.sqrt(nis.sum() / dof.sum())),
        float(np.sqrt(typical)), float(np.mean([bool(u.reason) for u in tested])), correlation,
    )  # fmt: skip


def nees(track: Trajectory, reference: Reference, time: FloatArray) -> dict[str, FloatArray]:
    """Return NEES of position, velocity and attitude at some reference times, shape (n,)."""
    row = np.searchsorted(reference.time, time - 1e-6)
    inside = (time >= track.time[0] + SETTLED) & (time <= track.time[-1])
    at = interpolate(track, reference.time[row[inside]])
    pos_e, vel_e = reference.pos_e[row[inside]], reference.vel_e[row[inside]]
    C_en = C_en_of(pos_e)
    C_nb = matrix_from_rpy(reference.rpy[row[inside]])
    estimated = np.swapaxes(C_en, 1, 2) @ at.C_eb
    errors = (
        np.einsum("nji,nj->ni", C_en, pos_e - at.pos_e),
        np.einsum("nji,nj->ni", C_en, vel_e - at.vel_e),
        Rotation.from_matrix(C_nb @ np.swapaxes(estimated, 1, 2)).as_rotvec(),
    )
    out = {}
    for part, error, cov in zip(
        PARTS, errors, (at.cov_pos_n, at.cov_vel_n, at.cov_att_n), strict=True
    ):
        out[part] = np.full(time.size, np.nan)
        solved = np.linalg.solve(cov, error[..., None])[..., 0]
        out[part][inside] = np.sum(error * solved, axis=1)
    return out


def drive(world: str, seed: int, work: Path) -> Sequence:
    """Return a simulated drive of a world; its reference is the truth of the IMU."""
    density = "open" if world == "white fixes" else world
    config = SimulationConfig(name=world, seed=seed, duration=DURATION, density=density)
    simulation = simulate(config)
    if world != "white fixes":
        folder = work / f"{world}-{seed}"
        write_great(simulation, folder)
        return dataclasses.replace(load(folder), reference=simulation.reference)
    time = np.arange(config.start_time + 1.0, config.start_time + DURATION)
    fixes = fixes_from_truth(
        simulation.trajectory, time, config.lever_antenna_b, (1.0, 1.0, 2.0), 0.05,
        np.random.default_rng([9, seed]),
    )  # fmt: skip
    return dataclasses.replace(simulation.sequence(fixes), observations=None)


def simulated(world: str, seeds: int, work: Path) -> World:
    """Navigate drives of one world and compare them with the truth."""
    seconds, log = [], []
    for seed in range(seeds):
        sequence = drive(world, seed, work)
        solution: Solution = navigate(sequence, CONFIG)
        assert sequence.reference is not None
        time = np.ceil(sequence.reference.time[0]) + np.arange(1.0, DURATION - 1.0)
        seconds.append(nees(solution.trajectory, sequence.reference, time))
        log += solution.updates
        print(f"{world}, drive {seed}", file=sys.stderr)
    stacked = {part: np.array([s[part] for s in seconds]) for part in PARTS}
    return World(stacked, innovations(tuple(log)))


def real() -> dict[str, dict[str, Innovations]]:
    """Return the innovations of the real recordings at hand."""
    out = {}
    for name, folder in REAL.items():
        if (DATA / folder).is_dir():
            out[name] = innovations(navigate(load(DATA / folder), CONFIG).updates)
            print(name, file=sys.stderr)
    return out


def by_hand(old: str) -> str:
    """Return the section of a page that is written by hand, to be kept."""
    found = old.find(SECTION)
    return "\n" + old[found:] if found >= 0 else ""


def page(
    worlds: dict[str, World], recordings: dict[str, dict[str, Innovations]], seeds: int
) -> str:
    """Return the page."""
    lines = [
        "# Is the covariance honest?", "", f"Made by `{COMMAND.format(seeds=seeds)}`.", "",
        "![NEES over time with 95 % bounds, and innovations by kind](figures/consistency.png)", "",
        "A filter states its accuracy with every epoch; two figures test whether to believe it. "
        "NEES is the square of the error in units of the stated σ, summed over three components: "
        "it needs the truth. NIS is the same of an innovation, the difference between a "
        "measurement and its prediction: it needs none.", "",
        f"## NEES, {seeds} simulated drives of {DURATION:.0f} s each", "",
        f"Against the truth, from {SETTLED:.0f} s after alignment on. 3 is right; above, errors "
        "are larger than the covariance says, below, smaller. *Inside*: share of seconds at which "
        "the mean of the drives lies within the 95 % bounds of χ²; 95 % is right.", "",
        "| world | " + " | ".join(f"{part} | inside" for part in PARTS) + " |",
        "|---|" + "---|---|" * len(PARTS),
    ]  # fmt: skip
    for name, world in worlds.items():
        cells = (f"{world.mean(p):.2g} | {100 * world.inside(p):.0f} %" for p in PARTS)
        lines.append(f"| {name}: {WORLDS[name]} | " + " | ".join(cells) + " |")
    lines += [
        "", "## Innovations", "",
        "By kind of update: RMS of the normalised innovations, the same from the median, share "
        "refused by the test, correlation with the next one. *σ* is what the median says about "
        "the σ of prediction and measurement together, against the 95 % bounds of χ² for white "
        "errors.", "",
        "| | update | number | RMS | typical | refused | correlation | σ |",
        "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    every = {name: world.innovations for name, world in worlds.items()} | recordings
    for name, kinds in every.items():
        for kind, i in kinds.items():
            correlation = "–" if np.isnan(i.correlation) else f"{i.correlation:.2f}"
            lines.append(
                f"| {name} | {kind} | {i.count} | {i.rms:.2f} | {i.typical:.2f} | "
                f"{100 * i.refused:.1f} % | {correlation} | {i.verdict} |"
            )
    return "\n".join(lines) + "\n"


def draw(
    worlds: dict[str, World], recordings: dict[str, dict[str, Innovations]], file: Path
) -> None:
    """Draw NEES over time, and the innovations of all kinds."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    colours = dict(zip(WORLDS, ("#009E73", "#0072B2", "#D55E00"), strict=True))
    styles = dict(zip(WORLDS, ("-", "--", ":"), strict=True))
    figure, axes = plt.subplots(
        4, 1, figsize=(8.5, 10.0), layout="constrained",
        gridspec_kw={"height_ratios": [1, 1, 1, 1.6]},
    )  # fmt: skip
    for panel, part in zip(axes[:3], PARTS, strict=True):
        drives = 0
        for name, world in worlds.items():
            values = world.nees[part]
            drives = max(drives, len(values))
            known = np.isfinite(values).any(axis=0)
            mean = np.full(values.shape[1], np.nan)
            mean[known] = np.nanmean(values[:, known], axis=0)
            panel.plot(mean, styles[name], color=colours[name], label=name, lw=1.3)
        low, high = bounds(3 * drives)
        panel.axhspan(3 * low, 3 * high, color="#DCDFE4", zorder=0, label="95 % of χ²")
        panel.axhline(3.0, color="#8A8F98", lw=0.8, zorder=1)
        panel.set_ylim(0.01, 60.0)
        panel.set(yscale="log", ylabel=f"NEES of {part} [–]")
    axes[0].legend(ncols=4, frameon=False, fontsize=8, loc="upper center",
                   bbox_to_anchor=(0.5, 1.25))  # fmt: skip
    axes[2].set_xlabel("time since the start of the drive [s]")
    every = {name: world.innovations for name, world in worlds.items()} | recordings
    kinds = sorted({kind for found in every.values() for kind in found})
    panel = axes[3]
    markers = "osD^vP*X"
    palette = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#56B4E9", "#CC79A7", "#000000")
    for k, kind in enumerate(kinds):
        rows = [(n, found[kind].typical) for n, found in enumerate(every.values()) if kind in found]
        x = [n + 0.1 * (k - (len(kinds) - 1) / 2) for n, _ in rows]
        panel.plot(x, [v for _, v in rows], markers[k], color=palette[k], label=kind, ms=6)
    panel.axhline(1.0, color="#8A8F98", lw=1.0)
    panel.set_xticks(range(len(every)), list(every), rotation=20, ha="right")
    panel.set(yscale="log", ylabel="typical innovation [σ]")
    panel.legend(ncols=4, frameon=False, fontsize=8)
    for panel in axes:
        panel.yaxis.set_major_formatter(matplotlib.ticker.StrMethodFormatter("{x:g}"))
        panel.yaxis.set_minor_formatter(matplotlib.ticker.NullFormatter())
        panel.grid(color="#E4E7EB", lw=0.6)
        panel.spines[["top", "right"]].set_visible(False)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=110)
    plt.close(figure)


def as_dict(
    worlds: dict[str, World], recordings: dict[str, dict[str, Innovations]]
) -> dict[str, object]:
    """Return all figures as plain types."""

    def plain(found: dict[str, Innovations]) -> dict[str, dict[str, object]]:
        return {k: dataclasses.asdict(i) | {"sigma": i.verdict} for k, i in found.items()}

    return {
        "nees": {
            name: {p: {"mean": w.mean(p), "inside": w.inside(p)} for p in PARTS}
            for name, w in worlds.items()
        },
        "innovations": {name: plain(w.innovations) for name, w in worlds.items()}
        | {name: plain(found) for name, found in recordings.items()},
    }


def main() -> int:
    """Print or write tables and figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4, metavar="N", help="drives a world [4]")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--no-real", action="store_true", help="simulated drives only")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the page there")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the figure (PNG)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        worlds = {name: simulated(name, arguments.seeds, Path(work)) for name in WORLDS}
    recordings = {} if arguments.no_real else real()
    if arguments.figure is not None:
        draw(worlds, recordings, arguments.figure)
    if arguments.json:
        print(json.dumps(as_dict(worlds, recordings), indent=2, default=float))
    elif arguments.out is not None:
        old = arguments.out.read_text(encoding="utf-8") if arguments.out.exists() else ""
        new = page(worlds, recordings, arguments.seeds) + by_hand(old)
        arguments.out.write_text(new, encoding="utf-8")
    else:
        print(page(worlds, recordings, arguments.seeds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
