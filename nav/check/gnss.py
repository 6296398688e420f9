"""GNSS by itself: raw observations against each other, carried positions against velocities."""

from __future__ import annotations

import numpy as np

from ...datasets.displacement import Agreement, agreement, horizontal_sigma
from ...datasets.observations import GnssFixes, GnssObservations
from ...datasets.sequence import Sequence
from ...filters.earth import C_en_of, ecef_to_lla, lla_to_ecef
from ...filters.rotation import FloatArray
from ...velocity.tracks import Track, Tracks
from ..rejections import rejections
from ..vehicles import VEHICLES, Vehicle
from .findings import Finding

#: Pseudoranges of GNSS satellites, receiver clock included [m]: 17 ms … 600 ms of light.
_RANGE = (1.5e7, 1.0e8)
_MIN_PAIRS = 20
#: Carried positions this far from the pseudoranges are another place [m].
_ELSEWHERE = 1000.0


def gnss_findings(
    sequence: Sequence, tracks: Tracks, min_cn0: float, vehicle: Vehicle = VEHICLES["car"]
) -> list[Finding]:
    """Return everything GNSS says by itself.

    Parameters
    ----------
    sequence : Sequence
    tracks : Tracks
    min_cn0 : float
        Signals weaker than this will not be used by a run [dB-Hz].
    vehicle : Vehicle
    """
    out: list[Finding] = []
    if sequence.observations is not None and len(sequence.observations):
        out += [
            *satellites(sequence.observations),
            *pseudoranges(sequence.observations),
            *doppler(sequence.observations, tracks),
            *signal_strength(sequence.observations, min_cn0),
        ]
    if sequence.fixes is not None:
        out += no_fixes(sequence.fixes)
        usable = sequence.fixes.take(sequence.fixes.usable)
        if len(usable) > 2:
            out += fixes(usable, tracks, vehicle)
    return out


def _epochs(observations: GnssObservations) -> np.ndarray:
    return np.cumsum(np.diff(observations.time, prepend=-np.inf) > 0) - 1


def satellites(observations: GnssObservations) -> list[Finding]:
    """Count satellites and those with an ephemeris."""
    epoch = _epochs(observations)
    states = np.asarray(np.isfinite(observations.sat_pos_e).all(1))
    identity = np.unique(np.column_stack([epoch.astype("U12"), observations.sat]), axis=0)
    tracked = np.unique(identity[:, 0], return_counts=True)[1]
    usable = np.bincount(epoch[states], minlength=epoch[-1] + 1)
    numbers = {
        "satellites_median": float(np.median(tracked)),
        "with_ephemeris_share": float(states.mean()),
        "epochs_below_4_share": float((usable < 4).mean()),
    }
    found = (
        f"median {np.median(tracked):.0f} tracked, {100 * states.mean():.0f} % of the rows with an "
        f"ephemeris, {100 * (usable < 4).mean():.0f} % of the epochs below 4"
    )
    if not states.any():
        remedy = "give the navigation file of that day"
        return [
            Finding(
                "fatal", "satellites", f"no ephemeris for any of the {states.size} rows", remedy,
                numbers,
            )
        ]  # fmt: skip
    if (usable >= 4).mean() < 0.2:
        remedy = "give navigation files for all constellations of that day"
        return [Finding("doubtful", "satellites", found, remedy, numbers)]
    return [Finding("note", "satellites", found, numbers=numbers)]


def pseudoranges(observations: GnssObservations) -> list[Finding]:
    """Test whether pseudoranges are ranges to satellites, in metres."""
    value = observations.pseudorange[np.isfinite(observations.pseudorange)]
    if not value.size:
        return [Finding("doubtful", "pseudorange", "none: no positions can be computed")]
    median = float(np.median(value))
    if _RANGE[0] < median < _RANGE[1]:
        return []
    found = f"median {median:.4g} m, expected 2e7…3e7"
    return [Finding("fatal", "pseudorange", found, "check the unit (metres)", {"median_m": median})]


