"""What a vehicle cannot do: offered when it holds, with the σ that is configured."""

import numpy as np
import pytest

from certnav.datasets.series import Odometer
from certnav.filters.error_model import ACCEL_BIAS, ATT, GYRO_BIAS, VEL
from certnav.filters.strapdown import InertialStream
from certnav.nav.config import VehicleConfig
from certnav.nav.engine.vehicle import VehicleConstraints
from oracles import rigs

MOUNTED = rigs.calibration(mounted="test", lever_vehicle_b=np.array([-0.5, 0.0, 1.4]))
DEG = np.pi / 180.0


def standing(sigma_speed=0.05, speed=0.0, stream=None, **model):
    kalman = rigs.filter_at_rest(3.0, sigma=(1.0, sigma_speed, 1e-3), stream=stream, **model)
    kalman.propagate(2.0)
    kalman.P[VEL, VEL] = np.eye(3) * sigma_speed**2
    kalman.vel_e[:] = speed * kalman.C_eb[:, 0]
    return kalman


def offered(kalman, config=None, calibration=MOUNTED, odometer=None, credible=True):
    vehicle = VehicleConstraints(calibration, config or VehicleConfig(), odometer)
    return dict(vehicle.offered(kalman, credible))


def test_at_rest_there_is_no_velocity_and_no_rate():
    found = offered(standing(), VehicleConfig(sigma_zupt_mps=0.2))
    assert list(found) == ["zupt", "zaru"]
    np.testing.assert_allclose(found["zupt"].R, 0.04 * np.eye(3))
    # Of a second's mean: the white noise, and 0.005°/s that an engine may turn it.
    noise = rigs.IMU.gyro_noise_density**2 + (0.005 * DEG) ** 2
    np.testing.assert_allclose(found["zaru"].R, noise * np.eye(3))
    np.testing.assert_allclose(found["zaru"].z, 0.0, atol=1e-12)  # the Earth's rate is known


@pytest.mark.parametrize(("zupt", "zaru"), [(True, False), (False, True), (False, False)])
def test_either_can_be_switched_off(zupt, zaru):
    found = offered(standing(), VehicleConfig(zupt=zupt, zaru=zaru))
    expected = [k for k, on in (("zupt", zupt), ("zaru", zaru)) if on]
    assert list(found) == (expected or ["nhc"])  # with neither nobody asks for a standstill


@pytest.mark.parametrize(("sigma", "speed", "rest"), [
    (0.05, 0.49, True), (0.05, 0.51, False), (0.4, 0.79, True), (0.4, 0.81, False),
    (0.99, 1.9, True), (1.01, 0.0, False),
])  # fmt: skip
def test_quiet_is_a_standstill_only_where_the_filters_speed_allows_it(sigma, speed, rest):
    """Within 0.5 m/s or 2σ of zero, and known to 1 m/s: a smooth road is quiet, too."""
    assert ("zupt" in offered(standing(sigma, speed))) == rest


def test_the_least_known_axis_counts():
    kalman = standing()
    kalman.P[VEL, VEL][1, 1] = 1.1**2
    assert "zupt" not in offered(kalman)


def test_a_filter_that_is_doubted_tells_no_standstill():
    assert list(offered(standing(), credible=False)) == ["nhc"]


def turning(rate):
    """A stream that turns steadily about the vertical [rad/s]."""
    rest = rigs.stream_at_rest(rigs.C_EN, 3.0)
    return InertialStream(rest.edges[1:], rest.gyro + np.array([0, 0, rate]), rest.accel)


def test_a_steady_rate_may_be_bias_where_the_bias_is_unknown():
    """0.3°/s and 3σ of the bias, whose σ is 0.139°/s at first."""
    for rate, sigma, rest in ((0.6, 0.139, True), (0.8, 0.139, False), (0.6, 0.01, False)):
        kalman = standing(stream=turning(rate * DEG))
        kalman.P[GYRO_BIAS, GYRO_BIAS] = np.eye(3) * (sigma * DEG) ** 2
        kalman.bias[:3] = 0.0
        assert ("zaru" in offered(kalman)) == rest


def braking(acceleration):
    """A stream without any vibration that slows down steadily along its nose [m/s²]."""
    rest = rigs.stream_at_rest(rigs.C_EN, 3.0)
    return InertialStream(rest.edges[1:], rest.gyro, rest.accel + np.array([acceleration, 0, 0]))


