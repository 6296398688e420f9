"""When a solution is no longer one of a vehicle: how fast, how high, how often doubted."""

import numpy as np
import pytest

from certnav.filters.error_model import VEL
from certnav.nav.engine.watch.sanity import Limits, Lost, Sanity
from oracles import rigs

UP, NORTH, EAST = rigs.PLACE / np.linalg.norm(rigs.PLACE), rigs.C_EN[:, 0], rigs.C_EN[:, 1]


def moving(vel_e, sigma=0.0, radius=None):
    kalman = rigs.filter_at_rest(3.0)
    kalman.vel_e[:] = vel_e
    kalman.P[VEL, VEL] = np.diag([0.0, sigma**2, 0.0])
    if radius is not None:
        kalman.pos_e[:] = radius * UP
    return kalman


def lost(kalman, limits=None, times=(0.0, 1.0)):
    """Return what is said of a filter that is looked at so; '' where it is believed."""
    sanity = Sanity(limits or Limits())
    try:
        for time in times:
            kalman.time = time
            sanity.look(kalman)
    except Lost as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("vel_e", "sigma", "said"), [
    (89.0 * NORTH, 0.0, ""), (91.0 * NORTH, 0.0, "at 91 m/s (limit 90)"),
    (95.0 * NORTH, 2.0, ""), (97.0 * NORTH, 2.0, "at 97 m/s (limit 90)"),
    (19.0 * UP, 0.0, ""), (21.0 * UP, 0.0, "climbing or sinking at 21 m/s (limit 20)"),
    (-21.0 * UP, 0.0, "climbing or sinking at 21 m/s (limit 20)"), (-25.0 * UP, 2.0, ""),
    (-27.0 * UP, 2.0, "climbing or sinking at 27"),
])  # fmt: skip
def test_faster_than_any_vehicle_beyond_its_own_doubt(vel_e, sigma, said):
    found = lost(moving(vel_e, sigma))
    assert found.startswith(said) and bool(found) == bool(said)


@pytest.mark.parametrize(("radius", "said"), [
    (6_349_999.0, "-21 km above"), (6_350_001.0, ""), (6_399_999.0, ""),
    (6_400_001.0, "29 km above the Earth's mean radius"),
])  # fmt: skip
def test_no_vehicle_leaves_the_ground(radius, said):
    found = lost(moving(np.zeros(3), radius=radius))
    assert found.startswith(said) and bool(found) == bool(said)


def test_limits_are_the_vehicles():
    assert lost(moving(50.0 * NORTH), Limits(speed=40.0))
    assert lost(moving(9.0 * UP), Limits(height_rate=8.0))
    assert not lost(moving(100.0 * NORTH), Limits(speed=110.0))


def test_one_wild_epoch_is_the_gates_business():
    wild = moving(200.0 * NORTH)
    assert not lost(wild, times=(0.0, 0.99))
    assert lost(wild, times=(0.0, 0.99, 1.0)).endswith("as no vehicle of its kind (vehicle.kind)")
    sanity, sound = Sanity(Limits()), moving(NORTH)
    for time in (0.0, 0.5, 1.0, 1.5):  # wild, sound, wild, wild: half a second at most
        kalman = sound if time == 0.5 else wild
        kalman.time = time
        sanity.look(kalman)


def test_five_doubts_in_thirty_seconds_are_too_many():
    for times, many in (
        ([0.0, 7.5, 15.0, 22.5, 30.0], True), ([0.0, 7.5, 15.0, 22.5, 30.1], False),
        ([0.0, 1.0, 2.0, 3.0], False), ([0.0, 40.0, 41.0, 42.0, 43.0, 44.0], True),
    ):  # fmt: skip
        sanity, raised = Sanity(Limits()), False
        for time in times[:-1]:
            sanity.doubted(time, "velocities")
        try:
            sanity.doubted(times[-1], "position fixes")
        except Lost as error:
            raised = True
            span = 4 if len(times) == 6 else 30
            assert str(error) == (
                f"position fixes and the filter contradict each other: doubted 5 times in {span} s"
            )
        assert raised == many


def accelerated(change_e, seconds, sigmas=(0.0, 0.0), limit=12.0):
    """Return what is said of a velocity that changes by so much in so long."""
    sanity = Sanity(Limits(acceleration=limit))
    try:
        for k in range(6):  # the change lasts in the velocity, and so does what is said of it
            late = min(k, 3)
            kalman = moving(change_e * late / 3.0, sigmas[int(k > 0)])
            kalman.time = late * seconds / 3.0 + 0.6 * max(k - 3, 0)
            sanity.look(kalman)
    except Lost as error:
        return str(error)
    return ""


def test_no_tyre_holds_two_g_for_seconds():
    said = accelerated(60.0 * NORTH, 3.0)
    assert said.startswith("its velocity changed by") and "(limit 12 m/s²)" in said
    assert not accelerated(35.0 * NORTH, 3.0)
    assert not accelerated(60.0 * NORTH, 3.0, limit=21.0)


def test_a_velocity_corrected_by_what_it_was_not_known_to_is_no_acceleration():
    assert not accelerated(60.0 * EAST, 3.0, sigmas=(9.0, 1.0))
