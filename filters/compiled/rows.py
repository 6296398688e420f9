"""What the filter records at an output epoch: one row of numbers, and where each stands in it."""

from __future__ import annotations

import numpy as np

from .jit import njit

# Columns of a recorded row.
ROW_TIME, ROW_POS, ROW_VEL, ROW_C = 0, 1, 4, 7
ROW_BIAS, ROW_COV, ROW_STD_BIAS = 16, 22, 40
ROW_SIZE = 46


@njit(cache=True)
def record(row, t, pos, vel, C, bias, P):
    """Write time, state, the three 3×3 covariance blocks (upper triangles) and bias σ to `row`."""
    row[ROW_TIME] = t
    for i in range(3):
        row[ROW_POS + i] = pos[i]
        row[ROW_VEL + i] = vel[i]
        for j in range(3):
            row[ROW_C + 3 * i + j] = C[i, j]
    for i in range(6):
        row[ROW_BIAS + i] = bias[i]
    if P.shape[0] == 0:
        return
    for i in range(6):
        row[ROW_STD_BIAS + i] = np.sqrt(P[9 + i, 9 + i])
    k = ROW_COV
    for block in range(3):
        for i in range(3):
            for j in range(i, 3):
                row[k] = P[3 * block + i, 3 * block + j]
                k += 1
