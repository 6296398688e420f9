"""A course whose velocities have the noise that fits them, and what a run says of it."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ....filters.rotation import FloatArray
from ....velocity.range_rate import DopplerNoise
from ...config import GnssConfig
from ...notes import Note, plain
from ..events import doppler_noise
from ..legs import Course, fitted_part, found_start
from ..start.state import Start
from .collected import collected
from .estimate import lasts, range_rate_noise, velocity_scale

#: Rows, or components of velocities, from which on a σ is known to 1/√(2 n) = 9 %.
_FEWEST = 60
#: A scale beyond this is no noise: wrong units, time stamps, a lever arm.
_LARGEST = 5.0
#: A walk so many times the declared, which stands for any quartz, is of something else: what that
#: is enters velocities too, lasts, and no white noise stands for it.
_NO_CLOCK = 3.0
#: Fewer than this count as one by chance.
_LASTING = 1.5
#: Recordings show the same noise of a receiver whose σ differ by less. The fits to 23 simulated
#: drives of one receiver, in the open and between houses, scatter by 4 %, two of them by 6 %
#: (`scripts/known_weights.py --scatter`): what differs by more than 2.5 times that is another.
_SAME = np.log(1.15)
#: What the filter's own share was made with has been found by then to a tenth, or it is repeated.
_ROUNDS, _NEAR = 2, np.log(1.1)
#: C/N0 at which noise is held against noise [dB-Hz].
MEASURED = (35.0, 45.0)


@dataclass(frozen=True)
class VelocityErrors:
    """What fits the velocities of a recording.

    Parameters
    ----------
    doppler : (float, float, float), optional
        Range-rate noise at 45 dB-Hz and its floor [m/s], and the walk of the receiver's clock
        [m/s/√s].
    factor : float
        On the declared σ of velocities that a set carries.
    """

    doppler: tuple[float, float, float] | None = None
    factor: float = 1.0

    @property
    def shown(self) -> tuple[float, ...]:
        """σ of range rates at `MEASURED` [m/s]; empty where none were fitted."""
        if self.doppler is None:
            return ()
        return tuple(DopplerNoise(*self.doppler[:2]).sigma(MEASURED).tolist())


def with_fitted_velocities(
    course: Course, report: Callable[[float, str], None]
) -> tuple[Course, VelocityErrors | None, tuple[Note, ...]]:
    """Return a course whose velocities have the noise that fits them, and what was found.

    Parameters
    ----------
    course : Course
    report : callable
        Told what is being done.
    """
    if course.config.gnss.velocity_noise == "declared":
        return course, None, ()
    offered = [e for e in course.events if e.kind != "position" and not e.reason]
    raw = any(e.observations is not None for e in offered)
    known = course.config.gnss.doppler_known_mps if raw else ()
    why = ""
    if 3 * len(offered) < _FEWEST:
        why = f"{len(offered)} epochs are too few to fit it to"
    elif raw and course.model.clock is None:
        why = "the receiver's clock is no state"
    if why:
        return course, None, (*_declared(why), *([_known(None, known)[1]] if known else ()))
    if course.start is None:
        report(0.0, "alignment")
        began = time.perf_counter()
        start = found_start(course, course.events)
        course = dataclasses.replace(course, start=(start, time.perf_counter() - began))
    else:
        start = course.start[0]
    report(0.0, "noise of velocities")
    if raw:
        errors, notes, below = _raw(course, start)
        course = dataclasses.replace(course, below_four=below)
    else:
        errors, notes = _carried(course, start)
    if known:
        errors, said = _known(errors, known)
        notes = (*notes, said)
    return (course if errors is None else with_velocities(course, errors)), errors, notes


def with_velocities(course: Course, errors: VelocityErrors) -> Course:
    """Return the course with the errors of velocities that were found."""
    course = _scaled(course, errors.factor)
    if errors.doppler is None:
        return course
    sigma, floor, walk = errors.doppler
    gnss = dataclasses.replace(
        course.config.gnss, doppler_sigma_mps=sigma, doppler_floor_mps=floor, clock_walk_mps=walk
    )
    return _with(course, gnss)


def _raw(course: Course, start: Start) -> tuple[VelocityErrors | None, tuple[Note, ...], bool]:
    """Return what fits range rates, what to say, and whether below four satellites mattered."""
    declared, fitted, below = course.config.gnss, course, False
    for _ in range(_ROUNDS):
        epochs, mattered = collected(fitted, start)
        below |= mattered
        if sum(e.z.size for e in epochs) < _FEWEST:
            return None, _declared("too few range rates after the start to fit it to"), below
        before = fitted.config.gnss
        # The prior's middle is what is declared, whatever the pass was made with.
        noise, walk = range_rate_noise(
            epochs, doppler_noise(declared), declared.clock_walk_mps, before.clock_walk_mps
        )
        if walk > _NO_CLOCK * declared.clock_walk_mps:
            why = (
                f"satellites share what wanders by {walk:.2g} m/s/√s, which is no clock of "
                f"{declared.clock_walk_mps:g}; gnss.clock_walk_mps, if it is one"
            )
            return None, _declared(why), below
        # Up to there it is the velocity that jerks: the clock is believed as far as declared.
        after = dataclasses.replace(
            declared, doppler_sigma_mps=noise.sigma_45, doppler_floor_mps=noise.floor,
            clock_walk_mps=min(walk, declared.clock_walk_mps),
        )  # fmt: skip
        fitted = _with(course, after)
        if np.abs(_logs(after) - _logs(before)).max() < _NEAR:
            break
    ratio = _at_45(after) / _at_45(declared)
    if ratio > _LARGEST:
        return None, (_doubtful(ratio),), below
    found = (after.doppler_sigma_mps, after.doppler_floor_mps, after.clock_walk_mps)
    count = f"{sum(e.z.size for e in epochs)} range rates{fitted_part(course, start)}"
    said = plain([_said(after, ratio, count)])
    return VelocityErrors(doppler=found), said, below


def _known(
    own: VelocityErrors | None, known: tuple[float, ...]
) -> tuple[VelocityErrors | None, Note]:
    """Return the noise that is known of a receiver where this recording shows what its own did.

    What is fitted to range rates is what they differ by from a filter that goes by them; a
    reference may have shown that they are worse than that. It holds for the receiver, the rate and
    the surroundings that look the same.
    """
    sigma, floor, *measured = known
    where = "gnss.doppler_known_mps"
    if own is None or own.doppler is None:
        return own, Note(
            "note", f"{where} is not used: nothing of this recording to hold it against"
        )
    here = own.shown
    if np.abs(np.log(np.divide(here, measured))).max() > _SAME:
        text = (
            f"{where} is not used: it was found where range rates show {measured[0]:.2g} m/s at "
            f"35 dB-Hz and {measured[1]:.2g} at 45; here it is {here[0]:.2g} and {here[1]:.2g}, "
            "and that is used. To insist: "
            f"gnss.velocity_noise = 'declared', gnss.doppler_sigma_mps = {sigma:.3g}, "
            f"gnss.doppler_floor_mps = {floor:.3g}"
        )
        return own, Note("unmet", text)
    at = DopplerNoise(sigma, floor).sigma(MEASURED)
    text = f"in force instead, as known ({where}): {at[0]:.2g} m/s at 35 dB-Hz, {at[1]:.2g} at 45"
    return VelocityErrors((sigma, floor, own.doppler[2])), Note("note", text)


def _with(course: Course, gnss: GnssConfig) -> Course:
    """Return the course with another noise of range rates and another walk of the clock."""
    return dataclasses.replace(
        course,
        config=dataclasses.replace(course.config, gnss=gnss),
        model=dataclasses.replace(course.model, clock_walk=gnss.clock_walk_mps),
    )


def _at_45(gnss: GnssConfig) -> float:
    return float(doppler_noise(gnss).sigma(45.0))


def _logs(gnss: GnssConfig) -> FloatArray:
    """Return ln of σ where signals are strong and where they are weak, and of the clock's walk."""
    return np.log([*doppler_noise(gnss).sigma([50.0, 38.0]), gnss.clock_walk_mps])


