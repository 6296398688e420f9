"""The loose pass sees the errors of positions, and is not moved by them."""

import dataclasses

import numpy as np
import pytest

from certnav.alignment.levelling import InitialAttitude
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.filters.error_model import ErrorModel
from certnav.filters.strapdown import InertialStream, NavState
from certnav.nav.config import Config
from certnav.nav.config_files import from_tables
from certnav.nav.engine import legs
from certnav.nav.engine.events import GnssEvent
from certnav.nav.engine.fix_noise import loose
from certnav.nav.engine.fix_noise.estimate import STEADY
from certnav.nav.engine.fix_noise.fitted import with_noise
from certnav.nav.engine.fix_noise.loose import loose_pass
from certnav.nav.engine.gnss import gnss_timeline
from certnav.nav.engine.legs import Course, fitted_part, found_start
from certnav.nav.engine.start.state import Start
from certnav.nav.engine.vehicle import VehicleConstraints
from certnav.nav.engine.velocity_noise import collected as velocities
from certnav.nav.engine.velocity_noise.collected import collected
from certnav.nav.solution import FixErrors
from oracles import rigs


@pytest.fixture(scope="module")
def drive():
    """An exact drive with positions that are wrong by up to 300 m, and those errors, NED."""
    config = SimulationConfig(
        seed=4, duration=60.0, density="open", noise=False, moving_start=True, static_start=0.0
    )
    made = simulate(config)
    rng = np.random.default_rng(1)
    time = np.arange(config.start_time + 1.0, config.start_time + 59.0)
    fixes = fixes_from_truth(
        made.trajectory, time, config.lever_antenna_b, (1e-6, 1e-6, 1e-6), 1e-4, rng
    )
    error_n = rng.uniform(-300.0, 300.0, (time.size, 3))
    error_n[:20] *= 0.01  # a start needs positions that agree
    pos_e = fixes.pos_e + np.einsum("nij,nj->ni", C_en_of(fixes.pos_e), error_n)
    quality = np.where(np.arange(time.size) == 30, "fixed", "single")
    cov_e = np.tile(4.0 * np.eye(3), (time.size, 1, 1))
    fixes = dataclasses.replace(fixes, pos_e=pos_e, quality=quality, pos_cov_e=cov_e)
    return dataclasses.replace(made.sequence(fixes), observations=None), error_n


def course_of(sequence):
    config = from_tables({"alignment": {"method": "level+course"}})
    timeline = gnss_timeline(sequence, config.gnss)
    imu = sequence.inertial
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    vehicle = VehicleConstraints(sequence.calibration, config.vehicle, None)
    model = ErrorModel(sequence.calibration.imu)
    return Course(timeline.events, stream, sequence.calibration, vehicle, model, (), config)


def test_innovations_are_the_errors_of_the_positions(drive):
    sequence, error_n = drive
    course = course_of(sequence)
    used, found, below_four = loose_pass(course, found_start(course, course.events))
    rows = np.searchsorted(sequence.fixes.time, found.time)
    assert len(used) == len(found) > 40 and not below_four
    assert 30 not in rows  # resolved
    seen, true = found.value_n - found.value_n[0], error_n[rows] - error_n[rows[0]]
    np.testing.assert_allclose(seen, true, atol=0.5)
    np.testing.assert_allclose(found.declared_n, 4.0 + 0.02**2, rtol=1e-6)
    assert (found.filter_n > 4.0).all()  # nothing tells it where it is
    np.testing.assert_array_equal(found.kept, 1.0)


def test_of_many_hours_the_first_are_what_noise_is_fitted_to(drive, monkeypatch):
    course = course_of(drive[0])
    start = found_start(course, course.events)
    whole, epochs = loose_pass(course, start)[1], collected(course, start)[0]
    assert fitted_part(course, start) == ""
    for module in (legs, loose, velocities):
        monkeypatch.setattr(module, "FITTED_TO", 18.0)
    part, first = loose_pass(course, start)[1], collected(course, start)[0]
    end = start.state.time + 18.0
    assert 10 < len(part) == int(np.sum(whole.time <= end)) < len(whole)
    np.testing.assert_array_equal(part.value_n, whole.value_n[: len(part)])
    assert [e.time for e in first] == [e.time for e in epochs if e.time <= end]
    assert 10 < len(first) < len(epochs)
    assert fitted_part(course, start) == " of the first 0.005 h"


def test_the_start_gets_the_noise_of_its_position():
    """What is added for the way from the position to the start stays."""
    more = np.diag([0.1, 0.2, 0.3])
    fix = GnssEvent(1.0, "position", rigs.PLACE, np.eye(3) * 4.0)
    attitude = InitialAttitude(
        1.0, rigs.C_EN, np.eye(3) * 1e-4, 0.03, np.zeros(3), None, "level+course", ""
    )
    state = NavState(1.0, rigs.PLACE, np.zeros(3), rigs.C_EN)
    start = Start(attitude, state, fix.cov_e + more, np.eye(3), fix=fix)
    velocity = GnssEvent(1.0, "velocity", np.zeros(3), np.eye(3))
    resolved = GnssEvent(2.0, "position", rigs.PLACE, np.eye(3) * 1e-4, resolved=True)
    calibration = rigs.calibration()
    course = Course(
        (fix, velocity, resolved), rigs.stream_at_rest(rigs.C_EN, 4.0), calibration,
        VehicleConstraints(calibration, Config().vehicle), ErrorModel(rigs.IMU), (), Config(),
        (start, 0.25),
    )  # fmt: skip
    found = FixErrors(0.5, 0.8, 33.0, STEADY, (4.0, 4.0, 4.0), 50.0, 0.1)
    made = with_noise(course, found)
    assert made.model.fix_correlation == 33.0
    begun, spent = made.start
    assert spent == 0.25 and begun.fix is made.events[0]
    np.testing.assert_allclose(begun.pos_cov_e, np.eye(3) + more, atol=1e-9)
    np.testing.assert_allclose(begun.fix.common_cov_e, 0.8 * np.eye(3), atol=1e-9)
    assert made.events[1:] == (velocity, resolved)
