"""`certnav check`: the page or the JSON, and the exit status."""

from __future__ import annotations

import argparse
import json

from ...filters.errors import ConfigError
from ..check.recording import check
from ..config import load_config


def check_recording(arguments: argparse.Namespace) -> int:
    """Check a recording; return 1 if it cannot be navigated."""
    config = load_config(None, arguments.set)
    if any(not text.startswith("data.") for text in arguments.set):
        raise ConfigError("--set: expected data.KEY=VALUE, an option of the reader")
    report = check(arguments.path, config.data)
    if arguments.json:
        print(json.dumps(report.as_dict(), indent=2, ensure_ascii=False, allow_nan=False))
    else:
        print(report.text())
    return 0 if report.navigable else 1
