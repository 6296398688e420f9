"""One receiver's file by itself: a raw log, or RINEX observations. It has no inertial data.

That is enough for ``certnav check``; a run takes it beside an IMU's file (``--imu``), or by a
declaration.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...filters.errors import DataError
from ...filters.sensors import ImuSpec
from ..sequence import Calibration, Sequence

_NO_IMU = ImuSpec("none", "a receiver's file by itself", *[np.inf] * 6)


def is_receiver_file(path: Path) -> bool:
    """Return whether a file holds a receiver's observations: a raw log, or RINEX, packed or not."""
    if not path.is_file():
        return False
    from ..rtklib.logs.given_files import is_observed  # RTKLIB is slow to import

    return is_observed(path)


def read_receiver_file(
    path: str | Path, *, navigation: str | tuple[str, ...] = (), systems: str = "GREJC"
) -> Sequence:
    """Return the observations of one file.

    Parameters
    ----------
    path : path
        RINEX observations, or a receiver's log (UBX, SBF, RTCM 3, NovAtel OEM).
    navigation : str or sequence of str
        Broadcast ephemerides, RINEX or logs; default: those in the log itself.
    systems : str
        Constellation letters, as in `datasets.rtklib.read_observations`.

    Raises
    ------
    DataError
        Nothing observed, or no ephemerides.
    """
    from ..rtklib import given_files, read_observations
    from ..text.rinex_repair import readable_rinex

    path = Path(path)
    names = (navigation,) if isinstance(navigation, str) else tuple(navigation)
    given = given_files(path, names)
    if not given.navigation:
        raise DataError(
            "no ephemerides: the file itself holds none",
            file=path,
            remedy="name them: --set data.navigation=FILE",
        )
    observations = read_observations(given.observations, given.navigation, systems=systems)
    repaired = [readable_rinex(f).notes for f in (given.observations, *given.navigation)]
    return Sequence(
        name=path.name.partition(".")[0],
        imu=None,
        calibration=Calibration(
            imu=_NO_IMU,
            lever_antenna_b=np.zeros(3),
            lever_antenna_source="positions of the antenna itself",
            lever_antenna_sigma=0.0,
        ),
        observations=observations,
        navigation=given.navigation,
        rover_file=given.observations,
        notes=(*given.notes, *(note for notes in repaired for note in notes)),
        logs=given.notes,
    )
