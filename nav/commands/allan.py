"""`certnav allan`: an IMU preset from a log at rest."""

from __future__ import annotations

import argparse
from pathlib import Path

HELP = "make an IMU preset from a log at rest"
DESCRIPTION = (
    "Take the longest rest of a recording, or of an IMU text file (sow gx gy gz ax ay az), and "
    "write its white noise and bias instability (Allan deviation) as a preset that a run takes "
    "with --set filter.imu=FILE."
)
EXAMPLE = "certnav allan rest.txt --out my_imu.toml"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``certnav allan`` to its parser."""
    parser.add_argument("path", type=Path, help="folder, declaration or IMU text file")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="write it there (*.toml), not to the screen"
    )
    parser.add_argument(
        "--preset",
        default="consumer",
        metavar="NAME",
        help="where turn-on spread, scale factors and correlation time are taken from",
    )
    parser.add_argument(
        "--gyro-unit", choices=("deg/s", "rad/s"), help="of a text file, which does not say it"
    )
    parser.add_argument(
        "--accel-unit", choices=("m/s2", "g"), default="m/s2", help="of a text file"
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="data.KEY=VALUE",
        help="reader option of a recording; repeatable",
    )


def run(arguments: argparse.Namespace) -> None:
    """Make a preset and print or write it."""
    from ...datasets.allan import preset_from_rest, preset_toml
    from ...datasets.loading import load
    from ...datasets.placing import write_file
    from ...datasets.text.imu import read_imu_text
    from ...filters.errors import ConfigError, DataError
    from ...filters.sensors import imu_preset
    from ..config_files import load_config
    from ..rest import longest_rest

    path, out, base = arguments.path, arguments.out, imu_preset(arguments.preset)
    if out is not None and out.suffix != ".toml":
        raise ConfigError(f"--out: expected a file *.toml, found {out.name}")
    if out is not None and out.exists():
        raise DataError("exists already", file=out, remedy="name another file")
    if path.is_file() and path.suffix != ".toml":
        if arguments.gyro_unit is None:
            raise ConfigError(f"{path}: a text file does not say it: give --gyro-unit")
        # Neither week nor axes matter to noise: the file's own will do.
        imu = read_imu_text(
            path, week=0, gyro_unit=arguments.gyro_unit, accel_unit=arguments.accel_unit, axes="FRD"
        )
    else:
        imu = load(path, **load_config(None, arguments.set).data).inertial
    spec, notes = preset_from_rest(longest_rest(imu, base), base, out.stem if out else "measured")
    text = preset_toml(spec, notes)
    if out is None:
        print(text, end="")
        return
    write_file(out, text.encode())
    print("\n".join(notes))
    print(f"{out}: certnav run … --set filter.imu={out}")
