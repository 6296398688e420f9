"""`certnav simulate`: a city drive in the GREAT layout."""

from __future__ import annotations

import argparse

from ...datasets.great.writer import simulate_folder
from ...datasets.simulation.simulator import SimulationConfig
from .progress import progress


def simulate(arguments: argparse.Namespace) -> None:
    """Simulate, and say how to navigate it."""
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
