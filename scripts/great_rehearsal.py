"""Rehearse a release of GREAT: its archives, simulated, through `certnav great` to the pages.

    python scripts/great_rehearsal.py [--out DIR] [--seconds 200] [--only campus-01,urban-02]
                                      [--outages 30/90:2-3] [--methods LIST] [--skip LIST]

makes DIR/downloads, archives with the names and the inner layout of the download page (one IMU.zip
and one reference a sequence, GNSS_RAW_DATA of all of them: a day's rover file and ephemerides),
shows that what the files do not say is asked all at once, answers it, and gives the same command
again. Nothing is typed in between. Every drive is simulated, short, and none of its figures is of
the GREAT dataset; the pages say so, and so do the tables and the names in them.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
import zipfile
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path

import numpy as np

from certnav.datasets.great.writer import write_imu, write_observations, write_reference
from certnav.datasets.simulation.constellation import write_navigation
from certnav.datasets.simulation.simulator import Simulation, SimulationConfig, simulate
from certnav.nav.commands.cli import main as certnav

#: As the car has it: antenna (2020, and another for 2022) and how the MEMS IMU sits in it.
LEVER_2022 = (-0.30, 0.02, -0.21)
MOUNTING = (0.2, -0.65, 0.5)
DAY_1, DAY_2, DAY_3 = (2020, 10, 27), (2020, 10, 29), (2022, 10, 23)


@dataclasses.dataclass(frozen=True)
class Planned:
    """One sequence of the release: when, between what houses, and what is cut out of its GNSS.

    Parameters
    ----------
    name : str
    start : datetime
        GPS time.
    density : str
        See `SimulationConfig`.
    tunnels : tuple of (float, float)
        Beginning and end as shares of the drive: no satellite there.
    saved : {'named', 'folder', 'whole'}
        How its archive was saved: under its name, as IMU.zip in a folder of its name, or the whole
        sequence as one archive.
    """

    name: str
    start: datetime
    density: str
    tunnels: tuple[tuple[float, float], ...] = ()
    saved: str = "named"


RELEASE = (
    Planned("campus-01", datetime(*DAY_1, 2, 9, 50), "suburb"),
    Planned("campus-02", datetime(*DAY_1, 2, 24, 29), "urban"),
    Planned("campus-03", datetime(*DAY_1, 2, 45), "urban", ((0.60, 0.68),), "whole"),
    Planned("campus-night", datetime(*DAY_2, 11, 30), "urban"),
    Planned("suburb-01", datetime(*DAY_2, 5, 59), "open", saved="folder"),
    Planned("suburb-02", datetime(*DAY_2, 6, 20), "suburb", saved="folder"),
    Planned("urban-01", datetime(*DAY_1, 4, 10), "urban", ((0.45, 0.55), (0.75, 0.80))),
    Planned("urban-02", datetime(*DAY_3, 3, 0), "canyon", ((0.55, 0.65),), "folder"),
)
ANSWERS = f"""\
reference_point = "mems"
gyro_unit = "deg/s"
lever = "figure"
[urban-02]
lever_antenna_frd_m = {list(LEVER_2022)}
"""


def simulated(planned: Planned, seconds: float) -> Simulation:
    """Return a sequence's drive, with the satellites of its day and nothing in its tunnels."""
    number = [p.name for p in RELEASE].index(planned.name)
    config = SimulationConfig(
        planned.name, 1700 + number, seconds, planned.start, density=planned.density,
        static_start=15.0, mounting_rpy_deg=MOUNTING, sky_seed=planned.start.toordinal(),
    )  # fmt: skip
    if planned.start.year == 2022:
        config = dataclasses.replace(config, lever_antenna_b=LEVER_2022)
    drive = simulate(config)
    into = (drive.observations.time - config.start_time) / seconds
    dark = np.zeros(into.size, dtype=bool)
    for begin, end in planned.tunnels:
        dark |= (into > begin) & (into < end)
    return dataclasses.replace(drive, observations=drive.observations.take(~dark))


