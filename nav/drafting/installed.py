"""Mounting and lever arm by a navigation that is told neither: what it has learned, with its σ."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...datasets.own.draft import Draft
from ...datasets.sequence import Sequence
from ...filters.errors import NavError
from ..check.mounting import mounting_findings, with_roll_of
from ..config import Config
from ..pipeline import navigate

#: So much of a drive is navigated for it [s].
_LONGEST = 400.0
#: And of positions one in so much [s]: more of them tell little more of an arm.
_EVERY = 1.0
#: What is known of a lever arm beforehand: a car's size, 1σ [m].
_CAR = 1.5
#: It is proposed where every axis is known to this, 1σ [m]; each axis is said from here on.
_KNOWN, _SAID = 0.15, 0.3
#: What a navigation's σ leaves out of it: phase centres, springs, delays of centimetres.
_FACTOR = 2.0


def mounting(draft: Draft, sequence: Sequence) -> None:
    """Write pitch and yaw of the IMU over their coarse values, where straights show them.

    Roll is that of the sequence, which is gravity's: no motion straight ahead shows it.
    """
    found = [f for f in mounting_findings(sequence) if f.subject == "mounting"]
    if not found:
        return
    n = found[0].numbers
    rpy = [
        round(float(v), 1) + 0.0
        for v in with_roll_of(sequence.calibration.C_bv, n["pitch_deg"], n["yaw_deg"])
    ]
    sigma = float(np.hypot(n["pitch_sigma_deg"], n["yaw_sigma_deg"]))
    evidence = (
        f"measured: pitch ± {n['pitch_sigma_deg']:.2f}, yaw ± {n['yaw_sigma_deg']:.2f} over "
        f"{n['straight_s']:.0f} s straight ahead"
    )
    draft.put("vehicle", "mounting_rpy_deg", rpy, evidence)
    draft.put("vehicle", "mounting_sigma_deg", max(1.0, round(3.0 * sigma, 1)), "a run estimates")


def lever(draft: Draft, sequence: Sequence) -> None:
    """Write the lever arm where motion shows all of it; else say what it shows."""
    if not draft.asks("antenna", "lever_frd_m"):
        return
    calibration = dataclasses.replace(
        sequence.calibration, lever_antenna_b=np.zeros(3), lever_antenna_sigma=_CAR,
        lever_antenna_source="not declared",
    )  # fmt: skip
    part, fixes = sequence.inertial, sequence.fixes
    part = part.between(part.time[0], min(part.time[-1], part.time[0] + _LONGEST))
    if fixes is not None and len(fixes) > 1:
        fixes = fixes.take(
            slice(None, None, max(1, round(_EVERY / float(np.median(np.diff(fixes.time))))))
        )
    alone = dataclasses.replace(
        sequence, imu=part, fixes=fixes, calibration=calibration, reference=None
    )
    try:
        solution = navigate(alone, Config())
    except NavError as error:
        draft.leave("antenna", "lever_frd_m", f"not measured: {error}")
        return
    if solution.installation is None or solution.status == "lost":
        draft.leave("antenna", "lever_frd_m", "not measured: no solution")
        return
    antenna = solution.installation.antenna
    sigma, arm = _FACTOR * antenna.sigma, antenna.lever_b
    if sigma.max() < _KNOWN:
        value = [round(float(v), 2) + 0.0 for v in arm]
        draft.put("antenna", "lever_frd_m", value, f"measured: ± {sigma.max():.2f} m, by a run")
        draft.put(
            "antenna", "lever_sigma_m", round(float(sigma.max()), 2), "a run estimates the rest"
        )
        return
    said = [
        f"{name} {value:+.2f} ± {s:.2f}"
        for name, value, s in zip(("forward", "right", "down"), arm, sigma, strict=True)
        if s < _SAID
    ]
    open_ = [
        name for name, s in zip(("forward", "right", "down"), sigma, strict=True) if s >= _SAID
    ]
    reason = f"measured by a run: {', '.join(said)} m" if said else "not measured"
    rest = f"; {' and '.join(open_)} not told by this drive" if open_ else ""
    draft.leave("antenna", "lever_frd_m", reason + rest)
