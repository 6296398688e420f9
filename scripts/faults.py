"""Faults in the data of a drive: what is said about each, and how far the solution goes off.

    python scripts/faults.py --seeds 3                      # table on the screen
    python scripts/faults.py --seeds 3 --out docs/trust.md  # rewrites the page's section
    python scripts/faults.py --json

Drives are simulated (truth known) and one real one of CERTNAV_DATA. Each fault is done to a copy,
which then goes the way of `certnav run`: reading, check, navigation, evaluation. What stops the
run at reading or check is navigated all the same, as with ``--unchecked``, where that is possible.
The status is 1 if a fault passes without a word and moves the solution beyond its own 3σ.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from certnav.datasets.great.writer import write_great
from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import NavError
from certnav.nav.check.recording import check_sequence
from certnav.nav.config_files import from_tables
from certnav.nav.evaluation.accuracy import Evaluation, evaluate
from certnav.nav.pipeline import navigate
from certnav.nav.solution import Solution
from oracles.faults import FAULTS, Fault, faults_begin
from oracles.recordings import DATA, REAL

COMMAND = "python scripts/faults.py --seeds 3 --out docs/trust.md"
SECTION = "## Faults in the data"
#: What was said about a fault, from loudest to nothing.
VERDICTS = ("refused", "warned", "noted", "silent")
#: A fault has done harm if it takes the error beyond 3σ where the sound run stayed inside, or
#: further beyond by this factor.
HARM = 1.2

#: Faults begin in the second half of a drive: how it starts is not the question, and this is fast.
CONFIG = from_tables({"alignment": {"method": "level+course"}})


@dataclass(frozen=True)
class Outcome:
    """What became of one run.

    Attributes
    ----------
    verdict : str
        One of `VERDICTS`; of a sound run 'silent' is right.
    lines : tuple of str
        What was said.
    rms, largest : float
        Horizontal error against the truth [m]; NaN where there is no solution.
    ratio : float
        Largest horizontal error along north or east over its own 3σ.
    refused : int
        Updates refused by the innovation test.
    duration : float
        Length of the solution [s].
    """

    verdict: str
    lines: tuple[str, ...]
    rms: float
    largest: float
    ratio: float
    refused: int
    duration: float


@dataclass(frozen=True, eq=False)
class Base:
    """A sound drive, where faults begin in it, and what its own run says."""

    name: str
    folder: Path | None
    sequence: Sequence
    begin: float
    sound: Outcome


def bases(seed: int, work: Path, wanted: Iterable[str], real: bool) -> dict[str, Base]:
    """Return the sound drives of one seed by the name faults know them by."""
    out: dict[str, Base] = {}
    config = SimulationConfig(
        name=f"drive {seed}", seed=seed, duration=240.0, density="suburb", nlos_probability=0.0
    )
    simulation = simulate(config)
    if "raw" in wanted:
        folder = work / f"raw-{seed}"
        write_great(simulation, folder)
        out["raw"] = base("simulated, raw GNSS", folder, load(folder))
    if "fixes" in wanted:
        time = np.arange(config.start_time + 1.0, config.start_time + config.duration)
        rng = np.random.default_rng(seed)
        fixes = fixes_from_truth(
            simulation.trajectory, time, config.lever_antenna_b,
            (1.0, 1.0, 2.0), (0.05, 0.05, 0.1), rng,
        )  # fmt: skip
        sequence = dataclasses.replace(simulation.sequence(fixes), observations=None)
        out["fixes"] = base("simulated, receiver's fixes", None, sequence)
    if real and "real" in wanted and (DATA / REAL["Oakville long"]).is_dir():
        out["real"] = base("Oakville long loop", None, load(DATA / REAL["Oakville long"]))
    return out


def base(name: str, folder: Path | None, sequence: Sequence) -> Base:
    """Return a sound drive with its run."""
    return Base(name, folder, sequence, faults_begin(sequence), run(lambda: sequence))


def run(read: Callable[[], Sequence], sound: Outcome | None = None) -> Outcome:
    """Go the way of ``certnav run``, and on where that stops if possible.

    Parameters
    ----------
    read : callable
        Returns the sequence, or refuses.
    sound : Outcome, optional
        What was said about the sound drive is left out.
    """
    said: list[tuple[str, str]] = []
    known = {stripped(line) for line in sound.lines} if sound else set()
    try:
        sequence = read()
        # Without its reference: few drives have one, and the fault has to be seen without.
        findings = check_sequence(dataclasses.replace(sequence, reference=None))
    except NavError as error:
        return Outcome("refused", (str(error),), np.nan, np.nan, np.nan, 0, 0.0)
    for f in findings:
        if f.severity != "note":
            said.append(("refused" if f.severity == "fatal" else "warned", f.line))
    try:
        solution = navigate(sequence, CONFIG)
        evaluation = evaluate(solution, sequence)
    except NavError as error:
        said.append(("refused", str(error)))
        lines = tuple(line for _, line in said)
        return Outcome("refused", lines, np.nan, np.nan, np.nan, 0, 0.0)
    said += [("noted", str(n)) for n in solution.notes if n.text not in sequence.notes]
    said = [(v, line) for v, line in said if stripped(line) not in known]
    said.sort(key=lambda s: (VERDICTS.index(s[0]), not s[1].startswith("doubtful")))
    verdict = min((v for v, _ in said), key=VERDICTS.index, default="silent")
    lines = tuple(line for v, line in said if v == verdict or sound is None)
    return Outcome(verdict, lines, *figures(solution, evaluation))


def stripped(line: str) -> str:
    """Return a line without its numbers, to tell what is said of the sound drive too."""
    return re.sub(r"[-+]?\d+(\.\d+)?(e-?\d+)?", "#", line)


def figures(solution: Solution, evaluation: Evaluation) -> tuple[float, float, float, int, float]:
    """Return RMS and largest horizontal error, the largest in units of 3σ, refusals, duration."""
    error, sigma = evaluation.error_pos_n[:, :2], evaluation.sigma_pos_n[:, :2]
    horizontal = np.hypot(*error.T)
    refused = sum(u.reason.startswith("innovation test") for u in solution.updates)
    time = solution.trajectory.time
    return (
        float(np.sqrt(np.mean(horizontal**2))), float(horizontal.max()),
        float((np.abs(error) / (3.0 * sigma)).max()), refused, float(time[-1] - time[0]),
    )  # fmt: skip


def broken(fault: Fault, on: Base, work: Path) -> Outcome:
    """Do a fault to a drive and return what became of it."""
    if fault.files is None:
        assert fault.data is not None
        change = fault.data
        return run(lambda: change(on.sequence, on.begin), on.sound)
    assert on.folder is not None
    copy = work / "copy"
    shutil.copytree(on.folder, copy)
    try:
        fault.files(copy, on.begin % 604800.0)
        return run(lambda: load(copy), on.sound)
    finally:
        shutil.rmtree(copy)


@dataclass(frozen=True)
class Row:
    """One fault over all seeds: the quietest verdict, and medians."""

    fault: str
    base: str
    verdict: str
    line: str
    rms: tuple[float, float]
    largest: tuple[float, float]
    ratio: tuple[float, float]
    refused: tuple[float, float]
    harmful: bool
    undetectable: str = ""

    @property
    def unnoticed(self) -> bool:
        """Whether nothing was said, the solution went wrong, and it could have been seen."""
        return self.verdict == "silent" and self.harmful and not self.undetectable


def summarised(fault: Fault, on: list[Base], outcomes: list[Outcome]) -> Row:
    """Return the row of a fault: figures are medians over the seeds, sound and broken."""
    quietest = max(outcomes, key=lambda o: VERDICTS.index(o.verdict))

    def pair(name: str) -> tuple[float, float]:
        values = [[getattr(o, name) for o in some] for some in ([b.sound for b in on], outcomes)]
        return tuple(float(np.median(v)) for v in values)  # type: ignore[return-value]

    # Harm is judged where it was said least.
    harmful = any(
        o.ratio > max(1.0, HARM * b.sound.ratio)
        for b, o in zip(on, outcomes, strict=True)
        if o.verdict == quietest.verdict
    )
    line = "; ".join(clean(text) for text in quietest.lines[:2])
    return Row(
        fault.name, on[0].name, quietest.verdict, line, pair("rms"), pair("largest"),
        pair("ratio"), pair("refused"), harmful, fault.undetectable,
    )  # fmt: skip


def clean(text: str) -> str:
    """Return a line without the copy's folder."""
    return re.sub(r"\s+", " ", re.sub(r"\S*/copy/?", "", text)).strip(": ")


