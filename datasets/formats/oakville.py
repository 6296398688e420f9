"""Oakville drives (yongkyuns/imu_gnss_fusion): generic replay folders of real cars.

``imu.csv[.gz]`` holds rad/s and m/s² in sensor axes, which in the car recordings are
forward-left-up (a_z = +9.9); ``gnss.csv[.gz]`` degrees, ellipsoidal height, velocity
north-east-down and standard deviations. Time is seconds from the start of the recording: there
is no date, so nothing that needs satellites is possible.

The reference is the receiver's own fused solution, not independent of the GNSS. Physics settles
what is not documented: roll is right side down, pitch nose up, heading clockwise (sensor gravity
and climb follow them), heading equals the course to 0.05° because the receiver constrains it so;
its position follows the antenna, its velocity a point about 1–1.5 m behind it (no side slip).
Until the receiver has initialised, it prints roll = 0 exactly and repeats its GNSS at 30 Hz; those
rows are no reference and are left out. The files of the reference have stamps of their own, and
are joined by them. Where ``reference_mount`` gives the mounting, the sensor may be turned in any
way: it is turned before it is judged.
"""

from __future__ import annotations

import itertools
import zlib
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...filters.earth import C_en_at, lla_to_ecef
from ...filters.errors import DataError
from ...filters.rotation import FloatArray, matrix_from_rpy, rpy_from_matrix, wrap_angle
from ...filters.sensors import imu_preset
from ..observations import GnssFixes
from ..physics import check_gravity, check_gyro, course_of
from ..sequence import Calibration, Sequence
from ..series import ImuData, Reference
from ..text.imu import AXES
from ..text.tables import LARGEST, check_head, sampling_note

if TYPE_CHECKING:
    import pandas as pd

_POSITION = ("lat_deg", "lon_deg", "height_m")
_VELOCITY = ("vn_mps", "ve_mps", "vd_mps")
_ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")
#: The antenna's place is not documented; the GNSS velocity in turns puts it within 0.5 m.
_LEVER_SIGMA = 0.5
#: Moving, and yet the same position printed twice: a held value [m/s].
_MOVING = 0.5
#: Attitudes this far apart still give that of a position between them [s].
_JOINED = 0.25


def is_oakville(folder: Path) -> bool:
    """Return whether the folder holds ``imu.csv`` and ``gnss.csv``, compressed or not."""
    return all(_find(folder, name) is not None for name in ("imu", "gnss"))


def read_oakville(path: str | Path, *, preset: str = "consumer") -> Sequence:
    """Return one drive.

    Parameters
    ----------
    path : path
        Folder of the drive.
    preset : str
        Noise model of the IMU, which the set does not name.

    Raises
    ------
    DataError
        Missing files or columns, or data that contradict physics.
    """
    folder = Path(path)
    C_bs = AXES["FLU"]
    table = _table(folder, "imu")
    imu = ImuData(
        time=table["t_s"].to_numpy(),
        gyro_b=_columns(table, [f"g{k}_radps" for k in "xyz"]) @ C_bs.T,
        accel_b=_columns(table, [f"a{k}_mps2" for k in "xyz"]) @ C_bs.T,
    )
    fixes = _fixes(_table(folder, "gnss"))
    C_bv, mount_note = _mount(folder)
    # The IMU may be turned in any way: gravity and yaw rate are the vehicle's, not the sensor's z.
    turned = ImuData(imu.time, imu.gyro_b @ C_bv, imu.accel_b @ C_bv)
    course = course_of(fixes.pos_e, fixes.vel_e)
    notes = [
        f"Oakville drive: time relative, no date; {sampling_note(imu.time, 'IMU')}",
        sampling_note(fixes.time, "GNSS"),
        check_gravity(turned.accel_b, file=folder, declared="m/s², FLU turned by mount"),
        "lever arm IMU→antenna not documented: zero, 0.5 m 1σ per axis",
        mount_note,
        check_gyro(turned, fixes.time, course, file=folder, declared="rad/s, FLU turned by mount"),
    ]
    reference, more = _reference(folder)
    return Sequence(
        name=folder.resolve().name,
        imu=imu,
        calibration=Calibration(
            imu=imu_preset(preset),
            lever_antenna_b=np.zeros(3),
            lever_antenna_source="not documented; zero assumed",
            lever_antenna_sigma=_LEVER_SIGMA,
            C_bv=C_bv,
        ),
        fixes=fixes,
        reference=reference,
        time_scale="relative",
        notes=tuple(notes + more),
    )


