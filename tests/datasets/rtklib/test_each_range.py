"""Each range against the others, held against positions solved without it or with it wrong."""

from __future__ import annotations

import numpy as np
import pytest

from certnav.datasets.rtklib.each_range import each_range
from certnav.datasets.rtklib.point_engine import Point


def point(rng, count=8, clocks=1):
    """Return a made-up linearised position with residuals of its own least squares."""
    e = rng.standard_normal((count, 3))
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    clock = np.eye(clocks)[np.arange(count) % clocks]
    sigma = rng.uniform(1.0, 6.0, count)
    noise = 0.8 * sigma
    H = np.hstack([-e, clock])
    r = sigma * rng.standard_normal(count)
    x = np.linalg.lstsq(H / sigma[:, None], r / sigma, rcond=None)[0]
    return Point(
        x[:3], np.eye(3), x[3], np.arange(count), H, r - H @ x, sigma, noise, np.full(count, 1.0)
    )


def solved(point, ranges, keep):
    """Return the position from residual ranges by weighted least squares."""
    weight = 1.0 / point.sigma[keep]
    return np.linalg.lstsq(point.H[keep] * weight[:, None], ranges[keep] * weight, rcond=None)[0]


@pytest.mark.parametrize("clocks", [1, 2])
def test_excess_and_gain_give_the_position_without_the_range(clocks):
    p = point(np.random.default_rng(4), clocks=clocks)
    found = each_range(p, 1.0)
    for i in range(8):
        without = solved(p, p.residuals, np.arange(8) != i)
        np.testing.assert_allclose(-found.gain[:, i] * found.excess[i], without[:3], atol=1e-9)
        # By how much the range is too long, say the others: what their position leaves of it.
        assert found.excess[i] == pytest.approx(p.residuals[i] - p.H[i] @ without)


def test_a_metre_more_moves_the_position_by_the_gain_and_is_seen_as_a_metre():
    p = point(np.random.default_rng(5))
    more = p.residuals + np.eye(8)[3]
    x = solved(p, more, np.ones(8, bool))
    before, after = each_range(p, 1.0), each_range(p._replace(residuals=more - p.H @ x), 1.0)
    np.testing.assert_allclose(before.gain[:, 3], x[:3])
    assert after.excess[3] - before.excess[3] == pytest.approx(1.0)


def test_noise_and_lasting_are_those_of_ranges_that_have_them():
    """10,000 epochs of ranges with the noise, and with what stays, that they are said to have."""
    rng = np.random.default_rng(6)
    p = point(rng)
    found = each_range(p._replace(residuals=np.zeros(8)), 1.0)
    project = np.eye(8) - p.H @ np.linalg.pinv(p.H / p.sigma[:, None]) / p.sigma
    for what, size, own in (("noise", p.noise, 1.0), ("lasting", p.staying, 0.0)):
        errors = size * rng.standard_normal((10_000, 8))
        for i in (0, 5):
            errors_i = errors.copy()
            errors_i[:, i] *= own  # what stays of the range itself is what is asked for
            residuals = errors_i @ project.T
            excess = [each_range(p._replace(residuals=r), 1.0).excess[i] for r in residuals[:2000]]
            assert np.std(excess) == pytest.approx(getattr(found, what)[i], rel=0.08)


def test_four_satellites_say_nothing_of_each_other():
    p = point(np.random.default_rng(7), count=4)
    found = each_range(p, 1.0)
    assert np.isinf(found.noise).all() and np.isinf(found.lasting).all()
    assert (found.excess == 0.0).all()


def test_residuals_too_large_for_sigma_widen_all_but_those_of_the_fault():
    """The range that explains them all by itself is known as well as before, the others are not."""
    p = point(np.random.default_rng(8))
    quiet = p._replace(residuals=np.zeros(8))
    x = solved(p, 60.0 * np.eye(8)[2], np.ones(8, bool))
    loud = each_range(p._replace(residuals=60.0 * np.eye(8)[2] - p.H @ x), 1.0)
    sound = each_range(quiet, 1.0)
    assert loud.noise[2] == pytest.approx(sound.noise[2])
    assert (np.delete(loud.noise, 2) > 1.5 * np.delete(sound.noise, 2)).all()
    # What the recording's residuals say of σ is believed, down to an eighth.
    np.testing.assert_allclose(each_range(quiet, 0.25).noise, 0.5 * sound.noise)
    np.testing.assert_allclose(each_range(quiet, 0.0).noise, sound.noise / 8.0)
