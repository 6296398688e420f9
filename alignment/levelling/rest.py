"""Standstills: where the IMU was quiet, and GNSS says that the vehicle stood."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...filters.rotation import FloatArray
from ...filters.sensors import ImuSpec
from ...filters.standstill import is_quiet, own_spread
from ...filters.strapdown import InertialStream
from .attitude import VelocityTrack
from .level import LEVEL_WINDOW, carry_from_rest

#: Shortest standstill that counts as one [s].
SHORTEST_REST = 2.0
#: The same where GNSS was silent [s]: steady braking is quiet, but shorter.
SHORTEST_UNSEEN = 3.0
#: Time over which spread and mean are taken, to find one [s].
_BLOCK = 1.0
#: GNSS speed above which the vehicle is certainly moving [m/s].
REST_SPEED = 0.5
#: Change of the blocks' means, per axis, within a quiet stretch.
_DRIFT_GYRO, _DRIFT_ACCEL = np.radians(0.2), 0.08
#: Error of the speed gained since a standstill, per second: half of 10 mg.
_DOUBT_ACCEL = 0.05
#: A wrong level, from a bend taken for a standstill, makes any speed in more than this [s].
_LONG_AGO = 15.0


def rest_before(
    stream: InertialStream, track: VelocityTrack, k: int, imu: ImuSpec, C_bv: FloatArray
) -> tuple[float, float] | None:
    """Return begin and end of the last standstill before epoch k.

    The IMU says when it was quiet. Steady driving is quiet as well: that the vehicle stood is for
    GNSS to say, by a velocity then or, where it was silent, by the first one after.
    """
    for start, stop in _quiet_stretches(stream, float(track.time[k]), imu):
        within = (track.time >= start) & (track.time <= stop)
        if within.any():
            speed = np.linalg.norm(track.vel_e[within], axis=1)
            stood = bool(np.all(speed <= np.maximum(REST_SPEED, 3.0 * track.sigma[within])))
        else:
            long = stop - start >= SHORTEST_UNSEEN - 1e-6
            stood = long and _gained_all_its_speed(stream, track, (start, stop), C_bv)
        if stood:
            return start, stop
    return None


def _quiet_stretches(
    stream: InertialStream, until: float, imu: ImuSpec
) -> Iterator[tuple[float, float]]:
    """Yield begin and end of quiet stretches before a time, the last first.

    Quiet is judged by the IMU alone, second by second.
    """
    last = int(np.searchsorted(stream.edges, until)) - 1
    dt = float(np.median(np.diff(stream.edges[: last + 1]))) if last > 1 else np.inf
    n = max(round(_BLOCK / dt), 2)
    blocks = last // n
    if blocks < 1:
        return
    gyro = stream.gyro[: blocks * n].reshape(blocks, n, 3)
    accel = stream.accel[: blocks * n].reshape(blocks, n, 3)
    own_gyro, own_accel = own_spread(imu, dt)
    quiet = is_quiet(gyro, accel, imu, dt, 3.0)
    # The noise of a block's mean on top of what may drift.
    limit_gyro = _DRIFT_GYRO + 6.0 * own_gyro / np.sqrt(n)
    limit_accel = _DRIFT_ACCEL + 6.0 * own_accel / np.sqrt(n)
    edge = stream.edges[np.arange(blocks + 1) * n]
    mean_gyro, mean_accel = gyro.mean(axis=1), accel.mean(axis=1)
    end = blocks - 1
    while end >= 0:
        if not quiet[end]:
            end -= 1
            continue
        first = end
        while (
            first > 0
            and quiet[first - 1]
            and edge[end + 1] - edge[first - 1] <= LEVEL_WINDOW
            and np.all(np.abs(mean_gyro[first - 1] - mean_gyro[end]) < limit_gyro)
            and np.all(np.abs(mean_accel[first - 1] - mean_accel[end]) < limit_accel)
        ):
            first -= 1
        if edge[end + 1] - edge[first] >= SHORTEST_REST - 1e-6:
            yield float(edge[first]), float(edge[end + 1])
        end = first - 1


def _gained_all_its_speed(
    stream: InertialStream, track: VelocityTrack, rest: tuple[float, float], C_bv: FloatArray
) -> bool:
    """Tell if the first velocity after a quiet stretch is what the accelerometers added since.

    After a standstill it is; after steady driving it lacks the speed that was there before. Where
    it is long ago, or slow now, the accelerometers cannot tell.
    """
    after = np.flatnonzero(track.time > rest[1])
    if not after.size or track.time[after[0]] > min(stream.end, rest[1] + _LONG_AGO):
        return False
    j = int(after[0])
    speed = float(np.linalg.norm(track.vel_e[j]))
    *_, elapsed, gained = carry_from_rest(stream, rest, float(track.time[j]), C_bv)
    doubt = REST_SPEED + 3.0 * float(track.sigma[j]) + _DOUBT_ACCEL * elapsed
    return abs(gained - speed) < doubt < max(0.5 * speed, 2.0 * REST_SPEED)
