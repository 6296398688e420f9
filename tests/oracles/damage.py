"""Changes of a recording's folder, made of changes of what one of its files holds."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd

#: Does something to the files of a folder.
Damage = Callable[[Path], None]


def imu_rows(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Change the rows ``sow gx gy gz ax ay az`` of a simulated drive."""
    file = folder / "IMU" / "MEMS_imu_data.txt"
    rows = change(np.loadtxt(file, skiprows=1))
    np.savetxt(file, rows, fmt=["%.5f", *6 * ["%.8f"]], header="Time", comments="")


def rinex(change: Callable[[str], str]) -> Damage:
    """Return a change of the GPS satellites' lines of the observation file."""

    def breaks(folder: Path) -> None:
        file = next((folder / "GNSS" / "Rover").iterdir())
        lines = file.read_text().splitlines()
        lines = [change(line) if re.match(r"G\d\d ", line) else line for line in lines]
        file.write_text("\n".join(lines) + "\n")

    return breaks


def cut(share: float, whole_epochs: bool) -> Damage:
    """Return an observation file cut short, at an epoch or within a line."""

    def breaks(folder: Path) -> None:
        file = next((folder / "GNSS" / "Rover").iterdir())
        text = file.read_text()
        at = int(len(text) * share)
        file.write_text(text[: text.rindex(">", 0, at)] if whole_epochs else text[:at])

    return breaks


def sidecar(pattern: str, replacement: str | Callable[[re.Match[str]], str]) -> Damage:
    """Return a change of the one place of ``great.toml`` that matches."""

    def breaks(folder: Path) -> None:
        file = folder / "great.toml"
        text, count = re.subn(pattern, replacement, file.read_text())
        assert count == 1, f"{pattern} found {count} times in {file}"
        file.write_text(text)

    return breaks


def remove(pattern: str) -> Damage:
    """Return the loss of the files that match."""

    def breaks(folder: Path) -> None:
        for file in folder.glob(pattern):
            file.unlink()

    return breaks


def csv(name: str, change: Callable[[pd.DataFrame], pd.DataFrame]) -> Damage:
    """Return a change of a packed table with a header."""

    def breaks(folder: Path) -> None:
        file = folder / f"{name}.csv.gz"
        change(pd.read_csv(file)).to_csv(file, index=False)

    return breaks


def arrays(*names: str, change: Callable[[np.ndarray], np.ndarray]) -> Damage:
    """Return a change of files in numpy's format, whatever their names end in."""

    def breaks(folder: Path) -> None:
        for name in names:
            value = change(np.load(folder / name))
            with (folder / name).open("wb") as stream:
                np.save(stream, value)

    return breaks


def both(a: Damage, b: Damage) -> Damage:
    """Return one damage after the other."""

    def breaks(folder: Path) -> None:
        a(folder)
        b(folder)

    return breaks