def rows(seeds: int, real: bool, only: str = "") -> list[Row]:
    """Do every fault to every drive."""
    chosen = [f for f in FAULTS if only in f.name]
    wanted = {f.base for f in chosen}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        drives = [bases(seed, work, wanted, real and seed == 0) for seed in range(seeds)]
        out = []
        for fault in chosen:
            on = [d[fault.base] for d in drives if fault.base in d]
            if on:
                out.append(summarised(fault, on, [broken(fault, b, work) for b in on]))
                print(f"{out[-1].verdict:>8}  {fault.base:<5}  {fault.name}", file=sys.stderr)
    return out


def table(made: list[Row], seeds: int) -> str:
    """Return the page's section."""
    lines = [
        SECTION, "",
        f"Made by `{COMMAND}` ({seeds} simulated drives of 240 s, figures are medians; the real "
        "drive from `CERTNAV_DATA`).",
        "Errors are horizontal, against the truth, of the sound run → of the broken one; *of 3σ* "
        "is the largest error along north or east over three of the filter's own σ there. The "
        "check looks at the drive without its reference, as most drives have none. What is "
        "*refused* stops `certnav run`; its figures are those of `--unchecked`, if there are any. "
        "*Silent* means that neither check nor the run's notes differ from the sound drive's.", "",
        "| fault | drive | | what is said | RMS [m] | largest [m] | of 3σ | refused updates |",
        "|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip

    def two(values: tuple[float, float], form: str) -> str:
        return " → ".join("–" if np.isnan(v) else format(v, form) for v in values)

    for r in made:
        verdict = f"**{r.verdict}**" if r.unnoticed else r.verdict
        lines.append(
            f"| {r.fault} | {r.base} | {verdict} | {said(r)} | "
            f"{two(r.rms, '.2f')} | {two(r.largest, '.1f')} | {two(r.ratio, '.1f')} | "
            f"{two(r.refused, '.0f')} |"
        )
    counts = {v: sum(r.verdict == v for r in made) for v in VERDICTS}
    bad = sum(r.unnoticed for r in made)
    lines += [
        "",
        f"Of {len(made)} faults {counts['refused']} are refused, {counts['warned']} warned of, "
        f"{counts['noted']} noted, {counts['silent']} pass in silence; of these "
        f"{bad or 'none'} {'moves' if bad < 2 else 'move'} the solution beyond its 3σ and could "
        "have been seen.",
    ]
    return "\n".join(lines)


def said(row: Row) -> str:
    """Return what was said, or why nothing could be."""
    if row.verdict == "silent" and row.harmful and row.undetectable:
        return f"cannot be told: {row.undetectable}"
    return row.line.replace("|", "/") or "–"


def with_section(page: str, section: str) -> str:
    """Return the page with the section of this script replaced, or added at the end."""
    text = section + "\n"
    found = re.search(rf"(?ms)^{re.escape(SECTION)}\n.*?(?=^## |\Z)", page)
    if found is None:
        return f"{page.rstrip()}\n\n{text}" if page.strip() else f"# Trust\n\n{text}"
    after = page[found.end() :]
    return page[: found.start()] + text + (f"\n{after}" if after else "")


def main() -> int:
    """Print or write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=1, metavar="N", help="simulated drives [1]")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--no-real", action="store_true", help="simulated drives only")
    parser.add_argument("--only", default="", metavar="TEXT", help="faults whose name holds this")
    parser.add_argument("--out", type=Path, metavar="FILE", help="rewrite its section there")
    arguments = parser.parse_args()
    made = rows(arguments.seeds, not arguments.no_real, arguments.only)
    if arguments.json:
        print(json.dumps([dataclasses.asdict(r) for r in made], indent=2, ensure_ascii=False))
    elif arguments.out is None:
        print(table(made, arguments.seeds))
    else:
        page = arguments.out.read_text(encoding="utf-8") if arguments.out.exists() else ""
        new = with_section(page, table(made, arguments.seeds))
        arguments.out.write_text(new, encoding="utf-8")
    return 1 if any(r.unnoticed for r in made) else 0


if __name__ == "__main__":
    sys.exit(main())
