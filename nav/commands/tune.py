"""`certnav tune`: which settings a run should have, and what they are worth."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..tune.settings import Settings
    from ..tune.tuning import Tuning

HELP = "find the settings a run should have, cross-validated"
DESCRIPTION = (
    "Find the settings a run should have: what Doppler below four satellites does, thresholds and "
    "weights, judged by whole runs of the filter and cross-validated; the answer may be to keep "
    "the default. With --objective velocity: the paper's thresholds for pairs of satellites."
)
EXAMPLE = "certnav tune drive --out tuned"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav tune`` to its parser."""
    parser.add_argument("path", type=Path, nargs="+", help="folders of sequences with a reference")
    parser.add_argument(
        "--objective", default="run", metavar="WHAT",
        help="run: error of the filter; velocity: error of pairs, the paper's figure [run]",
    )  # fmt: skip
    parser.add_argument(
        "--snr", metavar="LIST", help="C/N0 thresholds, A,B,… or FROM:TO:STEP "
        "[run: 35,45; velocity: 30:50:1]",
    )  # fmt: skip
    parser.add_argument(
        "--k", metavar="LIST", help="|SDV·RMD| thresholds [run: 0.1,0.4; velocity: 0.05:1:0.05]"
    )
    parser.add_argument(
        "--outages", default="30/60:2-3", metavar="SPEC",
        help="run: how GNSS is made weak, as for certnav compare [30/60:2-3]",
    )  # fmt: skip
    parser.add_argument(
        "--min-kept", type=float, default=0.4, metavar="SHARE",
        help="velocity: least share of pairs to retain [0.4]",
    )  # fmt: skip
    parser.add_argument(
        "--cn0-of", default="mean", metavar="WHICH",
        help="velocity: mean, or min as the filter has it [mean]",
    )  # fmt: skip
    parser.add_argument(
        "--k-of", default="sdv", metavar="WHICH",
        help="velocity: sdv as it is, as the filter has it, or cosine [sdv]",
    )  # fmt: skip
    parser.add_argument(
        "--direction", default="motion", metavar="FROM",
        help="velocity: direction of motion from the reference's velocity (motion) or attitude "
        "[motion]",
    )  # fmt: skip
    parser.add_argument("--systems", default="G", help="velocity: constellation letters [G]")
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="SECTION.KEY=VALUE",
        help="override one configuration value; repeatable",
    )  # fmt: skip
    parser.add_argument(
        "--out", type=Path, default=Path("results/tuning"), metavar="DIR",
        help="where thresholds.toml and the report go [results/tuning]",
    )  # fmt: skip
    parser.add_argument("--jobs", type=int, default=-1, help="processes, −1: all processors")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler to spread over")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(arguments: argparse.Namespace) -> None:
    """Tune, write the result directory, and say what was found."""
    from ...filters.errors import ConfigError
    from ..tune.report import check_replaceable

    if arguments.objective not in ("run", "velocity"):
        raise ConfigError(f"objective: expected run or velocity, found '{arguments.objective}'")
    if arguments.jobs == 0:
        raise ConfigError("--jobs: expected a number of processes, or −1; found 0")
    check_replaceable(arguments.out.resolve())
    if arguments.objective == "run":
        _settings(arguments)
    else:
        _pairs(arguments)


def _settings(arguments: argparse.Namespace) -> None:
    from ...filters.errors import ConfigError
    from ..config_files import load_config
    from ..results.summary import strict
    from ..spells.outages import parse_outages
    from ..tune.candidates import SNR, K
    from ..tune.settings import tune_settings
    from ..tune.settings_report import as_dict, write_settings
    from .terminal.progress import progress

    outages = parse_outages(arguments.outages)
    if not outages.keeps_some:
        raise ConfigError(f"--outages {arguments.outages}: leaves no satellite, nothing to tune")
    snr = parse_range("--snr", arguments.snr) if arguments.snr else SNR
    k = parse_range("--k", arguments.k) if arguments.k else K
    with progress() as report:
        found = tune_settings(
            arguments.path, config=load_config(arguments.config, arguments.set), snr=snr, k=k,
            outages=outages, jobs=arguments.jobs, scheduler=arguments.scheduler, progress=report,
        )  # fmt: skip
    out = write_settings(found, arguments.out)
    if arguments.json:
        print(json.dumps(strict(as_dict(found)), allow_nan=False))
        return
    for line in table(found):
        print(line)
    print(f"settings: {found.candidates[found.chosen].name}")
    print(f"  {found.decided}")
    _say_notes(found, out)


