"""What a start knows becomes the filter's state and covariance, in the filter's axes."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from certnav.alignment.levelling import InitialAttitude
from certnav.filters.error_model import ACCEL_BIAS, ATT, GYRO_BIAS, POS, VEL, ErrorModel
from certnav.filters.levers import AntennaPrior, VehiclePrior
from certnav.filters.rotation import matrix_from_rpy
from certnav.filters.strapdown import NavState
from certnav.nav.config import FilterConfig
from certnav.nav.engine.events import GnssEvent
from certnav.nav.engine.legs import told
from certnav.nav.engine.start.state import Start, start_filter
from oracles import rigs

C_EB = rigs.C_EN @ matrix_from_rpy([0.1, -0.2, 1.0])
STREAM = rigs.stream_at_rest(C_EB, 4.0)
MODEL = ErrorModel(rigs.IMU)


def start(sigma_gyro_bias=None, method="level+course", **more):
    attitude = InitialAttitude(
        1.0, C_EB, C_EB @ np.diag([1e-4, 4e-4, 9e-4]) @ C_EB.T, 0.03,
        np.array([1e-3, -2e-3, 3e-3]), sigma_gyro_bias, method, "as it was",
    )  # fmt: skip
    state = NavState(1.0, rigs.PLACE, np.array([1.0, 2.0, 3.0]), C_EB)
    cov = np.diag([4.0, 5.0, 6.0]), np.diag([0.1, 0.2, 0.3])
    return Start(attitude, state, *cov, **more)


def filter_of(start, model=MODEL, **config):
    return start_filter(start, STREAM, rigs.calibration(), model, FilterConfig(**config))


def test_the_attitudes_covariance_is_turned_into_body_axes():
    kalman = filter_of(start())
    np.testing.assert_allclose(kalman.P[ATT, ATT], np.diag([1e-4, 4e-4, 9e-4]), atol=1e-12)
    np.testing.assert_allclose(kalman.P[POS, POS], np.diag([4.0, 5.0, 6.0]))
    np.testing.assert_allclose(kalman.P[VEL, VEL], np.diag([0.1, 0.2, 0.3]))
    assert kalman.time == 1.0
    np.testing.assert_array_equal(kalman.vel_e, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(kalman.gyro_bias, [1e-3, -2e-3, 3e-3])


def test_a_lever_arm_that_is_not_known_is_a_position_that_is_not():
    """And so is a time: with the lever known the position is as good as the antenna's."""
    prior = AntennaPrior(sigma_lever=3.0, sigma_delay=0.1)
    kalman = filter_of(start(), dataclasses.replace(MODEL, gnss_antenna=prior))
    fix, v = np.diag([4.0, 5.0, 6.0]), kalman.vel_e
    late = 0.01 * np.outer(v, v)
    np.testing.assert_allclose(kalman.P[POS, POS], fix + 9.0 * np.eye(3) + late)
    states = np.r_[kalman.model.antenna, kalman.model.delay]
    across = kalman.P[POS][:, states]
    known = kalman.P[POS, POS] - across @ np.linalg.inv(kalman.P[np.ix_(states, states)]) @ across.T
    np.testing.assert_allclose(known, fix, atol=1e-12)


def test_what_is_wrong_with_the_first_position_is_wrong_with_the_next():
    """With the error it shares known, the position is as good as what is its own."""
    cov, part = np.diag([4.0, 5.0, 6.0]), np.diag([1.0, 4.0, 5.5])
    model = ErrorModel(rigs.IMU, fix_correlation=10.0)
    fix = GnssEvent(1.0, "position", rigs.PLACE, cov, shared=True, shared_cov_e=part)
    P = filter_of(start(fix=fix), model=model).P
    b = model.fix_bias
    np.testing.assert_allclose(P[b, b], np.eye(3))
    np.testing.assert_allclose(P[POS, POS] - P[POS, b] @ P[b, POS], cov - part, atol=1e-12)
    assert (np.diag(P[POS, b]) < 0.0).all()  # estimated too far: true − estimated is below 0
    own = GnssEvent(1.0, "position", rigs.PLACE, cov)
    for alone in (own, None):
        assert not filter_of(start(fix=alone), model=model).P[POS, b].any()