def _find(folder: Path, name: str) -> Path | None:
    return next((f for end in ("csv.gz", "csv") if (f := folder / f"{name}.{end}").is_file()), None)


def _table(folder: Path, name: str) -> pd.DataFrame:
    """Return a CSV with header, refusing values that are not finite."""
    file = _find(folder, name)
    if file is None:
        raise DataError("file not found", file=folder / f"{name}.csv.gz", remedy="check the folder")
    import pandas as pd

    check_head(file)
    try:
        table = pd.read_csv(file, dtype=float)
    except (ValueError, OSError, EOFError, zlib.error) as error:
        raise DataError(f"not readable as numbers: {error}".splitlines()[0], file=file) from None
    if "t_s" not in table:
        raise DataError(f"expected a column t_s, found {', '.join(table)}", file=file, line=1)
    if len(table) < 2:
        raise DataError(f"expected at least 2 rows, found {len(table)}", file=file)
    step = np.diff(table["t_s"])
    if (step <= 0.0).any():
        row = int(np.argmax(step <= 0.0)) + 1
        raise DataError(
            f"t_s: expected increasing time, found {table['t_s'][row]:g}",
            file=file,
            line=row + 2,
            remedy="sort the file or remove the repeated rows",
        )
    needed = [c for c in table if c != "heading_rad"]  # NaN where the receiver has no heading
    bad = ~(np.abs(table[needed].to_numpy()) <= LARGEST)
    if bad.any():
        row, column = (int(k) for k in np.argwhere(bad)[0])
        raise DataError(f"{needed[column]}: expected a finite number", file=file, line=row + 2)
    table.attrs["file"] = file
    return table


def _columns(table: pd.DataFrame, names: tuple[str, ...] | list[str]) -> FloatArray:
    missing = [name for name in names if name not in table]
    if missing:
        raise DataError(
            f"missing columns {', '.join(missing)}", file=table.attrs.get("file"), line=1
        )
    return table[list(names)].to_numpy()


def _lla(table: pd.DataFrame) -> FloatArray:
    return _columns(table, _POSITION) * [np.pi / 180.0, np.pi / 180.0, 1.0]


def _fixes(table: pd.DataFrame) -> GnssFixes:
    lla = _lla(table)
    C_en = C_en_at(lla[:, 0], lla[:, 1])

    def covariance(names: list[str]) -> FloatArray:
        std = _columns(table, names)
        return np.einsum("nij,nj,nkj->nik", C_en, std**2, C_en)

    return GnssFixes(
        time=table["t_s"].to_numpy(),
        pos_e=lla_to_ecef(*lla.T),
        pos_cov_e=covariance([f"pos_std_{k}_m" for k in "ned"]),
        vel_e=np.einsum("nij,nj->ni", C_en, _columns(table, _VELOCITY)),
        vel_cov_e=covariance([f"vel_std_{k}_mps" for k in "ned"]),
        satellites=np.full(len(table), -1),
        quality=np.full(len(table), "receiver"),
    )


