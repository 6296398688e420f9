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

from datasets.sequence import Calibration
from filters import measurements
from filters.ekf import ErrorStateFilter, Outcome
from filters.errors import DataError
from nav import blind
from nav.config import Config
from nav.doppler_update import apply_ddia, apply_rows
from nav.gnss import GnssEvent, doppler_noise
from nav.solution import UPDATE_KINDS, Update
from nav.vehicle import VehicleConstraints
from velocity.range_rate import DopplerRows, doppler_rows


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
        Begin and end of each spell without inertial data, in order (`nav.blind`). Those that
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
        self._constraints = 1

    def constrain(self, until: float) -> None:
        """Offer the vehicle's constraints that are due before `until` [s], each at its time."""
        interval = self.config.vehicle.interval_s
        while (due := self.begin + self._constraints * interval) < until:
            self._propagate(due)
            for kind, measurement in self.vehicle.offered(self.kalman):
                outcome = self.kalman.update(measurement, self.config.filter.gate_probability)
                self.updates.append(_logged(self.kalman.time, kind, (), outcome))
            self._constraints += 1

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
        insist = 0 < patience <= self._refused[event.kind]
        if event.observations is not None:
            antenna_e = self.kalman.pos_e + self.kalman.C_eb @ self.calibration.lever_antenna_b
            noise = doppler_noise(self.config.gnss)
            update = self._doppler(event, doppler_rows(event.observations, antenna_e, noise))
        else:
            update = self._fix(event, insist)
        used = update.accepted or insist
        self._refused[event.kind] = 0 if used else self._refused[event.kind] + 1
        return update

    def _fix(self, event: GnssEvent, insist: bool) -> Update:
        """Offer a position or a velocity; with `insist`, enlarge the covariance until it fits."""
        kalman, calibration = self.kalman, self.calibration
        n, lever = kalman.model.size, calibration.lever_antenna_b
        gate = self.config.filter.gate_probability
        if event.kind == "position":
            cov = event.cov_e + np.eye(3) * calibration.lever_antenna_sigma**2
            m = measurements.position(kalman.state, n, event.value_e, cov, lever)
        else:
            m = measurements.velocity(
                kalman.state, n, event.value_e, event.cov_e, lever, kalman.omega_b
            )
        outcome, reason = kalman.update(m, gate), ""
        if insist and not outcome.accepted:
            kalman.enlarge(m)
            if kalman.update(m, gate).accepted:
                outcome = dataclasses.replace(outcome, accepted=True)
                reason = "covariance enlarged after repeated refusal"
        return _logged(event.time, event.kind, event.satellites, outcome, reason)

    def _doppler(self, event: GnssEvent, rows: DopplerRows) -> Update:
        """Offer Doppler of an epoch without a least-squares velocity."""
        config = self.config
        gate = config.filter.gate_probability
        outcome: Outcome | None
        if config.gnss.below_four == "rows":
            outcome, names, reason = apply_rows(self.kalman, self.calibration, rows, gate)
        else:
            outcome, names, reason = apply_ddia(
                self.kalman, self.calibration, rows, event.time, config.gnss, gate
            )
        if outcome is None:
            return Update(event.time, event.kind, names, reason=reason)
        return _logged(event.time, event.kind, names, outcome, reason)


def _logged(
    time: float, kind: str, satellites: tuple[str, ...], outcome: Outcome, reason: str = ""
) -> Update:
    if not outcome.accepted and not reason:
        reason = f"innovation test (NIS > {outcome.limit:.1f})"
    whitened = tuple(map(float, outcome.whitened))
    return Update(time, kind, satellites, whitened, outcome.nis, outcome.accepted, reason)
