"""The reference against GNSS: time, place, lever arm, attitude.

A difference that turns with the vehicle is a lever arm; one that keeps its direction on the map
is another datum or a shifted reference; one along the velocity and proportional to it is time.
All three are fitted together, so that none is taken for another; a drive that does not turn
cannot tell them apart, and its uncertainties say so.
"""

from __future__ import annotations

import numpy as np

from ...datasets.sequence import Sequence
from ...datasets.series import Reference
from ...filters.earth import C_en_of
from ...filters.rotation import FloatArray, matrix_from_rpy
from ...velocity.tracks import Track, Tracks
from .findings import Finding
from .lag import Lag, find_lag
from .motion import COURSE_SPEED, increments
from .timing import LAG_TOLERANCE, expected_lags, leap_remedy, leap_second_words

_BLOCKS = 8
#: Slower epochs take no part in the fit [m/s].
_MOVING = 1.0
#: Positions that scatter more, or leave more, say nothing about arms and shifts of metres [m].
_MAX_SCATTER, _MAX_SIGMA = 3.0, 2.0
#: Where a reference is this far from the GNSS, it is of another place or another drive [m].
_ELSEWHERE = 300.0
#: Differences that matter beyond 4σ [m].
_LEVER_TOLERANCE = 0.3
_SHIFT_TOLERANCE = 1.0


def reference_findings(
    sequence: Sequence, tracks: Tracks, positions: tuple[FloatArray, FloatArray] | None
) -> list[Finding]:
    """Return what the reference says against GNSS.

    Parameters
    ----------
    sequence : Sequence
    tracks : Tracks
    positions : tuple of ndarray, optional
        Times [s] and ECEF positions [m] of the antenna, metre-level or better.
    """
    reference = sequence.reference
    if reference is None or tracks.reference is None:
        return [Finding("note", "reference", "none: a result cannot be judged")]
    out = [*velocity(reference), *heading(reference)]
    apart = sequence.calibration.lever_antenna_b - reference.lever_b
    distance = float(np.linalg.norm(apart)) + sequence.calibration.lever_antenna_sigma + 0.1
    lag, more = time_offset(tracks.reference, tracks.gnss, distance, expected_lags(sequence))
    out += more
    if tracks.coarse is not None or positions is not None:
        out += place(sequence, tracks, positions, lag)
    return out


def velocity(reference: Reference) -> list[Finding]:
    """Test the reference's velocity against its own displacements."""
    step = np.diff(reference.time)
    moved = np.diff(reference.pos_e, axis=0) / step[:, None]
    mean = 0.5 * (reference.vel_e[1:] + reference.vel_e[:-1])
    good = np.isfinite(mean).all(1) & (step < 1.5 * np.median(step))
    if good.sum() < 20:
        return []
    error = float(np.median(np.linalg.norm((moved - mean)[good], axis=1)))
    speed = float(np.median(np.linalg.norm(mean[good], axis=1)))
    if error < 0.2 * speed + 0.5:
        return []
    found = f"velocity contradicts its change of position by {error:.1f} m/s (median)"
    remedy = "check the velocity's columns, and latitude and longitude"
    return [Finding("doubtful", "reference", found, remedy, {"error_mps": error})]


def heading(reference: Reference) -> list[Finding]:
    """Test the reference's heading against its course."""
    vel_n = np.einsum("nji,nj->ni", C_en_of(reference.pos_e), reference.vel_e)
    fast = np.hypot(vel_n[:, 0], vel_n[:, 1]) > COURSE_SPEED
    fast &= np.isfinite(reference.rpy[:, 2])
    if fast.sum() < 20:
        return []
    course = np.arctan2(vel_n[fast, 1], vel_n[fast, 0])
    psi = reference.rpy[fast, 2]

    def apart(angle: FloatArray) -> float:
        return float(np.degrees(np.median(np.abs(np.angle(np.exp(1j * (angle - course)))))))

    found = apart(psi)
    numbers = {"heading_minus_course_deg": found}
    if found < 15.0:
        text = f"heading equals the course within {found:.1f}° (median)"
        return [Finding("note", "reference", text, "", numbers)]
    for guess, words in (
        (-psi, "counter-clockwise instead of clockwise"),
        (np.pi / 2 - psi, "counted from east, counter-clockwise (ENU yaw)"),
        (psi + np.pi, "opposite to the direction of travel"),
        (np.degrees(psi), "in radians, read as degrees"),
        (np.radians(psi), "in degrees, read as radians"),
    ):
        if apart(guess) < 10.0:
            text = f"heading is {words} ({found:.0f}° from the course, median)"
            remedy = "declare the heading's convention: clockwise from north, degrees"
            return [Finding("doubtful", "reference", text, remedy, numbers)]
    text = f"heading is {found:.0f}° from the course (median)"
    remedy = "check the heading's column and unit; a result's heading cannot be judged by it"
    return [Finding("doubtful", "reference", text, remedy, numbers)]


