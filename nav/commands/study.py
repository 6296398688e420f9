"""`certnav study`: the DDIA-VE paper's tables and figures of any recordings, side by side."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

HELP = "the DDIA-VE paper's tables and figures, of recordings side by side"
DESCRIPTION = (
    "Make every table and figure of the DDIA-VE paper of any number of recordings with raw Doppler "
    "and a reference, side by side: one page, CSV, LaTeX and PDF."
)
EXAMPLE = "certnav study drive1 drive2 --out paper"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav study`` to its parser."""
    parser.add_argument("path", type=Path, nargs="+", help="folders of recordings")
    parser.add_argument(
        "--direction", default="motion", metavar="FROM",
        help="direction of motion from the reference's velocity (motion) or attitude [motion]",
    )  # fmt: skip
    parser.add_argument("--systems", default="G", help="constellation letters [G]")
    parser.add_argument(
        "--label", default="", help="only rows the recording labels so, for example los"
    )
    parser.add_argument(
        "--epochs", type=int, default=200, metavar="N", help="of an outage, for Table 4 [200]"
    )
    parser.add_argument(
        "--precise", action="append", default=[], type=Path, metavar="FILE",
        help="precise orbits (SP3), clocks or antennas (ANTEX): what they cover is studied with "
        "them beside broadcast ephemerides; repeatable",
    )  # fmt: skip
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="data.KEY=VALUE",
        help="option of a reader, for the recordings whose reader knows it; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, default=Path("results/study"), metavar="DIR",
        help="where the page and all files go [results/study]",
    )  # fmt: skip
    parser.add_argument("--jobs", type=int, default=-1, help="processes, −1: all processors")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler to spread over")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(arguments: argparse.Namespace) -> None:
    """Study, write the directory, and say what was found."""
    from ...filters.errors import ConfigError
    from ..config_files import load_config
    from ..results.summary import strict
    from ..study.recording import StudyOptions, study
    from ..study.report import PAGE, as_dict, check_replaceable, sentences, write_study
    from .terminal.progress import progress

    if arguments.jobs == 0:
        raise ConfigError("--jobs: expected a number of processes, or −1; found 0")
    config = load_config(arguments.config, arguments.set)
    options = StudyOptions(
        arguments.systems, arguments.direction, arguments.label, arguments.epochs
    )
    check_replaceable(arguments.out.resolve())
    with progress() as report:
        report(0.0, f"{len(arguments.path)} recordings")
        found = study(
            arguments.path, options, data=dict(config.data), precise=arguments.precise,
            jobs=arguments.jobs, scheduler=arguments.scheduler, progress=report,
        )  # fmt: skip
    out = write_study(found, arguments.out)
    if arguments.json:
        print(json.dumps(strict(as_dict(found)), allow_nan=False))
        return
    for sentence in sentences(found):
        print(sentence)
    for one in found.recordings:
        for note in one.notes:
            print(f"  {note}")
    print(f"  page        {out / PAGE}")
    print(f"  for a paper {out}: table*.tex, fig*.pdf, *.csv")
