"""The error-state Kalman filter: compiled time update, a gate, the measurement update.

Closed loop: after every accepted update the estimated errors are fed into the state and the
error state is zero again. The update is `filters.measurement_update.compiled`, or filterpy's,
which it is tested against; filterpy has no innovation test, so that is made here, before it.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from .compiled import kernels
from .compiled import rows as layout
from .compiled.jit import COMPILED
from .earth import OMEGA_IE_E, gravity_e
from .error_model import ACCEL_BIAS, ATT, GYRO_BIAS, POS, VEL, ErrorModel
from .errors import DataError
from .gnss_states import GnssStates
from .levers import AntennaPoint, AntennaStates, VehicleStates, rate_over_earth
from .measurement_update import (
    Outcome,
    Update,
    compiled,
    gate_limit,
    innovation,
    turned,
    with_filterpy,
)
from .measurements import Measurement
from .rotation import FloatArray, crossed
from .smoother import Tape
from .strapdown import InertialStream, NavState


class Follower(Protocol):
    """What goes along with a filter, told of everything that multiplies its error state."""

    def predict(self, time: float, phi: FloatArray, P: FloatArray) -> None:
        """Error state multiplied by `phi`; P is the covariance at `time` [s] after it."""

    def correct(self, P: FloatArray, measurement: Measurement) -> None:
        """Measurement that was applied; P is the covariance before it."""


#: What moves the antenna so that GNSS shows its place and delay is a mean over so long [s].
_STEADY = 0.5
#: Samples that stay for measurements to look back to, twice a standstill's window [s].
_LOOK_BACK = 2.0
#: Position [m], velocity [m/s] and attitude [rad] errors beyond which enlarging P is pointless.
_LOST = np.repeat([1000.0, 30.0, 1.0], 3)


class ErrorStateFilter:
    """Error-state EKF over an inertial stream.

    Parameters
    ----------
    model : ErrorModel
    stream : InertialStream
    state : NavState
        Initial state; its time must lie inside the stream.
    P : array_like, shape (n, n)
        Initial error covariance, ordered as in `filters.error_model`.
    output_interval : float
        Spacing of recorded rows [s]; 0 records every IMU sample.
    gyro_bias : array_like, shape (3,)
        Initial estimate, body axes [rad/s].
    smoothing : bool
        Keep what `filters.smoother.smooth` needs, in `tape`.
    filterpy : bool
        Measurement updates by filterpy; default: only where nothing is compiled.
    accel_bias : array_like, shape (3,)
        Initial estimate, body axes [m/s²].

    Examples
    --------
    >>> import numpy as np
    >>> from certnav.filters import C_en_of, ErrorModel, ErrorStateFilter, InertialStream, NavState
    >>> from certnav.filters import gravity_e, imu_preset, lla_to_ecef
    >>> from certnav.filters.measurements import position
    >>> pos_e, still = lla_to_ecef(0.5, 2.0, 30.0), np.ones((1001, 1))
    >>> C_eb = C_en_of(pos_e)  # level, heading north, ten seconds at rest
    >>> gyro_b, accel_b = C_eb.T @ [0.0, 0.0, 7.292115e-5], -C_eb.T @ gravity_e(pos_e)
    >>> stream = InertialStream(0.01 * np.arange(1001), still * gyro_b, still * accel_b)
    >>> model = ErrorModel(imu_preset("adis16470"))
    >>> P = model.initial_covariance(25.0 * np.eye(3), 0.01 * np.eye(3), 1e-4 * np.eye(3))
    >>> start = NavState(0.0, pos_e + [3.0, 0.0, 0.0], np.zeros(3), C_eb)  # 3 m wrong
    >>> ekf = ErrorStateFilter(model, stream, start, P)
    >>> ekf.propagate(5.0)
    >>> ekf.update(position(ekf.state, model.size, pos_e, np.eye(3), np.zeros(3))).accepted
    True
    >>> print(f"{np.linalg.norm(ekf.pos_e - pos_e):.1f} m")
    0.1 m
    """

    def __init__(
        self,
        model: ErrorModel,
        stream: InertialStream,
        state: NavState,
        P: ArrayLike,
        output_interval: float = 0.0,
        gyro_bias: ArrayLike = (0.0, 0.0, 0.0),
        smoothing: bool = False,
        filterpy: bool = not COMPILED,
        accel_bias: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        n = model.size
        self.P = np.array(P, dtype=float)
        if self.P.shape != (n, n) or not np.isfinite(self.P).all():
            raise DataError(f"filter: expected a finite covariance of shape ({n}, {n})")
        if not stream.start <= state.time <= stream.end:
            raise DataError(
                f"filter: start {state.time:.3f} s is outside the IMU data "
                f"{stream.start:.3f}…{stream.end:.3f} s"
            )
        self.model, self.stream = model, stream
        self.time = state.time
        self.pos_e, self.vel_e, self.C_eb = (
            state.pos_e.copy(),
            state.vel_e.copy(),
            state.C_eb.copy(),
        )
        self.bias = np.zeros(12)
        self.bias[0:3], self.bias[3:6] = gyro_bias, accel_bias
        self.odometer_scale = 0.0
        self.gnss = GnssStates(model)
        self.vehicle = VehicleStates(model)
        self.antenna = AntennaStates(model)
        self.omega_b = np.zeros(3)
        #: Sample, and mean specific force and rate over `_STEADY` up to it.
        self._steady: tuple[int, FloatArray, FloatArray] | None = None
        self._noise = model.noise()
        self._still = np.eye(n)
        self._update: Update = with_filterpy if filterpy else compiled
        self._sample = stream.index(state.time)
        self._period = float(output_interval)
        # Room for the whole stream: untouched pages of zeros cost nothing, growing copies.
        samples = stream.gyro.shape[0] - self._sample
        spacing = max(self._period, (stream.end - state.time) / max(samples, 1), 1e-6)
        room = int((stream.end - state.time) / spacing) + 1024
        self._rows = np.zeros((room, layout.ROW_SIZE))
        self._rows[0, layout.ROW_TIME] = state.time
        self._cursor = np.array([1.0, state.time + self._period])
        self._record_now()
        self.tape = Tape() if smoothing else None
        self._follower: Follower | None = None
        self._phi = np.zeros((n, n) if smoothing else (0, 0))
        if self.tape is not None:
            self.tape.row(self._rows[0])

    @property
    def state(self) -> NavState:
        """The current estimate."""
        return NavState.known(self.time, self.pos_e, self.vel_e, self.C_eb)

    @property
    def gyro_bias(self) -> FloatArray:
        """Estimated gyro bias, body axes [rad/s], shape (3,)."""
        return self.bias[0:3]

    @property
    def accel_bias(self) -> FloatArray:
        """Estimated accelerometer bias, body axes [m/s²], shape (3,)."""
        return self.bias[3:6]

    def antenna_point(self, lever_b: ArrayLike) -> AntennaPoint:
        """Return the antenna as estimated, from its lever as declared [m]."""
        if self.model.antenna is None and self.model.delay is None:
            return self.antenna.point(lever_b)
        if self._steady is None or self._steady[0] != self._sample:
            first = max(self._sample - max(round(_STEADY / self.stream.interval), 1), 0)
            samples = slice(first, self._sample + 1)
            felt, turned = self.stream.accel[samples], self.stream.gyro[samples]
            self._steady = self._sample, felt.mean(axis=0), turned.mean(axis=0)
        force_b = self._steady[1] - self.accel_bias
        omega_b = self._steady[2] - self.gyro_bias
        coriolis = 2.0 * crossed(OMEGA_IE_E, self.vel_e)
        accel_e = self.C_eb @ force_b + gravity_e(self.pos_e) - coriolis
        return self.antenna.point(lever_b, accel_e, rate_over_earth(self.C_eb, omega_b))

    def follow(self, follower: Follower) -> None:
        """Tell `follower` of all that happens from now on."""
        self._follower = follower
        self._phi = np.zeros((self.model.size, self.model.size))

    @property
    def rows(self) -> FloatArray:
        """Recorded rows so far, shape (m, ROW_SIZE), see `filters.compiled.rows`."""
        return self._rows[: int(self._cursor[0])]

    def propagate(self, until: float) -> None:
        """Run mechanisation and covariance to `until` [s], splitting the IMU interval there."""
        if until < self.time - 1e-9:
            raise DataError(f"filter: cannot go back from {self.time:.6f} to {until:.6f} s")
        if self.tape is None:
            self._advance(until)
            return
        # Every output epoch is a node of the smoother, so the intervals end there too.
        edges = self.stream.edges
        last = edges[np.searchsorted(edges, until, side="right") - 1]
        while self._cursor[1] <= last + 1e-9:
            # Where every sample is recorded, that is the next one, whatever the cursor says.
            due = np.searchsorted(edges, self._cursor[1] - 1e-9)
            at = int(max(due, np.searchsorted(edges, self.time, side="right")))
            if at >= edges.size or edges[at] > until + 1e-9:
                break
            rows = int(self._cursor[0])
            self._advance(float(edges[at]))
            if int(self._cursor[0]) > rows:
                self.tape.row(self._rows[rows])
        self._advance(until)

    def ahead(self, until: float) -> tuple[NavState, FloatArray]:
        """Return state and covariance at `until` [s] as they will be if nothing is measured.

        The filter itself stays where it is; of the covariance, what the IMU's errors do to it.
        """
        pos_e, vel_e, C_eb, bias, P = (
            a.copy() for a in (self.pos_e, self.vel_e, self.C_eb, self.bias, self.P)
        )
        rows, cursor = np.zeros((1, layout.ROW_SIZE)), np.array([0.0, np.inf])
        kernels.advance(
            self.stream.edges, self.stream.gyro, self.stream.accel, self._sample, self.time, until,
            pos_e, vel_e, C_eb, bias, P, np.zeros((0, 0)), self._noise, rows, cursor, np.inf,
        )  # fmt: skip
        return NavState(min(until, self.stream.end), pos_e, vel_e, C_eb), P

    def _reserve(self, until: float) -> None:
        """Make room for a row per sample up to `until`."""
        if self._period > 0.0:
            due = int(self._cursor[0]) + int(max(until - self._cursor[1], 0.0) / self._period) + 2
            if due <= len(self._rows):
                return
        last = int(np.searchsorted(self.stream.edges, until + 1e-9, side="right"))
        samples = last - self._sample
        if self._period > 0.0:
            samples = min(samples, int(max(until - self._cursor[1], 0.0) / self._period) + 1)
        needed = int(self._cursor[0]) + samples + 1
        if needed > len(self._rows):
            more = max(needed, 2 * len(self._rows)) - len(self._rows)
            self._rows = np.vstack([self._rows, np.zeros((more, layout.ROW_SIZE))])

    def forget(self, before: float) -> None:
        """Let go of recorded rows, and of a live stream's samples, from before a time [s].

        Samples that measurements look back to stay. What `tape` has stays whole.
        """
        self._steady = None
        self._sample -= self.stream.forget(min(before, self.time - _LOOK_BACK))
        rows = self.rows
        gone = min(int(np.searchsorted(rows[:, layout.ROW_TIME], before)), len(rows) - 1)
        if 2 * gone < len(rows):
            return
        kept = np.zeros((max(2 * (len(rows) - gone), 1024), layout.ROW_SIZE))
        kept[: len(rows) - gone] = rows[gone:]
        self._rows = kept
        self._cursor[0] -= gone

    def _advance(self, until: float) -> None:
        self._reserve(until)
        before = self.P.copy()
        if self._phi.size:
            self._phi[:] = self._still
        self._sample, omega = kernels.advance(
            self.stream.edges, self.stream.gyro, self.stream.accel, self._sample, self.time, until,
            self.pos_e, self.vel_e, self.C_eb, self.bias, self.P, self._phi, self._noise,
            self._rows, self._cursor, self._period,
        )  # fmt: skip
        if until > self.time:
            phi = self.gnss.age(self.P, min(until, self.stream.end) - self.time)
            if phi is not None and self._phi.size:
                self._phi[:] = phi @ self._phi
            self.omega_b = omega
            if self.tape is not None:
                self.tape.predict(before, self._phi.copy(), self.P.copy())
            if self._follower is not None:
                self._follower.predict(min(until, self.stream.end), self._phi, self.P)
        self.time = min(until, self.stream.end)

    def reconsider(self, P: FloatArray, phi: FloatArray | None = None) -> None:
        """Put `P` in the covariance's place at this instant; the smoother learns of it.

        Parameters
        ----------
        P : ndarray, shape (n, n)
        phi : ndarray, shape (n, n), optional
            What the error state is multiplied by; default: nothing happens to it.
        """
        if self.tape is not None:
            still = self._still.copy() if phi is None else phi
            self.tape.predict(self.P.copy(), still, P.copy())
        if self._follower is not None and phi is not None:
            self._follower.predict(self.time, phi, P)
        self.P = P

    def test(self, measurement: Measurement, gate_probability: float) -> Outcome:
        """Return whitened innovation and NIS of a measurement, without applying it."""
        whitened, nis = innovation(self.P, measurement)
        limit = gate_limit(whitened.size, gate_probability)
        return Outcome(nis <= limit, whitened, nis, limit)

    def update(self, measurement: Measurement, gate_probability: float = 0.0) -> Outcome:
        """Test a measurement and, if it passes, apply it.

        Parameters
        ----------
        measurement : Measurement
        gate_probability : float
            Probability with which a correct measurement is refused; 0 switches the gate off.
        """
        outcome = self.test(measurement, gate_probability)
        if outcome.accepted:
            if self._follower is not None:
                self._follower.correct(self.P, measurement)
            x, self.P = self._update(self.P, measurement)
            self._feed_back(x)
            self._record_now()
        return outcome

    def enlarge(self, measurement: Measurement, limit: float = 10.0) -> float:
        """Multiply P by what brings the NIS of a measurement to its expectation, `limit` at most.

        For a filter that has refused measurements for too long: all correlations stay, all
        standard deviations grow alike. The limit keeps a run of bad measurements from throwing a
        good filter off; a filter that is really lost gets there in several rounds, and P never
        grows beyond a kilometre, 30 m/s and a radian.

        Returns
        -------
        float
            The factor; 1 where the NIS is low already.
        """
        S = measurement.H @ self.P @ measurement.H.T
        ceiling = float((_LOST**2 / np.diag(self.P)[: _LOST.size]).min())
        limit = max(1.0, min(limit, ceiling))
        factor = 1.0
        while factor < limit:
            z = measurement.z
            if z @ np.linalg.solve(factor * S + measurement.R, z) <= z.size:
                break
            factor = min(1.2 * factor, limit)
        self.reconsider(self.gnss.as_known(self.P, self.P * factor))
        return factor

    def doubt(self, measurement: Measurement, limit: float = 1e4) -> float:
        """Enlarge P where a measurement looks, until its NIS is what is expected of it.

        What H sees, H P Hᵀ, grows by a factor, what is correlated with it as the correlations
        say, and nothing else: P ← P + (f − 1) P Hᵀ (H P Hᵀ)⁻¹ H P.

        Parameters
        ----------
        measurement : Measurement
        limit : float
            Of the factor.

        Returns
        -------
        float
            The factor; 1 where the NIS is low already.
        """
        z, H, R = measurement.z, measurement.H, measurement.R
        PHt = self.P @ H.T
        seen = H @ PHt
        factor = 1.0
        while factor < limit and z @ np.linalg.solve(factor * seen + R, z) > z.size:
            factor = min(1.2 * factor, limit)
        if factor > 1.0:
            more = PHt @ np.linalg.pinv(seen, rcond=1e-10, hermitian=True) @ PHt.T
            more = self.P + (factor - 1.0) * 0.5 * (more + more.T)
            self.reconsider(self.gnss.as_known(self.P, more))
        return factor

    def _feed_back(self, x: FloatArray) -> None:
        self.pos_e += x[POS]
        self.vel_e += x[VEL]
        self.C_eb = turned(self.C_eb, x[ATT])
        self.bias[0:3] += x[GYRO_BIAS]
        self.bias[3:6] += x[ACCEL_BIAS]
        self.bias[6 : 6 + self.model.states - 15] += x[15 : self.model.states]
        self.gnss.feed_back(x)
        self.vehicle.feed_back(x)
        self.antenna.feed_back(x)
        if self.model.odometer:
            self.odometer_scale += float(x[-1])
        if self.tape is not None:
            self.tape.correct(x)

    def _record_now(self) -> None:
        """Overwrite the last row if it is of this instant, so that rows hold what was updated."""
        row = self._rows[int(self._cursor[0]) - 1]
        if abs(row[layout.ROW_TIME] - self.time) < 1e-6:
            layout.record(row, self.time, self.pos_e, self.vel_e, self.C_eb, self.bias, self.P)
