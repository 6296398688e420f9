"""The figures of the report over time, each from a result that was read back."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ...filters.rotation import FloatArray
from ...filters.sensors import STANDARD_GRAVITY
from ..evaluation.accuracy import rpy_covariance, standard_deviation
from ..page.palette import BLUE, GREY, INK, ORANGE, SKY, VERMILLION
from ..page.pictures import WIDTH
from ..page.thinning import thin
from ..results.directory import Result
from ..results.formats import geodetic_and_ned
from .panels import band, finish, line

_NED = ("north", "east", "down")
_RPY = ("roll", "pitch", "heading")


def satellites(result: Result) -> Figure | None:
    """Draw satellites tracked and usable over time; None where nothing tells them."""
    epochs = result.solution.epochs
    if not (epochs.usable >= 0).any():
        return None
    figure = Figure(figsize=(WIDTH, 2.5))
    axes = figure.subplots()
    t = epochs.time - result.solution.trajectory.time[0]
    for count, colour, name in ((epochs.tracked, GREY, "tracked"), (epochs.usable, BLUE, "usable")):
        keep = thin(count.astype(float))
        axes.plot(t[keep], count[keep], color=colour, drawstyle="steps-post", label=name)
    for level in (4, 2):
        axes.axhline(level, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
    axes.set_ylim(0, max(5.0, 1.08 * float(epochs.tracked.max())))
    axes.set_ylabel("satellites")
    axes.yaxis.set_major_locator(MaxNLocator(5, integer=True))
    finish(figure, np.array([[axes]]), result)
    return figure


def position(result: Result) -> Figure:
    """Draw the position errors north, east and down with the filter's ±3σ."""
    trajectory = result.solution.trajectory
    sigma3 = 3.0 * standard_deviation(trajectory.cov_pos_n)
    figure = Figure(figsize=(WIDTH, 5.6))
    grid = figure.subplots(3, 1, sharex=True, squeeze=False)
    for k, axes in enumerate(grid[:, 0]):
        _error_panel(axes, result, result.evaluation.error_pos_n[:, k], sigma3[:, k], _NED[k], "m")
    finish(figure, grid, result)
    return figure


def protection(result: Result) -> Figure | None:
    """Draw the protection levels over the errors, and over σ; None where there are none."""
    trajectory, evaluation = result.solution.trajectory, result.evaluation
    if not np.isfinite(trajectory.protection).any():
        return None
    t = trajectory.time - trajectory.time[0]
    t_error = evaluation.time - trajectory.time[0]
    error, cov = evaluation.error_pos_n, trajectory.cov_pos_n
    sigma = np.sqrt(np.maximum(cov[:, 0, 0], cov[:, 1, 1])), np.sqrt(cov[:, 2, 2])
    off = np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])
    figure = Figure(figsize=(WIDTH, 4.2))
    grid = figure.subplots(2, 1, sharex=True, squeeze=False)
    for k, (axes, name) in enumerate(zip(grid[:, 0], ("horizontal", "vertical"), strict=True)):
        line(axes, t, trajectory.protection[:, k], color=VERMILLION, label="protection level")
        line(axes, t, sigma[k], color=GREY, label="1σ")
        if t_error.size:
            # A zero has no place on a logarithmic axis.
            line(axes, t_error, np.maximum(off[k], 1e-3), color=BLUE, label="error")
        axes.set_yscale("log")
        axes.set_ylabel(f"{name} [m]")
    finish(figure, grid, result)
    return figure


def separation(result: Result) -> Figure | None:
    """Draw forward and backward against smoothed positions, and χ²; None where there are none."""
    found = result.solution.separation
    if found is None:
        return None
    t = found.time - result.solution.trajectory.time[0]
    figure = Figure(figsize=(WIDTH, 7.0))
    grid = figure.subplots(4, 1, sharex=True, squeeze=False)
    known = np.isfinite(found.chi2)
    for k, axes in enumerate(grid[:3, 0]):
        line(axes, t, found.forward_n[:, k], color=BLUE, label="forward − smoothed")
        line(axes, t[known], found.backward_n[known, k], color=ORANGE, label="backward − smoothed")
        axes.set_ylabel(f"{_NED[k]} [m]")
    axes = grid[3, 0]
    line(axes, t[known], np.maximum(found.chi2[known], 1e-3), color=INK, label="χ² between them")
    axes.axhline(3.0, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)))
    axes.set_yscale("log")
    axes.set_ylabel("χ², 3 dof [1]")
    finish(figure, grid, result)
    return figure