def time_offset(
    reference: Track, gnss: Track | None, distance: float, expected: tuple[float, ...] = ()
) -> tuple[float, list[Finding]]:
    """Return the reference's time offset against GNSS [s] (0 when in order), and what it means.

    Positive: the reference's stamps are late. `distance` is how far its point may be from the
    antenna [m], `expected` as of `expected_lags`.
    """
    subject = "time, reference and GNSS"
    moves = None if gnss is None else increments(gnss)
    known = np.isfinite(reference.vel_n).all(1)
    lags: list[tuple[Lag | None, float]] = []
    if moves is not None and known.sum() > 20:
        # A speed is the integral of an acceleration, a course that of a turn rate; the course of
        # another point of the vehicle leads or lags by their distance over the speed.
        speed = reference.speed[known][:, None]
        course = np.unwrap(np.arctan2(reference.vel_n[known, 1], reference.vel_n[known, 0]))
        for integral, y, systematic in (
            (speed, moves.along, 0.005),
            (course[:, None], moves.turn, distance / moves.turning_speed),
        ):
            lag = find_lag(
                reference.time[known], integral, moves.start, moves.end, y[:, None],
                expected=expected,
            )  # fmt: skip
            lags.append((lag, systematic))
    good = [(lag, float(np.hypot(lag.sigma, s))) for lag, s in lags if lag and lag.conclusive]
    if not good:
        return 0.0, [Finding("note", subject, "an offset cannot be told: too little motion")]
    best, sigma = min(good, key=lambda f: f[1])
    numbers = {"offset_s": best.lag, "offset_sigma_s": sigma}
    size, late = abs(best.lag), "late" if best.lag > 0 else "early"
    if size < LAG_TOLERANCE + 3.0 * sigma:
        return 0.0, [
            Finding("note", subject, f"agree to {best.lag:+.3f} ± {sigma:.3f} s", "", numbers)
        ]
    found = f"the reference's stamps are {size:.2f} ± {sigma:.2f} s {late}"
    found += leap_second_words(best.lag, expected)
    remedy = "correct the reference's time, or errors along the road will be its"
    remedy = leap_remedy(best.lag, expected, remedy, "the reference")
    # Not fatal: a run does not need the reference, but its errors would be wrong.
    return best.lag, [Finding("doubtful", subject, found, remedy, numbers)]


def place(
    sequence: Sequence,
    tracks: Tracks,
    positions: tuple[FloatArray, FloatArray] | None,
    lag: float,
) -> list[Finding]:
    """Fit lever arm, shift and time to GNSS − reference."""
    reference = sequence.reference
    assert reference is not None
    coarse = positions is None
    if positions is None:
        assert tracks.coarse is not None
        positions = tracks.coarse.time, tracks.coarse.pos_e
    time, pos_e = positions
    inside = (time + lag > reference.time[0]) & (time + lag < reference.time[-1])
    if inside.sum() < 8:
        return [Finding("note", "reference position", "too few common epochs to compare")]
    time, pos_e = time[inside], pos_e[inside]
    at = time + lag
    ref = np.column_stack([np.interp(at, reference.time, p) for p in reference.pos_e.T])
    apart_n = np.einsum("nji,nj->ni", C_en_of(ref), pos_e - ref)
    apart = float(np.median(np.linalg.norm(apart_n, axis=1)))
    if apart > _ELSEWHERE:
        found = f"{apart / 1e3:.1f} km from the GNSS positions (median)"
        remedy = "another drive, or latitude, longitude or their unit are wrong"
        return [Finding("doubtful", "reference position", found, remedy, {"apart_m": apart})]
    if coarse:
        found = f"within {apart:.0f} m of uncorrected pseudorange positions"
        return [Finding("note", "reference position", found, "", {"apart_m": apart})]
    return _fitted(sequence, at, apart_n, apart)


