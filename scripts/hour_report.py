"""One hour at 100 Hz: what making and opening its report costs, as a table for docs/report.md.

    python scripts/hour_report.py [--drive DIR] [--duration 3600] [--out docs/report.md]

A drive in the GREAT layout is simulated, unless DIR holds one, navigated, and its report made and
opened by Chromium, each by a process of its own: seconds on the clock and of the processor, and
peak memory. With --out the table in a page is replaced.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from playwright.sync_api import sync_playwright

from certnav.nav.results.directory import read_result

RUN = "import sys; from certnav.nav.commands.cli import main; sys.exit(main(sys.argv[1:]))"
REPORT = "import sys; from certnav.nav.report.run import write_report; write_report(sys.argv[1])"
TABLE = re.compile(r"(?<=<!-- hour -->\n).*?(?=<!-- /hour -->)", re.DOTALL)


def measured(code: str, *arguments: str) -> tuple[float, float, float]:
    """Run code by itself; return seconds on the clock, of the processor, peak memory [MB]."""
    began = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-c", code, *arguments])
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{' '.join(arguments)}: exit status {process.returncode}")
    took = time.perf_counter() - began
    return took, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024.0


def of_children() -> float:
    """Return the processor's seconds that all processes below this one have used."""
    used, parent = {}, {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
        except OSError:  # ended meanwhile
            continue
        pid = int(folder.name)
        parent[pid], used[pid] = int(fields[1]), int(fields[11]) + int(fields[12])

    def below(pid: int) -> bool:
        return pid in parent and (parent[pid] == os.getpid() or below(parent[pid]))

    return sum(ticks for pid, ticks in used.items() if below(pid)) / os.sysconf("SC_CLK_TCK")


def opened(page: Path, width: int) -> tuple[float, float, float]:
    """Return seconds until a page is drawn, of the processor, and its script's memory [MB]."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        tab = browser.new_page(viewport={"width": width, "height": 900})
        began, before = time.perf_counter(), of_children()
        tab.goto(page.resolve().as_uri())
        tab.wait_for_selector("body[data-ready=yes]", timeout=120_000)
        took, used = time.perf_counter() - began, of_children() - before
        heap = tab.evaluate("() => performance.memory.usedJSHeapSize")
        browser.close()
    return took, used, heap / 1e6


def extremes(page: Path, result: Path) -> list[tuple[str, float, float]]:
    """Return name, largest value in the tables and largest drawn, of what errors are drawn."""
    errors = np.abs(read_result(result).evaluation.error_pos_n)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox", "--disable-gpu"]
        )
        tab = browser.new_page()
        tab.goto(page.resolve().as_uri())
        tab.wait_for_selector("body[data-ready=yes]", timeout=120_000)
        drawn = tab.evaluate(
            "() => ['North', 'East', 'Down'].map(name => Math.max(..."
            "[...Bokeh.documents[0]._all_models.values()].find(m => m.type === 'Plot'"
            " && m.tags.includes('error') && m.title.text.startsWith(name)).renderers"
            ".filter(r => r.data_source?.data?.y)"
            ".flatMap(r => Array.from(r.data_source.data.y).filter(Number.isFinite)"
            ".map(Math.abs))))"
        )
        browser.close()
    most = errors.max(axis=0)
    return [(n, *pair) for n, *pair in zip(("north", "east", "down"), most, drawn, strict=True)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drive", type=Path)
    parser.add_argument("--duration", type=float, default=3600.0, help="[s]")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as work:
        drive, result = arguments.drive, Path(work) / "result"
        if drive is None:
            drive = Path(work) / "drive"
            measured(
                RUN, "simulate", "--out", str(drive), "--duration", str(arguments.duration), "-q"
            )
        run = measured(RUN, "run", str(drive), "--out", str(result), "--no-report", "-q")
        report = measured(REPORT, str(result))
        page = result / "report.html"
        rows = [("`certnav run --no-report`", *run), ("`write_report`", *report)]
        lines = [
            "| step | on the clock [s] | of the processor [s] | peak memory [MB] |",
            "|---|---|---|---|",
            *(
                f"| {name} | {wall:.1f} | {cpu:.1f} | {peak:.0f} |"
                for name, wall, cpu, peak in rows
            ),
        ]
        for width in (1400, 390):
            took, used, heap = opened(page, width)
            name = f"opened by Chromium, {width} px"
            lines.append(f"| {name} | {took:.1f} | {used:.1f} | {heap:.0f} (script) |")
        most = ", ".join(f"{name} {true:.3f} ({drawn:.3f})" for name, true, drawn
                         in extremes(page, result))  # fmt: skip
        size = page.stat().st_size / 1e6
        lines += ["", f"`report.html`: {size:.2f} MB. Largest error in the tables, and drawn [m]: "
                      f"{most}."]  # fmt: skip
    text = "\n".join(lines)
    print(text)
    if arguments.out is not None:
        old = arguments.out.read_text(encoding="utf-8")
        arguments.out.write_text(TABLE.sub(f"{text}\n", old), encoding="utf-8")


if __name__ == "__main__":
    main()
