"""The statistics of the DDIA-VE paper, for any drive.

    samples            Doppler rows with the reference's velocity and attitude beside them
    pairs              velocities of all pairs of satellites, millions at once
    tables             their errors by C/N0 and |SDV·RMD| (Tables 1–3, Figs. 2, 3, 6)
    statistics         bins, heat maps, correlations
    unaided            what inertial attitude without help costs (Table 4, Fig. 4)
    below_four         least squares against the mean of pairs, few satellites drawn at random

The names below are imported when they are first asked for: importing the package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ...lazy import names

if TYPE_CHECKING:
    from .below_four import FewSatellites, few_satellites
    from .pairs import EpochSpeeds, Pairs, all_pairs, epoch_speeds, velocity_errors
    from .samples import Samples, reference_samples
    from .statistics import (
        Bins,
        HeatMap,
        Rejection,
        attitude_effect,
        binned_rms,
        correlations,
        heat_map,
        rejection,
    )
    from .tables import PairTable, concatenated, describe, pair_table
    from .unaided import DriftEffect, drift_effect

#: Public names by the module that each is imported from when it is first asked for.
_PUBLIC = {
    "samples": ("Samples", "reference_samples"),
    "pairs": ("EpochSpeeds", "Pairs", "all_pairs", "epoch_speeds", "velocity_errors"),
    "tables": ("PairTable", "concatenated", "describe", "pair_table"),
    "statistics": (
        "Bins",
        "HeatMap",
        "Rejection",
        "attitude_effect",
        "binned_rms",
        "correlations",
        "heat_map",
        "rejection",
    ),
    "unaided": ("DriftEffect", "drift_effect"),
    "below_four": ("FewSatellites", "few_satellites"),
}

__all__ = [
    "Bins",
    "DriftEffect",
    "EpochSpeeds",
    "FewSatellites",
    "HeatMap",
    "PairTable",
    "Pairs",
    "Rejection",
    "Samples",
    "all_pairs",
    "attitude_effect",
    "binned_rms",
    "concatenated",
    "correlations",
    "describe",
    "drift_effect",
    "epoch_speeds",
    "few_satellites",
    "heat_map",
    "pair_table",
    "reference_samples",
    "rejection",
    "velocity_errors",
]

__getattr__, __dir__ = names(__name__, _PUBLIC)
