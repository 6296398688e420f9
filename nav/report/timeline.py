"""The panels of the report: everything over time, and what is distributed."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models import FactorRange, HoverTool, Line, Plot, Range1d, Scatter, Span, Text
from bokeh.plotting import figure

from ...filters.rotation import FloatArray
from ...filters.sensors import STANDARD_GRAVITY
from ..evaluation.accuracy import rpy_covariance, standard_deviation
from ..page.board import Board
from ..page.palette import BLUE, GREEN, GREY, INK, ORANGE, SKY, VERMILLION
from ..page.plots import look
from ..page.thinning import pieces, runs, thin
from ..results.directory import Result
from ..results.formats import geodetic_and_ned
from .coverage import age_of_position, gnss_state
from .span import ROWS

#: Shading behind lines, by the GNSS states of `gnss_state`.
SHADES = {1: "#FBE7BF", 2: "#DCDFE4"}
_NED, _RPY = ("north", "east", "down"), ("roll", "pitch", "heading")
#: Stretches of which a line keeps least and greatest: 3,000 points, whatever the drive's length.
_BINS = 1500
_KINDS = (BLUE, ORANGE, GREEN, VERMILLION, SKY, GREY, INK)


class Timeline:
    """The panels of one result, on the board of its page.

    Every method returns rows of plots for `Board.place`; an empty list where there is nothing to
    show. Times on the board are seconds since the start of the recording.
    """

    def __init__(self, result: Result, board: Board) -> None:
        self.result, self.board = result, board
        self.trajectory = result.solution.trajectory
        self.t = self.trajectory.time - board.start
        state = gnss_state(result)
        end = float(self.t[-1])
        self._outages = board.shading(
            {colour: runs(self.t, state == code, end) for code, colour in SHADES.items()}
        )
        _, self.vel_n, self.rpy_deg = geodetic_and_ned(self.trajectory)

    def satellites(self) -> list[list[Plot]]:
        """Draw satellites tracked and usable."""
        epochs = self.result.solution.epochs
        if not (epochs.usable >= 0).any():
            return []
        plot = self.panel("satellites", "Satellites tracked and usable")
        t = epochs.time - self.board.start
        for count, colour, name in (
            (epochs.tracked, GREY, "tracked"), (epochs.usable, BLUE, "usable"),
        ):  # fmt: skip
            keep, cut = pieces(t, count.astype(float), bins=_BINS)
            self.board.line(
                plot, t[keep], count[keep].astype(float), colour, name, cut=cut, mode="after"
            )
        for level in (4, 2):
            plot.add_layout(_level(level))
        plot.y_range = Range1d(0, max(5.0, 1.08 * float(epochs.tracked.max())))
        return [[plot]]

    def position(self) -> list[list[Plot]]:
        """Draw position errors and ±3σ, or ±3σ alone."""
        sigma3 = 3.0 * standard_deviation(self.trajectory.cov_pos_n)
        evaluation = self.result.evaluation
        full = ("north", "east", "up") if evaluation.time.size <= ROWS else ("",) * 3
        plots = self._errors(evaluation.error_pos_n, sigma3, _NED, "m", full=full)
        return [[p] for p in plots]

    def velocity(self) -> list[list[Plot]]:
        """Draw velocity errors and ±3σ."""
        sigma3 = 3.0 * standard_deviation(self.trajectory.cov_vel_n)
        return [[p] for p in self._errors(self.result.evaluation.error_vel_n, sigma3, _NED, "m/s")]

    def attitude(self) -> list[list[Plot]]:
        """Draw attitude errors, raw and with the constant misalignment removed, and ±3σ."""
        cov = rpy_covariance(self.trajectory.cov_att_n, np.deg2rad(self.rpy_deg))
        sigma3 = 3.0 * np.rad2deg(standard_deviation(cov))
        e = self.result.evaluation
        panels = self._errors(
            np.rad2deg(e.error_rpy_aligned), sigma3, _RPY, "°", np.rad2deg(e.error_rpy)
        )
        return [[p] for p in panels]

    def motion(self) -> list[list[Plot]]:
        """Draw speed, heading, roll and pitch."""
        speed = self.panel("speed [m/s]", "Horizontal speed")
        self.line(speed, self.t, np.hypot(*self.vel_n[:, :2].T), BLUE, "speed", "m/s", scale=True)
        heading = self.panel("heading [°]", "Heading", y_range=Range1d(0, 360),
                             ticks=(0, 90, 180, 270, 360))  # fmt: skip
        self.line(heading, self.t, self.rpy_deg[:, 2], BLUE, "heading", "°", wrap=360.0)
        tilt = self.panel("roll, pitch [°]", "Roll and pitch")
        for k, colour in ((0, BLUE), (1, ORANGE)):
            self.line(tilt, self.t, self.rpy_deg[:, k], colour, _RPY[k], "°", scale=True)
        return [[speed], [heading], [tilt]]

    def since_fix(self) -> list[list[Plot]]:
        """Draw the horizontal error over the time since the last accepted position."""
        evaluation = self.result.evaluation
        if not evaluation.has_reference:
            return []
        age = np.interp(
            evaluation.time, self.trajectory.time, _finite(age_of_position(self.result))
        )
        if not (age > 2.0).any():
            return []
        error = np.hypot(*evaluation.error_pos_n[:, :2].T)
        keep = _strongest(age, error)
        plot = self.board.free("time since the last accepted position [s]", "horizontal error [m]",
                               "Drift: error over time since the last position")  # fmt: skip
        plot.x_range.start = 0
        source = self.board.source({
            "age": age[keep], "error": error[keep], "t": evaluation.time[keep] - self.board.start,
        })  # fmt: skip
        glyph = Scatter(x="age", y="error", size=4, **_filled(BLUE, 0.6))
        self.board.tell(
            plot, self.board.draw(plot, source, glyph), ("since the last position", "@age{0.0} s"),
            ("error", "@error{0.00} m"), ("at", "@t{0.0} s since start"),
        )  # fmt: skip
        return [[plot]]

    def distribution(self) -> list[list[Plot]]:
        """Draw the distribution of horizontal error, and of what the filter claims."""
        evaluation = self.result.evaluation
        if not evaluation.has_reference or evaluation.time.size < 10:
            return []
        plot = self.board.free("horizontal error [m]", "share of the time below [%]",
                               "How often the error was below")  # fmt: skip
        plot.x_range.start = 0
        share = np.linspace(0.0, 100.0, 401)
        error = np.hypot(*evaluation.error_pos_n[:, :2].T)
        source = self.board.source({"x": np.percentile(error, share), "y": share})
        drawn = self.board.draw(plot, source, Line(line_color=BLUE, line_width=2), "error")
        plot.add_tools(HoverTool(renderers=[drawn], mode="hline", visible=False, tooltips=[
            ("", "@y{0.0} % of the time below @x{0.00} m")]))  # fmt: skip
        # Rayleigh with the filter's own variances, averaged over the run.
        variance = np.mean(evaluation.sigma_pos_n[:, :2] ** 2, axis=1)
        x = np.linspace(0.0, float(error.max()) or 1.0, 201)
        claimed = 100.0 * (1.0 - np.exp(-(x[:, None] ** 2) / (2.0 * variance[:: _every(variance)])))
        source = self.board.source({"x": x, "y": claimed.mean(axis=1)})
        glyph = Line(line_color=ORANGE, line_width=2, line_dash="dashed")
        self.board.draw(plot, source, glyph, "as the filter's σ would have it")
        plot.y_range = Range1d(0, 101)
        return [[plot]]

    def biases(self) -> list[list[list[Plot]]]:
        """Draw the estimated biases of gyro and accelerometers, a grid each, with ±3σ."""
        trajectory = self.trajectory
        per_degph, per_mg = np.rad2deg(1.0) * 3600.0, 1e3 / STANDARD_GRAVITY
        sides = (
            ("gyro", "°/h", per_degph * trajectory.gyro_bias, per_degph * trajectory.std_gyro_bias),
            ("accelerometer", "mg", per_mg * trajectory.accel_bias,
             per_mg * trajectory.std_accel_bias),
        )  # fmt: skip
        columns = []
        for sensor, unit, bias, std in sides:
            column = []
            for k, axis in enumerate("xyz"):
                plot = self.panel(f"{axis} [{unit}]", f"{sensor} bias, {axis}", height=170)
                keep = thin(std[:, k], 300)
                low, high = (bias[keep, k] + sign * 3.0 * std[keep, k] for sign in (-1, 1))
                self.board.band(plot, self.t[keep], low, high, SKY)
                self.line(plot, self.t, bias[:, k], BLUE, "estimate", unit)
                room = min(3.0 * std[:, k].max(), max(float(np.ptp(bias[:, k])),
                           4.5 * float(np.median(std[:, k])))) or 1.0  # fmt: skip
                plot.y_range = Range1d(bias[:, k].min() - 1.1 * room, bias[:, k].max() + 1.1 * room)
                column.append([plot])
            columns.append(column)
        return columns

    def innovations(self) -> list[list[Plot]]:
        """Draw the whitened innovations of each kind of update."""
        updates = [u for u in self.result.solution.updates if u.whitened]
        rows = []
        for kind in dict.fromkeys(u.kind for u in updates):
            plot = self.panel(f"{kind} [1]", f"Innovations of {kind} over their σ", height=170,
                              y_range=Range1d(-6.5, 6.5))  # fmt: skip
            samples = [
                (u.time - self.board.start, w, _fate(u.accepted, u.reason), u.reason,
                 " ".join(u.satellites))
                for u in updates if u.kind == kind for w in u.whitened
            ]  # fmt: skip
            for fate, colour, marker in (
                ("accepted", BLUE, "circle"), ("rejected", VERMILLION, "x"),
                ("gate overruled", ORANGE, "diamond"),
            ):  # fmt: skip
                chosen = [s for s in samples if s[2] == fate]
                if chosen:
                    self._scatter(plot, chosen, fate, colour, marker)
            for level in (-3.0, 3.0):
                plot.add_layout(_level(level))
            rows.append([plot])
        return rows

    def _scatter(
        self, plot: Plot, samples: list[tuple], fate: str, colour: str, marker: str
    ) -> None:
        t, w = np.array([s[0] for s in samples]), np.array([s[1] for s in samples])
        keep = thin(np.abs(w), 2 * _BINS) if fate == "accepted" else np.arange(w.size)[: 4 * _BINS]
        columns: dict[str, Any] = {
            "t": t[keep].astype("f4"), "y": np.clip(w[keep], -6.0, 6.0).astype("f4"),
            "w": w[keep].astype("f4"),
        }  # fmt: skip
        tips = [("", "@t{0.00} s since start"), (fate, "@w{0.00} σ")]
        if fate != "accepted":
            columns |= {"reason": [samples[k][3] for k in keep]}
            tips.append(("because", "@reason"))
        if fate != "accepted" and any(s[4] for s in samples):  # those of all are in updates.csv
            columns |= {"sats": [samples[k][4] for k in keep]}
            tips.append(("satellites", "@sats"))
        glyph = Scatter(x="t", y="y", marker=marker, size=4 if fate == "accepted" else 8,
                        **_filled(colour, 0.8))  # fmt: skip
        self.board.tell(plot, self.board.draw(plot, self.board.source(columns), glyph, fate), *tips)

    def panel(self, label: str, title: str = "", height: int = 190, **options: Any) -> Plot:
        """Return an empty panel over time, shaded where GNSS fell short."""
        plot = self.board.panel(label, title, height, **options)
        plot.renderers = list(self._outages)
        return plot

    def line(
        self, plot: Plot, t: FloatArray, y: FloatArray, colour: str, label: str, unit: str,
        *, wrap: float | None = None, scale: bool = False, full: str = "",
    ) -> None:  # fmt: skip
        """Draw a thinned line, broken at holes in time and where an angle wraps."""
        keep, cut = pieces(t, y, wrap, _BINS)
        self.board.line(
            plot, t[keep], y[keep], colour, label, unit, cut=cut, scale=scale, full=full
        )

    def _errors(
        self, error: FloatArray, sigma3: FloatArray, names: Sequence[str], unit: str,
        raw: FloatArray | None = None, full: Sequence[str] = ("",) * 3,
    ) -> list[Plot]:  # fmt: skip
        """Draw each error with its ±3σ on a scale on which the error shows; else ±3σ alone."""
        out = []
        t_error = self.result.evaluation.time - self.board.start
        for k, name in enumerate(names):
            known = np.isfinite(error[:, k])
            what = "error" if known.any() else "±3σ, no reference"
            limit = 1.1 * float(sigma3[:, k].max()) or 1.0
            plot = self.panel(f"{name} [{unit}]", f"{name.capitalize()}: {what}",
                              y_range=Range1d(-limit, limit), tags=["error"])  # fmt: skip
            keep = thin(sigma3[:, k], _BINS)
            self.board.band(plot, self.t[keep], -sigma3[keep, k], sigma3[keep, k], SKY)
            if known.any():
                if raw is not None:
                    self.line(plot, t_error, raw[:, k], GREY, "raw", unit)
                label = "error" if raw is None else "aligned"
                self.line(plot, t_error, error[:, k], BLUE, label, unit, scale=True, full=full[k])
            out.append(plot)
        return out


def start_up(attempts: Sequence[tuple[float, str]], board: Board) -> list[list[Plot]]:
    """Draw what a start in motion waited for: one row a reason, one mark an attempt."""
    reasons = list(dict.fromkeys(_reason(message) for _, message in attempts))
    if not reasons:
        return []
    t = np.array([time for time, _ in attempts]) - board.start
    plot = figure(
        height=96 + 34 * len(reasons), sizing_mode="stretch_width", tools=[],
        y_range=FactorRange(*reversed(reasons), range_padding=0.4), toolbar_location=None,
        title="What the start waited for",
    )  # fmt: skip
    look(plot)
    plot.xaxis.axis_label = "time since start [s]"
    plot.yaxis.visible = plot.ygrid.visible = False  # the names stand over their marks
    names = board.source({"y": reasons})
    board.draw(plot, names, Text(x=float(t.min()), y="y", text="y", text_font_size="11px",
                                 text_color=INK, y_offset=-7))  # fmt: skip
    source = board.source({
        "t": t, "y": [_reason(m) for _, m in attempts], "message": [m for _, m in attempts],
    })  # fmt: skip
    marks = Scatter(x="t", y="y", marker="dash", angle=np.pi / 2, size=12, **_filled(BLUE))
    board.tell(plot, board.draw(plot, source, marks), ("", "@t{0.0} s"), ("", "@message"))
    return [[plot]]


def _reason(message: str) -> str:
    """Return what an attempt missed and what would help, without its figures."""
    missed, _, help_ = message.removeprefix("not aligned: ").split(";")[0].partition(", needs ")
    if help_ or message.startswith("not aligned"):
        name = re.split(r" for |[±(]| \d", missed)[0].strip()
        short = f"{name}: {help_}" if help_ else name
    else:
        short = message.split(":")[0].split(" over ")[0]
    return short if len(short) <= 50 else short[:48].rstrip() + " …"


def _fate(accepted: bool, reason: str) -> str:
    if not accepted:
        return "rejected"
    return "gate overruled" if reason else "accepted"


def _filled(colour: str, alpha: float = 1.0) -> dict[str, Any]:
    """Return what gives a marker one colour."""
    return {"fill_color": colour, "line_color": colour, "fill_alpha": alpha, "line_alpha": alpha}


def _level(at: float) -> Span:
    return Span(location=at, dimension="width", line_color=INK, line_dash="dashed", line_width=1)


def _finite(values: FloatArray) -> FloatArray:
    return np.where(np.isfinite(values), values, 0.0)


def _every(values: FloatArray) -> int:
    return -(-values.size // 400)


def _strongest(x: FloatArray, y: FloatArray, count: int = 3000) -> np.ndarray:
    """Return at most so many indices, keeping the extremes of `y` along `x`."""
    order = np.argsort(x, kind="stable")
    return order[thin(y[order], count // 2)]
