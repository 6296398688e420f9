"""When a levelled start is due: at once after a standstill, in motion twelve seconds later."""

from types import SimpleNamespace

import numpy as np
import pytest

from certnav.alignment.levelling import InitialAttitude
from certnav.filters.error_model import ATT
from certnav.filters.errors import AlignmentError
from certnav.filters.rotation import rpy_from_matrix
from certnav.nav.config import AlignmentConfig, FilterConfig
from certnav.nav.engine.events import GnssEvent
from certnav.nav.engine.start.fixes import Fixes
from certnav.nav.engine.start.levelled import LevelledStart, given_start
from certnav.nav.engine.start.state import start_filter
from oracles import rigs

NORTH, EAST, DOWN = rigs.C_EN.T
STREAM = rigs.stream_at_rest(rigs.C_EN, 40.0)


@pytest.fixture
def fixes():
    return Fixes(STREAM, rigs.calibration())


class Levelled:
    """A levelled start that finds what it is told, and what it says."""

    def __init__(self, fixes, monkeypatch, **config):
        self.said = []
        self.start = LevelledStart(fixes, AlignmentConfig(**config), rigs.IMU, self.said.append)
        self.fixes, self.tries, self.finds, self.odds = fixes, 0, None, 20.0
        monkeypatch.setattr(self.start, "attitude", self._attitude)
        module = "certnav.nav.engine.start.levelled.log_odds"
        monkeypatch.setattr(module, lambda *_: self.odds)

    def _attitude(self, backwards=False):
        self.tries += not backwards
        if isinstance(self.finds, Exception):
            raise self.finds
        return self.finds

    def drives(self, time, vel_e, variance=0.01):
        self.fixes.add(GnssEvent(time, "position", rigs.PLACE, np.eye(3)))
        velocity = GnssEvent(time, "velocity", np.asarray(vel_e), variance * np.eye(3))
        self.start.take(self.fixes.add(velocity))


@pytest.fixture
def levelled(fixes, monkeypatch):
    return Levelled(fixes, monkeypatch)


def attitude(time, rested):
    sigma = 1e-5 if rested else None
    return SimpleNamespace(time=time, C_eb=rigs.C_EN, gyro_bias=np.zeros(3), sigma_gyro_bias=sigma)


def test_it_waits_for_the_first_level_speed(levelled):
    """3 m/s, with the epoch after it; what goes up and down is no course."""
    levelled.finds = attitude(3.0, rested=True)
    levelled.drives(1.0, 0.5 * NORTH)
    levelled.drives(2.0, 2.99 * NORTH + 5.0 * DOWN)
    assert levelled.said == ["no heading: slower than 3.0 m/s so far"] * 2
    assert levelled.start.offer(2.5) is None and levelled.tries == 0
    levelled.drives(3.0, 3.01 * EAST)
    assert len(levelled.said) == 2
    assert levelled.start.offer(3.0) is None
    start = levelled.start.offer(4.0)
    assert start is not None and start.state.time == 3.0


def test_the_speed_asked_for_is_the_configured_one(fixes, monkeypatch):
    levelled = Levelled(fixes, monkeypatch, min_speed_mps=8.0)
    levelled.finds = attitude(2.0, rested=True)
    levelled.drives(1.0, 7.99 * NORTH)
    assert levelled.said == ["no heading: slower than 8.0 m/s so far"]
    levelled.drives(2.0, 8.01 * NORTH)
    assert levelled.start.offer(2.002) is not None


def test_in_motion_it_looks_twelve_seconds_past_its_instant(levelled):
    levelled.finds = attitude(5.0, rested=False)
    levelled.drives(5.0, 9.0 * NORTH)
    assert levelled.start.offer(6.0) is None
    assert levelled.said == ["levelling: complete at 17.0 s"]
    assert levelled.start.offer(16.9) is None and levelled.tries == 1  # nothing new to see
    assert levelled.start.offer(17.0) is not None and levelled.tries == 2


