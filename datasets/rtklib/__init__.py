"""RINEX, raw logs, broadcast orbits, single-point and relative positioning through RTKLIB.

The only package that touches the binding, pyrtklib5: arrays go in, arrays come out. Files are
tested by `datasets.text.rinex` first, because RTKLIB reads a truncated file without complaint.

RTKLIB keeps one signal per frequency band and three bands a satellite; Doppler and C/N0 pass
through single precision (≤ 0.25 mHz, that is 0.05 mm/s, for Dopplers below 4 kHz).
"""

from .atmosphere import ionosphere_delay, troposphere_delay
from .kept import read_observations
from .logs.given_files import GivenFiles, given_files
from .logs.raw_logs import RawLog, is_raw_log, raw_log
from .positioning import SinglePoint, single_point
from .precise import precise_observations
from .rtk import RelativePositions, relative_positions
from .satellites import SatelliteStates, satellite_states

__all__ = [
    "GivenFiles",
    "RawLog",
    "RelativePositions",
    "SatelliteStates",
    "SinglePoint",
    "given_files",
    "ionosphere_delay",
    "is_raw_log",
    "precise_observations",
    "raw_log",
    "read_observations",
    "relative_positions",
    "satellite_states",
    "single_point",
    "troposphere_delay",
]
