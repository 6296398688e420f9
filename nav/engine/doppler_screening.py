"""Which Doppler to believe: every satellite held against the filter, whatever the count.

Decided against the filter's own velocity and clock: between houses several reflected signals may
agree with each other. One that is refused is not believed again for a while, or it would be as
soon as the filter, starved, has become modest enough.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...datasets.sequence import Calibration
from ...filters import measurements
from ...filters.ekf import ErrorStateFilter
from ...filters.gnss_states import CLOCK_DRIFT_SIGMA
from ...filters.measurement_update import gate_limit
from ...filters.measurements import Measurement
from ...filters.rotation import FloatArray
from ...velocity.aided_screening import agreeing
from ...velocity.range_rate import DopplerRows

#: Probability with which satellites on hold are kept there though they are right: 3σ of one.
_AGAIN = 0.0027


class DopplerScreening:
    """Says which satellites of an epoch agree with the filter, and remembers which did not.

    Parameters
    ----------
    hold_off : float
        How long a satellite that disagreed is not believed [s].
    significance : float
        Probability that the test accuses fault-free rows.
    """

    def __init__(self, hold_off: float, significance: float) -> None:
        self.hold_off, self.significance = hold_off, significance
        self._until: dict[str, float] = {}

    def held(self, rows: DopplerRows, time: float) -> NDArray[np.bool_]:
        """Return which rows belong to satellites that are not believed at `time`."""
        return np.array([self._until.get(s, -np.inf) > time for s in rows.sat.tolist()], dtype=bool)

    def forget(self) -> None:
        """Believe every satellite again."""
        self._until.clear()

    def test(
        self,
        kalman: ErrorStateFilter,
        calibration: Calibration,
        rows: DopplerRows,
        time: float,
        antenna: Measurement | None = None,
    ) -> NDArray[np.bool_]:
        """Return which rows to use; the others are held off from now on.

        `antenna` is `antenna_motion` of the filter as it is, where that is known already.

        A satellite on hold is tested too, after the others: while it disagrees with them, its
        time does not run. Where there are no others, those on hold are held against the filter all
        together: some of them may fit by where they stand in the sky.
        """
        held = self.held(rows, time)
        antenna = antenna_motion(kalman, calibration) if antenna is None else antenna
        all_H, all_z, P = _linear(kalman, antenna, rows)
        H, z = all_H[~held], all_z[~held]
        keep = agreeing(H, z, P, self.significance) if z.size else np.zeros(0, dtype=bool)
        if z.size >= 3 and 2 * keep.sum() < z.size:
            # All of them at once: it may be the receiver's clock that has jumped.
            free = _without_clock(P)
            again = agreeing(H, z, free, self.significance)
            if 2 * again.sum() > z.size and again.sum() >= 3:
                kalman.reconsider(*kalman.gnss.clock_forgotten(kalman.P))
                keep = again
                P = free
        used = np.zeros(len(rows), dtype=bool)
        used[np.flatnonzero(~held)[keep]] = True
        for sat in rows.sat[~held][~keep].tolist():
            self._until[sat] = time + self.hold_off
        if held.any():
            after = _posterior(H[keep], P)
            x = after @ H[keep].T @ z[keep]
            H, z = all_H[held], all_z[held]
            off, S = z - H @ x, H @ after @ H.T + np.eye(len(z))
            if keep.any():
                wrong = off**2 > 9.0 * np.diag(S)
            else:
                wrong = np.full(len(z), off @ np.linalg.solve(S, off) > gate_limit(len(z), _AGAIN))
            for sat in rows.sat[held][wrong].tolist():
                self._until[sat] = time + self.hold_off
        return used


def antenna_motion(kalman: ErrorStateFilter, calibration: Calibration) -> Measurement:
    """Return what the filter says of the antenna's velocity: −z, and its derivative H."""
    n, point = kalman.model.size, kalman.antenna_point(calibration.lever_antenna_b)
    return measurements.velocity(kalman.state, n, np.zeros(3), np.eye(3), point, kalman.omega_b)


def _linear(
    kalman: ErrorStateFilter, antenna: Measurement, rows: DopplerRows
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return whitened rows in antenna velocity and clock drift: H (n, 4), z (n,) and P (4, 4)."""
    predicted = -antenna.z
    clock = kalman.model.clock
    J = np.zeros((4, kalman.model.size))
    J[:3] = antenna.H
    if clock is not None:
        J[3, clock] = 1.0
    P = J @ kalman.P @ J.T
    if clock is None:
        P = _without_clock(P)
    H = np.empty((len(rows), 4))
    H[:, :3], H[:, 3] = rows.e_e, -1.0
    H /= rows.sigma[:, None]
    z = (rows.z - rows.e_e @ predicted + kalman.gnss.clock_drift) / rows.sigma
    return H, z, P


def _without_clock(P: FloatArray) -> FloatArray:
    out = P.copy()
    out[3], out[:, 3] = 0.0, 0.0
    out[3, 3] = CLOCK_DRIFT_SIGMA**2
    return out


def _posterior(H: FloatArray, P: FloatArray) -> FloatArray:
    return P - P @ H.T @ np.linalg.solve(H @ P @ H.T + np.eye(len(H)), H @ P)
