"""How long a live vehicle's samples take: `Navigator` with a 400 Hz IMU and 10 Hz GNSS.

    python scripts/live_latency.py [--hours H] [--history SECONDS] [--json]

A simulated car in streets. Every call of `add_imu` and `add_gnss` is timed by itself, in processor
time of one thread, and told by tenths of the drive: what does not grow is the same in the first
and in the last; each tenth has an IMU with turn-on biases of its own, at which a filter may be lost
and start again. An IMU sample that lets due GNSS in carries its updates. The clock of the process
is read to a microsecond, which is in the figures.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is imported

import numpy as np

from certnav import Navigator
from certnav.datasets.gpstime import from_week_sow
from certnav.datasets.sequence import Calibration
from certnav.datasets.simulation.sensors import fixes_from_truth, imu_measurements
from certnav.datasets.simulation.streets import RouteConfig, drive
from certnav.datasets.simulation.trajectory import Trajectory
from certnav.filters.sensors import imu_preset
from certnav.nav.config import Config
from certnav.nav.engine.events import GnssEvent

IMU_RATE, GNSS_RATE = 400, 10
LEVER = np.array([-0.65, -0.05, -0.15])
SIGMA_POS, SIGMA_VEL = 0.5, 0.05
PARTS = 10


def run(hours: float, history: float) -> dict:
    """Drive, and return latencies [µs] by tenths of the drive, and memory [MB]."""
    rng, duration, spec = np.random.default_rng(4), 3600.0 * hours, imu_preset("adis16470")
    motion = drive(RouteConfig(duration=duration + 2.0), rng)
    start = float(from_week_sow(2284, np.array(180000.0)))
    origin = (np.radians(30.53), np.radians(114.36), 30.0)
    trajectory = Trajectory(start, motion.time, motion.pos_t, motion.rpy, origin, (0.5, 0.0, -1.4))
    calibration = Calibration(lever_antenna_b=LEVER, lever_antenna_source="simulated", imu=spec)
    navigator = Navigator(calibration, Config(), 1.0 / IMU_RATE, history=history)
    parts, memory = [], []
    for part in range(PARTS):
        begin, end = (start + duration * k / PARTS for k in (part, part + 1))
        count = round((end - begin) * IMU_RATE)
        at = begin + np.arange(1, count + 1) / IMU_RATE
        imu, _, _ = imu_measurements(trajectory, at, spec, rng)
        fixes = fixes_from_truth(
            trajectory, begin + np.arange(1, round((end - begin) * GNSS_RATE)) / GNSS_RATE,
            LEVER, SIGMA_POS, SIGMA_VEL, rng,
        )  # fmt: skip
        events = [
            GnssEvent(float(t), kind, value, cov)
            for t, pos, pos_cov, vel, vel_cov in zip(
                fixes.time, fixes.pos_e, fixes.pos_cov_e, fixes.vel_e, fixes.vel_cov_e, strict=True
            )
            for kind, value, cov in (("position", pos, pos_cov), ("velocity", vel, vel_cov))
        ]
        parts.append(_fed(navigator, imu, events))
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)
    assert navigator.state is not None, navigator.waiting
    return {
        "hours": hours,
        "samples": round(duration * IMU_RATE),
        "latency_us": [_percentiles(part) for part in parts],
        "whole_us": _percentiles(np.concatenate(parts[1:])),
        "peak_mb": [round(value) for value in memory],
        "restarts": len(navigator.restarts),
    }


def _fed(navigator: Navigator, imu, events: list[GnssEvent]) -> np.ndarray:
    """Feed a part of the drive; return what each call has taken [s]."""
    spent = np.empty(len(imu) + len(events))
    waiting, number, now = iter(events), 0, time.thread_time
    event = next(waiting, None)
    for t, gyro_b, accel_b in zip(imu.time.tolist(), imu.gyro_b, imu.accel_b, strict=True):
        began = now()
        navigator.add_imu(t, gyro_b, accel_b)
        spent[number] = now() - began
        number += 1
        while event is not None and event.time <= t - 0.1:  # a receiver computes for a while
            began = now()
            navigator.add_gnss(event)
            spent[number] = now() - began
            number += 1
            event = next(waiting, None)
    return spent[:number]


def _percentiles(spent: np.ndarray) -> dict[str, float]:
    wanted = {"p50": 50.0, "p99": 99.0, "p99.9": 99.9, "max": 100.0}
    return {name: round(1e6 * float(np.percentile(spent, p)), 1) for name, p in wanted.items()} | {
        "mean": round(1e6 * float(spent.mean()), 1)
    }


def main() -> None:
    """Print the table, or JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=0.25)
    parser.add_argument("--history", type=float, default=60.0, help="rows and log kept [s]")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    arguments = parser.parse_args()
    figures = run(arguments.hours, arguments.history)
    if arguments.json:
        print(json.dumps(figures))
        return
    print(f"{figures['samples']} samples, {figures['restarts']} restarts; µs of processor a call")
    names = list(figures["whole_us"])
    print(f"{'tenth':<12}" + "".join(f"{name:>9}" for name in names) + f"{'MB':>8}")
    rows = zip(figures["latency_us"], figures["peak_mb"], strict=True)
    for k, (row, peak) in enumerate(rows, start=1):
        print(f"{k:<12}" + "".join(f"{row[name]:9.1f}" for name in names) + f"{peak:8d}")
    print(f"{'2 … 10':<12}" + "".join(f"{figures['whole_us'][name]:9.1f}" for name in names))


if __name__ == "__main__":
    main()
