"""`certnav simulate`: a city drive in the GREAT layout."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "simulate a city drive and write it in the GREAT layout"
DESCRIPTION = (
    "Simulate a car in a city: RINEX observations and navigation, IMU text and "
    "reference in the layout of the GREAT dataset, readable by `certnav run`."
)
EXAMPLE = "certnav simulate --out drive --duration 300"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav simulate`` to its parser."""
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=600.0, metavar="S", help="[s]")
    parser.add_argument("--density", default="urban", help="open, suburb, urban or canyon [urban]")
    parser.add_argument("--imu", default="adis16470", help="IMU preset [adis16470]")
    parser.add_argument("--moving-start", action="store_true", help="begin at cruising speed")
    parser.add_argument("--exact", action="store_true", help="no noise, no reflections")
    parser.add_argument(
        "--base-distance", type=float, metavar="M", help="also a base station, so far away [m]"
    )
    parser.add_argument("--overwrite", action="store_true")


def run(arguments: argparse.Namespace) -> None:
    """Simulate, and say how to navigate it."""
    from ...datasets.great.writer import simulate_folder
    from ...datasets.simulation.simulator import SimulationConfig
    from .terminal.progress import progress

    config = SimulationConfig(
        name=arguments.out.name,
        seed=arguments.seed,
        duration=arguments.duration,
        density=arguments.density,
        imu=arguments.imu,
        moving_start=arguments.moving_start,
        noise=not arguments.exact,
        base_distance_m=arguments.base_distance,
    )
    with progress() as report:
        report(0.0, "simulating")
        folder = simulate_folder(config, arguments.out, overwrite=arguments.overwrite)
    print(f"{folder}: {config.duration:.0f} s of simulated driving; navigate it with")
    print(f"  certnav run {folder}")
