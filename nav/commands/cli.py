"""Command line: the parser, and nothing heavy; a command is imported when it is called."""

from __future__ import annotations

import argparse
import atexit
import gc
import importlib
import os
import sys
from pathlib import Path

from ...filters.errors import NavError
from .compare import DESCRIPTION as COMPARE_DESCRIPTION
from .compare import REPORT_DESCRIPTION, add_report_arguments
from .compare import add_arguments as add_compare_arguments
from .tune import DESCRIPTION as TUNE_DESCRIPTION
from .tune import add_arguments as add_tuning_arguments


def main(argv: list[str] | None = None) -> int:
    """Run the command line; return the exit status.

    Whatever certnav refuses knowingly is one line on standard error and status 1.
    """
    # A run makes many objects that stay and few cycles: looking for those takes a tenth of it.
    gc.set_threshold(100_000)
    atexit.register(gc.freeze)  # and again at the end, where all of it goes anyway
    # All matrices are small or narrow: further threads of the linear algebra would only spin.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = _parser().parse_args(argv)
    try:
        module, function = arguments.command.split(":")
        status = getattr(importlib.import_module(module), function)(arguments)
    except NavError as error:
        print(f"certnav: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:  # the reader of our output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        print(f"certnav: {name}{error.strerror or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("certnav: interrupted; nothing was written", file=sys.stderr)
        return 130
    return int(status or 0)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="certnav",
        description="Loosely coupled GNSS/INS navigation of road vehicles.",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = commands.add_parser(
        "run",
        help="navigate a sequence and write a result directory with a report",
        description="Navigate a sequence: GNSS positions and Doppler velocities with the IMU in "
        "an error-state filter, judged against the reference if there is one.",
    )
    run.add_argument("path", type=Path, help="folder of the sequence")
    run.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML)")
    run.add_argument(
        "--set", action="append", default=[], metavar="SECTION.KEY=VALUE",
        help="override one configuration value, e.g. data.lever=figure; repeatable",
    )  # fmt: skip
    run.add_argument("--out", type=Path, metavar="DIR", help="result directory [results/NAME]")
    run.add_argument(
        "--start", type=float, metavar="T", help="GPS seconds of week (or GPS seconds)"
    )
    run.add_argument("--end", type=float, metavar="T", help="likewise")
    run.add_argument("--format", default="", metavar="LIST", help="also write pos,kml,tum,nav")
    run.add_argument(
        "--only", metavar="LIST",
        help="write these formats instead of solution.csv, and no report: the fastest way through",
    )  # fmt: skip
    run.add_argument(
        "--base", type=Path, metavar="FILE",
        help="RINEX of a base station, or a folder of them: RTK positions (gnss.position = rtk)",
    )  # fmt: skip
    run.add_argument(
        "--great", metavar="NAME",
        help="the folder is this GREAT sequence (campus-01 …): take what the catalogue knows of it",
    )  # fmt: skip
    run.set_defaults(command="certnav.nav.commands.run:run")

    run.add_argument("--no-report", action="store_true", help="leave report.html out: faster")
    run.add_argument("--smooth", action="store_true", help="smooth: every epoch knows all data")
    run.add_argument(
        "--unchecked", action="store_true", help="navigate even if the data contradict physics"
    )

    check = commands.add_parser(
        "check",
        help="test a recording against physics before anything is made of it",
        description="Load a recording and test it: gravity, turn rates against the course, time "
        "scales, Doppler, reference. One page; status 1 if it cannot be navigated.",
    )
    check.add_argument("path", type=Path, help="folder of the recording")
    check.add_argument(
        "--set", action="append", default=[], metavar="data.KEY=VALUE", help="reader option"
    )
    check.add_argument("--json", action="store_true", help="print JSON instead of the page")
    check.set_defaults(command="certnav.nav.commands.check:check_recording")

    declare = commands.add_parser(
        "declare",
        help="draft sequence.toml for your own files",
        description="Look at the columns of your files and draft the declaration they need; what "
        'only you can know is left as "?" with a comment.',
    )
    declare.add_argument("files", type=Path, nargs="+", metavar="FILE")
    declare.add_argument(
        "--out", type=Path, metavar="FILE", help="write it there, not to the screen"
    )
    declare.set_defaults(command="certnav.nav.commands.data:declare")

    datasets = commands.add_parser(
        "datasets",
        help="list the GREAT sequences, or arrange downloaded archives",
        description="Without arguments: what is known of the GREAT sequences, and where they are. "
        "import: put downloaded archives into the layout `certnav run` reads.",
    )
    actions = datasets.add_subparsers(metavar="ACTION")
    datasets.set_defaults(command="certnav.nav.commands.data:catalogue")
    arrange = actions.add_parser("import", help="arrange downloaded archives")
    arrange.add_argument("archives", type=Path, nargs="+", metavar="ZIP")
    arrange.add_argument("--to", type=Path, required=True, metavar="DIR")
    arrange.set_defaults(command="certnav.nav.commands.data:arrange")

    align = commands.add_parser(
        "align",
        help="find the attitude from Doppler and local velocity, window by window",
        description="Certifiable alignment over sliding windows: heading of the vehicle from raw "
        "Doppler and its own odometer, against the reference if there is one.",
    )
    align.add_argument("path", type=Path, help="folder of the recording")
    align.add_argument("--window", type=float, default=15.0, metavar="S", help="length [15 s]")
    align.add_argument("--step", type=float, default=5.0, metavar="S", help="distance [5 s]")
    align.add_argument(
        "--method", default="certified",
        help="certified, robust, sdp, voba or gauss-newton [certified]",
    )  # fmt: skip
    align.add_argument(
        "--clock", default="random-walk",
        help="drift: constant, linear, per-epoch or random-walk [random-walk]",
    )  # fmt: skip
    align.add_argument("--satellites", type=float, metavar="N", help="keep N per epoch, drawn")
    align.add_argument("--rows", default="all", help="all, or los where the data are labelled")
    align.add_argument("--decimate", type=int, default=1, metavar="K", help="every K-th epoch")
    align.add_argument(
        "--noise", default="assumed",
        help="Doppler σ: assumed, or fitted to the recording with its correlation [assumed]",
    )  # fmt: skip
    align.add_argument(
        "--clock-walk", type=float, default=0.1, metavar="Q", help="of --clock random-walk, m/s/√s"
    )
    align.add_argument("--min-cn0", type=float, default=0.0, metavar="DB", help="[dB-Hz]")
    align.add_argument(
        "--level", type=float, metavar="DEG", help="the vehicle is level within so much, 1σ"
    )
    align.add_argument(
        "--proof", type=Path, metavar="FILE", help="write proofs in exact numbers (certnav verify)"
    )
    align.add_argument("--json", action="store_true", help="print JSON instead of the table")
    align.add_argument("--plot", type=Path, metavar="FILE", help="draw headings and errors (PNG)")
    align.set_defaults(command="certnav.nav.commands.align:align")

    verify = commands.add_parser(
        "verify",
        help="check the proofs of certnav align --proof in exact arithmetic",
        description="Check alignment proofs in integers and fractions, without the solver: for "
        "the cost matrix in the file, no rotation costs less than the bound.",
    )
    verify.add_argument("path", type=Path, metavar="FILE")
    verify.set_defaults(command="certnav.nav.commands.verify:verify")

    tune = commands.add_parser(
        "tune", help="find screening thresholds, cross-validated", description=TUNE_DESCRIPTION
    )
    add_tuning_arguments(tune)
    tune.set_defaults(command="certnav.nav.commands.tune:run")

    compare = commands.add_parser(
        "compare", help="set methods against each other in spells of weak GNSS",
        description=COMPARE_DESCRIPTION,
    )  # fmt: skip
    add_compare_arguments(compare)
    compare.set_defaults(command="certnav.nav.commands.compare:run")

    report = commands.add_parser(
        "report", help="merge result directories into one page", description=REPORT_DESCRIPTION
    )
    add_report_arguments(report)
    report.set_defaults(command="certnav.nav.commands.compare:report")

    simulate = commands.add_parser(
        "simulate",
        help="simulate a city drive and write it in the GREAT layout",
        description="Simulate a car in a city: RINEX observations and navigation, IMU text and "
        "reference in the layout of the GREAT dataset, readable by `certnav run`.",
    )
    simulate.add_argument("--out", type=Path, required=True, metavar="DIR")
    simulate.add_argument("--seed", type=int, default=0)
    simulate.add_argument("--duration", type=float, default=600.0, metavar="S", help="[s]")
    simulate.add_argument(
        "--density", default="urban", help="open, suburb, urban or canyon [urban]"
    )
    simulate.add_argument("--imu", default="adis16470", help="IMU preset [adis16470]")
    simulate.add_argument("--moving-start", action="store_true", help="begin at cruising speed")
    simulate.add_argument("--exact", action="store_true", help="no noise, no reflections")
    simulate.add_argument(
        "--base-distance", type=float, metavar="M", help="also a base station, so far away [m]"
    )
    simulate.add_argument("--overwrite", action="store_true")
    simulate.set_defaults(command="certnav.nav.commands.simulate:simulate")

    demo = commands.add_parser(
        "demo",
        help="simulate a drive, navigate it, and say where the report is",
        description="Simulate a city drive in the GREAT layout, navigate it, write the report.",
    )
    demo.add_argument("--out", type=Path, default=Path("results/demo"), metavar="DIR")
    demo.set_defaults(command="certnav.nav.commands.run:demo")
    return parser


if __name__ == "__main__":
    sys.exit(main())
