"""Errors of positions from their innovations: known ones are found again, whatever their kind."""

import dataclasses

import numpy as np
import pytest

from certnav.nav.engine.fix_noise.estimate import (
    ALLOWANCE,
    STEADY,
    Innovations,
    fit,
    parts,
    usual_variance,
)
from certnav.nav.engine.fix_noise.likelihood import log_likelihood

SIGMA, WALK = np.array([1.0, 1.0, 2.0]), 0.05


def errors(rng, n, scale, share, correlation, dt=1.0):
    """Errors of successive positions, part of which lasts."""
    fade = np.exp(-dt / correlation)
    b = np.zeros((n, 3))
    b[0] = rng.standard_normal(3)
    for k in range(1, n):
        b[k] = fade * b[k - 1] + np.sqrt(1.0 - fade**2) * rng.standard_normal(3)
    own = rng.standard_normal((n, 3))
    return scale * SIGMA * (np.sqrt(share) * b + np.sqrt(1.0 - share) * own)


def seen(rng, e, dt=1.0, declared=SIGMA**2):
    """What a filter that wanders off from the first of them sees of them."""
    n = len(e)
    o = np.cumsum(WALK * np.sqrt(dt) * rng.standard_normal((n, 3)), axis=0)
    P = np.repeat(np.arange(n)[:, None] * WALK**2 * dt, 3, axis=1)
    V = np.broadcast_to(declared, (n, 3)).copy()
    return Innovations(np.arange(n) * dt, e - e[0] + o, P, V, np.ones(n))


@pytest.mark.parametrize("scale", [0.2, 1.0, 4.0])
def test_errors_of_their_own_are_taken_for_that(scale):
    rng = np.random.default_rng(1)
    found = fit(seen(rng, errors(rng, 300, scale, 0.0, 1.0)), reflections=False)
    assert found.share == 0.0 and found.correlation_s == 0.0 and found.meaning == STEADY
    # ln of the scale of n vectors has a σ of 1/√(6 n).
    assert found.scale == pytest.approx(scale, rel=4.0 / np.sqrt(6.0 * 300))
    assert found.spread == pytest.approx(1.0 / np.sqrt(6.0 * 300), rel=0.5)


@pytest.mark.parametrize(("scale", "share", "correlation"), [(1.0, 0.9, 10.0), (3.0, 0.5, 20.0)])
def test_errors_that_last_are_found_with_scale_share_and_time(scale, share, correlation):
    """Over a drive of many correlation times; of three drives each, in the mean of logarithms."""
    made = []
    for seed in range(3):
        rng = np.random.default_rng([2, seed])
        made.append(fit(seen(rng, errors(rng, 900, scale, share, correlation)), reflections=False))
    off = [
        (np.log(f.scale / scale), np.log(f.share / (1 - f.share)) - np.log(share / (1 - share)),
         np.log(f.correlation_s / correlation))
        for f in made
    ]  # fmt: skip
    assert (np.abs(np.mean(off, axis=0)) < [0.25, 0.5, 0.5]).all()
    assert all(f.gain > 50.0 for f in made)


def two_state_nees(found, e):
    """NEES of the position of a filter that has the noise that was found, at its end."""
    V = found.declared_n
    fit_ = fit(found, reflections=False)
    own = fit_.scale**2 * (1.0 - fit_.share) * V[0]
    h = fit_.scale * np.sqrt(fit_.share * V[0])
    total = 0.0
    for i in range(3):
        x, P = np.zeros(2), np.array([[100.0**2, 0.0], [0.0, 1.0]])
        for k in range(len(found)):
            if k:
                fade = np.exp(-1.0 / fit_.correlation_s) if fit_.correlation_s else 0.0
                F = np.diag([1.0, fade])
                x, P = F @ x, F @ P @ F.T + np.diag([WALK**2, 1.0 - fade**2])
            H = np.array([1.0, h[i]])
            K = P @ H / (H @ P @ H + own[i])
            # The filter's own drift is what it estimates: its innovation less the error is o.
            x, P = x + K * (found.value_n[k, i] - H @ x), P - np.outer(K, H @ P)
        truth = found.value_n[-1, i] - e[-1, i]
        total += (x[0] - truth) ** 2 / P[0, 0]
    return total


@pytest.mark.parametrize("scale", [1 / 3, 1.0, 3.0])
def test_a_filter_with_the_noise_that_was_found_is_honest(scale):
    """Declared three times too small or too large, and lasting: NEES is 3, or somewhat less.

    White errors of the declared σ in place of that make it up to 200.
    """
    values = []
    for seed in range(6):
        rng = np.random.default_rng([3, seed])
        e = errors(rng, 180, scale, 0.9, 20.0)
        values.append(two_state_nees(seen(rng, e), e))
    assert 0.75 < np.mean(values) < 6.0


