"""The smoother: never worse than the filter, honest, and the same forward run."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from certnav.datasets.simulation.sensors import fixes_from_truth, imu_measurements
from certnav.filters import measurements
from certnav.filters.compiled import rows as layout
from certnav.filters.earth import C_en_of
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ErrorModel
from certnav.filters.rotation import matrix_from_rotvec
from certnav.filters.sensors import imu_preset
from certnav.filters.smoother import separation, smooth
from certnav.filters.strapdown import InertialStream, NavState

SPEC = dataclasses.replace(
    imu_preset("adis16470"), gyro_bias_turn_on_degph=50.0, accel_bias_turn_on_mg=2.0
)
LEVER = np.array([-0.65, -0.05, -0.15])


def run(
    trajectory, seed, smoothing=True, outage=(40, 70), duration=110.0, states=15, interval=0.5
):  # fmt: skip
    """Filter with a spell without GNSS; return the filter."""
    rng = np.random.default_rng([11, seed])
    start = trajectory.span[0] + 30.0
    time = start + np.arange(1, int(duration * 50)) / 50.0
    imu, _, _ = imu_measurements(trajectory, time, SPEC, rng)
    fixes = fixes_from_truth(
        trajectory, start + np.arange(1.0, duration - 1.0) + 0.0071, LEVER, 1.0, 0.1, rng
    )
    model = ErrorModel(SPEC, states)
    k = trajectory.kinematics(np.array([start]))
    C_bn = k.C_eb[0].T @ C_en_of(k.pos_e[0])
    tilt = C_bn @ np.diag(np.radians([0.5, 0.5, 2.0]) ** 2) @ C_bn.T
    P = model.initial_covariance(np.eye(3), np.eye(3) * 0.01, tilt)
    error = np.linalg.cholesky(P[:9, :9]) @ rng.standard_normal(9)
    state = NavState(
        start, k.pos_e[0] - error[:3], k.vel_e[0] - error[3:6],
        k.C_eb[0] @ matrix_from_rotvec(error[6:9]).T,
    )  # fmt: skip
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    kalman = ErrorStateFilter(model, stream, state, P, interval, smoothing=smoothing)
    for i, t in enumerate(fixes.time):
        if outage[0] <= i < outage[1]:
            continue
        kalman.propagate(t)
        n = model.size
        m = measurements.position(kalman.state, n, fixes.pos_e[i], fixes.pos_cov_e[i], LEVER)
        kalman.update(m)
        m = measurements.velocity(
            kalman.state, n, fixes.vel_e[i], fixes.vel_cov_e[i], LEVER, kalman.omega_b
        )
        kalman.update(m)
    kalman.propagate(stream.end)
    return kalman


def test_every_sample_can_be_recorded(city_drive):
    """An interval of 0, the default, is that of the samples."""
    each, even = (
        run(city_drive, 1, outage=(0, 0), duration=12.0, interval=interval)
        for interval in (0.0, 0.02)
    )
    smoothed = smooth(each.tape, each.P)
    assert len(smoothed) == len(each.rows) >= len(even.rows) > 500
    at = np.searchsorted(smoothed[:, 0], even.rows[:, 0] - 1e-6)
    assert np.abs(smoothed[at] - smooth(even.tape, even.P))[:, 1:4].max() < 1e-6


def position_covariance(rows):
    cov = np.empty((len(rows), 3, 3))
    i, j = np.triu_indices(3)
    cov[:, i, j] = cov[:, j, i] = rows[:, layout.ROW_COV : layout.ROW_COV + 6]
    return cov


def position_error(rows, trajectory):
    return trajectory.pos_e(rows[:, 0]) - rows[:, 1:4]


@pytest.mark.parametrize("states", [15, 21])
def test_taping_does_not_change_the_filter(city_drive, states):
    plain, taped = (run(city_drive, 1, s, states=states) for s in (False, True))
    np.testing.assert_allclose(taped.rows[:, 0], plain.rows[:, 0], atol=1e-9)
    np.testing.assert_allclose(taped.rows[:, 1:7], plain.rows[:, 1:7], atol=1e-6)
    sigma = np.sqrt(np.diag(plain.P))
    np.testing.assert_allclose((taped.P - plain.P) / np.outer(sigma, sigma), 0.0, atol=1e-6)


def test_it_ends_where_the_filter_ends_and_is_never_worse(city_drive):
    kalman = run(city_drive, 2)
    rows = smooth(kalman.tape, kalman.P)
    np.testing.assert_allclose(rows[:, 0], kalman.rows[:, 0])
    np.testing.assert_allclose(rows[-1, 1:16], kalman.rows[-1, 1:16], atol=1e-6)
    filtered = np.trace(position_covariance(kalman.rows), axis1=1, axis2=2)
    smoothed = np.trace(position_covariance(rows), axis1=1, axis2=2)
    assert np.all(smoothed <= filtered * (1 + 1e-9))
    C = rows[:, 7:16].reshape(-1, 3, 3)
    np.testing.assert_allclose(
        C @ np.swapaxes(C, 1, 2), np.tile(np.eye(3), (len(C), 1, 1)), atol=1e-9
    )


def test_a_spell_without_gnss_is_bridged_from_both_ends(city_drive):
    ratios = []
    for seed in range(6):
        kalman = run(city_drive, seed)
        rows = smooth(kalman.tape, kalman.P)
        spell = (rows[:, 0] > kalman.rows[0, 0] + 41.0) & (rows[:, 0] < kalman.rows[0, 0] + 70.5)
        drift = [
            np.linalg.norm(position_error(r, city_drive)[spell], axis=1).max()
            for r in (kalman.rows, rows)
        ]
        ratios.append(drift[0] / drift[1])
    assert np.median(ratios) > 5.0


def test_velocity_and_attitude_are_corrected_too(city_drive):
    """In a spell without GNSS they are nearer to the truth than the filter's, and go together."""
    worse = []
    for seed in range(4):
        kalman = run(city_drive, seed)
        smoothed = smooth(kalman.tape, kalman.P)
        since = smoothed[:, 0] - smoothed[0, 0]
        spell = (since > 50.0) & (since < 70.0)
        truth = city_drive.kinematics(smoothed[spell, 0])
        errors = []
        for rows in (kalman.rows[spell], smoothed[spell]):
            turn = np.swapaxes(truth.C_eb, 1, 2) @ rows[:, 7:16].reshape(-1, 3, 3)
            phi = np.stack([turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]], axis=1)
            errors.append([rms(rows[:, 4:7] - truth.vel_e), rms(phi)])
        worse.append(np.array(errors[1]) / errors[0])
        # One motion: what the position gains in a step is the velocity it is given.
        step = np.diff(smoothed[spell, 0])[:, None]
        moved = np.diff(smoothed[spell, 1:4], axis=0) / step
        mean = 0.5 * (smoothed[spell][1:, 4:7] + smoothed[spell][:-1, 4:7])
        assert np.abs(moved - mean).max() < 0.25
    assert np.all(np.median(worse, axis=0) < [0.5, 1.0]), worse


