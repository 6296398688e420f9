"""`certnav align`: headings of sliding windows as a table, as JSON, as a picture, with proofs."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

HELP = "find the attitude from Doppler and local velocity, window by window"
DESCRIPTION = (
    "Certifiable alignment over sliding windows: heading of the vehicle from raw "
    "Doppler and its own odometer, or its IMU where there is none, against the reference if "
    "there is one."
)
EXAMPLE = "certnav align drive --window 15"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav align`` to its parser."""
    parser.add_argument("path", type=Path, help="folder of the recording")
    parser.add_argument("--window", type=float, default=15.0, metavar="S", help="length [15 s]")
    parser.add_argument("--step", type=float, default=5.0, metavar="S", help="distance [5 s]")
    parser.add_argument(
        "--method", default="robust",
        help="robust, certified (every row believed), sdp, voba or gauss-newton [robust]",
    )  # fmt: skip
    parser.add_argument(
        "--clock", default="random-walk",
        help="drift: constant, linear, per-epoch or random-walk [random-walk]",
    )  # fmt: skip
    parser.add_argument("--satellites", type=float, metavar="N", help="keep N per epoch, drawn")
    parser.add_argument("--rows", default="all", help="all, or los where the data are labelled")
    parser.add_argument("--decimate", type=int, default=1, metavar="K", help="every K-th epoch")
    parser.add_argument(
        "--noise",
        help="Doppler σ: fitted to the recording with its correlation, or assumed [fitted; "
        "assumed without an odometer]",
    )  # fmt: skip
    parser.add_argument(
        "--clock-walk", type=float, default=0.1, metavar="Q", help="of --clock random-walk, m/s/√s"
    )
    parser.add_argument(
        "--phase", default="gate",
        help="carrier phase: gate leaves out Doppler that contradicts it, rates also takes its "
        "rates instead, off [gate]",
    )  # fmt: skip
    parser.add_argument("--min-cn0", type=float, default=0.0, metavar="DB", help="[dB-Hz]")
    parser.add_argument(
        "--level", type=float, metavar="DEG",
        help="a car on a road is level within so much, 1σ; 0: nothing is known of it [2; 0 "
        "without an odometer]",
    )  # fmt: skip
    parser.add_argument(
        "--position-sigma", type=float, metavar="M",
        help="1σ of the positions, an unknown of each window [as the recording says]",
    )  # fmt: skip
    parser.add_argument(
        "--speed-scale", type=float, default=2.0, metavar="PCT",
        help="1σ of the odometer's scale, an unknown of each window [2]",
    )  # fmt: skip
    parser.add_argument(
        "--proof", type=Path, metavar="FILE", help="write proofs in exact numbers (certnav verify)"
    )
    parser.add_argument(
        "--unchecked", action="store_true", help="align even if the data contradict physics"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of the table")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw headings and errors (PNG)")


def run(arguments: argparse.Namespace) -> None:
    """Align every window of a recording and report."""
    from dataclasses import replace

    from ...filters.errors import ConfigError
    from ..config import Config
    from ..results.summary import strict
    from ..sweep.drives import checked_load
    from ..windows.options import WindowOptions
    from ..windows.recording import align_recording
    from ..windows.report import as_dict, draw, table, write_proofs

    options = WindowOptions(
        window=arguments.window,
        step=arguments.step,
        method=arguments.method,
        clock=arguments.clock,
        satellites=arguments.satellites,
        labels=arguments.rows,
        decimate=arguments.decimate,
        noise=arguments.noise or "assumed",
        phase=arguments.phase,
        min_cn0=arguments.min_cn0,
        level_deg=arguments.level or None,
        clock_walk=arguments.clock_walk,
        position_sigma_m=arguments.position_sigma,
        speed_scale_sigma=0.01 * arguments.speed_scale,
    )
    if arguments.proof is not None and options.method not in ("certified", "robust"):
        raise ConfigError(
            f"--proof: method '{options.method}' proves nothing that could be written"
        )
    sequence = checked_load(arguments.path, Config(), checked=not arguments.unchecked)
    if arguments.proof is not None and sequence.odometer is None:
        raise ConfigError(
            f"--proof: {sequence.name} has no odometer, and rows that hang on integrals of the IMU "
            "are none that a proof file holds — leave --proof out"
        )
    if sequence.odometer is not None:  # its windows can bear more, unless told otherwise
        options = replace(
            options, noise=arguments.noise or "fitted",
            level_deg=2.0 if arguments.level is None else options.level_deg,
        )  # fmt: skip
    results, noise = align_recording(sequence, options)
    if arguments.proof is not None:
        write_proofs(sequence.name, results, arguments.proof, options)
    if arguments.plot is not None:
        draw(results, options, sequence.name, arguments.plot)
    if arguments.json:
        print(json.dumps(strict(as_dict(sequence.name, options, results, noise)), indent=2))
    else:
        print(table(sequence.name, options, results, noise))
