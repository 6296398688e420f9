"""What the vehicle's constraint is worth without GNSS: 60 s in every 180 s, moved by 0, 60, 120 s.

    python scripts/spells_without_gnss.py RECORDING … [--outages 60/180@0,60,120] [--set KEY=VALUE]
        [--own] [--causal] [--only-on]

For each recording, causal and smoothed, without `vehicle.nhc` and with it: spells, RMS and largest
of their drifts, mean NEES of position at their ends (3 is right) and its median, the same of north
and east (2) and of the height (1), and what the constraint has found of the mounting in the
undisturbed run. Drift is max |e(t) − e(t₀)| in a spell, e the horizontal error and t₀ its
beginning. What has no reference, and with --own everything, is judged by its smoothed solution
without spells and without the constraint. Options of readers are set as data.KEY=VALUE, for
example data.rtk=fixes.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.filters.errors import NavError
from certnav.nav.config import Config
from certnav.nav.config_files import load_config
from certnav.nav.evaluation.accuracy import Evaluation, evaluate
from certnav.nav.evaluation.interpolation import interpolate
from certnav.nav.pipeline import navigate
from certnav.nav.solution import Solution
from certnav.nav.spells.degradation import degrade
from certnav.nav.spells.drift import SpellFigures, as_reference, spell_figures
from certnav.nav.spells.outages import Outages, Spell, parse_outages

#: A filter that has just begun knows its biases and its mounting as little as at first [s].
SETTLING = 60.0
WAYS = (("off", False), ("on", False), ("off", True), ("on", True))

#: Figures of a spell, and the NEES of north and east, and of the height, at its end.
Judged = tuple[SpellFigures, float, float]


def main() -> None:
    """Run what is asked for; print a table a recording, and one of all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recordings", type=Path, nargs="+")
    parser.add_argument("--outages", default="60/180@0,60,120")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--causal", action="store_true", help="without the smoother")
    parser.add_argument("--only-on", action="store_true", help="with the constraint alone")
    parser.add_argument("--own", action="store_true", help="judged by its own smoothed solution")
    arguments = parser.parse_args()
    outages = parse_outages(arguments.outages)
    config = load_config(None, arguments.set)
    ways = [way for way in WAYS if not (arguments.causal and way[1])]
    ways = [way for way in ways if not (arguments.only_on and way[0] == "off")]
    everything: dict[tuple[str, bool], list[Judged]] = {way: [] for way in ways}
    for path in arguments.recordings:
        try:
            sequence, earliest = judged(load(path, **config.data), config, arguments.own)
            print(f"\n{path.name}", flush=True)
            for way in ways:
                began = time.perf_counter()
                found = list(drifts(sequence, with_way(config, *way), outages, earliest))
                everything[way] += found
                show(way, found, time.perf_counter() - began)
        except NavError as error:
            print(f"  {error}")
    print("\nall")
    for way, found in everything.items():
        show(way, found)


def with_way(config: Config, nhc: str, smooth: bool) -> Config:
    """Return the configuration with the constraint and the smoother as given."""
    return dataclasses.replace(
        config,
        vehicle=dataclasses.replace(config.vehicle, nhc=nhc),
        filter=dataclasses.replace(config.filter, smooth=smooth),
    )


def judged(sequence: Sequence, config: Config, own: bool) -> tuple[Sequence, float]:
    """Return the sequence with a reference, and from when spells may begin [s]."""
    undisturbed = navigate(sequence, with_way(config, "on", False))
    print(f"\n{sequence.name}: {undisturbed.installation}")
    earliest = undisturbed.alignment.time + SETTLING
    if sequence.reference is None or own:
        best = navigate(sequence, with_way(config, "off", True)).trajectory
        judge = as_reference(best, "the smoothed solution without spells: NOT independent")
        sequence = dataclasses.replace(sequence, reference=judge)
    return sequence, earliest


def drifts(
    sequence: Sequence, config: Config, outages: Outages, earliest: float
) -> Iterator[Judged]:
    """Yield the figures of all spells of all variants."""
    first, last = sequence.inertial.time[[0, -1]]
    for shift in outages.shifts:
        try:
            spells: list[Spell] = outages.spells(first, last, earliest, shift)
        except NavError:  # none fits
            continue
        degraded = degrade(sequence, spells, outages)
        solution = navigate(degraded, config)
        evaluation = evaluate(solution, degraded)
        for spell in spells:
            figures = spell_figures(evaluation, spell)
            if figures is not None:
                yield figures, *nees_at_end(solution, evaluation, spell)


def nees_at_end(solution: Solution, evaluation: Evaluation, spell: Spell) -> tuple[float, float]:
    """Return the NEES of north and east, and of the height, at the last epoch of a spell."""
    row = np.flatnonzero(evaluation.time < spell[1])[-1:]
    error = evaluation.error_pos_n[row[0]]
    cov = interpolate(solution.trajectory, evaluation.time[row]).cov_pos_n[0]
    level = float(error[:2] @ np.linalg.solve(cov[:2, :2], error[:2]))
    return level, float(error[2] ** 2 / cov[2, 2])


def show(way: tuple[str, bool], found: list[Judged], took: float = float("nan")) -> None:
    """Print one line."""
    if not found:
        return
    drift = np.array([figures.drift for figures, _, _ in found])
    nees = np.array([figures.nees_end for figures, _, _ in found])
    level, height = (np.array([judged[k] for judged in found], dtype=float) for k in (1, 2))
    print(
        f"  nhc {way[0]:3} {'smoothed' if way[1] else 'causal':8} {len(found):3d} spells: "
        f"RMS of maxima {np.sqrt(np.mean(drift**2)):6.2f} m, largest {drift.max():6.2f} m, "
        f"NEES at the end {np.nanmean(nees):6.2f} (median {np.nanmedian(nees):.2f}), level "
        f"{np.nanmean(level):.2f} ({np.nanmedian(level):.2f}), height {np.nanmean(height):.2f} "
        f"({np.nanmedian(height):.2f}), {took:.0f} s",
        flush=True,
    )


if __name__ == "__main__":
    main()
