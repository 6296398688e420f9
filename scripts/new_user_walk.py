"""The walk of a new user: files of a logger of one's own, from nothing to a report.

A drive is rewritten as somebody's logger would have it: column names that nobody knows, degrees,
right-forward-up axes, Unix time, the reference in a third file. Then certnav is used as its pages
say, and what was typed and edited is printed, with what came back.

    python scripts/new_user_walk.py --data ../shared/data     an Oakville drive
    python scripts/new_user_walk.py --simulated               a minute's drive, without any data
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from certnav.datasets.axes import axes_matrix
from certnav.datasets.loading import load
from certnav.datasets.observations import GnssFixes
from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.datasets.text.toml_files import read_toml
from certnav.filters.earth import C_en_of, ecef_to_lla

#: What only the user knows, by key: the answers that are typed into the draft.
ANSWERS = {
    "preset": '"consumer"',
    "lever_frd_m": "[0.0, 0.0, -1.0]",
    "lever_sigma_m": "0.5",
    "height": '"ellipsoid"',
    "point": '"antenna"',
    "source": '"the receiver\'s own fused solution"',
    "attitude_of": '"vehicle"',
    "position_sigma_m": "[1.5, 1.5, 3.0]",
    "velocity_sigma_mps": "0.2",
}
#: Of a lever arm whose other axes were measured; the roof is so far above the IMU.
DOWN = "-1.0"
#: Most commands that a user should need.
MOST = 4
_DRIVE = "oakville-drives/urban-medium-turn-loop-nominal-001"
#: The beginning that the logger gives: 2024-05-03, Unix time [s].
_UNIX = 1714737600.0


def write_own_files(sequence: Sequence, fixes: GnssFixes, folder: Path) -> list[Path]:
    """Write a drive as somebody's logger would have it; return the files.

    Parameters
    ----------
    sequence : Sequence
        Its IMU and reference.
    fixes : GnssFixes
    folder : Path
    """
    start = float(sequence.inertial.time[0])
    imu, C_bs = sequence.inertial, axes_matrix("RFU")
    files = [folder / name for name in ("Traegheit.csv", "Satelliten.csv", "Wahrheit_ref.csv")]
    _table(
        files[0],
        {
            "Uhr": imu.time - start + _UNIX,
            **_three("Drehrate_", np.degrees(imu.gyro_b @ C_bs)),
            **_three("Kraft_", imu.accel_b @ C_bs),
        },
    )
    sigma = np.sqrt(np.einsum("nji,njk,nki->ni", C_en_of(fixes.pos_e), fixes.pos_cov_e,
                              C_en_of(fixes.pos_e)))  # fmt: skip
    _table(
        files[1],
        {
            "Uhr": fixes.time - start + _UNIX,
            **_places(fixes.pos_e),
            **_speeds(fixes.pos_e, fixes.vel_e),
            **{f"Streuung_{k}": v for k, v in zip("NOH", sigma.T, strict=True)},
        },
    )
    reference = sequence.reference
    assert reference is not None
    _table(
        files[2],
        {
            "Uhr": reference.time - start + _UNIX,
            **_places(reference.pos_e),
            **_speeds(reference.pos_e, reference.vel_e),
        },
    )
    return files


def _table(file: Path, columns: dict[str, np.ndarray]) -> None:
    pd.DataFrame(columns).to_csv(file, index=False, float_format="%.9f")


def _three(name: str, value: np.ndarray) -> dict[str, np.ndarray]:
    return {f"{name}{k}": column for k, column in zip("abc", value.T, strict=True)}


def _places(pos_e: np.ndarray) -> dict[str, np.ndarray]:
    lat, lon, height = ecef_to_lla(pos_e).T
    return {"Breite": np.degrees(lat), "Laenge": np.degrees(lon), "Hoehe": height}


def _speeds(pos_e: np.ndarray, vel_e: np.ndarray) -> dict[str, np.ndarray]:
    vel_n = np.einsum("nij,ni->nj", C_en_of(pos_e), vel_e)
    return dict(zip(("Fahrt_Nord", "Fahrt_Ost", "Fahrt_Unten"), vel_n.T, strict=True))


class Walk:
    """A user at a terminal in a folder: what is typed is printed, and counted."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.typed = 0

    def type(self, *words: str) -> str:
        """Type a command; return what it says. One that fails ends the walk."""
        self.typed += 1
        print(f"\n$ certnav {' '.join(words)}", flush=True)
        began = time.perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "certnav.nav.commands.cli", *words],
            cwd=self.folder, capture_output=True, text=True, check=False,
        )  # fmt: skip
        print(done.stdout.rstrip() + done.stderr.rstrip())
        print(f"[{time.perf_counter() - began:.1f} s, status {done.returncode}]", flush=True)
        if done.returncode:
            raise SystemExit(f"stumbled over: certnav {' '.join(words)}")
        return done.stdout

    def fill(self, file: str) -> int:
        """Fill the blanks of a draft in, as with an editor; return how many there were."""
        path, edits = self.folder / file, 0
        lines = path.read_text(encoding="utf-8").splitlines()
        blank_lever = False
        for k, line in enumerate(lines):
            key, _, rest = line.partition(" = ")
            value, _, _ = rest.partition("  #")
            blank = '"?"' in value
            if blank or (key == "lever_sigma_m" and blank_lever):
                edits += blank
                blank_lever |= key == "lever_frd_m"
                measured = blank and value.startswith("[")  # but for down, which nothing shows
                answer = value.replace('"?"', DOWN).strip() if measured else ANSWERS[key]
                lines[k] = f"{key} = {answer}"
                print(f"  edit line {k + 1}: {lines[k]}")
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return edits


