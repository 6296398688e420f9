"""`certnav run`: navigate a recording and write its result directory."""

from __future__ import annotations

import argparse
from pathlib import Path

#: Exit status of a run whose solution was lost, and could not be found again.
LOST = 3
HELP = "navigate a sequence and write a result directory with a report"
DESCRIPTION = (
    "Navigate a sequence: GNSS positions and Doppler velocities with the IMU in "
    "an error-state filter, judged against the reference if there is one."
)
EXAMPLE = "certnav run drive --smooth"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav run`` to its parser."""
    parser.add_argument(
        "path", type=Path, help="folder of the sequence, its sequence.toml, or with --imu a "
        "receiver's file: a raw log (UBX, SBF, RTCM 3, NovAtel) or RINEX",
    )  # fmt: skip
    parser.add_argument(
        "--imu", type=Path, metavar="FILE",
        help="the IMU's file beside a receiver's: both by a declaration, which is drafted first",
    )  # fmt: skip
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="SECTION.KEY=VALUE",
        help="override one configuration value, e.g. data.lever=figure; repeatable",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="DIR", help="result directory [results/NAME]")
    parser.add_argument(
        "--start", type=float, metavar="T", help="GPS seconds of week (or GPS seconds)"
    )
    parser.add_argument("--end", type=float, metavar="T", help="likewise")
    parser.add_argument("--format", default="", metavar="LIST", help="also write pos,kml,tum,nav")
    parser.add_argument(
        "--only", metavar="LIST",
        help="write these formats instead of solution.csv, and no report: the fastest way through",
    )  # fmt: skip
    parser.add_argument(
        "--base", type=Path, metavar="FILE",
        help="RINEX or raw log of a base station, or a folder of them: RTK positions "
        "(gnss.position = rtk)",
    )  # fmt: skip
    parser.add_argument(
        "--precise", action="append", default=[], metavar="FILE",
        help="precise orbits (SP3), clocks or antennas (ANTEX); repeatable (data.precise)",
    )  # fmt: skip
    parser.add_argument(
        "--great", metavar="NAME",
        help="the folder is this GREAT sequence (campus-01 …): take what the catalogue knows of it",
    )  # fmt: skip
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE",
        help="take lever arm, mounting and time offset from this file, not from the recording",
    )  # fmt: skip
    parser.add_argument(
        "--write-calibration", type=Path, metavar="FILE",
        help="write what the run has learned of them, for the next run on the same vehicle",
    )  # fmt: skip
    parser.add_argument(
        "--figures", choices=("pdf", "svg", "png"),
        help="also write the figures for a paper, into figures/ of the result",
    )  # fmt: skip
    parser.add_argument("--no-report", action="store_true", help="leave report.html out: faster")
    parser.add_argument("--smooth", action="store_true", help="smooth: every epoch knows all data")
    parser.add_argument(
        "--unchecked", action="store_true", help="navigate even if the data contradict physics"
    )
    parser.add_argument(
        "--json", action="store_true", help="print summary.json instead of the summary"
    )


def run(arguments: argparse.Namespace) -> int:
    """Navigate a recording; status 3 if the solution was lost."""
    import dataclasses

    from ...filters.errors import ConfigError, DataError
    from ..config_files import load_config
    from ..results.formats import parse_formats
    from .flow.navigation import navigate_folder

    smooth = ["filter.smooth=true"] if arguments.smooth else []
    config = load_config(arguments.config, [*arguments.set, *smooth])
    if arguments.base is not None:
        if not arguments.base.exists():  # before anything is read
            raise DataError("no such file or folder", file=arguments.base, remedy="check --base")
        gnss = dataclasses.replace(config.gnss, base=str(arguments.base), position="rtk")
        config = dataclasses.replace(config, gnss=gnss)
    if arguments.precise:
        data = {**config.data, "precise": arguments.precise}
        config = dataclasses.replace(config, data=data)
    path = arguments.path
    if arguments.imu is not None:
        from ...datasets.own.drafted import declaration_of
        from ..drafting import measured_draft

        path = declaration_of(path, arguments.imu, measured_draft)
    if arguments.great is not None:
        from ...datasets.great.catalogue import great_sequence

        path, data = great_sequence(path, arguments.great, config.data)
        config = dataclasses.replace(config, data=data)
    only = arguments.only is not None
    formats = parse_formats(arguments.only if only else arguments.format)
    if only and not formats:
        raise ConfigError("--only: expected pos, kml, tum or nav, found none")
    if only and arguments.figures:
        raise ConfigError(
            "--only and --figures: figures are drawn from solution.csv; leave one out"
        )
    if only and arguments.format:
        raise ConfigError("--only and --format: name all formats in one of them")
    out, status = navigate_folder(
        path, config, arguments.out, formats, arguments.start, arguments.end,
        checked=not arguments.unchecked, report_page=not (arguments.no_report or only),
        table=not only, say=not arguments.json, figures=arguments.figures,
        calibration=arguments.calibration, learn=arguments.write_calibration,
    )  # fmt: skip
    if arguments.json:
        print((out / "summary.json").read_text(encoding="utf-8").rstrip())
    return LOST if status == "lost" else 0
