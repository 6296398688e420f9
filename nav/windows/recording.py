"""Alignment over sliding windows of a recording, and its heading against the reference."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...alignment.local_velocity import LocalTrack, inertial_track, planar_track
from ...alignment.priors import Prior, up_prior
from ...alignment.problem import AlignmentRows, ClockModel, build_problem
from ...alignment.reference.baselines import gauss_newton, voba
from ...alignment.reference.certifiable import align_sdp
from ...alignment.result import AlignmentResult, Verdict
from ...alignment.robust import align_robust
from ...alignment.verdict import align
from ...datasets.observations import GnssObservations
from ...datasets.sequence import Sequence
from ...filters.earth import C_en_of
from ...filters.errors import AlignmentError, ConfigError
from ...filters.rotation import FloatArray, wrap_angle
from ...filters.strapdown import InertialStream
from ...velocity.range_rate import doppler_rows, with_elevation
from .noise import WindowNoise, fit_window_noise

METHODS = ("certified", "robust", "sdp", "voba", "gauss-newton")


@dataclass(frozen=True)
class WindowOptions:
    """How a recording is cut into windows and what is kept of it.

    Parameters
    ----------
    window, step : float
        Length of a window and distance between their beginnings [s].
    method : {'certified', 'robust', 'sdp', 'voba', 'gauss-newton'}
        'certified': the SDP-free solver with all verdicts; 'robust': the same on the largest
        consensus of the rows; 'sdp': the paper's relaxation; 'gauss-newton' starts from the
        identity, as in Song et al.'s Table III.
    clock : {'constant', 'linear', 'per-epoch', 'random-walk'}
        Model of the receiver's clock drift within a window.
    clock_walk : float
        Of the random walk [m/s/√s]; a quartz oscillator's is about 0.1.
    sigma_local_mps : float
        1σ per axis of the local velocity, odometer and yaw rate together; added to that of
        every row.
    satellites : float, optional
        Keep this many satellites per epoch, drawn at random; a fraction is the average.
        Default: all.
    labels : {'all', 'los'}
        'los' drops rows labelled as not in line of sight, where the recording has labels.
    decimate : int
        Keep every so-manieth epoch.
    noise : {'assumed', 'fitted'}
        Of the Doppler: `velocity.range_rate.DopplerNoise` as it is, or fitted to the recording
        with its correlation (`nav.windows.noise`).
    min_cn0 : float
        Weaker signals are left out [dB-Hz]; mostly reflections in a city.
    level_deg : float, optional
        1σ per axis of the vehicle's tilt: the up prior of a car on a road (`certified` and
        `robust`). Default: none.
    elevation_mask_deg : float
    seed : int
        For drawing satellites.
    """

    window: float = 15.0
    step: float = 5.0
    method: str = "certified"
    clock: str = "random-walk"
    clock_walk: float = 0.1
    sigma_local_mps: float = 0.0
    satellites: float | None = None
    labels: str = "all"
    decimate: int = 1
    noise: str = "assumed"
    min_cn0: float = 0.0
    level_deg: float | None = None
    elevation_mask_deg: float = 10.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ConfigError.unknown_key(self.method, METHODS, where="--method")
        if self.labels not in ("all", "los"):
            raise ConfigError(f"--rows: expected 'all' or 'los', found '{self.labels}'")
        if self.noise not in ("assumed", "fitted"):
            raise ConfigError(f"--noise: expected 'assumed' or 'fitted', found '{self.noise}'")
        if self.level_deg is not None and not 0.0 < self.level_deg <= 45.0:
            raise ConfigError(f"--level: expected 0 < level ≤ 45°, found {self.level_deg:g}")
        if not (self.window > 0.0 and self.step > 0.0 and self.decimate >= 1):
            raise ConfigError("expected window > 0 s, step > 0 s and decimate ≥ 1")
        if self.satellites is not None and not self.satellites >= 1.0:
            raise ConfigError(f"--satellites: expected at least 1, found {self.satellites:g}")


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
        If the recording has no raw Doppler, no odometer, or no window that both cover.
    """
    observations, pos_e = prepared_observations(sequence, options)
    first, last = float(observations.time[0]), float(observations.time[-1])
    if sequence.odometer is None:
        raise AlignmentError(
            f"{sequence.name}: no odometer, so no local velocity — alignment from an IMU alone "
            "needs the unknown start velocity as a nuisance, which is not built yet"
        )
    first = max(first, float(sequence.odometer.time[0]))
    last = min(last, float(sequence.odometer.time[-1]))
    if sequence.imu is not None and sequence.odometer.yaw_rate is None:
        first = max(first, float(sequence.imu.time[0]))
        last = min(last, float(sequence.imu.time[-1]))
    count = int(np.floor((last - first - options.window) / options.step + 1e-9)) + 1
    if count < 1:
        raise AlignmentError(
            f"{sequence.name}: Doppler and odometer share {max(last - first, 0.0):.1f} s, less "
            f"than one window of {options.window:g} s"
        )
    starts = [first + k * options.step for k in range(count)]
    noise = _noise(sequence, observations, pos_e, starts, options)
    return [align_window(sequence, observations, pos_e, s, options, noise) for s in starts], noise


