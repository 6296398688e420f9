"""Live navigation: IMU samples and GNSS events as they come, the same answers as a batch run.

    navigator = Navigator(calibration, config, imu_interval=0.01)
    navigator.add_imu(time, gyro_b, accel_b)         # every sample, in order
    navigator.add_gnss(event)                        # nav.engine.gnss.GnssEvent, when it arrives
    state = navigator.state                          # NavState, or None before alignment

Events are worked off `latency` behind the IMU, so that a fix that takes its time still finds the
filter at its epoch; `state` is carried on to the latest sample. Until there is an attitude they are
kept, too, and looked at one by one (`nav.engine.start.StartFinder`); levelling in motion finds one
in the past, and then they are worked off from there. An event that arrives later than `latency` is
logged as late and not used.
"""

from __future__ import annotations

import heapq
from collections import deque
from itertools import count

import numpy as np
from numpy.typing import ArrayLike

from ..datasets.sequence import Calibration, Odometer
from ..filters.error_model import ErrorModel
from ..filters.errors import AlignmentError, DataError
from ..filters.rotation import FloatArray
from ..filters.sensors import imu_preset
from ..filters.strapdown import InertialStream, NavState, integrate
from .config import Config
from .engine.blind import Spell, is_gap
from .engine.gnss import GnssEvent
from .engine.loop import FilterLoop
from .engine.start import Start, StartFinder, start_filter
from .engine.vehicle import VehicleConstraints
from .solution import Update


class LiveStream(InertialStream):
    """An inertial stream that grows.

    Parameters
    ----------
    interval : float
        Nominal sample interval [s]; the first sample is taken to cover one.
    """

    def __init__(self, interval: float) -> None:
        self.interval, self._count = interval, 0
        self._edges, self._gyro, self._accel = (
            np.zeros(1025),
            np.zeros((1024, 3)),
            np.zeros((1024, 3)),
        )

    def append(self, time: float, gyro_b: ArrayLike, accel_b: ArrayLike) -> None:
        """Add the sample that ends at `time` [s]; refuses time going backwards."""
        n = self._count
        if n == 0:
            self._edges[0] = time - self.interval
        if not time > self._edges[n]:
            raise DataError(
                f"imu: time goes backwards ({self._edges[n]:.6f} s, then {time:.6f} s)",
                remedy="sort the samples, or leave out the repeated one",
            )
        sample = np.concatenate([np.ravel(gyro_b), np.ravel(accel_b)])
        if sample.shape != (6,) or not np.isfinite(sample).all():
            raise DataError(f"imu: expected six finite values at {time:.6f} s")
        if n == self._gyro.shape[0]:
            self._edges = np.concatenate([self._edges, np.zeros(n)])
            self._gyro = np.concatenate([self._gyro, np.zeros((n, 3))])
            self._accel = np.concatenate([self._accel, np.zeros((n, 3))])
        self._edges[n + 1], self._gyro[n], self._accel[n] = time, sample[:3], sample[3:]
        self._count = n + 1

    def __len__(self) -> int:
        return self._count

    @property
    def edges(self) -> FloatArray:  # type: ignore[override]
        """Interval edges so far."""
        return self._edges[: self._count + 1]

    @property
    def gyro(self) -> FloatArray:  # type: ignore[override]
        """Mean rates so far [rad/s]."""
        return self._gyro[: self._count]

    @property
    def accel(self) -> FloatArray:  # type: ignore[override]
        """Mean specific forces so far [m/s²]."""
        return self._accel[: self._count]


