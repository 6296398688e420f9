"""The drives that `consistency.py` judges the covariance on, and how good their references are.

Simulated ones have the truth as reference. References of recordings have errors of their own; what
is documented of them, or was measured, is added to the solution's covariance (`Judged`).
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from certnav.datasets.great.writer import write_great
from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.nav.commands.demo import DURATION as DEMO_DURATION
from certnav.nav.commands.demo import SEED as DEMO_SEED
from certnav.nav.spells.degradation import degrade
from certnav.nav.spells.outages import parse_outages

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("CERTNAV_DATA", ROOT.parent / "shared" / "data"))
DURATION = 180.0
#: Share of the variance of 'lasting fixes' that lasts, and how long [s].
SHARE, LASTS = 0.9, 20.0
#: Of 'few satellites': two or three of a suburb's, 60 s in every 90 s.
FEW = "60/90:2-3"
WORLDS = {
    "white fixes": "positions (1, 1, 2 m) and velocities (5 cm/s) with white errors",
    "lasting fixes": "the same, 90 % of the positions' variance lasting 20 s",
    "suburb": "single-point positions and Doppler, few reflections",
    "urban": "the same between tall buildings",
    "canyon": "the same between the tallest",
    "few satellites": "a suburb with two or three satellites for 60 s in every 90 s",
    "demo": "the drive of `certnav demo`, 600 s between tall buildings",
}


@dataclass(frozen=True)
class Judged:
    """A recording, and what its reference is worth.

    Parameters
    ----------
    folder : str
        In the shared data.
    position, velocity : float
        1σ per axis of the reference [m], [m/s].
    heading : float
        1σ [deg].
    lever : float
        1σ per axis of the way from the IMU to the point it follows [m]; where both turn at ω, its
        velocity is uncertain by ω × lever.
    turned : bool
        Whether its axes may be another box's: a constant rotation is taken out of the heading.
    outages : str
        Satellites taken away.
    why : str
        Where these figures are from.
    """

    folder: str
    position: float = 0.0
    velocity: float = 0.0
    heading: float = 0.0
    lever: float = 0.0
    turned: bool = False
    outages: str = ""
    why: str = ""


_COMMA = Judged(
    "comma2k19-example1", lever=1.0, turned=True,
    why="follows a camera whose place and attitude against the IMU are not documented: 1 m per "
    "axis, a constant rotation taken out",
)  # fmt: skip
RECORDINGS = {
    "comma2k19": _COMMA,
    "comma2k19, 2–3 satellites": dataclasses.replace(_COMMA, outages="20-end:2-3"),
    "Spirent": Judged("instinct/spirent_dynamic", why="the simulator's own, exact"),
    "Tokyo": Judged(
        "tumsat-tsukishima", position=0.05, velocity=0.15, lever=1.0,
        why="RTK with resolved ambiguities, 5 cm; velocities are differences over 0.4 s, 0.15 m/s; "
        "the antenna's place is not documented, 1 m per axis",
    ),
    "rtklibexplorer": Judged(
        "rtklibexplorer-drive", position=0.01, velocity=0.04,
        why="the very positions that are navigated with: no test of the covariance",
    ),
    "Oakville medium": Judged(
        "oakville-drives/urban-medium-turn-loop-nominal-001",
        position=0.5, velocity=0.2, heading=0.48, lever=0.5, turned=True,
        why="the receiver's fused solution, from which its own fixes differ by 0.4 … 0.6 m and "
        "0.15 … 0.23 m/s (RMS per axis), its velocities 0.1 s late; its yaw departs from the "
        "integrated gyro by 0.68° in 15 s (RMS), 0.48° an end; another mounting",
    ),
}  # fmt: skip


def drives(name: str, seeds: range, work: Path) -> Iterator[Sequence]:
    """Yield the drives of a world, or the recording of that name."""
    if name in RECORDINGS:
        recording = RECORDINGS[name]
        whole = load(DATA / recording.folder)
        yield weakened(whole, recording.outages) if recording.outages else whole
        return
    for seed in seeds:
        yield drive(name, seed, work)


def weakened(sequence: Sequence, spec: str, seed: int = 0) -> Sequence:
    """Return the sequence with satellites taken away."""
    outages, time = parse_outages(spec), sequence.inertial.time
    spells = outages.spells(time[0], time[-1], time[0] + 20.0)
    return degrade(sequence, spells, outages, seed=seed)


def drive(world: str, seed: int, work: Path) -> Sequence:
    """Return a simulated drive of a world; its reference is the truth of the IMU."""
    if world in ("white fixes", "lasting fixes"):
        return _fixes(world, seed)
    density = {"demo": "urban", "few satellites": "suburb"}.get(world, world)
    config = SimulationConfig(name=world, seed=seed, duration=DURATION, density=density)
    if world == "demo":
        config = dataclasses.replace(config, seed=DEMO_SEED + seed, duration=DEMO_DURATION)
    simulation = simulate(config)
    folder = work / f"{world}-{seed}"
    write_great(simulation, folder)
    sequence = dataclasses.replace(load(folder), reference=simulation.reference)
    return weakened(sequence, FEW, seed) if world == "few satellites" else sequence


def _fixes(world: str, seed: int) -> Sequence:
    """Return a drive in the open with positions of 1, 1, 2 m."""
    config = SimulationConfig(name=world, seed=seed, duration=DURATION, density="open")
    made, rng = simulate(config), np.random.default_rng([12, seed])
    time = np.arange(config.start_time + 1.0, config.start_time + DURATION)
    place = made.trajectory, time, config.lever_antenna_b
    fixes = fixes_from_truth(*place, (1.0, 1.0, 2.0), 0.05, rng)
    if world == "lasting fixes":
        exact = fixes_from_truth(*place, (1e-6, 1e-6, 1e-6), 0.05, rng)
        b, fade = rng.standard_normal((time.size, 3)), np.exp(-1.0 / LASTS)
        for k in range(1, time.size):
            b[k] = fade * b[k - 1] + np.sqrt(1.0 - fade**2) * b[k]
        e = np.sqrt(SHARE) * b + np.sqrt(1.0 - SHARE) * rng.standard_normal(b.shape)
        off = np.einsum("nij,nj->ni", C_en_of(exact.pos_e), e * [1.0, 1.0, 2.0])
        fixes = dataclasses.replace(fixes, pos_e=exact.pos_e + off)
    return dataclasses.replace(made.sequence(fixes), observations=None)
