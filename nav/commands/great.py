"""`certnav great`: from the archives of the download page to one site of tables."""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .flow.dataset import Outcome

HELP = "from the GREAT archives to all tables and pages, in one go"
DESCRIPTION = (
    "Arrange downloaded GREAT archives, ask once for what the files do not say, then check, study, "
    "navigate, tune and compare all sequences: one site of pages, every table as LaTeX."
)
EXAMPLE = "certnav great DOWNLOADS --out site"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav great`` to its parser."""
    parser.add_argument(
        "archives", type=Path, nargs="*", metavar="ARCHIVE",
        help="what was downloaded, or folders of it; none: what is in --data already",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, default=Path("results/great"), metavar="DIR",
        help="where index.html and everything else goes [results/great]",
    )  # fmt: skip
    parser.add_argument(
        "--data", type=Path, metavar="DIR", help="where the sequences are arranged [DIR/data]"
    )
    parser.add_argument(
        "--declared", type=Path, metavar="FILE",
        help="answers to what the files do not say; drafted where there is none "
        "[DIR/declared.toml]",
    )  # fmt: skip
    parser.add_argument(
        "--only", metavar="LIST", help="these sequences, comma-separated: campus-01,urban-02"
    )
    parser.add_argument(
        "--methods", default="all", metavar="LIST", help="as for certnav compare [all]"
    )
    parser.add_argument(
        "--outages", default="60/180:2-3", metavar="SPEC",
        help="weak GNSS, as for certnav compare, of comparison and tuning [60/180:2-3]",
    )  # fmt: skip
    parser.add_argument(
        "--skip", default="", metavar="LIST", help="of study,tune,compare: leave these out"
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="SECTION.KEY=VALUE",
        help="override one configuration value; repeatable",
    )  # fmt: skip
    parser.add_argument("--jobs", type=int, default=-1, help="processes, −1: all processors")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler to spread over")
    parser.add_argument("--json", action="store_true", help="print great.json instead")


def run(arguments: argparse.Namespace) -> int:
    """Do all of it; status 1 if a step failed or no sequence could be navigated."""
    from ...datasets.great.asking import asked
    from ...filters.errors import ConfigError
    from ..compare.methods import parse_methods
    from ..config_files import load_config
    from ..spells.outages import parse_outages
    from .flow.dataset import SKIPPABLE, Work, work_through
    from .flow.first_run import compile_ahead
    from .flow.site import DATA, check_replaceable, write_site
    from .terminal.progress import announce_kernels, progress

    if arguments.jobs == 0:
        raise ConfigError("--jobs: expected a number of processes, or −1; found 0")
    outages, methods = parse_outages(arguments.outages), parse_methods(arguments.methods)
    if not outages.keeps_some:
        raise ConfigError(f"--outages {arguments.outages}: leaves no satellite, nothing to tune")
    skipped = tuple(filter(None, arguments.skip.split(",")))
    for name in skipped:
        if name not in SKIPPABLE:
            raise ConfigError.unknown_key(name, SKIPPABLE, where="--skip")
    config = load_config(arguments.config, arguments.set)
    out: Path = arguments.out.resolve()
    check_replaceable(out)
    home = (arguments.data or out / "data").resolve()
    folders = _arranged(arguments.archives, home, arguments.only)
    asked(home, arguments.declared or arguments.out / "declared.toml", folders)
    if announce_kernels():
        compile_ahead()
    out.mkdir(parents=True, exist_ok=True)
    work = Work(tuple(folders), config, outages, tuple(methods), arguments.jobs,
                arguments.scheduler, skipped)  # fmt: skip
    with progress() as report:
        found = work_through(work, out, report)
    page = write_site(work, found, out)
    if arguments.json:
        print((out / DATA).read_text(encoding="utf-8").rstrip())
    else:
        _say(found, page)
    return 1 if found.failures or not found.good() else 0


def _say(found: Outcome, page: Path) -> None:
    for step, seconds, why in found.steps:
        print(f"  {step:<12}{seconds:6.0f} s  {'failed' if why else 'done'}")
    for failure in found.failures:
        print(f"  {failure}")
    if found.simulated:
        print(f"  {len(found.simulated)} of {len(found.looked)} recordings are simulated: none of "
              "their figures is of GREAT")  # fmt: skip
    print(f"  page        {page}")


def _arranged(archives: Iterable[Path], home: Path, only: str | None) -> list[Path]:
    """Import what was downloaded; return the folders of the sequences that are asked for."""
    from ...datasets.great.asking import sequences_in
    from ...datasets.great.catalogue import entry
    from ...datasets.great.importing import import_archives
    from ...filters.errors import ConfigError, DataError

    downloads = list(archives)
    if downloads:
        made = import_archives(downloads, home)
        print(f"{len(made.placed)} files arranged in {home}")
        for name, lacking in made.missing.items():
            print(f"  {name:<14}{'lacks ' + ', '.join(lacking) if lacking else 'complete'}")
    there = sequences_in(home)
    if not there:
        raise DataError(
            "no GREAT sequence there", file=home,
            remedy="name the downloaded archives, or with --data a folder with Dataset_… in it",
        )  # fmt: skip
    if only is not None:
        wanted = [entry(name) for name in only.split(",")]
        for name, one in zip(only.split(","), wanted, strict=True):
            if one is None or one not in there:
                raise ConfigError.unknown_key(name, [e.name for e in there], where="--only")
        there = [e for e in there if e in wanted]
    return [home / f"Dataset_{e.name}" for e in there]
