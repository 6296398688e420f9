"""Alignment over sliding windows of a recording, against its reference.

    windows, noise = align_recording(load("comma2k19-example1"), WindowOptions(window=15.0))
    [window.heading for window in windows if window.passed]

    options      how a recording is cut, and what is kept of it
    rows         what goes into a window: Doppler, and the local velocity at the same instants
    methods      what each method says about one window
    recording    all windows of a recording, and their headings against the reference
    noise        Doppler noise as the windows themselves show it
    report       the windows as a table, as JSON, as a picture, with proofs

The names below are imported when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .noise import WindowNoise, fit_window_noise
    from .options import WindowOptions
    from .recording import WindowResult, align_recording, align_windows, summary

__all__ = [
    "WindowNoise",
    "WindowOptions",
    "WindowResult",
    "align_recording",
    "align_windows",
    "fit_window_noise",
    "summary",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "noise": ("WindowNoise", "fit_window_noise"),
        "options": ("WindowOptions",),
        "recording": ("WindowResult", "align_recording", "align_windows", "summary"),
    },
)
