"""`certnav tune`: screening thresholds from recordings, and what they are worth."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

HELP = "find screening thresholds, cross-validated"
DESCRIPTION = (
    "Find thresholds of C/N0 and |SDV·RMD| for Doppler velocity below four satellites, "
    "cross-validated, with the trade-off drawn."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav tune`` to its parser."""
    parser.add_argument("path", type=Path, nargs="+", help="folders of sequences with a reference")
    parser.add_argument(
        "--snr", default="30:50:1", metavar="FROM:TO:STEP", help="C/N0 thresholds [30:50:1]"
    )
    parser.add_argument(
        "--k", default="0.05:1:0.05", metavar="FROM:TO:STEP",
        help="|SDV·RMD| thresholds [0.05:1:0.05]",
    )  # fmt: skip
    parser.add_argument(
        "--objective", default="velocity", metavar="WHAT",
        help="velocity: error of pairs; position: drift of the filter over weak-GNSS spells",
    )  # fmt: skip
    parser.add_argument(
        "--min-kept", type=float, default=0.4, metavar="SHARE",
        help="least share of pairs to retain [0.4]",
    )  # fmt: skip
    parser.add_argument("--cn0-of", default="mean", metavar="WHICH", help="mean or min [mean]")
    parser.add_argument(
        "--k-of", default="sdv", metavar="WHICH", help="sdv (as it is) or cosine [sdv]"
    )
    parser.add_argument(
        "--direction", default="motion", metavar="FROM",
        help="direction of motion from the reference's velocity (motion) or attitude [motion]",
    )  # fmt: skip
    parser.add_argument("--systems", default="G", help="constellation letters [G]")
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (TOML)")
    parser.add_argument(
        "--out", type=Path, default=Path("results/tuning"), metavar="DIR",
        help="where thresholds.toml and the report go [results/tuning]",
    )  # fmt: skip
    parser.add_argument("--jobs", type=int, default=-1, help="processes, −1: all processors")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler to spread over")
    parser.add_argument("--json", action="store_true", help="print everything as JSON")


def run(arguments: argparse.Namespace) -> None:
    """Tune, write the result directory, and say what was found."""
    from ...velocity.screening import Screening
    from ..config_files import load_config
    from ..tune.report import as_dict, write_tuning
    from ..tune.tuning import tune

    tuning = tune(
        arguments.path,
        snr=parse_range("--snr", arguments.snr),
        k=parse_range("--k", arguments.k),
        objective=arguments.objective,
        screening=Screening(cn0_of=arguments.cn0_of, k_of=arguments.k_of),
        min_kept=arguments.min_kept,
        direction=arguments.direction,
        systems=arguments.systems,
        config=load_config(arguments.config),
        jobs=arguments.jobs,
        scheduler=arguments.scheduler,
    )
    out = write_tuning(tuning, arguments.out)
    if arguments.json:
        print(json.dumps(as_dict(tuning), allow_nan=False))
        return
    t = tuning.thresholds
    best = tuning.at(t.min_cn0_dbhz, t.min_k)
    assert best is not None
    print(f"thresholds: C/N0 ({t.cn0_of}) > {t.min_cn0_dbhz:g} dB-Hz, k ({t.k_of}) > {t.min_k:g}")
    print(
        f"  cross-validated over {tuning.folds_by}: RMS {tuning.cv_rms:.3g} {tuning.unit}, "
        f"{tuning.cv_retention:.0%} retained"
    )
    print(f"  on all data: RMS {best[0]:.3g} {tuning.unit}, {best[1]:.0%} retained")
    for note in tuning.notes:
        print(f"  {note}")
    print(f"  report      {out / 'tuning.html'}")
    print(f"  use it      certnav run PATH --config {out / 'thresholds.toml'}")


def parse_range(option: str, text: str) -> list[float]:
    """Return the thresholds of FROM:TO:STEP, both ends included, or of one number.

    Raises
    ------
    ConfigError
        If it is neither.
    """
    from ...filters.errors import ConfigError

    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) == 1:
        return numbers
    if len(numbers) != 3 or not (numbers[2] > 0.0 and numbers[1] >= numbers[0]):
        raise ConfigError(f"{option} {text}: expected FROM:TO:STEP, for example 30:50:1")
    first, last, step = numbers
    count = int((last - first) / step + 1e-9) + 1
    if count > 1000:
        raise ConfigError(f"{option} {text}: {count} thresholds — choose a larger step")
    return [round(first + i * step, 10) for i in range(count)]