def _fitted(sequence: Sequence, at: FloatArray, apart_n: FloatArray, apart: float) -> list[Finding]:
    reference = sequence.reference
    assert reference is not None
    C_nb, known = _attitude(sequence, at)
    vel_e = np.column_stack([np.interp(at, reference.time, v) for v in _velocities(reference).T])
    # Standing tells nothing of a lever arm, and reflections do not change.
    known &= np.linalg.norm(vel_e, axis=1) > _MOVING
    subject = "lever arm"
    if known.sum() < 40:
        found = f"reference {apart:.1f} m from the GNSS (median); too little motion to tell why"
        return [Finding("note", subject, found, "", {"apart_m": apart})]
    vel_n = np.einsum("nji,nj->ni", C_en_of(_at(reference, at)), vel_e)
    level = C_nb.copy()  # only the heading: what rolls with the car is below what can be seen
    n = at.size
    A = np.zeros((n, 3, 6))
    A[:, :, 0:3] = level
    A[:, 0, 3] = A[:, 1, 4] = 1.0  # a vertical shift cannot be told from a vertical lever
    A[:, :, 5] = vel_n
    good = known & np.isfinite(A).all((1, 2)) & np.isfinite(apart_n).all(1)
    solution, sigma = _robust(A[good], apart_n[good])
    # A street reflects for minutes on end: what scatters widely may be off as a whole.
    scatter = np.median(np.abs(apart_n[good] - A[good] @ solution), axis=0)
    if scatter[:2].max() > _MAX_SCATTER or sigma[:5].max() > _MAX_SIGMA:
        found = (
            f"not verified: GNSS positions scatter by {scatter[:2].max():.1f} m (median), which "
            f"leaves ± {sigma[:2].max():.1f} m"
        )
        return [Finding("note", subject, found, "", {"scatter_m": float(scatter[:2].max())})]
    expected = sequence.calibration.lever_antenna_b - reference.lever_b
    lever, lever_sigma = solution[:3], sigma[:3]
    shift, shift_sigma = solution[3:5], sigma[3:5]
    numbers = {
        "lever_forward_m": lever[0], "lever_right_m": lever[1], "down_m": lever[2],
        "lever_sigma_m": float(lever_sigma[:2].max()),
        "shift_north_m": shift[0], "shift_east_m": shift[1],
        "shift_sigma_m": float(shift_sigma.max()),
        "offset_s": solution[5], "offset_sigma_s": sigma[5],
    }  # fmt: skip
    return [
        _lever_finding(sequence, lever, lever_sigma, expected, numbers),
        *_shift_findings(
            shift, shift_sigma, lever[2] - expected[2], lever_sigma[2], scatter, numbers
        ),
    ]


def _lever_finding(sequence, lever, sigma, expected, numbers) -> Finding:
    subject = "lever arm"
    allowed = _LEVER_TOLERANCE + 2.0 * sequence.calibration.lever_antenna_sigma

    def words(v: FloatArray) -> str:
        return f"{v[0]:+.2f} forward, {v[1]:+.2f} right"

    miss, limit = np.abs(lever - expected)[:2], allowed + 4.0 * sigma[:2]
    found = (
        f"antenna seen from the reference: {words(lever)} m (± {sigma[0]:.2f}, {sigma[1]:.2f}), "
        f"declared {words(expected)} m"
    )
    if not (miss > limit).any():
        severity = "note"
        unsure = "; too uncertain to verify it" if sigma[:2].max() > 0.5 else ""
        return Finding(severity, subject, found + unsure, "", numbers)
    remedy = "correct the declared lever arms, or the point the reference is of"
    opposite = np.abs(lever + expected)[:2]
    if np.linalg.norm(expected[:2]) > 0.2 and (opposite < limit).all():
        found += ": the opposite"
        remedy = "reverse the sign: it is the vector from the IMU to the antenna"
    return Finding("doubtful", subject, found, remedy, numbers)


