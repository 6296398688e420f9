"""Are mounting, lever arm and time offset found as well as a run says that they are?

    python scripts/calibration_recovery.py [--seeds 20] [--duration 300]

Simulated drives (ADIS16470, open sky) with centimetre positions and velocities at 1 Hz. Each has
its own mounting (pitch and yaw of 3° 1σ), antenna (off by 0.5 m 1σ per axis), wheel point and time
offset (0.05 s 1σ), of which the run is told these σ alone. For each constant: RMS of its error, RMS
of the σ that the run gives it, the mean of (error/σ)² over the drives with what chance makes of 1
(95 %), and the largest error in σ.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np
from scipy.stats import chi2

from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.rotation import FloatArray
from certnav.nav.config_files import from_tables
from certnav.nav.installation import Installation
from certnav.nav.pipeline import navigate

#: What the constants are drawn with, and what a run is told of them.
SIGMA_MOUNTING_DEG, SIGMA_LEVER, SIGMA_WHEEL, SIGMA_DELAY = 3.0, 0.5, 1.0, 0.05
CONSTANTS = {
    "mounting pitch": "°", "mounting yaw": "°", "antenna forward": "m", "antenna right": "m",
    "wheels forward": "m", "GNSS delay": "s",
}  # fmt: skip


def main() -> None:
    """Run the drives; print a line a constant."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--duration", type=float, default=300.0, help="of a drive [s]")
    arguments = parser.parse_args()
    found = np.array([recovered(seed, arguments.duration) for seed in range(arguments.seeds)])
    errors, sigmas = found[:, 0], found[:, 1]
    low, high = chi2.ppf([0.025, 0.975], arguments.seeds) / arguments.seeds
    print(f"{arguments.seeds} drives of {arguments.duration:.0f} s; chance: {low:.2f} … {high:.2f}")
    for k, (name, unit) in enumerate(CONSTANTS.items()):
        ratio = errors[:, k] / sigmas[:, k]
        print(
            f"  {name:16} error {np.sqrt(np.mean(errors[:, k] ** 2)):.3f} {unit}, σ "
            f"{np.sqrt(np.mean(sigmas[:, k] ** 2)):.3f} {unit}, mean (error/σ)² "
            f"{np.mean(ratio**2):.2f}, largest {np.abs(ratio).max():.1f} σ"
        )


def recovered(seed: int, duration: float) -> FloatArray:
    """Return errors and σ of the constants after one drive, shape (2, 6)."""
    rng = np.random.default_rng([seed, 15])
    pitch, yaw = SIGMA_MOUNTING_DEG * rng.standard_normal(2)
    config = SimulationConfig(
        seed=seed, duration=duration, density="open", mounting_rpy_deg=(0.0, pitch, yaw)
    )
    made = simulate(config)
    true, delay = made.calibration, SIGMA_DELAY * rng.standard_normal()
    epochs = made.imu.time[0] + np.arange(1.0, duration - 2.0)
    fixes = fixes_from_truth(made.trajectory, epochs, true.lever_antenna_b, 0.02, 0.03, rng)
    told = dataclasses.replace(
        true, C_bv=np.eye(3), mounting_source="square", delay_sigma=SIGMA_DELAY,
        mounting_sigma=float(np.radians(SIGMA_MOUNTING_DEG)), lever_vehicle_sigma=SIGMA_WHEEL,
        lever_vehicle_b=true.lever_vehicle_b + SIGMA_WHEEL * rng.standard_normal(3),
        lever_antenna_b=true.lever_antenna_b + SIGMA_LEVER * rng.standard_normal(3),
        lever_antenna_sigma=SIGMA_LEVER,
    )  # fmt: skip
    fixes = dataclasses.replace(fixes, time=fixes.time - delay)
    drive = Sequence(f"s{seed}", made.imu, told, fixes=fixes, reference=made.reference)
    found = navigate(drive, from_tables({})).installation
    assert found is not None
    exact = dataclasses.replace(found, C_bv=true.C_bv)
    antenna, wheel_v = found.antenna, true.C_bv.T @ true.lever_vehicle_b
    errors = [
        *np.degrees(found.pitch_yaw - exact.pitch_yaw),
        *(antenna.lever_b - true.lever_antenna_b)[:2],
        found.wheel_v[0] - wheel_v[0],
        antenna.delay - delay,
    ]
    return np.array([errors, sigmas(found)])


def sigmas(found: Installation) -> list[float]:
    """Return the σ that a run gives the constants."""
    return [
        *np.degrees(found.pitch_yaw_sigma),
        *found.antenna.sigma[:2],
        found.wheel_sigma[0],
        found.antenna.delay_sigma,
    ]


if __name__ == "__main__":
    main()
