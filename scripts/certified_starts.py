"""Certified starts of a recording whose reference has no heading, from the IMU and Doppler alone.

    python scripts/certified_starts.py [--data DIR] [--every 20] [--within 60] [--json] [NAME]

The drive (default: tumsat-tsukishima, u-blox F9P and a 50 Hz MEMS IMU in Tokyo) is started every so
many seconds, as `certnav run` starts with ``alignment.method = certified``. What counts is time
spent faster than 5 m/s, traffic speed: `--within` so many seconds of it. Heading is held against
the course of the receiver's velocities, where the car is that fast and turns by less than 2°/s,
over the window that passed, or the minute after it. What the others waited for is counted by their
attempts in that time.
"""

from __future__ import annotations

import os

# Small matrices: threads cost more than they bring.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from certnav.alignment.in_motion.align import InertialAlignment
from certnav.alignment.in_motion.track import ImuParts
from certnav.datasets.loading import load
from certnav.datasets.sequence import Sequence
from certnav.filters.earth import C_en_of
from certnav.filters.rotation import wrap_angle
from certnav.filters.strapdown import InertialStream
from certnav.nav.config import Config
from certnav.nav.engine.gnss import GnssTimeline, gnss_timeline
from certnav.nav.engine.model import error_model
from certnav.nav.engine.start.finder import StartFinder

#: Traffic speed [m/s], and the yaw rate up to which a car points where it goes [rad/s].
TRAFFIC, STRAIGHT = 5.0, np.radians(2.0)
#: Epochs that a heading is judged by, at least.
ENOUGH = 5
#: Waiting longer than this is not waiting for an alignment [s].
LONGEST = 300.0
#: What a message is about, by a word in it.
REASONS = {
    "at rest": "at rest",
    "in motion for": "too little motion yet",
    "no heading": "heading not known well enough yet",
    "heading ±": "heading not known well enough yet",
    "are needed": "too many rows rejected",
    "χ²/dof": "rows inconsistent",
    "bound": "attitude not bounded",
    "without": "hangs on one satellite",
    "rival": "a rival is as good",
    "runner-up": "a rival is as good",
    "too few": "too few rows",
}


@dataclass(frozen=True)
class Outcome:
    """One start."""

    begin: float
    driven: float  # time at traffic speed until it was certified, or given up [s]
    certified: bool
    error_deg: float
    sigma_deg: float
    waited: Counter[str]


class Motion:
    """Speed and course by the receiver's velocities."""

    def __init__(self, sequence: Sequence) -> None:
        fixes = sequence.fixes
        assert fixes is not None
        known = fixes.has_velocity
        self.time = fixes.time[known]
        vel_n = np.einsum("nji,nj->ni", C_en_of(fixes.pos_e[known]), fixes.vel_e[known])
        self.speed, self.course = np.hypot(*vel_n[:, :2].T), np.arctan2(vel_n[:, 1], vel_n[:, 0])
        self.interval = float(np.median(np.diff(self.time)))

    def driven(self, begin: float, end: float) -> float:
        """Return the time spent at traffic speed [s]."""
        inside = (self.time >= begin) & (self.time < end)
        return float(np.sum(self.speed[inside] > TRAFFIC)) * self.interval

    def heading_error(
        self, found: InertialAlignment, stream: InertialStream, C_bv: np.ndarray
    ) -> float:
        """Return the median of heading − course over a window [rad].

        Of a window without straight driving it is that of the minute after it, to which the gyros
        carry the heading (the Earth turns by 0.25° meanwhile); NaN if there is none, either.
        """
        track, C_nv = found.track, C_en_of(found.pos_e).T
        attitudes = np.array([track.attitude(found.C_eb, k) for k in range(track.time.size)])
        errors = self._errors(track.time, track.omega_b, C_nv @ attitudes @ C_bv)
        if errors.size < ENOUGH:
            time = np.arange(found.time, min(found.time + 60.0, stream.end - 0.5), 0.5)
            later = ImuParts(stream).track(time, np.append(found.gyro_bias, found.accel_bias))
            attitudes = found.C_eb @ later.C_wb[0].T @ later.C_wb
            errors = self._errors(later.time, later.omega_b, C_nv @ attitudes @ C_bv)
        return float(np.median(errors)) if errors.size >= ENOUGH else float("nan")

    def _errors(self, time: np.ndarray, omega_b: np.ndarray, C_nv: np.ndarray) -> np.ndarray:
        """Return heading − course where the car drives fast and straight [rad]."""
        near = np.clip(np.searchsorted(self.time, time), 0, self.time.size - 1)
        good = (np.abs(omega_b[:, 2]) < STRAIGHT) & (np.abs(self.time[near] - time) < 0.25)
        good &= self.speed[near] > TRAFFIC
        heading = np.arctan2(C_nv[:, 1, 0], C_nv[:, 0, 0])
        return np.asarray(wrap_angle(heading - self.course[near])[good])


