"""Faults in the data of a drive: what is said about each, and how far the solution goes off.

    python scripts/faults.py --seeds 3                      # table on the screen
    python scripts/faults.py --seeds 3 --out docs/trust.md  # rewrites the page's section
    python scripts/faults.py --json

Drives are simulated (truth known) and one real one of CERTNAV_DATA. Each fault is done to a copy,
which then goes the way of `certnav run`: reading, check, navigation, evaluation. What stops the
run at reading or check is navigated all the same, as with ``--unchecked``, where that is possible.
The status is 1 if a fault passes without a word and moves the solution beyond its own 3σ.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from certnav.datasets.great.writer import write_great
from certnav.datasets.load import load
from certnav.datasets.sequence import GnssFixes, Sequence
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.datasets.simulation.trajectory import fixes_from_truth
from certnav.filters.earth import SPEED_OF_LIGHT, C_en_of
from certnav.filters.errors import NavError
from certnav.nav.check.recording import check_sequence
from certnav.nav.config import from_tables
from certnav.nav.evaluation.accuracy import Evaluation, evaluate
from certnav.nav.pipeline import navigate
from certnav.nav.solution import Solution

ROOT = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("CERTNAV_DATA", ROOT.parent / "shared" / "data"))
REAL = "oakville-drives/urban-long-turn-loop-nominal-001"
COMMAND = "python scripts/faults.py --seeds 3 --out docs/trust.md"
SECTION = "## Faults in the data"
#: What was said about a fault, from loudest to nothing.
VERDICTS = ("refused", "warned", "noted", "silent")
#: A fault has done harm if it takes the error beyond 3σ where the sound run stayed inside, or
#: further beyond by this factor.
HARM = 1.2

#: Faults begin in the second half of a drive: how it starts is not the question, and this is fast.
CONFIG = from_tables({"alignment": {"method": "level+course"}})

FileFault = Callable[[Path, float], None]
DataFault = Callable[[Sequence, float], Sequence]


@dataclass(frozen=True)
class Fault:
    """One fault.

    Parameters
    ----------
    name : str
        What was done.
    base : {'raw', 'fixes', 'real'}
        Simulated drive with raw GNSS in files; the same with positions and velocities of a
        receiver; a real drive with those.
    files : callable, optional
        Does it to the files of a folder, given the time it begins [s of week].
    data : callable, optional
        Does it to what has been read, given the time it begins [GPS s].
    undetectable : str
        Why it cannot be seen in some of the drives.
    """

    name: str
    base: str
    files: FileFault | None = None
    data: DataFault | None = None
    undetectable: str = ""


@dataclass(frozen=True)
class Outcome:
    """What became of one run.

    Attributes
    ----------
    verdict : str
        One of `VERDICTS`; of a sound run 'silent' is right.
    lines : tuple of str
        What was said.
    rms, largest : float
        Horizontal error against the truth [m]; NaN where there is no solution.
    ratio : float
        Largest horizontal error along north or east over its own 3σ.
    refused : int
        Updates refused by the innovation test.
    duration : float
        Length of the solution [s].
    """

    verdict: str
    lines: tuple[str, ...]
    rms: float
    largest: float
    ratio: float
    refused: int
    duration: float


# --- faults of the IMU's file: rows sow, gx, gy, gz, ax, ay, az -----------------------------


def _imu(change: Callable[[np.ndarray, int], np.ndarray]) -> FileFault:
    """Return a fault of the rows, which is told the first row it is to touch."""

    def breaks(folder: Path, sow: float) -> None:
        file = folder / "IMU" / "MEMS_imu_data.txt"
        rows = np.loadtxt(file, skiprows=1)
        rows = change(rows, int(np.searchsorted(rows[:, 0], sow)))
        np.savetxt(file, rows, fmt=["%.5f", *6 * ["%.8f"]], header="Time", comments="")

    return breaks


def _gap(seconds: float) -> FileFault:
    return _imu(lambda rows, k: np.delete(rows, slice(k, k + round(100 * seconds)), axis=0))


def _repeated(rows: np.ndarray, k: int) -> np.ndarray:
    return np.insert(rows, k, rows[k : k + 10], axis=0)


def _swapped(rows: np.ndarray, k: int) -> np.ndarray:
    rows[[k, k + 1]] = rows[[k + 1, k]]
    return rows


def _swapped_values(rows: np.ndarray, k: int) -> np.ndarray:
    """Swap neighbouring samples for a second, their stamps staying in order."""
    block = rows[k : k + 100, 1:].reshape(50, 2, 6)
    rows[k : k + 100, 1:] = block[:, ::-1].reshape(100, 6)
    return rows


def _frozen(columns: slice, seconds: float) -> FileFault:
    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[k : k + round(100 * seconds), columns] = rows[k, columns]
        return rows

    return _imu(change)


def _stamps(seconds: float) -> FileFault:
    """Return a jump of the stamps from the fault's time to the end."""

    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[k:, 0] += seconds
        return rows

    return _imu(change)


