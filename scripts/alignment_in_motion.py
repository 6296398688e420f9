"""Alignment of a car that moves from the first sample: time, heading error and honesty.

    python scripts/alignment_in_motion.py [--runs 20] [--seed 1] [--duration 90] [--every 2]
                                          [--json]

A simulated car in traffic, lights and corners; ADIS16470 (500 deg/h of gyro bias, 10 mg and 3000
ppm at turn-on), Doppler at 1 Hz from so many satellites drawn at random, a receiver clock that
walks by 0.03 m/s/√s; no odometer, no course, no standstill to begin with. For each number of
satellites under an open sky, and for what streets leave of them ('urban', with reflections):

    aligned             share of runs in which some window passed
    seconds             from the first sample to the first that passed (median)
    heading_deg         its heading error (median, largest)
    after_turn_deg      heading error 30 s after the first turn began, with whatever passed last
                        by then (median), and the share of runs that had something by then
    nees                of the attitude of the first window that passed, mean (3 is perfect)
    nees_all            of all windows that passed: mean over the drives of each drive's mean
    passed, wrong       windows that passed over the whole drive, and those of them whose attitude
                        is further from the truth than their bound
"""

from __future__ import annotations

import os

# Small matrices: threads cost more than they bring.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
from dataclasses import dataclass

import numpy as np

from certnav.alignment.in_motion.unknowns import InertialOptions
from certnav.alignment.in_motion.waiting import Attempt, MotionOptions, attempts
from certnav.alignment.problem import ClockModel
from certnav.alignment.solver.refinement import rotation_angle
from certnav.datasets.observations import GnssObservations
from certnav.datasets.simulation.simulator import Simulation, SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.filters.strapdown import InertialStream
from certnav.velocity.range_rate import DopplerNoise

#: What the simulator's receiver has.
NOISE, CLOCK = DopplerNoise(0.03, 0.02), ClockModel("random-walk", 0.03)
#: Yaw rate at which a turn has begun [rad/s].
TURNING = np.radians(5.0)
SATELLITES = (4, 3, 2, 8)
URBAN = 0


@dataclass
class Judged:
    """An attempt that passed, against the truth."""

    time: float
    heading: float
    angle: float
    bound: float
    nees: float


def judged(simulation: Simulation, attempt: Attempt) -> Judged:
    found = attempt.alignment
    assert found is not None
    truth = simulation.trajectory.C_eb(np.array([found.time]))[0]
    off = truth @ found.C_eb.T
    psi_e = 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
    heading = abs(float(C_en_of(found.pos_e)[:, 2] @ psi_e))
    angle = float(rotation_angle(found.C_eb, truth))
    nees = float(psi_e @ np.linalg.solve(found.cov_e, psi_e))
    return Judged(found.time, heading, angle, found.result.bound, nees)


def drawn(
    observations: GnssObservations, satellites: int, rng: np.random.Generator
) -> GnssObservations:
    """Keep so many of the satellites above 10° at the beginning."""
    high = observations.elevation > np.radians(10.0)
    names = np.unique(observations.sat[high & (observations.time == observations.time[0])])
    kept = rng.permutation(names)[:satellites]
    return observations.take(np.isin(observations.sat, kept) & high)


def first_turn(simulation: Simulation) -> float:
    """Time at which the first turn begins, NaN if there is none."""
    time = simulation.reference.time
    rate = np.abs(np.gradient(np.unwrap(simulation.reference.rpy[:, 2]), time))
    turning = np.flatnonzero(rate > TURNING)
    return float(time[turning[0]]) if turning.size else float("nan")


def drive(seed: int, satellites: int, duration: float, options: MotionOptions) -> dict:
    """One drive: everything that passed, when, and how wrong it was."""
    config = SimulationConfig(
        seed=seed, duration=duration, static_start=0.0, moving_start=True, scale_factors=True,
        density="open" if satellites else "urban",
    )  # fmt: skip
    simulation = simulate(config)
    imu, rng = simulation.imu, np.random.default_rng([seed, satellites])
    observations = simulation.observations
    if satellites:
        observations = drawn(observations, satellites, rng)
    observations = observations.mark(observations.cn0 < 35.0, "weak signal")
    lever = simulation.calibration.lever_antenna_b
    pos_e = simulation.trajectory.pos_e(observations.time, lever) + rng.normal(0.0, 5.0, 3)
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    passed = [
        judged(simulation, attempt)
        for attempt in attempts(stream, observations, pos_e, lever, options)
        if attempt.passed
    ]
    by = first_turn(simulation) + 30.0
    before = [p for p in passed if p.time <= by]
    return {
        "start": float(imu.time[0]),
        "passed": passed,
        "turn": by,
        "by": before[-1] if before else None,
    }


def summary(drives: list[dict]) -> dict:
    first = [d["passed"][0] for d in drives if d["passed"]]
    seconds = [d["passed"][0].time - d["start"] for d in drives if d["passed"]]
    turned = [d for d in drives if np.isfinite(d["turn"])]
    after = [d["by"] for d in turned if d["by"] is not None]
    everything = [p for d in drives for p in d["passed"]]
    each = [np.mean([p.nees for p in d["passed"]]) for d in drives if d["passed"]]

    def degrees(values: list[float], function) -> float | None:
        return round(float(np.degrees(function(values))), 3) if values else None

    return {
        "runs": len(drives),
        "aligned": round(len(first) / len(drives), 3),
        "seconds": round(float(np.median(seconds)), 1) if seconds else None,
        "heading_deg": degrees([p.heading for p in first], np.median),
        "heading_max_deg": degrees([p.heading for p in first], np.max),
        "after_turn_deg": degrees([p.heading for p in after], np.median),
        "after_turn_share": round(len(after) / len(turned), 3) if turned else None,
        "nees": round(float(np.mean([p.nees for p in first])), 2) if first else None,
        "nees_all": round(float(np.mean(each)), 2) if each else None,
        "passed": len(everything),
        "wrong": sum(p.angle > p.bound for p in everything),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--duration", type=float, default=90.0, help="of a drive [s]")
    parser.add_argument("--every", type=float, default=2.0, help="time between attempts [s]")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    options = MotionOptions(
        inertial=InertialOptions(noise=NOISE, clock=CLOCK), every=arguments.every
    )
    figures = {}
    for satellites in (*SATELLITES, URBAN):
        name = str(satellites) if satellites else "urban"
        seeds = range(arguments.seed, arguments.seed + arguments.runs)
        drives = [drive(seed, satellites, arguments.duration, options) for seed in seeds]
        figures[name] = summary(drives)
        if not arguments.json:
            print(f"{name:6}", figures[name], flush=True)
    if arguments.json:
        print(json.dumps(figures))


if __name__ == "__main__":
    main()
