"""The rule among the ways to start, each of them told what it finds."""

import numpy as np
import pytest

from certnav.alignment.levelling import InitialAttitude
from certnav.filters.error_model import ErrorModel
from certnav.filters.errors import AlignmentError
from certnav.filters.strapdown import NavState
from certnav.nav.config import AlignmentConfig
from certnav.nav.engine.events import GnssEvent, missing
from certnav.nav.engine.start.finder import StartFinder, find_start
from certnav.nav.engine.start.state import Start
from oracles import rigs

NORTH = rigs.C_EN[:, 0]
STREAM = rigs.stream_at_rest(rigs.C_EN, 400.0)
MODEL = ErrorModel(rigs.IMU)


def a_start(method, rested=False):
    attitude = InitialAttitude(
        1.0, rigs.C_EN, np.eye(3), 0.1, np.zeros(3), 1e-4 if rested else None, method, method
    )
    return Start(attitude, NavState(1.0, rigs.PLACE, np.zeros(3), rigs.C_EN), np.eye(3), np.eye(3))


class Levelled:
    """Finds a start from some time on; `fails` is what `attitude` raises at the end."""

    def __init__(self, at=np.inf, rested=False, fails=None):
        self.at, self.made, self.fails = at, a_start("level+course", rested), fails
        self.taken, self.offered, self.unheard = [], [], None

    def take(self, pairs):
        self.taken += pairs

    def offer(self, now):
        self.offered.append(now)
        return self.made if now >= self.at else None

    def at_last(self):
        if self.fails:
            raise AlignmentError(self.fails)
        return self.made


class Certified:
    """The same; its first Doppler is at `first`."""

    def __init__(self, at=np.inf, first=0.0, unplaced=False):
        self.at, self.first_epoch, self.attempts, self.unplaced = at, first, [], unplaced
        self.made = a_start("certified")

    def offer(self, event):
        self.attempts.append((event.time, "no"))
        return self.made if event.time >= self.at else None

    def why_not(self):
        return "not certified: because"


def finder(levelled=None, certified=None, **config):
    made = StartFinder(STREAM, rigs.calibration(), AlignmentConfig(**config), MODEL)
    made._levelled, made._certified = levelled or Levelled(), certified or Certified()
    return made


def position(time):
    return GnssEvent(time, "position", rigs.PLACE, np.eye(3))


def velocity(time, speed=10.0):
    return GnssEvent(time, "velocity", speed * NORTH, 0.01 * np.eye(3))


def first_start(made, until=200):
    for t in range(until):
        start = made.offer(velocity(float(t)))
        if start is not None:
            return t, start.attitude.method
    return None


@pytest.mark.parametrize(("levelled", "certified", "method", "found"), [
    # A standstill that has told the gyro bias does not pre-empt a certificate.
    ({"at": 20, "rested": True}, {"at": 30}, "auto", (30, "certified")),
    ({"at": 30, "rested": True}, {"at": 20}, "auto", (20, "certified")),
    ({"at": 20, "rested": True}, {"at": 121}, "auto", (120, "level+course")),
    ({"at": 20, "rested": True}, {"first": None}, "auto", (20, "level+course")),
    # Levelled it is kept back until two windows of 60 s have passed.
    ({"at": 20}, {"at": 119}, "auto", (119, "certified")),
    ({"at": 20}, {"at": 121}, "auto", (120, "level+course")),
    ({"at": 20}, {"at": 120}, "auto", (120, "certified")),
    ({"at": 150}, {}, "auto", (150, "level+course")),
    ({"at": 20}, {"first": None}, "auto", (20, "level+course")),
    # One way alone.
    ({"at": 20}, {"at": 50}, "certified", (50, "certified")),
    ({"at": 20, "rested": True}, {"at": 50}, "certified", (50, "certified")),
    ({"at": 20}, {}, "certified", None),
    ({"at": 20}, {"at": 10, "first": None}, "level+course", (20, "level+course")),
])  # fmt: skip
def test_which_start_is_taken(levelled, certified, method, found):
    made = finder(Levelled(**levelled), Certified(**certified), method=method)
    assert first_start(made) == found


def test_two_windows_are_as_long_as_configured():
    made = finder(Levelled(at=20), Certified(first=7.0), max_window_s=30.0)
    assert first_start(made) == (67, "level+course")


@pytest.mark.parametrize(("first", "at"), [(7.0, 67.0), (None, 0.0)])
def test_what_nothing_bears_out_is_for_want_of_a_better_one_when_time_is_up(first, at):
    levelled = Levelled(at=200)
    levelled.unheard = a_start("level+course", True)
    made = finder(levelled, Certified(first=first), max_window_s=30.0)
    assert first_start(made) == (at, "level+course")


def test_levelling_is_not_repeated_once_it_has_found_something():
    made = finder(Levelled(at=20), Certified())
    first_start(made, until=60)
    assert made._levelled.offered == [float(t) for t in range(21)]
    assert made._certified.attempts[-1][0] == 59.0
    alone = finder(Levelled(at=20), Certified(), method="certified")
    first_start(alone, until=60)
    assert alone._levelled.offered == []


