"""The noise of an IMU from a log at rest, by its Allan deviation, and presets as files.

White noise N falls with 1/√τ, σ² = N²/τ, and is fitted where it does; bias instability is where
the deviation is lowest, B = σ_min/0.664 (IEEE Std 952-2020, appendix C). A log that ends before the
minimum has only an upper bound of B. What no log at rest can tell, turn-on spread over many starts,
scale factors and correlation time, is taken from a preset that is named.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..filters.errors import ConfigError, DataError
from ..filters.rotation import FloatArray
from ..filters.sensors import STANDARD_GRAVITY, ImuSpec
from .series import ImuData
from .text.toml_files import read_toml

#: √(2 ln 2 / π): the lowest Allan deviation of flicker noise over its bias instability.
_FLICKER = 0.664
#: Slopes this far from −½ are another noise than white.
_SLOPE = 0.15
#: A deviation known worse than this, relative, decides nothing.
_KNOWN = 0.15
#: And worse than this, no slope.
_SURE = 0.05
#: The deviation has stopped falling where its slope is above this: halfway from white noise.
_FLAT = -0.25
_DEG = 180.0 / np.pi


@dataclass(frozen=True)
class AxisNoise:
    """Noise of one axis of a gyro or an accelerometer.

    Attributes
    ----------
    density, density_sigma : float
        White noise and its 1σ [unit/√Hz].
    instability : float
        Bias instability [unit].
    tau : float
        Averaging time of the lowest deviation [s].
    bounded : bool
        Whether the deviation stops falling: `instability` is an upper bound where it does not.
    """

    density: float
    density_sigma: float
    instability: float
    tau: float
    bounded: bool


def axis_noise(values: FloatArray, interval: float, name: str = "axis") -> AxisNoise:
    """Return the noise of one axis from samples at rest.

    Parameters
    ----------
    values : ndarray, shape (n,)
        [rad/s] or [m/s²].
    interval : float
        [s].
    name : str
        What it is, for the message.

    Raises
    ------
    ConfigError
        The package allantools is not installed.
    DataError
        No white noise in it: smoothed at all averaging times, standing still, or shaken.
    """
    from scipy.optimize import nnls  # slow to import

    try:
        from allantools import oadev
    except ImportError:
        raise ConfigError(
            "an Allan deviation needs the package allantools — pip install 'certnav[allan]'"
        ) from None
    tau, deviation, _, _ = oadev(
        values - values.mean(), rate=1.0 / interval, data_type="freq", taus="octave"
    )
    # Its own error counts overlapping pairs as independent; that of IEEE 952 counts clusters.
    clusters = values.size * interval / tau
    error = deviation / np.sqrt(2.0 * np.maximum(clusters - 1.0, 0.1))
    known = (deviation > 0.0) & (error < _KNOWN * deviation)
    tau, deviation, error = tau[known], deviation[known], error[known]
    slope = np.diff(np.log(deviation)) / np.diff(np.log(tau))
    sure = error[1:] < _SURE * deviation[1:]
    white = np.flatnonzero((np.abs(slope + 0.5) < _SLOPE) & sure)
    if not white.size:
        raise DataError(
            f"{name}: no white noise at any averaging time: smoothed, frozen, or shaken",
            remedy="log raw rates at rest for longer, engine off and nobody in the car",
        )
    lowest = int(np.argmin(deviation + error))  # a dip by chance is none
    # σ² = N²/τ + const from where it is white to the minimum: the flicker is not taken for noise.
    k = slice(int(white[0]), max(lowest, int(white[-1]) + 1) + 1)
    weight = 0.5 / (deviation[k] * error[k])
    design = np.column_stack([1.0 / tau[k], np.ones(tau[k].size)])
    (density, _), _ = nnls(design * weight[:, None], deviation[k] ** 2 * weight)
    return AxisNoise(
        density=float(np.sqrt(density)),
        # one log: its octaves are not independent, and the best of them is all there is
        density_sigma=float((error * np.sqrt(tau))[white].min()),
        instability=float(deviation[lowest] / _FLICKER),
        tau=float(tau[lowest]),
        bounded=bool(slope[-2:].mean() > _FLAT),
    )


def preset_from_rest(imu: ImuData, base: ImuSpec, name: str) -> tuple[ImuSpec, tuple[str, ...]]:
    """Return a preset made of a stretch at rest, and what it rests on in lines.

    Parameters
    ----------
    imu : ImuData
        At rest throughout.
    base : ImuSpec
        Where what a rest cannot tell is taken from; its turn-on biases are widened to those seen.
    name : str

    Returns
    -------
    spec : ImuSpec
        Its worst axis.
    notes : tuple of str
    """
    duration = float(imu.time[-1] - imu.time[0])
    notes, found, bounded = [], [], True
    for what, values, scales, units in (
        ("gyro", imu.gyro_b, (60.0 * _DEG, 3600.0 * _DEG), ("deg/√h", "deg/h")),
        ("accelerometer", imu.accel_b, (60.0, 1e3 / STANDARD_GRAVITY), ("m/s/√h", "mg")),
    ):
        axes = [
            axis_noise(column, imu.interval, f"{what} {letter}")
            for letter, column in zip("xyz", values.T, strict=True)
        ]
        for letter, one in zip("xyz", axes, strict=True):
            limit = "" if one.bounded else " at most: it falls to the end of the log"
            notes.append(
                f"{what} {letter}: {one.density * scales[0]:.3g} ± "
                f"{one.density_sigma * scales[0]:.1g} {units[0]}, bias instability "
                f"{one.instability * scales[1]:.3g} {units[1]} at {one.tau:.3g} s{limit}"
            )
        bounded &= all(one.bounded for one in axes)
        found += [
            max(one.density for one in axes) * scales[0],
            max(one.instability for one in axes) * scales[1],
        ]
    turned = float(np.abs(imu.gyro_b.mean(axis=0)).max()) * 3600.0 * _DEG
    size = float(np.linalg.norm(imu.accel_b.mean(axis=0)))
    off = abs(size - STANDARD_GRAVITY) / STANDARD_GRAVITY * 1e3
    upper = "" if bounded else "; bias instability an upper bound"
    return dataclasses.replace(
        base,
        name=name,
        source=f"Allan deviation of {duration:.0f} s at rest, worst axis{upper}; turn-on, scale "
        f"factors and correlation time of '{base.name}'",
        gyro_arw_deg_sqrth=found[0],
        gyro_bias_instability_degph=found[1],
        gyro_bias_turn_on_degph=max(base.gyro_bias_turn_on_degph, turned),
        accel_vrw_mps_sqrth=found[2],
        accel_bias_instability_mg=found[3],
        accel_bias_turn_on_mg=max(base.accel_bias_turn_on_mg, off),
    ), tuple(notes)


def preset_toml(spec: ImuSpec, notes: tuple[str, ...] = ()) -> str:
    """Return a preset as the text of a file; `read_preset` reads it."""
    lines = [f"# {note}" for note in notes]
    for field in dataclasses.fields(spec):
        value = getattr(spec, field.name)
        text = (
            '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
            if isinstance(value, str)
            else f"{float(value):.6g}"
        )
        lines.append(f"{field.name} = {text}")
    return "\n".join(lines) + "\n"


def read_preset(path: str | Path) -> ImuSpec:
    """Return the preset in a file: the fields of `ImuSpec`, as `preset_toml` writes them.

    Raises
    ------
    DataError
        No such file, or not TOML.
    ConfigError
        An unknown or missing key, or a value that is none.
    """
    file = Path(path)
    values, _ = read_toml(file)
    fields = {field.name: field for field in dataclasses.fields(ImuSpec)}
    for key, value in values.items():
        if key not in fields:
            raise ConfigError.unknown_key(key, fields, where=str(file))
        text = key in ("name", "source")
        if isinstance(value, bool) or not isinstance(value, str if text else int | float):
            expected = "a text" if text else "a number"
            raise ConfigError(f"{file}: {key}: expected {expected}, found {value!r}")
    for key, field in fields.items():
        if key not in values and field.default is dataclasses.MISSING:
            raise ConfigError(f"{file}: {key} is missing")
    return ImuSpec(**values)
