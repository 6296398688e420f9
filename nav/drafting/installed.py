"""Mounting and lever arm by a navigation that is told neither: what it has learned, with its σ."""

from __future__ import annotations

import dataclasses

import numpy as np

from ...datasets.own.blanks import BLANK
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
#: And of time stamps, 1σ [s]: in a turn a delay moves velocities as an arm does, braking does not.
_DELAY = 0.05
#: An axis is proposed that is known to this, 1σ [m].
_KNOWN = 0.3
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
    """Write how far forward and right the antenna is, where turns show it; down stays blank.

    Up and down move the antenna in pitch and roll alone, of which a road has little, and springs
    and mounting as much: what a run believes of it has been wrong, and a tape tells it.
    """
    if not draft.asks("antenna", "lever_frd_m"):
        return
    try:
        found = navigate(_untold(sequence), Config())
    except NavError as error:
        draft.leave("antenna", "lever_frd_m", f"not measured: {error}")
        return
    if found.installation is None or found.status != "ok":
        draft.leave("antenna", "lever_frd_m", "not measured: the run that would doubts itself")
        return
    antenna = found.installation.antenna
    arm, sigma = antenna.lever_b[:2], _FACTOR * antenna.sigma[:2]
    seen = [
        f"{name} {value:+.2f} ± {s:.2f} m" if s < _KNOWN else f"{name} not told by this drive"
        for name, value, s in zip(("forward", "right"), arm, sigma, strict=True)
    ]
    told = sigma < _KNOWN
    if not told.any():
        draft.leave("antenna", "lever_frd_m", "not measured: too little turning")
        return
    value = [round(float(v), 2) + 0.0 if ok else BLANK for v, ok in zip(arm, told, strict=True)]
    evidence = f"measured: {', '.join(seen)}, by a run; down shows in no turn, a tape tells it"
    draft.put("antenna", "lever_frd_m", [*value, BLANK], evidence)
    worst = round(float(sigma[told].max()), 2)
    draft.put("antenna", "lever_sigma_m", worst, "of what was measured; a run estimates the rest")


def _untold(sequence: Sequence) -> Sequence:
    """Return some minutes of the recording, of whose antenna and delay nothing is known."""
    calibration = dataclasses.replace(
        sequence.calibration, lever_antenna_b=np.zeros(3), lever_antenna_sigma=_CAR,
        lever_antenna_source="not declared",
        delay_sigma=max(sequence.calibration.delay_sigma, _DELAY),
    )  # fmt: skip
    part, fixes = sequence.inertial, sequence.fixes
    part = part.between(part.time[0], min(part.time[-1], part.time[0] + _LONGEST))
    if fixes is not None and len(fixes) > 1:
        fixes = fixes.take(
            slice(None, None, max(1, round(_EVERY / float(np.median(np.diff(fixes.time))))))
        )
    return dataclasses.replace(
        sequence, imu=part, fixes=fixes, calibration=calibration, reference=None
    )