def velocity(result: Result) -> Figure:
    """Draw velocity north, east, down, and its errors with ±3σ."""
    _, vel_n, _ = geodetic_and_ned(result.solution.trajectory)
    sigma3 = 3.0 * standard_deviation(result.solution.trajectory.cov_vel_n)
    return _value_and_error(result, vel_n, result.evaluation.error_vel_n, sigma3, _NED, "m/s")


def attitude(result: Result) -> Figure:
    """Draw roll, pitch, heading, and their errors with ±3σ, misalignment removed and raw."""
    trajectory, evaluation = result.solution.trajectory, result.evaluation
    _, _, rpy_deg = geodetic_and_ned(trajectory)
    cov = rpy_covariance(trajectory.cov_att_n, np.deg2rad(rpy_deg))
    sigma3 = 3.0 * np.rad2deg(standard_deviation(cov))
    error, raw = np.rad2deg(evaluation.error_rpy_aligned), np.rad2deg(evaluation.error_rpy)
    return _value_and_error(result, rpy_deg, error, sigma3, _RPY, "deg", raw)


def biases(result: Result) -> Figure:
    """Draw the estimated gyro and accelerometer biases with their ±3σ."""
    trajectory = result.solution.trajectory
    t = trajectory.time - trajectory.time[0]
    per_degph, per_mg = np.rad2deg(1.0) * 3600.0, 1e3 / STANDARD_GRAVITY
    sides = (
        ("gyro", "deg/h", trajectory.gyro_bias * per_degph, trajectory.std_gyro_bias * per_degph),
        ("accelerometer", "mg", trajectory.accel_bias * per_mg, trajectory.std_accel_bias * per_mg),
    )
    figure = Figure(figsize=(WIDTH, 5.2))
    grid = figure.subplots(3, 2, sharex=True)
    for (sensor, unit, bias, std), column in zip(sides, grid.T, strict=True):
        for k, axes in enumerate(column):
            value, sigma3 = bias[:, k], 3.0 * std[:, k]
            band(axes, t, value, sigma3)
            line(axes, t, value, color=BLUE, label="estimate")
            room = min(sigma3.max(), max(np.ptp(value), 1.5 * float(np.median(sigma3)))) or 1.0
            axes.set_ylim(value.min() - 1.1 * room, value.max() + 1.1 * room)
            axes.set_ylabel(f"{'xyz'[k]} [{unit}]")
        column[0].set_title(f"{sensor} bias")
    finish(figure, grid, result)
    return figure