def _noise(
    sequence: Sequence, observations: GnssObservations, pos_e: FloatArray, starts: list[float],
    options: WindowOptions,
) -> WindowNoise:  # fmt: skip
    """Return the noise of the rows, fitted to all windows if so asked."""
    if options.noise == "assumed":
        return WindowNoise()
    windows = []
    for start in starts:
        inside = _inside(observations, start, options)
        part = observations.take(inside)
        try:
            track = local_track(sequence, start, start + options.window)
            rows = alignment_rows(part, pos_e[inside], track, 0.0, WindowNoise())
        except AlignmentError:
            continue
        windows.append((rows, part))
    return fit_window_noise(windows, _clock(options, WindowNoise()))


def _inside(
    observations: GnssObservations, start: float, options: WindowOptions
) -> NDArray[np.bool_]:
    return (observations.time >= start) & (observations.time <= start + options.window)


def _clock(options: WindowOptions, noise: WindowNoise) -> ClockModel:
    if options.clock != "random-walk":
        return ClockModel(options.clock)
    return ClockModel(
        options.clock, options.clock_walk if noise.clock_walk is None else noise.clock_walk
    )


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
        rows = alignment_rows(part, pos_e[inside], track, options.sigma_local_mps, noise)
    except AlignmentError as error:
        return WindowResult(start, 0, len(part), nan, "FAILED", nan, nan, nan, nan, str(error))
    epochs = int(np.unique(rows.epoch).size)
    mean = len(rows) / epochs if epochs else nan
    try:
        solved = _solve(rows, options, noise, C_en_of(pos_e[inside][0]))
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
    )  # fmt: skip


def local_track(sequence: Sequence, start: float, end: float) -> LocalTrack:
    """Return the local velocity of a window: gyros where there is no yaw rate."""
    odometer, calibration = sequence.odometer, sequence.calibration
    if odometer is None:
        raise AlignmentError(f"{sequence.name}: no odometer, so no local velocity")
    C_vb = calibration.C_bv.T
    lever_v = C_vb @ (calibration.lever_antenna_b - calibration.lever_vehicle_b)
    if odometer.yaw_rate is not None:
        return planar_track(odometer.time, odometer.speed, odometer.yaw_rate, start, end, lever_v)
    imu = sequence.inertial
    stream = InertialStream(imu.time, imu.gyro_b, imu.accel_b)
    return inertial_track(
        stream, odometer.time, odometer.speed, start, end, calibration.C_bv, lever_v=lever_v
    )


def alignment_rows(
    observations: GnssObservations,
    pos_e: FloatArray,
    track: LocalTrack,
    sigma_local: float,
    noise: WindowNoise,
) -> AlignmentRows:
    """Pair the Doppler of a window with the local velocity at the same instants."""
    doppler = doppler_rows(observations, pos_e, noise.doppler)
    time = observations.time[doppler.row]
    return AlignmentRows.paired(doppler, time, track.velocity_at(time), vel_sigma=sigma_local)


class _Solved(NamedTuple):
    """What one method says about one window."""

    status: str
    C_ew: FloatArray
    sigma_heading: float = float("nan")
    chi2_per_dof: float = float("nan")
    bound: float = float("nan")
    result: AlignmentResult | None = None


