"""The filter loop: propagate exactly to each event, test its innovation, update, log.

One class for recorded and for live data: `nav.pipeline` feeds it a whole timeline,
`nav.navigator` one event at a time.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ...datasets.sequence import Calibration
from ...filters import measurements
from ...filters.ekf import ErrorStateFilter, Outcome
from ...filters.errors import DataError
from ...filters.measurements import Measurement
from ...velocity.range_rate import DopplerRows, doppler_rows
from ..config import Config
from ..solution import UPDATE_KINDS, Update
from . import blind
from .doppler_update import DopplerScreening, apply_ddia, rows_measurement, straight_ahead
from .events import GnssEvent, doppler_noise
from .vehicle import VehicleConstraints

#: Satellites from which on least squares checks itself well enough to be held against the filter.
_CHECKED = 6
#: Epochs of refused Doppler after which the filter's own speed is no proof of a standstill.
_CONTRADICTED = 3
#: How long such epochs have to contradict the filter before it is doubted [s].
_EVIDENT = 2.0
#: Doubted again within this time, the velocity is not all that is wrong [s].
_AGAIN = 60.0
_ENLARGED = "covariance enlarged after repeated refusal"


class Diverged(DataError):
    """The solution is no longer finite; what was recorded before is worth keeping."""


class FilterLoop:
    """Feeds events to a filter in time order, with the vehicle's constraints between them.

    Parameters
    ----------
    kalman : ErrorStateFilter
        Started.
    calibration : Calibration
    vehicle : VehicleConstraints
    config : Config
    spells : deque of (float, float)
        Begin and end of each spell without inertial data, in order (`nav.engine.blind`). Those that
        are over are taken out; new ones may be added.
    """

    def __init__(
        self,
        kalman: ErrorStateFilter,
        calibration: Calibration,
        vehicle: VehicleConstraints,
        config: Config,
        spells: deque[blind.Spell] | None = None,
    ) -> None:
        self.kalman, self.calibration = kalman, calibration
        self.spells = deque() if spells is None else spells
        self.vehicle, self.config = vehicle, config
        self.begin = kalman.time
        self.updates: list[Update] = []
        self._refused = dict.fromkeys(UPDATE_KINDS, 0)
        self._since = dict.fromkeys(UPDATE_KINDS, self.begin)  # … refused in a row, if at all
        self._constraints = 1
        self._agreed, self._four = False, False
        self._satellites: set[str] = set()
        self._doubted = -np.inf
        mounted = bool(calibration.mounting_source)
        wanted = config.gnss.forward_motion
        # Where the vehicle's constraint is in force, it has said so already.
        self._forward = (wanted == "on" or (wanted == "auto" and mounted)) and not vehicle.nhc
        self._screening = DopplerScreening(
            config.gnss.doppler_hold_off_s, config.filter.gate_probability
        )

    def constrain(self, until: float) -> None:
        """Offer the vehicle's constraints that are due before `until` [s], each at its time."""
        interval = self.config.vehicle.interval_s
        while (due := self.begin + self._constraints * interval) < until:
            self._propagate(due)
            contradicted = self._refused["velocity"] >= _CONTRADICTED
            for kind, measurement in self.vehicle.offered(self.kalman, not contradicted):
                outcome, reason = self._constrained(kind, measurement)
                self.updates.append(_logged(self.kalman.time, kind, (), outcome, reason))
            self._constraints += 1

    def _constrained(self, kind: str, measurement: Measurement) -> tuple[Outcome, str]:
        """Offer a constraint; one that is refused again and again doubts the filter."""
        gate, patience = self.config.filter.gate_probability, self.config.filter.gate_patience
        outcome = self.kalman.update(measurement, gate)
        if outcome.accepted:
            self._refused[kind] = 0
            return outcome, ""
        self._refused[kind] += 1
        if not 0 < patience < self._refused[kind]:
            return outcome, ""
        self._refused[kind] = 0
        self.kalman.enlarge(measurement)
        if not self.kalman.update(measurement, gate).accepted:
            return outcome, ""
        return dataclasses.replace(outcome, accepted=True), _ENLARGED

    def advance(self, until: float) -> None:
        """Propagate to `until` [s], with the constraints on the way."""
        with self._watched():
            self.constrain(until)
            self._propagate(until)

    def _propagate(self, until: float) -> None:
        while self.spells and self.spells[0][1] <= self.kalman.time:
            self.spells.popleft()
        blind.propagate(self.kalman, until, self.spells)

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Raise `Diverged` if the solution does not survive what is done in the context."""
        problem = f"the solution diverged after {self.kalman.time:.1f} s"
        remedy = "check units and axes of the IMU, and the IMU preset"
        try:
            yield
        except (DataError, np.linalg.LinAlgError) as error:
            raise Diverged(problem, remedy=remedy) from error
        if not (np.isfinite(self.kalman.pos_e).all() and np.isfinite(self.kalman.P).all()):
            raise Diverged(problem, remedy=remedy)

    def offer(self, event: GnssEvent) -> Update:
        """Advance to an event and offer it; return what became of it, which is logged too.

        Raises
        ------
        Diverged
            If the solution is no longer finite.
        """
        end = self.kalman.stream.end
        why = event.reason
        if event.time <= self.begin:
            if event.shared and not why:
                self._overlap(event.satellites)  # the start's own position is the last of these
            why = why or "before alignment"
        elif event.time > end:
            why = why or "after the IMU data"
        elif event.time < self.kalman.time - 1e-9:
            why = why or "late: the filter is past it"
        if why:
            update = Update(event.time, event.kind, event.satellites, reason=why)
        else:
            self.advance(event.time)
            with self._watched():
                update = self._apply(event)
        self.updates.append(update)
        return update

    def _apply(self, event: GnssEvent) -> Update:
        patience = self.config.filter.gate_patience
        checked = event.observations is not None or event.shared
        checked = checked and len(event.satellites) >= _CHECKED
        family = "velocity" if event.observations is not None else event.kind
        insist = 0 < patience <= self._refused[family]
        if checked and patience and self._refused[family]:
            insist |= event.time - self._since[family] >= _EVIDENT
        self._agreed = False
        if event.observations is not None:
            antenna_e = self.kalman.pos_e + self.kalman.C_eb @ self.calibration.lever_antenna_b
            noise = doppler_noise(self.config.gnss)
            update = self._doppler(
                event, doppler_rows(event.observations, antenna_e, noise), insist, checked
            )
        else:
            update = self._fix(event, insist)
        if update.accepted:
            self._refused[family] = 0
        elif insist:
            self._refused[family] = patience - 1  # once more, and soon
        elif not self._agreed:
            if self._refused[family] == 0:
                self._since[family] = event.time
            self._refused[family] += 1
        return update

    def _fix(self, event: GnssEvent, insist: bool) -> Update:
        """Offer a position or a velocity; with `insist`, enlarge the covariance until it fits."""
        kalman, calibration = self.kalman, self.calibration
        n, lever = kalman.model.size, calibration.lever_antenna_b
        gate = self.config.filter.gate_probability
        if event.kind == "position":
            cov = event.cov_e + np.eye(3) * calibration.lever_antenna_sigma**2
            m = measurements.position(kalman.state, n, event.value_e, cov, lever)
            if event.shared and kalman.model.fix_bias is not None:
                overlap = self._overlap(event.satellites)
                if overlap < 1.0:
                    kalman.reconsider(*kalman.gnss.other_satellites(kalman.P, overlap))
                m = measurements.with_shared_error(
                    m, event.cov_e, kalman.model.fix_bias, kalman.gnss.fix_bias
                )
        else:
            m = measurements.velocity(
                kalman.state, n, event.value_e, event.cov_e, lever, kalman.omega_b
            )
        outcome, reason = self._softly(m)
        if insist and not outcome.accepted:
            kalman.enlarge(m)
            if kalman.update(m, gate).accepted:
                outcome = dataclasses.replace(outcome, accepted=True)
                reason = _ENLARGED
        return _logged(event.time, event.kind, event.satellites, outcome, reason)

    def _softly(self, m: Measurement) -> tuple[Outcome, str]:
        """Offer a fix; one a little beyond the gate is weighted down to it, not refused."""
        gate, width = self.config.filter.gate_probability, self.config.filter.gate_width
        outcome = self.kalman.update(m, gate)
        if outcome.accepted or not outcome.nis <= width**2 * outcome.limit:
            return outcome, ""
        while not self.kalman.test(m, gate).accepted:
            m = Measurement(m.z, m.H, 1.2 * m.R)
        self.kalman.update(m)
        reason = f"weighted down to the gate (NIS > {outcome.limit:.1f})"
        return dataclasses.replace(outcome, accepted=True), reason

    def _doppler(self, event: GnssEvent, rows: DopplerRows, insist: bool, checked: bool) -> Update:
        """Offer the Doppler of an epoch: what agrees with the filter, as a velocity or as rows."""
        config, kalman, calibration = self.config, self.kalman, self.calibration
        gate = config.filter.gate_probability
        everyone = tuple(map(str, rows.sat))
        outcome: Outcome | None
        if insist:
            self._screening.forget()
            ok = np.isin(rows.sat, event.satellites)
            m = rows_measurement(kalman, calibration, rows.take(ok))
            again = event.time - self._doubted < _AGAIN
            if checked and not again:
                kalman.doubt(m)
            else:
                kalman.enlarge(m)
            self._doubted = event.time
        before = self._screening.held(rows, event.time)
        keep = self._screening.test(kalman, calibration, rows, event.time)
        self._log_exclusion(event, rows.take(~keep & ~before))
        # One satellite that agrees, clock and all, and the filter is not the one to doubt.
        self._agreed = bool(keep.any()) and not checked
        count = int(keep.sum())
        kind = "velocity" if self._enough(count) else "doppler"
        if count < 2 or (kind == "doppler" and config.gnss.below_four == "off"):
            few = "two" if count < 2 else "four"
            reason = f"fewer than {few} satellites agree with the filter"
            if count == 4:
                reason = "four satellites, fewer the epoch before"
            return Update(event.time, event.kind, everyone, reason=reason)
        rows = rows.take(keep)
        names = tuple(map(str, rows.sat))
        if kind == "velocity" or config.gnss.below_four == "rows":
            m = self._adapted(rows_measurement(kalman, calibration, rows))
            outcome, reason = kalman.update(m, gate), ""
            if kind == "doppler" and self._forward and outcome.accepted:
                forward = kalman.update(straight_ahead(kalman, calibration), gate)
                self.updates.append(_logged(event.time, "nhc", (), forward))
        else:
            outcome, names, reason = apply_ddia(
                kalman, calibration, rows, event.time, config.gnss, gate
            )
        if outcome is None:
            return Update(event.time, kind, names, reason=reason)
        return _logged(event.time, kind, names, outcome, reason)

    def _overlap(self, satellites: tuple[str, ...]) -> float:
        """Return the share of satellites that a position has in common with the last one."""
        before, now = self._satellites, set(satellites)
        self._satellites = now
        return len(before & now) / len(before | now) if before else 1.0

    def _adapted(self, m: Measurement) -> Measurement:
        """Return a measurement with R enlarged by what its NIS says R lacks."""
        nis = self.kalman.test(m, 0.0).nis
        return Measurement(m.z, m.H, m.R * max(1.0, nis / m.z.size))

    def _enough(self, satellites: int) -> bool:
        """Tell whether an epoch counts as four and more: four alone only the second time."""
        enough = satellites > 4 or (satellites == 4 and self._four)
        self._four = satellites >= 4
        return enough

    def _log_exclusion(self, event: GnssEvent, rows: DopplerRows) -> None:
        if len(rows):
            names = tuple(map(str, rows.sat))
            hold = self.config.gnss.doppler_hold_off_s
            reason = f"disagrees with the filter: not believed for {hold:g} s"
            self.updates.append(Update(event.time, "doppler", names, reason=reason))


def _logged(
    time: float, kind: str, satellites: tuple[str, ...], outcome: Outcome, reason: str = ""
) -> Update:
    if not outcome.accepted and not reason:
        reason = f"innovation test (NIS > {outcome.limit:.1f})"
    whitened = tuple(map(float, outcome.whitened))
    return Update(time, kind, satellites, whitened, outcome.nis, outcome.accepted, reason)
