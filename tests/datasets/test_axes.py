"""Named axes: every right-handed signed permutation, and none else."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from certnav.datasets.axes import ATTITUDE, axes_matrix, rpy_of
from certnav.datasets.text.imu import AXES
from certnav.filters.errors import ConfigError
from certnav.filters.rotation import matrix_from_rpy, rpy_from_matrix, wrap_angle

FRD = {"F": [1, 0, 0], "B": [-1, 0, 0], "R": [0, 1, 0], "L": [0, -1, 0], "D": [0, 0, 1]}
FRD["U"] = [0, 0, -1]
ALL = ["".join(p) for a in product("FB", "RL", "DU") for p in permutations(a)]


@pytest.mark.parametrize("name", ALL)
def test_every_signed_permutation_is_a_rotation_or_refused(name):
    """x, y, z of the file are the directions named: the columns of C_bs."""
    C = np.column_stack([FRD[letter] for letter in name]).astype(float)
    if np.linalg.det(C) > 0:
        np.testing.assert_array_equal(axes_matrix(name), C)
        np.testing.assert_array_equal(axes_matrix(name.lower()), C)
    else:
        with pytest.raises(ConfigError, match="left-handed"):
            axes_matrix(name)


def test_words_and_the_readers_own_table():
    np.testing.assert_array_equal(axes_matrix("back-right-up"), np.diag([-1.0, 1, -1]))
    np.testing.assert_array_equal(axes_matrix("Front_Left_Up"), AXES["FLU"])
    for name, C_bs in AXES.items():
        np.testing.assert_array_equal(axes_matrix(name), C_bs)


def test_the_left_handed_message_names_a_right_handed_set():
    with pytest.raises(ConfigError, match="'forward-right-down'"):
        axes_matrix("FRU")


@pytest.mark.parametrize("name", ["", "FR", "FRX", "XYZ", "forward-right", "FRDF"])
def test_unknown_names_are_refused(name):
    with pytest.raises(ConfigError, match="expected the directions"):
        axes_matrix(name)


@pytest.mark.parametrize("name", ["FFD", "FBD", "RLU"])
def test_one_axis_twice_is_refused(name):
    with pytest.raises(ConfigError, match="twice"):
        axes_matrix(name)


@pytest.mark.parametrize(
    ("convention", "body", "order"), [("flu-enu", "FLU", "ZYX"), ("rfu-enu", "RFU", "ZXY")]
)
def test_attitude_conventions_describe_the_same_rotation(convention, body, order):
    """Compose the printed angles in their own axes, turn the axes, and take the angles out."""
    rng = np.random.default_rng(1)
    roll, pitch = rng.uniform(-0.5, 0.5, (2, 50))
    yaw = rng.uniform(-np.pi, np.pi, 50)
    # FLU rolls about x and pitches about y, RFU pitches about x and rolls about y
    C_enu_s = Rotation.from_euler(order, np.column_stack([yaw, pitch, roll])).as_matrix()
    ned_from_enu = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])
    C_nb = ned_from_enu @ C_enu_s @ axes_matrix(body).T
    found = rpy_of(np.column_stack([roll, pitch, yaw]), convention)
    np.testing.assert_allclose(wrap_angle(found - rpy_from_matrix(C_nb)), 0.0, atol=1e-12)
    np.testing.assert_allclose(matrix_from_rpy(found), C_nb, atol=1e-12)


def test_unknown_convention_lists_the_known():
    with pytest.raises(ConfigError, match="frd-ned, flu-enu, rfu-enu"):
        rpy_of(np.zeros(3), "ned")
    assert set(ATTITUDE) == {"frd-ned", "flu-enu", "rfu-enu"}
