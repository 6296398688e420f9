"""Whose are the weights that `certnav tune` finds? Three ways to use them, on simulated receivers.

    python scripts/known_weights.py [--duration 150] [--seeds 3] [--scatter]

One receiver is as simulated, one has twice its noise, one has errors that last for seconds at 5 Hz,
as tracking loops that smooth have. Weights are fitted to one drive of each against its reference,
and applied to other drives of all three: insisted on, where a recording shows the same noise by
itself (`gnss.doppler_known_mps`), and half-way between them and what fits the recording. Told is
ln of the horizontal RMS over that of the default, as recorded and in spells of two or three
satellites, the mean over drives. `--scatter`: how far σ fitted to drives of one receiver differ.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator

import numpy as np

from certnav.datasets.sequence import Sequence
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.errors import NavError
from certnav.nav.config import Config
from certnav.nav.engine.prepared import Prepared as Common
from certnav.nav.engine.velocity_noise.fitted import MEASURED
from certnav.nav.tune.candidates import Weights, insisting_keys
from certnav.nav.tune.settings import OUTAGES
from certnav.nav.tune.trials import Prepared, pooled, prepare, try_out
from certnav.velocity.range_rate import DopplerNoise

#: By receiver: rate [Hz], white noise that is added and errors that last, in σ of the simulator.
RECEIVERS = {"as simulated": (1.0, 0.0, 0.0), "noisy": (1.0, 1.7, 0.0), "lasting": (5.0, 0.0, 1.7)}
#: For how long they do [s].
LASTING = 10.0


def drive(receiver: str, seed: int, duration: float, density: str = "suburb") -> Sequence:
    """Return a drive of a receiver, with positions of a metre and a half."""
    rate, white, lasting = RECEIVERS[receiver]
    config = SimulationConfig(
        receiver, seed, duration, density=density, imu_rate=50.0, gnss_rate=rate
    )
    made = simulate(config)
    rng = np.random.default_rng([seed, 1])
    time = np.arange(np.ceil(made.imu.time[1]), made.imu.time[-1] - 1.0)
    lever = made.calibration.lever_antenna_b
    sequence = made.sequence(fixes=fixes_from_truth(made.trajectory, time, lever, 1.5, 0.05, rng))
    seen = sequence.observations
    assert seen is not None
    error = white * rng.normal(size=len(seen))
    for sat in np.unique(seen.sat):
        rows = np.flatnonzero(seen.sat == sat)
        fades = np.exp(-np.diff(seen.time[rows], prepend=-np.inf) / LASTING)
        state = 0.0
        for row, fade, draw in zip(rows, fades, rng.normal(size=rows.size), strict=True):
            state = fade * state + np.sqrt(1.0 - fade**2) * draw
            error[row] += lasting * state
    sigma = DopplerNoise(0.03, 0.02).sigma(seen.cn0)
    return dataclasses.replace(
        sequence, observations=dataclasses.replace(seen, range_rate=seen.range_rate + sigma * error)
    )


def ways(weights: Weights, there: Prepared) -> Iterator[tuple[str, Config]]:
    """Yield the ways to use weights on a recording."""
    plain = Config()
    yield "insisted", _with(plain, insisting_keys(weights.noise))
    yield "where it shows the same", _with(plain, weights.keys())
    if there.shown:
        middle = np.sqrt(np.array(there.shown) * weights.noise.sigma(MEASURED))
        thermal = np.sqrt(max((middle[0] ** 2 - middle[1] ** 2) / 9.0, 1e-8))
        floor = np.sqrt(max(middle[1] ** 2 - thermal**2, 1e-6))
        yield "half-way", _with(plain, insisting_keys(DopplerNoise(thermal, floor)))


def _with(config: Config, keys: dict) -> Config:
    return dataclasses.replace(config, gnss=dataclasses.replace(config.gnss, **keys))


def scatter(duration: float) -> None:
    """Print how far σ fitted to drives of one receiver are from their mean."""
    found = []
    for density in ("open", "suburb", "urban", "canyon"):
        for length in (duration, 400.0):
            for seed in range(101, 104):
                try:
                    one = drive("as simulated", seed, length, density)
                    errors = Common(one, own_noise=True).noise(Config())[0]
                except NavError:
                    continue
                if errors is not None and errors.shown:
                    found.append(errors.shown)
    off = np.log(found) - np.log(found).mean(axis=0)
    for name, column in zip(("35 dB-Hz", "45 dB-Hz"), off.T, strict=True):
        print(f"{len(off)} drives, {name}: {column.std(ddof=1):.1%}, {np.abs(column).max():.1%}")


def main() -> None:
    """Fit, apply, and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--duration", type=float, default=150.0)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--scatter", action="store_true")
    arguments = parser.parse_args()
    if arguments.scatter:
        scatter(arguments.duration)
        return
    fitted = {}
    for name in RECEIVERS:
        one = prepare(drive(name, 50, arguments.duration), Config(), OUTAGES, 25.0, 5.0)
        found = pooled([one], "mad")
        assert found is not None
        fitted[name] = found
        at = found.noise.sigma(MEASURED)
        print(f"{name}: {at[0]:.3f}, {at[1]:.3f} m/s at 35, 45 dB-Hz; shows {found.shown}")
    print("| applied to | weights of | way | as recorded | weak GNSS |\n|---|---|---|---:|---:|")
    for name in RECEIVERS:
        changes: dict[tuple[str, str], list[list[float]]] = {}
        for seed in range(60, 60 + arguments.seeds):
            sequence = drive(name, seed, arguments.duration)
            there = prepare(sequence, Config(), OUTAGES, 25.0, 5.0)
            before = try_out(sequence, there, (Config(),))
            for whose, weights in fitted.items():
                for way, config in ways(weights, there):
                    after = try_out(sequence, there, (config,))
                    row = [
                        0.5 * np.log(after.square[part].mean() / before.square[part].mean())
                        if part in after.square
                        else np.nan
                        for part in before.square
                    ]
                    changes.setdefault((whose, way), []).append(row)
        for (whose, way), rows in changes.items():
            cells = " | ".join(f"{value:+.1%}" for value in np.nanmean(rows, axis=0))
            print(f"| {name} | {whose} | {way} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
