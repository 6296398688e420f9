"""The filter loop: propagate exactly to each event, test its innovation, update, log.

One class for recorded and for live data: `nav.pipeline` feeds it a whole timeline,
`nav.navigator` one event at a time.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ...datasets.fix_faults import HELD
from ...datasets.sequence import Calibration
from ...filters.ekf import ErrorStateFilter
from ...filters.errors import DataError
from ...filters.measurement_update import Outcome
from ...filters.measurements import Measurement
from ..config import Config
from ..solution import UPDATE_KINDS, Update
from ..vehicles import VEHICLES
from . import blind
from .doppler_update import DopplerUpdates
from .events import GnssEvent
from .fix_update import ENLARGED, FixUpdates, logged
from .vehicle import VehicleConstraints
from .watch.heading import HeadingMonitor
from .watch.patience import Patience
from .watch.sanity import Limits, Lost, Sanity

#: Satellites from which on least squares checks itself well enough to be held against the filter.
_CHECKED = 6
#: How long such measurements have to contradict the filter before it is doubted, and before its
#: own speed is no proof of a standstill any more [s].
_EVIDENT = 2.0
#: What the refusal of two or three satellites counts for: with the usual patience of ten seconds a
#: filter is doubted for them after half a minute, by when a car has left a reflection behind.
_FEW = 1.0 / 3.0


_Of = TypeVar("_Of")
_Became = TypeVar("_Became")


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
        limit = config.filter.patience_s
        self._patience = {kind: Patience(limit) for kind in UPDATE_KINDS}
        self._constraints = 1
        self._agreed, self._aside_until = -np.inf, -np.inf
        mounted = bool(calibration.mounting_source)
        wanted = config.gnss.forward_motion
        # Where the vehicle's constraint is in force, it has said so already.
        forward = (wanted == "on" or (wanted == "auto" and mounted)) and not vehicle.nhc
        kind = VEHICLES[config.vehicle.kind]
        self._sanity = Sanity(Limits(kind.max_speed, kind.max_height_rate, kind.max_acceleration))
        self._heading = HeadingMonitor(kalman, calibration.lever_antenna_b)
        self._fixes = FixUpdates(kalman, calibration, config.filter)
        self._doppler = DopplerUpdates(kalman, calibration, config, forward, self.updates.append)

    def constrain(self, until: float) -> None:
        """Offer the vehicle's constraints that are due before `until` [s], each at its time."""
        interval = self.config.vehicle.interval_s
        # Due at the very time of an event: that goes first, whatever rounding says.
        while (due := self.begin + self._constraints * interval) < until - 1e-6:
            self._propagate(max(due, self.kalman.time))
            credible = self._patience["velocity"].lasted < _EVIDENT - 1e-3
            for kind, measurement in self.vehicle.offered(self.kalman, credible):
                if kind == "nhc" and due < self._aside_until:
                    reason = f"not believed for {self.config.filter.patience_s:g} s"
                    self.updates.append(Update(self.kalman.time, kind, reason=reason))
                    continue
                outcome, reason = self._constrained(kind, measurement)
                self.updates.append(logged(self.kalman.time, kind, (), outcome, reason))
            self._constraints += 1

    def _constrained(self, kind: str, measurement: Measurement) -> tuple[Outcome, str]:
        """Offer a constraint; one refused for long doubts the filter, or is doubted itself."""
        kalman, patience = self.kalman, self._patience[kind]
        gate = self.config.filter.gate_probability
        insist = patience.over(kalman.time)
        outcome = kalman.update(measurement, gate)
        if outcome.accepted:
            patience.accepted()
            return outcome, ""
        if not insist:
            patience.refused(kalman.time)
            return outcome, ""
        if kind == "nhc" and kalman.time - self._agreed < _EVIDENT:
            # What GNSS confirms is not to be doubted: the IMU has been turned, or the car slides.
            self._aside_until = kalman.time + self.config.filter.patience_s
            kalman.reconsider(*kalman.vehicle.forgotten(kalman.P))
            patience.accepted()
            return outcome, ""
        kalman.enlarge(measurement)
        if not kalman.update(measurement, gate).accepted:
            patience.failed(kalman.time)
            return outcome, ""
        patience.accepted()
        return dataclasses.replace(outcome, accepted=True), ENLARGED

    def forget(self, before: float) -> None:
        """Let go of samples, rows and log from before a time [s]; the last update stays."""
        self.kalman.forget(before)
        gone = sum(1 for update in self.updates[:-1] if update.time < before)
        del self.updates[:gone]

    @property
    def below_four(self) -> bool:
        """Whether what Doppler does below four satellites has mattered."""
        return self._doppler.below_four

    @property
    def reached(self) -> float:
        """How far the events went [s]."""
        return self.updates[-1].time if self.updates else self.begin

    def advance(self, until: float) -> None:
        """Propagate to `until` [s], with the constraints on the way."""
        self._watched(self._advance, until)

    def _advance(self, until: float) -> None:
        self.constrain(until)
        self._propagate(until)

    def _propagate(self, until: float) -> None:
        while self.spells and self.spells[0][1] <= self.kalman.time:
            self.spells.popleft()
        kalman, begin = self.kalman, self.kalman.time
        vel_e, C_eb = kalman.vel_e.copy(), kalman.C_eb.copy()
        blind.propagate(kalman, until, self.spells)
        if self.spells and self.spells[0].begin < until:
            self._heading.blind()
        elif kalman.time > begin:
            self._heading.propagated(vel_e, C_eb, kalman.time - begin, kalman)

    def _watched(self, does: Callable[[_Of], _Became], of: _Of) -> _Became:
        """Do it; raise `Diverged` if the solution does not survive that."""
        problem = f"the solution diverged after {self.kalman.time:.1f} s"
        remedy = "check units and axes of the IMU, and the IMU preset"
        try:
            became = does(of)
        except Lost:
            raise
        except (DataError, np.linalg.LinAlgError) as error:
            raise Diverged(problem, remedy=remedy) from error
        # What is not finite stays so in a sum.
        if not np.isfinite(self.kalman.pos_e.sum() + self.kalman.P.sum()):
            raise Diverged(problem, remedy=remedy)
        return became

    def offer(self, event: GnssEvent) -> Update:
        """Advance to an event and offer it; return what became of it, which is logged too.

        Raises
        ------
        Diverged
            If the solution is no longer finite.
        Lost
            If it is no longer one of a vehicle.
        """
        end = self.kalman.stream.end
        why = event.reason
        if event.time <= self.begin:
            if event.shared and not why:
                # The start's own position is the last of these.
                self._fixes.overlap(event.satellites)
            why = why or "before alignment"
        elif event.time > end:
            why = why or "after the IMU data"
        elif event.time < self.kalman.time - 1e-9:
            why = why or "late: the filter is past it"
        if why:
            update = Update(event.time, event.kind, event.satellites, reason=why)
        else:
            self.advance(event.time)
            update = self._watched(self._apply, event)
            self._sanity.look(self.kalman)
            if event.kind == "velocity":
                agreed = update.satellites if update.accepted else ()
                self._heading.take(event, self.kalman, agreed)
                refused = self._patience["velocity"].lasted >= _EVIDENT
                self._heading.look(self.kalman, refused)
        self.updates.append(update)
        return update

    def _apply(self, event: GnssEvent) -> Update:
        doppler = event.observations is not None
        checked = (doppler or event.shared) and len(event.satellites) >= _CHECKED
        if not doppler and self._fixes.repeated(event):
            return Update(event.time, event.kind, event.satellites, reason=HELD)
        family = "velocity" if doppler else event.kind
        patience = self._patience[family]
        # Refused while the other is taken, it is the odd one out; refused both, they say the same.
        other = self._patience["position" if family == "velocity" else "velocity"]
        evident = checked or other.over(event.time, _EVIDENT)
        insist = patience.over(event.time) or (evident and patience.over(event.time, _EVIDENT))
        if insist:
            self._sanity.doubted(event.time, "velocities" if doppler else f"{event.kind} fixes")
        if doppler:
            update = self._doppler.offer(event, insist, checked)
        else:
            update = self._fixes.offer(event, insist)
        if update.accepted:
            patience.accepted()
            self._agreed = event.time
        elif insist:
            patience.failed(event.time)
        elif not (doppler and self._doppler.agreed):
            few = doppler and len(event.satellites) < 4
            patience.refused(event.time, _FEW if few else 1.0)
        return update
