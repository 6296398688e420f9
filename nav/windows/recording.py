"""Alignment over sliding windows of a recording, and its heading against the reference."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...alignment.in_motion.align import align_inertial
from ...alignment.in_motion.unknowns import InertialOptions
from ...alignment.result import AlignmentResult, Verdict
from ...datasets.observations import GnssObservations
from ...datasets.sequence import Sequence
from ...filters.earth import C_en_of
from ...filters.errors import AlignmentError, ConfigError
from ...filters.rotation import FloatArray, wrap_angle
from ...filters.strapdown import InertialStream
from .methods import Believed, clock_model, solve
from .noise import WindowNoise, fit_window_noise
from .options import WindowOptions
from .rows import (
    alignment_rows,
    left_out,
    local_track,
    position_sigma,
    prepared_observations,
    screened_observations,
)


@dataclass(frozen=True)
class WindowResult:
    """One window: the heading of the vehicle at its beginning, and what is known about it.

    Parameters
    ----------
    start : float
        GPS time [s].
    epochs, rows : int
    satellites : float
        Mean per epoch.
    status : str
        'PASSED' or the verdicts that did not pass; for the SDP the name of its status;
        'BASELINE' for methods that prove nothing; 'FAILED'.
    heading, sigma_heading : float
        [rad]; NaN where there is none.
    error : float
        Heading − reference [rad]; NaN without a reference.
    chi2_per_dof : float
    message : str
    bound : float
        Certified bound on the attitude [rad]; NaN where there is none.
    verdicts : tuple of Verdict
        All of them; none for methods that give none.
    result : AlignmentResult or None
        What they are about.
    believed : Believed or None
        And the rows it was made from.
    left_out : dict of str to int
        Rows of the window that were not offered to the method, by reason.
    """

    start: float
    epochs: int
    rows: int
    satellites: float
    status: str
    heading: float
    sigma_heading: float
    error: float
    chi2_per_dof: float
    message: str = ""
    bound: float = float("nan")
    verdicts: tuple[Verdict, ...] = ()
    result: AlignmentResult | None = None
    believed: Believed | None = None
    left_out: dict[str, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        heading, sigma = self.heading % math.tau, self.sigma_heading
        angles = (("heading", heading), ("1σ", sigma), ("error", self.error))
        known = [f"{name} {math.degrees(a):.4g}°" for name, a in angles if math.isfinite(a)]
        said = self.message or ", ".join(known)
        return f"<WindowResult at {self.start:.1f} s, {self.rows} rows, {self.status}: {said}>"

    @property
    def passed(self) -> bool:
        """Whether this attitude could start a filter."""
        return self.status in ("PASSED", "CERTIFIED")


def align_windows(sequence: Sequence, options: WindowOptions) -> list[WindowResult]:
    """Align every window of `sequence`; see `align_recording`."""
    return align_recording(sequence, options)[0]


def align_recording(
    sequence: Sequence, options: WindowOptions
) -> tuple[list[WindowResult], WindowNoise]:
    """Align every window of `sequence`, and say with what noise.

    Parameters
    ----------
    sequence : Sequence
    options : WindowOptions

    Raises
    ------
    AlignmentError
        If the recording has no raw Doppler, neither odometer nor IMU, or no window that they
        cover.
    ConfigError
        If the IMU is alone, and what is asked needs an odometer.

    Notes
    -----
    Without an odometer the windows are of Doppler and IMU, as a run aligns in motion
    (`alignment.in_motion`): the velocity at the beginning of each is one of its unknowns.
    """
    observations, pos_e = prepared_observations(sequence, options)
    if not len(observations):
        raise AlignmentError(f"{sequence.name}: no Doppler above mask and limits to align with")
    first, last = float(observations.time[0]), float(observations.time[-1])
    odometer = sequence.odometer
    alone = odometer is None
    if odometer is not None:
        first = max(first, float(odometer.time[0]))
        last = min(last, float(odometer.time[-1]))
    if alone and sequence.imu is None:
        raise AlignmentError(
            f"{sequence.name}: neither odometer nor IMU, so nothing tells how the vehicle moved"
        )
    if alone:
        _only_what_an_imu_can(options)
    if sequence.imu is not None and (odometer is None or odometer.yaw_rate is None):
        first = max(first, float(sequence.imu.time[0]))
        last = min(last, float(sequence.imu.time[-1]))
    count = int(np.floor((last - first - options.window) / options.step + 1e-9)) + 1
    if count < 1:
        raise AlignmentError(
            f"{sequence.name}: Doppler and {'IMU' if alone else 'odometer'} share "
            f"{max(last - first, 0.0):.1f} s, less than one window of {options.window:g} s"
        )
    starts = [first + k * options.step for k in range(count)]
    if alone:
        inertial = _Inertial(sequence, options)
        return [inertial.window(observations, pos_e, s) for s in starts], WindowNoise()
    noise = _noise(sequence, observations, pos_e, starts, options)
    screened, _ = screened_observations(sequence, options)
    results = [
        replace(
            align_window(sequence, observations, pos_e, s, options, noise),
            left_out=left_out(screened, s, s + options.window),
        )
        for s in starts
    ]
    return results, noise


def _only_what_an_imu_can(options: WindowOptions) -> None:
    """Refuse what needs an odometer."""
    asked = {
        f"--method {options.method}": options.method not in ("certified", "robust"),
        "--noise fitted": options.noise != "assumed",
        "--level": options.level_deg is not None,
        "a σ of the local velocity": options.sigma_local_mps != 0.0,
    }
    for what, there in asked.items():
        if there:
            raise ConfigError(f"{what}: needs an odometer, and the recording has none")


class _Inertial:
    """Windows of Doppler and IMU.

    Rows are rejected where `options.method` is 'robust', as in a run; 'certified' takes them all.
    """

    def __init__(self, sequence: Sequence, options: WindowOptions) -> None:
        imu, self.sequence, self.options = sequence.inertial, sequence, options
        self._stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
        self._how = InertialOptions(
            imu=sequence.calibration.imu, clock=clock_model(options, WindowNoise()),
            robust=options.method == "robust",
        )  # fmt: skip

    def window(
        self, observations: GnssObservations, pos_e: FloatArray, start: float
    ) -> WindowResult:
        """Align the window that begins at `start`; whatever goes wrong is in the result."""
        inside = _inside(observations, start, self.options)
        part, nan = observations.take(inside), float("nan")
        calibration, reference = self.sequence.calibration, self.sequence.reference
        try:
            found = align_inertial(
                self._stream, part, pos_e[inside], calibration.lever_antenna_b, self._how
            )
        except AlignmentError as error:
            return WindowResult(start, 0, len(part), nan, "FAILED", nan, nan, nan, nan, str(error))
        result = found.result
        C_nb = C_en_of(found.pos_e).T @ found.track.attitude(found.C_eb, 0)
        C_nv = C_nb @ calibration.C_bv
        heading = float(np.arctan2(C_nv[1, 0], C_nv[0, 0]))
        of_imu = reference is not None and reference.attitude_frame == "b"
        judged = float(np.arctan2(C_nb[1, 0], C_nb[0, 0])) if of_imu else heading
        error_rad = float(wrap_angle(judged - reference_heading(self.sequence, found.start)))
        failed = "not " + ", ".join(v.name for v in result.failed)
        return WindowResult(
            start, found.epochs, found.inliers.size, found.inliers.size / found.epochs,
            "PASSED" if result.passed else failed, heading, found.sigma_heading,
            error_rad, result.cost / result.dof if result.dof > 0 else nan, "", result.bound,
            result.verdicts, result,
        )  # fmt: skip


def _noise(
    sequence: Sequence, observations: GnssObservations, pos_e: FloatArray, starts: list[float],
    options: WindowOptions,
) -> WindowNoise:  # fmt: skip
    """Return the noise of the rows, fitted to all windows if so asked."""
    if options.noise == "assumed":
        return WindowNoise()
    # Whatever the speed's own errors are, scale or lag, they belong to what a row is off by: a
    # scale left free here would make rows look surer and less alike than they are.
    windows, exact = [], replace(options, sigma_local_mps=0.0, speed_scale_sigma=0.0)
    for start in starts:
        inside = _inside(observations, start, options)
        part = observations.take(inside)
        try:
            track = local_track(sequence, start, start + options.window)
            near = position_sigma(sequence, options, start, start + options.window)
            rows = alignment_rows(part, pos_e[inside], track, exact, WindowNoise(), near)
        except AlignmentError:
            continue
        windows.append((rows, part))
    return fit_window_noise(windows, clock_model(options, WindowNoise()))


def _inside(
    observations: GnssObservations, start: float, options: WindowOptions
) -> NDArray[np.bool_]:
    return (observations.time >= start) & (observations.time <= start + options.window)


def align_window(
    sequence: Sequence,
    observations: GnssObservations,
    pos_e: FloatArray,
    start: float,
    options: WindowOptions,
    noise: WindowNoise,
) -> WindowResult:
    """Align the window that begins at `start`; whatever goes wrong is in the result."""
    end = start + options.window
    inside = _inside(observations, start, options)
    part = observations.take(inside)
    nan = float("nan")
    try:
        if not inside.any():
            raise AlignmentError("no Doppler in this window")
        track = local_track(sequence, start, end)
        near = position_sigma(sequence, options, start, end)
        rows = alignment_rows(part, pos_e[inside], track, options, noise, near)
    except AlignmentError as error:
        return WindowResult(start, 0, len(part), nan, "FAILED", nan, nan, nan, nan, str(error))
    epochs = int(np.unique(rows.epoch).size)
    mean = len(rows) / epochs if epochs else nan
    try:
        solved = solve(rows, options, noise, C_en_of(pos_e[inside][0]))
    except AlignmentError as error:
        return WindowResult(
            start, epochs, len(rows), mean, "FAILED", nan, nan, nan, nan, str(error)
        )
    C_nw = C_en_of(pos_e[inside][0]).T @ solved.C_ew
    heading = float(np.arctan2(C_nw[1, 0], C_nw[0, 0]))
    error_rad = float(wrap_angle(heading - reference_heading(sequence, start)))
    return WindowResult(
        start, epochs, len(rows), mean, solved.status, heading, solved.sigma_heading, error_rad,
        solved.chi2_per_dof, "", solved.bound,
        () if solved.result is None else solved.result.verdicts, solved.result,
        solved.believed,
    )  # fmt: skip


def reference_heading(sequence: Sequence, time: float) -> float:
    """Return the vehicle's heading by the reference [rad], NaN where it has none."""
    reference = sequence.reference
    if reference is None or not reference.time[0] <= time <= reference.time[-1]:
        return float("nan")
    known = np.isfinite(reference.rpy[:, 2])
    if known.sum() < 2:
        return float("nan")
    unwrapped = np.unwrap(reference.rpy[known, 2])
    return float(np.interp(time, reference.time[known], unwrapped))


def summary(results: list[WindowResult]) -> dict[str, float | int]:
    """Return counts, and MAE, STD and MAX of the heading error [deg], passed windows apart."""
    error = np.degrees([r.error for r in results if np.isfinite(r.error)])
    solved = sum(np.isfinite(r.heading) for r in results)
    nothing = float("nan")
    passed = [abs(np.degrees(r.error)) for r in results if r.passed]
    return {
        "windows": len(results),
        "solved": int(solved),
        "passed": len(passed),
        "largest_passed_deg": float(np.max(passed)) if passed else nothing,
        "mae_passed_deg": float(np.mean(passed)) if passed else nothing,
        "mae_deg": float(np.mean(np.abs(error))) if error.size else nothing,
        "std_deg": float(np.std(error)) if error.size else nothing,
        "max_deg": float(np.max(np.abs(error))) if error.size else nothing,
    }