def walk(files: list[Path]) -> dict[str, float]:
    """Go from files to a report; return what it cost and what came out of it."""
    folder = files[0].parent
    user = Walk(folder)
    user.type("declare", *(file.name for file in files), "--out", "sequence.toml")
    edits = user.fill("sequence.toml")
    user.type("check", ".")
    user.type("run", ".", "--out", "result")
    summary = json.loads((folder / "result" / "summary.json").read_text(encoding="utf-8"))
    declared, _ = read_toml(folder / "sequence.toml")
    assert (folder / "result" / "report.html").is_file()
    position = float(summary["errors"]["horizontal_rms_m"])
    print(
        f"\n{user.typed} commands, {edits} blanks filled in, axes {declared['imu']['axes']}, "
        f"horizontal error {position:.2f} m RMS against the reference"
    )
    return {"commands": user.typed, "blanks": edits, "horizontal_rms_m": position}


def simulated(folder: Path, duration: float = 120.0) -> list[Path]:
    """Write the files of a simulated drive."""
    config = SimulationConfig(
        seed=3, duration=duration, density="open", static_start=10.0, imu_rate=50.0
    )
    drive = simulate(config)
    times = config.start_time + np.arange(1.0, duration - 1.0, 0.5)
    rng = np.random.default_rng(1)
    lever = config.lever_antenna_b
    fixes = fixes_from_truth(drive.trajectory, times, lever, (0.5, 0.5, 1.0), 0.05, rng)
    truth = drive.sequence()
    return write_own_files(truth, fixes, folder)


def main() -> None:
    """Walk, and say what it cost."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, help="the folder of the recordings")
    parser.add_argument("--simulated", action="store_true")
    parser.add_argument("--keep", type=Path, help="an empty folder to work in, which stays")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = arguments.keep or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        if arguments.simulated or arguments.data is None:
            files = simulated(folder)
        else:
            sequence = load(arguments.data / _DRIVE)
            assert sequence.fixes is not None
            files = write_own_files(sequence, sequence.fixes, folder)
        cost = walk(files)
    sys.exit(cost["commands"] > MOST)


if __name__ == "__main__":
    main()
