"""Break recordings on purpose, let ``certnav check`` look at them, and print what it said.

    python scripts/broken_copies.py                       # prints the table
    python scripts/broken_copies.py --out docs/check.md   # writes the page

Bases are a simulated drive in the GREAT layout and real ones from CERTNAV_DATA. Every copy is
made in a temporary folder. The status is 1 if a sound recording raises an alarm, or a fault is
not named that could be.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from certnav.nav.check.recording import check
from oracles.broken_copies import FAULTS, broken, clean, named
from oracles.recordings import REAL, SIMULATED, base_folder

COMMAND = "python scripts/broken_copies.py --out docs/check.md"


def table(work: Path) -> tuple[list[str], bool]:
    """Return the page's lines, and whether everything went as it should."""
    lines = [
        "# What `certnav check` says to broken recordings", "",
        f"Made by `{COMMAND}` (real recordings from `CERTNAV_DATA`).", "",
        "## Sound recordings", "", "| recording | verdict |", "|---|---|",
    ]  # fmt: skip
    good = True
    for name in (SIMULATED, *REAL):
        base = base_folder(name, work)
        if base is None:
            lines.append(f"| {name} | not at hand |")
            continue
        report = check(base)
        alarms = [clean(f.line, report.path) for f in report.findings if f.severity != "note"]
        good &= not alarms
        lines.append(f"| {name} | {'; '.join([report.verdict, *alarms])} |")
    count = len(FAULTS)
    seen = [f for f in FAULTS if f.expected]
    lines += [
        "", f"## {count} broken copies", "",
        f"{len(seen)} can be seen; {count - len(seen)} cannot, in the recording they were made "
        "of, and the table says why.", "",
        "| # | recording | what was done to it | what `check` says |", "|---|---|---|---|",
    ]  # fmt: skip
    for number, fault in enumerate(FAULTS, 1):
        report = broken(fault, work)
        if report is None:
            said = "recording not at hand"
        elif fault.expected:
            said = named(fault, report)
            if not said:
                good = False
                others = [clean(f.line, report.path) for f in report.findings]
                alarms = [o for o, f in zip(others, report.findings, strict=True)
                          if f.severity != "note"]  # fmt: skip
                said = f"**not named**; {'; '.join(alarms) or report.verdict}"
        else:
            alarms = [clean(f.line, report.path) for f in report.findings if f.severity != "note"]
            good &= not alarms
            said = f"nothing: {fault.undetectable}" + "".join(f"; {a}" for a in alarms)
        lines.append(f"| {number} | {fault.base} | {fault.name} | {said.replace('|', '/')} |")
    return lines, good


def main() -> int:
    """Print or write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the page there")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        lines, good = table(Path(work))
    text = "\n".join(lines) + "\n"
    if arguments.out is None:
        print(text)
    else:
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        arguments.out.write_text(text, encoding="utf-8")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
