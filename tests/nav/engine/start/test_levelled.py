"""When a levelled start is due: at once after a standstill, in motion twelve seconds later."""

import numpy as np
import pytest

from certnav.alignment.direction import Fit
from certnav.alignment.levelling import InitialAttitude
from certnav.filters.error_model import ATT
from certnav.filters.errors import AlignmentError
from certnav.filters.rotation import matrix_from_rpy, rpy_from_matrix
from certnav.nav.config import AlignmentConfig, FilterConfig
from certnav.nav.engine.events import GnssEvent
from certnav.nav.engine.start.fixes import Fixes
from certnav.nav.engine.start.levelled import LevelledStart, given_start
from certnav.nav.engine.start.state import start_filter
from certnav.nav.vehicles import VEHICLES
from oracles import rigs

NORTH, EAST, DOWN = rigs.C_EN.T
STREAM = rigs.stream_at_rest(rigs.C_EN, 40.0)


@pytest.fixture
def fixes():
    return Fixes(STREAM, rigs.calibration(), VEHICLES["car"])


class Levelled:
    """A levelled start that finds what it is told, and what it says."""

    def __init__(self, fixes, monkeypatch, **config):
        self.said = []
        self.start = LevelledStart(fixes, AlignmentConfig(**config), rigs.IMU, self.said.append)
        self.fixes, self.tries, self.finds, self.odds, self.after = fixes, 0, None, 99.0, []
        self.backwards = None
        monkeypatch.setattr(self.start, "attitude", self._attitude)
        self.fit = Fit(borne_out=True)
        place = "certnav.nav.engine.start.levelled"
        monkeypatch.setattr(f"{place}.log_odds", lambda *given: self.odds)
        monkeypatch.setattr(f"{place}.course_fit", lambda *given: self.fit)

    def _attitude(self, backwards=False):
        self.after.append(self.start._after)
        if backwards:
            return self.backwards or self.finds
        self.tries += 1
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


def attitude(time, rested, C_eb=rigs.C_EN, message="nose"):
    sigma = 1e-5 if rested else None
    return InitialAttitude(
        time, C_eb, np.eye(3), 0.1, np.zeros(3), sigma, "level+course", message
    )  # fmt: skip


def nose(time):
    return attitude(time, rested=True)


def turned(time):
    return attitude(time, True, rigs.C_EN @ matrix_from_rpy([0.0, 0.0, np.pi]), "tail, reversing")


def test_it_waits_for_the_first_level_speed(levelled):
    """3 m/s, with the epoch after it; what goes up and down is no course."""
    levelled.finds = attitude(3.0, rested=True)
    levelled.drives(1.0, 0.5 * NORTH)
    levelled.drives(2.0, 2.99 * NORTH + 5.0 * DOWN)
    assert levelled.said == ["no heading: slower than 3.0 m/s so far"] * 2
    assert levelled.start.offer(2.5) is None and levelled.tries == 0
    levelled.drives(3.0, 3.01 * EAST)
    assert len(levelled.said) == 2
    assert levelled.start.offer(3.0) is None and levelled.tries == 0
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


@pytest.mark.parametrize(("odds", "sure"), [(2.4, True), (2.2, False)])
def test_nose_first_must_be_a_thousand_to_one(levelled, odds, sure):
    """A hundred to one before anything is measured: ln 1000 − ln 100 = 2.303 are wanted."""
    levelled.finds, levelled.odds = attitude(5.0, rested=True), odds
    levelled.drives(5.0, 9.0 * NORTH)
    assert (levelled.start.offer(6.0) is not None) == sure
    told = "nose or tail first is not decided: a turn or a change of speed would tell"
    assert levelled.said == ([] if sure else [told])


