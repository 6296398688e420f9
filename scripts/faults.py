"""Faults in the data of a drive: what is said about each, and how far the solution goes off.

    python scripts/faults.py --seeds 1 --only "15 m"         # a few, on the screen
    python scripts/faults.py --seeds 5 --out docs/trust.md  # rewrites the page's section
    python scripts/faults.py --seeds 5 --keep done.jsonl    # goes on where it was stopped
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

COMMAND = "python scripts/faults.py --seeds {} --out docs/trust.md"
SECTION = "## Faults in the data"
#: What was said about a fault, from loudest to nothing.
VERDICTS = ("refused", "warned", "noted", "harmless", "silent")
#: Nothing said is harmless if the RMS error is that of the sound run up to this [m] and share.
SAME_M, SAME = 0.05, 0.1
#: A fault has done harm if it takes the error beyond 3σ where the sound run stayed inside, or
#: further beyond by this factor.
HARM = 1.2

#: Of the simulated drives [s].
DURATION = 180.0
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
        name=f"drive {seed}", seed=seed, duration=DURATION, density="suburb", nlos_probability=0.0,
        static_start=10.0,
    )  # fmt: skip
    simulation = simulate(config)
    if "raw" in wanted:
        folder = work / f"raw-{seed}"
        write_great(simulation, folder)
        out["raw"] = base("simulated, raw GNSS", folder, load(folder))
    for name, rate in (("fixes", 1.0), ("fast", 5.0)):
        if name not in wanted:
            continue
        time = np.arange(config.start_time + 1.0, config.start_time + config.duration, 1.0 / rate)
        fixes = fixes_from_truth(
            simulation.trajectory, time, config.lever_antenna_b,
            (1.0, 1.0, 2.0), (0.05, 0.05, 0.1), np.random.default_rng(seed),
        )  # fmt: skip
        sequence = dataclasses.replace(simulation.sequence(fixes), observations=None)
        out[name] = base(f"simulated, receiver's fixes, {rate:g} Hz", None, sequence)
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
        return judged(run(lambda: change(on.sequence, on.begin), on.sound), on.sound)
    assert on.folder is not None
    copy = work / "copy"
    shutil.copytree(on.folder, copy)
    try:
        fault.files(copy, on.begin % 604800.0)
        return judged(run(lambda: load(copy), on.sound), on.sound)
    finally:
        shutil.rmtree(copy)


def judged(outcome: Outcome, sound: Outcome) -> Outcome:
    """Return the outcome, harmless instead of silent if it is that of the sound run."""
    same = abs(outcome.rms - sound.rms) <= max(SAME_M, SAME * sound.rms)
    if outcome.verdict == "silent" and same and not harmful(outcome, sound):
        return dataclasses.replace(outcome, verdict="harmless")
    return outcome


def harmful(outcome: Outcome, sound: Outcome) -> bool:
    """Tell whether a fault took the solution beyond its 3σ, or further beyond."""
    return outcome.ratio > max(1.0, HARM * sound.ratio)


Figures = tuple[float, float, float]


@dataclass(frozen=True)
class Row:
    """One fault over all seeds: the quietest verdict, and figures: sound, median, worst."""

    fault: str
    base: str
    verdict: str
    seeds: str
    line: str
    rms: Figures
    largest: Figures
    ratio: Figures
    refused: Figures
    harmful: bool
    undetectable: str = ""

    @property
    def unnoticed(self) -> bool:
        """Whether nothing was said, the solution went wrong, and it could have been seen."""
        return self.verdict == "silent" and self.harmful and not self.undetectable


def summarised(fault: Fault, on: list[Base], outcomes: list[Outcome]) -> Row:
    """Return the row of a fault."""
    quietest = max(outcomes, key=lambda o: VERDICTS.index(o.verdict))
    count = sum(o.verdict == quietest.verdict for o in outcomes)

    def three(name: str) -> Figures:
        sound = float(np.median([getattr(b.sound, name) for b in on]))
        values = np.array([getattr(o, name) for o in outcomes], dtype=float)
        known = values[np.isfinite(values)]
        if not known.size:
            return sound, np.nan, np.nan
        return sound, float(np.median(known)), float(known.max())

    # Harm is judged where nothing was said.
    bad = any(
        o.verdict == "silent" and harmful(o, b.sound) for b, o in zip(on, outcomes, strict=True)
    )
    line = "; ".join(clean(text) for text in quietest.lines[:2])
    return Row(
        fault.name, on[0].name, quietest.verdict, f"{count} of {len(outcomes)}", line,
        three("rms"), three("largest"), three("ratio"), three("refused"), bad, fault.undetectable,
    )  # fmt: skip


def clean(text: str) -> str:
    """Return a line without the copy's folder."""
    return re.sub(r"\s+", " ", re.sub(r"\S*/copy/?", "", text)).strip(": ")


