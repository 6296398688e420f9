"""Phase against Doppler: slips, half cycles, jumps of Doppler, and what is left of each."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.observations import GnssObservations
from certnav.velocity.phase_rates import (
    DISAGREES,
    LIMIT,
    UNTRACKED,
    phase_gate,
    phase_intervals,
    with_phase_rates,
)

#: GPS L1, and GLONASS L1 on channel −4.
L1, GLONASS = 299792458.0 / 1575.42e6, 299792458.0 / (1602e6 - 4 * 562.5e3)


def two_satellites(interval=0.2, epochs=20, noise=0.0):
    """A range that accelerates by 1.5 m/s², seen on two wavelengths; rows by epoch."""
    t = interval * np.arange(epochs)
    rate, gone = 300.0 + 1.5 * t, 300.0 * t + 0.75 * t**2
    wavelength = np.tile([L1, GLONASS], epochs)
    n = 2 * epochs
    rng = np.random.default_rng(1)
    return GnssObservations(
        time=np.repeat(t, 2),
        sat=np.tile(["G05", "R12"], epochs),
        signal=np.full(n, "1C"),
        wavelength=wavelength,
        pseudorange=np.full(n, 2.2e7),
        carrier=1e8 + np.repeat(gone, 2) / wavelength,
        range_rate=np.repeat(rate, 2) + noise * rng.standard_normal(n),
        cn0=np.full(n, 45.0),
        loss_of_lock=np.zeros(n, dtype=int),
        sat_pos_e=np.full((n, 3), 2e7),
        sat_vel_e=np.zeros((n, 3)),
        sat_clock=np.zeros(n),
        sat_clock_drift=np.zeros(n),
        elevation=np.full(n, 0.5),
        azimuth=np.zeros(n),
        rejected=np.full(n, ""),
    )


def changed(observations, column, row, by):
    value = getattr(observations, column).copy()
    value[row:] = np.where(
        observations.sat[row:] == observations.sat[row], value[row:] + by, value[row:]
    )
    return observations.with_columns(**{column: value})


def test_the_phase_gives_the_mean_range_rate_on_any_wavelength():
    found = phase_intervals(two_satellites())
    assert found.rate.size == 2 * 19
    # A range of constant acceleration: the mean of the ends is the mean of the interval.
    assert np.abs(found.misfit).max() < 1e-6


def test_sound_rows_pass_and_reasons_are_given():
    assert phase_gate(two_satellites(noise=0.06)).usable.all()


@pytest.mark.parametrize("causal", [False, True])
def test_a_doppler_that_follows_another_signal_is_left_out(causal):
    drive = two_satellites()
    rate = drive.range_rate.copy()
    rate[10:20:2] += 1.0
    marked = phase_gate(drive.with_columns(range_rate=rate), causal=causal)
    assert set(marked.rejected[10:20:2]) == {DISAGREES}
    others = np.setdiff1d(np.arange(40), np.arange(10, 20, 2))
    # While driving, the first row has no interval before it, and the first good one after the
    # fault a bad one.
    spared = others if not causal else np.setdiff1d(others, [0, 1, 20])
    assert marked.usable[spared].all()


@pytest.mark.parametrize("cycles", [0.5, 1.0, -7.0])
def test_a_slip_speaks_against_the_interval_and_not_against_the_rows(cycles):
    """Half a cycle in 0.2 s is 0.48 m/s, more than the gate lets through."""
    slipped = changed(two_satellites(), "carrier", 20, cycles)
    assert (np.abs(phase_intervals(slipped).misfit) > LIMIT).sum() == 1
    assert phase_gate(slipped).usable.all()
    # Rates that reach over it are not taken from the phase.
    rates = with_phase_rates(slipped)
    assert np.abs(rates.range_rate - slipped.range_rate).max() < 1e-6


def test_what_the_receiver_says_of_lock_and_half_cycles_breaks_the_interval():
    drive = two_satellites()
    for bit, broken in ((1, 1), (2, 2)):
        lock = np.zeros(40, dtype=int)
        lock[20] = bit  # half a cycle becomes uncertain, and is resolved again
        found = phase_intervals(drive.with_columns(loss_of_lock=lock))
        assert found.rate.size == 38 - broken


def test_without_unbroken_phase_a_row_is_left_out_unless_nobody_has_any():
    drive = two_satellites()
    carrier = drive.carrier.copy()
    carrier[6:12:2] = np.nan
    marked = phase_gate(drive.with_columns(carrier=carrier))
    assert set(marked.rejected[6:12:2]) == {UNTRACKED}
    assert marked.usable.sum() == 40 - 3
    nothing = drive.with_columns(carrier=np.full(40, np.nan))
    assert phase_gate(nothing).usable.all()


def test_rates_of_the_phase_are_better_than_noisy_doppler():
    noisy, exact = two_satellites(noise=0.06), two_satellites()
    better = with_phase_rates(noisy)
    inner = slice(2, 38)  # the ends have one interval only
    error = np.abs(better.range_rate - exact.range_rate)[inner]
    assert error.max() < 1e-6
    # At 1 Hz half a cycle is 0.1 m/s: nothing is taken that a slip could hide in.
    slow = two_satellites(interval=1.0, noise=0.06)
    np.testing.assert_array_equal(with_phase_rates(slow).range_rate, slow.range_rate)
