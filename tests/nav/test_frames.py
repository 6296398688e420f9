"""Covariances of recorded rows in north-east-down: C cov Cᵀ, written out with numpy."""

import numpy as np

from certnav.filters.compiled import rows as layout
from certnav.filters.earth import C_en_of, lla_to_ecef
from certnav.nav.pipeline import trajectory_from_rows

UPPER = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


def test_covariances_are_turned_from_their_own_axes():
    """Position and velocity from e, attitude from b; more rows than are turned at once."""
    rng = np.random.default_rng(2)
    n = 9000
    rows = rng.standard_normal((n, layout.ROW_SIZE))
    lat, lon = rng.uniform(-1.5, 1.5, n), rng.uniform(-np.pi, np.pi, n)
    rows[:, 1:4] = lla_to_ecef(lat, lon, rng.uniform(-100.0, 5000.0, n))
    trajectory = trajectory_from_rows(rows)
    C_ne = np.swapaxes(C_en_of(rows[:, 1:4]), 1, 2)
    C_nb = C_ne @ rows[:, 7:16].reshape(-1, 3, 3)
    found = (trajectory.cov_pos_n, trajectory.cov_vel_n, trajectory.cov_att_n)
    for block, (C, cov_n) in enumerate(zip((C_ne, C_ne, C_nb), found, strict=True)):
        at = layout.ROW_COV + 6 * block
        cov = rows[:, at : at + 6][:, UPPER]
        np.testing.assert_allclose(cov_n, C @ cov @ np.swapaxes(C, 1, 2), rtol=0.0, atol=1e-12)


def test_a_single_row():
    row = np.zeros((1, layout.ROW_SIZE))
    row[0, 1:4], row[0, 7:16], row[0, 22:28] = (
        [6378137.0, 0, 0],
        np.eye(3).ravel(),
        [1, 0, 0, 2, 0, 3],
    )
    # On the equator at Greenwich north is z, east y, down −x.
    np.testing.assert_allclose(trajectory_from_rows(row).cov_pos_n[0], np.diag([3.0, 2.0, 1.0]))