def _mount(folder: Path) -> tuple[FloatArray, str]:
    """Return C_bv from the receiver's own estimate of the mounting angles.

    The angles turn the sensor's into the vehicle's forward-left-up axes, z-y-x:
    ``x_v = Rz(yaw) Ry(pitch) Rx(roll) x_s``. Yaw is settled by a drive with the sensor at 265°
    (accelerations agree to 0.3°), roll by gravity against the receiver's own vehicle roll. The
    estimate converges over minutes and wraps at 360°: the median direction of the second half of
    the drive is taken.
    """
    if _find(folder, "reference_mount") is None:
        return np.eye(3), "mounting of the IMU unknown: taken as aligned"
    table = _table(folder, "reference_mount")
    angles = np.radians(_columns(table, _ANGLES))
    angles = angles[len(angles) // 2 :]
    axes = _upright(angles)
    if axes is not None:  # angles about these axes: its own are undefined where x is vertical
        angles = np.array([rpy_from_matrix(matrix_from_rpy(a) @ axes.T) for a in angles])
    # about the circular mean, so that a median across 0/360° means what it says
    centre = np.angle(np.exp(1j * angles).mean(axis=0))
    rpy = centre + np.median(np.angle(np.exp(1j * (angles - centre))), axis=0)
    flip = AXES["FLU"]
    C_vs = matrix_from_rpy(rpy) @ (np.eye(3) if axes is None else axes)
    C_vb = flip @ C_vs @ flip
    roll, pitch, yaw = np.degrees(rpy if axes is None else rpy_from_matrix(C_vs))
    return C_vb.T, (
        f"mounting from the receiver's own estimate (median of the second half): roll {roll:.2f}°, "
        f"pitch {pitch:.2f}°, yaw {yaw:.2f}°, forward-left-up"
    )


def _upright(angles: FloatArray) -> FloatArray | None:
    """Return the signed permutation that turns the sensor's axes upright, None if they are.

    It is the nearest to the mean of the mounting's rotations, sensor to vehicle.
    """
    mean = np.mean([matrix_from_rpy(a) for a in angles], axis=0)
    if mean[2, 2] > np.cos(np.pi / 4):
        return None
    signs = np.array(list(itertools.product((1.0, -1.0), repeat=3)))
    turns = np.array(
        [np.eye(3)[list(order)] * s for order in itertools.permutations(range(3)) for s in signs]
    )
    turns = turns[np.linalg.det(turns) > 0.0]
    return turns[np.argmax(np.einsum("kij,ij->k", turns, mean))]


def _reference(folder: Path) -> tuple[Reference | None, list[str]]:
    """Return the receiver's fused solution from the moment it has initialised."""
    if any(_find(folder, f"reference_{n}") is None for n in ("position", "attitude")):
        return None, ["no reference"]
    position, attitude = (_table(folder, f"reference_{n}") for n in ("position", "attitude"))
    rpy, flat, known = _attitude_at(position["t_s"].to_numpy(), attitude)
    if known.sum() < 2:
        return None, ["reference left out: its positions and attitudes have no time in common"]
    position, rpy = position[known], rpy[known]
    time = position["t_s"].to_numpy()
    last = np.flatnonzero(flat[known])
    first = int(last[-1]) + 1 if last.size else 0
    lla = _lla(position)
    vel_n = _columns(position, _VELOCITY)
    moving = np.hypot(vel_n[:, 0], vel_n[:, 1]) > _MOVING
    held = np.concatenate([[False], (np.diff(lla, axis=0) == 0.0).all(axis=1)]) & moving
    keep = (np.arange(time.size) >= first) & ~held
    if keep.sum() < 2:
        return None, ["reference left out: the receiver never initialised its fusion"]
    apart = "" if known.all() else f"; {int((~known).sum())} positions without attitude left out"
    lla, vel_n = lla[keep], vel_n[keep]
    reference = Reference(
        time=time[keep],
        pos_e=lla_to_ecef(*lla.T),
        vel_e=np.einsum("nij,nj->ni", C_en_at(lla[:, 0], lla[:, 1]), vel_n),
        rpy=rpy[keep],
        lever_b=np.zeros(3),
        point="antenna",
        source="the receiver's own GNSS/INS solution: NOT independent of the GNSS",
        attitude_frame="v",
    )
    return reference, [
        f"reference: the receiver's own fused solution (not independent), antenna assumed, from "
        f"{time[first]:.1f} s when it initialised; {first} rows before that and "
        f"{int((held[first:]).sum())} held rows left out{apart}"
    ]


def _attitude_at(
    time: FloatArray, attitude: pd.DataFrame
) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
    """Return the attitude [rad] at other times: rows are joined by time, not by number.

    Returns
    -------
    rpy : ndarray, shape (n, 3)
    flat : ndarray of bool, shape (n,)
        Roll is exactly zero there, or on one side: the receiver has not initialised.
    known : ndarray of bool, shape (n,)
        There are attitudes near enough on both sides.
    """
    at, rpy = attitude["t_s"].to_numpy(), np.radians(_columns(attitude, _ANGLES))
    after = np.clip(np.searchsorted(at, time), 0, at.size - 1)
    before = np.where(at[after] == time, after, np.maximum(after - 1, 0))
    known = (at[before] <= time) & (time <= at[after]) & (at[after] - at[before] <= _JOINED)
    share = np.where(
        after > before, (time - at[before]) / np.maximum(at[after] - at[before], 1e-9), 0
    )
    change = wrap_angle(rpy[after] - rpy[before])
    flat = (rpy[before, 0] == 0.0) | (rpy[after, 0] == 0.0)
    return rpy[before] + share[:, None] * change, flat, known
