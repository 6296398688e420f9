"""Least squares of few satellites against the mean of the paper's screened pairs, the same draws.

    python scripts/few_satellites.py PATH [--draws 20] [--label los]

Two to five satellites are drawn at random in every epoch; weights are fitted on other time blocks
than they are judged on.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path

import numpy as np

from certnav.datasets.loading import load
from certnav.filters.errors import NavError
from certnav.velocity.doppler_noise import fit_doppler_noise, reference_residuals
from certnav.velocity.study.below_four import FewSatellites, few_satellites
from certnav.velocity.study.samples import Samples, reference_samples


def cross_fitted(samples: Samples, count: int, draws: int, blocks: int = 5) -> list[FewSatellites]:
    """Return the figures of each block of time, weights fitted to the other blocks."""
    edges = np.linspace(samples.time[0], samples.time[-1] + 1e-6, blocks + 1)
    residual = reference_residuals(samples)
    out = []
    for start, end in itertools.pairwise(edges):
        block = samples.between(start, end)
        others = ~((samples.time >= start) & (samples.time < end))[samples.epoch]
        noise = fit_doppler_noise(samples.cn0[others], residual[others], spread="rms").noise
        if block.time.size:
            out.append(few_satellites(block.weighted(noise), count, draws=draws))
    return out


def rms(epochs: np.ndarray, each: np.ndarray) -> float:
    """Return the RMS over blocks of so many epochs."""
    return float(np.sqrt(np.nansum(epochs * each**2) / epochs.sum()))


def main() -> None:
    """Draw, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("path", type=Path)
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--label", default="", help="only rows labelled so, e.g. los")
    arguments = parser.parse_args()
    try:
        samples = reference_samples(load(arguments.path), label=arguments.label)
        print("| satellites | pairs [m/s] | least squares [m/s] | lower by | availability |")
        print("|---|---|---|---|---|")
        for count in (2, 3, 4, 5):
            found = cross_fitted(samples, count, arguments.draws)
            epochs = np.array([f.epochs for f in found])
            pairs, joint = (
                rms(epochs, np.array([getattr(f, k) for f in found]))
                for k in ("rms_pairs", "rms_joint")
            )
            there = epochs.sum() / (arguments.draws * samples.time.size)
            cells = [f"{pairs:.2f}", f"{joint:.2f}", f"{1 - joint / pairs:.0%}", f"{there:.1%}"]
            print(f"| {count} | {' | '.join(cells)} |")
    except NavError as error:
        sys.exit(f"few_satellites: {error}")


if __name__ == "__main__":
    main()
