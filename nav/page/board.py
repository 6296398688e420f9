"""Interactive plots of a page: linked in time, with one look, carried by the page itself (Bokeh).

    board = Board(start=gps_time_of_the_recording, end=seconds)
    plot = board.panel("north error [m]")
    board.band(plot, t, low, high); board.line(plot, t, y, BLUE, "error")
    page = document("…", board.fill(body + board.place([[plot]])), board.script())

All panels share one time axis, seconds since `start`; hovering tells GPS time and seconds of week
as well. What a reader zooms to is the selected span: ``page.js`` writes its figures.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.embed import components
from bokeh.layouts import gridplot
from bokeh.model import Model
from bokeh.models import (
    BoxAnnotation,
    BoxSelectTool,
    BoxZoomTool,
    ColumnDataSource,
    CrosshairTool,
    CustomJS,
    CustomJSHover,
    HoverTool,
    Legend,
    LegendItem,
    PanTool,
    Range1d,
    ResetTool,
    SaveTool,
    Span,
    WheelZoomTool,
)
from bokeh.plotting import figure
from bokeh.resources import Resources

from ...datasets.gpstime import to_calendar, to_week_sow
from ...filters.rotation import FloatArray
from .pictures import INK

_FONT = '"Source Sans 3", "Segoe UI", "Helvetica Neue", Helvetica, Arial, sans-serif'
_GRID, _AXIS, _QUIET = "#E4E7EB", "#A7AEB8", "#5B6673"


class Board:
    """The plots of one page.

    Parameters
    ----------
    start : float
        GPS time of zero on the time axis [s].
    begin, end : float
        What the time axis shows at first [s since `start`].
    """

    def __init__(self, start: float, begin: float, end: float) -> None:
        end = max(end, begin + 1e-3)
        self.start = start
        room = 0.01 * (end - begin)
        self.time = Range1d(
            begin - room, end + room, bounds=(begin - room, end + room), min_interval=0.02,
            name="time",
        )  # fmt: skip
        self._crosshair = Span(dimension="height", line_color=INK, line_alpha=0.5, line_width=1)
        self._placed: list[Model] = []
        self._spans = 0
        self._clock = _clock(start)

    def panel(self, label: str, title: str = "", height: int = 190, **options: Any) -> figure:
        """Return an empty plot over the common time axis; `label` names its ordinate."""
        plot = figure(
            height=height, sizing_mode="stretch_width", x_range=self.time, title=title or None,
            tools=[], toolbar_location=None, min_border_left=58, **options,
        )  # fmt: skip
        look(plot)
        plot.yaxis.axis_label = label
        select = BoxSelectTool(dimensions="width", persistent=False)
        zoom = BoxZoomTool(dimensions="width")
        plot.add_tools(
            zoom, select, PanTool(dimensions="width"), WheelZoomTool(dimensions="width"),
            ResetTool(), SaveTool(), CrosshairTool(overlay=self._crosshair),
        )  # fmt: skip
        plot.toolbar.active_drag = zoom
        plot.add_layout(
            BoxAnnotation(
                left=np.nan, right=np.nan, fill_color=INK, fill_alpha=0.08, line_color=INK,
                line_alpha=0.4, name=f"span-{self._spans}", level="underlay",
            )
        )  # fmt: skip
        self._spans += 1
        plot.js_on_event(
            "selectiongeometry",
            CustomJS(code="window.certnav?.select(cb_obj.geometry.x0, cb_obj.geometry.x1)"),
        )
        plot.js_on_event("mousemove", CustomJS(code="window.certnav?.point(cb_obj.x)"))
        return plot

    def line(
        self,
        plot: figure,
        t: FloatArray,
        y: FloatArray,
        colour: str,
        label: str = "",
        unit: str = "",
        *,
        cut: Iterable[int] = (),
        scale: bool = False,
        **style: Any,
    ) -> None:
        """Draw a line, broken before the indices `cut`; hovering it tells time and value.

        With `scale` the ordinate follows what of it is in sight.
        """
        at = np.asarray(list(cut), dtype=int)
        columns = {"t": np.insert(t, at, np.nan), "y": np.insert(y, at, np.nan).astype("f4")}
        source = ColumnDataSource(columns, tags=["scale"] if scale else [])
        style = {"line_width": 1.4, "line_join": "round"} | style
        if t.size == 1:
            drawn = plot.scatter("t", "y", source=source, color=colour, size=5)
        elif style.pop("mode", ""):
            drawn = plot.step("t", "y", source=source, color=colour, mode="after", **style)
        else:
            drawn = plot.line("t", "y", source=source, color=colour, **style)
        self.legend(plot, label, [drawn])
        value = f"@y{{0.0000}} {unit}".rstrip()
        plot.add_tools(
            HoverTool(
                renderers=[drawn], mode="vline", tooltips=[("", "@t{custom}"), (label, value)],
                formatters={"@t": self._clock}, visible=False, point_policy="snap_to_data",
                line_policy="nearest",
            )
        )  # fmt: skip

    def band(
        self, plot: figure, t: FloatArray, low: FloatArray, high: FloatArray, colour: str,
        label: str = "±3σ",
    ) -> None:  # fmt: skip
        """Fill what lies between `low` and `high`."""
        source = ColumnDataSource({"t": t, "low": low.astype("f4"), "high": high.astype("f4")})
        drawn = plot.varea("t", "low", "high", source=source, fill_color=colour, fill_alpha=0.3)
        self.legend(plot, label, [drawn])

    def shade(self, plot: figure, spans: Sequence[tuple[float, float]], colour: str) -> None:
        """Shade (start, width) over the whole height, behind everything."""
        if not spans:
            return
        left = np.array([a for a, _ in spans])
        right = left + np.array([w for _, w in spans])
        plot.vstrip(left, right, fill_color=colour, line_color=None, level="image")

    @staticmethod
    def legend(plot: figure, label: str, drawn: list[Any]) -> None:
        """Name what was drawn, over the plot and out of its way."""
        if not label:
            return
        if not plot.legend:
            plot.add_layout(
                Legend(
                    orientation="horizontal", location="right", border_line_color=None,
                    background_fill_alpha=0.0, padding=0, margin=0, spacing=14, glyph_width=16,
                    label_text_font_size="12px", label_text_color=INK, label_text_font=_FONT,
                    click_policy="hide", label_height=14, glyph_height=14,
                ),
                "above",
            )  # fmt: skip
        plot.legend[0].items.append(LegendItem(label=label, renderers=drawn))

    def place(self, rows: Sequence[Sequence[figure]], alt: str, stretch: bool = True) -> str:
        """Return where in the page a grid of plots goes; `alt` says what they show.

        Without `stretch` plots keep their size, where shape is what they show.
        """
        for plot in rows[-1]:
            if plot.x_range is self.time:
                plot.xaxis.axis_label = "time since start [s]"
                plot.height += 18
        model = (
            gridplot(
                [list(row) for row in rows], sizing_mode="stretch_width", merge_tools=True,
                toolbar_location="above", toolbar_options={"logo": None},
            )
            if stretch
            else rows[0][0]
        )  # fmt: skip
        self._placed.append(model)
        return (
            f'<div class="plot" role="img" aria-label="{escape(alt)}">'
            f"<!--plot {len(self._placed) - 1}--></div>"
        )

    def fill(self, body: str) -> tuple[str, str]:
        """Return the page's body with its plots in place, and the scripts that draw them."""
        if not self._placed:
            return body, ""
        document = Document()
        with document.models.freeze():  # or all models are counted again with each plot
            for model in self._placed:
                document.add_root(model)
        script, places = components(tuple(self._placed), wrap_script=False)
        numbers: dict[str, str] = {}
        script = _renumbered(script, numbers)
        for k, place in enumerate(places):
            body = body.replace(f"<!--plot {k}-->", _renumbered(place, numbers))
        library = Resources(mode="inline", components=["bokeh"]).render_js()
        own = files(__package__).joinpath("page.js").read_text(encoding="utf-8")
        return body, f"{library}\n<script>\n{own}\n{script}\n</script>"


