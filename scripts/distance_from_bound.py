"""How far the filter's rows are from the best that can be done with two or three satellites.

    python scripts/distance_from_bound.py [--seeds 20] [--first 0]

Open sky, ADIS16470, positions and Doppler of all satellites until a spell begins; in it the
Doppler of two or three. The bound is the covariance of an error-state recursion of its own, along
the true motion with the true noise of everything: nothing linear and unbiased does better.
Drift is e(t) − e(t₀), horizontal, t₀ where the spell begins. Vehicle constraints are off.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from certnav.datasets.observations import GnssObservations
from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.signals import range_rate_sigma
from certnav.datasets.simulation.simulator import Simulation, SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.filters.rotation import FloatArray, skew
from certnav.filters.sensors import imu_preset
from certnav.nav.config_files import from_tables
from certnav.nav.pipeline import at_times, navigate

#: When a spell begins, and how long it lasts [s].
BEGIN, LENGTHS = 150.0, (60.0, 180.0)
DURATION = BEGIN + max(LENGTHS) + 10.0
SIGMA_POS = (1.0, 1.0, 2.0)
#: Walk of the simulated receiver's clock [m/s/√s] (`datasets.simulation.signals`).
CLOCK_WALK = 0.03
_STEP = 0.1
#: A signal in the open from some 25° up [dB-Hz], less five σ of what a receiver says of it.
_HIGH = 40.0
_OMEGA = skew(np.array([0.0, 0.0, 7.292115e-5]))


def main() -> None:
    """Print RMS drift at the end of spells, the bound, and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=0)
    arguments = parser.parse_args()
    print("| satellites | spell [s] | bound [m] | rows: RMS [m] | ratio, ± | largest drift/bound |")
    print("|---|---|---|---|---|---|")
    drives = [
        simulate(SimulationConfig(seed=s, duration=DURATION, density="open"))
        for s in range(arguments.first, arguments.first + arguments.seeds)
    ]
    for count in (2, 3):
        for length in LENGTHS:
            pairs = np.array([one(drive, count, length) for drive in drives])
            drift, bound = pairs.T
            ratio = np.sqrt(np.mean(drift**2) / np.mean(bound**2))
            # Of two components each with the bound's variance.
            spread = ratio / np.sqrt(4.0 * len(drives))
            print(
                f"| {count} | {length:.0f} | {np.sqrt(np.mean(bound**2)):.2f} | "
                f"{np.sqrt(np.mean(drift**2)):.2f} | {ratio:.2f} ± {spread:.2f} | "
                f"{(drift / bound).max():.1f} |",
                flush=True,
            )


def one(drive: Simulation, count: int, length: float) -> tuple[float, float]:
    """Return drift and bound of one drive at the end of a spell [m]."""
    rng = np.random.default_rng([count, drive.config.seed])
    start = drive.config.start_time
    spell = (start + BEGIN, start + BEGIN + length)
    kept = chosen(drive.observations, spell, count, rng)
    inside = (drive.observations.time > spell[0]) & (drive.observations.time <= spell[1])
    away = inside & ~np.isin(drive.observations.sat, kept)
    observations = drive.observations.mark(away, "cut")
    lever_b = drive.calibration.lever_antenna_b
    epochs = np.unique(observations.time)[1:-1]
    fixes = fixes_from_truth(drive.trajectory, epochs, lever_b, SIGMA_POS, 0.05, rng)
    fixes = fixes.take((fixes.time <= spell[0]) | (fixes.time > spell[1]))
    sequence = replace(drive.sequence(fixes), observations=observations)
    return drifted(sequence, spell), bounded(drive, observations, spell)


def chosen(
    observations: GnssObservations, spell: tuple[float, float], count: int, rng: np.random.Generator
) -> np.ndarray:
    """Return satellites in sight for the whole spell, well above the elevation mask."""
    inside = (observations.time > spell[0]) & (observations.time <= spell[1])
    inside &= observations.cn0 > _HIGH
    epochs = np.unique(observations.time[inside]).size
    sats, seen = np.unique(observations.sat[inside], return_counts=True)
    return rng.permutation(sats[seen == epochs])[:count]


