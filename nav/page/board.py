"""Interactive plots that are linked in time.

    board = Board(start=gps_time_of_the_recording, begin=0.0, end=seconds)
    plot = board.panel("north error [m]")
    board.band(plot, t, low, high, SKY); board.line(plot, t, y, BLUE, "error")
    page = document("…", *board.fill(body + board.place([[plot]], "…")))

All panels share one time axis, seconds since `start`; hovering tells GPS time and seconds of week
as well. What a reader zooms to is the selected span: ``page.js`` writes its figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from bokeh.models import (
    BoxAnnotation,
    BoxSelectTool,
    BoxZoomTool,
    ColumnDataSource,
    CrosshairTool,
    CustomJS,
    CustomJSHover,
    HoverTool,
    PanTool,
    Range1d,
    ResetTool,
    SaveTool,
    Span,
    WheelZoomTool,
)
from bokeh.plotting import figure
from numpy.typing import NDArray

from ...datasets.gpstime import to_calendar, to_week_sow
from ...filters.rotation import FloatArray
from ..notes import times_in
from .palette import INK
from .plots import Plots, look


class Board(Plots):
    """The plots of one page that is about a stretch of time.

    Parameters
    ----------
    start : float
        GPS time of zero on the time axis [s].
    begin, end : float
        What the time axis shows at first [s since `start`].
    """

    def __init__(self, start: float, begin: float, end: float) -> None:
        super().__init__()
        end = max(end, begin + 1e-3)
        self.start = start
        room = 0.01 * (end - begin)
        self.time = Range1d(
            begin - room, end + room, bounds=(begin - room, end + room), min_interval=0.02,
            name="time",
        )  # fmt: skip
        self._crosshair = Span(dimension="height", line_color=INK, line_alpha=0.5, line_width=1)
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
        full: str = "",
        **style: Any,
    ) -> None:
        """Draw a line, broken before the indices `cut`; hovering it tells time and value.

        With `scale` the ordinate follows what of it is in sight; `full` names the column of the
        page's own table that has all of a line that was thinned.
        """
        at = np.asarray(list(cut), dtype=int)
        columns = {"t": _single(np.insert(t, at, np.nan)), "y": _single(np.insert(y, at, np.nan))}
        source = ColumnDataSource(columns, tags=["scale"] * scale)
        if full:
            source.tags.append(f"full:{full}")
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
        source = ColumnDataSource({"t": _single(t), "low": _single(low), "high": _single(high)})
        drawn = plot.varea("t", "low", "high", source=source, fill_color=colour, fill_alpha=0.3)
        self.legend(plot, label, [drawn])

    def shade(self, plot: figure, spans: Sequence[tuple[float, float]], colour: str) -> None:
        """Shade (start, width) over the whole height, behind everything."""
        if not spans:
            return
        left = np.array([a for a, _ in spans])
        right = left + np.array([w for _, w in spans])
        plot.vstrip(left, right, fill_color=colour, line_color=None, level="image")

    def button(self, text: str) -> str:
        """Return a button that shows the span whose times a text names; '' where it names none."""
        times = [time - self.start for time in times_in(text, self.start)]
        if not times:
            return ""
        return (
            f' <button type="button" data-from="{min(times):.2f}" data-to="{max(times):.2f}">'
            "show</button>"
        )

    @staticmethod
    def zooming() -> str:
        """Return the controls of the time axis of all plots, for mouse and keyboard."""
        return (
            "<label>Selected span, s since start: "
            '<input id="span-from" type="number" step="any" aria-label="from"></label> … '
            '<input id="span-to" type="number" step="any" aria-label="to"> '
            '<button type="button" id="span-back" aria-label="earlier">◀</button>'
            '<button type="button" id="span-on" aria-label="later">▶</button>'
            '<button type="button" id="span-in" aria-label="zoom in">+</button>'
            '<button type="button" id="span-out" aria-label="zoom out">−</button>'
            '<button type="button" id="span-whole">whole</button>'
        )

    def place(self, rows: Sequence[Sequence[figure]], alt: str, stretch: bool = True) -> str:
        """Return where a grid of plots goes; the time axis has its name below the last of them."""
        for plot in rows[-1]:
            if plot.x_range is self.time:
                plot.xaxis.axis_label = "time since start [s]"
                plot.height += 18
        return super().place(rows, alt, stretch)


def _single(values: FloatArray) -> NDArray[np.float32]:
    """Return what is drawn with the digits that can be seen: of a day's times 0.01 s."""
    return values.astype(np.float32)


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