def look(plot: figure) -> None:
    """Give a plot the look of all: quiet axes, light grid, letters that can be read."""
    plot.background_fill_color = plot.border_fill_color = None
    plot.outline_line_color = None
    plot.title.text_font, plot.title.text_font_size = _FONT, "13px"
    plot.title.text_color, plot.title.text_font_style = INK, "normal"
    plot.axis.axis_label_text_font = plot.axis.major_label_text_font = _FONT
    plot.axis.axis_label_text_font_style = "normal"
    plot.axis.axis_label_text_font_size = plot.axis.major_label_text_font_size = "12px"
    plot.axis.axis_label_text_color = plot.axis.major_label_text_color = _QUIET
    plot.axis.axis_line_color = plot.axis.major_tick_line_color = _AXIS
    plot.axis.minor_tick_line_color = None
    plot.grid.grid_line_color = _GRID


def _renumbered(text: str, numbers: dict[str, str]) -> str:
    """Return a text in which Bokeh's identifiers, other in every run, count from one."""

    def number(found: re.Match) -> str:
        return f'"{numbers.setdefault(found[1], f"p{len(numbers) + 1}")}"'

    return re.sub(r'"(p\d+|[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12})"', number, text)


def _clock(start: float) -> CustomJSHover:
    """Return what writes a time of the axis: GPS time, seconds of week, seconds since start."""
    week, sow = to_week_sow(start)
    if week == 0:
        return CustomJSHover(code="return value.toFixed(2) + ' s since start'")
    moment = to_calendar(start)
    day = moment.hour * 3600 + moment.minute * 60 + moment.second + moment.microsecond * 1e-6
    code = """
        const s = (((day + value) % 86400) + 86400) % 86400, two = (x) => String(x).padStart(2, '0')
        return two(Math.floor(s / 3600)) + ':' + two(Math.floor(s / 60) % 60) + ':'
            + (s % 60).toFixed(2).padStart(5, '0') + ' GPS time, SOW ' + (sow + value).toFixed(2)
            + ', ' + value.toFixed(2) + ' s since start'
    """
    return CustomJSHover(args={"day": day, "sow": float(sow)}, code=code)
