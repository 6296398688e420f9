"""What `fuzz` found, as the section of a page and as text for the screen."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fuzz_seeds import UNIT_FORMATS

COMMAND = "python scripts/fuzz.py --count 100000 --json --out docs/trust.md"
_PAGE = """\
## Fuzzing

    {command}

Sound inputs of every reader, {size}, are broken at random — bytes flipped, cut out,
inserted or zeroed; files truncated, empty, missing or a folder; lines deleted, doubled, exchanged
or a hundred thousand characters long; columns exchanged, dropped, overwritten or scaled; numbers
replaced by NaN, infinity, 1e308, nothing or words; other separators, line ends and encodings;
TOML values of other types; arrays of other shapes and types; messages broken under a checksum
that is right — and read in a process of their own. A case ends well if it is *read*, or
*refused* by an error of one line that names the file. Anything else counts: a *traceback*, a
*hang* (5 s of processor time) or a *crash* of the process, which RTKLIB, a C library, could be the
cause of. Seed {seed}, {seconds:.0f} s on two cores that were busy with other things too.

{table}

What is read although it was broken is mostly what has no check sum and no redundancy: another
digit of a coordinate, a row less, a comment.

RINEX reaches RTKLIB only after a test of every line (`datasets.text.rinex`), under a name it takes
as it is (`datasets.rtklib.file_names`): of {rinex} broken RINEX files none has ended the process,
so that RTKLIB is called in it and not in a child.

**Wrong units.** Gyro or accelerometer of a simulated drive scaled by what confuses degrees and
radians, seconds and hours, m/s², g, mg and Gal, metres and feet, and by −1, in {formats}: of
{units_tried} recordings {units_silent} passed in silence; the others the reader refused or
`certnav check` named.
"""


def write_section(page: Path, found: dict[str, Any], seed: int) -> None:
    """Write the section "Fuzzing" of a page, whose other sections stay."""
    before = page.read_text(encoding="utf-8") if page.is_file() else "# Trust\n"
    before, heading, behind = before.partition("## Fuzzing\n")
    later = behind.find("\n## ")
    behind = behind[later:] if heading and later >= 0 else ""
    rinex = sum(
        sum(c.values()) for name, c in found["readers"].items()
        if any(word in name for word in ("RINEX", "Hatanaka"))
    )  # fmt: skip
    section = _PAGE.format(
        command=COMMAND, size="12 s of a simulated drive and excerpts of real RINEX", seed=seed,
        table=_table(found), rinex=rinex, formats=", ".join(UNIT_FORMATS),
        **{key: found.get(key, 0) for key in ("seconds", "units_tried", "units_silent")},
    )  # fmt: skip
    page.write_text(before.rstrip() + "\n\n" + section + behind, encoding="utf-8")


def _table(found: dict[str, Any]) -> str:
    lines = [
        "| reader | tried | read | refused | tracebacks | hangs | crashes |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for name, c in found["readers"].items():
        tried = sum(c.values())
        lines.append(
            f"| {name} | {tried} | {c['ok']} | {c['refused']} | {c['traceback']} | {c['hang']} "
            f"| {c['crash']} |"
        )
    lines.append(
        f"| **all** | **{found['tried']}** | {found['read']} | {found['refused']} "
        f"| {found['tracebacks']} | {found['hangs']} | {found['crashes']} |"
    )
    return "\n".join(lines)


def text(found: dict[str, Any]) -> str:
    """Return the table, and examples of what went wrong."""
    lines = [_table(found)]
    if "units_tried" in found:
        lines += ["", f"scaled units: {found['units_tried']} tried, {found['units_silent']} silent"]
    lines += [f"{e['outcome']} ×{e['count']} {e['case']}: {e['said']} ({e['how']})"
              for e in found["examples"]]  # fmt: skip
    return "\n".join(lines)
