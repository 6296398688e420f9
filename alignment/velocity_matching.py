"""How far a heading is off, from how the velocity changes: no matter what a filter believes.

What accelerometers feel, turned into north and east with a heading that is wrong by ψ, is the true
change of velocity turned by −ψ. Over a window with turns or changes of speed ψ follows in closed
form by least squares from velocities alone, for any ψ up to half a turn: nothing is linearised, so
a filter whose linearisation has led it astray can be held against it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..filters.rotation import FloatArray

#: What may be left in the specific force beside the heading, 1σ [m/s²]: of the accelerometers, in
#: body axes, beyond the bias a filter has taken off; of the level, 3° of it, in north and east.
_ACCEL, _LEVEL = 0.3, 2.0
#: Of the gyro about the vertical, beside the bias that was taken off, 1σ: 0.3 °/s [rad/s].
_GYRO = 0.005
#: Of the velocities beside their own σ: vibration, time stamps, lever arm [m/s].
_FLOOR = 0.15
#: What of specific force and level does not stay the same: 0.05 m/s² (0.3°) for five seconds, as
#: 2 · 0.05² · 5 a random walk of the velocity [m²/s³].
_WALK = 0.025
#: Beyond so many σ a velocity counts less, as of Huber.
_HUBER = 2.0
#: Rounds of weighting anew.
_ROUNDS = 3
#: Information of the unknowns, in the order of `_equations`; that of the heading keeps the matrix
#: regular where nothing turns.
_PRIOR = np.r_[[1e-6] * 2, [_ACCEL**-2] * 3, [_LEVEL**-2] * 2, [1e-6] * 2, [_GYRO**-2] * 2]
#: Accelerations as felt and as seen have to be of like size, and be known to that.
_SCALE, _SCALE_SIGMA = (0.7, 1.4), 0.2


class HeadingOffset(NamedTuple):
    """A heading against the velocities.

    Attributes
    ----------
    offset : float
        True heading less the heading that was used, −π … π [rad].
    sigma : float
        1σ [rad].
    weight : ndarray, shape (n,)
        0 … 1: 1 for velocities that the others bear out.
    scale, sigma_scale : float
        How many times as large the velocities' changes are as what was felt, and 1σ of it.
    """

    offset: float
    sigma: float
    weight: FloatArray
    scale: float = 1.0
    sigma_scale: float = 0.0

    @property
    def tells(self) -> bool:
        """Whether what was felt and what was seen are of like size, and known to be."""
        return bool(_SCALE[0] < self.scale < _SCALE[1] and self.sigma_scale <= _SCALE_SIGMA)

    @property
    def contradicts(self) -> bool:
        """Whether they are not of like size, by more than chance: some velocities are wrong."""
        beyond = max(self.scale - _SCALE[1], _SCALE[0] - self.scale)
        return bool(beyond > 3.0 * self.sigma_scale)


def heading_offset(
    time: FloatArray,
    vel_n: FloatArray,
    sigma: FloatArray,
    felt_n: FloatArray,
    C_nb: FloatArray,
) -> HeadingOffset | None:
    """Return by how much a heading is off, and whether the velocities can tell.

    Parameters
    ----------
    time : ndarray, shape (n,)
        GPS time of the velocities [s].
    vel_n : ndarray, shape (n, 2)
        North and east velocity as GNSS has it [m/s].
    sigma : ndarray, shape (n,)
        1σ of each component [m/s].
    felt_n : ndarray, shape (n, 2)
        Integral of the specific force since the first of the instants, and whatever else turns
        with the heading, in north and east of the heading to be tested [m/s].
    C_nb : ndarray, shape (n, 3, 3)
        Attitude with that heading.

    Returns
    -------
    HeadingOffset or None
        None for fewer than ten velocities.
    """
    count = time.size
    if count < 10:
        return None
    A, y = _equations(time, vel_n, felt_n, C_nb), np.asarray(vel_n, dtype=float)
    flat, size = A.reshape(2 * count, -1), A.shape[2]
    walked = _WALK * np.minimum.outer(time - time[0], time - time[0])
    white = np.hypot(sigma, _FLOOR) ** 2
    weight = np.ones(count)
    for _ in range(_ROUNDS):
        W = np.linalg.inv(walked + np.diag(white / weight))
        weighted = (W @ A.reshape(count, -1)).reshape(-1, size)
        cov = np.linalg.inv(np.diag(_PRIOR) + flat.T @ weighted)
        x = cov @ (weighted.T @ y.ravel())
        rest = y - A @ x
        pulled = W @ rest
        # What a velocity is off from what all others say of it, in its own σ.
        off = np.abs(pulled).max(axis=1) / np.sqrt(np.diag(W))
        if (off <= _HUBER).all():  # nothing to weigh anew
            break
        weight = np.minimum(1.0, _HUBER / np.maximum(off, 1e-9)) * weight
    # Noise that is larger than assumed makes what follows from it worth less.
    cov = cov * max(1.0, float(np.sum(rest * pulled)) / (2 * count - 9))
    cosine, sine = x[:2]
    scale = float(np.hypot(cosine, sine))
    along, across = x[:2] / scale, np.array([-sine, cosine]) / scale
    sigma_offset, sigma_scale = (float(np.sqrt(a @ cov[:2, :2] @ a)) for a in (across, along))
    return HeadingOffset(
        float(np.arctan2(sine, cosine)), sigma_offset / scale, weight, scale, sigma_scale
    )


def _equations(
    time: FloatArray, vel_n: FloatArray, felt_n: FloatArray, C_nb: FloatArray
) -> FloatArray:
    """Return the coefficients, of shape (n, 2, 11).

    They are those of cos ψ, sin ψ, accelerometers (3), level (2), first velocity (2) and gyro (2).

    A turn by ψ about down takes (north, east) to (c·n − s·e, s·n + c·e). A gyro bias β makes ψ
    grow by β t: to first order it adds β cos ψ and β sin ψ times the moments of what was felt.
    """
    count = time.size
    step = np.diff(time, prepend=time[0])
    A = np.zeros((count, 2, 11))
    A[:, :, 0] = felt_n
    A[:, 0, 1], A[:, 1, 1] = -felt_n[:, 1], felt_n[:, 0]
    moment = np.cumsum((time - time[-1])[:, None] * np.diff(felt_n, axis=0, prepend=0.0), axis=0)
    A[:, 0, 9], A[:, 1, 9] = -moment[:, 1], moment[:, 0]
    A[:, :, 10] = -moment
    A[:, :, 2:5] = np.cumsum(C_nb[:, :2, :] * step[:, None, None], axis=0)
    A[:, :, 5:7] = np.eye(2) * (time - time[0])[:, None, None]
    A[:, :, 7:9] = np.eye(2)
    return A