@pytest.mark.parametrize(("acceleration", "tilt", "stands"), [
    (0.0, 0.1, True), (0.3, 0.1, True), (-1.8, 0.1, False), (0.6, 0.1, False),
    (0.6, 2.0, True), (-1.8, 2.0, False),
])  # fmt: skip
def test_a_car_that_brakes_evenly_is_quiet_and_does_not_stand(acceleration, tilt, stands):
    """Within what 0.1 m/s² and the level, known to so many degrees, explain: 4σ of both."""
    kalman = standing(sigma_speed=0.9, stream=braking(acceleration))
    kalman.P[ATT, ATT] = np.eye(3) * (tilt * DEG) ** 2
    kalman.P[ACCEL_BIAS, ACCEL_BIAS] = np.eye(3) * 0.01**2
    kalman.vel_e[:] = 0.0
    found = offered(kalman)
    assert ("zupt" in found) == ("zaru" in found) == stands
    assert ("nhc" in found) == (not stands)


def test_each_is_made_when_it_is_its_turn():
    """What the first has taught the filter, the second is measured against."""
    kalman = standing()
    constraints = VehicleConstraints(MOUNTED, VehicleConfig()).offered(kalman)
    next(constraints)
    kalman.bias[:3] += [1e-4, 0.0, 0.0]
    kind, zaru = next(constraints)
    assert kind == "zaru"
    np.testing.assert_allclose(zaru.z, [-1e-4, 0.0, 0.0], atol=1e-12)


def test_in_motion_it_goes_where_it_points():
    config = VehicleConfig(sigma_lateral_mps=0.3, sigma_vertical_mps=0.7)
    kalman = standing(speed=10.0)
    kalman.vel_e += 0.5 * kalman.C_eb[:, 1] - 0.2 * kalman.C_eb[:, 2]
    kalman.omega_b = np.array([0.0, 0.0, 0.1]) + kalman.C_eb.T @ [0.0, 0.0, 7.292115e-5]
    found = offered(kalman, config)
    assert list(found) == ["nhc"]
    np.testing.assert_allclose(found["nhc"].R, np.diag([0.09, 0.49]))
    # At the axle: ω × l = (0, 0, 0.1) × (−0.5, 0, 1.4) = (0, −0.05, 0).
    np.testing.assert_allclose(found["nhc"].z, [-0.45, 0.2], atol=1e-7)


@pytest.mark.parametrize(("wanted", "mounted", "there"), [
    ("auto", "test", True), ("auto", "", True), ("on", "", True), ("off", "test", False),
])  # fmt: skip
def test_it_is_on_unless_told_otherwise_whatever_is_known(wanted, mounted, there):
    calibration = rigs.calibration(mounted=mounted)
    vehicle = VehicleConstraints(calibration, VehicleConfig(nhc=wanted))
    assert vehicle.nhc == there
    assert ("nhc" in offered(standing(speed=9.0), VehicleConfig(nhc=wanted), calibration)) == there
    odometer = Odometer(np.arange(4.0), np.full(4, 9.0))
    made = VehicleConstraints(calibration, VehicleConfig(odometer=wanted), odometer)
    assert (made.odometer is odometer) == there
    assert VehicleConstraints(calibration, VehicleConfig(odometer=wanted)).odometer is None


def test_an_odometer_is_read_between_its_samples_and_never_beyond():
    config = VehicleConfig(odometer="on", sigma_odometer_mps=0.3)
    kalman = standing(speed=9.0, odometer=True)
    kalman.odometer_scale = 0.1
    at = kalman.time
    for times, speeds, z in [
        ([at - 1.0, at + 3.0], [8.0, 12.0], 9.0 - 1.1 * 9.0),
        ([at, at + 1.0], [10.0, 0.0], 10.0 - 1.1 * 9.0),
        ([at - 1.0, at], [0.0, 10.0], 10.0 - 1.1 * 9.0),
        ([at + 0.001, at + 1.0], [9.0, 9.0], None),
        ([at - 1.0, at - 0.001], [9.0, 9.0], None),
    ]:
        found = offered(kalman, config, odometer=Odometer(np.array(times), np.array(speeds)))
        assert list(found) == (["nhc"] if z is None else ["nhc", "odometer"])
        if z is not None:
            np.testing.assert_allclose(found["odometer"].z, [z], atol=1e-4)
            np.testing.assert_allclose(found["odometer"].R, [[0.09]])
    ready = Odometer(np.array([at - 1.0, at + 1.0]), np.full(2, 9.0))
    assert list(offered(standing(speed=9.0), config, odometer=ready)) == ["nhc"]  # no such state