def test_the_message_says_why_it_is_not_certified():
    made = finder(Levelled(at=20), Certified())
    for t in range(121):
        start = made.offer(velocity(float(t)))
    assert start.attitude.message == "level+course; not certified: because"
    assert start.attempts == tuple((float(t), "no") for t in range(121))
    never = finder(Levelled(at=20), Certified(first=None), method="level+course")
    for t in range(21):
        start = never.offer(velocity(float(t)))
    assert start.attitude.message == "level+course" and start.attempts == ()


def test_one_that_comes_late_is_passed_over():
    made = finder(Levelled(at=20, rested=True), Certified(first=None))
    assert made.offer(velocity(25.0)) is not None
    assert made.offer(velocity(24.9)) is None
    assert made.offer(velocity(25.0 - 1e-10)) is not None
    assert made._levelled.offered == [25.0]


def test_pairs_reach_levelling_in_all_ways():
    made = finder()
    made.offer(position(1.0))
    made.offer(velocity(1.0))
    assert [(v.time, p.time) for v, p in made._levelled.taken] == [(1.0, 1.0)]


ANGLES = {"roll_deg": 0.0, "pitch_deg": 0.0, "heading_deg": 30.0}


def test_three_angles_are_given_two_are_not():
    assert finder(**ANGLES).method == "given"
    assert finder(**ANGLES, method="certified").method == "certified"
    assert finder(roll_deg=0.0, heading_deg=30.0).method == "auto"
    made = finder(**ANGLES)
    assert made.offer(velocity(1.0)) is None
    assert made.offer(position(2.0)) is None  # one position may be a bad one
    start = made.offer(velocity(2.5))
    assert start.attitude.method == "given" and start.state.time == 1.0
    assert made._levelled.offered == [] and made._certified.attempts == []
    alone = finder(**ANGLES)
    alone.offer(position(2.0))
    alone.offer(velocity(2.0))
    assert alone.close().attitude.method == "given"  # but there will be no more


# At the end of the data.


def closed(made, *events):
    for event in events:
        made.offer(event)
    return made.close()


def test_the_end_of_the_data_is_no_reason_to_wait_for_a_certificate():
    start = closed(finder(Levelled(at=20), Certified()), position(29.0), velocity(30.0))
    assert start.attitude.method == "level+course"
    assert start.attitude.message == "level+course; not certified: because"
    assert len(start.attempts) == 2


def test_levelling_makes_do_with_what_there_is():
    """Not yet due, but there will be no more."""
    start = closed(finder(Levelled(), Certified(first=None)), position(0.0), velocity(1.0))
    assert start.attitude.method == "level+course"


def test_why_there_is_no_attitude():
    both = position(1.0), velocity(1.0)
    for made, events, text in (
        (finder(method="certified"), both, "not certified: because"),
        (finder(), (), "no usable GNSS position"),
        (finder(), both[:1], "no usable GNSS velocity"),
        (finder(), both[1:], "no usable GNSS position"),
        (finder(certified=Certified(unplaced=True)), both[1:], "not certified: because"),
        (finder(), (missing(1.0, "position", "no fix"), both[1]), "no usable GNSS position"),
        (finder(), (position(1.0), velocity(9.0)), "no GNSS velocity with a position within 2.5 s"),
        (finder(Levelled(fails="too slow")), both, "too slow; not certified: because"),
    ):
        with pytest.raises(AlignmentError) as error:
            closed(made, *events)
        assert str(error.value).startswith(text)
    alone = finder(Levelled(fails="too slow"), Certified(first=None), method="level+course")
    with pytest.raises(AlignmentError) as error:
        closed(alone, *both)
    assert str(error.value) == "too slow"


def test_a_recording_ends_in_a_start_or_in_a_reason():
    config, events = AlignmentConfig(**ANGLES), (position(1.0), velocity(1.0), velocity(2.0))
    found = find_start(events, STREAM, rigs.calibration(), config, MODEL)
    assert found.state.time == 1.0
    with pytest.raises(AlignmentError, match="no usable GNSS velocity"):
        find_start(events[:1], STREAM, rigs.calibration(), config, MODEL)
    standing = tuple(e for t in range(1, 20) for e in (position(float(t)), velocity(float(t), 0.0)))
    with pytest.raises(AlignmentError, match=r"never reaches 3\.0 m/s"):
        find_start(standing, STREAM, rigs.calibration(), AlignmentConfig(), MODEL)


def test_it_says_what_it_waits_for():
    made = StartFinder(STREAM, rigs.calibration(), AlignmentConfig(), MODEL)
    assert made.waiting == "no data yet" and made.attempts == []
    made.offer(position(1.0))
    made.offer(velocity(1.0, 0.5))
    assert made.waiting == "no heading: slower than 3.0 m/s so far"
