"""An odometer against GNSS: delays and scales that were put in come out, with an honest σ."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.velocity.wheel_speed import wheel_speed


def drive(delay, scale, seed=0, noise=0.05, seconds=400.0, swing=6.0):
    """Return an odometer at 20 Hz and GNSS speeds at 1 Hz of a drive that speeds up and brakes."""
    rng = np.random.default_rng(seed)
    knots = np.arange(0.0, seconds + 30.0, 10.0)
    speeds = np.clip(8.0 + swing * rng.normal(size=knots.size), 0.0, 20.0)

    def v(t):
        return np.interp(t, knots, speeds)

    time = np.arange(0.0, seconds, 0.05)
    known = np.arange(5.0, seconds - 5.0)
    wheel = v(time - delay) / scale
    return time, wheel, known, v(known) + noise * rng.normal(size=known.size)


@pytest.mark.parametrize("delay", [-0.3, 0.0, 0.013, 0.5, 0.642, 1.4])
@pytest.mark.parametrize("scale", [1.0, 1.02, 0.1966])
def test_what_was_put_in_comes_out(delay, scale):
    found = wheel_speed(*drive(delay, scale))
    assert abs(found.delay - delay) < 4.0 * found.delay_sigma + 0.005 < 0.06
    assert found.scale == pytest.approx(scale, rel=0.005)
    noiseless = wheel_speed(*drive(delay, scale, noise=0.0))
    assert noiseless.delay == pytest.approx(delay, abs=0.01)


def test_sigma_is_that_of_many_drives():
    """Delays of 100 drives scatter as each of them says."""
    found = [wheel_speed(*drive(0.5, 1.0, seed, noise=0.2)) for seed in range(100)]
    z = np.array([(f.delay - 0.5) / f.delay_sigma for f in found])
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.6 and np.abs(z).max() < 5.0


def test_reflections_do_no_harm_and_a_sign_is_none():
    time, wheel, known, v = drive(0.5, 1.0)
    spoiled = v.copy()
    spoiled[::9] += 15.0
    found = wheel_speed(time, wheel, known, spoiled)
    assert found.delay == pytest.approx(0.5, abs=0.02)
    assert found.scale == pytest.approx(1.0, abs=0.005)
    assert wheel_speed(time, -wheel, known, v).delay == pytest.approx(0.5, abs=0.02)


def test_what_does_not_tell_is_not_told():
    time, wheel, known, v = drive(0.5, 1.0)
    assert wheel_speed(time, wheel, known[:30], v[:30]) is None  # too short
    assert wheel_speed(*drive(0.5, 1.0, swing=0.0)) is None  # no change of speed
    assert wheel_speed(time, 0.0 * wheel, known, v) is None  # a sensor that is off
    assert wheel_speed(*drive(3.0, 1.0)) is None  # later than is looked for
    rng = np.random.default_rng(1)
    assert wheel_speed(time, rng.uniform(0.0, 15.0, time.size), known, v) is None  # another drive
