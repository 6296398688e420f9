"""Feed broken files to every reader and count what is neither read nor refused in one line.

    python scripts/fuzz.py --count 100000 --json

Sound inputs are made from a simulated drive, broken at random (`oracles.mutations`) and read in two
worker processes that may hang or die without harm. With CERTNAV_DATA set, excerpts of real RINEX
are broken too. A case is refused when a `NavError` of one line comes out; anything else that is
no result is counted:

- traceback: another exception, or a message of several lines;
- hang: no answer within 5 s of processor time, or a minute;
- crash: the process died.

Scaled inertial data have to be refused by the reader, or named by ``certnav check``; ``--no-units``
leaves them out. The status is 1 if anything was found. A case is made again by its seed and number:
``--only``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from random import Random
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from fuzz_worker import BLOCK, Worker

from oracles.cases import link, make_case, read_case
from oracles.readers import READ
from oracles.seeds import SHARED, UNIT_FORMATS, Target, data_folder, make_seeds
from oracles.units import silent_units

OUTCOMES = ("ok", "refused", "traceback", "hang", "crash")
_BAD = ("traceback", "hang", "crash")
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
so that RTKLIB is called in it and not in a child. Its decoders of raw logs have been ended by a
damaged message under a right checksum: they run in a process of their own.

**Wrong units.** Gyro or accelerometer of a simulated drive scaled by what confuses degrees and
radians, seconds and hours, m/s², g, mg and Gal, metres and feet, and by −1, in {formats}: of
{units_tried} recordings {units_silent} passed in silence; the others the reader refused or
`certnav check` named.
"""


def fuzz(
    targets: list[Target], seeds: Path, count: int, seed: int, seconds: float, workers: int
) -> dict[str, Any]:
    """Return counts per reader, and examples of what is wrong."""
    shares = {t.name: t.weight / sum(t.weight for t in targets) for t in targets}
    rest = {name: max(1, round(count * share)) for name, share in shares.items()}
    at = dict.fromkeys(rest, 0)
    reader = {t.name: t.reader for t in targets}
    counts: dict[str, Counter[str]] = {t.reader: Counter() for t in targets}
    examples: dict[str, dict[str, Any]] = {}
    slow: list[tuple[float, str]] = []
    lock, end = threading.Lock(), time.monotonic() + seconds
    unsound: list[RuntimeError] = []

    def next_block() -> tuple[str, int, int] | None:
        with lock:
            # the target that is behind most: whenever time runs out, all have had their share
            name = max(rest, key=lambda n: rest[n] / (rest[n] + at[n]))
            if rest[name] == 0 or unsound or time.monotonic() > end:
                return None
            size = min(rest[name], BLOCK)
            size = max(1, min(size, int(0.1 * (rest[name] + at[name])) + 1))
            first = at[name]
            at[name] += size
            rest[name] -= size
            return name, first, size

    def serve(k: int) -> None:
        worker = Worker(seeds, seeds.parent / f"scratch-{k}", seed)
        try:
            while (block := next_block()) is not None:
                name, first, size = block
                for found in worker.run(name, first, size):
                    with lock:
                        counts[reader[name]][found["outcome"]] += 1
                        slow.append((found.get("seconds", 0.0), f"{name}/{found['end']}"))
                        slow.sort(reverse=True)
                        del slow[5:]
                        if found["outcome"] in _BAD:
                            where = found["said"].rpartition(" at ")[2]
                            key = (
                                f"{name}: {where}"
                                if " at " in found["said"]
                                else (f"{name}: {found['outcome']}")
                            )
                            example = examples.setdefault(
                                key,
                                {"outcome": found["outcome"], "case": f"{name}/{found['end']}",
                                 "said": found["said"], "how": found.get("how", ""), "count": 0},
                            )  # fmt: skip
                            example["count"] += 1
                            if example["count"] == 1:  # a long run is watched
                                print(json.dumps(example, ensure_ascii=False), file=sys.stderr)
        except RuntimeError as error:
            unsound.append(error)
        finally:
            worker.close()

    threads = [threading.Thread(target=serve, args=(k,)) for k in range(workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if unsound:
        raise SystemExit(str(unsound[0]))
    total = sum(counts.values(), Counter())
    return {
        "tried": sum(total.values()),
        "tracebacks": total["traceback"],
        "hangs": total["hang"],
        "crashes": total["crash"],
        "read": total["ok"],
        "refused": total["refused"],
        "readers": {
            name: {o: c[o] for o in OUTCOMES} for name, c in counts.items() if sum(c.values())
        },
        "slowest": [f"{case} {s:.2f} s" for s, case in slow],
        "examples": list(examples.values())[:40],
    }


# --- what is said of it ----------------------------------------------------------------------


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


# --- command line ----------------------------------------------------------------------------


def main() -> int:
    """Run the cases and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=1000, metavar="N", help="cases [1000]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=1e9, metavar="S", help="stop after")
    parser.add_argument("--workers", type=int, default=2, choices=(1, 2))
    parser.add_argument("--target", action="append", help="only these seeds; repeatable")
    parser.add_argument("--only", metavar="TARGET/NUMBER", help="make one case again, and keep it")
    parser.add_argument("--no-units", action="store_true", help="leave the scaled drives out")
    parser.add_argument("--out", type=Path, metavar="FILE", help="put the section into this page")
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    memory = Path("/dev/shm")
    place = memory if memory.is_dir() and os.access(memory, os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="certnav-fuzz-", dir=place) as home:
        seeds = Path(home) / "seeds"
        seeds.mkdir()
        targets = make_seeds(seeds, data_folder())
        (seeds / "targets.json").write_text(json.dumps([vars(t) for t in targets]))
        if arguments.only:
            return _again(targets, seeds, arguments.only, arguments.seed)
        if arguments.target:
            targets = [t for t in targets if t.name in arguments.target]
        began = time.monotonic()
        found = fuzz(
            targets, seeds, arguments.count, arguments.seed, arguments.seconds, arguments.workers
        )
        if not arguments.no_units:
            found |= silent_units(Path(home) / "units")
        found["seconds"] = round(time.monotonic() - began, 1)
    if arguments.out:
        write_section(arguments.out, found, arguments.seed)
    print(json.dumps(found, indent=1, ensure_ascii=False) if arguments.json else text(found))
    wrong = ("tracebacks", "hangs", "crashes", "units_silent")
    return int(any(found.get(key) for key in wrong) or bool(found.get("alarms")))


def _again(targets: list[Target], seeds: Path, only: str, seed: int) -> int:
    name, _, number = only.partition("/")
    target = next(t for t in targets if t.name == name)
    folder = Path(tempfile.mkdtemp(prefix=f"{name}-{number}-"))
    link(seeds / SHARED.get(name, name), folder)
    print(make_case(target, seeds, folder, seed, int(number))[0])
    for pointer in [f for f in folder.rglob("*") if f.is_symlink()]:
        content = pointer.read_bytes()
        pointer.unlink()
        pointer.write_bytes(content)
    print(folder)
    outcome, said = read_case(name, folder, Random(f"{seed}/set/{number}"))
    print(outcome, said)
    if outcome == "traceback":
        READ[name](folder)
    return int(outcome in _BAD)


if __name__ == "__main__":
    sys.exit(main())
