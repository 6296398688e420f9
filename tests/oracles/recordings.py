"""Sound recordings by name: a simulated drive in the GREAT layout, and real ones."""

from __future__ import annotations

import os
from pathlib import Path

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.simulation.simulator import SimulationConfig

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("CERTNAV_DATA", ROOT.parent / "shared" / "data"))
#: Real recordings by the name used in tables, as folders of CERTNAV_DATA.
REAL = {
    "comma2k19": "comma2k19-example1",
    "rtklibexplorer": "rtklibexplorer-drive",
    "Oakville figure 8": "oakville-drives/parking-lot-figure8-nominal-001",
    "Oakville long": "oakville-drives/urban-long-turn-loop-nominal-001",
    "Oakville": "oakville-drives/urban-medium-turn-loop-nominal-001",
    "Spirent": "instinct/spirent_dynamic",
}
SIMULATED = "simulated GREAT"


def simulate_base(folder: Path, duration: float = 300.0) -> Path:
    """Simulate the drive most faults are done to."""
    config = SimulationConfig(name="base", seed=3, duration=duration, density="suburb")
    return simulate_folder(config, folder)


def base_folder(name: str, work: Path) -> Path | None:
    """Return the sound recording of that name, simulated when it is; None where absent."""
    if name == SIMULATED:
        folder = work / "base"
        return folder if folder.exists() else simulate_base(folder)
    folder = DATA / REAL[name]
    return folder if folder.is_dir() else None
