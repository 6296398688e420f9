"""The figures of the report, each from a result that was read back.

Every time plot shares one axis, seconds since the first solution epoch, and shades where GNSS fell
short. Lines are thinned to what a page resolves, keeping the extremes of every stretch.
"""

from __future__ import annotations

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from ...filters.earth import C_en_of, lla_to_ecef
from ...filters.rotation import FloatArray
from ...filters.sensors import STANDARD_GRAVITY
from ..evaluation.accuracy import rpy_covariance, standard_deviation, usable_at
from ..page.pictures import BLUE, GREY, INK, ORANGE, SKY, VERMILLION, WIDTH
from ..results.directory import Result
from ..results.formats import geodetic_and_ned

#: Colours of the three GNSS states of `gnss_state`, on the map; and of the shading, behind lines.
STATE_COLOURS = (BLUE, ORANGE, VERMILLION)
_SHADES = (None, "#FBE7BF", "#DCDFE4")

_NED = ("north", "east", "down")
_RPY = ("roll", "pitch", "heading")


def gnss_state(result: Result) -> np.ndarray:
    """Return what GNSS could do at each solution epoch: 0 position, 1 velocity only, 2 nothing.

    From the usable satellites (≥ 4, 2–3, < 2) where there are observations; for a set of fixes,
    2 means that no position was accepted for 3 s or 3 usual intervals.
    """
    time = result.solution.trajectory.time
    usable = usable_at(result.solution.epochs, time)
    if (usable >= 0).all():
        return np.where(usable >= 4, 0, np.where(usable >= 2, 1, 2))
    accepted = [u.time for u in result.solution.updates if u.accepted and u.kind == "position"]
    fixes = np.array([-np.inf, *accepted])
    limit = max(3.0, 3.0 * float(np.median(np.diff(accepted)))) if len(accepted) > 1 else 3.0
    age = time - fixes[np.searchsorted(fixes, time + 1e-6, side="right") - 1]
    return np.where(age <= limit, 0, 2)


def state_names(result: Result) -> tuple[str, str, str]:
    """Return the names of the three states of `gnss_state`."""
    if (result.solution.epochs.usable >= 0).any():
        return ("≥ 4 satellites usable", "2–3 usable", "fewer than 2 usable")
    return ("position fixes accepted", "", "no position accepted")