def _all_stamps(seconds: float) -> FileFault:
    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[:, 0] += seconds
        return rows

    return _imu(change)


def _clipped(columns: slice, limit: float) -> FileFault:
    def change(rows: np.ndarray, k: int) -> np.ndarray:
        rows[:, columns] = np.clip(rows[:, columns], -limit, limit)
        return rows

    return _imu(change)


def _declared_week(change: int) -> FileFault:
    def breaks(folder: Path, sow: float) -> None:
        file = folder / "great.toml"
        text, count = re.subn(
            r"(?m)^(imu_week|week)( *= *)(\d+)",
            lambda m: f"{m[1]}{m[2]}{int(m[3]) + change}",
            file.read_text(),
        )
        if count != 1:
            raise RuntimeError(f"{file}: {count} weeks declared")
        file.write_text(text)

    return breaks


# --- faults of the GNSS --------------------------------------------------------------------


def _rinex_weeks(weeks: int) -> FileFault:
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


def _ephemeris(anomaly: float) -> FileFault:
    """Return a GPS satellite shifted along its orbit: mean anomaly [rad]."""

    def breaks(folder: Path, sow: float) -> None:
        used = load(folder).observations
        assert used is not None
        seen, count = (
            np.unique(used.sat[used.elevation > 0.6], return_counts=True)
            if (np.isfinite(used.elevation).any())
            else np.unique(used.sat, return_counts=True)
        )
        name = str(seen[np.argmax(count)])
        (file,) = (folder / "GNSS" / "Product").iterdir()
        lines = file.read_text().splitlines()
        for number, line in enumerate(lines):
            if line.startswith(name):
                orbit = lines[number + 1]
                value = float(orbit[61:80].replace("D", "E")) + anomaly
                lines[number + 1] = f"{orbit[:61]}{value:19.12E}{orbit[80:]}"
        file.write_text("\n".join(lines) + "\n")

    return breaks


def _receiver_clock(seconds: float, stamps: bool) -> DataFault:
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


def _fixes(change: Callable[[GnssFixes, float], GnssFixes]) -> DataFault:
    def changed(sequence: Sequence, begin: float) -> Sequence:
        assert sequence.fixes is not None
        return dataclasses.replace(sequence, fixes=change(sequence.fixes, begin))

    return changed


def _late(seconds: float, for_s: float = np.inf) -> DataFault:
    """Return fixes stamped late: all of them, or those of a while after the fault's time."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        during = (fixes.time >= begin) & (fixes.time < begin + for_s)
        late = np.ones(len(fixes), bool) if np.isinf(for_s) else during
        return dataclasses.replace(fixes, time=fixes.time + seconds * late)

    return _fixes(change)


def _late_from(seconds: float) -> DataFault:
    """Return a receiver clock that jumps: every stamp after the fault's time is late."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        after = fixes.time >= begin
        return dataclasses.replace(fixes, time=fixes.time + seconds * after)

    return _fixes(change)


