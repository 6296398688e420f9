"""How each seed of `seeds` is read: as a user's command would, in one call."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from .drives import WEEK
from .solutions import WRITE


def _load(format: str | None = None, **options: object) -> Callable[[Path], Any]:
    def run(folder: Path) -> Any:
        from certnav.datasets.loading import load

        return load(folder, format=format, **options)

    return run


def _file(module: str, function: str, name: str, **options: object) -> Callable[[Path], Any]:
    def run(folder: Path) -> Any:
        return getattr(importlib.import_module(module), function)(folder / name, **options)

    return run


def read_great_import(folder: Path) -> None:
    from certnav.datasets.great.importing import import_archives

    import_archives([folder / "campus-01.zip"], folder / "imported")


def _packed(folder: Path) -> list[Any]:
    """Read the one packed file that is there: the case keeps no other."""
    from certnav.datasets.rtklib import read_observations
    from certnav.datasets.text.rinex_packing import plain_rinex

    return [
        read_observations(plain_rinex(file), [folder / "brdc.nav"])
        for file in sorted(folder.iterdir())
        if file.name != "brdc.nav" and (file.is_dir() or not file.is_symlink())
    ]


def _rinex(folder: Path) -> Any:
    from certnav.datasets.rtklib import read_observations

    return read_observations(folder / "rover.obs", [folder / "brdc.nav"], signals="all")


def _precise(folder: Path) -> Any:
    from certnav.datasets.rtklib import precise_observations, read_observations, single_point

    products = [folder / name for name in ("day.sp3", "day.clk", "igs.atx")]
    broadcast = read_observations(folder / "rover.obs", [folder / "brdc.nav"])
    found, _ = precise_observations(broadcast, products)
    return single_point(found, [folder / "brdc.nav", *products])


def _raw_log(folder: Path) -> Any:
    from certnav.datasets.loading import load

    return [load(file) for file in sorted(folder.iterdir())]


def _relative(folder: Path) -> None:
    from certnav.datasets.rtklib import read_observations, relative_positions

    rover, navigation = folder / "rover.obs", [folder / "brdc.nav"]
    screened = read_observations(rover, navigation)
    relative_positions(rover, folder / "base.obs", navigation, screened=screened)


def _navigation(folder: Path) -> None:
    from certnav.datasets.rtklib.satellites import load_navigation, satellite_states

    nav = load_navigation([folder / "brdc.nav"])
    names = ["G01", "G05", "R01", "R10", "E01", "E11", "C06", "C20", "J01"]
    eph = [nav.eph[k].toe.time for k in range(min(nav.n, 3))]
    time = [t - 315964800.0 + 60.0 for t in eph] or [1.3e9]
    for t in time:
        satellite_states([folder / "brdc.nav"], names, np.full(len(names), t))


def _config(folder: Path) -> None:
    from certnav.nav.config_files import load_config, to_toml

    to_toml(load_config(folder / "config.toml"))


def _draft(folder: Path) -> Any:
    from certnav.datasets.own.declare import draft_declaration

    names = ("imu.csv", "gnss.csv", "odometer.csv", "ref.csv.gz")
    return draft_declaration([folder / name for name in names])


def _check(folder: Path) -> None:
    from certnav.nav.check.recording import check

    report = check(folder)
    report.text()
    json.dumps(report.as_dict(), allow_nan=False)


#: How each target reads its folder; what is read is returned where a test looks at it.
READ: dict[str, Callable[[Path], Any]] = {
    "great": _load(),
    "imu_text": _file(
        "certnav.datasets.text.imu", "read_imu_text", "imu.txt", week=WEEK, gyro_unit="deg/s"
    ),
    "inertial_explorer": _file(
        "certnav.datasets.formats.inertial_explorer", "read_reference_table", "ref.txt"
    ),
    "great_pvt": _file("certnav.datasets.great.pvt", "read_flt", "rover.flt", week=WEEK),
    "rtklib_pos_llh": _file("certnav.datasets.formats.rtklib_pos", "read_pos", "a.pos"),
    "rtklib_pos_ecef": _file("certnav.datasets.formats.rtklib_pos", "read_pos", "a.pos"),
    "rtklib_pos_dms": _file("certnav.datasets.formats.rtklib_pos", "read_pos", "a.pos"),
    **{
        f"solution_{form}": _file(
            "certnav.datasets.solutions.reading", "read_solution", file, week=WEEK
        )
        for form, (file, _) in WRITE.items()
    },
    "ubx": _file("certnav.datasets.formats.ubx", "read_ubx", "a.ubx"),
    "nmea": _file("certnav.datasets.formats.nmea", "read_nmea", "a.nmea"),
    **dict.fromkeys(("raw_ubx", "raw_sbf", "raw_novatel", "raw_rtcm3"), _raw_log),
    "kfgins": _load(),
    "oakville": _load(),
    "rtklibexplorer": _load(),
    "comma2k19": _load(),
    "smartloc": _load(),
    "instinct": _load("spirent", rate=10.0),
    "rinex_3": _rinex,
    "rinex_2": _rinex,
    "real_rinex": _rinex,
    "relative": _relative,
    "precise": _precise,
    "real_brdc0870": _navigation,
    "real_BRDC00IG": _navigation,
    "packed": _packed,
    "own_data": _load(),
    "own_rinex": _load(),
    "declare": _draft,
    "config": _config,
    "great_import": read_great_import,
    "check": _check,
    "check_great": _check,
}  # fmt: skip
