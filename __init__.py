"""certnav: GNSS/INS navigation of road vehicles that starts itself, certified, in motion.

    from certnav import load, load_config, navigate, evaluate

    sequence = load("Dataset_campus-01", lever="figure", reference_point="mems")
    solution = navigate(sequence, load_config(None, ["filter.states=21"]))
    print(evaluate(solution, sequence).metrics["horizontal_rms_m"])

What it offers
--------------
load, Sequence
    A recording in one unit system, one set of axes, one time scale; every reader checks physics.
load_config
    The configuration of a run, from TOML and ``section.key=value``.
navigate, Navigator
    A whole recording, or a live vehicle sample by sample: the same answers.
evaluate
    A solution against a reference, and its covariance against its errors.
align
    Attitude from Doppler and local velocity, certified to be the global optimum.
align_anywhere
    The same without a position, which comes out as well.
ddia_velocity
    Velocity from one, two or more satellites and the attitude (DDIA-VE).
write_result, read_result
    The result directory of a run, written in one move and read back whole.
simulate
    A car in a city under a sky, with the truth known exactly.

Packages: `certnav.nav` runs and judges, `certnav.alignment` finds attitudes, `certnav.velocity`
turns Doppler into velocity, `certnav.datasets` reads and simulates, `certnav.filters` holds Earth,
sensors and the error-state filter.

Conventions, stated here once and kept throughout
-------------------------------------------------
Frames
    i inertial, e ECEF, n north-east-down, b body = IMU (forward, right, down), v vehicle
    (forward, right, down, at the point the wheels constrain), w local world (the body frame at a
    window's start), a antenna.
Vectors and rotations
    ``pos_e``, ``vel_e``, ``lever_b``: a vector in that frame. ``C_eb @ x_b == x_e``.
Attitude
    Roll: right side down +. Pitch: nose up +. Heading: clockwise from true north.
Units
    SI and radians. Degrees, deg/h and mg only in files, configuration, command line and reports,
    and then in the name: ``heading_deg``.
Time
    GPS seconds since the GPS epoch (week · 604800 + seconds of week), float64, no leap seconds.
Satellites
    Line of sight: unit vector from receiver to satellite. Doppler is positive when approaching;
    range rate = −λ·D is positive when receding.
Errors of the filter
    True − estimated; see `certnav.filters.error_model`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .lazy import names

if TYPE_CHECKING:
    from .alignment import align, align_anywhere
    from .datasets.loading import load
    from .datasets.sequence import Sequence
    from .datasets.simulation.simulator import simulate
    from .nav.config_files import load_config
    from .nav.evaluation.accuracy import evaluate
    from .nav.navigator import Navigator
    from .nav.pipeline import navigate
    from .nav.results.directory import read_result, write_result
    from .velocity.ddia import ddia_velocity

__all__ = [
    "Navigator",
    "Sequence",
    "align",
    "align_anywhere",
    "ddia_velocity",
    "evaluate",
    "load",
    "load_config",
    "navigate",
    "read_result",
    "simulate",
    "write_result",
]

__getattr__, __dir__ = names(
    __name__,
    {
        "alignment": ("align", "align_anywhere"),
        "datasets.loading": ("load",),
        "datasets.sequence": ("Sequence",),
        "datasets.simulation.simulator": ("simulate",),
        "nav.config_files": ("load_config",),
        "nav.evaluation.accuracy": ("evaluate",),
        "nav.navigator": ("Navigator",),
        "nav.pipeline": ("navigate",),
        "nav.results.directory": ("read_result", "write_result"),
        "velocity.ddia": ("ddia_velocity",),
    },
)
