"""Range rates and lines of sight from Doppler, and the velocities they give.

    rows = doppler_rows(observations, pos_e, DopplerNoise())      # all equations of an epoch
    doppler_velocity(rows, time)                                  # four satellites or more
    ddia_velocity(rows, forward_motion(C_eb, omega_b, lever_b), time)         # two or more

    range_rate         Doppler as linear equations in velocity
    linearised         those equations, for any places or for the one of an epoch
    least_squares      their solution for four satellites or more, faults left out
    vehicle_motion     what the attitude says: a road vehicle moves where it points
    ddia               the velocity from one, two or more satellites with that help
    aided_velocity     what they return
    screening          which pairs of satellites to trust
    aided_screening    which satellites to trust when the velocity is roughly known
    doppler_noise      a receiver's noise over C/N0 and elevation, fitted to what it did
    constellations     their Doppler held against each other: drift, and noise
    phase_rates        range rates from the carrier's phase, and Doppler held against them
    wheel_speed        how late an odometer is, and its scale
    mounting           the IMU's mounting in the vehicle, from straight driving
    tracks             velocities of a recording from every source it has

    study/             the paper's statistics, of any drive

The names below are imported when they are first asked for: importing the package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..lazy import names

if TYPE_CHECKING:
    from .aided_velocity import AidedVelocity
    from .ddia import (
        ddia_pair,
        ddia_velocities,
        ddia_velocity,
        drift_free,
        ndia_velocity,
    )
    from .doppler_noise import NoiseFit, fit_doppler_noise, own_residuals, reference_residuals
    from .least_squares import DopplerVelocity, doppler_velocities, doppler_velocity
    from .mounting import Mounting, calibrate_mounting, sequence_mounting
    from .phase_rates import phase_gate, phase_intervals, with_phase_rates
    from .range_rate import (
        DopplerNoise,
        DopplerRows,
        LineOfSight,
        doppler_rows,
        line_of_sight,
        predicted_range_rate,
        with_elevation,
    )
    from .screening import Screening, screen
    from .vehicle_motion import ForwardMotion, forward_motion

#: Public names by the module that each is imported from when it is first asked for.
_PUBLIC = {
    "range_rate": (
        "DopplerNoise",
        "DopplerRows",
        "LineOfSight",
        "doppler_rows",
        "line_of_sight",
        "predicted_range_rate",
        "with_elevation",
    ),
    "least_squares": ("DopplerVelocity", "doppler_velocities", "doppler_velocity"),
    "vehicle_motion": ("ForwardMotion", "forward_motion"),
    "aided_velocity": ("AidedVelocity",),
    "ddia": (
        "ddia_pair",
        "ddia_velocities",
        "ddia_velocity",
        "drift_free",
        "ndia_velocity",
    ),
    "screening": ("Screening", "screen"),
    "doppler_noise": ("NoiseFit", "fit_doppler_noise", "own_residuals", "reference_residuals"),
    "mounting": ("Mounting", "calibrate_mounting", "sequence_mounting"),
    "phase_rates": ("phase_gate", "phase_intervals", "with_phase_rates"),
}

__all__ = [
    "AidedVelocity",
    "DopplerNoise",
    "DopplerRows",
    "DopplerVelocity",
    "ForwardMotion",
    "LineOfSight",
    "Mounting",
    "NoiseFit",
    "Screening",
    "calibrate_mounting",
    "ddia_pair",
    "ddia_velocities",
    "ddia_velocity",
    "doppler_rows",
    "doppler_velocities",
    "doppler_velocity",
    "drift_free",
    "fit_doppler_noise",
    "forward_motion",
    "line_of_sight",
    "ndia_velocity",
    "own_residuals",
    "phase_gate",
    "phase_intervals",
    "predicted_range_rate",
    "reference_residuals",
    "screen",
    "sequence_mounting",
    "with_elevation",
    "with_phase_rates",
]

__getattr__, __dir__ = names(__name__, _PUBLIC)
