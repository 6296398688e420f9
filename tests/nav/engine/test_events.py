"""Events: what one says when it has nothing to say, and how sure it is of what it says."""

import numpy as np
import pytest

from certnav.alignment.in_motion.rows import DopplerEpoch
from certnav.nav.config import GnssConfig
from certnav.nav.engine.events import GnssEvent, doppler_noise, inflated, missing
from certnav.velocity.range_rate import doppler_rows
from oracles import rigs


def test_a_missing_one_has_no_numbers_but_keeps_what_there_was():
    observations = rigs.sky(("G01", "G02"))
    epoch = DopplerEpoch(5.0, rigs.PLACE, doppler_rows(observations, rigs.PLACE))
    event = missing(5.0, "velocity", "why", ("G01", "G02"), observations, epoch)
    assert (event.time, event.kind, event.reason) == (5.0, "velocity", "why")
    assert event.value_e.shape == (3,) and event.cov_e.shape == (3, 3)
    assert np.isnan(event.value_e).all() and np.isnan(event.cov_e).all()
    assert event.satellites == ("G01", "G02") and not event.shared
    assert event.observations is observations and event.epoch is epoch
    bare = missing(5.0, "position", "why")
    assert bare.satellites == () and bare.observations is None and bare.epoch is None


def test_what_positions_have_in_common_is_nine_tenths_unless_said():
    """Reflections and atmosphere: of a single-point position's error nearly all."""
    cov, part = np.diag([1.0, 4.0, 9.0]), np.diag([0.5, 0.1, 0.2])
    assert GnssEvent(0.0, "position", rigs.PLACE, cov).common_cov_e is None
    made = GnssEvent(0.0, "position", rigs.PLACE, cov, shared=True)
    np.testing.assert_allclose(made.common_cov_e, 0.9 * cov, rtol=1e-15)
    said = GnssEvent(0.0, "position", rigs.PLACE, cov, shared=True, shared_cov_e=part)
    np.testing.assert_array_equal(said.common_cov_e, part)


def test_sigma_is_scaled_and_the_floor_added_in_variance():
    cov = np.array([[4.0, 1.0, 0.0], [1.0, 9.0, 0.0], [0.0, 0.0, 1.0]])
    expected = [[36.25, 9.0, 0.0], [9.0, 81.25, 0.0], [0.0, 0.0, 9.25]]
    np.testing.assert_allclose(inflated(cov, 3.0, 0.5), expected, rtol=1e-15)


def test_the_noise_of_range_rates_is_the_configured_one():
    noise = doppler_noise(GnssConfig(doppler_sigma_mps=0.3, doppler_floor_mps=0.4))
    assert noise.sigma(45.0) == pytest.approx(0.5)
    assert noise.sigma(25.0) == pytest.approx(np.hypot(0.4, 3.0))  # tenfold per 20 dB
