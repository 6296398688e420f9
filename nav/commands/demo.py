"""`certnav demo`: simulate a drive, navigate it, and say where the report is."""

from __future__ import annotations

import argparse
from pathlib import Path

#: A drive between tall buildings, long enough for satellites to come and go.
SEED, DURATION = 2, 600.0

HELP = "simulate a drive, navigate it, and say where the report is"
DESCRIPTION = "Simulate a city drive in the GREAT layout, navigate it, write the report."
EXAMPLE = "certnav demo"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav demo`` to its parser."""
    parser.add_argument("--out", type=Path, default=Path("results/demo"), metavar="DIR")


def run(arguments: argparse.Namespace) -> None:
    """Simulate a drive in the GREAT layout and navigate it."""
    from ...datasets.great.writer import simulate_folder
    from ...datasets.simulation.simulator import SimulationConfig
    from ..config import Config
    from ..results.directory import check_replaceable
    from .flow.navigation import navigate_folder

    out: Path = arguments.out
    check_replaceable(out)  # before a minute is spent on it
    drive = out.parent / f"{out.name}-drive"
    config = SimulationConfig(name="demo", seed=SEED, duration=DURATION)
    print(f"simulating {DURATION:.0f} s of city driving in the GREAT layout → {drive}")
    simulate_folder(config, drive, overwrite=True)
    navigate_folder(drive, Config(), out)
