"""The satellites of a run: sky, signal strength, use and reasons, residuals, geometry."""

from __future__ import annotations

import numpy as np
from bokeh.models import Circle, FactorRange, HBar, MultiLine, Plot, Range1d, Scatter, Text
from bokeh.plotting import figure

from ...filters.rotation import FloatArray
from ..page.board import Board
from ..page.palette import BLUE, GREEN, GREY, INK, ORANGE, SKY, VERMILLION
from ..page.plots import look
from ..page.thinning import thin
from ..signals import UNUSED, Signals

#: One colour a system; what is not named is grey.
_SYSTEMS = {"G": BLUE, "R": VERMILLION, "E": GREEN, "C": ORANGE, "J": SKY}
_NAMES = {"G": "GPS", "R": "GLONASS", "E": "Galileo", "C": "BeiDou", "J": "QZSS"}
#: What became of a row: used, refused by the filter, refused by the screening before it.
_FATES = (("used", BLUE), ("not used by the filter", ORANGE), ("screened out", GREY))

#: Stretches of a satellite that a page can show apart; of more, spans are told by their shares.
_BARS = 500


class Sky:
    """The panels of a run's satellite signals; on the board of its page.

    Every method returns rows of plots for `Board.place`.
    """

    def __init__(self, signals: Signals, board: Board) -> None:
        self.signals, self.board = signals, board
        self.t = signals.time - board.start
        self.satellites = sorted(set(signals.sat.tolist()))
        self.fate = np.where(signals.reason == "", 0, np.where(signals.reason == UNUSED, 1, 2))

    def use(self) -> list[list[Plot]]:
        """Draw when each satellite was used, and why not."""
        plot = self.board.panel(
            "",
            "Satellites: when used, and why not",
            height=70 + 15 * len(self.satellites),
            y_range=FactorRange(*reversed(self.satellites)),
        )
        plot.yaxis.major_label_text_font_size = "10px"
        bars = [bar for sat in self.satellites for bar in self._bars(sat)]
        for code, (name, colour) in enumerate(_FATES):
            chosen = [bar for bar in bars if bar[4] == code]
            if chosen:
                sat, left, right, why, _ = zip(*chosen, strict=True)
                columns = {"sat": sat, "left": left, "right": right, "why": why}
                glyph = HBar(y="sat", height=0.7, left="left", right="right", fill_color=colour,
                             line_color=colour)  # fmt: skip
                drawn = self.board.draw(plot, self.board.source(columns), glyph, name)
                self.board.tell(plot, drawn, ("@sat", "@left{0.0} … @right{0.0} s since start"),
                                (name, "@why"))  # fmt: skip
        return [[plot]]

    def strength(self) -> list[list[Plot]]:
        """Draw C/N0 over time."""
        if not np.isfinite(self.signals.cn0).any():
            return []
        plot = self.board.panel("C/N0 [dB-Hz]", "Signal strength", height=220)
        self._by_system(plot, self.signals.cn0, "C/N0", "dB-Hz", np.arange(len(self.signals)))
        return [[plot]]

    def residuals(self) -> list[list[Plot]]:
        """Draw residuals of the range rates that were used, and of those that were not."""
        known = np.isfinite(self.signals.residual)
        rows = []
        for title, chosen in (
            ("Residuals of range rates used", known & (self.fate == 0)),
            ("… and of those not used", known & (self.fate > 0)),
        ):
            if chosen.any():
                limit = _limit(self.signals.residual[chosen])
                plot = self.board.panel("residual [m/s]", f"{title}, to ±{limit:g} m/s")
                value = np.clip(self.signals.residual, -limit, limit)
                self._by_system(plot, value, "residual", "m/s", np.flatnonzero(chosen))
                plot.y_range = Range1d(-1.08 * limit, 1.08 * limit)
                rows.append([plot])
        return rows

    def dilution(self) -> list[list[Plot]]:
        """Draw the dilution of precision of the satellites that were used, horizontal and up."""
        t, dop = _dilution(self.signals.take(self.fate == 0))
        if t.size < 2:
            return []
        plot = self.board.panel("DOP [1]", "Dilution of precision of the signals used")
        t = t - self.board.start
        for k, (name, colour) in enumerate((("horizontal", BLUE), ("vertical", ORANGE))):
            keep = thin(dop[:, k], 1500)
            cut = np.flatnonzero(np.diff(t[keep], prepend=t[0]) > 5.0 * np.median(np.diff(t)))
            self.board.line(plot, t[keep], dop[keep, k], colour, name, cut=cut)
        top = float(np.percentile(dop, 90.0))
        plot.y_range = Range1d(0.0, min(max(2.0, 1.3 * top), 30.0))
        return [[plot]]

    def plot(self) -> list[list[Plot]]:
        """Draw where the satellites stood, zenith in the middle, north up."""
        known = np.isfinite(self.signals.elevation) & np.isfinite(self.signals.azimuth)
        if not known.any():
            return []
        plot = figure(
            width=350,
            height=372,
            tools="",
            toolbar_location=None,
            title="Sky plot",
            x_range=Range1d(-104, 104),
            y_range=Range1d(-104, 104),
        )
        look(plot)
        plot.axis.visible = plot.grid.visible = False
        self._horizon(plot)
        self._paths(plot, known)
        return [[plot]]

    def _horizon(self, plot: Plot) -> None:
        """Draw circles of equal elevation, and where north, east, south and west are."""
        circles = self.board.source({"y": [0, 0, 0], "away": [90, 60, 30]})
        glyph = Circle(x=0, y="y", radius="away", fill_color=None, line_color="#C9CED6")
        self.board.draw(plot, circles, glyph)
        names = {"x": [2, 2, 2, 0, 97, 0, -97], "y": [90, 60, 30, 96, 0, -97, 0],
                 "text": ["0°", "30°", "60°", "N", "E", "S", "W"],
                 "size": ["11px"] * 3 + ["12px"] * 4, "align": ["left"] * 3 + ["center"] * 4,
                 "base": ["top"] * 3 + ["middle"] * 4}  # fmt: skip
        glyph = Text(x="x", y="y", text="text", text_font_size="size", text_align="align",
                     text_baseline="base", text_color=INK)  # fmt: skip
        self.board.draw(plot, self.board.source(names), glyph)

    def _paths(self, plot: Plot, known: np.ndarray) -> None:
        """Draw the way of each satellite, and where it stood last."""
        away, azimuth = 90.0 - np.rad2deg(self.signals.elevation), self.signals.azimuth
        x, y = away * np.sin(azimuth), away * np.cos(azimuth)
        columns: dict[str, list] = {
            name: [] for name in ("xs", "ys", "x", "y", "sat", "share", "colour")
        }
        for sat in self.satellites:
            of = self.signals.sat == sat
            rows = np.flatnonzero(of & known)
            if not rows.size:
                continue
            rows = rows[:: -(-rows.size // 100)]
            share = 100.0 * float(np.mean(self.fate[of] == 0))
            row = (x[rows], y[rows], x[rows[-1]], y[rows[-1]], sat, share,
                   _SYSTEMS.get(sat[0], GREY))  # fmt: skip
            for column, value in zip(columns.values(), row, strict=True):
                column.append(value)
        source = self.board.source(columns)
        ways = MultiLine(xs="xs", ys="ys", line_color="colour", line_width=2, line_alpha=0.6)
        self.board.draw(plot, source, ways)
        ends = Scatter(x="x", y="y", size=22, fill_color="white", line_color="colour", line_width=2)
        drawn = self.board.draw(plot, source, ends)
        self.board.tell(plot, drawn, ("@sat", "used @share{0} % of its epochs"))
        labels = Text(x="x", y="y", text="sat", text_font_size="9px", text_align="center",
                      text_baseline="middle", text_color=INK)  # fmt: skip
        self.board.draw(plot, source, labels)

    def _bars(self, sat: str) -> list[tuple[str, float, float, str, int]]:
        """Return the stretches of one satellite in which the same became of it."""
        rows = np.flatnonzero(self.signals.sat == sat)
        # Of several signals at an epoch the one that was used, or was refused last, speaks.
        rows = rows[np.lexsort((self.fate[rows], self.t[rows]))]
        rows = rows[np.diff(self.t[rows], prepend=-np.inf) > 0]
        step = np.diff(self.t[rows])
        usual = float(np.median(step)) if step.size else 1.0
        reason = self.signals.reason[rows]
        new = (step > 1.5 * usual) | (reason[1:] != reason[:-1])
        if new.sum() > _BARS:
            return self._shares(sat, rows, usual)
        first = np.r_[0, np.flatnonzero(new) + 1]
        last = np.r_[first[1:] - 1, rows.size - 1]
        return [
            (
                sat,
                float(self.t[rows[a]]) - usual / 2,
                float(self.t[rows[b]]) + usual / 2,
                str(reason[a]) or "used",
                int(self.fate[rows[a]]),
            )
            for a, b in zip(first, last, strict=True)
        ]

    def _shares(
        self, sat: str, rows: np.ndarray, usual: float
    ) -> list[tuple[str, float, float, str, int]]:
        """Return what became of a satellite most often in each of `_BARS` spans, and all counts."""
        t, out = self.t[rows], []
        edges = np.linspace(t[0] - usual / 2, t[-1] + usual / 2, _BARS + 1)
        parts = np.split(rows, np.searchsorted(t, edges[1:-1]))
        for part, left, right in zip(parts, edges[:-1], edges[1:], strict=True):
            if part.size:
                reasons, count = np.unique(self.signals.reason[part], return_counts=True)
                told = ", ".join(f"{r or 'used'} {n}" for r, n in zip(reasons, count, strict=True))
                fate = int(np.bincount(self.fate[part]).argmax())
                out.append((sat, float(left), float(right), told, fate))
        return out

    def _by_system(
        self, plot: Plot, value: FloatArray, name: str, unit: str, rows: np.ndarray
    ) -> None:
        """Scatter a value of each signal over time, extremes kept, one colour a system."""
        for system in sorted({sat[0] for sat in self.satellites}):
            of = rows[np.char.startswith(self.signals.sat[rows], system)]
            of = of[np.isfinite(value[of])]
            if not of.size:
                continue
            keep = of[thin(value[of], 3000)]
            columns = {"t": self.t[keep].astype("f4"), "y": value[keep].astype("f4"),
                       "sat": self.signals.sat[keep].tolist()}  # fmt: skip
            colour = _SYSTEMS.get(system, GREY)
            glyph = Scatter(x="t", y="y", size=3, fill_color=colour, line_color=colour,
                            fill_alpha=0.7, line_alpha=0.7)  # fmt: skip
            drawn = self.board.draw(plot, self.board.source(columns), glyph,
                                    _NAMES.get(system, system))  # fmt: skip
            self.board.tell(plot, drawn, ("@sat", f"@y{{0.00}} {unit} ({name})"),
                            ("", "@t{0.0} s since start"))  # fmt: skip


def _limit(residual: FloatArray) -> float:
    """Return up to where residuals are drawn apart [m/s]: noise shows, few are at the edge."""
    wanted = 1.5 * float(np.percentile(np.abs(residual), 98.0))
    return next((step for step in (0.1, 0.2, 0.5, 1.0, 2.0) if wanted <= step), 5.0)


def _dilution(signals: Signals) -> tuple[FloatArray, FloatArray]:
    """Return the times of epochs of four satellites or more, and horizontal and vertical DOP."""
    known = signals.take(np.isfinite(signals.elevation) & np.isfinite(signals.azimuth))
    if not len(known):
        return np.zeros(0), np.zeros((0, 2))
    names, which = np.unique(known.sat, return_inverse=True)
    milliseconds = np.rint(1e3 * known.time).astype(np.int64)
    _, one = np.unique(milliseconds * names.size + which, return_index=True)  # signal a satellite
    known = known.take(np.sort(one))
    times, first, count = np.unique(known.time, return_index=True, return_counts=True)
    el, az = known.elevation, known.azimuth
    G = np.column_stack(
        [np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), -np.sin(el), np.ones(el.size)]
    )
    normal = np.add.reduceat(G[:, :, None] * G[:, None, :], first)
    good = count >= 4
    good[good] = np.linalg.cond(normal[good]) < 1e9
    q = np.diagonal(np.linalg.inv(normal[good]), axis1=1, axis2=2)
    return times[good], np.sqrt(np.column_stack([q[:, 0] + q[:, 1], q[:, 2]]))
