"""Faults of the GNSS: files, observations, and a receiver's fixes."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from datetime import datetime
from pathlib import Path

import numpy as np

from certnav.datasets.loading import load
from certnav.datasets.observations import GnssFixes, GnssObservations
from certnav.datasets.sequence import Sequence
from certnav.filters.earth import SPEED_OF_LIGHT, C_en_of, lla_to_ecef

from .imu_breaks import DataFault, FileFault


def rinex_weeks(weeks: int) -> FileFault:
    """Return a receiver whose calendar is off by so many weeks; time of week is right."""

    def breaks(folder: Path, sow: float) -> None:
        file = next((folder / "GNSS" / "Rover").iterdir())
        shift = np.timedelta64(7 * weeks, "D")

        def moved(match: re.Match[str]) -> str:
            y, m, d = (int(v) for v in match[2].split())
            date = (np.datetime64(f"{y:04d}-{m:02d}-{d:02d}") + shift).astype(datetime)
            return f"{match[1]}{date.year:4d} {date.month:02d} {date.day:02d}"

        text = re.sub(r"(?m)^(> )(\d{4} [ \d]\d [ \d]\d)", moved, file.read_text())
        file.write_text(text)

    return breaks


def ephemeris(anomaly: float, which: int = 0) -> FileFault:
    """Return a GPS satellite shifted along its orbit: mean anomaly [rad].

    `which`: 0 is the one that is seen most.
    """

    def breaks(folder: Path, sow: float) -> None:
        used = load(folder).observations
        assert used is not None
        seen, count = (
            np.unique(used.sat[used.elevation > 0.6], return_counts=True)
            if (np.isfinite(used.elevation).any())
            else np.unique(used.sat, return_counts=True)
        )
        name = str(seen[np.argsort(-count, kind="stable")[which]])
        (file,) = (folder / "GNSS" / "Product").iterdir()
        lines = file.read_text().splitlines()
        for number, line in enumerate(lines):
            if line.startswith(name):
                orbit = lines[number + 1]
                value = float(orbit[61:80].replace("D", "E")) + anomaly
                lines[number + 1] = f"{orbit[:61]}{value:19.12E}{orbit[80:]}"
        file.write_text("\n".join(lines) + "\n")

    return breaks


def receiver_clock(seconds: float, stamps: bool) -> DataFault:
    """Return a jump of the receiver's clock: pseudoranges, and the stamps if it does so."""

    def change(sequence: Sequence, begin: float) -> Sequence:
        old = sequence.observations
        assert old is not None
        after = old.time >= begin
        new = old.with_columns(
            time=old.time + np.where(after & stamps, seconds, 0.0),
            pseudorange=old.pseudorange + np.where(after, SPEED_OF_LIGHT * seconds, 0.0),
        )
        return dataclasses.replace(sequence, observations=new)

    return change


def on_fixes(change: Callable[[GnssFixes, float], GnssFixes]) -> DataFault:
    def changed(sequence: Sequence, begin: float) -> Sequence:
        assert sequence.fixes is not None
        return dataclasses.replace(sequence, fixes=change(sequence.fixes, begin))

    return changed


def late(seconds: float, for_s: float = np.inf) -> DataFault:
    """Return fixes stamped late: all of them, or those of a while after the fault's time."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        during = (fixes.time >= begin) & (fixes.time < begin + for_s)
        late = np.ones(len(fixes), bool) if np.isinf(for_s) else during
        return dataclasses.replace(fixes, time=fixes.time + seconds * late)

    return on_fixes(change)


def late_from(seconds: float) -> DataFault:
    """Return a receiver clock that jumps: every stamp after the fault's time is late."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        after = fixes.time >= begin
        return dataclasses.replace(fixes, time=fixes.time + seconds * after)

    return on_fixes(change)


def jump(metres: float, epochs: int) -> DataFault:
    """Return positions shifted to the east for so many epochs, velocities as they were."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        k = int(np.searchsorted(fixes.time, begin))
        pos_e = fixes.pos_e.copy()
        pos_e[k : k + epochs] += metres * C_en_of(pos_e[k : k + epochs])[:, :, 1]
        return dataclasses.replace(fixes, pos_e=pos_e)

    return on_fixes(change)


def fixes_frozen(seconds: float) -> DataFault:
    """Return a receiver that repeats its last position and velocity with fresh stamps."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        k, m = np.searchsorted(fixes.time, [begin, begin + seconds])
        pos_e, vel_e = fixes.pos_e.copy(), fixes.vel_e.copy()
        pos_e[k:m], vel_e[k:m] = pos_e[k], vel_e[k]
        return dataclasses.replace(fixes, pos_e=pos_e, vel_e=vel_e)

    return on_fixes(change)


def observed(change: Callable[[GnssObservations, float], GnssObservations]) -> DataFault:
    """Return a fault of the observations."""

    def changed(sequence: Sequence, begin: float) -> Sequence:
        assert sequence.observations is not None
        return dataclasses.replace(sequence, observations=change(sequence.observations, begin))

    return changed


def satellites(count: int, seconds: float) -> DataFault:
    """Return a while in which only so many satellites are seen."""

    def change(old: GnssObservations, begin: float) -> GnssObservations:
        names = np.unique(old.sat[old.time >= begin])[:count]
        during = (old.time >= begin) & (old.time < begin + seconds)
        return old.take(~during | np.isin(old.sat, names))

    return observed(change)


