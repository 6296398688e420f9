"""The figures of a run as plain values: the content of summary.json."""

from __future__ import annotations

import dataclasses
import importlib.metadata
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ...datasets.sequence import Sequence
from ...filters.rotation import FloatArray
from ..evaluation.accuracy import Evaluation
from ..notes import plain
from ..solution import Separation, Solution, Update


def summarise(solution: Solution, evaluation: Evaluation, sequence: Sequence) -> dict[str, Any]:
    """Return the content of summary.json.

    ``duration_s`` is the span of the solution, ``alignment.time_s`` the wait from the start of the
    data to the first solution epoch (whose GPS time is ``gps_time_s``), ``epochs`` counts GNSS
    epochs by usable satellites, of those that say how many (ready-made fixes may not).
    """
    time, usable = solution.trajectory.time, solution.epochs.usable
    usable = usable[usable >= 0]
    alignment, calibration = solution.alignment, sequence.calibration
    return {
        "name": solution.name,
        "status": solution.status,
        "certnav_version": _version(),
        "duration_s": float(time[-1] - time[0]) if time.size else 0.0,
        "imu_samples": len(sequence.inertial),
        "epochs": {
            "total": int(usable.size),
            "ge4": int((usable >= 4).sum()),
            "two_or_three": int(((usable >= 2) & (usable < 4)).sum()),
            "lt2": int((usable < 2).sum()),
        },
        "alignment": {
            "status": alignment.status,
            "method": alignment.method,
            "time_s": alignment.waited,
            "gps_time_s": alignment.time,
            "sigma_heading_deg": np.rad2deg(alignment.sigma_heading),
            "message": alignment.message,
            "bound_deg": None if alignment.bound is None else np.rad2deg(alignment.bound),
            "verdicts": dict(alignment.verdicts),
        },
        "installation": None if solution.installation is None else solution.installation.figures(),
        "errors": evaluation.metrics,
        "reference": {
            "source": evaluation.source,
            "point": evaluation.point,
            "epochs_compared": int(evaluation.time.size),
            "epochs_left_out": evaluation.left_out,
            "misalignment_rpy_deg": np.rad2deg(evaluation.misalignment_rpy),
        }
        if evaluation.has_reference
        else None,
        "consistency": evaluation.consistency,
        "position_noise": None
        if solution.fix_errors is None
        else dataclasses.asdict(solution.fix_errors),
        "rtk": None if solution.resolution is None else dataclasses.asdict(solution.resolution),
        "protection": protection_figures(solution, evaluation),
        "separation": separation_figures(solution.separation),
        "updates": count_updates(solution.updates),
        "timing": {"total_s": None, "read_s": None, "filter_s": None} | solution.timing,
        "sensors": {
            "imu": calibration.imu.name,
            "imu_rate_hz": 1.0 / sequence.inertial.interval,
            "lever_antenna_b_m": calibration.lever_antenna_b,
            "lever_antenna_source": calibration.lever_antenna_source,
        },
        "notes": [
            dataclasses.asdict(note)
            for note in dict.fromkeys([*plain(sequence.notes), *solution.notes])
        ],
    }


def protection_figures(solution: Solution, evaluation: Evaluation) -> dict[str, Any] | None:
    """Return the protection levels in figures: what they stand for, how large they are [m], and,
    with a reference, the share of its epochs with an error beyond.
    """
    levels, meant = solution.trajectory.protection, solution.protection
    if meant is None or not np.isfinite(levels).all():
        return None
    figures: dict[str, Any] = dataclasses.asdict(meant)
    error = evaluation.error_pos_n
    errors = np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])
    for name, level, off in zip(("horizontal", "vertical"), levels.T, errors, strict=True):
        there = np.interp(evaluation.time, solution.trajectory.time, level)
        figures[f"{name}_median_m"] = float(np.median(level))
        figures[f"{name}_p95_m"] = float(np.percentile(level, 95))
        figures[f"{name}_max_m"] = float(level.max())
        figures[f"{name}_exceeded"] = float(np.mean(off > there)) if off.size else None
    return figures


def separation_figures(separation: Separation | None) -> dict[str, float] | None:
    """Return the separation in figures: RMS [m] where both sides know the position, and χ²."""
    if separation is None:
        return None
    known = np.isfinite(separation.chi2)

    def rms(part: FloatArray) -> float:
        return float(np.sqrt(np.mean(np.sum(part[known, :2] ** 2, axis=1)))) if known.any() else 0.0

    return {
        "forward_horizontal_rms_m": rms(separation.forward_n),
        "backward_horizontal_rms_m": rms(separation.backward_n),
        "chi2_mean": float(separation.chi2[known].mean()) if known.any() else float("nan"),
        "known_share": float(known.mean()) if known.size else 0.0,
    }


def count_updates(updates: Iterable[Update]) -> dict[str, dict[str, Any]]:
    """Return, by kind, how many updates were offered, accepted, and rejected for which reason.

    Updates that were accepted out of the ordinary (they carry a reason too) are counted among the
    accepted, and again under ``accepted_although``, which is there only if there are any.
    """
    counts: dict[str, dict[str, Any]] = {}
    for u in updates:
        entry = counts.setdefault(u.kind, {"offered": 0, "accepted": 0, "rejected": Counter()})
        entry["offered"] += 1
        if u.accepted:
            entry["accepted"] += 1
            if u.reason:
                entry.setdefault("accepted_although", Counter())[u.reason] += 1
        else:
            entry["rejected"][u.reason or "no reason given"] += 1
    for entry in counts.values():
        for key in entry.keys() & {"rejected", "accepted_although"}:
            entry[key] = dict(entry[key].most_common())
    return counts


def strict(value: Any) -> Any:
    """Return `value` as plain JSON types, with None for what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): strict(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [strict(item) for item in value]
    if isinstance(value, np.generic):
        return strict(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _version() -> str:
    try:
        return importlib.metadata.version("certnav")
    except importlib.metadata.PackageNotFoundError:
        return "not installed"
