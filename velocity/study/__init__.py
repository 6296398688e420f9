"""The statistics of the DDIA-VE paper, for any drive.

    samples            Doppler rows with the reference's velocity and attitude beside them
    pairs              velocities of all pairs of satellites, millions at once
    tables             their errors by C/N0 and |SDV·RMD| (Tables 2, 3, 5, Figs. 3, 5–8)
    statistics         bins, heat maps, correlations
    unaided            what inertial attitude costs in outages (Table 4, Fig. 4)
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
        binned_rms,
        correlations,
        heat_map,
        rejection,
    )
    from .tables import PairTable, concatenated, describe, pair_table
    from .unaided import Outage, outages, over_outages

#: Public names by the module that each is imported from when it is first asked for.
_PUBLIC = {
    "samples": ("Samples", "reference_samples"),
    "pairs": ("EpochSpeeds", "Pairs", "all_pairs", "epoch_speeds", "velocity_errors"),
    "tables": ("PairTable", "concatenated", "describe", "pair_table"),
    "statistics": (
        "Bins",
        "HeatMap",
        "Outage",
        "Rejection",
        "binned_rms",
        "correlations",
        "heat_map",
        "rejection",
    ),
    "unaided": ("Outage", "outages", "over_outages"),
    "below_four": ("FewSatellites", "few_satellites"),
}

__all__ = [
    "Bins",
    "EpochSpeeds",
    "FewSatellites",
    "HeatMap",
    "Outage",
    "PairTable",
    "Pairs",
    "Rejection",
    "Samples",
    "all_pairs",
    "binned_rms",
    "concatenated",
    "correlations",
    "describe",
    "epoch_speeds",
    "few_satellites",
    "heat_map",
    "outages",
    "over_outages",
    "pair_table",
    "reference_samples",
    "rejection",
    "velocity_errors",
]

__getattr__, __dir__ = names(__name__, _PUBLIC)
