"""`certnav compare`: every method on the same drives, with the same spells of weak GNSS."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..compare.runs import Comparison

HELP = "set methods against each other in spells of weak GNSS"
DESCRIPTION = (
    "Set methods against each other on the same drives with the same spells of weak GNSS: GNSS "
    "alone, alignment alone, and loose coupling without and with Doppler below four satellites, "
    "vehicle constraints and smoothing."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav compare`` to its parser."""
    parser.add_argument("path", type=Path, nargs="+", help="folders of sequences")
    parser.add_argument(
        "--methods", default="all", metavar="LIST",
        help="comma-separated: gnss-only, alignment-only[+vehicle], certified-only[+vehicle], lc4, "
        "lc+ddia, lc+rows (each also with +vehicle, +smooth, or both), alignment-heading [all]",
    )  # fmt: skip
    parser.add_argument(
        "--outages", default="60/180", metavar="SPEC",
        help="DURATION/PERIOD or FROM-TO, :satellites left, @shifts: 60/180 (nothing left), "
        "60/180:2-3@0,60,120, 60/180:3high, 60/180:canyon60, 10-end:2 [60/180]",
    )  # fmt: skip
    parser.add_argument(
        "--seeds", type=int, default=1, metavar="N", help="draws of the satellites left [1]"
    )
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="SECTION.KEY=VALUE",
        help="override one configuration value; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, default=Path("results/comparison"), metavar="DIR",
        help="page, figures and one result directory a method [results/comparison]",
    )  # fmt: skip
    parser.add_argument(
        "--reports", action="store_true",
        help="draw the report of every run, too: most of the time (certnav report DIR draws one)",
    )  # fmt: skip
    parser.add_argument("--jobs", type=int, default=-1, help="processes, −1: all processors")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler to spread over")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(arguments: argparse.Namespace) -> None:
    """Compare, write page and result directories, and say what came out."""
    from ...datasets.cache import kept_in
    from ...datasets.loading import load
    from ...datasets.placing import written_whole
    from ...filters.errors import ConfigError
    from ..compare.comparison import compare
    from ..compare.methods import parse_methods
    from ..compare.report import check_replaceable, write_page
    from ..config_files import load_config
    from ..spells.outages import parse_outages
    from .terminal.progress import progress

    if arguments.seeds < 1:
        raise ConfigError(f"--seeds: expected at least 1, found {arguments.seeds}")
    if arguments.jobs == 0:
        raise ConfigError("--jobs: expected a number of processes, or −1; found 0")
    outages, methods = parse_outages(arguments.outages), parse_methods(arguments.methods)
    config = load_config(arguments.config, arguments.set)
    out: Path = arguments.out.resolve()
    check_replaceable(out)
    with written_whole(out) as draft:
        with progress() as report, kept_in(out.parent / ".certnav-cache"):
            comparison = compare(
                [load(path, **config.data) for path in arguments.path], methods, outages, config,
                seeds=arguments.seeds, out=draft, draw=_report if arguments.reports else None,
                jobs=arguments.jobs, scheduler=arguments.scheduler, progress=report,
            )  # fmt: skip
        write_page(comparison, draft)
    say(comparison, out, arguments.json)


def _report(draft: Path) -> None:
    from ..report.run import write_report  # slow to import

    write_report(draft)


def say(comparison: Comparison, out: Path, as_json: bool) -> None:
    """Print a comparison, and where its page is."""
    from ..compare.report import PAGE
    from ..compare.runs import as_dict
    from ..results.summary import strict

    content = as_dict(comparison)
    if as_json:
        print(json.dumps(strict(content), allow_nan=False))
        return
    for line in table(content):
        print(line)
    for note in comparison.notes:
        print(f"  {note}")
    print(f"  page        {out / PAGE}")


def table(content: dict[str, Any]) -> list[str]:
    """Return the drift and the errors of each method as lines of text, recording by recording."""
    parts = list(content["recordings"].items())
    together = content["methods"]
    if len(parts) > 1 and any(f["spells"] for f in together.values()):
        parts.append(("all recordings together", together))
    lines = []
    for name, by_method in parts:
        if len(parts) > 1:
            lines.append(f"{name}:")
        lines += [
            f"{'':24}{'drift per spell [m]':^27}{'horizontal':>11}{'heading':>9}",
            f"{'method':24}{'median':>9}{'RMS':>9}{'95 %':>9}{'RMS [m]':>11}{'RMS [°]':>9}",
            *(_row(method, f) for method, f in by_method.items()),
        ]
    return lines


def _row(name: str, f: dict[str, Any]) -> str:
    def number(value: float | None) -> str:
        return f"{'–':>9}" if value is None else f"{value:9.2f}"

    if not f["runs"]:
        return f"{name:24}not available: {f['not_available'][0]}"
    d, e = f["drift_m"], f["errors"]
    heading = e["heading_rms_deg"]
    if "alignment_windows" in f:
        heading = f["alignment_windows"]["mae_deg"]
    drift = "".join(number(d[k]) for k in ("median", "rms_of_maxima", "p95"))
    return f"{name:24}{drift}  {number(e['horizontal_rms_m'])}{number(heading)}"
