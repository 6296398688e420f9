"""The GREAT-Dataset sequences: what is known of each, and what the user has to find out.

Facts: Readme and figures parameter1/2 of GREAT-WHU/GREAT-Dataset; GREAT-WHU/GREAT-MSF for the
second lever arm. The files are on a cloud drive that is opened by hand: the catalogue names the
page, and `datasets.import_archives` arranges what was downloaded.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...filters.errors import ConfigError
from .installation import LEVERS, MEMS_TO_TACTICAL, WEEK_2020, sidecar
from .options import IMU_PRESETS

#: Where the download links are: section "Data Download" of the Readme.
PAGE = "https://github.com/GREAT-WHU/GREAT-Dataset"
_WEEK_2022 = 2233


@dataclass(frozen=True)
class CatalogueEntry:
    """One sequence.

    Parameters
    ----------
    name : str
    date : str
        Day of the recording, year-month-day.
    week : int
        GPS week.
    day : int
        Day of the GPS week, 0 = Sunday: its seconds of week are 86400·day … 86400·(day + 1).
    duration_s : float
        As the Readme gives it.
    difficulty : str
        As the Readme grades it.
    surroundings : str
    receiver : str
    """

    name: str
    date: str
    week: int
    day: int
    duration_s: float
    difficulty: str
    surroundings: str
    receiver: str

    @property
    def lever_known(self) -> bool:
        """Whether the public drawings show where the antenna is."""
        return self.week == WEEK_2020


def _of_2020(
    name: str, day: int, duration: float, difficulty: str, surroundings: str
) -> CatalogueEntry:
    date = f"2020-10-{25 + day}"
    return CatalogueEntry(
        name, date, WEEK_2020, day, duration, difficulty, surroundings, "Septentrio PolaRx5"
    )


#: The eight sequences, in the Readme's order.
GREAT: tuple[CatalogueEntry, ...] = (
    _of_2020("campus-01", 2, 606.85, "medium", "campus: buildings, trees"),
    _of_2020("campus-02", 2, 806.9, "medium", "campus: buildings, trees"),
    _of_2020("campus-03", 2, 1200.1, "hard", "campus, severe in parts"),
    _of_2020("campus-night", 4, 545.7, "hard", "campus at night, severe"),
    _of_2020("suburb-01", 4, 1081.35, "easy", "open sky, trees"),
    _of_2020("suburb-02", 4, 837.0, "easy", "open sky, trees, traffic"),
    _of_2020("urban-01", 2, 767.3, "medium", "flyovers, tunnels, traffic"),
    CatalogueEntry(
        "urban-02", "2022-10-23", _WEEK_2022, 0, 1399.2, "hard",
        "flyovers, tunnels, severe", "Septentrio AsteRx4",
    ),
)  # fmt: skip


def entry(name: str) -> CatalogueEntry | None:
    """Return the sequence of that name, however it is spelt (Campus_01, campus01 …)."""
    plain = _plain(name)
    return next((e for e in GREAT if _plain(e.name) == plain), None)


def named_in(text: str) -> CatalogueEntry | None:
    """Return the one sequence whose name occurs in a file or folder name; None if not one."""
    found = [e for e in GREAT if _plain(e.name) in _plain(text)]
    return found[0] if len(found) == 1 else None


def _plain(text: str) -> str:
    return "".join(c for c in text.lower() if c.isalnum())


def catalogue_text() -> str:
    """Return the catalogue as a table with what is known and unknown, for the command line."""
    head = f"{'sequence':<13}{'date':<12}{'week':<6}{'s':>7}  {'difficulty':<11}{'receiver':<20}"
    lines = ["GREAT-Dataset (Wuhan University), car, GNSS 1 Hz, MEMS 100 Hz, tactical IMU 200 Hz"]
    lines += [f"download by hand: {PAGE} (section Data Download)", "", head + "surroundings"]
    lines += [
        f"{e.name:<13}{e.date:<12}{e.week:<6}{e.duration_s:>7.0f}  {e.difficulty:<11}"
        f"{e.receiver:<20}{e.surroundings}"
        for e in GREAT
    ]
    figure, msf = LEVERS["figure", "mems"][0], LEVERS["msf_xml", "mems"][0]
    tactical = LEVERS["figure", "tactical"][0]
    between = MEMS_TO_TACTICAL[_WEEK_2022]
    lines += [
        "",
        "Lever arms IMU→antenna, forward right down [m]; none is taken unless you name it:",
        f'  2020  MEMS {figure} as drawn (lever = "figure"), {msf} in GREAT-MSF\'s',
        '        configuration (lever = "msf_xml"): they differ by 0.24 m, both are published;',
        f"        tactical {tactical} as drawn",
        f"  2022  urban-02: the antenna is not drawn; known is only MEMS→tactical {between}.",
        "        Take it from the dataset's file Extrinsic & Intrinsic Parameters",
        "Reference: Inertial Explorer, RTK with the tactical IMU, smoothed. Which point it is of",
        '        is not stated: declare reference_point = "mems", "tactical" or "antenna".',
        "Durations are the Readme's; for urban-02 its editions give 1399 and 1622 s.",
        "Licence: MIT, for academic purposes; the Readme asks to be cited.",
        "",
        "Wanted for each sequence: IMU.zip and the reference solution; for all: GNSS_RAW_DATA.",
        "Then: certnav datasets import ZIP… --to DIR",
    ]
    return "\n".join(lines)


def _unknown(name: str) -> ConfigError:
    """Return the error that lists the sequences of the place that is meant, or the nearest."""
    place = re.match("[a-z]*", _plain(name))
    same = [e.name for e in GREAT if place and _plain(e.name).startswith(place[0] or "?")]
    if same:
        return ConfigError(f"--great: no sequence '{name}' — of {same[0].partition('-')[0]} there "
                           f"are {', '.join(same)}")  # fmt: skip
    return ConfigError.unknown_key(name, [e.name for e in GREAT], where="--great")


def great_sequence(
    path: str | Path, name: str, options: Mapping[str, Any]
) -> tuple[Path, dict[str, Any]]:
    """Return a sequence's folder, and reader options with what the catalogue knows added.

    Parameters
    ----------
    path : path
        The folder of the sequence, or one that holds ``Dataset_<name>``.
    name : str
        As in `GREAT`, however it is spelt.
    options : mapping
        What the user has declared; it wins, and so does a ``great.toml`` in the folder.

    Raises
    ------
    ConfigError
        An unknown sequence, or one whose lever arm has to be declared and is not.
    """
    known = entry(name)
    if known is None:
        raise _unknown(name)
    path = Path(path)
    inside = path / f"Dataset_{known.name}"
    folder = inside if inside.is_dir() else path
    other = named_in(folder.resolve().name)
    if other is not None and other != known:
        raise ConfigError(f"--great {known.name}: the folder is named after {other.name}: {folder}")
    imu = options.get("imu", "mems")
    facts: dict[str, Any] = {"week": known.week}
    if imu in IMU_PRESETS:
        facts["imu_preset"] = IMU_PRESETS[imu]
    if ("figure", imu) in LEVERS and known.lever_known:
        facts["lever"] = "figure"
    declared = {**sidecar(folder, imu), **options}
    if "lever_antenna_frd_m" in declared:
        facts.pop("lever", None)
    elif "lever" not in declared and "lever" not in facts:
        raise ConfigError(
            f"{known.name}: lever arm of the {imu} IMU unknown (no public drawing shows the "
            "antenna): take it from the dataset's file Extrinsic & Intrinsic Parameters and add "
            '--set "data.lever=[forward, right, down]" in metres'
        )
    new = {key: value for key, value in facts.items() if key not in declared}
    return folder, {**new, **options}
