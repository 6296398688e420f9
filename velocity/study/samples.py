"""Doppler of a recorded drive beside its reference: what statistics and tuning are made of.

The direction of motion u comes from the reference: either the direction of its velocity
('motion': the antenna's own velocity, free of attitude, mounting and lever arm) or its attitude and
the mounting ('attitude': what DDIA-VE really uses). Which one was taken changes the meaning of the
error: only the second contains what the vehicle constraint itself gets wrong.

Epochs are taken at the receiver's own time labels; a clock that is 0.1 ms off costs 0.3 mm/s at
3 m/s².
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from ...datasets.observations import GnssObservations
from ...datasets.sequence import Sequence
from ...datasets.series import ImuData, Reference
from ...filters.earth import OMEGA_IE_E, C_en_of
from ...filters.errors import ConfigError, DataError
from ...filters.rotation import FloatArray, matrix_from_rpy
from ..range_rate import DopplerNoise, DopplerRows, doppler_rows, with_elevation
from ..vehicle_motion import ForwardMotion, forward_motion
from .pairs import Pairs, all_pairs, velocity_errors

#: Longest step of the reference that is interpolated [s].
MAX_GAP = 1.05


@dataclass(frozen=True, eq=False)
class Samples:
    """Doppler rows with the truth behind them.

    Attributes
    ----------
    name : str
    time : ndarray, shape (epochs,)
        GPS time [s].
    rows : DopplerRows
        n rows, sorted by epoch; `rows.row` indexes the sequence's observations.
    epoch : ndarray of int, shape (n,)
    motion : ForwardMotion
        One entry per epoch, from the reference.
    vel_e : ndarray, shape (epochs, 3)
        True antenna velocity [m/s].
    cn0, elevation, azimuth : ndarray, shape (n,)
        [dB-Hz], [rad], [rad].
    left_out : dict
        Epochs that could not be used, by reason.
    """

    name: str
    time: FloatArray
    rows: DopplerRows
    epoch: NDArray[np.int64]
    motion: ForwardMotion
    vel_e: FloatArray
    cn0: FloatArray
    elevation: FloatArray
    azimuth: FloatArray
    left_out: dict[str, int]

    def __repr__(self) -> str:
        return f"Samples({self.name!r}, {len(self.rows)} rows, {self.time.size} epochs)"

    def between(self, start: float, end: float) -> Samples:
        """Return the epochs with ``start <= time < end`` [s]."""
        keep = (self.time >= start) & (self.time < end)
        rows = keep[self.epoch]
        return replace(
            self,
            time=self.time[keep],
            rows=self.rows.take(rows),
            epoch=(np.cumsum(keep) - 1)[self.epoch[rows]],
            motion=self.motion.take(keep),
            vel_e=self.vel_e[keep],
            cn0=self.cn0[rows],
            elevation=self.elevation[rows],
            azimuth=self.azimuth[rows],
        )

    def weighted(self, noise: DopplerNoise) -> Samples:
        """Return the same with σ of the range rates from `noise`."""
        return replace(self, rows=replace(self.rows, sigma=noise.sigma(self.cn0)))

    def pairs(self) -> Pairs:
        """Return all pairs."""
        return all_pairs(self.rows, self.epoch, self.motion, self.cn0, self.elevation)

    def errors(self, pairs: Pairs) -> FloatArray:
        """Return ‖Δv‖ of pairs (of these rows, whatever motion they were made with) [m/s]."""
        return velocity_errors(pairs.speed, pairs.epoch, self.motion, self.vel_e)


def reference_samples(
    sequence: Sequence,
    *,
    direction: str = "motion",
    systems: str = "G",
    min_speed: float = 0.5,
    label: str = "",
    noise: DopplerNoise | None = None,
    reference_delay: float = 0.0,
) -> Samples:
    """Return the usable Doppler rows of a sequence with reference velocities.

    Parameters
    ----------
    sequence : Sequence
        With observations and a reference.
    direction : {'motion', 'attitude'}
        See the module. 'motion' needs speeds above `min_speed`.
    systems : str
        Constellation letters to take.
    min_speed : float
        [m/s].
    label : str
        Only rows the data set labels so ('los'); '' takes all.
    noise : DopplerNoise, optional
    reference_delay : float
        Added to the reference's times [s], to see what a wrong time stamp costs.

    Raises
    ------
    DataError
        No observations, no reference, or no row that has both.
    """
    if direction not in ("motion", "attitude"):
        raise ConfigError(f"direction: expected 'motion' or 'attitude', found {direction!r}")
    observations, reference = sequence.observations, sequence.reference
    if observations is None or reference is None:
        what = "GNSS observations" if observations is None else "reference"
        raise DataError(f"{sequence.name}: no {what}: Doppler cannot be judged")
    part = _selected(observations, systems, label)
    if not part.any():
        raise DataError(
            f"{sequence.name}: no usable Doppler of systems '{systems}'"
            + (f" labelled '{label}'" if label else ""),
            remedy="the set needs range rates with satellite states",
        )
    index = np.flatnonzero(part)
    chosen = observations.take(index)
    time, inverse = np.unique(chosen.time, return_inverse=True)
    ref_time = reference.time + reference_delay
    C_eb = reference_attitude(sequence, ref_time, time)
    pos_e, vel_e = _antenna_at(sequence, reference, ref_time, time, C_eb)
    speed = np.linalg.norm(vel_e, axis=1)
    usable = _covered(ref_time, time) & np.isfinite(vel_e).all(1)
    seen = _covered(ref_time, time) & np.isfinite(
        interpolated(time, ref_time, reference.vel_e)
    ).all(1)
    left_out = {
        "no reference velocity": int((~seen).sum()),
        "no reference attitude for the lever arm": int((seen & ~usable).sum()),
    }
    if direction == "motion":
        left_out["too slow for a direction"] = int((usable & ~(speed > min_speed)).sum())
        usable &= speed > min_speed
        with np.errstate(invalid="ignore", divide="ignore"):
            motion = ForwardMotion(vel_e / speed[:, None], np.zeros_like(vel_e), np.zeros((3, 3)))
    else:
        known = np.isfinite(C_eb).all((1, 2))
        left_out["no reference attitude"] = int((usable & ~known).sum())
        usable &= known
        motion = _attitude_motion(sequence, time, C_eb)
    if not usable.any():
        raise DataError(f"{sequence.name}: no Doppler epoch has a usable reference ({left_out})")
    keep = usable[inverse]
    chosen, pos_row = chosen.take(keep), pos_e[inverse[keep]]
    chosen = with_elevation(chosen, pos_row)
    rows = doppler_rows(chosen, pos_row, noise)
    assert len(rows) == len(chosen)
    number = np.cumsum(usable) - 1
    return Samples(
        name=sequence.name,
        time=time[usable],
        rows=DopplerRows(index[keep][rows.row], rows.sat, rows.e_e, rows.z, rows.sigma),
        epoch=number[inverse[keep]],
        motion=motion.take(usable),
        vel_e=vel_e[usable],
        cn0=chosen.cn0,
        elevation=chosen.elevation,
        azimuth=chosen.azimuth,
        left_out={reason: count for reason, count in left_out.items() if count},
    )


def _selected(observations: GnssObservations, systems: str, label: str) -> NDArray[np.bool_]:
    """Return rows with Doppler of the systems wanted, of each system's most frequent signal."""
    letter = observations.sat.astype("U1")
    part = np.zeros(len(observations), dtype=bool)
    for system in systems:
        mine = observations.has_range_rate & (letter == system)
        signals, count = np.unique(observations.signal[mine], return_counts=True)
        if signals.size:
            part |= mine & (observations.signal == signals[np.argmax(count)])
    return part & (observations.label == label) if label else part


