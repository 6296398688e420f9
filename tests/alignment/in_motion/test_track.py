"""Integrals that are kept from window to window: the same as if nothing were."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from certnav.alignment.in_motion import track
from certnav.alignment.in_motion.track import ImuParts
from certnav.filters.strapdown import InertialStream

#: 400 deg/h and 20 mg off, somewhere between the points of the grid.
BIASES = np.array([2.1e-3, -1.7e-3, 0.4e-3, 0.1, -0.17, 0.2])


def arrays(found):
    return {
        field.name: getattr(found, field.name)
        for field in dataclasses.fields(found)
        if field.name not in ("time", "anchor")
    }


def test_other_biases_are_those_that_would_have_been_subtracted(noise_free, monkeypatch):
    """45 s with a turn, carried from the grid or integrated with the biases themselves."""
    time, stream = noise_free.doppler.time, noise_free.stream
    carried = arrays(ImuParts(stream).track(time, BIASES))
    plain = arrays(ImuParts(stream).track(time, 0.0 * BIASES))
    monkeypatch.setattr(track, "_GRID", np.full(6, 1e-12))
    exact = arrays(ImuParts(stream).track(time, BIASES))
    assert np.abs(plain["dv_w"] - exact["dv_w"]).max() > 10.0
    tolerance = {"C_wb": 1e-8, "dv_w": 3e-6, "omega_b": 1e-15, "A": 1e-5, "B": 2e-2, "F": 1e-3}
    for name, most in tolerance.items():
        assert np.abs(carried[name] - exact[name]).max() < most, name


def test_a_window_that_slides_is_the_window_from_scratch(noise_free):
    """To the last digit, whatever was asked before it."""
    time, parts = noise_free.doppler.time, ImuParts(noise_free.stream)
    rng = np.random.default_rng(4)
    for end in range(3, time.size):
        window = time[max(0, end - 20) : end]
        for biases in (0.0 * BIASES, BIASES * rng.normal(size=6)):
            kept = arrays(parts.track(window, biases))
            fresh = arrays(ImuParts(noise_free.stream).track(window, biases))
            for name in kept:
                np.testing.assert_array_equal(kept[name], fresh[name])


def test_every_second_is_integrated_once(noise_free, monkeypatch):
    spans, integrate = [], track.kernels.integrate

    def counted(*arguments):
        spans.append(np.ptp(arguments[6]))
        integrate(*arguments)

    monkeypatch.setattr(track.kernels, "integrate", counted)
    time, parts = noise_free.doppler.time, ImuParts(noise_free.stream)
    for end in range(3, time.size):
        for _ in range(2):
            parts.track(time[max(0, end - 20) : end], 0.0 * BIASES)
    assert sum(spans) == pytest.approx(time[-2] - time[0], abs=0.5)


def test_far_epochs_have_parts_between_them(noise_free):
    """Two instants, or all between them: the same integrals."""
    time, parts = noise_free.doppler.time, ImuParts(noise_free.stream)
    coarse = arrays(parts.track(time[[0, 30, 45]], BIASES))
    fine = arrays(ImuParts(noise_free.stream).track(time, BIASES))
    for name in coarse:
        size = np.abs(fine[name]).max()
        np.testing.assert_allclose(coarse[name], fine[name][[0, 30, 45]], atol=1e-6 * size)


def test_a_stream_that_grows_is_the_recording(noise_free):
    """Two samples past an epoch; with none, the last has no slope yet, which is put right later."""
    batch = noise_free.stream
    live = InertialStream.live(batch.edges[1] - batch.edges[0])
    growing, parts = ImuParts(live), ImuParts(batch)
    time, reached, different = noise_free.doppler.time, 0, []
    for end in range(3, 20):
        until = int(np.searchsorted(batch.edges[1:], time[end - 1] - 1e-9)) + 1 + 2 * (end % 2)
        for k in range(reached, until):
            live.append(batch.edges[k + 1], batch.gyro[k], batch.accel[k])
        reached, window = until, time[max(0, end - 10) : end]
        here, there = growing.track(window, BIASES), parts.track(window, BIASES)
        if end % 2:
            for name, value in arrays(there).items():
                np.testing.assert_array_equal(getattr(here, name), value)
        else:
            different.append(np.abs(here.dv_w - there.dv_w).max())
    assert max(different) > 1e-11  # what must not be kept


def test_rates_are_level_next_to_a_gap():
    """A ramp with a second missing: linear within samples, but not from one side to the other."""
    edges = np.append(np.arange(0.0, 2.05, 0.1), np.arange(3.0, 5.05, 0.1))
    middle = 0.5 * (edges[1:] + edges[:-1])
    gyro = np.outer(middle, [0.0, 0.0, 0.1])
    stream = InertialStream.of_edges(edges, gyro, np.ones((middle.size, 3)))
    at = np.array([1.02, 1.53, 1.92, 2.4, 3.08, 3.57, 4.01])
    found = ImuParts(stream).track(at, np.zeros(6)).omega_b[:, 2]
    level = [0.195, 0.25, 0.305]  # their own means: next to the gap, across it, and after it
    np.testing.assert_allclose(found, [0.102, 0.153, *level, 0.357, 0.401], atol=1e-12)
