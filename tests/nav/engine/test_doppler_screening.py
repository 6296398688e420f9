"""Majorities and thresholds of the screening: when the clock is blamed, and when a satellite."""

import numpy as np
import pytest

from certnav.filters.error_model import ATT, GYRO_BIAS, VEL
from certnav.nav.engine.doppler_screening import DopplerScreening
from certnav.velocity.range_rate import doppler_rows
from oracles import rigs

CALIBRATION = rigs.calibration()
JUMP = 40.0


def rows(names=rigs.NAMES, **sky):
    return doppler_rows(rigs.sky(tuple(names), **sky), rigs.PLACE)


def knowing(velocity=0.05, **more):
    return rigs.filter_at_rest(sigma=(1.0, velocity, 1e-3), clock_walk=0.1, **more)


def screened(kalman, observed, hold=1.5, time=0.0, screening=None, calibration=CALIBRATION):
    return (screening or DopplerScreening(hold, 1e-4)).test(kalman, calibration, observed, time)


def sigma_clock(kalman):
    return np.sqrt(kalman.P[kalman.model.clock, kalman.model.clock])


@pytest.mark.parametrize(("count", "forgotten"), [(8, True), (3, True), (2, False), (1, False)])
def test_it_takes_three_to_blame_the_clock(count, forgotten):
    kalman = knowing()
    used = screened(kalman, rows(rigs.NAMES[:count], drift=rigs.DRIFT + JUMP))
    assert used.sum() == (count if forgotten else 0)
    assert (sigma_clock(kalman) == pytest.approx(1000.0)) == forgotten


@pytest.mark.parametrize(("count", "wrong", "forgotten"), [
    (5, 1, True), (5, 3, False), (4, 1, True), (4, 2, False), (8, 3, True),
])  # fmt: skip
def test_a_majority_must_agree_on_the_jump(count, wrong, forgotten):
    """Of those that do not agree with it each is wrong in its own way."""
    kalman = knowing()
    names = rigs.NAMES[:count]
    bias = {name: 25.0 * (-1.7) ** k for k, name in enumerate(names[:wrong])}
    used = screened(kalman, rows(names, drift=rigs.DRIFT + JUMP, bias=bias))
    assert used.tolist() == [forgotten and name not in bias for name in names]
    assert (sigma_clock(kalman) > 100.0) == forgotten


def test_a_minority_that_agrees_with_the_old_drift_does_not_hold_the_clock():
    """Two of five, by chance; the other three agree with each other."""
    kalman = knowing()
    bias = dict.fromkeys(rigs.NAMES[:2], -JUMP)
    used = screened(kalman, rows(rigs.NAMES[:5], drift=rigs.DRIFT + JUMP, bias=bias))
    assert used.tolist() == [False, False, True, True, True]
    assert sigma_clock(kalman) == pytest.approx(1000.0)


def test_where_half_agrees_the_clock_is_right():
    kalman = knowing()
    bias = dict.fromkeys(rigs.NAMES[:4], JUMP)
    used = screened(kalman, rows(bias=bias))
    assert used.tolist() == [False] * 4 + [True] * 4
    assert sigma_clock(kalman) == pytest.approx(0.1)


def test_the_filters_own_doubt_counts():
    """A velocity error of 3 m/s is nothing to a filter that knows it to 3 m/s."""
    moving = rows(vel_e=3.0 * rigs.C_EN[:, 1])
    assert screened(knowing(velocity=3.0), moving).all()
    assert not screened(knowing(), moving).all()


def test_without_a_clock_state_every_drift_is_possible():
    kalman = rigs.filter_at_rest(sigma=(1.0, 0.05, 1e-3))
    assert screened(kalman, rows(drift=500.0)).all()
    used = screened(kalman, rows(drift=500.0, bias={"G03": 3.0}))
    assert used.tolist() == [name != "G03" for name in rigs.NAMES]


