"""Alignment windows made to break a certificate, and what their rotations cost to 19 digits.

Numpy alone, and nothing of certnav: neither its simulation nor its cost. A window is drawn, then
bent: towards one line, towards two wells of equal depth, towards rows that outweigh all others.
Costs are sums over the rows in `np.longdouble`, the clock drift removed as their weighted mean:
no matrix is squared, so that they hold where a float64 cost matrix is wrong by thousands of χ².
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

KINDS = ("near-degenerate", "two wells", "tiny sigma", "high speed", "anisotropic")
#: Digits that the costs need; where longdouble is a double they cannot be had.
PRECISE = np.finfo(np.longdouble).eps < 1e-18

Array = np.ndarray


class Attack(NamedTuple):
    """One window: k rows z = e·C v − drift + noise, with one drift."""

    kind: str
    e: Array
    v: Array
    z: Array
    sigma: Array
    epoch: Array
    C: Array


def attacks(seed: int, first: int, last: int) -> Iterator[Attack]:
    """Yield the attacks of these numbers: each is drawn by itself, so that a run can go on."""
    for number in range(first, last):
        rng = np.random.default_rng([seed, number])
        yield _attack(rng, KINDS[number % len(KINDS)])


def _attack(rng: np.random.Generator, kind: str) -> Attack:
    satellites, epochs = int(rng.integers(2, 9)), int(rng.integers(2, 16))
    sigma, speed = 10.0 ** rng.uniform(-2.0, 0.0), 10.0 ** rng.uniform(0.0, 1.6)
    if kind == "tiny sigma" or rng.random() < 0.2:
        sigma = 10.0 ** rng.uniform(-9.0, -3.0)
    if kind == "high speed" or rng.random() < 0.1:
        speed = 10.0 ** rng.uniform(2.0, 5.0)
    e, v = rng.normal(size=(satellites, 3)), rng.normal(size=(epochs, 3))
    if rng.random() < 0.5:
        e[:, 2] = np.abs(e[:, 2])
    thin = 10.0 ** rng.uniform(-9.0, -0.5)
    if kind == "near-degenerate":
        v[:, 1:] *= thin
        if rng.random() < 0.5:
            v[:, 1] /= thin
        if rng.random() < 0.5:
            e = e[0] + e * 10.0 ** rng.uniform(-5.0, 0.0)
    if kind == "two wells":
        v[:, 2] *= thin
        e[:, 2] *= 1.0 if satellites == 2 else 10.0 ** rng.uniform(-9.0, -0.5)
    if kind == "anisotropic":
        v *= 10.0 ** rng.uniform(-5.0, 0.0, size=3)
    e /= np.linalg.norm(e, axis=1, keepdims=True)
    C, turn = rotation(rng.normal(size=4)), rotation(rng.normal(size=4))
    # Neither the sky nor the motion knows the axes that they were thinned along.
    e, v = e @ turn.T, v @ rotation(rng.normal(size=4)).T
    v *= speed / np.abs(v).max()
    epoch, which = np.repeat(np.arange(epochs), satellites), np.tile(np.arange(satellites), epochs)
    e, v = e[which], v[epoch]
    sigma = np.full(len(e), sigma)
    if kind == "anisotropic":
        sigma = sigma * 10.0 ** rng.uniform(-3.0, 3.0, size=len(e))
    exact = np.einsum("ki,ij,kj->k", e, C, v)
    if kind == "two wells":
        # Between what this rotation and its mirror image say: as far from one as from the other.
        other = np.einsum("ki,ij,kj->k", e, mirrored(C, e, v), v)
        share = 0.5 + rng.choice([0.0, 10.0 ** rng.uniform(-12.0, -0.5)]) * rng.choice([-1.0, 1.0])
        exact = share * exact + (1.0 - share) * other if rng.random() < 0.7 else exact
    noise = sigma * rng.normal(size=len(e)) * rng.choice([0.0, 1.0, 1.0, 10.0])
    drift = rng.choice([0.0, rng.uniform(-300.0, 300.0)])
    return Attack(kind, e, v, exact - drift + noise, sigma, epoch, C)


def rotation(q: Array) -> Array:
    """Return the rotation matrix of a quaternion (w, x, y, z) of any length, in its precision."""
    w, x, y, z = q / np.sqrt(np.sum(q * q))
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def mirrored(C: Array, e: Array, v: Array) -> Array:
    """Return the other rotation of two satellites over planar motion: both normals reversed."""
    across_e = np.linalg.svd(e)[2][2]
    across_v = np.linalg.svd(v)[2][2]
    return (
        (np.eye(3) - 2.0 * np.outer(across_e, across_e))
        @ C
        @ (np.eye(3) - 2.0 * np.outer(across_v, across_v))
    )


def angle(C1: Array, C2: Array) -> float:
    """Return the angle between two rotations [deg]."""
    chord = float(np.linalg.norm((C1 - C2).astype(float)))
    return float(np.degrees(2.0 * np.arcsin(min(chord / (2.0 * np.sqrt(2.0)), 1.0))))


class Costs:
    """What rotations cost in one window, and where its wells are."""

    def __init__(self, attack: Attack) -> None:
        wide = np.longdouble
        e, v, z = (np.asarray(a, wide) for a in (attack.e, attack.v, attack.z))
        weight = 1 / np.asarray(attack.sigma, wide)
        rows = np.hstack([(v[:, :, None] * e[:, None, :]).reshape(len(z), 9), -z[:, None]])
        share = weight**2 / np.sum(weight**2)
        self.rows = _triangle((rows - share @ rows) * weight[:, None])

    def __call__(self, C: Array) -> np.longdouble:
        """Return χ² of a rotation matrix, made orthonormal first."""
        residual = self.rows @ _lifted(_orthonormal(C))
        return residual @ residual

    def wells(self, rng: np.random.Generator, extra: list[Array], starts: int = 4) -> list[Array]:
        """Return bottoms reached from `extra` rotations, their half-turns, and random ones."""
        begin = list(extra)
        for C in extra:
            begin += [C @ np.diag(d) for d in ((1.0, -1, -1), (-1.0, 1, -1), (-1.0, -1, 1))]
        begin += [rotation(rng.normal(size=4)) for _ in range(starts)]
        return [self._descended(_orthonormal(C)) for C in begin]

    def _descended(self, C: Array) -> Array:
        """Levenberg–Marquardt; residuals wide, steps double."""
        residual = self.rows @ _lifted(C)
        cost, damping = residual @ residual, 1e-3
        for _ in range(25):
            J = (self.rows[:, :9] @ _tangents(C)).astype(float)
            A, g = J.T @ J, J.T @ residual.astype(float)
            shift = damping * np.trace(A) * np.eye(3)
            step = -np.linalg.lstsq(A + shift, g, rcond=None)[0]
            size = float(np.linalg.norm(step))
            trial = _turned(C, step * min(1.0, 0.5 / max(size, 1e-300)))
            after = self.rows @ _lifted(trial)
            if after @ after < cost:
                C, residual, cost, damping = trial, after, after @ after, damping * 0.05
            else:
                damping = max(10.0 * damping, 1e-12)
            if size < 1e-15 or damping > 1e6:
                break
            damping = max(damping, 1e-16)
        return C


def _triangle(rows: Array) -> Array:
    """Return the triangular factor of a matrix, by Householder reflections in its precision."""
    R = rows.copy()
    for k in range(min(R.shape[0] - 1, R.shape[1])):
        u = R[k:, k].copy()
        size = np.sqrt(u @ u)
        if size == 0:
            continue
        u[0] += size if u[0] >= 0 else -size
        R[k:] -= np.outer(u * (2 / (u @ u)), u @ R[k:])
    return R[: R.shape[1]]


def _lifted(C: Array) -> Array:
    return np.append(C.T.reshape(9), np.longdouble(1))


def _orthonormal(C: Array) -> Array:
    """Newton–Schulz from a matrix that is a rotation to a few digits."""
    C = np.asarray(C, np.longdouble)
    for _ in range(4):
        C = C @ (1.5 * np.eye(3, dtype=np.longdouble) - C.T @ C / 2)
    return C


def _tangents(C: Array) -> Array:
    """Return ∂vec(C·Exp(θ))/∂θ, shape (9, 3)."""
    axes = np.zeros((3, 3, 3), C.dtype)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        axes[i, k, j], axes[i, j, k] = 1, -1
    return np.stack([(C @ axis).T.reshape(9) for axis in axes], axis=1)


def _turned(C: Array, theta: Array) -> Array:
    q = np.append(np.longdouble(1), np.asarray(theta, np.longdouble) / 2)
    return _orthonormal(C @ rotation(q))
