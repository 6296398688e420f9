"""What receivers' observations give: positions against a base, Doppler of all constellations.

    python scripts/raw_receivers.py

The recordings are those of CERTNAV_DATA: `nagoya-rtk-static`, a rover at rest on a known point,
`fuji-rtk`, a moving one, and Spirent's simulator. Prints the tables of ``docs/raw_logs.md``.
"""

from __future__ import annotations

import gzip
import itertools
import os
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from certnav.datasets.loading import load
from certnav.datasets.observations import GnssObservations
from certnav.datasets.rtklib import RelativePositions, read_observations, relative_positions
from certnav.filters.earth import C_en_of, lla_to_ecef
from certnav.filters.rotation import FloatArray
from certnav.velocity.least_squares import doppler_velocities
from certnav.velocity.range_rate import doppler_rows, with_elevation

FUJI_BASE = (-3959400.631, 3385704.533, 3667523.111)
#: Satellites lower than that are not used [rad], signals weaker neither [dB-Hz].
MASK, WEAK = np.radians(10.0), 35.0
Velocity = Callable[[float], FloatArray]


def main() -> None:
    """Print positions against a base, then Doppler."""
    data = Path(os.environ.get("CERTNAV_DATA", "../shared/data"))
    with tempfile.TemporaryDirectory() as scratch:
        nagoya = _unpacked(data / "nagoya-rtk-static", Path(scratch))
        fuji = data / "fuji-rtk"
        print("| | bands | systems | fixed | float | ratio | error or distance [m] | base [m] |")
        print("|---|--:|---|--:|--:|--:|--:|--:|")
        _known_point(nagoya, data / "nagoya-rtk-static")
        _moving(fuji)
        print()
        print("| | all | GPS | Galileo | BeiDou | GLONASS | QZSS |")
        print("|---|--:|--:|--:|--:|--:|--:|")
        o = read_observations(nagoya / "rover.obs", [data / "nagoya-rtk-static/base.nav"])
        rest = _point(data / "nagoya-rtk-static/rover_position.txt")
        still = _observed("Nagoya, at rest", o, rest, lambda time: np.zeros(3))
        o = read_observations(fuji / "3034265G.21O", [fuji / "SEPT2650.21P"])
        _observed("Fuji's base, at rest", o, np.array(FUJI_BASE), lambda time: np.zeros(3))
        truth = (spirent := load(data / "instinct/spirent_dynamic")).reference
        assert truth is not None and spirent.observations is not None
        place = _at(spirent.observations.time, truth.time, truth.pos_e)
        simulated = _observed(
            "Spirent, moving", spirent.observations, place,
            lambda time: _at(np.array([time]), truth.time, truth.vel_e)[0],
        )  # fmt: skip
    print()
    print("| pairs of satellites | pairs | RMS [m/s] |")
    print("|---|--:|--:|")
    for name, (seen, pos_e, velocity) in (("Nagoya", still), ("Spirent", simulated)):
        _pairs(name, seen, pos_e, velocity)


def _unpacked(source: Path, scratch: Path) -> Path:
    for name in ("rover", "base"):
        packed = (source / f"{name}.obs.gz").read_bytes()
        (scratch / f"{name}.obs").write_bytes(gzip.decompress(packed))
    return scratch


def _point(file: Path) -> FloatArray:
    lat, lon, height = (float(v) for v in file.read_text().split())
    return lla_to_ecef(np.radians(lat), np.radians(lon), height)


def _at(time: FloatArray, known: FloatArray, value: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(time, known, column) for column in value.T])


def _known_point(folder: Path, source: Path) -> None:
    rover_e, base_e = (_point(source / f"{n}_position.txt") for n in ("rover", "base"))
    found = relative_positions(
        folder / "rover.obs", folder / "base.obs", [source / "base.nav"], base_pos_e=base_e
    )
    error_n = (found.fixes.pos_e - rover_e) @ C_en_of(rover_e)
    _row("Nagoya, at rest", found, f"{np.abs(error_n).max():.4f} (largest)")


