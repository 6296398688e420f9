"""Interactive plots of a page, with one look, carried by the page itself (Bokeh).

    plots = Plots()
    plot = plots.free("drift [m]", "share [%]", "How often the drift was below")
    page = document("…", *plots.fill(body + plots.cells([plot], "…")))

``page.js`` sorts tables, switches series on and off, and lets the keyboard zoom and pan.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.embed import components
from bokeh.layouts import gridplot
from bokeh.model import Model
from bokeh.models import (
    AllIndices,
    AllLabels,
    Axis,
    CDSView,
    ColumnDataSource,
    CustomJS,
    GlyphRenderer,
    HoverTool,
    Legend,
    LegendItem,
    Plot,
    Selection,
    UnionRenderers,
)
from bokeh.models.glyph import Glyph
from bokeh.plotting import figure
from bokeh.resources import Resources
from bokeh.settings import settings

from ...filters.rotation import FloatArray
from .palette import INK

_FONT = '"Source Sans 3", "Segoe UI", "Helvetica Neue", Helvetica, Arial, sans-serif'
GRID = "#E4E7EB"
_AXIS, _QUIET = "#A7AEB8", "#5B6673"
#: What zooms, moves and shows the whole of a plot that has the keyboard's focus (`page.js`).
_KEYS = "+ - ArrowLeft ArrowRight 0"
#: Lengths of dashes and gaps [px], by Bokeh's names, as a sample of a line draws them.
_DASHES = {"solid": "", "dashed": "6 3", "dotted": "2 3", "dotdash": "2 3 6 3"}


class Plots:
    """The plots of one page."""

    def __init__(self) -> None:
        self._placed: list[Model] = []
        # What has no state of its own is there once: making a page takes as long as it has models.
        self._all, self._labels = AllIndices(), AllLabels()
        self._union, self._none = UnionRenderers(), Selection()  # nothing is ever selected

    def free(
        self, x: str, y: str, title: str = "", height: int = 300, **options: Any
    ) -> figure:  # fmt: skip
        """Return an empty plot with axes of its own; a double click shows the whole again."""
        options = {"min_border_left": 58} | options
        plot = figure(
            height=height, sizing_mode="stretch_width", title=title,
            tools="box_zoom,pan,wheel_zoom,reset,save", **options,
        )  # fmt: skip
        look(plot)
        plot.xaxis.axis_label, plot.yaxis.axis_label = x or None, y or None
        plot.toolbar.autohide, plot.toolbar.logo = True, None
        plot.js_on_event("doubletap", CustomJS(args={"plot": plot}, code="plot.reset.emit()"))
        return plot

    def source(self, columns: Mapping[str, Any], **options: Any) -> ColumnDataSource:
        """Return a source of columns."""
        return ColumnDataSource(
            dict(columns), selected=self._none, selection_policy=self._union, **options
        )

    def drawing(self, source: ColumnDataSource, glyph: Glyph, **options: Any) -> GlyphRenderer:
        """Return what draws a glyph for each row of a source, in every plot it is given to."""
        view = CDSView(filter=self._all)
        return GlyphRenderer(data_source=source, glyph=glyph, view=view, **options)

    def draw(
        self, plot: Plot, source: ColumnDataSource, glyph: Glyph, label: str = "", **options: Any
    ) -> GlyphRenderer:  # fmt: skip
        """Draw a glyph for each row of a source, and name it in the legend.

        Plots' own methods do the same with three glyphs: two more for what is selected or muted,
        which nothing here ever is.
        """
        drawn = self.drawing(source, glyph, **options)
        plot.renderers.append(drawn)
        self.legend(plot, label, [drawn])
        return drawn

    @staticmethod
    def legend(plot: Plot, label: str, drawn: list[Any]) -> None:
        """Name what was drawn, over the plot and out of its way."""
        if not label:
            return
        item = LegendItem(label=label, renderers=drawn)
        for legend in plot.above:
            if isinstance(legend, Legend):
                legend.items.append(item)
                return
        plot.above.append(
            Legend(
                orientation="horizontal", location="right", border_line_color=None,
                background_fill_alpha=0.0, padding=0, margin=0, spacing=14, glyph_width=16,
                label_text_font_size="12px", label_text_color=INK, label_text_font=_FONT,
                click_policy="hide", label_height=14, glyph_height=14, items=[item],
            )
        )  # fmt: skip

    @staticmethod
    def tell(plot: Plot, drawn: Any, *lines: tuple[str, str]) -> None:
        """Let the pointer over what was drawn tell of it: pairs of a name and a Bokeh template."""
        plot.add_tools(HoverTool(renderers=[drawn], tooltips=list(lines), visible=False))

    @staticmethod
    def series(name: str, drawn: Iterable[Any]) -> None:
        """Let what was drawn be switched on and off with all else of this name."""
        for each in drawn:
            each.tags = [*each.tags, f"series:{name}"]

    @staticmethod
    def switches(series: Sequence[tuple[str, str, str]], what: str) -> str:
        """Return a button for each series of name, colour and dash; `what` they are together."""
        buttons = "".join(
            f'<button type="button" data-series="{escape(name)}" aria-pressed="true">'
            f'<svg width="22" height="8" aria-hidden="true"><line x1="0" y1="4" x2="22" y2="4" '
            f'stroke="{colour}" stroke-width="3" stroke-dasharray="{_DASHES[dash]}"/></svg>'
            f"{escape(name)}</button>"
            for name, colour, dash in series
        )
        return (
            f'<p class="controls switches" role="group" aria-label="{escape(what)} shown">'
            f"{buttons}"
            '<button type="button" data-all="true">all</button>'
            '<button type="button" data-all="false">none</button></p>'
        )

    def place(self, rows: Sequence[Sequence[Plot]], alt: str, stretch: bool = True) -> str:
        """Return where in the page a grid of plots goes, under one toolbar; `alt` tells of them.

        Without `stretch` plots keep their size, where shape is what they show.
        """
        model = (
            gridplot(
                [list(row) for row in rows], sizing_mode="stretch_width", merge_tools=True,
                toolbar_location="above", toolbar_options={"logo": None},
            )
            if stretch
            else rows[0][0]
        )  # fmt: skip
        return self._hole(model, alt)

    def cells(self, plots: Sequence[Plot], alt: str, columns: int = 1) -> str:
        """Return where in the page plots go side by side, and below each other on a phone."""
        holes = "".join(
            self._hole(plot, f"{alt}: {plot.title.text}" if plot.title.text else alt)
            for plot in plots
        )
        return f'<div class="cells" style="--columns: {min(columns, len(plots))}">{holes}</div>'

    def _hole(self, model: Model, alt: str) -> str:
        self._placed.append(model)
        return (
            f'<div class="plot" role="figure" tabindex="0" aria-label="{escape(alt)}" '
            f'aria-keyshortcuts="{_KEYS}"><!--plot {len(self._placed) - 1}--></div>'
        )

    def fill(self, body: str) -> tuple[str, str]:
        """Return the page's body with its plots in place, and the scripts that draw them."""
        own = files(__package__).joinpath("page.js").read_text(encoding="utf-8")
        if not self._placed:
            return body, f"<script>\n{own}\n</script>"
        document = Document()
        with document.models.freeze():  # or all models are counted again with each plot
            for model in self._placed:
                document.add_root(model)
        with _unchecked():
            script, places = components(tuple(self._placed), wrap_script=False)
        numbers: dict[str, str] = {}
        script = _renumbered(script, numbers)
        for k, place in enumerate(places):
            body = body.replace(f"<!--plot {k}-->", _renumbered(place, numbers))
        library = Resources(mode="inline", components=["bokeh"]).render_js()
        return body, f"{library}\n<script>\n{own}\n{script}\n</script>"


