"""Attitude without a position, from 1 to 1,000 km away: simulated windows and real ones.

    python scripts/alignment_anywhere.py [--runs 100] [--seed 5] [--data FOLDER] [--json]

Simulated: a car with one turn at 12 m/s, 30 s, 4, 6 and 8 of thirty satellites, 0.05 m/s, a clock
that walks by 0.1 m/s/√s. Real: comma2k19 (50 s windows), smartLoc Berlin1 (30 s), the Tokyo drive
(60 s), rows at 1 Hz, a car that is level within 2°, with the noise of each recording's own windows
in motion; the position comes from its reference, moved in a random direction. The radius that is
claimed is one and a half times the distance. 'beyond' counts windows that pass with an attitude
further off than their bound, or that are located and further off than their radius; of real windows
the attitude's error is that of the heading, or of the course, against the reference.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from certnav.alignment.anywhere.align import AnywhereAlignment, align_anywhere
from certnav.alignment.anywhere.signals import Signals
from certnav.alignment.local_velocity import LocalTrack
from certnav.alignment.problem import ClockModel
from certnav.alignment.reference.earth_windows import displaced, earth_window
from certnav.alignment.solver.refinement import rotation_angle
from certnav.datasets.loading import load
from certnav.datasets.observations import GnssObservations
from certnav.datasets.sequence import Sequence
from certnav.filters.earth import C_en_of
from certnav.filters.errors import AlignmentError
from certnav.filters.rotation import wrap_angle
from certnav.nav.results.summary import strict
from certnav.nav.windows.noise import WindowNoise, fit_window_noise
from certnav.nav.windows.options import WindowOptions
from certnav.nav.windows.recording import reference_heading
from certnav.nav.windows.rows import alignment_rows, local_track, prepared_observations

DISTANCES_KM = (1.0, 10.0, 100.0, 1000.0)
#: A car on a road, as for the windows with a position [rad].
LEVEL = float(np.radians(2.0))
#: Mean speed of windows that the noise is taken from [m/s].
MOVING = 3.0
#: Folder, length and distance of windows [s], every so-manieth epoch, least C/N0 [dB-Hz].
DRIVES = {
    "comma2k19": ("comma2k19-example1", 50.0, 4.0, 10, 0.0),
    "Berlin1": ("smartloc-berlin1", 30.0, 6.0, 5, 40.0),
    "Tokyo": ("tumsat-tsukishima", 60.0, 60.0, 5, 40.0),
}


@dataclass(frozen=True)
class Outcome:
    """What became of one window."""

    passed: bool
    located: bool
    error_deg: float
    bound_deg: float
    off_km: float
    radius_km: float


def outcome(found: AnywhereAlignment, error: float, pos_e: np.ndarray) -> Outcome:
    """Judge a window by its attitude's error [rad] and its true position."""
    return Outcome(
        found.passed, found.located.passed, float(np.degrees(abs(error))),
        float(np.degrees(found.bound)), float(np.linalg.norm(found.pos_e - pos_e)) / 1e3,
        found.radius / 1e3,
    )  # fmt: skip


def simulated(rng: np.random.Generator, runs: int, satellites: int) -> dict[float, list[Outcome]]:
    """Outcomes by distance [km]."""
    out: dict[float, list[Outcome]] = {distance: [] for distance in DISTANCES_KM}
    for _ in range(runs):
        window = earth_window(rng, satellites, 30.0)
        clock = ClockModel("random-walk", window.clock_walk)
        for distance in DISTANCES_KM:
            near = displaced(rng, window.pos_e, 1e3 * distance)
            found = align_anywhere(
                window.signals, window.track, near, 1.5e3 * distance, 300.0, clock=clock
            )
            error = float(rotation_angle(found.C_ew, window.C_ew))
            out[distance].append(outcome(found, error, window.pos_e))
    return out