def test_what_is_allowed_for_reflections_stays():
    """Quiet positions, and for half of the time a σ ten times as large that comes true."""
    rng = np.random.default_rng(4)
    worse, run = np.arange(200) % 20 >= 10, np.arange(200) // 10
    V = SIGMA**2 * np.where(worse, 100.0, 1.0)[:, None]
    e = errors(rng, 200, 0.2, 0.0, 1.0)
    e += np.where(worse, 10.0, 0.0)[:, None] * SIGMA * rng.standard_normal((20, 3))[run]
    kept = np.where(np.diff(run, prepend=0) > 0, 0.0, 1.0)  # other satellites each time
    found = seen(rng, e, declared=V)
    assert fit(found, reflections=False).scale > 0.6  # one scale for both fits neither
    found = fit(dataclasses.replace(found, kept=kept), reflections=True)
    assert found.meaning == ALLOWANCE and found.scale < 0.4
    np.testing.assert_allclose(found.usual_n, SIGMA**2)


def test_parts_add_up():
    """Whatever a variance is divided into, with a scale of 1 it is what was declared."""
    V = np.random.default_rng(5).uniform(1.0, 9.0, (50, 3))
    W, U, C, D = parts(V, np.full((50, 1), 0.3), ALLOWANCE)
    for share in (0.0, 0.4, 1.0):
        np.testing.assert_allclose(share * W + C + (1.0 - share) * U + D, V)
    W, U, C, D = parts(V, usual_variance(V, STEADY), STEADY)
    np.testing.assert_allclose(W, np.tile(np.median(V, axis=0), (50, 1)))
    np.testing.assert_array_equal(U, V)
    assert not C.any() and not D.any()


def test_satellites_that_change_take_their_error_along():
    """Errors that jump where satellites change, and are constant between: so they are found."""
    rng = np.random.default_rng(6)
    jump = np.arange(300) % 25 == 0
    e = (SIGMA * rng.standard_normal((12, 3)))[np.cumsum(jump) - 1]
    e = e + 0.05 * SIGMA * rng.standard_normal(e.shape)
    found = seen(rng, e)
    told = fit(dataclasses.replace(found, kept=np.where(jump, 0.0, 1.0)), reflections=False)
    untold = fit(found, reflections=False)
    assert told.scale == pytest.approx(1.0, rel=0.4)
    assert told.correlation_s > 3.0 * untold.correlation_s
    assert told.gain > untold.gain + 50.0


def test_thinning_keeps_time_and_what_satellites_have_changed():
    n = 7001
    kept = np.ones(n)
    kept[[4, 5, 3000]] = 0.5
    found = Innovations(np.arange(n) / 10.0, *(np.ones((n, 3)) for _ in range(3)), kept)
    thin = found.thinned()
    assert len(thin) == 2334 and thin.time[1] == pytest.approx(0.3)
    assert thin.kept[2] == pytest.approx(0.25) and thin.kept[1000] == pytest.approx(0.5)
    assert np.prod(thin.kept) == pytest.approx(0.125)
    assert len(found.thinned().thinned()) == 2334


def test_likelihood_is_that_of_the_joint_distribution():
    """Of innovations of nothing ln |S|; of small ones the NIS, times 18/13 for the tails."""
    rng = np.random.default_rng(7)
    n, scale, share, tau = 6, 1.3, 0.7, 4.0
    t = np.cumsum(rng.uniform(0.5, 2.0, n))
    V = rng.uniform(0.5, 2.0, (n, 3))
    P = np.cumsum(np.full((n, 3), 0.2), axis=0)
    shape = parts(V, usual_variance(V, STEADY), STEADY)
    dt, drift = np.diff(t, prepend=t[0]), np.diff(P, axis=0, prepend=P[:1])

    def joint(z):
        """ln p of z₁ … given z₀, by the covariance of z_k − z₀ = Δo + (hb + v)_k − (hb + v)_0."""
        total = 0.0
        for i in range(3):
            h2, r = scale**2 * share * np.median(V[:, i]), scale**2 * (1 - share) * V[:, i]
            S = h2 * np.exp(-np.abs(t[:, None] - t) / tau) + np.diag(r)
            T = np.eye(n)[1:] - np.eye(n)[0]
            walk = np.minimum.outer(P[1:, i] - P[0, i], P[1:, i] - P[0, i])
            S = T @ S @ T.T + walk
            y = T @ z[:, i]
            total += -0.5 * y @ np.linalg.solve(S, y) - 0.5 * np.linalg.slogdet(S)[1]
        return total

    def ours(z):
        work = np.empty(n), np.empty(n)
        return log_likelihood(dt, np.ones(n), z, drift, shape, scale, share, tau, *work)

    z = 1e-3 * rng.standard_normal((n, 3))
    work = np.empty(n), np.empty(n)
    log_likelihood(dt, np.ones(n), z, drift, shape, scale, share, tau, *work)
    assert ours(0.0 * z) == pytest.approx(joint(0.0 * z), rel=1e-4)
    # Where tails do not matter yet, ln(1 + x/13)·18/2 is 18/26 x.
    large = 30.0 * z
    assert (ours(large) - ours(0.0 * z)) * 13.0 / 9.0 / 2.0 == pytest.approx(
        (joint(large) - joint(0.0 * z)), rel=0.02
    )
