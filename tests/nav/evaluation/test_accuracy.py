"""Evaluation: known offsets give known figures, at the right point and in the right frame."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.filters.earth import C_en_of, lla_to_ecef
from certnav.filters.errors import DataError
from certnav.filters.rotation import (
    matrix_from_rpy,
)
from certnav.nav.evaluation.accuracy import (
    METRICS,
    evaluate,
    mean_rate_b,
    normalised_nis,
    without_reference,
)
from certnav.nav.evaluation.interpolation import usable_at
from certnav.nav.solution import Epochs, Update


def shifted(solution, pos_n=(0, 0, 0), vel_n=(0, 0, 0), C_bb=None):
    """Return the solution with constant NED offsets and its body axes turned by C_bb."""
    trajectory = solution.trajectory
    C_en = C_en_of(trajectory.pos_e)
    return dataclasses.replace(
        solution,
        trajectory=dataclasses.replace(
            trajectory,
            pos_e=trajectory.pos_e + C_en @ np.array(pos_n, float),
            vel_e=trajectory.vel_e + C_en @ np.array(vel_n, float),
            C_eb=trajectory.C_eb @ (np.eye(3) if C_bb is None else C_bb),
        ),
    )


def with_reference(sequence, **changes):
    return dataclasses.replace(
        sequence, reference=dataclasses.replace(sequence.reference, **changes)
    )


def with_rows(solution, rows):
    columns = {
        f.name: getattr(solution.trajectory, f.name)[rows]
        for f in dataclasses.fields(solution.trajectory)
    }
    return dataclasses.replace(
        solution, trajectory=dataclasses.replace(solution.trajectory, **columns)
    )


def test_perfect_solution_has_no_error(drive):
    solution, sequence = drive(noise=0.0)
    metrics = evaluate(solution, sequence).metrics
    assert tuple(metrics) == METRICS
    assert max(metrics.values()) < 1e-6


def test_known_offsets_give_known_metrics(drive):
    solution, sequence = drive(noise=0.0)
    turn = matrix_from_rpy(np.deg2rad([0.3, -0.4, 2.0]))
    result = evaluate(shifted(solution, (3.0, -4.0, 2.0), (0.2, 0.1, -0.2), turn), sequence)
    m = result.metrics
    for name in ("horizontal_rms_m", "horizontal_p50_m", "horizontal_p95_m", "horizontal_max_m"):
        assert m[name] == pytest.approx(5.0, abs=1e-6)
    assert m["up_rms_m"] == pytest.approx(2.0, abs=1e-6)
    assert m["position_3d_rms_m"] == pytest.approx(np.sqrt(29.0), abs=1e-6)
    assert m["velocity_3d_rms_mps"] == pytest.approx(0.3, abs=1e-6)
    # Down is positive, a solution too far south has a negative north error.
    np.testing.assert_allclose(result.error_pos_n - [3.0, -4.0, 2.0], 0.0, atol=1e-5)
    # The turn is the same in body axes at every epoch, so it is all misalignment.
    np.testing.assert_allclose(np.rad2deg(result.misalignment_rpy), [0.3, -0.4, 2.0], atol=1e-6)
    assert m["heading_rms_deg"] == pytest.approx(2.0, abs=0.03)
    assert m["heading_rms_after_misalignment_deg"] < 1e-6
    assert m["roll_rms_after_misalignment_deg"] < 1e-6


def test_percentiles_of_a_ramp(drive):
    solution, sequence = drive(noise=0.0, duration=100.0)
    east = np.zeros((len(solution.trajectory), 3))
    east[:, 1] = np.linspace(0.0, 10.0, len(east))
    C_en = C_en_of(solution.trajectory.pos_e)
    ramp = dataclasses.replace(
        solution.trajectory, pos_e=solution.trajectory.pos_e + (C_en @ east[:, :, None])[:, :, 0]
    )
    m = evaluate(dataclasses.replace(solution, trajectory=ramp), sequence).metrics
    assert m["horizontal_p50_m"] == pytest.approx(5.0, abs=1e-6)
    assert m["horizontal_p95_m"] == pytest.approx(9.5, abs=1e-6)
    assert m["horizontal_max_m"] == pytest.approx(10.0, abs=1e-6)
    assert m["horizontal_rms_m"] == pytest.approx(10.0 / np.sqrt(3.0), rel=2e-3)


def test_compares_at_the_reference_point(drive):
    lever = (1.5, -0.7, -1.1)
    solution, sequence = drive(noise=0.0, lever_b=lever)
    metrics = evaluate(solution, sequence).metrics
    assert metrics["position_3d_rms_m"] < 1e-4
    # The gyro is averaged over 0.1 s: second-order small in the angular acceleration.
    assert metrics["velocity_3d_rms_mps"] < 1e-3

    ignored = evaluate(solution, with_reference(sequence, lever_b=np.zeros(3))).metrics
    assert ignored["position_3d_rms_m"] == pytest.approx(np.linalg.norm(lever), rel=1e-6)
    assert ignored["velocity_3d_rms_mps"] > 0.05


def test_lever_velocity_uses_the_gyro_without_its_bias(drive):
    solution, sequence = drive(noise=0.0, lever_b=(2.0, 0.0, 0.0))
    bias = np.array([0.01, -0.02, 0.03])
    biased = dataclasses.replace(
        sequence, imu=dataclasses.replace(sequence.imu, gyro_b=sequence.imu.gyro_b + bias)
    )
    known = dataclasses.replace(
        solution, trajectory=dataclasses.replace(
            solution.trajectory, gyro_bias=np.tile(bias, (len(solution.trajectory), 1))
        ),
    )  # fmt: skip
    assert evaluate(known, biased).metrics["velocity_3d_rms_mps"] < 1e-3
    # Left in, the bias is a velocity of ω × l = 0.01·…: |(0, 0.03·2, 0.02·2)|.
    wrong = evaluate(solution, biased).metrics["velocity_3d_rms_mps"]
    assert wrong == pytest.approx(2.0 * np.hypot(0.03, 0.02), rel=0.02)


def test_vehicle_frame_reference_is_compared_through_the_mounting(drive):
    C_bv = matrix_from_rpy(np.deg2rad([1.0, -3.0, 175.0]))
    solution, sequence = drive(noise=0.0, attitude_frame="v", C_bv=C_bv)
    assert evaluate(solution, sequence).metrics["heading_rms_deg"] < 1e-6
    wrong = evaluate(solution, with_reference(sequence, attitude_frame="b"))
    assert wrong.metrics["heading_rms_deg"] > 170.0


def test_heading_error_wraps(drive):
    solution, sequence = drive(noise=0.0)
    turn = matrix_from_rpy([0.0, 0.0, np.deg2rad(-1.0)])
    full_turns = sequence.reference.rpy + np.array([0.0, 0.0, 2 * np.pi])
    result = evaluate(shifted(solution, C_bb=turn), with_reference(sequence, rpy=full_turns))
    assert np.ptp(sequence.reference.rpy[:, 2]) > 6.0  # the drive does cross ±180°
    np.testing.assert_allclose(np.rad2deg(result.error_rpy[:, 2]), -1.0, atol=0.01)


def test_interpolates_between_solution_epochs(drive):
    solution, sequence = drive(noise=0.0, rate=10.0, reference_rate=7.0)
    m = evaluate(solution, sequence).metrics
    # Hermite: |p⁗| h⁴/384; linear velocity: |v̈| h²/8; both from the analytic motion.
    assert m["position_3d_rms_m"] < 1e-5
    assert m["velocity_3d_rms_mps"] < 1e-3
    assert m["heading_rms_deg"] < 0.02


def test_a_gap_is_left_out_not_interpolated(drive):
    solution, sequence = drive(noise=0.0)
    t = solution.trajectory.time - solution.trajectory.time[0]
    holed = with_rows(solution, (t < 40.0) | (t > 60.0))
    result = evaluate(holed, sequence)
    inside = result.time - sequence.reference.time[0]
    assert not ((inside > 40.0) & (inside < 60.0)).any()
    assert result.left_out == 101 and len(result.time) + 101 == len(sequence.reference)
    assert result.metrics["position_3d_rms_m"] < 1e-5


def test_no_overlap_is_one_line(drive):
    solution, sequence = drive(noise=0.0)
    late = with_reference(sequence, time=sequence.reference.time + 150.2)
    with pytest.raises(DataError, match=r"made-up: the solution .* covers no epoch") as error:
        evaluate(solution, late)
    assert "\n" not in str(error.value) and "leap seconds" in str(error.value)


def test_without_reference_every_metric_is_none(drive):
    solution, sequence = drive(reference=False)
    result = evaluate(solution, sequence)
    assert set(result.metrics.values()) == {None} and not result.has_reference
    assert result.consistency["nees_position_mean"] is None
    assert result.consistency["nis_mean"] is not None


def test_partial_reference(drive):
    solution, sequence = drive(noise=0.0)
    rpy = sequence.reference.rpy.copy()
    rpy[:, :2] = np.nan
    blind = with_reference(sequence, rpy=rpy, vel_e=np.full_like(rpy, np.nan))
    turned = shifted(solution, C_bb=matrix_from_rpy([0.0, 0.0, 0.05]))
    result = evaluate(turned, blind)
    m = result.metrics
    assert m["velocity_3d_rms_mps"] is None and m["roll_rms_deg"] is None
    assert m["heading_rms_deg"] == pytest.approx(np.rad2deg(0.05), rel=0.01)
    assert m["heading_rms_after_misalignment_deg"] < 0.01
    assert np.isnan(result.misalignment_rpy[:2]).all()


def test_nees_and_nis_of_honest_errors(drive):
    """Errors drawn from the stated covariance give NEES 3 and NIS/dof 1; doubled ones 12."""
    solution, sequence = drive(noise=0.0, duration=400.0, rate=5.0)
    rng = np.random.default_rng(8)
    A = rng.normal(size=(3, 3))
    P = A @ A.T + np.eye(3)
    C_en = C_en_of(solution.trajectory.pos_e)
    draws = rng.multivariate_normal(np.zeros(3), P, len(solution.trajectory))
    means = []
    for factor in (1.0, 2.0):
        noisy = dataclasses.replace(
            solution.trajectory,
            pos_e=solution.trajectory.pos_e + factor * (C_en @ draws[:, :, None])[:, :, 0],
            cov_pos_n=np.tile(P, (len(draws), 1, 1)),
        )
        means.append(
            evaluate(dataclasses.replace(solution, trajectory=noisy), sequence).consistency[
                "nees_position_mean"
            ]
        )
    # χ²₃ has variance 6: 3σ of the mean of 2001 independent draws.
    assert means[0] == pytest.approx(3.0, abs=3 * np.sqrt(6 / 2001))
    assert means[1] == pytest.approx(4 * means[0], rel=1e-4)


def test_nis_counts_what_passed_the_gate(drive):
    solution, sequence = drive(noise=0.0)
    updates = (
        Update(0.0, "position", (), (1.0, 1.0, 1.0), 3.0, True),
        Update(1.0, "velocity", (), (1.0, 2.0), 5.0, True),
        Update(1.5, "velocity", (), (3.0, 4.0), 25.0, False, "gate"),
        Update(1.7, "velocity", (), (3.0, 4.0), 25.0, True, "overruled"),
        Update(2.0, "position", reason="too few satellites"),
    )
    result = evaluate(dataclasses.replace(solution, updates=updates), sequence)
    assert result.consistency["nis_mean"] == pytest.approx((1.0 + 2.5) / 2)


def test_mean_rate_averages_over_its_window(drive):
    _, sequence = drive(duration=5.0)
    imu = sequence.imu
    ramp = dataclasses.replace(imu, gyro_b=np.outer(imu.time - imu.time[0], [1.0, 2.0, 0.0]))
    mid = imu.time[100]
    # Each sample is the mean over the interval that ends at its time: half a sample late.
    expected = (mid - imu.time[0] + imu.interval / 2) * np.array([1.0, 2.0, 0.0])
    np.testing.assert_allclose(mean_rate_b(ramp, np.array([mid]))[0], expected, rtol=1e-5)
    assert np.isnan(mean_rate_b(imu, imu.time[-1:] + 1.0)).all()


def test_usable_satellites_in_force():
    epochs = Epochs(np.array([10.0, 11.0, 12.0]), np.array([9, 9, 9]), np.array([8, 3, 1]))
    time = np.array([9.0, 10.0, 10.9, 11.5, 12.0, 14.5, 14.6])
    assert usable_at(epochs, time).tolist() == [0, 8, 8, 3, 1, 1, 0]
    nothing = Epochs(np.zeros(0), np.zeros(0, int), np.zeros(0, int))
    assert usable_at(nothing, time).tolist() == [-1] * 7


def test_sigma_is_that_of_the_filter_at_the_references_epochs(drive):
    solution, sequence = drive(duration=60.0)
    trajectory = solution.trajectory
    n = len(trajectory)
    sigma = {
        "cov_pos_n": (2.0, 3.0, 4.0), "cov_vel_n": (0.2, 0.3, 0.4), "cov_att_n": (0.01, 0.02, 0.05)
    }  # fmt: skip
    known = dataclasses.replace(
        trajectory, **{k: np.tile(np.diag(np.square(v)), (n, 1, 1)) for k, v in sigma.items()}
    )
    result = evaluate(dataclasses.replace(solution, trajectory=known), sequence)
    m = len(sequence.reference)
    np.testing.assert_allclose(result.sigma_pos_n, np.tile(sigma["cov_pos_n"], (m, 1)))
    np.testing.assert_allclose(result.sigma_vel_n, np.tile(sigma["cov_vel_n"], (m, 1)))
    # Nearly level: roll and pitch are the tilt seen along heading, north and east mixed.
    heading = sequence.reference.rpy[:, 2]
    roll = np.hypot(0.01 * np.cos(heading), 0.02 * np.sin(heading))
    pitch = np.hypot(0.01 * np.sin(heading), 0.02 * np.cos(heading))
    np.testing.assert_allclose(result.sigma_rpy[:, 0], roll, rtol=0.1)
    np.testing.assert_allclose(result.sigma_rpy[:, 1], pitch, rtol=0.1)
    np.testing.assert_allclose(result.sigma_rpy[:, 2], 0.05, rtol=0.03)
    expected = np.sum(np.square(result.error_pos_n / sigma["cov_pos_n"]), axis=1)
    np.testing.assert_allclose(result.nees_position, expected)
    assert result.consistency["nees_position_mean"] == pytest.approx(expected.mean())


def test_an_evaluation_says_what_it_compared_with(drive):
    solution, sequence = drive(noise=0.0, duration=30.0, lever_b=(1.0, 0.0, 0.0))
    result = evaluate(solution, sequence)
    assert result.has_reference and result.left_out == 0
    assert (result.source, result.point) == ("analytic motion", "antenna")
    np.testing.assert_array_equal(result.time, sequence.reference.time)
    np.testing.assert_allclose(lla_to_ecef(*result.ref_lla.T), sequence.reference.pos_e, atol=1e-6)
    assert not without_reference().has_reference
    bare = without_reference(1.5)
    assert bare.consistency == {"nees_position_mean": None, "nis_mean": 1.5}
    assert bare.time.shape == (0,) and bare.ref_lla.shape == (0, 3)
    assert bare.nees_position.shape == (0,) and np.isnan(bare.misalignment_rpy).all()


def test_one_common_epoch_is_a_comparison(drive):
    solution, sequence = drive(noise=0.0)
    time = sequence.reference.time
    once = with_rows(solution, np.abs(solution.trajectory.time - time[100]) < 1e-6)
    assert len(once.trajectory) == 1
    result = evaluate(once, sequence)
    assert result.has_reference and result.left_out == len(time) - 1
    assert result.metrics["horizontal_max_m"] < 1e-6


def test_how_long_a_hole_may_be(drive):
    solution, sequence = drive(noise=0.0)
    t = solution.trajectory.time - solution.trajectory.time[0]
    holed = with_rows(solution, (t < 40.05) | (t > 42.95))
    assert evaluate(holed, sequence).left_out == 14
    assert evaluate(holed, sequence, max_gap=3.1).left_out == 0


def test_an_empty_solution_covers_nothing(drive):
    solution, sequence = drive(noise=0.0)
    none = with_rows(solution, np.zeros(len(solution.trajectory), dtype=bool))
    with pytest.raises(DataError, match=r"made-up: the solution \(empty\) covers no epoch"):
        evaluate(none, sequence)
    late = with_reference(sequence, time=sequence.reference.time + 150.2)
    first, last = sequence.reference.time[[0, -1]]
    spans = (
        rf"the solution \({first:.1f}…{last:.1f} s\) covers no epoch of the reference "
        rf"\({first + 150.2:.1f}…{last + 150.2:.1f} s\)"
    )
    with pytest.raises(DataError, match=spans):
        evaluate(solution, late)


def test_a_covariance_that_is_none_has_no_nees(drive):
    solution, sequence = drive(noise=0.0, duration=20.0)
    cov = solution.trajectory.cov_pos_n.copy()
    cov[50:101] = 0.0
    flat = dataclasses.replace(
        solution, trajectory=dataclasses.replace(solution.trajectory, cov_pos_n=cov)
    )
    result = evaluate(shifted(flat, (1.0, 0.0, 0.0)), sequence)
    since = result.time - result.time[0]
    none = np.isnan(result.nees_position)
    np.testing.assert_array_equal(none, (since > 4.999) & (since < 10.001))
    assert result.consistency["nees_position_mean"] == pytest.approx(
        result.nees_position[~none].mean()
    )
    cov[:] = 0.0
    assert evaluate(flat, sequence).consistency["nees_position_mean"] is None


def test_nis_of_a_kind_alone():
    updates = [
        Update(0.0, "position", (), (1.0, 1.0), 2.0, True),
        Update(1.0, "velocity", (), (1.0, 2.0), 5.0, True),
        Update(2.0, "velocity", (), (1.0,), np.nan, True),
        Update(3.0, "velocity", (), (9.0,), 81.0, False),
    ]
    assert normalised_nis(updates, "velocity") == 2.5
    assert normalised_nis(updates, "position") == 1.0
    assert normalised_nis(updates) == 1.75
    assert normalised_nis(updates, "nhc") is None and normalised_nis([]) is None


def test_the_rate_at_the_ends_is_that_of_what_is_left(drive):
    _, sequence = drive(duration=5.0)
    imu = sequence.imu
    rate = np.where(imu.time[:, None] < imu.time[3] - 1e-6, [1.0, 0.0, 0.0], [0.0, 2.0, 0.0])
    made = dataclasses.replace(imu, gyro_b=np.tile([0.0, 0.0, 3.0], (len(imu), 1)) + rate)
    first = imu.time[0] - imu.interval
    # Three samples of the first rate and two of the second in the half window that is left.
    at = mean_rate_b(made, np.array([first]))[0]
    np.testing.assert_allclose(at, [0.6, 0.8, 3.0], atol=1e-4)
    # Of 60 ms, as asked for, one sample more of the first.
    at = mean_rate_b(made, np.array([first]), 0.06)[0]
    np.testing.assert_allclose(at, [1.0, 0.0, 3.0], atol=1e-4)
    np.testing.assert_allclose(mean_rate_b(made, imu.time[-1:])[0], [0.0, 2.0, 3.0], atol=1e-4)


def test_a_lone_epoch_stays_in_force():
    """There is no interval to say when it is too old."""
    epochs = Epochs(np.array([10.0]), np.array([9]), np.array([8]))
    time = np.array([9.9, 10.0 - 5e-7, 10.0, 1e6])
    assert usable_at(epochs, time).tolist() == [0, 8, 8, 8]
    slow = Epochs(np.array([0.0, 2.0, 4.0, 5.0]), np.full(4, 9), np.array([1, 2, 3, 4]))
    assert usable_at(slow, np.array([10.0, 10.01])).tolist() == [4, 0]
