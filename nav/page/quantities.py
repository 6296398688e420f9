"""Figures as a page prints them: three digits, a unit, a dash for what is not known."""

from __future__ import annotations


def quantity(value: float | None, unit: str) -> str:
    """Return a figure to three digits with its unit, or a dash."""
    if value is None or value != value:
        return "—"
    text = f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"
    return text + unit if unit in ("", "°") else f"{text} {unit}"


def length(value: float | None) -> str:
    """Return metres to three digits, or a dash."""
    return quantity(value, "m")


def percent(part: int, whole: int) -> str:
    """Return a share, with a decimal where it is close to none or all."""
    share = 100.0 * part / whole
    return f"{share:.1f} %" if 0.0 < share < 9.95 or 90.05 < share < 100.0 else f"{share:.0f} %"


def duration(seconds: float) -> str:
    """Return seconds, or minutes and seconds from two minutes on."""
    if seconds < 120.0:
        return f"{seconds:.3g} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s"