def test_it_is_the_antennas_velocity_that_is_tested():
    """Lever 2 m, 0.5 rad/s: 1 m/s; and the attitude's and the gyros' share of its doubt."""
    lever = np.array([2.0, 0.0, 0.0])
    calibration = rigs.calibration(lever)
    kalman = knowing()
    kalman.omega_b = np.array([0.0, 0.0, 0.5]) + kalman.C_eb.T @ [0.0, 0.0, 7.292115e-5]
    swing = kalman.C_eb @ [0.0, 1.0, 0.0]
    assert screened(kalman, rows(vel_e=swing), calibration=calibration).all()
    assert not screened(kalman, rows(), calibration=calibration).all()
    kalman.P[GYRO_BIAS, GYRO_BIAS] = np.eye(3) * 0.5**2  # 1 m/s of doubt
    assert screened(kalman, rows(), calibration=calibration).all()
    kalman.P[GYRO_BIAS, GYRO_BIAS] = np.eye(3) * 1e-12
    turned = rows(vel_e=kalman.C_eb @ [0.4, 1.0, 0.0])
    assert not screened(kalman, turned, calibration=calibration).all()
    kalman.P[ATT, ATT] = np.eye(3) * 0.4**2
    assert screened(kalman, turned, calibration=calibration).all()


def test_no_satellite_is_no_satellite():
    screening = DopplerScreening(1.5, 1e-4)
    assert screened(knowing(), rows(()), screening=screening).shape == (0,)
    screened(knowing(), rows(bias={"G01": 9.0}), screening=screening)
    alone = rows(("G01",), bias={"G01": 9.0})
    assert screened(knowing(), alone, screening=screening, time=1.0).tolist() == [False]


def test_hold_off_ends_when_it_ends():
    screening = DopplerScreening(1.5, 1e-4)
    screened(knowing(), rows(bias={"G02": 3.0}), time=10.0, screening=screening)
    held = [screening.held(rows(), t).tolist() for t in (10.0, 11.49, 11.5)]
    assert held == [[n == "G02" for n in rigs.NAMES]] * 2 + [[False] * 8]
    screening.forget()
    assert not screening.held(rows(), 10.0).any()


@pytest.mark.parametrize(("bias", "extended"), [(0.35, True), (0.2, False), (-0.35, True)])
def test_on_hold_it_is_tested_against_what_the_others_say(bias, extended):
    """Three σ of the row and of what the others leave open, not of the filter before them."""
    screening = DopplerScreening(1.5, 1e-4)
    kalman = knowing(velocity=3.0)
    screened(kalman, rows(bias={"G02": 30.0}), screening=screening)
    used = screened(kalman, rows(bias={"G02": bias}), time=1.0, screening=screening)
    assert not used[1] and used.sum() == 7
    assert screening.held(rows(), 2.0)[1] == extended
    assert not screening.held(rows(), 2.5).any()


def test_where_all_are_on_hold_they_are_held_against_the_filter_together():
    """Three that are reflected stay there as long as they say so, though one of them, from
    straight above, hardly knows of the velocity; once they fit, their time runs out.
    """
    screening = DopplerScreening(1.5, 1e-4)
    bias = {"G01": 3.0, "G02": -2.0, "G03": 0.0}
    three = rows(tuple(bias), bias=bias)
    screening._until = dict.fromkeys(bias, 1.5)
    for time in (1.0, 2.0, 3.0):
        assert not screened(knowing(), three, time=time, screening=screening).any()
    assert screening.held(three, 4.4).all()
    screened(knowing(), rows(tuple(bias)), time=4.0, screening=screening)
    assert not screening.held(three, 4.5).any()


def test_significance_is_the_price_of_caution():
    """One row off by 3.5 of its σ: a test at 1 % refuses it, one at 1e-6 does not."""
    kalman = knowing(velocity=1e-3)
    kalman.P[kalman.model.clock, kalman.model.clock] = 1e-6
    off = rows(("G01",), bias={"G01": 3.5 * rows().sigma[0]})
    for significance, believed in ((1e-2, False), (1e-6, True)):
        used = DopplerScreening(1.5, significance).test(kalman, CALIBRATION, off, 0.0)
        assert used.tolist() == [believed]
    assert kalman.P[VEL, VEL][0, 0] == pytest.approx(1e-6)