def _shift_findings(shift, sigma, down, down_sigma, scatter, numbers) -> list[Finding]:
    out = []
    if (np.abs(shift) > _SHIFT_TOLERANCE + 4.0 * sigma + 0.3 * scatter[:2]).any():
        found = (
            f"shifted against the GNSS by {-shift[0]:+.1f} m north, {-shift[1]:+.1f} m east "
            f"(± {sigma.max():.1f}), the same wherever the vehicle points"
        )
        remedy = "another datum, base station or map grid: transform the reference"
        out.append(Finding("doubtful", "reference position", found, remedy, numbers))
    if abs(down) > 5.0 + 4.0 * down_sigma + 2.0 * scatter[2]:
        found = f"{down:+.1f} m higher than the GNSS"
        remedy = "height above the geoid instead of the ellipsoid? declare it"
        out.append(Finding("doubtful", "reference height", found, remedy, numbers))
    return out


def _velocities(reference: Reference) -> FloatArray:
    if np.isfinite(reference.vel_e).all():
        return reference.vel_e
    return np.gradient(reference.pos_e, reference.time, axis=0)


def _at(reference: Reference, at: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(at, reference.time, p) for p in reference.pos_e.T])


def _attitude(sequence: Sequence, at: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Return C_nb at the times, from the reference's heading or course, and where it is known.

    Levelled: only the heading is used.
    """
    reference = sequence.reference
    assert reference is not None
    vel_n = np.einsum("nji,nj->ni", C_en_of(reference.pos_e), _velocities(reference))
    speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
    course = np.arctan2(vel_n[:, 1], vel_n[:, 0])
    psi = reference.rpy[:, 2]
    use = np.where(np.isfinite(psi), psi, np.where(speed > COURSE_SPEED, course, np.nan))
    # Through sine and cosine, so that neighbours across ±180° interpolate.
    sine, cosine = (np.interp(at, reference.time, f(use)) for f in (np.sin, np.cos))
    heading = np.arctan2(sine, cosine)
    zero = np.zeros_like(heading)
    C_nv = matrix_from_rpy(np.column_stack([zero, zero, np.nan_to_num(heading)]))
    # From a course, or where the reference's attitude is the vehicle's, the mounting follows.
    vehicle = reference.attitude_frame == "v" or not np.isfinite(psi).any()
    C_nb = C_nv @ sequence.calibration.C_bv.T if vehicle else C_nv
    return C_nb, np.isfinite(heading)


def _robust(A: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the solution of A x = y with Cauchy weights, and its σ from blocks of the drive."""
    n = len(y)
    weight = np.ones(n)
    for _ in range(8):
        x = _weighted(A, y, weight)
        residual = np.linalg.norm(y - A @ x, axis=1)
        scale = 1.5 * float(np.median(residual)) + 1e-6
        weight = 1.0 / (1.0 + (residual / scale) ** 2)
    block = np.arange(n) * _BLOCKS // n
    parts = np.array(
        [_weighted(A[block != k], y[block != k], weight[block != k]) for k in range(8)]
    )
    spread = np.sqrt((_BLOCKS - 1) / _BLOCKS * ((parts - parts.mean(axis=0)) ** 2).sum(axis=0))
    return x, np.maximum(spread, 1e-3)


def _weighted(A: FloatArray, y: FloatArray, weight: FloatArray) -> FloatArray:
    normal = np.einsum("n,nij,nik->jk", weight, A, A)
    right = np.einsum("n,nij,ni->j", weight, A, y)
    # A car that never turns or never changes speed leaves a direction open: hold it near zero.
    return np.linalg.solve(normal + 1e-6 * np.trace(normal) * np.eye(len(right)), right)