def write_release(
    downloads: Path, seconds: float, chosen: Iterable[Planned] = RELEASE
) -> list[Path]:
    """Write the archives of a release into a folder; return what one finds there."""
    work = downloads / ".work"
    work.mkdir(parents=True)
    days: dict[tuple[int, int, int], list[Simulation]] = {}
    for planned in sorted(chosen, key=lambda p: p.start):
        drive = simulated(planned, seconds)
        days.setdefault((*planned.start.timetuple()[:3],), []).append(drive)
        _write_sequence(downloads, work, planned, drive)
    with zipfile.ZipFile(downloads / "GNSS_RAW_DATA.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for day, drives in days.items():
            _write_day(archive, work, day, drives)
    for file in work.iterdir():
        file.unlink()
    work.rmdir()
    return sorted(downloads.iterdir())


def _write_sequence(downloads: Path, work: Path, planned: Planned, drive: Simulation) -> None:
    mems, tactical, truth = (work / name for name in ("mems", "tactical", "truth"))
    write_imu(mems, drive.imu)
    write_imu(tactical, drive.tactical_imu())
    write_reference(truth, drive.reference, drive.trajectory.C_bv)
    inside = {"IMU/MEMS_imu_data.txt": mems, "IMU/Tactical_imu_data.txt": tactical}
    name, reference = downloads / f"{planned.name}-IMU.zip", downloads / f"{planned.name}.txt"
    if planned.saved == "folder":
        (downloads / planned.name).mkdir()
        name = downloads / planned.name / "IMU.zip"
        reference = downloads / planned.name / "groundtruth.txt"
    if planned.saved == "whole":
        name = downloads / f"Dataset_{planned.name}.zip"
        inside = {f"Dataset_{planned.name}/{key}": file for key, file in inside.items()}
        inside[f"Dataset_{planned.name}/Groundtruth/groundtruth.txt"] = truth
    with zipfile.ZipFile(name, "w", zipfile.ZIP_DEFLATED) as archive:
        for place, file in inside.items():
            archive.write(file, place)
        if planned.saved == "whole":  # as it comes with its pictures
            archive.writestr(f"Dataset_{planned.name}/Image/Img0/timestamps.txt", "0.0,0.jpg\n")
            archive.writestr(f"Dataset_{planned.name}/Image/Img0/Data/0.jpg", b"\xff\xd8")
    if planned.saved != "whole":
        truth.replace(reference)


def _write_day(
    archive: zipfile.ZipFile, work: Path, day: tuple[int, int, int], drives: list[Simulation]
) -> None:
    """Add a day's one rover file, of all its drives, and its ephemerides."""
    date = datetime(*day)
    stem = f"{date.timetuple().tm_yday:03d}0.{date.year % 100:02d}"
    lines: list[str] = []
    for number, drive in enumerate(drives):
        part = work / "rover"
        write_observations(part, drive.observations, 1.0)
        text = part.read_text(encoding="ascii").splitlines(keepends=True)
        head = next(k for k, line in enumerate(text) if "END OF HEADER" in line) + 1
        if number == 0:
            lines += [line for line in text[:head] if "TIME OF LAST OBS" not in line]
        lines += text[head:]
    home = f"GNSS_RAW_DATA/{date:%Y%m%d}"
    archive.writestr(f"{home}/SEPT{stem}O", "".join(lines))
    begin, end = drives[0].config.start_time, drives[-1].config.start_time
    write_navigation(
        work / "broadcast", drives[0].ephemerides, begin, end + drives[-1].config.duration
    )
    archive.write(work / "broadcast", f"{home}/brdm{stem}p")


def rehearse(out: Path, arguments: argparse.Namespace) -> int:
    """Write the release, see the questions, answer them, and do all of it; return the status."""
    names = arguments.only.split(",") if arguments.only else [p.name for p in RELEASE]
    chosen = [p for p in RELEASE if p.name in names]
    if len(chosen) != len(names):
        sys.exit(f"--only: expected some of {', '.join(p.name for p in RELEASE)}")
    began = time.perf_counter()
    downloads = out / "downloads"
    write_release(downloads, arguments.seconds, chosen)
    print(f"{len(chosen)} sequences simulated in {time.perf_counter() - began:.0f} s", flush=True)
    site = out / "site"
    command = [
        "great", str(downloads), "--out", str(site), "--outages", arguments.outages,
        "--methods", arguments.methods, "--jobs", str(arguments.jobs), "--skip", arguments.skip,
    ]  # fmt: skip
    if arguments.scheduler:
        command += ["--scheduler", arguments.scheduler]
    print(f"certnav {' '.join(command)}", flush=True)
    if certnav(command) != 1 or not (site / "declared.toml").is_file():
        print("nothing was asked", file=sys.stderr)
        return 1
    (site / "declared.toml").write_text(ANSWERS, encoding="utf-8")
    began = time.perf_counter()
    status = certnav(command)
    print(f"archives to pages in {time.perf_counter() - began:.0f} s, status {status}", flush=True)
    return status


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    made = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    made.add_argument("--out", type=Path, default=Path("results/great-rehearsal"))
    made.add_argument("--seconds", type=float, default=200.0, help="of each drive [200]")
    made.add_argument("--only", default="", metavar="LIST", help="these sequences")
    made.add_argument("--outages", default="30/90:2-3", metavar="SPEC")
    made.add_argument("--methods", default="all", metavar="LIST")
    made.add_argument("--skip", default="", metavar="LIST", help="steps to leave out")
    made.add_argument("--jobs", type=int, default=2)
    made.add_argument("--scheduler", metavar="ADDRESS")
    return made


if __name__ == "__main__":
    given = parser().parse_args()
    if given.out.exists():
        sys.exit(f"{given.out}: exists; remove it, or name another --out")
    sys.exit(rehearse(given.out, given))