def wrong_satellite(metres: float, rate: float) -> DataFault:
    """Return a satellite whose ranges and range rates are off from the fault's time on."""

    def change(old: GnssObservations, begin: float) -> GnssObservations:
        seen, count = np.unique(old.sat[old.usable], return_counts=True)
        rows = (old.sat == seen[np.argmax(count)]) & (old.time >= begin)
        return old.with_columns(
            pseudorange=old.pseudorange + metres * rows, range_rate=old.range_rate + rate * rows
        )

    return observed(change)


def rows_of(
    change: Callable[[dict[str, np.ndarray], np.ndarray], None], seconds: float, at: float = 0.0
) -> DataFault:
    """Return a change of the columns of some rows of fixes: a while after the fault's time.

    `at` NaN: the first rows of all.
    """

    def changed(fixes: GnssFixes, begin: float) -> GnssFixes:
        begin = float(fixes.time[0]) if np.isnan(at) else begin + at
        rows = (fixes.time >= begin) & (fixes.time < begin + seconds)
        names = [f.name for f in dataclasses.fields(fixes)]
        columns = {name: getattr(fixes, name).copy() for name in names}
        change(columns, rows)
        return GnssFixes(**columns)

    return on_fixes(changed)


def at_null(height: float = 0.0) -> Callable[[dict[str, np.ndarray], np.ndarray], None]:
    """Return latitude and longitude 0."""

    def change(columns: dict[str, np.ndarray], rows: np.ndarray) -> None:
        columns["pos_e"][rows] = lla_to_ecef(0.0, 0.0, height)

    return change


def displaced(metres: float, **columns_too: object) -> Callable[..., None]:
    """Return positions to the east by so much, other columns as given."""

    def change(columns: dict[str, np.ndarray], rows: np.ndarray) -> None:
        pos_e = columns["pos_e"]
        pos_e[rows] += metres * C_en_of(pos_e[rows])[:, :, 1]
        for name, value in columns_too.items():
            columns[name] = columns[name].astype("U16") if name == "quality" else columns[name]
            columns[name][rows] = value

    return change


def creeping(speed: float) -> Callable[[dict[str, np.ndarray], np.ndarray], None]:
    """Return positions that creep away to the east, velocities as they were."""

    def change(columns: dict[str, np.ndarray], rows: np.ndarray) -> None:
        pos_e, time = columns["pos_e"], columns["time"]
        since = np.where(rows, time - time[rows][0], 0.0)
        pos_e += (speed * since)[:, None] * C_en_of(pos_e)[:, :, 1]

    return change


def stated(factor: float) -> Callable[[dict[str, np.ndarray], np.ndarray], None]:
    """Return another stated accuracy of positions and velocities."""

    def change(columns: dict[str, np.ndarray], rows: np.ndarray) -> None:
        columns["pos_cov_e"][rows] *= factor**2
        columns["vel_cov_e"][rows] *= factor**2

    return change


def position_turned(signs: tuple[float, float, float]) -> Callable[..., None]:
    """Return positions with the displacement from the first one mirrored: north, east, down."""

    def change(columns: dict[str, np.ndarray], rows: np.ndarray) -> None:
        pos_e = columns["pos_e"]
        C_en = C_en_of(pos_e[0])
        pos_e[rows] = pos_e[0] + (pos_e[rows] - pos_e[0]) @ C_en * signs @ C_en.T

    return change


def velocity_turned(M_n: np.ndarray) -> Callable[[dict[str, np.ndarray], np.ndarray], None]:
    """Return velocities multiplied by a matrix, north-east-down."""

    def change(columns: dict[str, np.ndarray], rows: np.ndarray) -> None:
        C_en = C_en_of(columns["pos_e"][rows])
        vel_n = np.einsum("nji,nj->ni", C_en, columns["vel_e"][rows])
        columns["vel_e"][rows] = np.einsum("nij,nj->ni", C_en, vel_n @ M_n.T)

    return change


def repeats(*names: str) -> Callable[[dict[str, np.ndarray], np.ndarray], None]:
    """Return columns that keep their value through the rows."""

    def change(columns: dict[str, np.ndarray], rows: np.ndarray) -> None:
        for name in names:
            columns[name][rows] = columns[name][np.argmax(rows)]

    return change


def printed(times: int) -> DataFault:
    """Return a log that prints every fix so many times, with fresh stamps."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        step = float(np.median(np.diff(fixes.time))) / times
        more = fixes.take(np.repeat(np.arange(len(fixes)), 1))
        columns = {
            f.name: np.repeat(getattr(more, f.name), times, axis=0)
            for f in dataclasses.fields(more)
        }
        columns["time"] = columns["time"] + np.tile(np.arange(times) * step, len(fixes))
        return GnssFixes(**columns)

    return on_fixes(change)


def no_fixes(seconds: float) -> DataFault:
    """Return a while without fixes."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        return fixes.take((fixes.time < begin) | (fixes.time >= begin + seconds))

    return on_fixes(change)


def then(first: DataFault, second: DataFault) -> DataFault:
    """Return one fault after the other."""
    return lambda sequence, begin: second(first(sequence, begin), begin)
