"""`certnav compare`: every method on the same drives, with the same spells of weak GNSS."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ...datasets.sequence import Sequence
    from ..compare.runs import Comparison

HELP = "set methods against each other in spells of weak GNSS"
DESCRIPTION = (
    "Set methods against each other on the same drives with the same spells of weak GNSS: GNSS "
    "alone, alignment alone, and loose coupling without and with Doppler below four satellites, "
    "vehicle constraints and smoothing; and results of other programs (--result)."
)
EXAMPLE = "certnav compare drive --outages 60/180 --out comparison"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav compare`` to its parser."""
    parser.add_argument("path", type=Path, nargs="*", help="folders of sequences")
    parser.add_argument(
        "--methods", default="all", metavar="LIST",
        help="comma-separated: gnss-only, alignment-only[+vehicle], certified-only[+vehicle], lc4, "
        "lc+ddia, lc+rows (each also with +vehicle, +smooth, or both), alignment-heading [all]",
    )  # fmt: skip
    parser.add_argument(
        "--outages", default="60/180", metavar="SPEC",
        help="DURATION/PERIOD or FROM-TO, :satellites left, @shifts: 60/180 (nothing left), "
        "60/180:2-3@0,60,120, 60/180:3high, 60/180:canyon60, 10-end:2, none [60/180]",
    )  # fmt: skip
    parser.add_argument(
        "--seeds", type=int, default=1, metavar="N", help="draws of the satellites left [1]"
    )
    parser.add_argument(
        "--result", action="append", default=[], metavar="NAME=FILE[@POINT]",
        help="a result of another program as a method: RTKLIB or GINav .pos, KF-GINS .nav, GREAT "
        ".ins or .flt, TUM, CSV; of the imu or the antenna; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--reference", type=Path, metavar="FILE",
        help="judge results by this file (the same formats, GINav's .mat), without a recording",
    )  # fmt: skip
    parser.add_argument(
        "--settle", type=float, default=0.0, metavar="S",
        help="judge results of others from so long after their beginning on [0 s]",
    )  # fmt: skip
    parser.add_argument("--week", type=int, help="GPS week of results that hold none")
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
        help="draw the report of every run, too: most of the time",
    )  # fmt: skip
    parser.add_argument(
        "--unchecked", action="store_true", help="compare even if the data contradict physics"
    )
    parser.add_argument("--jobs", type=int, default=-1, help="processes, −1: all processors")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler to spread over")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(arguments: argparse.Namespace) -> None:
    """Compare, write page and result directories, and say what came out."""
    from ...datasets.loading import load
    from ...datasets.placing import written_whole
    from ..compare.comparison import compare
    from ..compare.methods import parse_methods
    from ..compare.others import Judge, read_others, side_by_side
    from ..compare.report import check_replaceable, write_page
    from ..config_files import load_config
    from ..spells.outages import parse_outages
    from .terminal.progress import progress

    _check(arguments)
    outages, methods = parse_outages(arguments.outages), parse_methods(arguments.methods)
    config = load_config(arguments.config, arguments.set)
    out: Path = arguments.out.resolve()
    check_replaceable(out)
    with written_whole(out) as draft:
        with progress() as report:
            if arguments.reference is not None:
                judge = Judge.from_file(arguments.reference, arguments.week)
                others = read_others(arguments.result, arguments.week)
                comparison = side_by_side(others, judge, arguments.settle)
            else:
                week = arguments.week
                if arguments.result and week is None:
                    week = _week(load(arguments.path[0], **config.data))
                others = read_others(arguments.result, week)
                comparison = compare(
                    arguments.path, methods, outages, config, others=others,
                    settle=arguments.settle,
                    seeds=arguments.seeds, out=draft, draw=_report if arguments.reports else None,
                    checked=not arguments.unchecked, cache=out.parent / ".certnav-cache",
                    jobs=arguments.jobs, scheduler=arguments.scheduler, progress=report,
                )  # fmt: skip
        write_page(comparison, draft)
    say(comparison, out, arguments.json)


def _check(arguments: argparse.Namespace) -> None:
    from ...filters.errors import ConfigError

    if arguments.seeds < 1:
        raise ConfigError(f"--seeds: expected at least 1, found {arguments.seeds}")
    if arguments.jobs == 0:
        raise ConfigError("--jobs: expected a number of processes, or −1; found 0")
    if not 0.0 <= arguments.settle < float("inf"):
        raise ConfigError(f"--settle: expected a number ≥ 0, found {arguments.settle}")
    if arguments.week is not None and not 0 < arguments.week < 10000:
        raise ConfigError(f"--week: expected a GPS week, found {arguments.week}")
    if arguments.reference is not None and arguments.path:
        raise ConfigError("--reference: a recording has its own; leave one of them out")
    if arguments.reference is not None and not arguments.result:
        raise ConfigError("--reference: expected at least one --result NAME=FILE to judge by it")
    if arguments.reference is None and not arguments.path:
        raise ConfigError("expected folders of sequences, or --reference FILE and --result")


def _week(sequence: Sequence) -> int | None:
    from ...datasets.gpstime import to_week_sow

    return int(to_week_sow(sequence.span[0])[0]) if sequence.time_scale == "gps" else None


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
