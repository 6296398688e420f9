"""Range rates as a receiver counts them → `doppler_rows` → `AlignmentRows`: one sign convention."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.alignment.problem import build_problem
from certnav.alignment.reference.certifiable import align_sdp
from certnav.alignment.rows import AlignmentRows
from certnav.alignment.solver.refinement import rotation_angle
from certnav.alignment.status import AlignmentStatus
from certnav.datasets.observations import GnssObservations
from certnav.filters.earth import SPEED_OF_LIGHT, C_en_of, lla_to_ecef
from certnav.velocity.range_rate import doppler_rows, predicted_range_rate

ANTENNA = lla_to_ecef(np.radians(52.5), np.radians(13.4), 60.0)
DRIFT = -37.5  # cδṫ of the receiver [m/s]


@pytest.fixture
def rows_and_truth(rng):
    """Five satellites, twenty seconds through a bend and over a crest, exact range rates."""
    epochs, n = 20, 5
    C_en = C_en_of(ANTENNA)
    course = np.linspace(0.3, 2.5, epochs)
    climb = 1.5 * np.sin(np.linspace(0.0, 5.0, epochs))
    vel_n = np.column_stack([12.0 * np.cos(course), 12.0 * np.sin(course), climb])
    vel_e = vel_n @ C_en.T
    azimuth, elevation = np.array([0.2, 1.4, 2.9, 4.1, 5.3]), np.array([0.4, 0.9, 0.6, 1.2, 0.3])
    level = np.cos(elevation)
    sight = np.column_stack([level * np.cos(azimuth), level * np.sin(azimuth), -np.sin(elevation)])
    sat_pos = np.tile(ANTENNA + 2.3e7 * sight @ C_en.T, (epochs, 1))
    sat_vel = np.tile(rng.normal(scale=2500.0, size=(n, 3)), (epochs, 1))
    epoch, zero, nan = (
        np.repeat(np.arange(epochs), n),
        np.zeros(n * epochs),
        np.full(n * epochs, np.nan),
    )
    rates = predicted_range_rate(ANTENNA, vel_e[epoch], DRIFT, sat_pos, sat_vel, zero)
    observations = GnssObservations(
        time=epoch.astype(float), sat=np.tile([f"G{k + 1:02d}" for k in range(n)], epochs),
        signal=np.full(n * epochs, "1C"),
        wavelength=np.full(n * epochs, SPEED_OF_LIGHT / 1.57542e9),
        pseudorange=nan, carrier=nan, range_rate=rates, cn0=nan,
        loss_of_lock=np.zeros(n * epochs, dtype=int), sat_pos_e=sat_pos, sat_vel_e=sat_vel,
        sat_clock=zero, sat_clock_drift=zero, elevation=nan, azimuth=nan,
        rejected=np.full(n * epochs, ""),
    )  # fmt: skip
    doppler = doppler_rows(observations, ANTENNA)
    C_ew = Rotation.random(rng=rng).as_matrix()
    time = observations.time[doppler.row]
    return AlignmentRows.paired(doppler, time, (vel_e @ C_ew)[epoch[doppler.row]]), C_ew


def test_exact_range_rates_give_the_exact_rotation_and_clock(rows_and_truth):
    rows, C_ew = rows_and_truth
    result = align_sdp(build_problem(rows))
    assert result.status is AlignmentStatus.CERTIFIED
    assert np.degrees(rotation_angle(result.C_ew, C_ew)) < 1e-6
    assert result.nuisance[0] == pytest.approx(DRIFT, abs=1e-6)
    assert result.cost < 1e-9


def test_the_opposite_line_of_sight_does_not_fit(rows_and_truth):
    # n = −e with z left as it is asks for −C, a reflection; the best rotation is certified all
    # the same, and only its misfit gives it away.
    rows, _ = rows_and_truth
    wrong = AlignmentRows(-rows.e_e, rows.vel_w, rows.z, rows.sigma, rows.epoch, rows.time)
    result = align_sdp(build_problem(wrong))
    assert result.cost / result.dof > 10.0