@pytest.mark.parametrize(("odds", "sure"), [(-11.6, True), (-11.4, False), (-4.7, False)])
def test_tail_first_must_be_so_in_spite_of_that(levelled, odds, sure):
    """− ln 1000 − ln 100 = −11.513."""
    levelled.finds, levelled.odds = attitude(5.0, rested=True), odds
    levelled.backwards = turned(5.0)
    levelled.drives(5.0, 9.0 * NORTH)
    start = levelled.start.offer(6.0)
    assert (start is not None) == sure
    if sure:
        np.testing.assert_array_equal(start.state.C_eb, levelled.backwards.C_eb)
        assert start.attitude.message == "tail, reversing"
    else:
        assert levelled.start.offer(6.9) is None and levelled.tries == 1  # again after a second
        assert levelled.start.offer(7.0) is None and levelled.tries == 2


def test_what_the_gyros_carry_no_further_is_tried_anew(levelled):
    """25 s after its instant nobody will know any more which way round that was."""
    levelled.finds, levelled.odds = attitude(5.0, rested=True), 0.0
    levelled.drives(5.0, 9.0 * NORTH)
    for now in (29.0, 30.0, 31.1, 32.2):
        levelled.start.offer(now)
    after = levelled.after[::2]
    assert after[:3] == [-np.inf] * 3 and after[3:] == pytest.approx([30.1])


def test_at_the_end_the_likelier_is_taken_and_the_doubt_told(levelled):
    levelled.finds, levelled.backwards = nose(5.0), turned(5.0)
    levelled.drives(5.0, 9.0 * NORTH)
    for odds, message in (
        (99.0, "nose"), (-99.0, "tail, reversing"),
        (2.2, "nose; nose or tail first is not decided: the likelier is taken"),
        (-4.7, "tail, reversing; nose or tail first is not decided: the likelier is taken"),
        (-4.5, "nose; nose or tail first is not decided: the likelier is taken"),
    ):  # fmt: skip
        levelled.odds = odds
        assert levelled.start.at_last().attitude.message == message
        assert levelled.start.at_last().doubt == message.partition("; ")[2]
    levelled.odds, levelled.fit = 99.0, Fit()
    assert levelled.start.at_last().doubt == "other velocities do not bear out the course"
    levelled.finds = AlignmentError("too slow")
    with pytest.raises(AlignmentError, match="too slow"):
        levelled.start.at_last()


def test_a_course_that_no_other_velocity_bears_out_waits(levelled):
    """25 s after its instant it is kept for want of a better one, and later ones are tried."""
    levelled.finds, levelled.fit = attitude(5.0, rested=True), Fit()
    levelled.drives(5.0, 9.0 * NORTH)
    assert levelled.start.offer(6.0) is None
    alone = "other velocities do not bear out the course"
    assert levelled.said == [f"{alone}: a turn or a change of speed would tell"]
    assert levelled.start.offer(29.9) is None and levelled.start.unheard is None
    assert levelled.start.offer(31.0) is None
    assert levelled.start.unheard.doubt == alone and levelled.start.unheard.state.time == 5.0
    assert levelled.start.offer(32.1) is None and levelled.after[-1] == pytest.approx(30.0)
    assert levelled.start.at_last() is levelled.start.unheard
    levelled.fit = Fit(borne_out=True)
    assert not levelled.start.offer(33.2).doubt


@pytest.mark.parametrize(("satellites", "starts"), [(7, False), (8, True)])
def test_a_velocity_of_many_satellites_needs_no_other(levelled, satellites, starts):
    levelled.finds, levelled.fit = attitude(5.0, rested=True), Fit(sigma=0.05)
    levelled.fixes.add(GnssEvent(5.0, "position", rigs.PLACE, np.eye(3)))
    seen = tuple(f"G{k:02d}" for k in range(satellites))
    velocity = GnssEvent(5.0, "velocity", 9.0 * NORTH, 0.01 * np.eye(3), seen)
    levelled.start.take(levelled.fixes.add(velocity))
    assert (levelled.start.offer(6.0) is not None) == starts
    sigma = levelled.start.at_last().attitude.sigma_heading
    assert sigma == pytest.approx(0.1 if starts else np.radians(10.0))


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
