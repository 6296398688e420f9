"""Positions as declared and as fits the recording: NEES, NIS and errors, of filter and smoother.

    python scripts/fitted_noise.py --seeds 20                  # all worlds and recordings
    python scripts/fitted_noise.py --seeds 20 --only suburb urban

NEES of position, velocity and attitude (3 is right), mean over all seconds from 20 s after the
start on, and over all drives of a world; in brackets the 3-D RMS of the positions. References of
recordings are no truths: their own errors count as the solution's. Seeds begin at 0; what the rule
was tried on began at 100.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from consistency import DATA, DURATION, PARTS, REAL, drive, innovations, nees

from certnav.datasets.great.writer import write_great
from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.filters.errors import AlignmentError
from certnav.filters.rotation import FloatArray
from certnav.nav.config_files import from_tables
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate

#: Recordings, and halves of one.
RECORDINGS = {**REAL, "comma2k19, halves": REAL["comma2k19"]}
WORLDS = ("white fixes", "lasting fixes", "suburb", "urban", "canyon", "demo")
#: Share of the variance of 'lasting fixes' that lasts, and how long [s].
SHARE, LASTS = 0.9, 20.0


@dataclasses.dataclass(frozen=True)
class Figures:
    """Of one run: NEES by part, mean square of the position error, NIS per degree of freedom."""

    nees: tuple[float, ...]
    square: float
    nis: float
    found: str


def lasting(seed: int) -> Sequence:
    """Return a drive in the open with positions of 1, 1, 2 m whose errors last."""
    config = SimulationConfig(name="lasting", seed=seed, duration=DURATION, density="open")
    made = simulate(config)
    rng = np.random.default_rng([12, seed])
    time = np.arange(config.start_time + 1.0, config.start_time + DURATION)
    fixes = fixes_from_truth(
        made.trajectory, time, config.lever_antenna_b, (1.0, 1.0, 2.0), 0.05, rng
    )
    exact = fixes_from_truth(
        made.trajectory, time, config.lever_antenna_b, (1e-6, 1e-6, 1e-6), 0.05, rng
    )
    b, fade = rng.standard_normal((time.size, 3)), np.exp(-1.0 / LASTS)
    for k in range(1, time.size):
        b[k] = fade * b[k - 1] + np.sqrt(1.0 - fade**2) * b[k]
    e = np.sqrt(SHARE) * b + np.sqrt(1.0 - SHARE) * rng.standard_normal(b.shape)
    pos_e = exact.pos_e + np.einsum("nij,nj->ni", C_en_of(exact.pos_e), e * [1.0, 1.0, 2.0])
    return dataclasses.replace(
        made.sequence(dataclasses.replace(fixes, pos_e=pos_e)), observations=None
    )


def demo(seed: int, work: Path) -> Sequence:
    """Return the drive of ``certnav demo``, or the same with another seed."""
    from certnav.nav.commands.demo import DURATION as LENGTH
    from certnav.nav.commands.demo import SEED

    made = simulate(SimulationConfig(name="demo", seed=SEED + seed, duration=LENGTH))
    write_great(made, work / f"demo-{seed}")
    return dataclasses.replace(load(work / f"demo-{seed}"), reference=made.reference)


def sequences(name: str, seeds: int, work: Path) -> Iterator[Sequence]:
    """Yield the drives of a world, or the recording of that name, whole and cut."""
    if name in RECORDINGS:
        whole = load(DATA / RECORDINGS[name])
        if not name.endswith("halves"):
            yield whole
            return
        time = whole.inertial.time
        for begin, end in itertools.pairwise((time[0], time[time.size // 2], time[-1])):
            yield whole.between(begin, end)
        return
    for seed in range(seeds):
        if name == "lasting fixes":
            yield lasting(seed)
        elif name == "demo":
            yield demo(seed, work)
        else:
            yield drive(name, seed, work)


def figures(sequence: Sequence, noise: str, smooth: bool) -> Figures:
    """Navigate, and compare with the reference."""
    solution = navigate(
        sequence,
        from_tables({
            "alignment": {"method": "level+course"},
            "filter": {"smooth": smooth},
            "gnss": {"position_noise": noise},
        }),
    )  # fmt: skip
    reference = sequence.reference
    assert reference is not None
    track = solution.trajectory
    time = reference.time[(reference.time > track.time[0]) & (reference.time < track.time[-1])]
    time = time[:: max(1, round(1.0 / max(float(np.median(np.diff(time))), 1e-3)))]
    by_part = nees(track, reference, time)
    evaluation = evaluate(solution, sequence)
    late = evaluation.time > track.time[0] + 20.0
    error: FloatArray = evaluation.error_pos_n[late]
    nis = innovations(solution.updates)
    found = solution.fix_errors
    said = "" if found is None else f"{found.scale:.2g} {found.share:.2f} {found.correlation_s:.0f}"
    return Figures(
        tuple(float(np.nanmean(by_part[part])) for part in PARTS),
        float(np.mean(np.sum(error**2, axis=1))),
        nis["position"].rms ** 2 if "position" in nis else np.nan,
        said or "declared",
    )


def cell(runs: list[Figures], part: int) -> str:
    """Return the mean NEES of a part."""
    return f"{np.nanmean([run.nees[part] for run in runs]):.3g}"


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4, metavar="N", help="drives a world [4]")
    parser.add_argument("--only", nargs="+", choices=[*WORLDS, *RECORDINGS], metavar="NAME")
    arguments = parser.parse_args()
    print("| | | " + " | ".join(PARTS) + " | 3-D RMS [m] | NIS of positions | found |")
    print("|---|---|" + "---|" * (len(PARTS) + 3))
    for name in arguments.only or [*WORLDS, *RECORDINGS]:
        if name in RECORDINGS and not (DATA / RECORDINGS[name]).is_dir():
            continue
        runs: dict[tuple[bool, str], list[Figures]] = {}
        with tempfile.TemporaryDirectory() as work:
            for sequence in sequences(name, arguments.seeds, Path(work)):
                try:
                    for smooth, noise in itertools.product((False, True), ("declared", "fitted")):
                        made = figures(sequence, noise, smooth)
                        runs.setdefault((smooth, noise), []).append(made)
                except AlignmentError as error:  # at the first of them: all start alike
                    print(f"{name}: no start, left out: {error}", file=sys.stderr)
                    continue
                print(f"{name}: {sequence.name}", file=sys.stderr)
        for smooth, what in ((False, "filter"), (True, "smoother")):
            before, after = runs[smooth, "declared"], runs[smooth, "fitted"]
            cells = [f"{cell(before, k)} → {cell(after, k)}" for k in range(len(PARTS))]
            cells += [
                " → ".join(
                    f"{np.sqrt(np.mean([r.square for r in x])):.2f}" for x in (before, after)
                ),
                " → ".join(f"{np.nanmean([r.nis for r in x]):.2g}" for x in (before, after)),
                after[0].found,
            ]
            print(f"| {name} | {what} | " + " | ".join(cells) + " |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