def _covered(ref_time: FloatArray, time: FloatArray) -> NDArray[np.bool_]:
    """Return where `time` lies on the reference's epochs or between two close ones."""
    after = np.clip(np.searchsorted(ref_time, time), 1, ref_time.size - 1)
    step = ref_time[after] - ref_time[after - 1]
    inside = (time >= ref_time[0] - 1e-6) & (time <= ref_time[-1] + 1e-6)
    return inside & (step <= MAX_GAP)


def interpolated(time: FloatArray, node: FloatArray, value: FloatArray) -> FloatArray:
    """Return columns of `value` (n, m) at `node`, linearly interpolated to `time`."""
    return np.column_stack([np.interp(time, node, column) for column in value.T])


def reference_attitude(sequence: Sequence, ref_time: FloatArray, time: FloatArray) -> FloatArray:
    """Return C_eb of the reference at `time`, NaN where unknown, shape (m, 3, 3).

    Parameters
    ----------
    sequence : Sequence
        With a reference.
    ref_time : ndarray
        Times of the reference's epochs [s].
    time : ndarray, shape (m,)
        [s].
    """
    reference = sequence.reference
    assert reference is not None
    C_eb = np.full((time.size, 3, 3), np.nan)
    known = np.isfinite(reference.rpy).all(1)
    if known.sum() >= 2:
        C = C_en_of(reference.pos_e[known]) @ matrix_from_rpy(reference.rpy[known])
        if reference.attitude_frame == "v":
            C = C @ sequence.calibration.C_bv.T
        node = ref_time[known]
        inside = (time >= node[0]) & (time <= node[-1])
        turn = Slerp(node - node[0], Rotation.from_matrix(C))
        C_eb[inside] = turn(time[inside] - node[0]).as_matrix()
    return C_eb


