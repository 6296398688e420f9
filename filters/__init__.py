"""Earth model, sensor models, strapdown mechanisation and the error-state filter.

    kalman = ErrorStateFilter(ErrorModel(imu_preset("adis16470")), stream, state, P)
    kalman.propagate(time)
    kalman.update(measurements.position(kalman.state, kalman.model.size, pos_e, cov_e, lever_b))

    earth                WGS 84, gravity, local axes
    rotation             rotations as matrices
    sensors              IMU grades in datasheet units, and presets
    strapdown            position, velocity, attitude from inertial samples
    error_model,         the error states, their dynamics and noise; those of GNSS
    gnss_states
    measurements,        z, H, R of positions, velocities and Doppler, and of what a road vehicle
    constraints          does not do
    levers               points beside the IMU: their velocity; mounting and wheel point
    standstill           when a vehicle stands
    ekf                  the filter: propagate, test, update
    measurement_update   the test before it, and the update itself, compiled and by filterpy
    smoother             the same, from the end backwards
    fault_exclusion      the largest set of equations that agree
    compiled/            their inner loops, compiled
    errors               what certnav refuses with, one line each

The names below are imported when they are first asked for: importing the package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..lazy import names

if TYPE_CHECKING:
    from .earth import C_en_of, ecef_to_lla, gravity_e, lla_to_ecef
    from .ekf import ErrorStateFilter
    from .error_model import ErrorModel
    from .errors import AlignmentError, ConfigError, DataError, NavError
    from .measurement_update import Outcome
    from .measurements import Measurement
    from .rotation import matrix_from_rpy, rpy_from_matrix
    from .sensors import ImuSpec, imu_preset
    from .smoother import smooth
    from .strapdown import InertialStream, NavState, integrate

#: Public names by the module that each is imported from when it is first asked for.
_PUBLIC = {
    "ekf": ("ErrorStateFilter",),
    "measurement_update": ("Outcome",),
    "error_model": ("ErrorModel",),
    "measurements": ("Measurement",),
    "strapdown": ("InertialStream", "NavState", "integrate"),
    "smoother": ("smooth",),
    "sensors": ("ImuSpec", "imu_preset"),
    "earth": ("C_en_of", "ecef_to_lla", "gravity_e", "lla_to_ecef"),
    "rotation": ("matrix_from_rpy", "rpy_from_matrix"),
    "errors": ("AlignmentError", "ConfigError", "DataError", "NavError"),
}

__all__ = [
    "AlignmentError",
    "C_en_of",
    "ConfigError",
    "DataError",
    "ErrorModel",
    "ErrorStateFilter",
    "ImuSpec",
    "InertialStream",
    "Measurement",
    "NavError",
    "NavState",
    "Outcome",
    "ecef_to_lla",
    "gravity_e",
    "imu_preset",
    "integrate",
    "lla_to_ecef",
    "matrix_from_rpy",
    "rpy_from_matrix",
    "smooth",
]

__getattr__, __dir__ = names(__name__, _PUBLIC)
