"""Inertial data in a wrong unit: who names it, the reader, ``certnav check``, or nobody."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np

from certnav.datasets.loading import load
from certnav.filters.errors import NavError
from certnav.nav.check.recording import check

from .drives import Drive, scaled
from .seeds import UNIT_FORMATS


def silent_units(folder: Path) -> dict[str, Any]:
    """Scale gyro and accelerometer of a drive with turns; count what nobody names."""
    drive = Drive.of(duration=120.0, imu_rate=50.0, fix_interval=0.25)
    degree, g = np.pi / 180.0, 9.80665
    gyro = (degree, 1 / degree, 3600.0, 1 / 3600.0, 1e3, 1e-3, 2 * np.pi, 0.5 / np.pi, -1.0)
    accel = (g, 1 / g, 1e3, 1e-3, 1e2, 1e-2, 0.3048, 1 / 0.3048, -1.0)
    cases = [("sound", 1.0, 1.0)]
    cases += [(f"gyro × {f:.4g}", f, 1.0) for f in gyro]
    cases += [(f"accelerometer × {f:.4g}", 1.0, f) for f in accel]
    tried, silent, sound = 0, [], []
    for form, write in UNIT_FORMATS.items():
        for what, f_gyro, f_accel in cases:
            place = folder / f"units-{form}"
            place.mkdir(parents=True)
            write(place, scaled(drive, f_gyro, f_accel))
            try:
                load(place)
                refused = ""
            except NavError as error:
                refused = str(error)
            found = check(place)
            about = [
                f for f in (*found.of("fatal"), *found.of("doubtful"))
                if any(word in f.line.lower() for word in ("gyro", "gravity", "accelerometer"))
            ]  # fmt: skip
            shutil.rmtree(place)
            if what == "sound":
                sound += [f"{form}: {refused or about[0].line}"] if refused or about else []
                continue
            tried += 1
            if not refused and not about:
                silent.append(f"{form}: {what}")
    return {"units_tried": tried, "units_silent": len(silent), "silent": silent, "alarms": sound}
