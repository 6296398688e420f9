"""The IMU by itself: gravity at rest, values that stand still or hit a limit, noise, sampling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...datasets.imu_faults import SENSORS, UNITS, blind_stretches
from ...datasets.sequence import Sequence
from ...datasets.series import ImuData
from ...filters.earth import gravity_e
from ...filters.rotation import FloatArray
from ...filters.sensors import STANDARD_GRAVITY, ImuSpec
from ...velocity.tracks import Track
from ..notes import clock
from .findings import Finding

_WINDOW = 1.0
#: A window is at rest if GNSS says slower than this [m/s] …
_REST_SPEED = 0.3
#: … and the gyro turns less than this beyond the bias [rad/s].
_REST_RATE = 0.02
_MIN_REST = 5
#: Gravity further off than this is another unit, not a bias [m/s²].
_GRAVITY_FATAL = 0.6
#: Axes that freeze within this time are one fault [s].
_FROZEN = 0.5
_FROZEN_FATAL = 0.2  # share of the recording
#: Noise at rest so many times that of the preset is said, and doubted, up and down: what an idling
#: engine shakes is noise, too. While driving the road is in it, which says nothing of the sensor.
_NOISE_OFF, _NOISE_FACTOR = 2.0, 10.0
#: Scatter of the sample interval, relative to it, that only a logger's clock shows.
_JITTER = 0.2
#: No inertial sensor waits so long [s].
_TOO_LONG = 1.0
_DEG_PER_H = np.pi / 180.0 / 3600.0


def inertial_findings(sequence: Sequence, track: Track | None) -> list[Finding]:
    """Return everything the IMU says by itself; `track` only tells when the vehicle stood."""
    imu = sequence.inertial
    windows = _windows(imu)
    if not windows:
        found = f"{len(imu)} rows, {imu.time[-1] - imu.time[0]:.2f} s: too short to navigate"
        return [Finding("fatal", "IMU sampling", found, "give the whole recording")]
    rest = _at_rest(imu, windows, track)
    return [
        *sampling(imu),
        *gravity(imu, windows, rest, track, sequence.calibration.imu),
        *frozen(imu, track),
        *saturated(imu),
        *noise(imu, sequence.calibration.imu, windows, rest),
    ]


def _windows(imu: ImuData) -> list[slice]:
    size = max(2, round(_WINDOW / imu.interval))
    return [slice(k, k + size) for k in range(0, len(imu) - size + 1, size)]


def _in_windows(values: FloatArray, windows: list[slice]) -> FloatArray:
    """Return the values of each window along a second axis: they follow each other."""
    count, size = len(windows), windows[0].stop if windows else 0
    return values[: count * size].reshape(count, size, *values.shape[1:])


def _at_rest(imu: ImuData, windows: list[slice], track: Track | None) -> NDArray[np.bool_]:
    """Tell the windows at rest: slow by GNSS, and quiet."""
    if not windows:
        return np.zeros(0, dtype=bool)
    gyro = _in_windows(imu.gyro_b, windows)
    rate = np.abs(gyro - np.median(gyro, axis=1)[:, None]).max(axis=(1, 2))
    shake = _in_windows(np.linalg.norm(imu.accel_b, axis=1), windows).std(axis=1)
    quiet = (rate < max(_REST_RATE, 3.0 * np.percentile(rate, 5))) & (
        shake < max(0.1, 2.0 * np.percentile(shake, 5))
    )
    if track is None:
        return quiet
    known = np.isfinite(track.vel_n).all(1)
    if known.sum() < 3:
        return quiet
    middle = _in_windows(imu.time, windows).mean(axis=1)
    time, speed = track.time[known], track.speed[known]
    # the fastest of the neighbourhood, so that a window does not reach into the start
    around = np.max([np.interp(middle + d, time, speed) for d in (-1.0, 0.0, 1.0)], axis=0)
    near = np.abs(time[np.clip(np.searchsorted(time, middle), 0, time.size - 1)] - middle) < 3.0
    return quiet & near & (around < _REST_SPEED)


def gravity(
    imu: ImuData,
    windows: list[slice],
    rest: NDArray[np.bool_],
    track: Track | None,
    spec: ImuSpec,
) -> list[Finding]:
    """Test the accelerometer's unit and down axis against gravity, at rest if there is a rest."""
    means = _in_windows(imu.accel_b, windows).mean(axis=1)
    if rest.sum() >= _MIN_REST:
        mean, when = np.median(means[rest], axis=0), f"{rest.sum():.0f} s at rest"
    else:
        mean, when = imu.accel_b.mean(axis=0), "mean of the drive, no rest found"
    size = float(np.linalg.norm(mean))
    expected = STANDARD_GRAVITY
    if track is not None:
        expected = float(np.linalg.norm(gravity_e(track.pos_e[len(track) // 2])))
    numbers = {"specific_force_mps2": size, "expected_mps2": expected}
    subject = "gravity"
    if abs(size - expected) > _GRAVITY_FATAL:
        meaning, remedy = _gravity_unit(size, expected, imu.interval)
        found = f"specific force {size:.3g} m/s², expected {expected:.2f} ({when}): {meaning}"
        return [Finding("fatal", subject, found, remedy, numbers)]
    tilt = float(np.degrees(np.arccos(np.clip(-mean[2] / size, -1.0, 1.0))))
    numbers["tilt_deg"] = tilt
    if tilt > 30.0:
        axis = int(np.argmax(np.abs(mean)))
        sign = "+" if mean[axis] > 0 else "−"
        found = f"up is {sign}{'xyz'[axis]}, expected −z ({mean.round(2)} m/s², {when})"
        remedy = "declare the axes the file really holds"
        return [Finding("fatal", subject, found, remedy, numbers)]
    severity, remedy = "note", ""
    found = f"{size:.3f} m/s², {tilt:.1f}° from the down axis, expected {expected:.3f} ({when})"
    allowed = min(max(0.2, 4.0 * spec.accel_bias_initial_sigma), 0.9 * _GRAVITY_FATAL)
    if rest.sum() >= _MIN_REST and abs(size - expected) > allowed:
        severity = "doubtful"
        found += f": {1e3 * (size - expected) / STANDARD_GRAVITY:+.0f} mg of bias or scale"
        remedy = "declare an IMU preset whose turn-on bias covers it, or calibrate"
    elif tilt > 10.0:
        severity = "doubtful"
        remedy = "declare the mounting of the IMU in the vehicle; a run measures it if it is not"
        found += ": the IMU is mounted tilted"
    return [Finding(severity, subject, found, remedy, numbers)]


def _gravity_unit(size: float, expected: float, interval: float) -> tuple[str, str]:
    """Return what a wrong size of gravity means, and what to declare."""
    known = (
        (1.0 / STANDARD_GRAVITY, "the numbers are in g", "declare the accelerometer's unit: g"),
        (STANDARD_GRAVITY, "m/s² multiplied by g", "declare the accelerometer's unit: m/s²"),
        (1e3 / STANDARD_GRAVITY, "the numbers are in mg", "declare the accelerometer's unit: mg"),
        (interval, "these are velocity increments", "declare increments instead of rates"),
        (100.0, "the numbers are in cm/s²", "declare the accelerometer's unit"),
    )
    # the nearest: mg and cm/s² differ by 2 %
    factor, meaning, remedy = min(known, key=lambda k: abs(size / (expected * k[0]) - 1.0))
    if abs(size / (expected * factor) - 1.0) < 0.06:
        return meaning, remedy
    if size < 1.0:
        return (
            "gravity has been taken out",
            "use the raw accelerometer, not 'linear acceleration'",
        )
    return "no known unit", "check unit, and whether the file holds increments instead of rates"


def sampling(imu: ImuData) -> list[Finding]:
    """Report rate, jitter and gaps."""
    step = np.diff(imu.time)
    usual = imu.interval
    gaps = step > 1.5 * usual
    regular = step[~gaps]
    jitter = float(np.std(regular) / usual)
    longest = float(step.max())
    numbers = {
        "rate_hz": 1.0 / usual, "jitter_percent": 100.0 * jitter,
        "gaps": float(gaps.sum()), "longest_gap_s": longest if gaps.any() else 0.0,
    }  # fmt: skip
    found = f"{1.0 / usual:.1f} Hz, jitter {100 * jitter:.1f} % of the interval"
    if gaps.any():
        found += (
            f", {gaps.sum()} gaps, the longest {longest:.2f} s from "
            f"{clock(imu.time[np.argmax(step)])}"
        )
    else:
        found += ", no gaps"
    severity, remedy = "note", ""
    if longest > max(1.0, 10.0 * usual):
        severity, remedy = "doubtful", "attitude is lost in such a gap: start after it, or cut it"
    elif jitter > _JITTER:
        severity = "doubtful"
        remedy = "the stamps are those of the logger, not of the sensor: rebuild them from a count"
    elif usual > 0.05:
        severity, remedy = "doubtful", "a car needs 50 Hz or more"
    if usual > _TOO_LONG:
        severity = "fatal"
        found = f"a sample every {usual:.4g} s: stamps in another unit than declared?"
        remedy = 'declare the unit of its time (time_unit = "ms", "us" or "ns")'
    return [Finding(severity, "IMU sampling", found, remedy, numbers)]


def frozen(imu: ImuData, track: Track | None) -> list[Finding]:
    """Find stretches in which a sensor, or one of its axes, repeats itself though moving."""
    blind = blind_stretches(imu, _moving(imu, track))
    out = []
    for sensor, values in enumerate((imu.gyro_b, imu.accel_b)):
        name = SENSORS[sensor]
        spread = np.ptp(values, axis=0)
        dead = [k for k in range(3) if spread[k] == 0.0]
        if dead:
            axes = ", ".join("xyz"[k] for k in dead)
            found = f"axis {axes} never changes ({values[0, dead[0]]:.4g})"
            out.append(Finding("fatal", name, found, "the column is empty or the sensor is off"))
            continue
        stretches = [s for s in blind if s.sensor == sensor and s.why == "frozen"]
        if not stretches:
            continue
        longest = max(stretches, key=lambda s: s.last - s.first)
        length = longest.last - longest.first + 1
        seconds = length * imu.interval
        axes = ", ".join(
            sorted({"xyz"[s.axis] for s in stretches if abs(s.begin - longest.begin) < _FROZEN})
        )
        found = f"frozen for {seconds:.1f} s from {clock(longest.begin)}: {length} equal rows"
        found = found if axes == "x, y, z" else f"axis {axes} {found}"
        severity = "fatal" if length > _FROZEN_FATAL * len(imu) else "doubtful"
        remedy = "leave the stretch out; the sensor or its log had stopped"
        out.append(Finding(severity, name, found, remedy, {"frozen_s": seconds}))
    same = (np.diff(imu.gyro_b, axis=0) == 0).all(1) & (np.diff(imu.accel_b, axis=0) == 0).all(1)
    share = float(same.mean())
    if share > 0.2 and not out:
        found = f"{100 * share:.0f} % of the rows repeat the one before: the sensor is slower"
        remedy = "remove the repeated rows"
        out.append(Finding("doubtful", "IMU rows", found, remedy, {"repeated_share": share}))
    elif share > 1e-3 and not out:
        found = f"{same.sum()} rows ({100 * share:.1f} %) repeat the one before"
        out.append(Finding("note", "IMU rows", found, numbers={"repeated_share": share}))
    return out


def _moving(imu: ImuData, track: Track | None) -> NDArray[np.bool_]:
    """Tell the samples at which GNSS does not say the vehicle stands: noise-free data may repeat.

    Where GNSS says nothing, it may move.
    """
    if track is None:
        return np.ones(len(imu), dtype=bool)
    known = np.isfinite(track.vel_n).all(1)
    if known.sum() < 3:
        return np.ones(len(imu), dtype=bool)
    return np.asarray(np.interp(imu.time, track.time[known], track.speed[known]) > _REST_SPEED)


def saturated(imu: ImuData) -> list[Finding]:
    """Find axes that hit a limit: an extreme value at which they pile up."""
    out = []
    blind = [s for s in blind_stretches(imu, np.zeros(len(imu), dtype=bool)) if s.why == "clipped"]
    for key in sorted({(s.sensor, s.axis, s.value) for s in blind}):
        sensor, axis, limit = key
        some = [s for s in blind if (s.sensor, s.axis, s.value) == key]
        column = (imu.gyro_b, imu.accel_b)[sensor][:, axis]
        hits = int((column == limit).sum())
        longest = max(some, key=lambda s: s.end - s.begin)
        found = (
            f"axis {'xyz'[axis]} hits {limit:+.3g} {UNITS[sensor]} {hits} times: saturated, in "
            f"{len(some)} stretches, the longest {longest.end - longest.begin:.2f} s from "
            f"{clock(longest.begin)}"
        )
        remedy = "use a wider range, or leave these stretches out"
        numbers = {"limit": limit, "hits": float(hits), "share": hits / len(imu)}
        out.append(Finding("doubtful", SENSORS[sensor], found, remedy, numbers))
    return out


def noise(
    imu: ImuData, spec: ImuSpec, windows: list[slice], rest: NDArray[np.bool_]
) -> list[Finding]:
    """Compare noise and gyro bias at rest with the declared IMU."""
    if rest.sum() < _MIN_REST:
        return [Finding("note", "IMU noise", f"no rest to compare with preset '{spec.name}'")]
    out = []
    chosen = [w for w, still in zip(windows, rest, strict=True) if still]
    for name, values, density, unit, scale in (
        (SENSORS[0], imu.gyro_b, spec.gyro_noise_density, "deg/√h", 60.0 * 180.0 / np.pi),
        (SENSORS[1], imu.accel_b, spec.accel_noise_density, "m/s/√h", 60.0),
    ):
        # differences of neighbours: white noise without bias and slow motion
        rms = np.array([np.sqrt((np.diff(values[w], axis=0) ** 2).mean() / 2.0) for w in chosen])
        measured = float(np.median(rms) * np.sqrt(imu.interval))
        ratio = measured / density if density > 0.0 else np.inf
        found = (
            f"{measured * scale:.3g} {unit} at rest, preset '{spec.name}' says "
            f"{density * scale:.3g}"
        )
        severity, remedy = "note", ""
        if not 1.0 / _NOISE_OFF <= ratio <= _NOISE_OFF:
            found += f": off by a factor {max(ratio, 1.0 / ratio if ratio else np.inf):.1f}"
            remedy = "declare another IMU preset: certnav allan makes one from a log at rest"
        if ratio > _NOISE_FACTOR:
            severity, remedy = "doubtful", remedy + "; or the engine shakes it"
        elif ratio < 1.0 / _NOISE_FACTOR:
            found += " (filtered in the sensor, or a better IMU than declared)"
        numbers = {"ratio": ratio}
        out.append(Finding(severity, f"{name} noise", found, remedy, numbers))
    bias = np.median([imu.gyro_b[w].mean(axis=0) for w in chosen], axis=0)
    largest = float(np.abs(bias).max())
    if largest > 4.0 * spec.gyro_bias_initial_sigma + 5e-4:
        found = (
            f"{largest / _DEG_PER_H:.0f} deg/h at rest, preset '{spec.name}' expects "
            f"{spec.gyro_bias_turn_on_degph:g} (1σ)"
        )
        remedy = "declare an IMU preset with a larger turn-on bias"
        out.append(
            Finding("doubtful", "gyro bias", found, remedy, {"bias_degph": largest / _DEG_PER_H})
        )
    return out
