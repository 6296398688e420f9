"""The map of the report: the track over its reference, coloured by what the reader chooses."""

from __future__ import annotations

import json

import numpy as np
from bokeh.models import (
    ColorBar,
    Line,
    LinearColorMapper,
    Scatter,
    Segment,
    TileRenderer,
    WMTSTileSource,
)
from bokeh.palettes import Cividis256
from bokeh.plotting import figure

from ...filters.earth import ecef_to_lla
from ...filters.rotation import FloatArray
from ..evaluation.accuracy import standard_deviation
from ..evaluation.interpolation import usable_at
from ..page.board import Board
from ..page.palette import BLUE, INK, ORANGE, VERMILLION
from ..page.plots import look
from ..page.thinning import thin
from ..results.directory import Result
from ..results.formats import geodetic_and_ned
from .coverage import gnss_state

#: Of the ellipsoid: Web Mercator is spherical.
_RADIUS = 6378137.0
_POINTS = 4000
#: Stretches of which least and greatest are kept besides.
_BINS = 300
_TILES = "https://tile.openstreetmap.org/{Z}/{X}/{Y}.png"
_CREDIT = '© <a href="https://www.openstreetmap.org/copyright">OpenStreetMap</a> contributors'


def track_map(result: Result, board: Board) -> str:
    """Return the map with its controls."""
    plot, kinds = _draw(result, board)
    options = "".join(f'<option value="{k}">{v["title"]}</option>' for k, v in kinds.items())
    text = json.dumps(kinds)
    return (
        f'<p class="controls"><label>Colour <select id="track-colour">{options}</select></label> '
        '<button id="track-tiles" type="button" aria-pressed="false">Map behind the track</button> '
        '<span class="note">loads pictures from tile.openstreetmap.org, which then knows where '
        "this drive was; nothing else of this page uses the network.</span></p>\n"
        f"{board.place([[plot]], 'Track of the vehicle, north up')}\n"
        f'<script type="application/json" id="track-kinds">{text}</script>'
    )


def mercator(lla: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Web Mercator x, y [m] of latitude and longitude [rad]."""
    return _RADIUS * lla[:, 1], _RADIUS * np.arcsinh(np.tan(lla[:, 0]))


def _draw(result: Result, board: Board) -> tuple[figure, dict[str, dict]]:
    trajectory, evaluation = result.solution.trajectory, result.evaluation
    plot = figure(
        height=480, sizing_mode="stretch_width", match_aspect=True, toolbar_location="above",
        x_axis_type="mercator", y_axis_type="mercator",
        tools="pan,wheel_zoom,box_zoom,reset,save",
    )  # fmt: skip
    look(plot)
    plot.xaxis.axis_label, plot.yaxis.axis_label = "longitude [°]", "latitude [°]"
    plot.xaxis.ticker.desired_num_ticks = 4
    plot.renderers.append(
        TileRenderer(
            tile_source=WMTSTileSource(url=_TILES, attribution=_CREDIT), visible=False,
            name="tiles", level="image", alpha=0.8,
        )
    )  # fmt: skip
    if evaluation.has_reference:
        x, y = mercator(evaluation.ref_lla[:: -(-evaluation.time.size // _POINTS)])
        glyph = Line(line_color=INK, line_alpha=0.25, line_width=7, line_join="round")
        board.draw(plot, board.source({"x": x, "y": y}), glyph, "reference")
    values = _values(result)
    keep = np.arange(0, len(trajectory), -(-len(trajectory) // _POINTS))
    for _, value in values.values():  # and where each is least and greatest
        keep = np.union1d(keep, thin(value, _BINS))
    x, y = mercator(ecef_to_lla(trajectory.pos_e[keep]))
    columns, kinds = _colours(result, values, keep)
    first = kinds[next(iter(kinds))]
    mapper = LinearColorMapper(
        palette=first["palette"], low=first["low"], high=first["high"], name="track-colours"
    )
    source = board.source(
        {"t": trajectory.time[keep] - board.start, "x": x, "y": y, "x1": np.roll(x, -1),
         "y1": np.roll(y, -1), **columns, "c": columns[next(iter(kinds))]},
        name="track",
    )  # fmt: skip
    source.data["x1"][-1], source.data["y1"][-1] = x[-1], y[-1]
    glyph = Segment(
        x0="x", y0="y", x1="x1", y1="y1", line_width=3, line_cap="round",
        line_color={"field": "c", "transform": mapper},
    )  # fmt: skip
    drawn = board.draw(plot, source, glyph, "solution")
    tips = [("", "@t{0.00} s since start")]
    tips += [(kind["title"], f"@{name}{{0.00}}") for name, kind in kinds.items() if name != "state"]
    board.tell(plot, drawn, *tips)
    ends = (("start", 0, "circle", 10), ("end", -1, "square", 9))
    for label, k, marker, size in ends:
        glyph = Scatter(marker=marker, size=size, fill_color="white", line_color=INK, line_width=2)
        board.draw(plot, board.source({"x": x[[k]], "y": y[[k]]}), glyph, label)
    here = board.source({"x": [], "y": []}, name="here")
    board.draw(plot, here, Scatter(size=16, fill_color=None, line_color=VERMILLION, line_width=3))
    plot.add_layout(
        ColorBar(color_mapper=mapper, width=10, title=first["title"], name="track-bar", padding=6,
                 title_text_font_style="normal", title_text_font_size="12px",
                 background_fill_alpha=0.0), "right",
    )  # fmt: skip
    for axis in (plot.x_range, plot.y_range):
        axis.range_padding, axis.default_span = 0.06, 30.0
    return plot, kinds


def _values(result: Result) -> dict[str, tuple[str, FloatArray]]:
    """Return title and value, at each epoch, of what a track may be coloured by."""
    trajectory, evaluation = result.solution.trajectory, result.evaluation
    _, vel_n, _ = geodetic_and_ned(trajectory)
    std = standard_deviation(trajectory.cov_pos_n)
    found = {
        "sigma": ("horizontal σ [m]", np.hypot(std[:, 0], std[:, 1])),
        "speed": ("speed [m/s]", np.hypot(vel_n[:, 0], vel_n[:, 1])),
    }
    if evaluation.has_reference:
        error = np.hypot(*evaluation.error_pos_n[:, :2].T)
        at = np.interp(trajectory.time, evaluation.time, error, left=np.nan, right=np.nan)
        found = {"error": ("horizontal error [m]", at), **found}
    return found


def _colours(
    result: Result, found: dict[str, tuple[str, FloatArray]], keep: np.ndarray
) -> tuple[dict[str, FloatArray], dict[str, dict]]:
    """Return the columns that a track may be coloured by, and how."""
    columns = {name: value[keep].astype("f4") for name, (_, value) in found.items()}
    kinds = {}
    for name, (title, value) in found.items():
        top = float(np.nanpercentile(value, 99.0)) or 1.0
        kinds[name] = {"title": title, "palette": list(Cividis256[::4]), "low": 0.0, "high": top}
    usable = usable_at(result.solution.epochs, result.solution.trajectory.time)
    if (usable >= 0).any():
        columns["satellites"] = usable[keep].astype("f4")
        kinds["satellites"] = {"title": "satellites usable", "palette": list(Cividis256[::4]),
                               "low": 0.0, "high": max(float(usable.max()), 1.0)}  # fmt: skip
    columns["state"] = gnss_state(result)[keep].astype("f4")
    kinds["state"] = {"title": "GNSS: position, velocity only, none", "low": -0.5, "high": 2.5,
                      "palette": [BLUE, ORANGE, VERMILLION]}  # fmt: skip
    return columns, kinds