def look(plot: Plot) -> None:
    """Give a plot the look of all: quiet axes, light grid, letters that can be read."""
    look_of_frame(plot)
    for axis in plot.axis:
        look_of_axis(axis)
    plot.grid.grid_line_color = GRID


def look_of_frame(plot: Plot) -> None:
    """Give a plot's title and background the look of all."""
    plot.update(background_fill_color=None, border_fill_color=None, outline_line_color=None)
    plot.title.update(
        text_font=_FONT, text_font_size="13px", text_color=INK, text_font_style="normal"
    )


def look_of_axis(axis: Axis) -> None:
    """Give an axis the look of all."""
    axis.update(
        axis_label_text_font=_FONT, axis_label_text_font_size="12px",
        axis_label_text_font_style="normal", axis_label_text_color=_QUIET,
        major_label_text_font=_FONT, major_label_text_font_size="12px",
        major_label_text_color=_QUIET, axis_line_color=_AXIS, major_tick_line_color=_AXIS,
        minor_tick_line_color=None,
    )  # fmt: skip


@contextmanager
def _unchecked() -> Iterator[None]:
    """Spare Bokeh the check of every model, an eighth of a page's time: the tests have it."""
    before = settings.perform_document_validation()
    settings.perform_document_validation.set_value(False)
    try:
        yield
    finally:
        settings.perform_document_validation.set_value(before)


def _renumbered(text: str, numbers: dict[str, str]) -> str:
    """Return a text in which Bokeh's identifiers, other in every run, count from one."""

    def number(found: re.Match) -> str:
        return f'"{numbers.setdefault(found[1], f"p{len(numbers) + 1}")}"'

    return re.sub(r'"(p\d+|[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12})"', number, text)


def decade_marks(drawn: FloatArray) -> list[float]:
    """Return the numbers of a logarithmic axis of few decades; none: it finds its own.

    Within two decades Bokeh counts 1, 2, 3 … evenly: low values get none, high ones overlap.
    """
    known = drawn[np.isfinite(drawn) & (drawn > 0.0)]
    if not known.size:
        return []
    low, high = np.log10([known.min(), known.max()])
    if high - low > 2.0:
        return []
    decades = 10.0 ** np.arange(np.floor(low), np.ceil(high) + 1.0)
    return [float(f"{m * d:.0e}") for d in decades for m in (1, 2, 5)]
