"""Names of axes: any signed permutation of forward, right and down, and angles about them.

Three letters ('RFU') or three words ('back-right-up') say where x, y and z of a file point.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from ..filters.errors import ConfigError
from ..filters.rotation import FloatArray

#: Direction of each word in forward-right-down axes.
_DIRECTIONS = {
    "forward": (0, 1.0),
    "back": (0, -1.0),
    "right": (1, 1.0),
    "left": (1, -1.0),
    "down": (2, 1.0),
    "up": (2, -1.0),
}
_SYNONYMS = {"front": "forward", "backward": "back", "rear": "back"}
_LETTERS = {word[0]: word for word in _DIRECTIONS}


def axes_matrix(name: str, *, key: str = "axes") -> FloatArray:
    """Return C_bs of named axes: ``x_b = C_bs @ x_s``, b = forward-right-down, shape (3, 3).

    Parameters
    ----------
    name : str
        Directions of x, y, z: 'RFU', 'flu', 'back-right-up'.
    key : str
        What the name stands for, for the message.

    Raises
    ------
    ConfigError
        Unknown directions, the same axis twice, or a left-handed set.
    """
    words = _words(name)
    if words is None:
        raise ConfigError(
            f"{key}: expected the directions of x, y, z such as 'FRD', 'FLU', 'RFU' or "
            f"'back-right-up', found {name!r}"
        )
    C_bs = np.zeros((3, 3))
    for column, word in enumerate(words):
        row, sign = _DIRECTIONS[word]
        C_bs[row, column] = sign
    determinant = round(float(np.linalg.det(C_bs)))
    if determinant == 0:
        raise ConfigError(f"{key}: {name!r} names one axis twice: each of the three needs its own")
    if determinant < 0:
        flipped = "-".join([*words[:2], _opposite(words[2])])
        raise ConfigError(
            f"{key}: {name!r} is left-handed, which no sensor triad is: with these x and y it is "
            f"'{flipped}'"
        )
    return C_bs


def axes_name(C_bs: FloatArray) -> str:
    """Return the name of axes, as 'RFU', from ``x_b = C_bs @ x_s``, a signed permutation (3, 3)."""
    letters = {direction: word[0].upper() for word, direction in _DIRECTIONS.items()}
    rows = np.argmax(np.abs(C_bs), axis=0)
    return "".join(letters[int(r), float(np.sign(C_bs[r, k]))] for k, r in enumerate(rows))


def all_axes() -> FloatArray:
    """Return C_bs of all right-handed signed permutations, shape (24, 3, 3)."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            C_bs = np.zeros((3, 3))
            C_bs[order, range(3)] = signs
            if np.linalg.det(C_bs) > 0.0:
                found.append(C_bs)
    return np.array(found)


def _words(name: str) -> list[str] | None:
    text = name.strip().lower()
    parts = [text[k] for k in range(3)] if len(text) == 3 else text.replace("_", "-").split("-")
    words = [_LETTERS.get(p, _SYNONYMS.get(p, p)) for p in parts]
    return words if len(words) == 3 and all(w in _DIRECTIONS for w in words) else None


def _opposite(word: str) -> str:
    row, sign = _DIRECTIONS[word]
    return next(w for w, (r, s) in _DIRECTIONS.items() if r == row and s == -sign)


#: Attitude conventions by name: (roll, pitch, yaw) as printed → roll, pitch, heading of
#: forward-right-down axes against north-east-down. Named body axes first, then local axes.
ATTITUDE: dict[str, Callable[[FloatArray], FloatArray]] = {
    # roll right side down, pitch nose up, heading clockwise from north: aerospace, INS exports
    "frd-ned": lambda a: a,
    # yaw counter-clockwise from east, pitch nose down +: ROS (REP 103)
    "flu-enu": lambda a: np.stack([a[..., 0], -a[..., 1], np.pi / 2 - a[..., 2]], axis=-1),
    # yaw counter-clockwise from north, pitch nose up +, roll right side down +: PSINS, GREAT
    "rfu-enu": lambda a: np.stack([a[..., 0], a[..., 1], -a[..., 2]], axis=-1),
}


def rpy_of(angles: ArrayLike, convention: str, *, key: str = "attitude_convention") -> FloatArray:
    """Return roll, pitch and heading [rad] of angles printed in a named convention.

    Parameters
    ----------
    angles : array_like, shape (..., 3)
        Roll, pitch, yaw [rad], in that order.
    convention : {'frd-ned', 'flu-enu', 'rfu-enu'}
        See `ATTITUDE`.
    key : str
        For the message.
    """
    if convention not in ATTITUDE:
        raise ConfigError(
            f"{key}: expected one of {', '.join(ATTITUDE)} (body axes, local axes), "
            f"found {convention!r}"
        )
    return ATTITUDE[convention](np.asarray(angles, dtype=float))