def kept(path: Path | None) -> dict[tuple[str, str, int], Outcome]:
    """Return what an earlier run has written down."""
    out: dict[tuple[str, str, int], Outcome] = {}
    if path is None or not path.exists():
        return out
    for line in path.read_text(encoding="utf-8").splitlines():
        made = json.loads(line)
        made["outcome"]["lines"] = tuple(made["outcome"]["lines"])
        out[made["fault"], made["base"], made["seed"]] = Outcome(**made["outcome"])
    return out


def rows(seeds: int, real: bool, only: str = "", keep: Path | None = None) -> list[Row]:
    """Do every fault to every drive; what `keep` holds is done, and what is done goes there."""
    chosen = [f for f in FAULTS if only in f.name]
    wanted = {f.base for f in chosen}
    done = kept(keep)
    found: dict[tuple[str, str], list[tuple[Base, Outcome]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        for seed in range(seeds):  # seed after seed: what is stopped early has whole drives
            drives = bases(seed, work, wanted, real and seed == 0)
            for fault in chosen:
                if fault.base not in drives:
                    continue
                on, key = drives[fault.base], (fault.name, fault.base, seed)
                if key not in done:
                    done[key] = broken(fault, on, work)
                    written(keep, key, done[key])
                found.setdefault(key[:2], []).append((on, done[key]))
                print(
                    f"{done[key].verdict:>8}  {seed} {fault.base:<5}  {fault.name}", file=sys.stderr
                )
    return [
        summarised(
            fault, *(list(part) for part in zip(*found[fault.name, fault.base], strict=True))
        )
        for fault in chosen
        if (fault.name, fault.base) in found
    ]


def written(path: Path | None, key: tuple[str, str, int], outcome: Outcome) -> None:
    """Write down what became of one fault."""
    if path is not None:
        fault, on, seed = key
        made = {"fault": fault, "base": on, "seed": seed, "outcome": dataclasses.asdict(outcome)}
        with path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(made, ensure_ascii=False) + "\n")


def table(made: list[Row], seeds: int) -> str:
    """Return the page's section."""
    lines = [
        SECTION, "",
        f"Made by `{COMMAND.format(seeds)}` ({seeds} simulated drives of {DURATION:.0f} s; the "
        "real drive from `CERTNAV_DATA`).",
        "Errors are horizontal, against the truth: median of the sound runs → median / worst of "
        "the broken ones; *of 3σ* is the largest error along north or east over three of the "
        "filter's own σ there. What is said, and in how many drives, is that of the quietest. The "
        "check looks at the drive without its reference, as most drives have none. What is "
        "*refused* stops `certnav run`; its figures are those of `--unchecked`, if there are any. "
        "*Harmless* and *silent* mean that neither check nor the run's notes differ from the sound "
        f"drive's; harmless, that the RMS error does not either (by {100 * SAME:.0f} % or "
        f"{100 * SAME_M:.0f} cm).", "",
        "| fault | drive | | in | what is said | RMS [m] | largest [m] | of 3σ | refused updates |",
        "|---|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip

    def text(values: Figures, form: str) -> str:
        sound, median, worst = ("–" if np.isnan(v) else format(v, form) for v in values)
        return f"{sound} → {median} / {worst}" if median != "–" else f"{sound} → –"

    for r in made:
        verdict = f"**{r.verdict}**" if r.unnoticed else r.verdict
        lines.append(
            f"| {r.fault} | {r.base} | {verdict} | {r.seeds} | {said(r)} | {text(r.rms, '.2f')} | "
            f"{text(r.largest, '.1f')} | {text(r.ratio, '.1f')} | {text(r.refused, '.0f')} |"
        )
    counts = {v: sum(r.verdict == v for r in made) for v in VERDICTS}
    bad = sum(r.unnoticed for r in made)
    lines += [
        "",
        f"Of {len(made)} faults {counts['refused']} are refused, {counts['warned']} warned of, "
        f"{counts['noted']} noted in every drive; {counts['harmless']} change nothing, "
        f"{counts['silent']} pass in silence in some drive; of these {bad or 'none'} "
        f"{'moves' if bad < 2 else 'move'} the solution beyond its 3σ and could have been seen.",
    ]
    return "\n".join(lines)


def said(row: Row) -> str:
    """Return what was said, or why nothing could be."""
    if row.verdict == "silent" and row.undetectable:
        return f"nothing: {row.undetectable}"
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
    parser.add_argument("--keep", type=Path, metavar="FILE", help="what is done, to go on later")
    parser.add_argument("--out", type=Path, metavar="FILE", help="rewrite its section there")
    arguments = parser.parse_args()
    made = rows(arguments.seeds, not arguments.no_real, arguments.only, arguments.keep)
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