def test_a_standstill_tells_the_gyro_bias_else_its_turn_on_spread_holds():
    kalman = filter_of(start(sigma_gyro_bias=2e-4))
    np.testing.assert_allclose(kalman.P[GYRO_BIAS, GYRO_BIAS], 4e-8 * np.eye(3))
    spread = rigs.IMU.gyro_bias_initial_sigma**2 + rigs.IMU.gyro_bias_sigma**2
    kalman = filter_of(start())
    np.testing.assert_allclose(kalman.P[GYRO_BIAS, GYRO_BIAS], spread * np.eye(3))


def test_a_window_that_was_certified_hands_on_its_correlations():
    A = np.random.default_rng(0).normal(size=(12, 12))
    joint = A @ A.T
    made = start(sigma_gyro_bias=2e-4, joint_cov=joint, accel_bias=np.array([0.1, 0.2, 0.3]))
    kalman = filter_of(made)
    rows = np.r_[6:9, 3:6, 9:15]  # attitude, velocity, gyro bias, accelerometer bias
    np.testing.assert_array_equal(kalman.P[np.ix_(rows, rows)], joint)
    np.testing.assert_allclose(kalman.P[POS, POS], np.diag([4.0, 5.0, 6.0]))
    assert not kalman.P[POS, ATT].any() and kalman.P[ACCEL_BIAS, GYRO_BIAS].any()
    np.testing.assert_array_equal(kalman.accel_bias, [0.1, 0.2, 0.3])


@pytest.mark.parametrize(("rate", "rows"), [(10.0, 31), (2.0, 7), (0.0, 301)])
def test_rows_are_recorded_at_the_output_rate(rate, rows):
    kalman = filter_of(start(), output_rate_hz=rate)
    kalman.propagate(4.0)
    assert len(kalman.rows) == rows and kalman.tape is None
    assert filter_of(start(), smooth=True).tape is not None


def test_the_report_says_how_it_was_found():
    report = start().report(began=0.25)
    assert (report.status, report.method, report.time) == ("aligned", "level+course", 1.0)
    assert report.waited == 0.75 and report.sigma_heading == 0.03
    assert report.message == "as it was" and report.bound is None and report.verdicts == ()
    assert start(method="given").report(0.0).status == "given"
    tried = start(attempts=((1.0, "no"), (2.0, "yes")))
    assert tried.report(0.0).attempts == ((1.0, "no"), (2.0, "yes"))


@pytest.mark.parametrize("method", ["level+course", "given", "certified"])
def test_a_heading_by_course_is_as_uncertain_as_the_mounting(method):
    """And goes with it: the vehicle's own heading, φ_v = C_bvᵀ φ + μ, is known as before."""
    C_bv = matrix_from_rpy([0.02, -0.05, 0.3])
    model = ErrorModel(rigs.IMU, vehicle=VehiclePrior(0.1, 2.0))
    calibration = rigs.calibration(C_bv=C_bv)
    P = start_filter(start(method=method), STREAM, calibration, model, FilterConfig()).P
    down_b, yaw = C_bv[:, 2], model.mounting.start + 1
    own = down_b @ np.diag([1e-4, 4e-4, 9e-4]) @ down_b
    by_course = method == "level+course"
    assert down_b @ P[ATT, ATT] @ down_b == pytest.approx(own + 0.01 * by_course)
    h = np.zeros(model.size)
    h[ATT], h[yaw] = down_b, 1.0
    assert h @ P @ h == pytest.approx(own + 0.01 * (not by_course))


def test_what_was_open_about_a_start_is_a_doubt_of_the_run():
    def leg(doubt):
        start = SimpleNamespace(doubt=doubt, state=SimpleNamespace(time=1.29e9))
        return SimpleNamespace(lost="", start=start)

    assert told([leg("")], 1.3e9, "") == ("ok", [])
    status, (note,) = told([leg("nose or tail?")], 1.3e9, "")
    assert status == "ok" and note.doubtful and note.text.endswith(": nose or tail?")