def _solve(
    rows: AlignmentRows, options: WindowOptions, noise: WindowNoise, C_en: FloatArray
) -> _Solved:
    """Align one window; an `AlignmentError` says why there is no rotation."""
    if options.method == "voba":
        return _Solved("BASELINE", voba(rows).C_ew)
    clock, correlated = _clock(options, noise), noise.correlated
    priors = _priors(options, C_en)
    if options.method == "robust":
        return _judged(align_robust(rows, clock, correlated=correlated, priors=priors).result)
    if options.method == "certified":
        return _judged(align(rows, clock, correlated=correlated, priors=priors))
    problem = build_problem(rows, clock, correlated=correlated)
    if options.method == "gauss-newton":
        found = gauss_newton(problem)
        chi2 = problem.cost(found.C_ew) / problem.dof if problem.dof > 0 else float("nan")
        status = "BASELINE" if found.converged else "NOT_CONVERGED"
        return _Solved(status, found.C_ew, chi2_per_dof=chi2)
    result = align_sdp(problem)
    chi2 = result.cost / result.dof if result.dof > 0 else float("nan")
    # θ is in w axes; its down component there is the heading's error on level ground.
    sigma = float(np.sqrt(result.cov_w[2, 2]))
    return _Solved(result.status.name, result.C_ew, sigma, chi2)


def _priors(options: WindowOptions, C_en: FloatArray) -> tuple[Prior, ...]:
    """Return the up prior of a vehicle on a road, if asked for."""
    if options.level_deg is None:
        return ()
    return (up_prior([0.0, 0.0, -1.0], C_en, np.radians(options.level_deg)),)


def _judged(result: AlignmentResult) -> _Solved:
    """Return the overall verdict, or the names of the verdicts that did not pass."""
    failed = "not " + ", ".join(v.name for v in result.failed)
    chi2 = result.cost / result.dof if result.dof > 0 else float("nan")
    sigma = float(np.sqrt(result.cov_w[2, 2]))
    status = "PASSED" if result.passed else failed
    return _Solved(status, result.C_ew, sigma, chi2, result.bound, result)


def prepared_observations(
    sequence: Sequence, options: WindowOptions
) -> tuple[GnssObservations, FloatArray]:
    """Return the screened and thinned observations with their approximate positions."""
    if sequence.observations is None or not sequence.observations.has_range_rate.any():
        raise AlignmentError(f"{sequence.name}: no raw Doppler with satellite states to align with")
    observations = sequence.observations
    pos_e = _whereabouts(sequence, observations.time)
    observations = with_elevation(observations, pos_e)
    low = observations.elevation < np.radians(options.elevation_mask_deg)
    observations = observations.mark(low, "below elevation mask")
    observations = observations.mark(observations.cn0 < options.min_cn0, "weak signal")
    if options.labels == "los":
        observations = observations.mark(observations.label == "nlos", "labelled as reflected")
    keep = observations.has_range_rate & _kept(observations, options)
    return observations.take(keep), pos_e[keep]


def _whereabouts(sequence: Sequence, time: FloatArray) -> FloatArray:
    """Return approximate antenna positions: the receiver's own, else the reference's."""
    source = sequence.fixes if sequence.fixes is not None else sequence.reference
    if source is None:
        raise AlignmentError(
            f"{sequence.name}: no position to compute lines of sight from — a kilometre would do"
        )
    return np.column_stack([np.interp(time, source.time, x) for x in source.pos_e.T])


def _kept(observations: GnssObservations, options: WindowOptions) -> NDArray[np.bool_]:
    """Return the rows left by decimation and by drawing satellites."""
    rng = np.random.default_rng(options.seed)
    keep = np.zeros(len(observations), dtype=bool)
    usable = observations.has_range_rate
    for number, (_, rows) in enumerate(observations.epochs()):
        here = np.flatnonzero(usable[rows]) + rows.start
        if number % options.decimate or not here.size:
            continue
        if options.satellites is not None:
            whole, fraction = divmod(options.satellites, 1.0)
            spread = rng.integers(-1, 2) if options.satellites == 2.0 else 0
            n = int(whole) + int(rng.random() < fraction) + int(spread)
            here = rng.permutation(here)[: max(n, 1)]
        keep[here] = True
    return keep


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
        "mae_deg": float(np.mean(np.abs(error))) if error.size else nothing,
        "std_deg": float(np.std(error)) if error.size else nothing,
        "max_deg": float(np.max(np.abs(error))) if error.size else nothing,
    }