def drifted(sequence: Sequence, spell: tuple[float, float]) -> float:
    """Return the horizontal drift of the filter over the spell [m]."""
    off = {"nhc": "off", "zupt": False, "zaru": False, "odometer": "off"}
    config = from_tables({
        "vehicle": off,
        "gnss": {"velocity": "doppler", "below_four": "rows", "forward_motion": "off"},
        "alignment": {"method": "level+course"}, "filter": {"protection_risk": 0.0},
    })  # fmt: skip
    track, truth = navigate(sequence, config).trajectory, sequence.reference
    assert truth is not None
    times = np.array(spell)
    error = at_times(track.time, track.pos_e, times) - at_times(truth.time, truth.pos_e, times)
    ned = (error[1] - error[0]) @ C_en_of(truth.pos_e[0])
    return float(np.hypot(ned[0], ned[1]))


def bounded(drive: Simulation, observations: GnssObservations, spell: tuple[float, float]) -> float:
    """Return 1σ of the horizontal drift of the best estimator over the spell [m].

    States: position, velocity, attitude (ECEF), gyro and accelerometer bias, clock drift.
    """
    spec, origin = imu_preset(drive.config.imu), drive.config.start_time
    deg, mg = np.pi / 180.0, 9.80665e-3
    degph = deg / 3600.0
    bias = np.repeat(
        [spec.gyro_bias_instability_degph * degph, spec.accel_bias_instability_mg * mg], 3
    )
    turn_on = np.repeat([spec.gyro_bias_turn_on_degph * degph, spec.accel_bias_turn_on_mg * mg], 3)
    tau = spec.bias_correlation_time_s
    P = np.diag(np.r_[np.full(3, 10.0), np.full(3, 1.0), np.full(3, 5.0 * deg), turn_on, 1e3] ** 2)
    noise = np.zeros(16)
    noise[3:6] = (spec.accel_vrw_mps_sqrth / 60.0) ** 2
    noise[6:9] = (spec.gyro_arw_deg_sqrth * deg / 60.0) ** 2
    noise[9:15] = 2.0 * bias**2 / tau
    noise[15] = CLOCK_WALK**2
    times = origin + np.arange(1.0, spell[1] - origin + _STEP / 2, _STEP)
    tr, lever_b = drive.trajectory, drive.calibration.lever_antenna_b
    C_eb = tr.C_eb(times)
    f_e = (C_eb @ tr.specific_force_b(times)[:, :, None])[:, :, 0]
    antenna_e = tr.pos_e(times) + C_eb @ lever_b
    epochs = {round(10 * float(t - origin)): rows for t, rows in observations.epochs()}
    begun = False
    for k, t in enumerate(times):
        if not begun and t > spell[0] + _STEP / 2:
            P[:3], P[:, :3], begun = 0.0, 0.0, True  # drift is counted from here
        F = np.zeros((16, 16))
        F[:3, 3:6] = np.eye(3)
        F[3:6, 3:6] = -2.0 * _OMEGA
        F[3:6, 6:9] = -skew(f_e[k])
        F[3:6, 12:15] = F[6:9, 9:12] = C_eb[k]
        F[6:9, 6:9] = -_OMEGA
        F[9:15, 9:15] = -np.eye(6) / tau
        Phi = np.eye(16) + F * _STEP + F @ F * (_STEP**2 / 2.0)
        P = Phi @ P @ Phi.T + np.diag(noise * _STEP)
        rows = epochs.get(round(10 * float(t - origin)))
        if rows is None:
            continue
        seen = observations.take(rows)
        seen = seen.take(seen.usable)
        place = antenna_e[k]
        e = seen.sat_pos_e - place
        e /= np.linalg.norm(e, axis=1)[:, None]
        H, R = np.zeros((len(e), 16)), range_rate_sigma(seen.cn0) ** 2
        H[:, 3:6], H[:, 15] = e, -1.0
        if t <= spell[0]:
            C_en = C_en_of(place)
            G = np.zeros((3, 16))
            G[:, :3] = C_en.T
            H, R = np.vstack([H, G]), np.r_[R, np.square(SIGMA_POS)]
        gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(R))
        P = (np.eye(16) - gain @ H) @ P
        P = 0.5 * (P + P.T)
    C_en = C_en_of(antenna_e[-1])
    ned: FloatArray = C_en.T @ P[:3, :3] @ C_en
    return float(np.sqrt(ned[0, 0] + ned[1, 1]))


if __name__ == "__main__":
    main()