def _moving(folder: Path) -> None:
    def solved(bands: int) -> RelativePositions:
        return relative_positions(
            folder / "SEPT265G.21O", folder / "3034265G.21O", [folder / "SEPT2650.21P"],
            base_pos_e=FUJI_BASE, frequencies=bands,
        )  # fmt: skip

    found = {bands: solved(bands) for bands in (1, 2, 3, 0)}
    for bands, one in found.items():
        name = f"Fuji, moving{', default' if bands == 0 else ''}"
        _row(name, one, f"{_apart(one, found[3]):.4f} (RMS)" if 0 < bands < 3 else "–")


def _apart(few: RelativePositions, many: RelativePositions) -> float:
    """Return how far fixes are from those with three bands, RMS [m]."""
    a, b = few.fixes, many.fixes
    _, i, j = np.intersect1d(np.round(a.time, 1), np.round(b.time, 1), return_indices=True)
    both = (a.quality[i] == "fixed") & (b.quality[j] == "fixed")
    apart = np.linalg.norm(a.pos_e[i][both] - b.pos_e[j][both], axis=1)
    return float(np.sqrt(np.mean(apart**2)))


def _row(name: str, found: RelativePositions, error: str) -> None:
    quality = found.fixes.quality
    offered = len(found.fixes) + len(found.failed)
    fixed = quality == "fixed"
    own = found.base_own
    base = "–" if own is None else f"{np.linalg.norm(own.pos_e - found.base_pos_e):.1f}"
    print(
        f"| {name} | {found.frequencies} | {found.systems} | {fixed.sum()} of {offered} | "
        f"{(quality == 'float').sum()} | {np.median(found.ratio[fixed]):.0f} | {error} | {base} |"
    )


def _seen(o: GnssObservations, pos_e: FloatArray) -> GnssObservations:
    seen = with_elevation(o, pos_e)
    return seen.mark((seen.elevation < MASK) | (seen.cn0 < WEAK), "low or weak")


def _systems(seen: GnssObservations, pos_e: FloatArray) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return times and velocities from all constellations, and from each by itself."""
    letters = seen.sat.astype("U1")
    out = {}
    for system in ("GECRJ", *"GECRJ"):
        other = seen.mark(~np.isin(letters, list(system)), "another constellation")
        found = [v for v in doppler_velocities(other, pos_e) if v.ok]
        out[system] = np.array([v.time for v in found]), np.array([v.vel_e for v in found])
    return out


def _observed(
    name: str, o: GnssObservations, pos_e: FloatArray, velocity: Velocity
) -> tuple[GnssObservations, FloatArray, Velocity]:
    """Print RMS errors of velocities, 3-D, against a known velocity."""
    seen = _seen(o, pos_e)
    cells = []
    for time, vel_e in _systems(seen, pos_e).values():
        error = [v - velocity(t) for t, v in zip(time, vel_e, strict=True)]
        cells.append(f"{np.sqrt(np.mean(np.sum(np.square(error), 1))):.4f}" if len(time) else "–")
    print(f"| {name} | {' | '.join(cells)} |")
    return seen, pos_e, velocity


def _pairs(name: str, seen: GnssObservations, pos_e: FloatArray, velocity: Velocity) -> None:
    """Print what Doppler differences of two satellites have against a known velocity."""
    rows = doppler_rows(seen, pos_e)
    time, letters = seen.time[rows.row], rows.sat.astype("U1")
    left = rows.z - np.array([e @ velocity(t) for e, t in zip(rows.e_e, time, strict=True)])
    kinds: dict[str, list[float]] = {"of one constellation": [], "of two": []}
    for at in np.unique(time):
        here = np.flatnonzero(time == at)
        for a, b in itertools.combinations(here, 2):
            kind = "of one constellation" if letters[a] == letters[b] else "of two"
            kinds[kind].append(left[a] - left[b])
    for kind, values in kinds.items():
        print(f"| {name}, {kind} | {len(values)} | {np.sqrt(np.mean(np.square(values))):.4f} |")


if __name__ == "__main__":
    main()
