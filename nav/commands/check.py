"""`certnav check`: the page or the JSON, and the exit status."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

HELP = "test a recording against physics before anything is made of it"
DESCRIPTION = (
    "Load a recording and test it: gravity, turn rates against the course, time "
    "scales, Doppler, reference. One page; status 1 if it cannot be navigated."
)
EXAMPLE = "certnav check drive"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav check`` to its parser."""
    parser.add_argument("path", type=Path, help="folder of the recording")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="SECTION.KEY=VALUE",
        help="reader option (data.KEY), or vehicle.kind; repeatable",
    )
    parser.add_argument("--html", type=Path, metavar="FILE", help="also write it as a page")
    parser.add_argument("--json", action="store_true", help="print JSON instead of the page")


def run(arguments: argparse.Namespace) -> int:
    """Check a recording; return 1 if it cannot be navigated."""
    from ...filters.errors import ConfigError
    from ..check.recording import read_and_checked
    from ..config_files import load_config

    config = load_config(None, arguments.set)
    if any(not text.startswith(("data.", "vehicle.kind=")) for text in arguments.set):
        raise ConfigError(
            "--set: expected data.KEY=VALUE, an option of the reader, or vehicle.kind"
        )
    report, sequence = read_and_checked(arguments.path, config.data, config.vehicle.kind)
    if arguments.html is not None:
        from ...datasets.placing import write_file
        from ..check.page import build_page  # slow to import

        write_file(arguments.html, build_page(report, sequence).encode())
    if arguments.json:
        print(json.dumps(report.as_dict(), indent=2, ensure_ascii=False, allow_nan=False))
    else:
        print(report.text())
    return 0 if report.navigable else 1