def table(found: Settings) -> list[str]:
    """Return the candidates as lines of text."""
    from ..tune.settings import interval

    def number(value: float) -> str:
        return f"{value:9.3f}" if value < 1e6 else f"{'–':>9}"

    lines = [f"{'settings':46}{'recorded':>9}{'weak [m]':>9}  both together"]
    for k, candidate in enumerate(found.candidates):
        rms = "".join(number(found.rms(k, part)) for part in ("as recorded", "weak GNSS"))
        said = found.reasons[k] or (interval(found.changes[k]) if k else "")
        lines.append(f"{candidate.name:46}{rms}  {said}")
    return lines


def _pairs(arguments: argparse.Namespace) -> None:
    from ...velocity.screening import Screening
    from ..config_files import load_config
    from ..results.summary import strict
    from ..tune.report import as_dict, write_tuning
    from ..tune.tuning import tune

    tuning = tune(
        arguments.path,
        snr=parse_range("--snr", arguments.snr or "30:50:1"),
        k=parse_range("--k", arguments.k or "0.05:1:0.05"),
        screening=Screening(cn0_of=arguments.cn0_of, k_of=arguments.k_of),
        min_kept=arguments.min_kept,
        direction=arguments.direction,
        systems=arguments.systems,
        config=load_config(arguments.config, arguments.set),
        jobs=arguments.jobs,
        scheduler=arguments.scheduler,
    )
    out = write_tuning(tuning, arguments.out)
    if arguments.json:
        print(json.dumps(strict(as_dict(tuning)), allow_nan=False))
        return
    t = tuning.thresholds
    best = tuning.at(t.min_cn0_dbhz, t.min_k)
    assert best is not None
    print(f"thresholds: C/N0 ({t.cn0_of}) > {t.min_cn0_dbhz:g} dB-Hz, k ({t.k_of}) > {t.min_k:g}")
    print(f"  {tuning.decided}")
    print(
        f"  cross-validated over {tuning.folds_by}: RMS {tuning.cv_rms:.3g} m/s, "
        f"{tuning.cv_retention:.0%} retained"
    )
    print(f"  on all data: RMS {best[0]:.3g} m/s, {best[1]:.0%} retained")
    _say_notes(tuning, out)


def _say_notes(found: Settings | Tuning, out: Path) -> None:
    for note in found.notes:
        print(f"  {note}")
    print(f"  report      {out / 'tuning.html'}")
    print(f"  use it      certnav run PATH --config {out / 'thresholds.toml'}")


def parse_range(option: str, text: str) -> list[float]:
    """Return the thresholds of FROM:TO:STEP, both ends included, of A,B,… or of one number.

    Raises
    ------
    ConfigError
        If it is neither.
    """
    from ...filters.errors import ConfigError

    listed = "," in text
    try:
        numbers = [float(part) for part in text.split("," if listed else ":")]
    except ValueError:
        numbers = []
    if len(numbers) == 1 or (listed and numbers):
        return numbers
    if len(numbers) != 3 or not (numbers[2] > 0.0 and numbers[1] >= numbers[0]):
        raise ConfigError(f"{option} {text}: expected FROM:TO:STEP or A,B,…, for example 30:50:1")
    first, last, step = numbers
    count = int((last - first) / step + 1e-9) + 1
    if count > 1000:
        raise ConfigError(f"{option} {text}: {count} thresholds — choose a larger step")
    return [round(first + i * step, 10) for i in range(count)]