def innovations(result: Result) -> Figure | None:
    """Draw the whitened innovations of each kind of update; None if none was computed."""
    updates = [u for u in result.solution.updates if u.whitened]
    kinds = list(dict.fromkeys(u.kind for u in updates))
    if not kinds:
        return None
    figure = Figure(figsize=(WIDTH, 0.7 + 2.1 * len(kinds)))
    grid = figure.subplots(len(kinds), 2, squeeze=False, width_ratios=[8, 1], sharey=True)
    start = result.solution.trajectory.time[0]
    normal = np.linspace(-6.0, 6.0, 121)
    for kind, (axes, side) in zip(kinds, grid, strict=True):
        samples = [(u.time - start, w, u.accepted, u.accepted and u.reason != "")
                   for u in updates if u.kind == kind for w in u.whitened]  # fmt: skip
        t, w, accepted, overruled = (np.array(column) for column in zip(*samples, strict=True))
        shown = np.clip(w, -6.0, 6.0)
        raster = bool(t.size > 1500)
        axes.plot(t[accepted], shown[accepted], ".", color=BLUE, markersize=2.6, alpha=0.7,
                  rasterized=raster, label="accepted")  # fmt: skip
        axes.plot(t[~accepted], shown[~accepted], "x", color=VERMILLION, markersize=5.5,
                  markeredgewidth=1.4, rasterized=raster, label="rejected by the gate")  # fmt: skip
        if overruled.any():
            axes.plot(
                t[overruled],
                shown[overruled],
                "D",
                color="white",
                markersize=4.0,
                markeredgecolor=ORANGE,
                markeredgewidth=1.4,
                label="gate overruled",
            )
        for level in (-3.0, 3.0):
            axes.axhline(level, color=INK, linewidth=0.8, linestyle=(0, (4, 3)))
        axes.set_title(kind)
        axes.set_ylabel("whitened [1]")
        axes.set_ylim(-6.4, 6.4)
        side.hist(shown, bins=np.linspace(-6, 6, 33), density=True, orientation="horizontal",
                  color=SKY, edgecolor="none")  # fmt: skip
        side.plot(np.exp(-0.5 * normal**2) / np.sqrt(2 * np.pi), normal, color=INK, linewidth=1.0)
        side.set_xticks([])
        side.set_title("against N(0, 1)")
    finish(figure, grid[:, :1], result)
    return figure


def _value_and_error(
    result: Result,
    value: FloatArray,
    error: FloatArray,
    sigma3: FloatArray,
    names: tuple[str, str, str],
    unit: str,
    raw: FloatArray | None = None,
) -> Figure:
    t = result.solution.trajectory.time - result.solution.trajectory.time[0]
    figure = Figure(figsize=(WIDTH, 5.6))
    grid = figure.subplots(3, 2, sharex=True)
    for k, (left, right) in enumerate(grid):
        wrap = 360.0 if names[k] == "heading" else None
        line(left, t, value[:, k], wrap=wrap, color=BLUE, linewidth=0.9)
        if wrap and np.ptp(value[:, k]) > 180.0:
            left.set_yticks(np.arange(0.0, 361.0, 90.0))
        left.set_ylabel(f"{names[k]} [{unit}]")
        _error_panel(right, result, error[:, k], sigma3[:, k], names[k], unit,
                     None if raw is None else raw[:, k])  # fmt: skip
    finish(figure, grid, result)
    return figure


def _error_panel(
    axes: Axes,
    result: Result,
    error: FloatArray,
    sigma3: FloatArray,
    name: str,
    unit: str,
    raw: FloatArray | None = None,
) -> None:
    """Draw one error with its ±3σ and the figures that sum it up; ±3σ alone if there is none."""
    trajectory, evaluation = result.solution.trajectory, result.evaluation
    t = trajectory.time - trajectory.time[0]
    band(axes, t, np.zeros_like(t), sigma3)
    known = np.isfinite(error)
    limit = 1.1 * float(sigma3.max()) or 1.0
    if known.any():
        t_error = evaluation.time - trajectory.time[0]
        largest = float(np.abs(error[known]).max())
        limit = 1.15 * max(largest, min(float(sigma3.max()), 1.6 * largest)) or 1.0
        if raw is not None:
            line(axes, t_error, raw, color=GREY, linewidth=0.9, label="raw")
            most = float(np.abs(raw[known]).max())
            limit = max(limit, 1.1 * most) if most < 4.0 * limit else limit
        label = "error" if raw is None else "misalignment removed"
        line(axes, t_error, error, color=BLUE, label=label)
        inside = np.abs(error[known]) <= np.interp(t_error[known], t, sigma3)
        rms = float(np.sqrt(np.mean(error[known] ** 2)))
        axes.set_title(
            f"{name}: RMS {rms:.3g} {unit}, largest {largest:.3g} {unit}, "
            f"{100.0 * inside.mean():.3g} % within 3σ"
        )
    else:
        axes.set_title(f"{name}: ±3σ of the filter, no reference")
    axes.set_ylim(-limit, limit)
    axes.set_ylabel(f"{name} error [{unit}]")
