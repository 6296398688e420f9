"""The error state taken at its word: a state moved by it, and derivatives by differences."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from certnav.filters.rotation import FloatArray, matrix_from_rotvec
from certnav.filters.strapdown import NavState

#: Steps over which predictions are straight and their differences above rounding: position [m],
#: velocity [m/s], attitude [rad], biases [rad/s], [m/s²]; further states.
_STEPS, _MORE = np.repeat([10.0, 1.0, 1e-3, 1e-3, 1.0], 3), 1e-3


def moved(state: NavState, x: FloatArray) -> NavState:
    """Return the state as it would be if the error vector x were added to it."""
    return dataclasses.replace(
        state,
        pos_e=state.pos_e + x[0:3],
        vel_e=state.vel_e + x[3:6],
        C_eb=state.C_eb @ matrix_from_rotvec(x[6:9]),
    )


def central_differences(predict: Callable[[FloatArray], FloatArray], states: int) -> FloatArray:
    """Return the derivative of a prediction with respect to the error state, shape (m, states)."""
    steps = np.concatenate([_STEPS, np.full(states - 15, _MORE)])
    return np.column_stack(
        [
            (predict(s * e) - predict(-s * e)) / (2.0 * s)
            for s, e in zip(steps, np.eye(states), strict=True)
        ]
    )
