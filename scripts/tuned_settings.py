"""Tune on each recording, then run every other one with the settings found and without.

    python scripts/tuned_settings.py [--data DIR] [--duration 300] [--longest 300] [--only A,B]

The recordings: comma2k19 and Tokyo (CERTNAV_DATA) and four simulated drives in the GREAT layout.
Where tuning keeps the default there is nothing to run. Differences are of the horizontal RMS, with
the interval of `nav.tune.choice` over blocks of time.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.nav.config import Config
from certnav.nav.tune.choice import Group, change
from certnav.nav.tune.settings import OUTAGES, interval, tune_settings
from certnav.nav.tune.trials import prepare, try_out

REAL = {"comma2k19": "comma2k19-example1", "Tokyo": "tumsat-tsukishima"}
SIMULATED = {"suburb": 21, "urban": 22, "urban, again": 23, "canyon": 24}


def recordings(
    data: Path, work: Path, duration: float, longest: float
) -> Iterator[tuple[str, Sequence]]:
    """Yield the recordings that are there."""
    for name, folder in REAL.items():
        if (data / folder).is_dir():
            drive = load(data / folder)
            begin, end = drive.span
            yield name, drive.between(begin, min(end, begin + longest))
    for name, seed in SIMULATED.items():
        density = name.split(",")[0]
        config = SimulationConfig(f"{density}-{seed}", seed, duration, density=density)
        yield name, load(simulate_folder(config, work / config.name))


def main() -> None:
    """Tune, run, and print what changed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(os.environ.get("CERTNAV_DATA", "../shared/data"))
    parser.add_argument("--data", type=Path, default=default)
    parser.add_argument("--duration", type=float, default=300.0, help="of a simulated drive [s]")
    parser.add_argument("--longest", type=float, default=300.0, help="of a real one [s]")
    parser.add_argument("--only", default="", metavar="LIST", help="tune on these recordings")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        drives = dict(recordings(arguments.data, Path(work), arguments.duration, arguments.longest))
        for name in arguments.only.split(",") if arguments.only else drives:
            found = tune_settings([drives[name]], jobs=arguments.jobs)
            print(f"{name}: {found.candidates[found.chosen].name}. {found.decided}", flush=True)
            if found.config == Config():
                continue
            for other, sequence in drives.items():
                if other != name:
                    print(f"  {other}: {compared(sequence, found.config)}", flush=True)


def compared(sequence: Sequence, config: Config) -> str:
    """Return the horizontal RMS without and with settings, as recorded and in spells."""
    ready = prepare(sequence, Config(), OUTAGES, 25.0, 5.0)
    before, after = (try_out(sequence, ready, (c,)) for c in (Config(), config))
    if after.reason:
        return after.reason
    out = []
    for part, square in before.square.items():
        both = np.array([square, after.square[part]])
        weight = np.ones(square.size)
        if part == "as recorded":
            weight = np.bincount(ready.block).astype(float)
        group = Group(sequence.name, part, both, weight, np.zeros(square.size, dtype=int))
        words = interval(change([group], [both[1]]))
        out.append(f"{part} {group.rms(0):.3f} → {group.rms(1):.3f} m, {words}")
    return "; ".join(out)


if __name__ == "__main__":
    main()
