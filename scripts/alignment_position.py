"""What a wrong position does to an alignment, and what knowing so costs.

    python scripts/alignment_position.py [--runs 200] [--seed 11] [--seconds 10 30 60] [--json]

A car with one turn at 12 m/s, 4, 6 and 8 of thirty satellites, 0.05 m/s of noise, a clock that
walks by 0.1 m/s/√s. Rows are made at a position that is 0.1 to 10 km off in any direction; as if
it were exact, and with the three unknowns of its error, 1σ per axis of the distance over √3.
'beyond' counts the windows that pass and whose attitude is further from the truth than their
bound: 0.27 % are allowed (3σ).
"""

from __future__ import annotations

import argparse
import json

import numpy as np

from certnav.alignment.problem import ClockModel
from certnav.alignment.reference.earth_windows import EarthWindow, earth_window
from certnav.alignment.rows import AlignmentRows
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.verdict import align
from certnav.velocity.range_rate import DopplerRows

DISTANCES_KM = (0.1, 0.3, 1.0, 3.0, 10.0)


def rows_of(window: EarthWindow, off_e: np.ndarray, sigma: float) -> AlignmentRows:
    """Rows at a position that is off by so much [m], and known to be so by 1σ per axis [m]."""
    signals, track = window.signals, window.track
    antenna_e = window.pos_e + track.moved_at(signals.time) @ window.C_ew.T
    sight = signals.at(antenna_e + off_e)
    number = np.arange(len(signals))
    doppler = DopplerRows(
        number, number.astype(str), sight.e_e, sight.z, signals.sigma, sight.by_pos
    )
    vel_w = track.velocity_at(signals.time)
    return AlignmentRows.paired(doppler, signals.time, vel_w, position_sigma=sigma)


def cell(rng: np.random.Generator, runs: int, satellites: int, seconds: float) -> list[dict]:
    """Figures of one number of satellites and one length, for all distances."""
    kept: dict[tuple[float, bool], list[tuple[bool, bool, float]]] = {}
    for _ in range(runs):
        window = earth_window(rng, satellites, seconds)
        clock = ClockModel("random-walk", window.clock_walk)
        for distance in DISTANCES_KM:
            direction = rng.normal(size=3)
            off_e = 1e3 * distance * direction / np.linalg.norm(direction)
            for known in (False, True):
                sigma = 1e3 * distance / np.sqrt(3.0) if known else 0.0
                result = align(rows_of(window, off_e, sigma), clock)
                error = float(rotation_angle(result.C_ew, window.C_ew))
                kept.setdefault((distance, known), []).append(
                    (result.passed, result.passed and error > result.bound, result.bound)
                )
    out = []
    for (distance, known), found in kept.items():
        passed = [bound for ok, _, bound in found if ok]
        out.append(
            {
                "satellites": satellites,
                "seconds": seconds,
                "off_km": distance,
                "unknown": known,
                "passed": len(passed),
                "beyond": sum(wrong for _, wrong, _ in found),
                "bound_deg": round(float(np.degrees(np.median(passed))), 2) if passed else None,
            }
        )
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=11)
    parser.add_argument("--seconds", type=float, nargs="+", default=[10.0, 30.0, 60.0])
    parser.add_argument("--satellites", type=int, nargs="+", default=[4, 6, 8])
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    rng, cells = np.random.default_rng(arguments.seed), []
    for seconds in arguments.seconds:
        for satellites in arguments.satellites:
            cells += cell(rng, arguments.runs, satellites, seconds)
    if arguments.json:
        print(json.dumps({"runs": arguments.runs, "cells": cells}))
        return
    print("  time  sats     off      as if exact           with its unknowns")
    print("                          passed beyond  bound  passed beyond  bound")
    for believed, known in zip(cells[::2], cells[1::2], strict=True):
        line = (
            f"{believed['seconds']:4.0f} s {believed['satellites']:5d} {believed['off_km']:5.1f} km"
        )
        for one in (believed, known):
            bound = "–" if one["bound_deg"] is None else f"{one['bound_deg']:.2f}°"
            line += f"   {one['passed']:5d} {one['beyond']:6d} {bound:>6}"
        print(line)
    wrong = sum(c["beyond"] for c in cells if c["unknown"])
    total = sum(c["passed"] for c in cells if c["unknown"])
    print(f"with its unknowns: {wrong} of {total} passed beyond their bound")


if __name__ == "__main__":
    main()