class Navigator:
    """Loosely coupled navigation of a live vehicle.

    Parameters
    ----------
    calibration : Calibration
    config : Config
    imu_interval : float
        Nominal sample interval of the IMU [s].
    latency : float
        How late after its epoch GNSS may arrive and is still sure to be used [s].
    odometer : Odometer, optional
        Recorded; live odometers are not supported.
    """

    def __init__(
        self,
        calibration: Calibration,
        config: Config,
        imu_interval: float,
        latency: float = 0.5,
        odometer: Odometer | None = None,
    ) -> None:
        self.calibration, self.config, self.latency = calibration, config, latency
        self._stream = LiveStream(imu_interval)
        spec = imu_preset(config.filter.imu) if config.filter.imu else calibration.imu
        self._vehicle = VehicleConstraints(calibration, config.vehicle, odometer)
        self._model = ErrorModel(
            spec, config.filter.states, config.filter.bias_model,
            self._vehicle.odometer is not None,
            config.gnss.clock_walk_mps, config.gnss.position_correlation_s,
        )  # fmt: skip
        self._finder = StartFinder(self._stream, calibration, config.alignment, self._model)
        self._kept: list[GnssEvent] = []
        self._queue: list[tuple[float, str, int, GnssEvent]] = []
        self._order = count()
        self._spells: deque[Spell] = deque()
        self._loop: FilterLoop | None = None

    @property
    def waiting(self) -> str:
        """What is missing for an attitude; '' once there is one."""
        return self._finder.waiting if self._loop is None else ""

    @property
    def attempts(self) -> tuple[tuple[float, str], ...]:
        """GPS time of each certified attempt so far [s], and what it was waiting for."""
        return tuple(self._finder.attempts)

    @property
    def state(self) -> NavState | None:
        """The estimate at the latest IMU sample, or None before alignment (see `waiting`)."""
        if self._loop is None:
            return None
        kalman = self._loop.kalman
        if self._stream.end <= kalman.time:
            return kalman.state
        first = max(self._stream.index(kalman.time) - 1, 0)
        bias = kalman.bias
        recent = InertialStream.of_edges(
            self._stream.edges[first:],
            (self._stream.gyro[first:] - bias[0:3]) / (1.0 + bias[6:9]),
            (self._stream.accel[first:] - bias[3:6]) / (1.0 + bias[9:12]),
        )
        row = integrate(recent, kalman.state)[-1]
        return NavState(row[0], row[1:4], row[4:7], row[7:16].reshape(3, 3))

    def finish(self) -> None:
        """No more data will come: work off what is left, up to the last IMU sample."""
        self._work_off(self._stream.end)
        if self._loop is None:
            try:
                self._start(self._finder.close())
            except AlignmentError as error:
                self._finder.waiting = str(error)
                return
        assert self._loop is not None
        self._loop.advance(self._stream.end)

    @property
    def updates(self) -> tuple[Update, ...]:
        """The log so far."""
        return tuple(self._loop.updates) if self._loop is not None else ()

    @property
    def rows(self) -> FloatArray:
        """Recorded rows so far, as of `filters.ekf.ErrorStateFilter.rows`."""
        return self._loop.kalman.rows if self._loop is not None else np.zeros((0, 0))

    def add_imu(self, time: float, gyro_b: ArrayLike, accel_b: ArrayLike) -> None:
        """Take the sample that ends at GPS time `time` [s]: mean rate, mean specific force.

        Raises
        ------
        DataError
            If time does not increase or a value is not finite.
        """
        before = self._stream.end if len(self._stream) else time
        self._stream.append(time, gyro_b, accel_b)
        if is_gap(time - before, self._stream.interval):
            self._spells.append((before, time))
        self._work_off(time - self.latency)

    def add_gnss(self, event: GnssEvent) -> None:
        """Take a position, a velocity or Doppler rows."""
        heapq.heappush(self._queue, (event.time, event.kind, next(self._order), event))
        if len(self._stream):
            self._work_off(self._stream.end - self.latency)

    def _work_off(self, until: float) -> None:
        """Apply what is due by `until` [s]; the steps are those of a batch run."""
        while self._queue and self._queue[0][0] <= until:
            event = heapq.heappop(self._queue)[3]
            if self._loop is not None:
                self._loop.offer(event)
                continue
            self._kept.append(event)
            start = self._finder.offer(event)
            if start is not None:
                self._start(start)
        if self._loop is not None:
            self._loop.constrain(until)

    def _start(self, start: Start) -> None:
        """Begin to filter, with what was kept until now."""
        kalman = start_filter(
            start, self._stream, self.calibration, self._model, self.config.filter
        )
        self._loop = FilterLoop(kalman, self.calibration, self._vehicle, self.config, self._spells)
        # One that came late was looked at late; the filter gets it in its place.
        for kept in sorted(self._kept, key=lambda event: (event.time, event.kind)):
            self._loop.offer(kept)
        self._kept.clear()