def test_a_failure_is_told_and_repeated_after_a_second(levelled):
    levelled.finds = AlignmentError("cannot level")
    levelled.drives(5.0, 9.0 * NORTH)
    assert levelled.start.offer(6.0) is None and levelled.said == ["cannot level"]
    assert levelled.start.offer(6.9) is None and levelled.tries == 1
    levelled.finds = attitude(5.0, rested=True)
    assert levelled.start.offer(7.0) is not None


def test_it_waits_until_it_is_clear_whether_nose_or_tail_goes_first(levelled):
    """100 to 1 for the nose beforehand are not enough; 1000 to 1 are, either way."""
    levelled.finds = InitialAttitude(
        5.0, rigs.C_EN, np.eye(3), 0.05, np.zeros(3), 1e-5, "level+course", "levelled"
    )
    levelled.drives(5.0, 9.0 * NORTH)
    levelled.odds = np.log(9.9)
    assert levelled.start.offer(6.0) is None
    assert levelled.said == [
        "nose or tail first is not decided: a turn or a change of speed would tell"
    ]
    levelled.odds = -np.log(9.9e4)
    assert levelled.start.offer(7.0) is None
    levelled.odds = np.log(10.1)
    assert levelled.start.offer(8.0).attitude.message == "levelled"
    levelled.odds = -np.log(1.01e5)
    assert levelled.start.offer(9.0).attitude.message == "levelled, reversing"
    levelled.odds = -np.log(1e3)
    assert levelled.start.at_last().attitude.message == (
        "levelled, reversing; nose or tail first is not decided: the likelier is taken"
    )


def test_it_levels_with_the_mounting_and_the_sigmas_of_the_configuration(fixes, monkeypatch):
    seen = {}

    def fake(stream, track, C_bv, imu, **options):
        seen.update(options, stream=stream, track=track, C_bv=C_bv, imu=imu)

    monkeypatch.setattr("certnav.nav.engine.start.levelled.level_and_course", fake)
    config = AlignmentConfig(min_speed_mps=4.0, sigma_level_deg=1.5, sigma_heading_deg=6.0)
    fixes.add(GnssEvent(1.0, "position", rigs.PLACE, np.eye(3)))
    fixes.add(GnssEvent(1.0, "velocity", NORTH, np.eye(3)))
    LevelledStart(fixes, config, rigs.IMU, print).attitude()
    assert seen["min_speed"] == 4.0
    assert np.degrees([seen["sigma_level"], seen["sigma_heading"]]) == pytest.approx([1.5, 6.0])
    assert seen["stream"] is STREAM and seen["imu"] is rigs.IMU
    assert seen["track"].time.tolist() == [1.0]


def test_a_given_attitude_starts_at_the_first_velocity_with_a_position(fixes):
    config = AlignmentConfig(
        roll_deg=2.0, pitch_deg=-3.0, heading_deg=40.0, sigma_level_deg=0.7, sigma_heading_deg=5.0
    )
    assert given_start(fixes, config) is None
    fixes.add(GnssEvent(3.0, "velocity", 7.0 * NORTH, 0.01 * np.eye(3)))
    assert given_start(fixes, config) is None
    fixes.add(GnssEvent(4.0, "position", rigs.PLACE, np.eye(3)))
    fixes.add(GnssEvent(5.0, "velocity", 9.0 * NORTH, 0.01 * np.eye(3)))
    start = given_start(fixes, config)
    assert start.state.time == 3.0
    np.testing.assert_allclose(start.state.pos_e, rigs.PLACE - 7.0 * NORTH, atol=1e-6)
    rpy = np.degrees(rpy_from_matrix(rigs.C_EN.T @ start.state.C_eb))
    np.testing.assert_allclose(rpy, [2.0, -3.0, 40.0], atol=1e-3)
    kalman = start_filter(
        start, STREAM, rigs.calibration(), rigs.filter_at_rest().model, FilterConfig()
    )
    C_nb = rigs.C_EN.T @ start.state.C_eb
    sigma = np.degrees(np.sqrt(np.diag(C_nb @ kalman.P[ATT, ATT] @ C_nb.T)))
    np.testing.assert_allclose(sigma, [0.7, 0.7, 5.0], atol=1e-3)
