"""What ``scripts/benchmark.py`` gives every contestant, and certnav's filter against its peers."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType

import numpy as np

from certnav.datasets.gpstime import from_week_sow, to_week_sow
from certnav.datasets.observations import GnssFixes
from certnav.datasets.series import ImuData, Reference
from certnav.datasets.simulation.sensors import fixes_from_truth, imu_measurements
from certnav.datasets.simulation.streets import RouteConfig, drive
from certnav.datasets.simulation.trajectory import Trajectory
from certnav.filters import measurements
from certnav.filters.earth import C_en_of, ecef_to_lla
from certnav.filters.ekf import ErrorStateFilter
from certnav.filters.error_model import ErrorModel
from certnav.filters.rotation import FloatArray, matrix_from_rpy
from certnav.filters.sensors import imu_preset
from certnav.filters.strapdown import InertialStream, NavState

RATE, WEEK, SOW = 200.0, 2284, 180000.0
LEVER = np.array([-0.65, -0.05, -0.15])
SPEC = imu_preset("adis16470")
SIGMA_POS, SIGMA_VEL = 0.5, 0.05
#: 1σ at the start: position [m], velocity [m/s], level and heading [rad].
START_SIGMA = (1.0, 0.1, 0.01, 0.03)


@dataclass(frozen=True)
class Drive:
    """What every contestant gets."""

    imu: ImuData
    fixes: GnssFixes
    truth: Reference

    def until(self, seconds: float) -> Drive:
        """The first seconds of it."""
        end = self.imu.time[0] + seconds + 1e-6
        f, n = self.fixes, int(np.sum(self.fixes.time <= end))
        k = int(np.sum(self.imu.time <= end))
        part = {name: getattr(f, name)[:n] for name in f.__dataclass_fields__}
        imu = ImuData(self.imu.time[:k], self.imu.gyro_b[:k], self.imu.accel_b[:k])
        return Drive(imu, GnssFixes(**part), self.truth)


def simulated(duration: float) -> Drive:
    """Simulate a drive of so many seconds."""
    rng = np.random.default_rng(1)
    motion = drive(RouteConfig(duration=duration + 2.0), rng)
    origin = (np.radians(30.53), np.radians(114.36), 30.0)
    start = float(from_week_sow(WEEK, np.array(SOW)))
    trajectory = Trajectory(start, motion.time, motion.pos_t, motion.rpy, origin, (0.5, 0.0, -1.4))
    sow = np.round(SOW + np.arange(1, round(duration * RATE) + 1) / RATE, 5)
    imu, _, _ = imu_measurements(trajectory, from_week_sow(WEEK, sow), SPEC, rng)
    at = from_week_sow(WEEK, SOW + np.arange(1.0, duration))
    fixes = fixes_from_truth(trajectory, at, LEVER, SIGMA_POS, SIGMA_VEL, rng)
    return Drive(imu, fixes, trajectory.reference(imu.time[:2]))


def best(function: Callable[[], object], repeat: int) -> float:
    """Return the smallest of `repeat` times [s]."""
    times = []
    for _ in range(repeat):
        began = time.process_time()
        function()
        times.append(time.process_time() - began)
    return min(times)


def new_filter(data: Drive, states: int = 15) -> ErrorStateFilter:
    """A filter at the first sample, with the true state and honest sigmas."""
    truth, model = data.truth, ErrorModel(SPEC, states)
    C_eb = C_en_of(truth.pos_e[0]) @ matrix_from_rpy(truth.rpy[0])
    state = NavState(truth.time[0], truth.pos_e[0], truth.vel_e[0], C_eb)
    pos, vel, level, heading = START_SIGMA
    P = model.initial_covariance(
        np.eye(3) * pos**2, np.eye(3) * vel**2, np.diag([level, level, heading]) ** 2
    )
    stream = InertialStream(data.imu.time, data.imu.gyro_b, data.imu.accel_b)
    kalman = ErrorStateFilter(model, stream, state, P)
    kalman._reserve(stream.end)  # memory for the rows is not what is measured
    return kalman


def filtered(data: Drive) -> ErrorStateFilter:
    """A whole filter run with a position and a velocity a second."""
    kalman, fixes = new_filter(data), data.fixes
    for k in range(fixes.time.size):
        kalman.propagate(fixes.time[k])
        n = kalman.model.size
        z = fixes.pos_e[k], fixes.pos_cov_e[k]
        kalman.update(measurements.position(kalman.state, n, *z, LEVER))
        z = fixes.vel_e[k], fixes.vel_cov_e[k]
        kalman.update(measurements.velocity(kalman.state, n, *z, LEVER, kalman.omega_b))
    kalman.propagate(kalman.stream.end)
    return kalman


def python_ins_us(data: Drive, time_step: float) -> float | None:
    """python-ins' feedback filter on the same data [µs per sample]; `time_step` of covariance."""
    pyins = _installed("pyins")
    if pyins is None:
        return None
    import pandas as pd
    from pyins import filters, inertial_sensor, strapdown
    from pyins import measurements as observed
    from pyins.util import ACCEL_COLS, GYRO_COLS, LLA_COLS, RPH_COLS, VEL_COLS

    sow = to_week_sow(data.imu.time)[1]
    columns = [*GYRO_COLS, *ACCEL_COLS]
    table = np.column_stack([data.imu.gyro_b, data.imu.accel_b]) / RATE
    imu = pd.DataFrame(table, index=sow, columns=columns)
    increments = strapdown.compute_increments_from_imu(imu, "increment")
    fixes, truth = data.fixes, data.truth
    at = to_week_sow(fixes.time)[1]
    lla = lla_deg(fixes.pos_e)
    vel_n = np.einsum("nji,nj->ni", C_en_of(fixes.pos_e), fixes.vel_e)
    offers = [
        observed.Position(pd.DataFrame(lla, index=at, columns=LLA_COLS), SIGMA_POS, LEVER),
        observed.NedVelocity(pd.DataFrame(vel_n, index=at, columns=VEL_COLS), SIGMA_VEL, LEVER),
    ]
    start_vel_n = C_en_of(truth.pos_e[0]).T @ truth.vel_e[0]
    values = [*lla_deg(truth.pos_e)[0], *start_vel_n, *np.degrees(truth.rpy[0])]
    pva = pd.Series(values, index=[*LLA_COLS, *VEL_COLS, *RPH_COLS], name=sow[0])
    pos, vel, level, heading = START_SIGMA

    def sensor(bias: float, density: float) -> object:
        return inertial_sensor.EstimationModel(bias_sd=bias, noise=density)

    gyro = sensor(SPEC.gyro_bias_initial_sigma, SPEC.gyro_noise_density)
    accel = sensor(SPEC.accel_bias_initial_sigma, SPEC.accel_noise_density)

    def run(part: object) -> object:
        return filters.run_feedback_filter(
            pva, pos, vel, np.degrees(level), np.degrees(heading), part, gyro, accel, offers,
            time_step=time_step,
        )  # fmt: skip

    run(increments.iloc[: min(250, len(increments) // 4)])  # its kernels compile
    began = time.process_time()
    result = run(increments)
    spent = time.process_time() - began
    error = np.radians(result.trajectory[LLA_COLS[:2]].iloc[-1].to_numpy() - lla[-1, :2])
    if not np.linalg.norm(error) * 6.4e6 < 30.0:
        raise SystemExit("benchmark: python-ins did not follow the drive")
    return 1e6 * spent / len(increments)


def sidereon_us(data: Drive) -> float | None:
    """sidereon's loosely coupled filter on the same data [µs per sample]."""
    ins = _installed("sidereon")
    if ins is None:
        return None
    fixes, truth = data.fixes, data.truth
    # It refuses stamps whose differences are rounded: seconds since the start, as rates.
    zero = data.imu.time[0]
    sow, at = np.round(data.imu.time - zero, 6), np.round(fixes.time - zero, 6)
    C_eb = C_en_of(truth.pos_e[0]) @ matrix_from_rpy(truth.rpy[0])
    nominal = ins.NavState(sow[0], truth.pos_e[0], truth.vel_e[0], C_eb)
    pos, vel, level, heading = START_SIGMA
    diagonal = [pos**2] * 3 + [vel**2] * 3 + [level**2] * 2 + [heading**2]
    diagonal += [SPEC.accel_bias_initial_sigma**2] * 3 + [SPEC.gyro_bias_initial_sigma**2] * 3
    state = ins.InsFilterState.from_diagonal(nominal, ins.ErrorStateLayout.FIFTEEN, diagonal)
    config = ins.InertialFilterConfig(
        ins.ImuSpec.mems(), loose=ins.LooseCouplingConfig(LEVER.tolist())
    )
    covariance = np.diag([SIGMA_POS**2] * 3 + [SIGMA_VEL**2] * 3)
    samples = [
        ins.ImuSample.rate(t, f, w)
        for t, f, w in zip(sow, data.imu.accel_b, data.imu.gyro_b, strict=True)
    ]
    due = dict(zip(np.searchsorted(sow, at - 1e-6).tolist(), range(at.size), strict=True))

    def run() -> object:
        kalman = ins.InertialFilter.with_config(state, config)
        for k, sample in enumerate(samples[1:], 1):
            kalman.propagate(sample)
            if k in due:
                j = due[k]
                kalman.update_loose(
                    ins.GnssFixMeasurement.position_velocity(
                        sow[k], fixes.pos_e[j], fixes.vel_e[j], covariance, 8
                    )
                )
        return kalman

    end = np.asarray(run().state.nominal.position_ecef_m)
    if not np.linalg.norm(end - fixes.pos_e[-1]) < 50.0:
        raise SystemExit("benchmark: sidereon did not follow the drive")
    return 1e6 * best(run, 2) / len(samples)


def _installed(name: str) -> ModuleType | None:
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def lla_deg(pos_e: FloatArray) -> FloatArray:
    lla = ecef_to_lla(pos_e)
    return np.column_stack([np.degrees(lla[:, :2]), lla[:, 2]])


def peers(data: Drive, quick: bool) -> dict:
    """Filter with a position and a velocity a second, same samples and fixes, ratios."""
    filtered(data.until(5.0))
    long, short = data.until(60.0), data.until(1.5 if quick else 3.0)
    ours = 1e6 * best(lambda: filtered(long), 3) / len(long.imu)
    ours_short = 1e6 * best(lambda: filtered(short), 5) / len(short.imu)
    return {
        "certnav_us": round(ours, 2),
        "python-ins": _against(python_ins_us(long, 0.5), ours),
        "python-ins, covariance at every sample": _against(
            python_ins_us(short, 1.0 / RATE), ours_short
        ),
        "sidereon": _against(sidereon_us(data.until(10.0 if quick else 60.0)), ours),
    }


def _against(theirs: float | None, ours: float) -> dict[str, float] | None:
    if theirs is None:
        return None
    return {"us": round(theirs, 1), "ratio": round(theirs / ours, 1)}