def _jump(metres: float, epochs: int) -> DataFault:
    """Return positions shifted to the east for so many epochs, velocities as they were."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        k = int(np.searchsorted(fixes.time, begin))
        pos_e = fixes.pos_e.copy()
        pos_e[k : k + epochs] += metres * C_en_of(pos_e[k : k + epochs])[:, :, 1]
        return dataclasses.replace(fixes, pos_e=pos_e)

    return _fixes(change)


def _fixes_frozen(seconds: float) -> DataFault:
    """Return a receiver that repeats its last position and velocity with fresh stamps."""

    def change(fixes: GnssFixes, begin: float) -> GnssFixes:
        k, m = np.searchsorted(fixes.time, [begin, begin + seconds])
        pos_e, vel_e = fixes.pos_e.copy(), fixes.vel_e.copy()
        pos_e[k:m], vel_e[k:m] = pos_e[k], vel_e[k]
        return dataclasses.replace(fixes, pos_e=pos_e, vel_e=vel_e)

    return _fixes(change)


def _gap_in_memory(seconds: float) -> DataFault:
    def change(sequence: Sequence, begin: float) -> Sequence:
        imu = sequence.inertial
        keep = (imu.time < begin) | (imu.time >= begin + seconds)
        less = dataclasses.replace(
            imu, time=imu.time[keep], gyro_b=imu.gyro_b[keep], accel_b=imu.accel_b[keep]
        )
        return dataclasses.replace(sequence, imu=less)

    return change


def _stamps_in_memory(seconds: float) -> DataFault:
    def change(sequence: Sequence, begin: float) -> Sequence:
        imu = sequence.inertial
        time = imu.time + np.where(imu.time >= begin, seconds, 0.0)
        return dataclasses.replace(sequence, imu=dataclasses.replace(imu, time=time))

    return change


_GYRO, _ACCEL, _ALL = slice(1, 4), slice(4, 7), slice(1, 7)

FAULTS = (
    Fault("IMU: 0.1 s missing", "raw", _gap(0.1)),
    Fault("IMU: 1 s missing", "raw", _gap(1.0)),
    Fault("IMU: 5 s missing", "raw", _gap(5.0)),
    Fault("IMU: ten rows repeated with their stamps", "raw", _imu(_repeated)),
    Fault("IMU: two rows in the wrong order", "raw", _imu(_swapped)),
    Fault("IMU: samples swapped in pairs for 1 s, stamps in order", "raw", _imu(_swapped_values)),
    Fault("IMU: all axes frozen for 0.3 s", "raw", _frozen(_ALL, 0.3)),
    Fault("IMU: all axes frozen for 2 s", "raw", _frozen(_ALL, 2.0)),
    Fault("IMU: gyro frozen for 10 s", "raw", _frozen(_GYRO, 10.0)),
    Fault("IMU: accelerometer frozen for 10 s", "raw", _frozen(_ACCEL, 10.0)),
    Fault("IMU: gyro clipped at 12 deg/s", "raw", _clipped(_GYRO, 12.0)),
    Fault("IMU: horizontal accelerometers clipped at 1.2 m/s²", "raw", _clipped(slice(4, 6), 1.2)),
    Fault("IMU: stamps jump 0.1 s ahead", "raw", _stamps(0.1)),
    Fault("IMU: stamps jump 1 s ahead", "raw", _stamps(1.0)),
    Fault("IMU: stamps jump 0.1 s back", "raw", _stamps(-0.1)),
    Fault("IMU: all stamps 0.1 s late", "raw", _all_stamps(0.1)),
    Fault("IMU: all stamps 1 s late (leap second)", "raw", _all_stamps(1.0)),
    Fault("IMU: all stamps 18 s early (UTC)", "raw", _all_stamps(-18.0)),
    Fault("GPS week of the IMU 1024 too small", "raw", _declared_week(-1024)),
    Fault("calendar of the receiver 1024 weeks back", "raw", _rinex_weeks(-1024)),
    Fault("one satellite 26 m along its orbit", "raw", _ephemeris(1e-6)),
    Fault("one satellite 265 m along its orbit", "raw", _ephemeris(1e-5),
          undetectable="with six or seven satellites it leaves residuals below 4 m, which orbits "
          "and atmosphere may leave too; with nine it is named"),
    Fault("one satellite 26 km along its orbit", "raw", _ephemeris(1e-3)),
    Fault("receiver clock jumps 1 ms, pseudorange and stamp", "raw",
          data=_receiver_clock(1e-3, True)),
    Fault("receiver clock jumps 1 ms, pseudorange alone", "raw",
          data=_receiver_clock(1e-3, False)),
    Fault("receiver clock jumps 0.1 s, pseudorange and stamp", "raw",
          data=_receiver_clock(0.1, True)),
    Fault("GNSS 0.1 s late", "fixes", data=_late(0.1)),
    Fault("GNSS 0.3 s late", "fixes", data=_late(0.3)),
    Fault("GNSS 1 s late (leap second)", "fixes", data=_late(1.0)),
    Fault("GNSS 18 s early (UTC)", "fixes", data=_late(-18.0)),
    Fault("GNSS 0.5 s late for 20 s", "fixes", data=_late(0.5, 20.0)),
    Fault("GNSS stamps jump 0.1 s ahead", "fixes", data=_late_from(0.1)),
    Fault("GNSS stamps jump 1 s ahead", "fixes", data=_late_from(1.0)),
    Fault("15 m jump of the fix, 1 epoch", "fixes", data=_jump(15.0, 1)),
    Fault("15 m jump of the fix, 10 epochs", "fixes", data=_jump(15.0, 10)),
    Fault("15 m jump of the fix, 40 epochs", "fixes", data=_jump(15.0, 40)),
    Fault("receiver frozen for 10 s, fresh stamps", "fixes", data=_fixes_frozen(10.0)),
    Fault("IMU: 1 s missing", "real", data=_gap_in_memory(1.0)),
    Fault("IMU: 5 s missing", "real", data=_gap_in_memory(5.0)),
    Fault("IMU: stamps jump 0.1 s ahead", "real", data=_stamps_in_memory(0.1)),
    Fault("IMU: stamps jump 1 s ahead", "real", data=_stamps_in_memory(1.0)),
    Fault("GNSS 0.3 s late", "real", data=_late(0.3)),
    Fault("15 m jump of the fix, 1 epoch", "real", data=_jump(15.0, 1)),
    Fault("15 m jump of the fix, 10 epochs", "real", data=_jump(15.0, 10)),
)  # fmt: skip


# --- runs ----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Base:
    """A sound drive, where faults begin in it, and what its own run says."""

    name: str
    folder: Path | None
    sequence: Sequence
    begin: float
    sound: Outcome


def bases(seed: int, work: Path, wanted: Iterable[str], real: bool) -> dict[str, Base]:
    """Return the sound drives of one seed by the name faults know them by."""
    out: dict[str, Base] = {}
    config = SimulationConfig(
        name=f"drive {seed}", seed=seed, duration=240.0, density="suburb", nlos_probability=0.0
    )
    simulation = simulate(config)
    if "raw" in wanted:
        folder = work / f"raw-{seed}"
        write_great(simulation, folder)
        out["raw"] = base("simulated, raw GNSS", folder, load(folder))
    if "fixes" in wanted:
        time = np.arange(config.start_time + 1.0, config.start_time + config.duration)
        rng = np.random.default_rng(seed)
        fixes = fixes_from_truth(
            simulation.trajectory, time, config.lever_antenna_b,
            (1.0, 1.0, 2.0), (0.05, 0.05, 0.1), rng,
        )  # fmt: skip
        sequence = dataclasses.replace(simulation.sequence(fixes), observations=None)
        out["fixes"] = base("simulated, receiver's fixes", None, sequence)
    if real and "real" in wanted and (DATA / REAL).is_dir():
        out["real"] = base("Oakville long loop", None, load(DATA / REAL))
    return out


def base(name: str, folder: Path | None, sequence: Sequence) -> Base:
    """Return a sound drive with its run."""
    return Base(name, folder, sequence, faults_begin(sequence), run(lambda: sequence))


def faults_begin(sequence: Sequence) -> float:
    """Return a whole second in the second half of the drive after which it moves and turns."""
    reference, imu = sequence.reference, sequence.inertial
    assert reference is not None
    first, last = sequence.span
    rate = np.cumsum(np.abs(imu.gyro_b[:, 2])) * imu.interval
    way = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(reference.pos_e, axis=0), axis=1))]
    )
    best, most = first, -1.0
    for begin in np.arange(np.ceil(first + 0.5 * (last - first)), last - 60.0):
        ends = [begin, begin + 10.0]
        turned = float(np.diff(np.interp(ends, imu.time, rate))[0])
        moved = float(np.diff(np.interp(ends, reference.time, way))[0])
        if moved > 50.0 and turned > most:
            best, most = float(begin), turned
    return best


def run(read: Callable[[], Sequence], sound: Outcome | None = None) -> Outcome:
    """Go the way of ``certnav run``, and on where that stops if possible.

    Parameters
    ----------
    read : callable
        Returns the sequence, or refuses.
    sound : Outcome, optional
        What was said about the sound drive is left out.
    """
    said: list[tuple[str, str]] = []
    known = {stripped(line) for line in sound.lines} if sound else set()
    try:
        sequence = read()
        # Without its reference: few drives have one, and the fault has to be seen without.
        findings = check_sequence(dataclasses.replace(sequence, reference=None))
    except NavError as error:
        return Outcome("refused", (str(error),), np.nan, np.nan, np.nan, 0, 0.0)
    for f in findings:
        if f.severity != "note":
            said.append(("refused" if f.severity == "fatal" else "warned", f.line))
    try:
        solution = navigate(sequence, CONFIG)
        evaluation = evaluate(solution, sequence)
    except NavError as error:
        said.append(("refused", str(error)))
        lines = tuple(line for _, line in said)
        return Outcome("refused", lines, np.nan, np.nan, np.nan, 0, 0.0)
    said += [("noted", note) for note in solution.notes if note not in sequence.notes]
    said = [(v, line) for v, line in said if stripped(line) not in known]
    said.sort(key=lambda s: (VERDICTS.index(s[0]), not s[1].startswith("doubtful")))
    verdict = min((v for v, _ in said), key=VERDICTS.index, default="silent")
    lines = tuple(line for v, line in said if v == verdict or sound is None)
    return Outcome(verdict, lines, *figures(solution, evaluation))


def stripped(line: str) -> str:
    """Return a line without its numbers, to tell what is said of the sound drive too."""
    return re.sub(r"[-+]?\d+(\.\d+)?(e-?\d+)?", "#", line)


def figures(solution: Solution, evaluation: Evaluation) -> tuple[float, float, float, int, float]:
    """Return RMS and largest horizontal error, the largest in units of 3σ, refusals, duration."""
    error, sigma = evaluation.error_pos_n[:, :2], evaluation.sigma_pos_n[:, :2]
    horizontal = np.hypot(*error.T)
    refused = sum(u.reason.startswith("innovation test") for u in solution.updates)
    time = solution.trajectory.time
    return (
        float(np.sqrt(np.mean(horizontal**2))), float(horizontal.max()),
        float((np.abs(error) / (3.0 * sigma)).max()), refused, float(time[-1] - time[0]),
    )  # fmt: skip


def broken(fault: Fault, on: Base, work: Path) -> Outcome:
    """Do a fault to a drive and return what became of it."""
    if fault.files is None:
        assert fault.data is not None
        change = fault.data
        return run(lambda: change(on.sequence, on.begin), on.sound)
    assert on.folder is not None
    copy = work / "copy"
    shutil.copytree(on.folder, copy)
    try:
        fault.files(copy, on.begin % 604800.0)
        return run(lambda: load(copy), on.sound)
    finally:
        shutil.rmtree(copy)


@dataclass(frozen=True)
class Row:
    """One fault over all seeds: the quietest verdict, and medians."""

    fault: str
    base: str
    verdict: str
    line: str
    rms: tuple[float, float]
    largest: tuple[float, float]
    ratio: tuple[float, float]
    refused: tuple[float, float]
    harmful: bool
    undetectable: str = ""

    @property
    def unnoticed(self) -> bool:
        """Whether nothing was said, the solution went wrong, and it could have been seen."""
        return self.verdict == "silent" and self.harmful and not self.undetectable


def summarised(fault: Fault, on: list[Base], outcomes: list[Outcome]) -> Row:
    """Return the row of a fault: figures are medians over the seeds, sound and broken."""
    quietest = max(outcomes, key=lambda o: VERDICTS.index(o.verdict))

    def pair(name: str) -> tuple[float, float]:
        values = [[getattr(o, name) for o in some] for some in ([b.sound for b in on], outcomes)]
        return tuple(float(np.median(v)) for v in values)  # type: ignore[return-value]

    # Harm is judged where it was said least.
    harmful = any(
        o.ratio > max(1.0, HARM * b.sound.ratio)
        for b, o in zip(on, outcomes, strict=True)
        if o.verdict == quietest.verdict
    )
    line = "; ".join(clean(text) for text in quietest.lines[:2])
    return Row(
        fault.name, on[0].name, quietest.verdict, line, pair("rms"), pair("largest"),
        pair("ratio"), pair("refused"), harmful, fault.undetectable,
    )  # fmt: skip


def clean(text: str) -> str:
    """Return a line without the copy's folder."""
    return re.sub(r"\s+", " ", re.sub(r"\S*/copy/?", "", text)).strip(": ")