def _carried(course: Course, start: Start) -> tuple[VelocityErrors | None, tuple[Note, ...]]:
    scale, before, fitted = 1.0, 1.0, course
    for _ in range(_ROUNDS):
        epochs, _ = collected(fitted, start)
        if 3 * len(epochs) < _FEWEST:
            return None, _declared("too few after the start to fit it to")
        before, scale = scale, velocity_scale(epochs, scale)
        if scale > _LARGEST:
            return None, (_doubtful(scale),)
        fitted = _scaled(course, scale)
        if abs(np.log(scale / before)) < _NEAR:
            break
    successive = lasts(epochs, scale / before)
    # Time stamps and the IMU make innovations last as well: it may take back what the fit has taken
    # off the declared σ, but raises none.
    factor = float(np.clip(scale * np.sqrt(successive), scale, max(scale, 1.0)))
    text = f"noise of velocities: {scale:.2g} times the declared σ"
    if successive > _LASTING and factor > scale:
        text += f", {successive:.2g} successive ones count as one: {factor:.2g} times in the filter"
    text += f" (fitted to {len(epochs)} velocities{fitted_part(course, start)})"
    return VelocityErrors(factor=factor), plain([text])


def _scaled(course: Course, factor: float) -> Course:
    """Return the course with so many times the σ of its velocities."""
    events = tuple(
        dataclasses.replace(e, cov_e=factor**2 * e.cov_e)
        if e.kind == "velocity" and not e.reason
        else e
        for e in course.events
    )
    return dataclasses.replace(course, events=events)


def _declared(why: str) -> tuple[Note, ...]:
    return plain([f"noise of velocities: as declared ({why})"])


def _doubtful(ratio: float) -> Note:
    return Note(
        "doubtful",
        f"noise of velocities: {ratio:.0f} times what is declared would fit them, which is wrong "
        "units, time stamps or axes, not noise; as declared",
    )


def _said(gnss: GnssConfig, ratio: float, data: str) -> str:
    sigma = doppler_noise(gnss).sigma([35.0, 45.0])
    return (
        f"noise of Doppler: {sigma[0]:.2g} m/s at 35 dB-Hz, {sigma[1]:.2g} at 45, {ratio:.2g} "
        f"times the declared; the receiver's clock walks by {gnss.clock_walk_mps:.2g} m/s/√s "
        f"(fitted to {data})"
    )
