"""What the DDIA-VE paper (PMC12736487) says of its own three sets, to stand beside ours.

GPS alone, Septentrio PolaRx5 at 1 Hz, ADIS16470. Where the paper gives a range or says "about",
so does this; None stands for what it does not give. Its slips are kept: set 3 of Table 3 loses
179, not 178, and the text has 42.47 dB-Hz for the 42.16 of set 1 in Table 5.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PaperSet:
    """One set of the paper.

    Parameters
    ----------
    name : str
    pairs, singular : int
        Table 2: samples with SNR and k; of them with k ≤ 0.05.
    rms, outliers, left : float, int, int
        Table 3: RMS before the outlier rule [m/s], samples rejected and left by it.
    yaw, roll, pitch : float
        Table 4: RMS over the first 200 epochs [deg].
    difference : tuple of float
        Table 4: RMS of the velocity difference on x, y, z [m/s].
    snr, snr_spread : float
        Table 5: mean of the pairs' mean SNR, its standard deviation [dB-Hz].
    at_40_20, at_45 : tuple of str
        Fig. 8: RMS [m/s] and share kept at SNR > 40, k > 0.2, and at SNR > 45.
    """

    name: str
    pairs: int
    singular: int
    rms: float
    outliers: int
    left: int
    yaw: float
    roll: float
    pitch: float
    difference: tuple[float, float, float]
    snr: float
    snr_spread: float
    at_40_20: tuple[str, str]
    at_45: tuple[str, str]


PAPER = (
    PaperSet(
        "paper, set 1", 11_035, 514, 2.92, 178, 10_343, 0.274, 1.305, 0.540,
        (0.028, 0.060, 0.098), 42.16, 5.37, ("≈ 0.3", "> 70 %"), ("≈ 0.3", "–"),
    ),
    PaperSet(
        "paper, set 2", 53_317, 3_449, 0.66, 559, 49_309, 0.153, 0.870, 0.718,
        (0.100, 0.135, 0.087), 42.47, 3.15, ("≈ 0.3", "> 70 %"), ("≈ 0.3", "< 30 %"),
    ),
    PaperSet(
        "paper, set 3", 11_590, 387, 4.15, 178, 11_024, 0.433, 1.812, 0.747,
        (0.054, 0.074, 0.110), 38.26, 5.32, ("≈ 0.3", "≈ 44 %"), ("≈ 0.3", "12.9 %"),
    ),
)  # fmt: skip
