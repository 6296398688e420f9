"""The figures of a run for papers: one file each, drawn by matplotlib."""

from __future__ import annotations

from pathlib import Path

from ...filters.errors import ConfigError
from ..page.pictures import save
from ..results.directory import Result
from . import figures
from .track import track

#: What a figure may be written as.
FIGURE_FORMATS = ("pdf", "svg", "png")
_DRAWN = {
    "track": track,
    "satellites": figures.satellites,
    "position": figures.position,
    "protection": figures.protection,
    "separation": figures.separation,
    "velocity": figures.velocity,
    "attitude": figures.attitude,
    "biases": figures.biases,
    "innovations": figures.innovations,
}


def write_figures(result: Result, folder: Path, kind: str = "pdf") -> list[Path]:
    """Write ``track.pdf``, ``position.pdf`` … into a folder, which is made; return their paths.

    Raises
    ------
    ConfigError
        If `kind` is none of `FIGURE_FORMATS`.
    """
    if kind not in FIGURE_FORMATS:
        raise ConfigError(f"figures: expected {', '.join(FIGURE_FORMATS)}, found '{kind}'")
    folder.mkdir(parents=True, exist_ok=True)
    paths = [(draw, folder / f"{name}.{kind}") for name, draw in _DRAWN.items()]
    return [path for draw, path in paths if save(draw, result, path)]