def doppler(observations: GnssObservations, tracks: Tracks) -> list[Finding]:
    """Test Doppler against the change of the pseudoranges, and against itself."""
    rate = observations.range_rate
    present = np.isfinite(rate)
    share = float(present.mean())
    epoch = _epochs(observations)
    count = np.bincount(epoch[present], minlength=epoch[-1] + 1)
    numbers = {"present_share": share, "satellites_median": float(np.median(count))}
    if not present.any():
        remedy = "convert again with Doppler (RTKLIB convbin: -od), or use another receiver output"
        found = "no Doppler in the data: velocity only from differenced positions"
        return [Finding("doubtful", "Doppler", found, remedy, numbers)]
    slope, sigma, pairs = _range_rate_slope(observations)
    numbers |= {"rate_over_pseudorange_change": slope, "sigma": sigma}
    there = f"{100 * share:.0f} % of the rows, median {np.median(count):.0f} satellites"
    if pairs < _MIN_PAIRS:
        return [Finding("note", "Doppler", f"{there}; too few pairs to test its sign", "", numbers)]
    evidence = f"range rate / change of pseudorange = {slope:.3g} ± {sigma:.1g}"
    if abs(slope - 1.0) > max(0.1, 5.0 * sigma):
        return [_doppler_fault(slope, evidence, observations, numbers)]
    states = present & np.isfinite(observations.sat_vel_e).all(1)
    if not states.any():
        return [
            Finding("note", "Doppler", f"{there}; {evidence}; no ephemeris to use it", "", numbers)
        ]
    if tracks.doppler is None:
        found = f"{there}; {evidence}, but no epoch has six satellites that agree with each other"
        return [Finding("doubtful", "Doppler", found, "check the ephemerides", numbers)]
    numbers["consistent_epochs"] = float(len(tracks.doppler))
    found = (
        f"{there}; {evidence}; six or more agree with each other in {len(tracks.doppler)} epochs"
    )
    return [Finding("note", "Doppler", found, "", numbers)]


def _doppler_fault(
    slope: float, evidence: str, observations: GnssObservations, numbers: dict[str, float]
) -> Finding:
    wavelength = float(np.median(observations.wavelength))
    remedy = "check Doppler's unit and sign"
    meaning = "Doppler and pseudorange contradict each other"
    for factor, words in (
        (1.0, ""),
        (1.0 / wavelength, " and in Hz, not m/s"),
        (wavelength, " and multiplied by the wavelength once too often"),
    ):
        for sign in (1.0, -1.0):
            if abs(slope / (sign * factor) - 1.0) < 0.1:
                mirrored = "the sign is reversed" if sign < 0 else "the unit is wrong:"
                meaning = f"{mirrored}{words}".replace(": and", ":")
                remedy = "range rate is −λ·Doppler, positive when receding: " + (
                    "negate it" if sign < 0 and not words else "convert it"
                )
    return Finding("fatal", "Doppler", f"{meaning} ({evidence})", remedy, numbers)


def _range_rate_slope(observations: GnssObservations) -> tuple[float, float, int]:
    """Return the slope of range rates against pseudorange changes, its σ and the pairs used.

    Between neighbouring epochs of one signal, after the epoch's median (the receiver clock, and
    its millisecond jumps) is taken from both.
    """
    key = np.char.add(observations.sat, observations.signal)
    order = np.lexsort((observations.time, key))
    step = np.diff(observations.time[order])
    epoch = _epochs(observations)[order]
    usual = float(np.median(np.diff(np.unique(observations.time))))
    near = (key[order][1:] == key[order][:-1]) & (step < 1.5 * max(usual, 1e-3)) & (step > 0)
    change = np.diff(observations.pseudorange[order]) / np.where(step > 0, step, np.nan)
    rate = observations.range_rate[order]
    rate = 0.5 * (rate[1:] + rate[:-1])
    good = near & np.isfinite(change) & np.isfinite(rate)
    change, rate, epoch = change[good], rate[good], epoch[1:][good]
    if change.size < _MIN_PAIRS:
        return np.nan, np.nan, int(change.size)
    change, rate = _less_epoch_median(change, epoch), _less_epoch_median(rate, epoch)
    # Median of slopes, weighted: what a reflection or a cycle of the code does, counts once.
    far = np.abs(change) > 50.0
    if far.sum() < _MIN_PAIRS:
        return np.nan, np.nan, int(far.sum())
    slopes, weight = rate[far] / change[far], np.abs(change[far])
    order = np.argsort(slopes)
    half = np.cumsum(weight[order])
    slope = float(slopes[order][np.searchsorted(half, 0.5 * half[-1])])
    sigma = 1.4826 * float(np.median(np.abs(slopes - slope))) * 1.25 / np.sqrt(slopes.size)
    return slope, sigma, int(far.sum())


