"""The paper's tables, a row a recording and the paper's own below; the numbers of its figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from ..page.tables import Column, Table
from .paper import PAPER, PaperSet
from .recording import Studied, Study

_COUNT, _SHARE, _SPEED = ",d", ".1%", ".2f"
_RECORDING = Column("recording")


def tables(study: Study) -> list[Table]:
    """Return Tables 2 to 5 and the operating points of Fig. 8."""
    return [_table2(study), _table3(study), _table4(study), _table5(study), _operating(study)]


def series(study: Study) -> list[Table]:
    """Return the numbers behind Figs. 3 to 8, one line a point, without the paper's."""
    return [
        _long(study, "fig3", "RMS error by |k|", "bins", (
            ("low", "k from", ""), ("high", "k to", ""), ("count", "pairs", ""),
            ("rms_mps", "RMS [m/s]", ""))),
        _fig4(study),
        _fig5(study),
        _long(study, "fig6", "Mean SNR of the pairs by satellite", "by_satellite", (
            ("sat", "satellite", ""), ("count", "pairs", ""), ("mean_dbhz", "mean SNR [dB-Hz]", ""),
            ("std_db", "standard deviation [dB]", ""))),
        _long(study, "fig7", "Correlation of |k| with the error within SNR ranges", "within_snr", (
            ("above", "SNR above [dB-Hz]", ""), ("up_to", "SNR up to [dB-Hz]", ""),
            ("count", "pairs", ""), ("rms_mps", "RMS [m/s]", ""), ("pearson", "Pearson", ""),
            ("spearman", "Spearman", ""))),
        _long(study, "fig8", "RMS and share kept over thresholds", "heatmap", (
            ("snr", "SNR above [dB-Hz]", ""), ("k", "k above", ""), ("count", "pairs", ""),
            ("rms_mps", "RMS [m/s]", ""), ("kept", "kept", ""))),
    ]  # fmt: skip


def _rows(
    study: Study, ours: Callable[[Studied], Iterable[object]],
    papers: Callable[[PaperSet], Iterable[object]], width: int,
) -> tuple[tuple[object, ...], ...]:  # fmt: skip
    """Return one row a recording and one a set of the paper."""
    out: list[tuple[object, ...]] = []
    for one in study.recordings:
        values = tuple(ours(one)) if one.figures else (None,) * width
        out.append((one.name, *values))
    return (*out, *((p.name, *papers(p)) for p in PAPER))


def _table2(study: Study) -> Table:
    def ours(one: Studied) -> tuple[object, ...]:
        f = one.figures
        share = f["k05_kept"] / f["pairs"]
        return f["pairs"], f["pairs"] - f["k05_kept"], f["k05_kept"], share

    def papers(p: PaperSet) -> tuple[object, ...]:
        return p.pairs, p.singular, p.pairs - p.singular, 1.0 - p.singular / p.pairs

    columns = (
        _RECORDING, Column("samples with SNR and k", "", _COUNT),
        Column("k ≤ 0.05, discarded", "", _COUNT), Column("retained", "", _COUNT),
        Column("retained", "share", ".2%"),
    )  # fmt: skip
    return Table("table2", "Singular geometry (Table 2)", columns, _rows(study, ours, papers, 4))


def _table3(study: Study) -> Table:
    def ours(one: Studied) -> tuple[object, ...]:
        f = one.figures
        samples, left = f["k05_kept"], f["kept_3rms"]
        share = left / samples if samples else None
        return (samples, f["rms_k05_mps"], f["limit_mps"], samples - left, left, share,
                f["rms_3rms_mps"])  # fmt: skip

    def papers(p: PaperSet) -> tuple[object, ...]:
        samples = p.pairs - p.singular
        return samples, p.rms, 3.0 * p.rms, p.outliers, p.left, p.left / samples, None

    columns = (
        _RECORDING, Column("samples", "", _COUNT), Column("RMS", "m/s", _SPEED),
        Column("3 RMS", "m/s", _SPEED), Column("rejected", "", _COUNT),
        Column("left", "", _COUNT), Column("left", "share", _SHARE),
        Column("RMS of those left", "m/s", _SPEED),
    )  # fmt: skip
    return Table("table3", "Outliers (Table 3)", columns, _rows(study, ours, papers, 7))


