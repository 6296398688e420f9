"""The palette of pages and figures.

Okabe and Ito's colours, which stay apart for colour-blind readers and in grey.
"""

from __future__ import annotations

BLUE, ORANGE, GREEN, VERMILLION = "#0072B2", "#E69F00", "#009E73", "#D55E00"
SKY, GREY, INK = "#56B4E9", "#8A8F98", "#1F2933"
