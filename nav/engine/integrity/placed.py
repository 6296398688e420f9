"""Levels put beside the trajectory, and what they stand for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from ....filters.rotation import FloatArray
from ...config import Config
from ...solution import Protection, Trajectory
from ..events import GnssEvent
from ..vehicle import VehicleConstraints
from .levels import factors, semi_major
from .responses import BLOCK


def with_protection(
    trajectory: Trajectory, levels: FloatArray, risk: float, lacking: Trajectory
) -> Trajectory:
    """Return a trajectory with protection levels.

    Parameters
    ----------
    trajectory : Trajectory
    levels : ndarray, shape (m, 3)
        Of its legs; with none, the trajectory is returned as it is.
    risk : float
    lacking : Trajectory
        The same before what its σ lacked was added, which widens the levels as much.
    """
    if not len(levels):
        return trajectory
    sigma, before = (
        np.column_stack([semi_major(t.cov_pos_n), np.sqrt(t.cov_pos_n[:, 2, 2])])
        for t in (trajectory, lacking)
    )
    at = [np.interp(trajectory.time, levels[:, 0], column) for column in levels[:, 1:].T]
    k = np.array(factors(risk))
    protection = np.maximum(np.column_stack(at) + k * (sigma - before), k * sigma)
    return replace(trajectory, protection=protection)


def of_smoothed(levels: FloatArray) -> FloatArray:
    """Return levels for a smoothed solution: the largest from each until a block later.

    What is wrong with a sensor moves the filter, and the solution from the later data alike; the
    smoothed one is between them. The filter has believed these data as much within a block.
    """
    out = levels.copy()
    last = np.searchsorted(levels[:, 0], levels[:, 0] + BLOCK, side="right")
    for k, end in enumerate(last):
        out[k, 1:] = levels[k:end, 1:].max(axis=0)
    return out


def meaning(
    events: Iterable[GnssEvent], vehicle: VehicleConstraints, config: Config
) -> Protection | None:
    """Return what the levels of a run stand for; None where there are none."""
    risk = config.filter.protection_risk
    if risk == 0.0:
        return None
    usable = [e for e in events if not e.reason]
    positions = [e for e in usable if e.kind == "position"]
    with_ranges = [e.ranges is not None for e in positions]
    covers, lacks = [], []
    if any(with_ranges):
        covers.append("one satellite's pseudorange")
    if not all(with_ranges):
        lacks.append("positions whose satellites are not known: their errors as their σ says")
    if any(e.observations is not None for e in usable):
        covers.append("one satellite's Doppler")
        if config.gnss.below_four == "ddia":
            lacks.append("Doppler of two or three satellites (gnss.below_four = ddia)")
    if any(e.kind == "velocity" and e.observations is None for e in usable):
        lacks.append("velocities that come ready-made: their errors as their σ says")
    if vehicle.nhc:
        covers.append("sideslip or heave")
    if vehicle.odometer is not None:
        covers.append("slip of the odometer's wheel")
    return Protection(risk, tuple(covers), tuple(lacks))