def _table4(study: Study) -> Table:
    keys = ("outages", "epochs", "pairs", "yaw_rms_deg", "roll_rms_deg", "pitch_rms_deg",
            "x_rms_mps", "y_rms_mps", "z_rms_mps")  # fmt: skip

    def ours(one: Studied) -> tuple[object, ...]:
        return tuple(one.attitude.get(key) for key in keys)

    def papers(p: PaperSet) -> tuple[object, ...]:
        return (1, 200, None, p.yaw, p.roll, p.pitch, *p.difference)

    columns = (
        _RECORDING, Column("outages", "", _COUNT), Column("epochs", "", _COUNT),
        Column("pairs", "", _COUNT), Column("yaw", "°", ".3f"), Column("roll", "°", ".3f"),
        Column("pitch", "°", ".3f"), Column("x", "m/s", ".3f"), Column("y", "m/s", ".3f"),
        Column("z", "m/s", ".3f"),
    )  # fmt: skip
    text = (
        f"RMS over the first {study.options.epochs} epochs of an outage: attitude of the IMU "
        "alone against the reference, and velocity difference that makes, ECEF (Table 4)"
    )
    return Table("table4", text, columns, _rows(study, ours, papers, len(keys)))


def _table5(study: Study) -> Table:
    def ours(one: Studied) -> tuple[object, ...]:
        cn0 = one.figures["cn0"]
        return cn0["count"], cn0["mean_dbhz"], cn0["std_db"]

    def papers(p: PaperSet) -> tuple[object, ...]:
        return p.left, p.snr, p.snr_spread

    columns = (
        _RECORDING, Column("pairs", "", _COUNT),
        Column("mean of the pairs' mean SNR", "dB-Hz", _SPEED),
        Column("its standard deviation", "dB", _SPEED),
    )  # fmt: skip
    return Table("table5", "Signal strength (Table 5)", columns, _rows(study, ours, papers, 3))


def _operating(study: Study) -> Table:
    points = ((40.0, 0.2), (45.0, 0.05))

    def ours(one: Studied) -> tuple[object, ...]:
        cells = [one.at(*point) for point in points]
        return tuple(cell.get(key) for cell in cells for key in ("count", "rms_mps", "kept"))

    def papers(p: PaperSet) -> tuple[object, ...]:
        return None, *p.at_40_20, None, *p.at_45

    columns = (
        _RECORDING, Column("SNR > 40, k > 0.2: pairs", "", _COUNT), Column("RMS", "m/s", _SPEED),
        Column("kept", "share", _SHARE), Column("SNR > 45: pairs", "", _COUNT),
        Column("RMS", "m/s", _SPEED), Column("kept", "share", _SHARE),
    )  # fmt: skip
    return Table("operating_points", "Operating points (Fig. 8)", columns,
                 _rows(study, ours, papers, 6))  # fmt: skip


def _long(
    study: Study, name: str, caption: str, key: str, columns: tuple[tuple[str, str, str], ...]
) -> Table:
    """Return the entries of one figure of every recording below each other."""
    rows = [
        (one.name, *(entry[part] for part, _, _ in columns))
        for one in study.recordings
        for entry in one.figures.get(key, ())
    ]
    heads = (_RECORDING, *(Column(title, "", digits) for _, title, digits in columns))
    return Table(name, caption, heads, tuple(rows))


def _fig4(study: Study) -> Table:
    rows: list[tuple[Any, ...]] = []
    for one in study.recordings:
        for number, outage in enumerate(one.outages, 1):
            medians = by_epoch(outage.pair_time, outage.difference_e, outage.time)
            for time, angle, speed in zip(
                outage.time, np.degrees(outage.rpy_error), medians, strict=True
            ):
                rows.append((one.name, number, time - outage.start, *angle, *speed))
    names = ("outage", "since [s]", "roll [°]", "pitch [°]", "yaw [°]", "x [m/s]", "y [m/s]",
             "z [m/s]")  # fmt: skip
    caption = "IMU attitude against the reference's, and the median velocity difference of pairs"
    return Table("fig4", caption, (_RECORDING, *map(Column, names)), tuple(rows))


def by_epoch(pair_time: np.ndarray, values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the median of the pairs' values in every epoch; NaN where there are none."""
    out = np.full((time.size, values.shape[1]), np.nan)
    for number, epoch in enumerate(time):
        here = pair_time == epoch
        if here.any():
            out[number] = np.median(values[here], axis=0)
    return out


def _fig5(study: Study) -> Table:
    rows = [
        (one.name, factor, value["pearson"], value["spearman"])
        for one in study.recordings
        for factor, value in one.figures.get("correlation", {}).items()
    ]
    names = ("factor", "Pearson", "Spearman")
    caption = "Correlation of the error with what may go with it"
    return Table("fig5", caption, (_RECORDING, *map(Column, names)), tuple(rows), words=2)
