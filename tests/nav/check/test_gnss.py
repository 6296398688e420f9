"""GNSS by itself: made-up observations and positions whose fault is known."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.datasets.observations import GnssFixes, GnssObservations
from certnav.filters.earth import SPEED_OF_LIGHT, C_en_at, lla_to_ecef
from certnav.nav.check.gnss import doppler, fixes, pseudoranges, signal_strength
from certnav.velocity.tracks import Track, Tracks

LAT, LON = np.radians([48.0, 11.0])
NOTHING = Tracks(None, None, None, None)
WAVELENGTH = SPEED_OF_LIGHT / 1575.42e6


def observations(rate_factor: float = 1.0, cn0=None, scale: float = 1.0) -> GnssObservations:
    """Return six satellites over 60 s: smooth ranges, a receiver clock with a jump of 1 ms."""
    t = np.repeat(np.arange(60.0), 6)
    sat = np.tile(np.arange(6), 60)
    start, rate = 2.1e7 + 5e5 * sat, -700.0 + 280.0 * sat + 0.1 * t
    clock = 40.0 * t + np.where(t > 30, 1e-3 * SPEED_OF_LIGHT, 0.0)
    noise = np.random.default_rng(0).normal(0.0, 1.0, t.size)
    nan = np.full(t.size, np.nan)
    return GnssObservations(
        time=t, sat=np.char.add("G0", (sat + 1).astype(str)), signal=np.full(t.size, "1C"),
        wavelength=np.full(t.size, WAVELENGTH),
        pseudorange=scale * (start + (-700.0 + 280.0 * sat) * t + 0.05 * t**2 + clock + noise),
        carrier=nan, range_rate=rate_factor * (rate + 40.0),
        cn0=np.tile([38.0, 41, 44, 47, 50, 33], 60) if cn0 is None else np.resize(cn0, t.size),
        loss_of_lock=np.zeros(t.size, dtype=int), sat_pos_e=np.full((t.size, 3), np.nan),
        sat_vel_e=np.full((t.size, 3), np.nan), sat_clock=nan, sat_clock_drift=nan,
        elevation=nan, azimuth=nan, rejected=np.full(t.size, ""),
    )  # fmt: skip


def only(findings):
    (found,) = findings
    return found


def test_doppler_in_order_in_spite_of_a_clock_jump():
    found = only(doppler(observations(), NOTHING))
    assert found.severity == "note"
    assert found.numbers["rate_over_pseudorange_change"] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (-1.0, "the sign is reversed"),
        (1.0 / WAVELENGTH, "the unit is wrong: in Hz"),
        (-1.0 / WAVELENGTH, "the sign is reversed and in Hz"),
        (WAVELENGTH, "multiplied by the wavelength once too often"),
        (0.5, "contradict"),
    ],
)
def test_doppler_faults_are_fatal_and_named(factor, words):
    found = only(doppler(observations(factor), NOTHING))
    assert found.severity == "fatal" and words in found.found


def test_missing_doppler_is_doubtful():
    found = only(doppler(observations(np.nan), NOTHING))
    assert found.severity == "doubtful" and "no Doppler" in found.found


def without_doppler(first: float, last: float, satellites: int = 6) -> GnssObservations:
    """Return observations without the Doppler of the first satellites for a time."""
    whole = observations()
    number = np.char.lstrip(whole.sat, "G").astype(int)
    gone = (whole.time >= first) & (whole.time <= last) & (number <= satellites)
    return whole.with_columns(range_rate=np.where(gone, np.nan, whole.range_rate))


@pytest.mark.parametrize("satellites", [6, 4])
@pytest.mark.parametrize(("first", "last"), [(0.0, 9.0), (20.0, 31.0), (50.0, 59.0)])
def test_doppler_missing_in_part_is_doubtful(first, last, satellites):
    found = only(doppler(without_doppler(first, last, satellites), NOTHING))
    assert found.severity == "doubtful"
    share = 100 * (last - first + 1) / 60
    assert f"missing in {share:.0f} % of the epochs that have ranges" in found.found
    assert f"longest {first:.1f}…{last:.1f} s after the first" in found.found


@pytest.mark.parametrize(("last", "satellites"), [(21.0, 6), (40.0, 2)])
def test_a_second_or_a_few_satellites_without_doppler_are_no_doubt(last, satellites):
    assert only(doppler(without_doppler(20.0, last, satellites), NOTHING)).severity == "note"


@pytest.mark.parametrize(
    ("cn0", "severity", "words"),
    [
        (None, "note", "median"),
        ([4, 5, 6, 7, 8, 9], "doubtful", "signal-strength steps"),
        ([45.0], "doubtful", "constant"),
        ([180, 176, 150, 190], "doubtful", "not dB-Hz"),
        ([0.4, 0.5, 0.6], "doubtful", "not dB-Hz"),
        ([28, 30, 31, 33, 40], "doubtful", "are below gnss.min_cn0_dbhz"),
        ([np.nan], "doubtful", "none in the data"),
    ],
)
def test_signal_strength(cn0, severity, words):
    found = only(signal_strength(observations(cn0=cn0), 35.0))
    assert found.severity == severity and words in found.found


def test_pseudorange_unit():
    assert pseudoranges(observations()) == []
    assert only(pseudoranges(observations(scale=1e-3))).severity == "fatal"


def carried(velocity=lambda v: v, place=lambda lla: lla) -> GnssFixes:
    """Return positions of a winding, hilly drive, with faults in velocity or place."""
    t = np.arange(0.0, 200.0, 0.5)
    vel_n = np.column_stack([12 * np.cos(0.05 * t), 9 * np.sin(0.05 * t), -0.8 * np.sin(0.1 * t)])
    moved = np.column_stack(
        [240 * np.sin(0.05 * t), -180 * np.cos(0.05 * t), 8 * (np.cos(0.1 * t) - 1)]
    )
    radius = 6.37e6
    lla = np.column_stack(
        [LAT + moved[:, 0] / radius, LON + moved[:, 1] / radius / np.cos(LAT), 500 - moved[:, 2]]
    )
    lla = place(lla)
    C_en = C_en_at(lla[:, 0], lla[:, 1])
    cov = np.tile(np.eye(3), (t.size, 1, 1))
    return GnssFixes(
        t, lla_to_ecef(*lla.T), cov, np.einsum("nij,nj->ni", C_en, velocity(vel_n)), 0.01 * cov,
        np.full(t.size, 8), np.full(t.size, "single"),
    )  # fmt: skip


def test_positions_and_velocities_in_order():
    found = only(fixes(carried(), NOTHING))
    assert found.severity == "note" and "also vertically" in found.found


def test_without_any_velocity_a_run_cannot_start():
    bare = dataclasses.replace(carried(), vel_e=np.full((len(carried()), 3), np.nan))
    found = only(fixes(bare, NOTHING))
    assert found.severity == "fatal" and found.subject == "GNSS velocity"
    computable = Tracks(None, Track("Doppler", bare.time, bare.pos_e, carried().vel_e), None, None)
    assert only(fixes(bare, computable)).severity == "note"


@pytest.mark.parametrize(
    ("fault", "subject", "words"),
    [
        ({"velocity": lambda v: v[:, [1, 0, 2]]}, "GNSS velocity", "north and east are swapped"),
        ({"velocity": lambda v: v * [1, 1, -1]}, "GNSS velocity", "down component"),
        ({"velocity": lambda v: -v}, "GNSS velocity", "sign is reversed"),
        ({"velocity": lambda v: 3.6 * v}, "GNSS velocity", "km/h"),
        ({"velocity": lambda v: v * 3600 / 1852}, "GNSS velocity", "knots"),
        ({"place": lambda p: p[:, [1, 0, 2]]}, "GNSS position", "longitude are swapped"),
        ({"place": lambda p: p * [*np.radians([1, 1]), 1]}, "GNSS position", "in radians"),
        ({"place": lambda p: p * [1, 1, 0]}, "GNSS height", "missing"),
        ({"place": lambda p: np.add(p, [0, 0, 2e4])}, "GNSS height", "no road"),
    ],
)
def test_faults_of_positions_are_fatal_and_named(fault, subject, words):
    found = [f for f in fixes(carried(**fault), NOTHING) if f.severity == "fatal"]
    assert any(f.subject == subject and words in f.found for f in found), found
