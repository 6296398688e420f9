"""Which Doppler the loop believes, for how long, and when it doubts itself instead."""

import dataclasses

import numpy as np
import pytest

from certnav.datasets.sequence import Calibration
from certnav.filters.earth import C_en_of
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import VEL, ErrorModel
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream, NavState
from certnav.nav.engine.doppler_screening import DopplerScreening
from certnav.nav.engine.doppler_update import rows_measurement
from certnav.velocity.range_rate import DopplerRows

HOLD, SIGMA = 10.0, 0.05
DRIFT = 12.0


@pytest.fixture
def kalman():
    """A filter at rest that knows its velocity to 5 cm/s and the clock's drift to 10 cm/s."""
    model = ErrorModel(imu_preset("adis16470"), clock_walk=0.1)
    pos_e = np.array([-2267e3, 5009e3, 3221e3])
    C_eb = C_en_of(pos_e)
    time = np.arange(0.0, 2.0, 0.01)
    stream = InertialStream(time, np.zeros((time.size, 3)), np.zeros((time.size, 3)))
    P = model.initial_covariance(np.eye(3), np.eye(3) * 0.05**2, np.eye(3) * 1e-6)
    P[model.clock, model.clock] = 0.1**2
    made = ErrorStateFilter(model, stream, NavState(stream.start, pos_e, np.zeros(3), C_eb), P)
    made.gnss.clock_drift = DRIFT
    return made


def epoch(bias, drift=DRIFT, names="ABCDEF"):
    """Range rates of a receiver at rest; `bias` [m/s] by satellite."""
    rng = np.random.default_rng(7)
    n = len(names)
    azimuth, elevation = np.arange(n) * 2.1, rng.uniform(0.3, 1.2, n)
    C_en = C_en_of(np.array([-2267e3, 5009e3, 3221e3]))
    e_n = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
         -np.sin(elevation)]
    )  # fmt: skip
    z = np.full(n, -drift) + [bias.get(name, 0.0) for name in names]
    return _rows(e_n @ C_en.T, z, np.array(list(names)))


def _rows(e_e, z, sat):
    fields = {f.name for f in dataclasses.fields(DopplerRows)}
    n = len(z)
    values = {
        "e_e": e_e, "z": z, "sigma": np.full(n, SIGMA), "sat": sat, "row": np.arange(n),
        "epoch": np.zeros(n, dtype=int), "time": np.zeros(n),
    }  # fmt: skip
    return DopplerRows(**{k: v for k, v in values.items() if k in fields})


CALIBRATION = Calibration(imu_preset("adis16470"), np.zeros(3), "test")


def test_sound_satellites_are_believed(kalman):
    screening = DopplerScreening(HOLD, 1e-4)
    assert screening.test(kalman, CALIBRATION, epoch({}), 0.0).all()


def test_a_refused_satellite_stays_out_while_the_filter_grows_modest(kalman):
    screening = DopplerScreening(HOLD, 1e-4)
    used = screening.test(kalman, CALIBRATION, epoch({"B": 3.0}), 0.0)
    np.testing.assert_array_equal(used, [True, False, True, True, True, True])
    kalman.P[VEL, VEL] *= 1e4  # now 3 m/s would pass
    pair = epoch({"B": 3.0}, names="AB")
    assert not screening.test(kalman, CALIBRATION, pair, 5.0)[1]
    # Held off, but found in order meanwhile: believed when its time is over.
    assert screening.test(kalman, CALIBRATION, epoch({}), HOLD + 0.1).all()


def test_on_hold_its_time_does_not_run_while_it_disagrees(kalman):
    screening = DopplerScreening(HOLD, 1e-4)
    for t in (0.0, 6.0, 12.0):
        used = screening.test(kalman, CALIBRATION, epoch({"B": 3.0}), t)
        assert not used[1] and used.sum() == 5
    assert screening.held(epoch({}), 21.9)[1]
    assert not screening.held(epoch({}), 22.1)[1]


def test_a_jump_of_the_clock_is_no_fault_of_the_satellites(kalman):
    screening = DopplerScreening(HOLD, 1e-4)
    used = screening.test(kalman, CALIBRATION, epoch({}, drift=DRIFT + 40.0), 0.0)
    assert used.all()
    assert kalman.P[kalman.model.clock, kalman.model.clock] > 1e5
    kalman.update(rows_measurement(kalman, CALIBRATION, epoch({}, drift=DRIFT + 40.0)))
    assert kalman.gnss.clock_drift == pytest.approx(DRIFT + 40.0, abs=0.1)
    assert np.linalg.norm(kalman.vel_e) < 0.1


def test_one_satellite_says_something_once_the_clock_is_known(kalman):
    before = np.trace(kalman.P[VEL, VEL])
    kalman.P[kalman.model.clock, kalman.model.clock] = 0.01**2
    kalman.update(rows_measurement(kalman, CALIBRATION, epoch({}, names="A")))
    assert np.trace(kalman.P[VEL, VEL]) < 0.9 * before