def thin(values: FloatArray, bins: int = 800) -> np.ndarray:
    """Return indices that keep the least and greatest of `values` in each of `bins` stretches."""
    if values.size <= 2 * bins:
        return np.arange(values.size)
    width = -(-values.size // bins)
    padded = np.full(width * -(-values.size // width), np.nan)
    padded[: values.size] = values
    rows = padded.reshape(-1, width)
    unknown = np.isnan(rows)
    first = np.arange(len(rows)) * width
    low = first + np.where(unknown, np.inf, rows).argmin(axis=1)
    high = first + np.where(unknown, -np.inf, rows).argmax(axis=1)
    return np.unique(np.concatenate([low, high, [0, values.size - 1]]))


def track(result: Result) -> Figure:
    """Draw the track over the reference, metres east and north of the start."""
    trajectory, evaluation = result.solution.trajectory, result.evaluation
    to_ned = C_en_of(trajectory.pos_e[0])
    ned = (trajectory.pos_e - trajectory.pos_e[0]) @ to_ned
    figure = Figure(figsize=(7.2, 6.2))
    axes = figure.subplots()
    if evaluation.has_reference:
        ref_e = lla_to_ecef(*evaluation.ref_lla.T)
        ref = (ref_e - trajectory.pos_e[0]) @ to_ned
        keep = _shape_points(ref)
        axes.plot(ref[keep, 1], ref[keep, 0], color="#111111", linewidth=4.2, alpha=0.28,
                  label="reference")  # fmt: skip
    keep = _shape_points(ned)
    state, north_east = gnss_state(result)[keep], ned[keep]
    for code, (colour, name) in enumerate(zip(STATE_COLOURS, state_names(result), strict=True)):
        mask = state == code
        mask[1:] |= mask[:-1].copy()  # up to the next point, so that no piece is missing
        if (state == code).any():
            line = np.where(mask[:, None], north_east, np.nan)
            axes.plot(line[:, 1], line[:, 0], color=colour, linewidth=1.7 + 0.5 * (code > 0),
                      label=name)  # fmt: skip
    ends = ((ned[0], "o", 6, 6, "start"), (ned[-1], "s", 10, 5, "end"))
    for point, marker, size, layer, name in ends:
        axes.plot(point[1], point[0], marker, color="white", markeredgecolor=INK,
                  markeredgewidth=1.6, markersize=size, zorder=layer, label=name)  # fmt: skip
    _equal_limits(axes, ned)
    _scale_bar(axes, ned)
    axes.set_xlabel("east of start [m]")
    axes.set_ylabel("north of start [m]")
    figure.legend(loc="outside upper left", ncols=4, columnspacing=1.4)
    return figure


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
    _finish(figure, np.array([[axes]]), result)
    return figure


def position(result: Result) -> Figure:
    """Draw the position errors north, east and down with the filter's ±3σ."""
    trajectory = result.solution.trajectory
    sigma3 = 3.0 * standard_deviation(trajectory.cov_pos_n)
    figure = Figure(figsize=(WIDTH, 5.6))
    grid = figure.subplots(3, 1, sharex=True, squeeze=False)
    for k, axes in enumerate(grid[:, 0]):
        _error_panel(axes, result, result.evaluation.error_pos_n[:, k], sigma3[:, k], _NED[k], "m")
    _finish(figure, grid, result)
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
            _band(axes, t, value, sigma3)
            _line(axes, t, value, color=BLUE, label="estimate")
            room = min(sigma3.max(), max(np.ptp(value), 1.5 * float(np.median(sigma3)))) or 1.0
            axes.set_ylim(value.min() - 1.1 * room, value.max() + 1.1 * room)
            axes.set_ylabel(f"{'xyz'[k]} [{unit}]")
        column[0].set_title(f"{sensor} bias")
    _finish(figure, grid, result)
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
    _finish(figure, grid[:, :1], result)
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
        _line(left, t, value[:, k], wrap=wrap, color=BLUE, linewidth=0.9)
        if wrap and np.ptp(value[:, k]) > 180.0:
            left.set_yticks(np.arange(0.0, 361.0, 90.0))
        left.set_ylabel(f"{names[k]} [{unit}]")
        _error_panel(right, result, error[:, k], sigma3[:, k], names[k], unit,
                     None if raw is None else raw[:, k])  # fmt: skip
    _finish(figure, grid, result)
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
    _band(axes, t, np.zeros_like(t), sigma3)
    known = np.isfinite(error)
    limit = 1.1 * float(sigma3.max()) or 1.0
    if known.any():
        t_error = evaluation.time - trajectory.time[0]
        largest = float(np.abs(error[known]).max())
        limit = 1.15 * max(largest, min(float(sigma3.max()), 1.6 * largest)) or 1.0
        if raw is not None:
            _line(axes, t_error, raw, color=GREY, linewidth=0.9, label="raw")
            most = float(np.abs(raw[known]).max())
            limit = max(limit, 1.1 * most) if most < 4.0 * limit else limit
        label = "error" if raw is None else "misalignment removed"
        _line(axes, t_error, error, color=BLUE, label=label)
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


def _line(axes: Axes, t: FloatArray, y: FloatArray, wrap: float | None = None, **style) -> None:
    """Plot a thinned line, broken at holes in time and where an angle wraps."""
    if t.size == 0:
        return
    step = np.diff(t, prepend=t[0])
    hole = step > max(1.5, 5.0 * float(np.median(step)))
    if wrap:
        hole |= np.abs(np.diff(y, prepend=y[0])) > wrap / 2
    keep = np.union1d(thin(y), np.flatnonzero(hole | np.roll(hole, -1)))
    keep = keep if keep.size < 8000 else thin(y)
    piece = np.cumsum(hole)[keep]
    cut = np.flatnonzero(np.diff(piece)) + 1
    marker = "." if keep.size == 1 else None
    axes.plot(np.insert(t[keep], cut, np.nan), np.insert(y[keep], cut, np.nan), marker=marker,
              **style)  # fmt: skip


def _band(axes: Axes, t: FloatArray, centre: FloatArray, sigma3: FloatArray) -> None:
    keep = thin(sigma3, 300)
    low, high = (centre - sigma3)[keep], (centre + sigma3)[keep]
    axes.fill_between(t[keep], low, high, color=SKY, alpha=0.35, edgecolor=SKY, linewidth=0.7,
                      label="±3σ")  # fmt: skip


def _finish(figure: Figure, grid: np.ndarray, result: Result) -> None:
    """Shade the outages, set the common time axis, and put one legend on top."""
    time = result.solution.trajectory.time
    end = max(float(time[-1] - time[0]), 1e-3)
    state, names = gnss_state(result), state_names(result)
    handles: dict[str, Artist] = {}
    for axes in grid.ravel():
        for code in (1, 2):
            bars = _runs(time - time[0], state == code, end)
            if bars:
                axes.broken_barh(bars, (0, 1), transform=axes.get_xaxis_transform(), zorder=0,
                                 facecolor=_SHADES[code], linewidth=0)  # fmt: skip
        axes.set_xlim(0.0, end)
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    for code in (1, 2):
        if (state == code).any():
            handles[names[code]] = Patch(facecolor=_SHADES[code])
    for axes in grid[-1]:
        axes.set_xlabel("time since start [s]")
    figure.legend(list(handles.values()), list(handles), loc="outside upper right", ncols=6,
                  columnspacing=1.4)  # fmt: skip


def _runs(t: FloatArray, mask: np.ndarray, end: float) -> list[tuple[float, float]]:
    """Return (start, width) where `mask` holds; runs closer than a pixel are joined."""
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    starts, stops = t[edges[:-1] == 1], np.append(t, end)[np.flatnonzero(edges == -1)]
    if not starts.size:
        return []
    apart = starts[1:] - stops[:-1] > end / 1500.0
    starts, stops = starts[np.r_[True, apart]], stops[np.r_[apart, True]]
    return [(float(a), float(b - a)) for a, b in zip(starts, stops, strict=True)]


def _shape_points(ned: FloatArray, points: int = 6000) -> np.ndarray:
    return np.unique(np.append(np.arange(0, len(ned), -(-len(ned) // points)), len(ned) - 1))


def _equal_limits(axes: Axes, ned: FloatArray, shape: float = 1.15) -> None:
    """Make a metre the same length both ways, `shape` wide to high, and the map at least 20 m."""
    low, high = ned[:, [1, 0]].min(axis=0), ned[:, [1, 0]].max(axis=0)
    middle, half = (low + high) / 2, np.maximum(0.56 * (high - low), 10.0)
    half = max(half[0] / shape, half[1]) * np.array([shape, 1.0])
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_aspect("equal")


def _scale_bar(axes: Axes, ned: FloatArray) -> None:
    """Draw a bar of 1, 2 or 5 times a power of ten metres in the corner the track leaves free."""
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    target = 0.22 * (right - left)
    decade = 10.0 ** np.floor(np.log10(target))
    length = decade * max(f for f in (1.0, 2.0, 5.0) if f * decade <= target)
    u, v = (ned[:, 1] - left) / (right - left), (ned[:, 0] - bottom) / (top - bottom)
    corners = [(0.04, 0.05), (0.74, 0.05), (0.04, 0.90), (0.74, 0.90)]
    busy = [
        np.sum((np.abs(u - x - 0.11) < 0.15) & (np.abs(v - y - 0.02) < 0.08)) for x, y in corners
    ]
    x, y = corners[int(np.argmin(busy))]
    x, y = left + x * (right - left), bottom + y * (top - bottom)
    axes.plot([x, x + length], [y, y], color=INK, linewidth=2.5, solid_capstyle="butt")
    axes.text(x + length / 2, y + 0.012 * (top - bottom), f"{length:g} m", ha="center", va="bottom")
