"""Interactive plots that are linked in time.

    board = Board(start=gps_time_of_the_recording, begin=0.0, end=seconds)
    plot = board.panel("north error [m]")
    board.band(plot, t, low, high, SKY); board.line(plot, t, y, BLUE, "error")
    page = document("…", *board.fill(body + board.place([[plot]], "…")))

All panels share one time axis, seconds since `start`; hovering tells GPS time and seconds of week
as well. What a reader zooms to is the selected span: ``page.js`` writes its figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from bokeh.models import (
    Axis,
    BasicTicker,
    BasicTickFormatter,
    BoxAnnotation,
    BoxSelectTool,
    BoxZoomTool,
    CategoricalAxis,
    CategoricalScale,
    CrosshairTool,
    CustomJS,
    CustomJSHover,
    DataRange1d,
    FactorRange,
    FixedTicker,
    GlyphRenderer,
    Grid,
    GridPlot,
    HoverTool,
    Line,
    LinearAxis,
    LinearScale,
    LogAxis,
    LogScale,
    PanTool,
    Plot,
    Range,
    Range1d,
    ResetTool,
    SaveTool,
    Scale,
    Scatter,
    Span,
    Step,
    Title,
    Toolbar,
    ToolProxy,
    VArea,
    VStrip,
    WheelZoomTool,
)
from numpy.typing import NDArray

from ...datasets.gpstime import to_calendar, to_week_sow
from ...filters.rotation import FloatArray
from ..notes import times_in
from .palette import INK
from .plots import GRID, Plots, look_of_axis, look_of_frame


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
        self._crosshair = CrosshairTool(
            overlay=Span(dimension="height", line_color=INK, line_alpha=0.5, line_width=1)
        )
        self._span = BoxAnnotation(
            left=np.nan, right=np.nan, fill_color=INK, fill_alpha=0.08, line_color=INK,
            line_alpha=0.4, name="span", level="underlay",
        )  # fmt: skip
        # How an ordinate's numbers are written is its own; the axis of time is every plot's.
        self._scale, self._ticker, numbers = LinearScale(), BasicTicker(), BasicTickFormatter()
        self._axis, self._named = (
            LinearAxis(ticker=self._ticker, formatter=numbers, major_label_policy=self._labels,
                       axis_label=name)
            for name in (None, "time since start [s]")
        )  # fmt: skip
        look_of_axis(self._axis)
        look_of_axis(self._named)
        self._grid = Grid(dimension=0, ticker=self._ticker, grid_line_color=GRID)
        self._lines = Grid(dimension=1, ticker=self._ticker, grid_line_color=GRID)
        self._select = CustomJS(
            code="window.certnav?.select(cb_obj.geometry.x0, cb_obj.geometry.x1)"
        )
        self._point = CustomJS(code="window.certnav?.point(cb_obj.x)")
        self._clock = _clock(start)
        self._hovers: dict[tuple[str, str], HoverTool] = {}

    def panel(
        self, label: str, title: str = "", height: int = 190, *, y_range: Range | None = None,
        logarithmic: bool = False, ticks: Sequence[float] = (), tags: Sequence[str] = (),
    ) -> Plot:  # fmt: skip
        """Return an empty plot over the common time axis.

        Parameters
        ----------
        label : str
            Name of the ordinate.
        title : str
        height : int
            [px]
        y_range : Range, optional
            What the ordinate shows; else what is drawn. Names, one a row, are a FactorRange.
        logarithmic : bool
        ticks : sequence of float
            Where the ordinate has numbers and lines, if it is known better than from its range.
        tags : sequence of str
        """
        axis, scale = self._ordinate(y_range, logarithmic, ticks)
        axis.update(axis_label=label, major_label_policy=self._labels)
        usual = axis.ticker is self._ticker
        lines = self._lines if usual else Grid(dimension=1, axis=axis, grid_line_color=GRID)
        plot = Plot(
            height=height, sizing_mode="stretch_width", toolbar_location=None, min_border_left=58,
            x_range=self.time, x_scale=self._scale, y_range=y_range or DataRange1d(),
            y_scale=scale, title=Title(text=title), tags=list(tags), left=[axis],
            below=[self._axis], center=[self._grid, lines, self._span],
            js_event_callbacks={
                "selectiongeometry": [self._select], "mousemove": [self._point],
            },
        )  # fmt: skip
        look_of_frame(plot)
        look_of_axis(axis)
        return plot

    def _ordinate(
        self, y_range: Range | None, logarithmic: bool, ticks: Sequence[float]
    ) -> tuple[Axis, Scale]:
        """Return axis and scale of an ordinate; the usual scale and ticks are everybody's."""
        if isinstance(y_range, FactorRange):
            return CategoricalAxis(), CategoricalScale()
        if logarithmic:
            marks = {"ticker": FixedTicker(ticks=list(ticks))} if ticks else {}
            return LogAxis(**marks), LogScale()
        if ticks:
            return LinearAxis(ticker=FixedTicker(ticks=list(ticks))), self._scale
        return LinearAxis(ticker=self._ticker), self._scale

    def line(
        self,
        plot: Plot,
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
        tags = ["scale"] * scale + [f"full:{full}"] * bool(full)
        stepped = style.pop("mode", "")
        style = {"line_width": 1.4, "line_join": "round"} | style
        if t.size == 1:
            glyph = Scatter(x="t", y="y", fill_color=colour, line_color=colour, size=5)
        elif stepped:
            glyph = Step(x="t", y="y", line_color=colour, mode=stepped, **style)
        else:
            glyph = Line(x="t", y="y", line_color=colour, **style)
        drawn = self.draw(plot, self.source(columns, tags=tags), glyph, label, name=label)
        self._hover(plot, unit).renderers.append(drawn)

    def _hover(self, plot: Plot, unit: str) -> HoverTool:
        """Return what tells time and value of all lines of a plot in one unit."""
        key = (plot.id, unit)
        if key not in self._hovers:
            self._hovers[key] = HoverTool(
                renderers=[], mode="vline", formatters={"@t": self._clock}, visible=False,
                tooltips=[("", "@t{custom}"), ("", f"$name: @y{{0.0000}} {unit}".rstrip())],
                point_policy="snap_to_data", line_policy="nearest",
            )  # fmt: skip
            plot.add_tools(self._hovers[key])
        return self._hovers[key]

    def band(
        self, plot: Plot, t: FloatArray, low: FloatArray, high: FloatArray, colour: str,
        label: str = "±3σ",
    ) -> None:  # fmt: skip
        """Fill what lies between `low` and `high`."""
        source = self.source({"t": _single(t), "low": _single(low), "high": _single(high)})
        glyph = VArea(x="t", y1="low", y2="high", fill_color=colour, fill_alpha=0.3)
        self.draw(plot, source, glyph, label)

    def shading(self, spans: Mapping[str, Sequence[tuple[float, float]]]) -> list[GlyphRenderer]:
        """Return what shades (start, width) over the whole height, behind everything, by colour.

        It may be among the renderers of any number of plots.
        """
        rows = [(a, a + width, colour) for colour in spans for a, width in spans[colour]]
        if not rows:
            return []
        columns = dict(zip(("left", "right", "colour"), zip(*rows, strict=True), strict=True))
        glyph = VStrip(x0="left", x1="right", fill_color="colour", line_color=None)
        return [self.drawing(self.source(columns), glyph, level="image")]

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

    def place(self, rows: Sequence[Sequence[Plot]], alt: str, stretch: bool = True) -> str:
        """Return where a grid of plots goes; the time axis has its name below the last of them.

        Plots over time that lie together share their tools: what zooms one zooms all.
        """
        plots = [plot for row in rows for plot in row]
        if any(plot.x_range is not self.time for plot in plots):
            return super().place(rows, alt, stretch)
        for plot in rows[-1]:
            plot.below = [self._named]
            plot.height += 18
        zoom, reset = BoxZoomTool(dimensions="width"), ResetTool()
        select = BoxSelectTool(dimensions="width", persistent=False, renderers=[])
        zoom.overlay.handles = select.overlay.handles = self._span.handles
        pan, wheel = PanTool(dimensions="width"), WheelZoomTool(dimensions="width")
        tools = [zoom, select, pan, wheel, self._crosshair]
        for plot in plots:
            plot.toolbar.update(tools=[*tools, reset, *plot.toolbar.tools], active_drag=zoom)
        # What acts on a plot, not on the grid, acts for the grid by proxy.
        toolbar = Toolbar(
            tools=[*tools, ToolProxy(tools=[reset]), SaveTool()], active_drag=zoom, logo=None
        )
        grid = GridPlot(
            children=[(plot, i, k) for i, row in enumerate(rows) for k, plot in enumerate(row)],
            toolbar=toolbar, sizing_mode="stretch_width",
        )  # fmt: skip
        return self._hole(grid, alt)


def _single(values: FloatArray) -> NDArray[np.float32]:
    """Return what is drawn with the digits that can be seen: of a day's times 0.01 s."""
    return values.astype(np.float32)


def _clock(start: float) -> CustomJSHover:
    """Return what writes a time of the axis: GPS time, seconds of week, seconds since start."""
    week, sow = to_week_sow(start)
    if week <= 0:
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
