"""The Spirent simulator set of INSTINCT (University of Stuttgart, INS): exact truth, no IMU.

`Rover-*_motion_Spirent.csv` holds the simulated motion at 10 Hz: ECEF position [m] and velocity
[m/s], geodetic position [rad], heading/elevation/bank [rad] with respect to NED, axes
forward-right-down (heading equals the course, checked), antenna = vehicle point. Its `Ang-vel`
columns are body rates relative to NED with spikes where the heading wraps; they are not used.

IMU data are made from the motion (`smooth_trajectory`). The simulated signals follow the file's
velocity, which jitters by 0.8 mm/s around the smooth one; the reference carries the file's.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...filters.earth import C_en_at, C_en_of, ecef_to_lla, lla_to_ecef
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray, matrix_from_rpy, rpy_from_matrix
from ...filters.sensors import imu_preset
from ..sequence import Calibration, Sequence
from ..series import Reference
from ..text.tables import cannot_open, check_head

if TYPE_CHECKING:
    import pandas as pd

    from ..simulation.trajectory import Trajectory

_MOTION = "Rover-*_motion_Spirent.csv"
_VARIANTS = {True: "iono-Klob_tropo-Saast", False: "iono-none_tropo-none"}
_KNOT_STEP = 2.0
_POSITION, _VELOCITY = ["Pos_X", "Pos_Y", "Pos_Z"], ["Vel_X", "Vel_Y", "Vel_Z"]
_ATTITUDE = ["Bank", "Elevation", "Heading"]


def is_spirent(path: str | Path) -> bool:
    """Return True if `path` is the folder `spirent_dynamic` of the set."""
    return Path(path).is_dir() and any(Path(path).glob(_MOTION))


def read_spirent(
    path: str | Path,
    *,
    atmosphere: bool = True,
    imu: str = "adis16470",
    seed: int | None = 0,
    rate: float = 100.0,
    systems: str = "GE",
) -> Sequence:
    """Return the simulated drive: real simulator observations, truth, and an IMU made from it.

    Parameters
    ----------
    path : path
        Folder `spirent_dynamic`.
    atmosphere : bool
        Observations with Klobuchar ionosphere and Saastamoinen troposphere, or with neither.
    imu : str
        `ImuSpec` preset, for the noise added and for `calibration`.
    seed : int, optional
        Seed of the IMU's noise and biases; None makes an error-free IMU.
    rate : float
        IMU samples per second.
    systems : str
        Constellations to keep, of 'G' and 'E'.

    Raises
    ------
    DataError
        Missing or incomplete files.
    """
    # Slow to import, and every folder is looked at for being one of these.
    from .. import rtklib
    from ..simulation.sensors import imu_measurements

    path = Path(path)
    spec = imu_preset(imu)
    reference = _read_motion(path)
    variant = path / _VARIANTS[atmosphere]
    files = sorted(variant.glob("*.obs"))
    if not files:
        raise DataError("no observation file (*.obs)", file=variant, remedy="unpack the whole set")
    navigation = tuple(sorted(p for p in path.glob("RINEX_?N_Spirent.*") if p.is_file()))
    if not rate > 0.0:
        raise ConfigError(f"rate: expected > 0 Hz, found {rate!r}")
    count = int((reference.time[-1] - reference.time[0]) * rate - 1e-3)
    samples, _, _ = imu_measurements(
        smooth_trajectory(reference),
        reference.time[0] + np.arange(1, count + 1) / rate,
        spec,
        np.random.default_rng(seed),
        noise=seed is not None,
    )
    made = f"IMU made from the truth at {rate:g} Hz (the set has none)"
    return Sequence(
        name=f"spirent-{'atmosphere' if atmosphere else 'vacuum'}",
        imu=samples,
        calibration=Calibration(
            spec,
            np.zeros(3),
            "simulated: antenna at the vehicle point",
            # Above 3 m/s the point's velocity is never more than 4 mm/s off its attitude's x.
            mounting_source="the motion file: no velocity across its own attitude",
        ),
        observations=rtklib.read_observations(files[0], navigation, systems=systems),
        navigation=navigation,
        rover_file=files[0],
        reference=reference,
        notes=(
            made + (", error-free" if seed is None else f", {spec.name} errors, seed {seed}"),
            "ionosphere and troposphere simulated" if atmosphere else "no atmosphere simulated",
            "Galileo's broadcast accuracy (25 m) is outside its table: RTKLIB's single-point "
            "positioning leaves Galileo out; its Doppler is used",
        ),
    )


def _read_motion(path: Path) -> Reference:
    files = sorted(path.glob(_MOTION)) if path.is_dir() else []
    if not files:
        raise DataError(f"no {_MOTION}", file=path, remedy="name the folder spirent_dynamic")
    file = files[0]
    try:
        with file.open(encoding="latin-1") as stream:
            head = stream.readline(1000).split(",")
    except OSError as error:
        raise cannot_open(file, error) from None
    check_head(file, skip=1)
    import pandas as pd

    columns = ["Time_ms", *_POSITION, *_VELOCITY, *_ATTITUDE]
    try:
        start = float(head[-1])
        if not 0.0 <= start < 4e9:
            raise ValueError(f"GPS time of the start in line 1: {start:g} s")
        table = pd.read_csv(file, skiprows=1, engine="c", usecols=columns, dtype=float)
    except ValueError as error:
        raise DataError(
            f"expected a Spirent motion file ({error})".splitlines()[0],
            file=file,
            remedy="unpack the set again",
        ) from None
    _check_motion(table, file)
    time = start + 1e-3 * table["Time_ms"].to_numpy()
    return Reference(
        time=time,
        pos_e=table[_POSITION].to_numpy(),
        vel_e=table[_VELOCITY].to_numpy(),
        rpy=table[_ATTITUDE].to_numpy(),
        lever_b=np.zeros(3),
        point="imu",
        source="Spirent simulator, exact",
    )


def _check_motion(table: pd.DataFrame, file: Path) -> None:
    """Refuse what splines with 2 s between knots cannot follow."""

    def refuse(bad: FloatArray, problem: str) -> None:
        if bad.any():
            row = int(np.argmax(bad))
            raise DataError(problem, file=file, line=row + 3, remedy="unpack the set again")

    refuse(~np.isfinite(table.to_numpy()).all(axis=1), "expected finite numbers in all columns")
    radius = np.linalg.norm(table[_POSITION].to_numpy(), axis=1)
    refuse((radius < 6.3e6) | (radius > 6.5e6), "ECEF position: expected 6300 … 6500 km")
    speed = np.linalg.norm(table[_VELOCITY].to_numpy(), axis=1)
    refuse(speed > 1e3, "velocity: expected a road vehicle's, in m/s")
    refuse(np.abs(table[_ATTITUDE].to_numpy()).max(axis=1) > 7.0, "attitude: expected radians")
    time = 1e-3 * table["Time_ms"].to_numpy()
    step = np.diff(time, prepend=time[:1] - 0.1)
    refuse((step <= 0.0) | (step > 1.0), "Time_ms: expected steps of up to 1000, increasing")
    if time.size < 2 or time[-1] - time[0] < 2.0 * _KNOT_STEP:
        raise DataError(f"expected at least {2 * _KNOT_STEP:g} s of motion", file=file)


def smooth_trajectory(reference: Reference) -> Trajectory:
    """Return a trajectory with continuous acceleration and angular rate along the truth.

    Least-squares quintic splines with 2 s knots replace the file's digits (0.1 mm) and the
    jitter of its heading (0.014° rms); interpolating them at the file's rate changes nothing.
    """
    from scipy.interpolate import make_lsq_spline

    from ..simulation.trajectory import Trajectory

    start = float(reference.time[0])
    t = reference.time - start
    inner = np.arange(_KNOT_STEP, t[-1] - _KNOT_STEP / 2, _KNOT_STEP)
    knots = np.r_[np.zeros(6), inner, np.full(6, t[-1])]
    pos_e = make_lsq_spline(t, reference.pos_e, knots, 5)(t)
    rpy = make_lsq_spline(t, np.unwrap(reference.rpy, axis=0), knots, 5)(t)
    origin = ecef_to_lla(pos_e[0])
    C_et = C_en_at(origin[0], origin[1])
    rpy_t = rpy_from_matrix(C_et.T @ C_en_of(pos_e) @ matrix_from_rpy(rpy))
    pos_t = (pos_e - lla_to_ecef(*origin)) @ C_et
    return Trajectory(start, t, pos_t, np.unwrap(rpy_t, axis=0), origin)
