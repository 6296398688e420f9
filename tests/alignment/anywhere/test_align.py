"""Attitude from far away: exact without noise, honest with it, silent where there is nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import certnav
from certnav.alignment.anywhere.align import align_anywhere
from certnav.alignment.local_velocity import LocalTrack
from certnav.alignment.problem import ClockModel
from certnav.alignment.reference.earth_windows import displaced, earth_window
from certnav.alignment.solver.refinement import rotation_angle
from certnav.filters.earth import C_en_of
from certnav.filters.errors import AlignmentError, ConfigError
from certnav.filters.rotation import matrix_from_rpy

CLOCK = ClockModel("random-walk", 0.1)


def faster(track, factor):
    """The track of an odometer whose speeds are too large."""
    return LocalTrack(track.time, track.C_wv, factor * track.vel_w, track.source)


@pytest.mark.parametrize(("distance", "radius"), [(1e3, 1e5), (3e5, 1e6), (2e6, 3e6)])
def test_without_noise_it_is_exact_from_anywhere(distance, radius):
    """The position too, but for the row that says where it is near: 1 m in so many σ of that."""
    rng = np.random.default_rng(2)
    window = earth_window(rng, 7, 30.0, noise=False)
    near = displaced(rng, window.pos_e, distance)
    found = align_anywhere(
        window.signals, window.track, near, radius, speed_scale_sigma=0.0, clock=CLOCK
    )
    assert found.passed and found.located.passed, found.message
    assert rotation_angle(found.C_ew, window.C_ew) < np.radians(1e-3)
    assert np.linalg.norm(found.pos_e - window.pos_e) < 2.0
    assert certnav.align_anywhere is align_anywhere


def test_what_passes_keeps_bound_and_radius():
    """From 100 km, with noise: attitude and position within what is proved of them, all of them."""
    rng, passed, located = np.random.default_rng(20), 0, 0
    for k in range(24):
        window = earth_window(rng, (4, 6, 8)[k % 3], 30.0)
        near = displaced(rng, window.pos_e, 1e5)
        found = align_anywhere(window.signals, window.track, near, 1.5e5, clock=CLOCK)
        off = np.linalg.norm(found.pos_e - window.pos_e)
        if found.passed:
            passed += 1
            assert rotation_angle(found.C_ew, window.C_ew) < found.bound
        if found.located.passed:
            located += 1
            assert off < found.radius < 2e5
        normal = np.linalg.solve(found.pos_cov_e, found.pos_e - window.pos_e)
        assert (found.pos_e - window.pos_e) @ normal < 30.0
    assert passed >= 16 and located >= 16


def test_a_height_locates_three_satellites():
    rng, passed = np.random.default_rng(4), 0
    for _ in range(8):
        window = earth_window(rng, 3, 60.0, sigma=0.02, clock_walk=0.02, motion="circle")
        near, clock = displaced(rng, window.pos_e, 3e4), ClockModel("random-walk", 0.02)
        blind = align_anywhere(window.signals, window.track, near, 5e4, clock=clock)
        found = align_anywhere(window.signals, window.track, near, 5e4, 100.0, clock=clock)
        for one in (blind, found):
            assert not one.passed or rotation_angle(one.C_ew, window.C_ew) < one.bound
        passed += found.passed
    assert passed >= 3


def test_time_and_speed_may_be_wrong():
    """Stamps five minutes early, speeds 3 % too large, 200 km off: all of it comes out."""
    rng = np.random.default_rng(9)
    window = earth_window(rng, 9, 40.0, sigma=0.02, clock_walk=0.02)
    signals = window.signals.later(-300.0)
    near = displaced(rng, window.pos_e, 2e5)
    found = align_anywhere(
        signals, faster(window.track, 1.03), near, 3e5, 300.0, time_sigma=300.0,
        speed_scale_sigma=0.05, clock=ClockModel("random-walk", 0.02),
    )  # fmt: skip
    assert rotation_angle(found.C_ew, window.C_ew) < np.radians(2.0)
    assert found.late == pytest.approx(300.0, abs=60.0)
    assert found.speed_scale == pytest.approx(1.0 / 1.03 - 1.0, abs=0.02)
    exact = align_anywhere(signals, window.track, near, 3e5, 300.0, clock=CLOCK)
    assert not exact.passed


def test_a_scale_that_is_believed_moves_the_position():
    """One per cent of the speeds is kilometres, unless it is an unknown."""
    rng = np.random.default_rng(11)
    window = earth_window(rng, 8, 30.0, noise=False)
    near = displaced(rng, window.pos_e, 1e5)
    off = [
        np.linalg.norm(
            align_anywhere(
                window.signals, faster(window.track, 1.01), near, 1e6, speed_scale_sigma=sigma
            ).pos_e
            - window.pos_e
        )
        for sigma in (0.0, 0.05)
    ]
    assert off[0] > 200.0 > 50.0 > off[1]


def test_a_straight_line_and_too_few_rows_say_what_they_need():
    rng = np.random.default_rng(3)
    window = earth_window(rng, 6, 30.0, motion="line")
    found = align_anywhere(window.signals, window.track, window.pos_e, 1e5)
    assert not found.passed and "needs a turn" in found.message
    with pytest.raises(AlignmentError, match="5 Doppler rows within the track"):
        align_anywhere(window.signals.take(slice(0, 5)), window.track, window.pos_e, 1e5)


def test_gross_rows_are_found_and_too_many_do_not_pass():
    rng = np.random.default_rng(12)
    window = earth_window(rng, 8, 30.0)
    near = displaced(rng, window.pos_e, 5e4)
    for share, ok in ((0.05, True), (0.3, False)):
        gross = rng.random(len(window.signals)) < share
        rate = window.signals.range_rate + gross * rng.uniform(2.0, 8.0, gross.size)
        signals = dataclasses.replace(window.signals, range_rate=rate)
        found = align_anywhere(signals, window.track, near, 1e5)
        assert found.passed is ok, found.message
        if ok:
            assert not found.inliers[gross].any()
            assert rotation_angle(found.C_ew, window.C_ew) < found.bound


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"near": np.zeros(3)}, "near"),
        ({"radius": 0.0}, "radius"),
        ({"height_sigma": -1.0}, "height_sigma"),
        ({"time_sigma": -1.0}, "time_sigma"),
        ({"speed_scale_sigma": 2.0}, "speed_scale_sigma"),
        ({"correlated": 0.5}, "correlated"),
    ],
)
def test_what_cannot_be_is_refused(change, match):
    window = earth_window(np.random.default_rng(1), 5, 10.0)
    known = {"near": window.pos_e, "radius": 1e5} | change
    with pytest.raises(ConfigError, match=match):
        align_anywhere(window.signals, window.track, **known)


def test_a_level_vehicle_makes_up_for_a_turn_that_is_slight():
    """From 100 km: level within 2° the bound is smaller, and right; tilted by 20° it is noticed."""
    rng, better = np.random.default_rng(21), 0
    for _ in range(8):
        window = earth_window(rng, 5, 30.0)
        C_nw = C_en_of(window.pos_e).T @ window.C_ew
        level = matrix_from_rpy([0.0, 0.0, 0.7]).T @ C_nw  # local axes with z downwards
        near = displaced(rng, window.pos_e, 1e5)

        def aligned(turn, sigma, window=window, near=near):
            track = window.track
            turned = LocalTrack(track.time, track.C_wv, track.vel_w @ turn.T, "turned")
            return align_anywhere(
                window.signals, turned, near, 1.5e5, 300.0, clock=CLOCK, level_sigma=sigma
            )

        plain, known = aligned(level, None), aligned(level, np.radians(2.0))
        better += known.bound < plain.bound
        if known.passed:
            assert rotation_angle(known.C_ew, window.C_ew @ level.T) < known.bound
        tilted = aligned(matrix_from_rpy([0.35, 0.0, 0.0]) @ level, np.radians(1.0))
        assert not tilted.passed
    assert better >= 7