def real(rng: np.random.Generator, path: Path, how: tuple) -> dict[float, list[Outcome]]:
    """Outcomes by distance [km] over the windows of a recording."""
    _, length, step, decimate, min_cn0 = how
    sequence = load(path)
    options = WindowOptions(method="certified", decimate=decimate, min_cn0=min_cn0)
    observations, pos_e = prepared_observations(sequence, options)
    windows: list[tuple[float, GnssObservations, LocalTrack]] = []
    believed = []
    for start in np.arange(*_shared(sequence, length), step):
        inside = (observations.time >= start) & (observations.time <= start + length)
        try:
            track = local_track(sequence, start, start + length)
        except AlignmentError:
            continue
        part = observations.take(inside)
        windows.append((start, part, track))
        # What stands still tells little of the noise in motion.
        if inside.any() and np.linalg.norm(track.vel_w, axis=1).mean() > MOVING:
            exact = replace(options, speed_scale_sigma=0.0)
            rows = alignment_rows(part, pos_e[inside], track, exact, WindowNoise(), 30.0)
            believed.append((rows, part))
    noise = fit_window_noise(believed, ClockModel("random-walk", 0.1))
    clock = ClockModel("random-walk", noise.clock_walk)
    out: dict[float, list[Outcome]] = {distance: [] for distance in DISTANCES_KM}
    for start, part, track in windows:
        signals = Signals.of(part, noise.doppler)
        reference = sequence.reference
        pos_e = np.array([np.interp(start, reference.time, x) for x in reference.pos_e.T])
        for distance in DISTANCES_KM:
            near = displaced(rng, pos_e, 1e3 * distance)
            try:
                found = align_anywhere(
                    signals, track, near, 1.5e3 * distance, 300.0, clock=clock,
                    correlated=max(noise.correlated, 1.0), level_sigma=LEVEL,
                )  # fmt: skip
            except AlignmentError:
                continue
            error = heading_error(found, sequence, start, track)
            out[distance].append(outcome(found, error, pos_e))
    return out


def heading_error(
    found: AnywhereAlignment, sequence: Sequence, start: float, track: LocalTrack
) -> float:
    """Heading, or where the reference has none the course, median while moving [rad]."""
    reference, C_ne = sequence.reference, C_en_of(found.pos_e).T
    heading = reference_heading(sequence, start)
    if np.isfinite(heading):
        forward = C_ne @ found.C_ew[:, 0]
        return float(wrap_angle(np.arctan2(forward[1], forward[0]) - heading))
    known = np.isfinite(reference.vel_e).all(axis=1)
    known &= (reference.time >= track.time[0]) & (reference.time <= track.time[-1])
    local = track.velocity_at(reference.time[known])
    moving = np.linalg.norm(local, axis=1) > MOVING
    here, there = (
        np.arctan2(v[:, 1], v[:, 0])
        for v in (local[moving] @ found.C_ew.T @ C_ne.T, reference.vel_e[known][moving] @ C_ne.T)
    )
    return float(np.median(wrap_angle(here - there))) if moving.any() else float("nan")


def _shared(sequence: Sequence, length: float) -> tuple[float, float]:
    """First and last beginning of a window that Doppler, odometer and reference share [s]."""
    times = [sequence.observations.time, sequence.odometer.time, sequence.reference.time]
    if sequence.imu is not None:
        times.append(sequence.imu.time)
    return max(t[0] for t in times), min(t[-1] for t in times) - length


def row(name: str, distance: float, found: list[Outcome]) -> dict:
    """One line of the table."""
    passed = [o for o in found if o.passed]
    located = [o for o in found if o.located]

    def middle(values: list[float]) -> float:
        return float(np.median(values)) if values else float("nan")

    return {
        "windows": name,
        "from_km": distance,
        "count": len(found),
        "passed": len(passed),
        "located": len(located),
        "beyond": sum(o.error_deg > o.bound_deg for o in passed)
        + sum(o.off_km > o.radius_km for o in located),
        "error_deg": middle([o.error_deg for o in passed]),
        "largest_deg": max((o.error_deg for o in passed), default=float("nan")),
        "bound_deg": middle([o.bound_deg for o in passed]),
        "off_km": middle([o.off_km for o in located]),
        "radius_km": middle([o.radius_km for o in located]),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=5)
    default = Path(os.environ.get("CERTNAV_DATA", "../shared/data"))
    parser.add_argument("--data", type=Path, default=default)
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    rng, rows = np.random.default_rng(arguments.seed), []
    if not arguments.json:
        print("| windows | from | passed | located | beyond ", end="")
        print("| attitude: error, largest, bound | position: off, radius |")
        print("|---|---|---|---|---|---|---|")

    def add(name: str, found: dict[float, list[Outcome]]) -> None:
        for distance, outcomes in found.items():
            rows.append(row(name, distance, outcomes))
            if not arguments.json:
                r = rows[-1]
                print(
                    f"| {name} | {distance:,.0f} km | {r['passed']} of {r['count']} | "
                    f"{r['located']} | {r['beyond']} | {r['error_deg']:.2f}°, "
                    f"{r['largest_deg']:.2f}°, {r['bound_deg']:.2f}° | {r['off_km']:.2f} km, "
                    f"{r['radius_km']:.1f} km |",
                    flush=True,
                )

    for satellites in (4, 6, 8):
        add(f"simulated, {satellites} satellites", simulated(rng, arguments.runs, satellites))
    for name, how in DRIVES.items():
        path = arguments.data / how[0]
        if path.exists():
            add(name, real(rng, path, how))
    if arguments.json:
        print(json.dumps(strict(rows)))


if __name__ == "__main__":
    main()
