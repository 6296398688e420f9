"""Readers that turn files into one `Sequence`, the types themselves, and the simulator.

    sequence = load("Dataset_campus-01", lever="figure", reference_point="mems")
    sequence.imu, sequence.observations, sequence.reference, sequence.notes

    loading          load: the folder is recognised and handed to its reader
    sequence         Sequence and Calibration; its parts are
    series           ImuData, Odometer, Reference
    observations     GnssObservations row by row, and GnssFixes
    fields           what their arrays are held to
    physics          gravity and the course against the units and axes declared
    displacement     positions against velocities, by regression
    axes             axes of a sensor by name
    gpstime,         GPS seconds from and to calendars; time scales of files
    time_scales
    allan            noise of an IMU from a log at rest, and presets as files
    imu_faults       inertial axes that are frozen or clipped
    fix_faults       fixes that are none, or repeated in motion
    cache            what is read once and kept
    placing          directories that appear whole

    formats/         one module a public recording or file format
    great/           the GREAT dataset: reader, options, import, catalogue, writer
    solutions/       results of other programs, whatever their format
    own/             a user's own files by declaration, ``sequence.toml``
    simulation/      a car in a city under a sky, with the truth
    receivers/       receivers' own files: messages of raw logs, a file by itself
    rtklib/          RINEX, orbits, single-point and relative positions
    text/            numbers, tables and columns as instruments write them

The names below are imported when they are first asked for: importing the package costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..lazy import names

if TYPE_CHECKING:
    from .great.options import GreatOptions
    from .loading import load, recognise
    from .observations import GnssFixes, GnssObservations
    from .own.declare import draft_declaration
    from .sequence import Calibration, Sequence
    from .series import ImuData, Odometer, Reference
    from .simulation.simulator import Simulation, SimulationConfig, simulate

#: Public names by the module that each is imported from when it is first asked for.
_PUBLIC = {
    "loading": ("load", "recognise"),
    "sequence": ("Calibration", "Sequence"),
    "series": ("ImuData", "Odometer", "Reference"),
    "observations": ("GnssFixes", "GnssObservations"),
    "great.options": ("GreatOptions",),
    "own.declare": ("draft_declaration",),
    "simulation.simulator": ("Simulation", "SimulationConfig", "simulate"),
}

__all__ = [
    "Calibration",
    "GnssFixes",
    "GnssObservations",
    "GreatOptions",
    "ImuData",
    "Odometer",
    "Reference",
    "Sequence",
    "Simulation",
    "SimulationConfig",
    "draft_declaration",
    "load",
    "recognise",
    "simulate",
]

__getattr__, __dir__ = names(__name__, _PUBLIC)
