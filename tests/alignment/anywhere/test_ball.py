"""The remainders against what linearisation really leaves out."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.alignment.anywhere import ball as ball_module
from certnav.alignment.anywhere.ball import _Remainders, contracted
from certnav.alignment.anywhere.joint import UNIT, Joint, Known, Place
from certnav.alignment.problem import ClockModel
from certnav.alignment.reference.earth_windows import earth_window
from certnav.alignment.solver.constraints import lift
from certnav.alignment.verdict import judge
from certnav.filters.rotation import matrix_from_rotvec


def linearised(seed=3, satellites=6, speed=12.0):
    """A window at its true place, without noise: a joint cost with exact derivatives."""
    window = earth_window(np.random.default_rng(seed), satellites, 20.0, speed=speed, noise=False)
    time = window.signals.time
    known = Known(window.pos_e, 3e5, None, 0.0, 0.0, ClockModel("random-walk", 0.1))
    place = Place(window.pos_e, window.C_ew)
    vel_w, moved_w = window.track.velocity_at(time), window.track.moved_at(time)
    return Joint(window.signals, vel_w, moved_w, known, place, exact=True)


def left_out(joint, off_e, C_ew):
    """Whitened rows of the truth at p + off and a rotation, less the linear ones."""
    sight = joint.signals.at(joint.place.pos_e + off_e + joint.moved_w @ C_ew.T)
    true = np.sum(sight.e_e * (joint.vel_w @ C_ew.T), axis=1) - (sight.z - joint.level)
    white = joint.known.clock.whiten(joint.rows, true[:, None])[:, 0]
    m = joint.stack.shape[1] - 10
    at = np.zeros(m)
    at[joint.clocks : joint.clocks + 3] = off_e / UNIT
    linear = joint.stack @ np.concatenate([at, lift(C_ew)])
    out = np.zeros(len(linear))
    out[: len(white)] = white - linear[: len(white)]
    return out


@pytest.mark.parametrize("speed", [12.0, 300.0])
@pytest.mark.parametrize("distance", [3e3, 3e4, 3e5])
def test_what_is_left_out_is_within_its_bound(distance, speed):
    """In the cost and in the position, for rotations near and far; and the bound is near it."""
    joint, rng = linearised(speed=speed), np.random.default_rng(1)
    remainders, closest = _Remainders(joint), np.zeros(2)
    for angle in (0.0, 0.05, 1.0, np.pi):
        for _ in range(12):
            direction, axis = rng.normal(size=(2, 3))
            off_e = distance * direction / np.linalg.norm(direction)
            C_ew = joint.place.C_ew @ matrix_from_rotvec(angle * axis / np.linalg.norm(axis))
            rest = left_out(joint, off_e, C_ew)
            across = rest - remainders._basis @ (remainders._basis.T @ rest)
            found = np.array([np.linalg.norm(across), np.linalg.norm(remainders._to_place @ rest)])
            bounds = np.array(remainders.of(distance, angle))
            assert np.all(found <= bounds), (angle, found, bounds)
            closest = np.maximum(closest, found / bounds)
    assert np.all(closest > 0.02)


@pytest.mark.parametrize("broken", ["curved", "turned", "way"])
def test_a_bound_without_one_of_its_terms_is_no_bound(broken):
    """Each of the terms is needed somewhere: without it something is left out that it hides."""
    joint, rng = linearised(speed=300.0), np.random.default_rng(2)
    remainders = _Remainders(joint)
    value = getattr(remainders, broken)
    setattr(remainders, broken, (0.0, 0.0) if isinstance(value, tuple) else 0.0 * value)
    exceeded = False
    for distance in (10.0, 1e3, 3e4):
        for angle in (0.0, 0.3, np.pi):
            for _ in range(6):
                direction, axis = rng.normal(size=(2, 3))
                off_e = distance * direction / np.linalg.norm(direction)
                C_ew = joint.place.C_ew @ matrix_from_rotvec(angle * axis / np.linalg.norm(axis))
                rest = left_out(joint, off_e, C_ew)
                across = rest - remainders._basis @ (remainders._basis.T @ rest)
                exceeded |= np.linalg.norm(across) > remainders.of(distance, angle)[0]
    assert exceeded


def test_nothing_is_claimed_where_the_series_is_none():
    """A ball that reaches half way to the satellites."""
    joint = linearised()
    found = contracted(joint, judge(joint.problem), 1.2e7, 0.9973)
    assert not found.contracts and found.bound == np.pi


def test_a_smaller_ball_claims_no_less(monkeypatch):
    joint = linearised()
    result = judge(joint.problem)
    wide, narrow = (contracted(joint, result, r, 0.9973) for r in (3e5, 3e4))
    assert narrow.bound <= wide.bound * 1.01 and narrow.radius <= wide.radius * 1.01
    assert wide.contracts
    monkeypatch.setattr(ball_module, "_ROUNDING", 1e3)
    assert not contracted(joint, result, 3e5, 0.9973).contracts