def rows(seeds: int, real: bool, only: str = "") -> list[Row]:
    """Do every fault to every drive."""
    chosen = [f for f in FAULTS if only in f.name]
    wanted = {f.base for f in chosen}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        drives = [bases(seed, work, wanted, real and seed == 0) for seed in range(seeds)]
        out = []
        for fault in chosen:
            on = [d[fault.base] for d in drives if fault.base in d]
            if on:
                out.append(summarised(fault, on, [broken(fault, b, work) for b in on]))
                print(f"{out[-1].verdict:>8}  {fault.base:<5}  {fault.name}", file=sys.stderr)
    return out


def table(made: list[Row], seeds: int) -> str:
    """Return the page's section."""
    lines = [
        SECTION, "",
        f"Made by `{COMMAND}` ({seeds} simulated drives of 240 s, figures are medians; the real "
        "drive from `CERTNAV_DATA`).",
        "Errors are horizontal, against the truth, of the sound run → of the broken one; *of 3σ* "
        "is the largest error along north or east over three of the filter's own σ there. The "
        "check looks at the drive without its reference, as most drives have none. What is "
        "*refused* stops `certnav run`; its figures are those of `--unchecked`, if there are any. "
        "*Silent* means that neither check nor the run's notes differ from the sound drive's.", "",
        "| fault | drive | | what is said | RMS [m] | largest [m] | of 3σ | refused updates |",
        "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip

    def two(values: tuple[float, float], form: str) -> str:
        return " → ".join("–" if np.isnan(v) else format(v, form) for v in values)

    for r in made:
        verdict = f"**{r.verdict}**" if r.unnoticed else r.verdict
        lines.append(
            f"| {r.fault} | {r.base} | {verdict} | {said(r)} | "
            f"{two(r.rms, '.2f')} | {two(r.largest, '.1f')} | {two(r.ratio, '.1f')} | "
            f"{two(r.refused, '.0f')} |"
        )
    counts = {v: sum(r.verdict == v for r in made) for v in VERDICTS}
    bad = sum(r.unnoticed for r in made)
    lines += [
        "",
        f"Of {len(made)} faults {counts['refused']} are refused, {counts['warned']} warned of, "
        f"{counts['noted']} noted, {counts['silent']} pass in silence; of these "
        f"{bad or 'none'} {'moves' if bad < 2 else 'move'} the solution beyond its 3σ and could "
        "have been seen.",
    ]
    return "\n".join(lines)


def said(row: Row) -> str:
    """Return what was said, or why nothing could be."""
    if row.verdict == "silent" and row.harmful and row.undetectable:
        return f"cannot be told: {row.undetectable}"
    return row.line.replace("|", "/") or "–"


def with_section(page: str, section: str) -> str:
    """Return the page with the section of this script replaced, or added at the end."""
    text = section + "\n"
    found = re.search(rf"(?ms)^{re.escape(SECTION)}\n.*?(?=^## |\Z)", page)
    if found is None:
        return f"{page.rstrip()}\n\n{text}" if page.strip() else f"# Trust\n\n{text}"
    after = page[found.end() :]
    return page[: found.start()] + text + (f"\n{after}" if after else "")


def main() -> int:
    """Print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="simulated drives [1]")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--no-real", action="store_true", help="simulated drives only")
    parser.add_argument("--only", default="", metavar="TEXT", help="faults whose name holds this")
    parser.add_argument("--out", type=Path, metavar="FILE", help="rewrite its section there")
    arguments = parser.parse_args()
    made = rows(arguments.seeds, not arguments.no_real, arguments.only)
    if arguments.json:
        print(json.dumps([dataclasses.asdict(r) for r in made], indent=2, ensure_ascii=False))
    elif arguments.out is None:
        print(table(made, arguments.seeds))
    else:
        page = arguments.out.read_text(encoding="utf-8") if arguments.out.exists() else ""
        new = with_section(page, table(made, arguments.seeds))
        arguments.out.write_text(new, encoding="utf-8")
    return 1 if any(r.unnoticed for r in made) else 0


if __name__ == "__main__":
    sys.exit(main())
