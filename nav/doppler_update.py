"""Doppler of two and more satellites offered to the filter without a velocity fix.

'rows': every satellite difference is a measurement of the antenna's velocity; nothing is assumed
about where the vehicle points, and nothing is divided by k. 'ddia': the paper's way, eq. (20) as a
velocity along the vehicle's nose, screened by C/N0 and |SDV·RMD|.
"""

from __future__ import annotations

import numpy as np

from datasets.sequence import Calibration
from filters import measurements
from filters.ekf import ErrorStateFilter, Outcome
from filters.measurements import Measurement
from nav import ddia_update
from nav.config import GnssConfig
from nav.gnss import doppler_noise
from velocity.ddia import ddia_velocity
from velocity.range_rate import DopplerRows


def apply_rows(
    kalman: ErrorStateFilter,
    calibration: Calibration,
    rows: DopplerRows,
    gate_probability: float,
) -> tuple[Outcome, tuple[str, ...], str]:
    """Offer the differences of `rows`; leave out the satellite that does not fit, while three stay.

    Returns
    -------
    outcome : Outcome
    satellites : tuple of str
        Those used, or offered.
    reason : str
        '' or why the update was not accepted.
    """
    everyone = rows
    while True:
        outcome = kalman.test(_rows_measurement(kalman, calibration, rows), gate_probability)
        if outcome.accepted or len(rows) <= 2:
            break
        without = [np.arange(len(rows)) != k for k in range(len(rows))]
        nis = [
            kalman.test(_rows_measurement(kalman, calibration, rows.take(keep)), 0.0).nis
            for keep in without
        ]
        rows = rows.take(without[int(np.argmin(nis))])
    if not outcome.accepted:
        names = tuple(map(str, everyone.sat))
        return outcome, names, f"innovation test (NIS > {outcome.limit:.1f})"
    outcome = kalman.update(_rows_measurement(kalman, calibration, rows), gate_probability)
    return outcome, tuple(map(str, rows.sat)), ""


def _rows_measurement(
    kalman: ErrorStateFilter, calibration: Calibration, rows: DopplerRows
) -> Measurement:
    return measurements.range_rates(
        kalman.state, kalman.model.size, rows.e_e, rows.z, rows.sigma,
        calibration.lever_antenna_b, kalman.omega_b,
    )  # fmt: skip


def apply_ddia(
    kalman: ErrorStateFilter,
    calibration: Calibration,
    rows: DopplerRows,
    time: float,
    config: GnssConfig,
    gate_probability: float,
) -> tuple[Outcome | None, tuple[str, ...], str]:
    """Offer DDIA-VE's velocity; the outcome is None when there is none to offer."""
    # Rows carry σ, not C/N0; the noise model turns one threshold into the other.
    loud = rows.sigma <= float(doppler_noise(config).sigma(config.ddia_min_cn0_dbhz)) + 1e-12
    names = tuple(map(str, rows.sat))
    if loud.sum() < 2:
        return None, names, "fewer than two satellites above the C/N0 of DDIA-VE"
    motion = ddia_update.filter_motion(kalman, calibration)
    aided = ddia_velocity(rows.take(loud), motion, time, min_k=config.ddia_min_k)
    if not aided.ok:
        return None, names, aided.status
    measurement = ddia_update.measurement(
        kalman, aided, calibration,
        sigma_scale=config.velocity_sigma_scale, sigma_floor=config.velocity_sigma_floor_mps,
    )  # fmt: skip
    outcome = kalman.update(measurement, gate_probability)
    reason = "" if outcome.accepted else f"innovation test (NIS > {outcome.limit:.1f})"
    return outcome, aided.satellites, reason