def rms(error):
    return float(np.sqrt(np.mean(np.sum(error**2, axis=1))))


def test_smoothed_covariance_is_honest(city_drive):
    """Mean position NEES over 30 seeds stays inside the 95 % bounds of χ²."""
    runs, nees = 30, []
    for seed in range(runs):
        kalman = run(city_drive, seed)
        rows = smooth(kalman.tape, kalman.P)
        error, cov = position_error(rows, city_drive), position_covariance(rows)
        nees.append(np.einsum("ki,ki->k", error, np.linalg.solve(cov, error[..., None])[..., 0]))
    mean = np.mean(nees, axis=0)
    low, high = chi2.ppf([0.025, 0.975], 3 * runs) / runs
    assert low < mean.mean() < high
    assert ((mean > low) & (mean < high)).mean() > 0.85


def test_forward_and_backward_are_apart_by_what_their_covariances_say(city_drive):
    """White errors of known σ: χ² of what is between them is 3 on the average, its mean zero."""
    runs, chi, apart = 30, [], []
    for seed in range(runs):
        kalman = run(city_drive, seed)
        found = separation(kalman.tape, smooth(kalman.tape, kalman.P))
        known = np.isfinite(found.chi2)
        assert 0.7 < known.mean() < 1.0  # at the end there are no later data
        assert not known[-1]
        assert (np.isfinite(found.backward_e).all(axis=1) == known).all()
        chi.append(found.chi2)
        apart.append(found.backward_e - found.forward_e)
    low, high = chi2.ppf([0.025, 0.975], 3 * runs) / runs
    assert low < np.nanmean(chi) < high
    apart = np.array(apart)
    known = np.isfinite(apart).all(axis=(0, 2))
    spread = apart[:, known].std(axis=0) / np.sqrt(runs)
    assert np.abs((apart[:, known].mean(axis=0) / spread).mean(axis=0)).max() < 1.0


def test_combined_is_the_weighted_mean_of_forward_and_backward(city_drive):
    """Backward has the information that is missing to the combined one, and nothing else."""
    kalman = run(city_drive, 3)
    rows = smooth(kalman.tape, kalman.P)
    found = separation(kalman.tape, rows)
    known = np.isfinite(found.chi2)
    forward = np.array([e[0] for e in kalman.tape.entries if len(e) == 2])[known]
    both, one = (np.linalg.inv(position_covariance(r)) for r in (rows[known], forward))
    other = both - one
    pull = one @ found.forward_e[known][..., None] + other @ found.backward_e[known][..., None]
    size = np.linalg.norm(one @ found.forward_e[known][..., None], axis=1)
    assert np.abs(pull).max() < 1e-5 * size.max()
    # χ² from its definition: what is between the two over the sum of their covariances.
    between = (found.backward_e - found.forward_e)[known]
    total = np.linalg.inv(one) + np.linalg.inv(other)
    expected = np.einsum("ki,ki->k", between, np.linalg.solve(total, between[..., None])[..., 0])
    np.testing.assert_allclose(found.chi2[known], expected, rtol=1e-4)
    # In the spell without GNSS the later data pull the filter back.
    since = found.time - found.time[0]
    spell = (since > 60.0) & (since < 70.0)
    worst = np.linalg.norm(found.forward_e[spell], axis=1).max()
    assert worst > 3.0 * np.linalg.norm(found.forward_e[(since > 20) & (since < 40)], axis=1).max()