def reason(message: str) -> str:
    """Return what an attempt was waiting for."""
    return next((said for word, said in REASONS.items() if word in message), message)


def start(
    sequence: Sequence, timeline: GnssTimeline, motion: Motion, begin: float, within: float,
    config: Config,
) -> Outcome:  # fmt: skip
    """Start at `begin`."""
    imu, calibration = sequence.inertial, sequence.calibration
    after = imu.time >= begin
    stream = InertialStream(imu.time[after], imu.gyro_b[after], imu.accel_b[after])
    model = error_model(calibration, config, odometer=False, doppler=True, shared=False, nhc=False)
    finder = StartFinder(stream, calibration, config.alignment, model, config.vehicle.kind)
    end, found = begin, None
    for event in timeline.events:
        if event.time < begin:
            continue
        end = event.time
        driven = motion.driven(begin, end)
        if driven > within or end > begin + LONGEST or end > stream.end - 0.1:
            break
        found = finder.offer(event)
        if found is not None:
            break
    waited = Counter(
        reason(message) for time, message in finder.attempts if motion.driven(begin, time) > 0.0
    )
    if found is None or found.certified is None:
        return Outcome(begin, motion.driven(begin, end), False, np.nan, np.nan, waited)
    error = motion.heading_error(found.certified, stream, calibration.C_bv)
    sigma = float(np.degrees(found.certified.sigma_heading))
    return Outcome(begin, motion.driven(begin, end), True, float(np.degrees(error)), sigma, waited)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = Path(os.environ.get("CERTNAV_DATA", "../shared/data"))
    parser.add_argument("name", nargs="?", default="tumsat-tsukishima")
    parser.add_argument("--data", type=Path, default=default)
    parser.add_argument("--every", type=float, default=20.0, metavar="S", help="[20 s]")
    parser.add_argument("--within", type=float, default=60.0, metavar="S", help="[60 s]")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    sequence = load(arguments.data / arguments.name)
    config = Config()
    config = replace(config, alignment=replace(config.alignment, method="certified"))
    timeline, motion = gnss_timeline(sequence, config.gnss), Motion(sequence)
    with_doppler = [e.time for e in timeline.events if e.epoch is not None]
    first, last = with_doppler[0], with_doppler[-1]
    outcomes = []
    for begin in np.arange(first, last, arguments.every):
        if motion.driven(begin, last) < arguments.within:
            break  # not enough driving is left to be judged
        outcomes.append(start(sequence, timeline, motion, begin, arguments.within, config))
        if not arguments.json:
            show(outcomes[-1], first)
    certified = [o for o in outcomes if o.certified]
    errors = np.abs([o.error_deg for o in certified])
    waiting = Counter(o.waited.most_common(1)[0][0] for o in outcomes if not o.certified)
    figures = {
        "starts": len(outcomes),
        "certified": len(certified),
        "median_driven_s": float(np.median([o.driven for o in certified])) if certified else None,
        "heading_mean_deg": float(np.nanmean(errors)) if certified else None,
        "heading_largest_deg": float(np.nanmax(errors)) if certified else None,
        "judged": int(np.isfinite(errors).sum()),
        "beyond_3_deg": int(np.sum(errors > 3.0)),
        "beyond_4_sigma": int(
            sum(abs(o.error_deg) > 4.0 * np.hypot(o.sigma_deg, 0.5) for o in certified)
        ),
        "others_waited_for": dict(waiting.most_common()),
    }
    print(
        json.dumps(figures)
        if arguments.json
        else "\n".join(f"{k}: {v}" for k, v in figures.items())
    )


def show(outcome: Outcome, first: float) -> None:
    """Print one start."""
    if outcome.certified:
        said = f"certified, heading off by {outcome.error_deg:+.1f}° (σ {outcome.sigma_deg:.1f}°)"
    else:
        said = ", ".join(f"{name} {count}" for name, count in outcome.waited.most_common(4))
    print(f"{outcome.begin - first:6.0f} s  {outcome.driven:5.1f} s driven  {said}", flush=True)


if __name__ == "__main__":
    main()