def _less_epoch_median(value: FloatArray, epoch: np.ndarray) -> FloatArray:
    order = np.lexsort((value, epoch))
    start = np.flatnonzero(np.diff(epoch[order], prepend=-1))
    count = np.diff(start, append=epoch.size)
    low = value[order][start + (count - 1) // 2]
    high = value[order][start + count // 2]
    median = np.empty(epoch.size)
    median[order] = np.repeat(0.5 * (low + high), count)
    return value - median


def signal_strength(observations: GnssObservations, min_cn0: float) -> list[Finding]:
    """Test whether C/N0 can be dB-Hz."""
    subject = "C/N0"
    cn0 = observations.cn0[np.isfinite(observations.cn0)]
    if not cn0.size:
        found = "none in the data: weak signals cannot be screened out"
        return [Finding("doubtful", subject, found, "convert again with signal strengths")]
    median, low, high = (float(v) for v in np.percentile(cn0, [50, 1, 99]))
    numbers = {"median_dbhz": median, "p1_dbhz": low, "p99_dbhz": high}
    spread = f"median {median:.1f}, 1…99 %: {low:.1f}…{high:.1f} dB-Hz"
    if high <= 9.5 and median >= 1.0:
        found = f"values {low:.0f}…{high:.0f} are RINEX signal-strength steps (1–9), not dB-Hz"
        remedy = f"convert again with S observables; gnss.min_cn0_dbhz = {min_cn0:g} rejects all"
        return [Finding("doubtful", subject, found, remedy, numbers)]
    if high > 70.0 or median < 15.0:
        found = f"{spread}: not dB-Hz (expected 20…60)"
        remedy = "check the unit; until then set gnss.min_cn0_dbhz = 0"
        return [Finding("doubtful", subject, found, remedy, numbers)]
    if cn0.size > 20 and np.ptp(cn0) == 0.0:
        found = f"always {median:g}: a constant, not a measurement"
        remedy = "convert again with S observables, or set gnss.min_cn0_dbhz = 0"
        return [Finding("doubtful", subject, found, remedy, numbers)]
    weak = float((cn0 < min_cn0).mean())
    if weak > 0.6:
        found = f"{spread}; {100 * weak:.0f} % are below gnss.min_cn0_dbhz = {min_cn0:g}"
        return [Finding("doubtful", subject, found, "set gnss.min_cn0_dbhz lower", numbers)]
    return [Finding("note", subject, spread, "", numbers)]


def no_fixes(found: GnssFixes) -> list[Finding]:
    """Name the rows that are no fixes, or repeat one while the vehicle moved: they are not used."""
    return [Finding("doubtful", "fixes", text) for text in rejections(found)]


def fixes(found: GnssFixes, tracks: Tracks, vehicle: Vehicle = VEHICLES["car"]) -> list[Finding]:
    """Test carried positions against the pseudoranges, against their velocities, and by height."""
    out = [*_height(found, vehicle), *_covariance(found)]
    if tracks.coarse is not None:
        out += _elsewhere(found, tracks.coarse)
    out += _velocity_axes(found, computable=tracks.doppler is not None)
    return out


def _height(found: GnssFixes, vehicle: Vehicle) -> list[Finding]:
    lla = ecef_to_lla(found.pos_e)
    height = lla[:, 2]
    travelled = float(np.linalg.norm(np.diff(found.pos_e, axis=0), axis=1).sum())
    subject = "GNSS height"
    if travelled > 100.0 and np.ptp(height) < 1e-3:
        text = f"always {height[0]:.1f} m over {travelled:.0f} m of way: it is missing"
        return [Finding("fatal", subject, text, "give the ellipsoidal height")]
    middle = float(np.median(height))
    if not -450.0 < middle < vehicle.max_height:
        text = f"{middle:.0f} m above the ellipsoid: no road is there, and {vehicle.words} neither"
        return [
            Finding(
                "fatal", subject, text, "check order, unit and sign of latitude, longitude, height",
                {"height_m": middle},
            )
        ]  # fmt: skip
    return []


def _covariance(found: GnssFixes) -> list[Finding]:
    sigma = np.sqrt(np.maximum(np.trace(found.pos_cov_e, axis1=1, axis2=2) / 3.0, 0.0))
    median = float(np.median(sigma))
    if 1e-3 < median < 100.0:
        return []
    text = f"median standard deviation {median:.3g} m per axis"
    remedy = "declare the positions' standard deviations"
    return [Finding("doubtful", "GNSS accuracy", text, remedy, {"sigma_m": median})]


def _elsewhere(found: GnssFixes, coarse: Track) -> list[Finding]:
    inside = (found.time >= coarse.time[0]) & (found.time <= coarse.time[-1])
    if not inside.any():
        return []
    where = np.column_stack([np.interp(found.time[inside], coarse.time, p) for p in coarse.pos_e.T])
    apart = float(np.median(np.linalg.norm(where - found.pos_e[inside], axis=1)))
    numbers = {"apart_m": apart}
    if apart > _ELSEWHERE:
        text = f"{apart / 1e3:.0f} km from where the pseudoranges are"
        remedy = "check order, unit (degrees or radians) and sign of latitude and longitude"
        return [Finding("fatal", "GNSS position", text, remedy, numbers)]
    text = f"agrees with uncorrected pseudoranges to {apart:.0f} m"
    return [Finding("note", "GNSS position", text, "", numbers)]


def _velocity_axes(found: GnssFixes, computable: bool) -> list[Finding]:
    """Compare displacements with velocities, and where they contradict, say how."""
    subject = "GNSS velocity"
    if not found.has_velocity.any() and not computable:
        remedy = (
            "declare the columns of the velocity; of speed and course make north and east "
            "(NMEA: velocity_sigma_mps)"
        )
        return [Finding("fatal", subject, "none: a run has nothing to start from", remedy)]
    if found.has_velocity.sum() < 20:
        what = "too few" if found.has_velocity.any() else "the positions carry no velocity"
        return [Finding("note", subject, what)]
    sigma = horizontal_sigma(found.pos_cov_e)
    moved = agreement(found.time, found.pos_e, found.vel_e, sigma)
    if moved is None:
        return [Finding("note", subject, "too little motion to compare it with the positions")]
    numbers = {
        "way_over_velocity": moved.factor, "misfit": moved.misfit(np.eye(2)),
        "misfit_sigma": moved.sigma, "scatter_m": moved.scatter,
    }  # fmt: skip
    lla = ecef_to_lla(found.pos_e)
    if not moved.contradicts:
        vel_n = np.einsum("nji,nj->ni", C_en_of(found.pos_e), found.vel_e)
        return [_vertical(lla, vel_n, found.time, moved, numbers)]
    guesses = []
    if (cause := moved.cause()) is not None:
        guesses.append((moved.misfit(cause.matrix), subject, cause.words))
    for values, words in (
        (lla[:, [1, 0, 2]], "latitude and longitude are swapped"),
        (np.degrees(lla) * [1, 1, np.pi / 180], "latitude and longitude are in radians"),
    ):
        if np.abs(values[:, 0]).max() < np.pi / 2:
            other = _elsewhere_moved(found, values, sigma)
            if other is not None and other.agrees:
                guesses.append((other.misfit(np.eye(2)), "GNSS position", words))
    if guesses:
        _, where, words = min(guesses)
        text = f"{words}: only then do positions move as the velocities say"
        return [Finding("fatal", where, text, "declare it as it is", numbers)]
    text = f"positions move {moved.factor:.3g} times as far as the velocities say, or elsewhere"
    remedy = "check unit, order and sign of latitude, longitude and velocity"
    return [Finding("fatal", subject, text, remedy, numbers)]


def _elsewhere_moved(found: GnssFixes, lla: FloatArray, sigma: FloatArray) -> Agreement | None:
    """Return how positions put elsewhere agree with the velocities north, east, down."""
    vel_n = np.einsum("nji,nj->ni", C_en_of(found.pos_e), found.vel_e)
    pos_e = lla_to_ecef(*lla.T)
    vel_e = np.einsum("nij,nj->ni", C_en_of(pos_e), vel_n)
    return agreement(found.time, pos_e, vel_e, sigma)


def _vertical(
    lla: FloatArray,
    vel_n: FloatArray,
    time: FloatArray,
    moved: Agreement,
    numbers: dict[str, float],
) -> Finding:
    """Test the sign of the down velocity by climbs over ten intervals."""
    text = (
        f"positions move {moved.factor:.2f} ± {moved.sigma:.2f} times as it says, and lie within "
        f"{moved.scatter:.2f} m of it"
    )
    fall = 0.5 * (vel_n[1:, 2] + vel_n[:-1, 2]) * np.diff(time)
    known = np.isfinite(fall)
    fallen, climbed = np.cumsum(fall[known]), np.cumsum(np.diff(lla[:, 2])[known])
    if fallen.size > 40:
        x, y = fallen[10:] - fallen[:-10], climbed[10:] - climbed[:-10]
        numbers["climb_correlation"] = correlation = float(np.corrcoef(x, y)[0, 1])
        if correlation > 0.7 and np.std(y) > 0.2:
            text = f"its down component has the wrong sign (climbs with {correlation:.2f})"
            remedy = "declare velocity up instead of down"
            return Finding("fatal", "GNSS velocity", text, remedy, numbers)
        if correlation < -0.7:
            text += ", also vertically"
    return Finding("note", "GNSS velocity", f"{text} (median, horizontal)", "", numbers)