def rate_eb_b(imu: ImuData, time: FloatArray, C_eb: FloatArray, window: float = 0.1) -> FloatArray:
    """Return ω_eb^b at `time` from the gyro, averaged over `window` [s], shape (m, 3) [rad/s]."""
    edges = np.concatenate([[imu.time[0] - imu.interval], imu.time])
    angle = np.vstack([np.zeros(3), np.cumsum(imu.gyro_b * np.diff(edges)[:, None], axis=0)])
    low, high = (np.clip(time + half, edges[0], edges[-1]) for half in (-window / 2, window / 2))
    turned = interpolated(high, edges, angle) - interpolated(low, edges, angle)
    with np.errstate(invalid="ignore", divide="ignore"):
        rate = turned / (high - low)[:, None]
    return rate - np.einsum("nji,j->ni", C_eb, OMEGA_IE_E)


def _antenna_at(
    sequence: Sequence,
    reference: Reference,
    ref_time: FloatArray,
    time: FloatArray,
    C_eb: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return position and velocity of the antenna according to the reference."""
    pos_e = interpolated(time, ref_time, reference.pos_e)
    vel_e = interpolated(time, ref_time, reference.vel_e)
    arm_b = sequence.calibration.lever_antenna_b - reference.lever_b
    if not arm_b.any() or sequence.imu is None:
        return pos_e, vel_e
    swing_b = np.cross(rate_eb_b(sequence.imu, time, C_eb), arm_b)
    return pos_e + C_eb @ arm_b, vel_e + np.einsum("nij,nj->ni", C_eb, swing_b)


def _attitude_motion(sequence: Sequence, time: FloatArray, C_eb: FloatArray) -> ForwardMotion:
    """Return direction and lever-arm velocity that the reference's attitude implies."""
    calibration = sequence.calibration
    omega = np.zeros_like(C_eb[:, 0])
    if sequence.imu is not None:
        omega = rate_eb_b(sequence.imu, time, C_eb)
    return forward_motion(
        C_eb,
        omega,
        calibration.lever_antenna_b,
        C_bv=calibration.C_bv,
        lever_vehicle_b=calibration.lever_vehicle_b,
    )
